"""The default tracker: a new fit of the known shapes to every frame.

The last frame only determines where each fit starts, so that errors do not accumulate. A marker
whose pixels the fit does not explain is lost. Markers keep their numbers by continuity in time. If
that breaks, or several are lost at once, all are detected again and numbered from the rim inwards,
see `relocate`.
"""

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ...render import Frame
from ..doubt import Doubt, doubted, mean_step
from ..palette import Palette
from ..trackers import check_frame
from ..tracks import Tracks
from .at_rest import AtRest, fit_rest, visible_markers
from .compression import compression, deviations, fine_part
from .kernels.survey_kernels import report, velocities
from .looks import astray, better, blind, judge, surveyed, untangled, worth
from .memory import Look, Memory
from .pair_fit import level_variance
from .pair_state import PairFits, PairState
from .relocate import Relocated
from .settings import FitSettings
from .templates import forget
from .tuning import faded, tune

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]

#: Settings of the default tracker.
FULL = FitSettings()
#: Settings that read every other row of the image and keep templates for longer.
QUICK = FitSettings(rows=2, limit=0.2)


class MarkerTracker:
    """Fits position, size and strain of all markers of both layers, and the light on them.

    Parameters
    ----------
    palette: colours of the markers
    noise: standard deviation of the camera noise [grey levels]; rounding is added to it
    settings: effort per frame, and tuned parameters

    Attributes
    ----------
    rest: tracks of the rest frames
    """

    rest: Tracks
    _known: AtRest
    _memory: Memory

    def __init__(self, palette: Palette, noise: float, settings: FitSettings = FULL) -> None:
        self._palette, self._noise, self.settings = palette, noise, settings

    @property
    def state(self) -> Memory:
        """Copy of everything that changes from frame to frame."""
        return self._memory.copied()

    @state.setter
    def state(self, state: Memory) -> None:
        self._memory = state.copied()

    def reset(self, rest: list[Frame]) -> Tracks:
        """Find the markers in frames of the unloaded sensor; their mean is the rest position.

        Raises
        ------
        UserError
            When there is no frame, or it does not show the sensor's markers.
        """
        known, fits = fit_rest(rest, self._palette, self._noise, self.settings)
        self._known = known
        visible = visible_markers(fits, self.settings)
        self._memory = Memory(
            start=known.state.unsloped(),
            velocity=np.zeros_like(known.state.fits),
            templates=known.fit.empty_templates(),
            visible=visible,
            intact=visible,
            last_seen=np.where(visible.T, rest[-1].time, np.nan)[: known.layers],
            typical=known.typical,
            patience=self.settings.patience,
            doubt=Doubt.of_rest(_places(known, known.state.fits), visible.T[: known.layers]),
        )
        look = surveyed(known, self._memory, fits)
        tracks = _tracks(known, self._memory, rest[-1], look, np.zeros_like(visible))
        if tracks.compression > 1.0:  # errors common to all rest frames do not average out
            tracks = replace(tracks, covariance=len(rest) * tracks.covariance)
        self.rest = tracks
        return self.rest

    def update(self, frame: Frame) -> Tracks:
        """Find the markers in the next frame.

        Raises
        ------
        UserError
            When the frame has another size than the rest frame.
        """
        check_frame(frame, self._known.shape)
        self._memory, tracks = step(self._known, self._memory, frame)
        return tracks


def quick(palette: Palette, noise: float) -> MarkerTracker:
    """Make a tracker that reads every other row of the image and keeps templates for longer."""
    return MarkerTracker(palette, noise, QUICK)


def step(known: AtRest, memory: Memory, frame: Frame) -> tuple[Memory, Tracks]:
    """Track one frame; return the memory after it, and its tracks.

    Parameters
    ----------
    known: fit of the unloaded sensor
    memory: memory after the previous frame; its templates are changed in place
    frame: frame of the rest frame's size
    """
    image = np.ascontiguousarray(frame.image)
    memory = replace(memory, frames=memory.frames + 1)
    start = memory.expected()
    settings = known.settings
    limit, steps = settings.limit, settings.steps
    calm = abs(memory.velocity[..., :2]).max(axis=(1, 2)) < limit
    fits = known.fit.follow(image, start, calm, limit, memory.templates, steps)
    look = judge(known, memory, image, fits, start)
    if astray(known, memory, look, 0):
        # The skin may have reversed its motion.
        still = memory.start.unsloped()
        look = better(look, judge(known, memory, image, known.fit.fit(image, still, steps), still))
    look = untangled(known, memory, image, look)
    ambiguous = look.torn
    few = max(settings.few, int(settings.few_share * len(look.visible)))
    steady, relocated = not astray(known, memory, look, few), None
    if blind(known, look.visible):
        steady = steady and memory.frames % settings.looks.turns > 0
    if not steady:
        moved = _places(known, memory.start.fits) - _places(known, known.state.fits)
        relocated = known.relocator(image, moved)
        start = _start_at(known, memory, relocated)
        again = judge(known, memory, image, known.fit.fit(image, start, steps), start)
        if worth(again) >= worth(look):
            look = again
            unsure = np.zeros_like(look.visible)
            unsure[:, : known.layers] = relocated.ambiguous.T
            ambiguous = look.visible & (look.torn | unsure)
        else:
            steady = True
    memory, look, ambiguous = _tuned(known, memory, image, look, ambiguous, start)
    before, memory = memory, _remember(known, memory, look, steady)
    memory = _doubting(known, before, memory, image, look, relocated)
    # Markers that the edge cuts are fitted, so that their neighbours are followed, but not told.
    told = ~known.edge.hidden(look.fits.state.fits[..., :2])
    look, ambiguous = look._replace(visible=look.visible & told), ambiguous & told
    memory = _at_time(memory, frame, look.visible)
    return memory, _tracks(known, memory, frame, look, ambiguous)


def _places(known: AtRest, fits: Array) -> Array:
    """Places of fits (M, 2, 5) by layer, NaN where one has no marker, shape (L, M, 2) [px]."""
    places = np.where(known.state.present[..., None], fits[..., :2], np.nan)
    return np.swapaxes(places, 0, 1)[: known.layers]


def _doubting(
    known: AtRest,
    before: Memory,
    memory: Memory,
    image: Image,
    look: Look,
    relocated: Relocated | None,
) -> Memory:
    """Judge whether the numbers are certain, if several were lost or found again, see `doubt`."""
    lost = ~(look.visible & ~look.on_others).T[: known.layers]
    fits = (known.state.fits, before.start.fits, memory.start.fits)
    leap = mean_step(fits[2][:, 0, :2], fits[1][:, 0, :2], known.pitch)
    if memory.doubt.stands(lost, look.torn, known.settings.few, leap):
        return memory
    rest, last, now = (_places(known, each) for each in fits)
    spots = known.relocator.blobs(image)[0] if relocated is None else relocated.blobs
    near, edge = known.fit.near, known.edge.at_rest(rest)
    doubt = doubted(memory.doubt, (rest, last, now), lost, known.pitch, near, spots, edge)
    return replace(memory, doubt=doubt)


def _start_at(known: AtRest, memory: Memory, relocated: Relocated) -> PairState:
    """State with markers at relocated positions, from which a fit starts."""
    fits = known.state.fits.copy()
    finite = np.isfinite(relocated.position)
    at = np.swapaxes(fits, 0, 1)[: known.layers, :, :2]
    at[finite] = relocated.position[finite]
    return replace(memory.start.unsloped(), fits=fits, gains=relocated.gains)


def _tuned(
    known: AtRest, memory: Memory, image: Image, look: Look, ambiguous: Mask, start: PairState
) -> tuple[Memory, Look, Mask]:
    """Fit colours and blur if needed; return the memory, look and ambiguous markers.

    They are fitted when the misfit is larger than before, and at growing intervals while it is
    larger than at rest, as colours may not be the cause.
    """
    settings, least = known.settings, 1.0
    waited, patience = memory.waited + 1, memory.patience

    def is_time(typical: float) -> bool:
        worse = typical > settings.worse * known.typical
        return typical > settings.worse * memory.typical or (worse and waited > patience)

    before = look.fits.typical
    tried = is_time(before)
    if tried:
        # Templates fit less well as pairs move, and colours do not improve that.
        forget(memory.templates)
        fresh = known.fit.fit(image, look.fits.state.unsloped(), settings.steps)
        before = min(before, fresh.typical)  # do not credit this gain to the colours
        look = better(look, judge(known, memory, image, fresh, start))
        tried = is_time(look.fits.typical)
    typical = look.fits.typical
    worse = typical > settings.worse * memory.typical
    if tried:
        waited, patience = 0, settings.patience if worse else 2 * patience
        shapes = memory.start.fits
        fits = tune(known.fit, image, look.fits, shapes, settings.steps, settings.tuning)
        light = fits.state
        if fits is look.fits:
            # No colours fit better; do not try again until the misfit grows further.
            least = memory.typical
        elif not faded(known.fit, light, settings.tuning):
            start = replace(start, absorbed=light.absorbed, width=light.width, black=light.black)
            look = judge(known, memory, image, fits, start)
            forget(memory.templates)
            ambiguous = look.visible & (look.torn | ambiguous)
            typical = look.fits.typical
            if typical < settings.better * before:
                patience = settings.patience
    memory = replace(memory, waited=waited, patience=patience)
    if tried or not memory.typical / settings.worse < typical < settings.worse * memory.typical:
        memory = replace(memory, typical=max(least, min(typical, 1e6)))
    return memory, look, ambiguous


def _remember(known: AtRest, memory: Memory, look: Look, steady: bool) -> Memory:
    """Update the memory after a look; lost markers move with their visible neighbours."""
    visible, state, near = look.visible, look.fits.state, known.fit.near
    lost = np.asarray((~visible & known.state.present).any(axis=1)) & ~known.odd
    # A missing layer keeps its rest position.
    followed = visible | (known.state.present & known.odd[:, None])
    # After a frame that shows too little, the field is near its last place, not at rest.
    other = memory.start.fits if blind(known, visible) else known.state.fits
    fits = np.where(followed[..., None], state.fits, other)
    if lost.any():
        displacement = np.where(visible[..., None], state.fits - known.state.fits, np.nan)
        gains = np.where(np.asarray(visible.any(axis=1))[:, None], state.gains, np.nan)
        for m in np.flatnonzero(lost):
            for k in np.flatnonzero(~visible[m]):
                around = near[m][visible[near[m], k]]
                if len(around):
                    fits[m, k] = known.state.fits[m, k]
                    fits[m, k] += np.median(displacement[around, k], axis=0)
            if np.isnan(gains[m, 0]):
                lit = near[m][visible[near[m]].any(axis=1)]
                gains[m] = gains[lit].mean(axis=0) if len(lit) else memory.start.gains[m]
        state = replace(state, gains=np.where(np.isnan(gains), 1.0, gains))
        forget(memory.templates, lost)
    memory = _go_on(known, memory, state, fits, visible & steady)
    return replace(memory, visible=visible, intact=visible & ~look.torn)


def _go_on(known: AtRest, memory: Memory, state: PairState, fits: Array, steady: Mask) -> Memory:
    """Update start and velocity for the next frame.

    Parameters
    ----------
    state: state of this frame
    fits: parameters of the markers in this frame, assumed ones for lost markers, (M, 2, 5)
    steady: markers whose velocity is known from this frame, shape (M, 2)
    """
    # The mean over the neighbours is less noisy than each marker's own step.
    velocity = np.empty_like(fits)
    velocities(fits, memory.start.fits, steady, known.fit.near, velocity)
    start = replace(state, fits=fits, present=known.state.present)
    return replace(memory, start=start, velocity=velocity)


def _at_time(memory: Memory, frame: Frame, visible: Mask) -> Memory:
    """Set `last_seen` of the visible markers to the frame's time."""
    layers = len(memory.last_seen)
    last_seen = np.where(visible.T[:layers], frame.time, memory.last_seen)
    return replace(memory, last_seen=last_seen)


def _tracks(known: AtRest, memory: Memory, frame: Frame, look: Look, ambiguous: Mask) -> Tracks:
    """Make the tracks of a frame from its look."""
    layers, fit, visible = known.layers, look.fits, look.visible
    fits, covariance = fit.state.fits.copy(), fit.covariance.copy()
    log_size, spread = np.empty((2, len(fits))), np.ones((len(fits), 6))
    doubt = np.zeros((len(fits), 6))
    factor = _compression(known, frame.image, fit)
    if factor > 1.0 or known.skin is not None:
        offset = (fits - known.state.fits)[..., :2]
        moved = np.linalg.norm(np.where(visible[..., None], offset, 0.0), axis=2).max(axis=1)
        if factor > 1.0:
            spread = deviations(factor, moved, known.settings.compression)
        if known.skin is not None:
            doubt = known.skin.variances(moved)
    # Sizes of touching markers depend on the light between them, which is less certain.
    doubt[:, 2::3] += (known.settings.touching_size**2 * look.touching)[:, None]
    report(
        fit.state.gains, known.state.gains, fit.misfit, visible, known.fit.near, spread, doubt,
        fits, covariance, log_size,
    )  # fmt: skip
    ambiguous = ambiguous | look.on_others
    ambiguous[:, :layers] |= visible[:, :layers] & memory.doubt.mask.T
    return Tracks(
        time=frame.time,
        position=np.swapaxes(fits[:, :layers, :2], 0, 1),
        log_size=log_size[:layers],
        hue=partial(known.fit.hues, frame.image, fits),
        visible=visible[:, :layers].T,
        ambiguous=ambiguous[:, :layers].T,
        last_seen=memory.last_seen.copy(),
        covariance=covariance[:, : 3 * layers, : 3 * layers],
        compression=factor,
    )


def _compression(known: AtRest, image: Image, fit: PairFits) -> float:
    """Factor by which compression increased the standard deviations in a frame; 1 for none."""
    residual = np.sqrt(fit.typical * level_variance(known.fit.noise))
    own = known.settings.compression
    return compression(float(residual), fine_part(image, known.flat), own)
