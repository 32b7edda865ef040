"""The default tracker: in every frame the known shapes are fitted anew.

The last frame only says where each fit starts, so that errors do not add up. A marker whose pixels
are not explained is lost. Markers keep their numbers by continuity in time; where that breaks, or
several are lost at once, all are detected anew and numbered from the rim inwards, see `relocate`.
"""

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ...render import Frame
from ..palette import Palette
from ..trackers import check_frame
from ..tracks import Tracks
from .at_rest import AtRest, fit_rest, visible_markers
from .compression import compression, deviations, fine_part
from .kernels.survey_kernels import report, velocities
from .looks import astray, better, judge, surveyed, untangled, worth
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
#: Settings that read every other row of the image.
SPARSE = FitSettings(rows=2, limit=0.1)
#: The same, with templates that are kept for longer.
QUICK = FitSettings(rows=2, limit=0.2)


class MarkerTracker:
    """Fits place, size and strain of all markers of both layers, and the light on them.

    Parameters
    ----------
    palette: of the markers
    noise: standard deviation of the camera noise [grey levels]; rounding is added to it
    settings: effort of a frame, and tuned numbers

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
        """All that changes from frame to frame; a copy, as templates are changed in place."""
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
        )
        look = surveyed(known, self._memory, fits)
        tracks = _tracks(known, self._memory, rest[-1], look, np.zeros_like(visible))
        if tracks.compression > 1.0:  # its errors are the same in all rest frames
            tracks = replace(tracks, covariance=len(rest) * tracks.covariance)
        self.rest = tracks
        return self.rest

    def update(self, frame: Frame) -> Tracks:
        """Markers in the next frame.

        Raises
        ------
        UserError
            When the frame has another size than the rest frame.
        """
        check_frame(frame, self._known.shape)
        self._memory, tracks = step(self._known, self._memory, frame)
        return tracks


def sparse(palette: Palette, noise: float) -> MarkerTracker:
    """Tracker that reads every other row of the image: noisier, in less time."""
    return MarkerTracker(palette, noise, SPARSE)


def quick(palette: Palette, noise: float) -> MarkerTracker:
    """Tracker as `sparse`, whose templates are kept until a pair has moved twice as far."""
    return MarkerTracker(palette, noise, QUICK)


def step(known: AtRest, memory: Memory, frame: Frame) -> tuple[Memory, Tracks]:
    """Memory after a frame, and its tracks.

    Parameters
    ----------
    known: the unloaded sensor
    memory: after the frame before; its templates are changed in place
    frame: of the rest frame's size
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
    steady = not astray(known, memory, look, few)
    if not steady:
        relocated = known.relocator(image)
        start = _start_at(known, memory, relocated)
        again = judge(known, memory, image, known.fit.fit(image, start, steps), start)
        if worth(again) >= worth(look):
            look = again
            unsure = np.zeros_like(look.visible)
            unsure[:, : known.layers] = relocated.ambiguous.T
            ambiguous = look.visible & (look.torn | unsure)
    memory, look, ambiguous = _tuned(known, memory, image, look, ambiguous, start)
    memory = _remember(known, memory, look, steady)
    memory = _at_time(memory, frame, look.visible)
    return memory, _tracks(known, memory, frame, look, ambiguous)


def _start_at(known: AtRest, memory: Memory, relocated: Relocated) -> PairState:
    """State to start from at positions that were found without the fit."""
    fits = known.state.fits.copy()
    finite = np.isfinite(relocated.position)
    at = np.swapaxes(fits, 0, 1)[: known.layers, :, :2]
    at[finite] = relocated.position[finite]
    return replace(memory.start.unsloped(), fits=fits, gains=relocated.gains)


def _tuned(
    known: AtRest, memory: Memory, image: Image, look: Look, ambiguous: Mask, start: PairState
) -> tuple[Memory, Look, Mask]:
    """Memory, look and ambiguous markers with the colours and the blur fitted, where it is time.

    It is time when the pairs are explained worse than before, and now and then while they are
    explained worse than at rest: what is left there no colours explain.
    """
    settings, least = known.settings, 1.0
    waited, patience = memory.waited + 1, memory.patience

    def is_time(typical: float) -> bool:
        worse = typical > settings.worse * known.typical
        return typical > settings.worse * memory.typical or (worse and waited > patience)

    before = look.fits.typical
    tried = is_time(before)
    if tried:
        # Templates explain less as the pairs move on, which no colours change.
        forget(memory.templates)
        fresh = known.fit.fit(image, look.fits.state.unsloped(), settings.steps)
        before = min(before, fresh.typical)  # what is gained by that is not the colours' merit
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
            # No light explains more, and it is not tried again where it is as bad again.
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
    """Memory after a look; lost markers move with their visible neighbours."""
    visible, state, near = look.visible, look.fits.state, known.fit.near
    lost = np.asarray((~visible & known.state.present).any(axis=1)) & ~known.odd
    # A layer that is not there stays where it is at rest.
    followed = visible | (known.state.present & known.odd[:, None])
    fits = np.where(followed[..., None], state.fits, known.state.fits)
    if lost.any():
        displacement = np.where(visible[..., None], state.fits - known.state.fits, np.nan)
        gains = np.where(np.asarray(visible.any(axis=1))[:, None], state.gains, np.nan)
        for m in np.flatnonzero(lost):
            for k in np.flatnonzero(~visible[m]):
                around = near[m][visible[near[m], k]]
                if len(around):
                    fits[m, k] += np.median(displacement[around, k], axis=0)
            if np.isnan(gains[m, 0]):
                lit = near[m][visible[near[m]].any(axis=1)]
                gains[m] = gains[lit].mean(axis=0) if len(lit) else memory.start.gains[m]
        state = replace(state, gains=np.where(np.isnan(gains), 1.0, gains))
        forget(memory.templates, lost)
    memory = _go_on(known, memory, state, fits, visible & steady)
    return replace(memory, visible=visible, intact=visible & ~look.torn)


def _go_on(known: AtRest, memory: Memory, state: PairState, fits: Array, steady: Mask) -> Memory:
    """Memory with the start and the velocity of the next frame.

    Parameters
    ----------
    state, fits: of this frame; of lost markers, as they are assumed
    steady: markers that this frame shows the velocity of, shape (M, 2)
    """
    # The mean over the neighbours is a steadier guess than each marker's own step.
    velocity = np.empty_like(fits)
    velocities(fits, memory.start.fits, steady, known.fit.near, velocity)
    start = replace(state, fits=fits, present=known.state.present)
    return replace(memory, start=start, velocity=velocity)


def _at_time(memory: Memory, frame: Frame, visible: Mask) -> Memory:
    """Memory with the frame's time for the markers that are visible in it."""
    layers = len(memory.last_seen)
    last_seen = np.where(visible.T[:layers], frame.time, memory.last_seen)
    return replace(memory, last_seen=last_seen)


def _tracks(known: AtRest, memory: Memory, frame: Frame, look: Look, ambiguous: Mask) -> Tracks:
    """Tracks of a frame from a look at it."""
    layers, fit, visible = known.layers, look.fits, look.visible
    fits, covariance = fit.state.fits.copy(), fit.covariance.copy()
    log_size, spread = np.empty((2, len(fits))), np.ones((len(fits), 6))
    factor = _compression(known, frame.image, fit)
    if factor > 1.0:
        offset = (fits - known.state.fits)[..., :2]
        moved = np.linalg.norm(np.where(visible[..., None], offset, 0.0), axis=2).max(axis=1)
        spread = deviations(factor, moved, known.settings.compression)
    # Where markers touch, sizes depend on the light between them, which is less certain.
    doubt = known.settings.touching_size**2 * look.touching
    report(
        fit.state.gains, known.state.gains, fit.misfit, visible, known.fit.near, spread, doubt,
        fits, covariance, log_size,
    )  # fmt: skip
    ambiguous = ambiguous | look.on_others
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
    """Factor of compression on the deviations of a frame; 1 for none."""
    residual = np.sqrt(fit.typical * level_variance(known.fit.noise))
    own = known.settings.compression
    return compression(float(residual), fine_part(image, known.flat), own)
