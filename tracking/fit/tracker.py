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
from .at_rest import STEPS, WORSE, AtRest, FitSettings, fit_rest, misfit_limit, visible_markers
from .compression import compression, deviations, fine_part
from .looks import astray, better, judge, untangled, worth
from .memory import PATIENCE, Look, Memory
from .neighbour_kernels import median, tie_light
from .pair_state import PairFits, PairState
from .relocate import Relocated
from .tuning import faded, tune

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]

#: Settings of the default tracker.
FULL = FitSettings()
#: Settings that fit pairs which hold still only in every fourth frame.
THRIFTY = FitSettings(turns=4)
#: The same, from every other row of the image.
SPARSE = FitSettings(turns=4, rows=2)
#: Settings that fit places alone, to every other row, in a single step where that is enough.
QUICK = FitSettings(free=2, rows=2, arrived=0.3, glance=True)

#: A fit of the colours helped where it lowers the misfit to less than this share.
_BETTER = 0.98
#: Newly lost markers that have all markers detected anew: more than this number …
_FEW = 3
#: … and more than this share.
_FEW_SHARE = 0.02
#: Standard deviation added to the log size of a marker that touches another one of its layer.
_TOUCHING_SIZE = 0.003
#: Frames in a row that are only glanced at while any marker is lost.
_GLANCES = 8
#: Pairs that moved less than this in a frame hold still [px].
_STILL = 0.05
#: All pairs are fitted where the still ones fit worse than before by this factor.
_CHANGED = 1.1


class MarkerTracker:
    """Fits place, size and strain of all markers of both layers, and the light on them.

    Parameters
    ----------
    palette: of the markers
    noise: standard deviation of the camera noise [grey levels]; rounding is added to it
    settings: effort that is spent on a frame

    Attributes
    ----------
    state: all that changes from frame to frame, as one frozen value
    rest: tracks of the rest frames
    """

    state: Memory
    rest: Tracks
    _known: AtRest

    def __init__(self, palette: Palette, noise: float, settings: FitSettings = FULL) -> None:
        self._palette, self._noise, self.settings = palette, noise, settings

    def reset(self, rest: list[Frame]) -> Tracks:
        """Find the markers in frames of the unloaded sensor; their mean is the rest position.

        Raises
        ------
        UserError
            When there is no frame, or it does not show the sensor's markers.
        """
        known, fits = fit_rest(rest, self._palette, self._noise, self.settings)
        visible = visible_markers(fits)
        self._known = known
        self.state = Memory(
            start=known.state.unsloped(),
            velocity=np.zeros_like(known.state.fits),
            fitted=None,
            visible=visible,
            intact=visible,
            last_seen=np.where(visible.T, rest[-1].time, np.nan)[: known.layers],
            typical=max(1.0, fits.typical),
        )
        tracks = _tracks(known, self.state, rest[-1], fits, visible, np.zeros_like(visible))
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
        self.state, tracks = step(self._known, self.state, frame)
        return tracks


def thrifty(palette: Palette, noise: float) -> MarkerTracker:
    """Tracker that fits pairs which hold still in every fourth frame only.

    Pairs that move, and those next to them, are fitted in every frame. The others stay as they were
    fitted last: they lag by three frames at most, and their noise stays for as long, which shakes a
    control loop more. Where the light changes, or any pair is lost, all are fitted.
    """
    return MarkerTracker(palette, noise, THRIFTY)


def sparse(palette: Palette, noise: float) -> MarkerTracker:
    """Tracker as `thrifty`, from every other row of the image: noisier, in half the time."""
    return MarkerTracker(palette, noise, SPARSE)


def quick(palette: Palette, noise: float) -> MarkerTracker:
    """Tracker of places alone, from every other row, in a single step where that is enough.

    Shapes are taken as at rest, and hues are not measured. Where the step does not explain all
    markers that were visible, the frame is fitted as `MarkerTracker` does.
    """
    return MarkerTracker(palette, noise, QUICK)


def step(known: AtRest, memory: Memory, frame: Frame) -> tuple[Memory, Tracks]:
    """Memory after a frame, and its tracks.

    Parameters
    ----------
    known: the unloaded sensor
    memory: after the frame before
    frame: of the rest frame's size
    """
    image = frame.image
    if known.settings.glance:
        glance = _glance(known, memory, frame)
        if glance is not None:
            return glance
    memory = replace(memory, glances=0, frames=memory.frames + 1)
    start = memory.expected()
    look = judge(known, memory, image, _first_fit(known, memory, image, start), start)
    if astray(known, memory, look, 0):
        # The skin may have reversed its motion.
        still = memory.start.unsloped()
        look = better(look, judge(known, memory, image, known.fit.fit(image, still, STEPS), still))
    look = untangled(known, memory, image, look)
    ambiguous = look.torn
    steady = not astray(known, memory, look, max(_FEW, int(_FEW_SHARE * len(look.visible))))
    if not steady:
        relocated = known.relocator(image)
        start = _start_at(known, memory, relocated)
        again = judge(known, memory, image, known.fit.fit(image, start, STEPS), start)
        if worth(again) >= worth(look):
            look = again
            unsure = np.zeros_like(look.visible)
            unsure[:, : known.layers] = relocated.ambiguous.T
            ambiguous = look.visible & (look.torn | unsure)
    memory, look, ambiguous = _tuned(known, memory, image, look, ambiguous, start)
    memory = _remember(known, memory, look, steady)
    memory = _at_time(memory, frame, look.visible)
    return memory, _tracks(known, memory, frame, look.fits, look.visible, ambiguous)


def _first_fit(known: AtRest, memory: Memory, image: Image, start: PairState) -> PairFits:
    """Fit of a frame from where its markers are expected; still pairs only in their turn."""
    present, before = known.state.present, memory.fitted
    if (
        known.settings.turns == 1
        or before is None
        or not np.isfinite(before.misfit[present.any(axis=1)]).all()
        or not memory.visible[present].all()
    ):
        return known.fit.fit(image, start, STEPS)

    def and_around(which: Mask) -> Mask:
        return np.asarray(which | which[known.fit.near].any(axis=1))

    moving = abs(memory.velocity[..., :2]).max(axis=(1, 2)) > _STILL
    turn = (np.arange(len(moving)) - memory.frames) % known.settings.turns == 0
    active = and_around(moving) | turn
    fits = np.where(active[:, None, None], start.fits, memory.start.fits)
    last = PairFits(replace(start, fits=fits), before.misfit, before.covariance)
    now = known.fit.refit(image, last, active, STEPS)
    still = turn & ~moving
    if median(now.misfit[still]) > _CHANGED * max(1.0, median(before.misfit[still])):
        return known.fit.fit(image, start, STEPS)
    # Pairs that move after all, and those around them, are fitted as well.
    moved = abs((now.state.fits - memory.start.fits)[..., :2]).max(axis=(1, 2)) > _STILL
    woken = and_around(moved) & ~active
    return known.fit.refit(image, now, woken, STEPS) if woken.any() else now


def _glance(known: AtRest, memory: Memory, frame: Frame) -> tuple[Memory, Tracks] | None:
    """As `step`, from a single step of the fit; None where that is not enough."""
    visible, glances = memory.visible, memory.glances + 1
    fits = known.fit.glance(frame.image, replace(memory.expected(), present=visible))
    explained = fits.misfit < misfit_limit(fits)
    if not (explained | ~visible.any(axis=1)).all():
        return None
    if glances > _GLANCES and known.lost(visible):
        return None
    memory = _go_on(known, replace(memory, glances=glances), fits.state, fits.state.fits, visible)
    memory = _at_time(memory, frame, visible)
    return memory, _tracks(known, memory, frame, fits, visible, np.zeros_like(visible))


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
    explained worse than by noise alone.
    """
    typical = look.fits.typical
    least = 1.0
    waited, patience = memory.waited + 1, memory.patience
    worse = typical > WORSE * memory.typical
    tried = worse or (typical > WORSE and waited > patience)
    if tried:
        waited, patience = 0, PATIENCE if worse else 2 * patience
        fits = tune(known.fit, image, look.fits, memory.start.fits, STEPS)
        light = fits.state
        if fits is look.fits:
            # No light explains more, and it is not tried again where it is as bad again.
            least = memory.typical
        elif not faded(known.fit, light):
            start = replace(start, absorbed=light.absorbed, width=light.width, black=light.black)
            look = judge(known, memory, image, fits, start)
            ambiguous = look.visible & (look.torn | ambiguous)
            before, typical = typical, look.fits.typical
            if typical < _BETTER * before:
                patience = PATIENCE
    memory = replace(memory, waited=waited, patience=patience)
    if tried or not memory.typical / WORSE < typical < WORSE * memory.typical:
        memory = replace(memory, typical=max(least, min(typical, 1e6)))
    return memory, look, ambiguous


def _remember(known: AtRest, memory: Memory, look: Look, steady: bool) -> Memory:
    """Memory after a look; lost markers move with their visible neighbours."""
    visible, state, near = look.visible, look.fits.state, known.fit.near
    displacement = np.where(visible[..., None], state.fits - known.state.fits, np.nan)
    gains = np.where(np.asarray(visible.any(axis=1))[:, None], state.gains, np.nan)
    for m in np.flatnonzero((~visible & known.state.present).any(axis=1)):
        for k in np.flatnonzero(~visible[m]):
            around = near[m][visible[near[m], k]]
            displacement[m, k] = np.median(displacement[around, k], axis=0) if len(around) else 0.0
        if np.isnan(gains[m, 0]):
            lit = near[m][visible[near[m]].any(axis=1)]
            gains[m] = gains[lit].mean(axis=0) if len(lit) else memory.start.gains[m]
    fits = known.state.fits + np.nan_to_num(displacement)
    state = replace(state, gains=np.where(np.isnan(gains), 1.0, gains))
    memory = _go_on(known, memory, state, fits, visible & steady)
    return replace(memory, visible=visible, intact=visible & ~look.torn, fitted=look.fits)


def _go_on(known: AtRest, memory: Memory, state: PairState, fits: Array, steady: Mask) -> Memory:
    """Memory with the start and the velocity of the next frame.

    Parameters
    ----------
    state, fits: of this frame; of lost markers, as they are assumed
    steady: markers that this frame shows the velocity of, shape (M, 2)
    """
    # The mean over the neighbours is a steadier guess than each marker's own step.
    step = np.where(steady[..., None], (fits - memory.start.fits)[..., :2], 0.0)
    near = known.fit.near
    velocity = np.zeros_like(fits)
    velocity[..., :2] = (step + step[near].sum(axis=1)) / (1 + near.shape[1])
    start = replace(state, fits=fits, present=known.state.present)
    return replace(memory, start=start, velocity=velocity)


def _at_time(memory: Memory, frame: Frame, visible: Mask) -> Memory:
    """Memory with the frame's time for the markers that are visible in it."""
    layers = len(memory.last_seen)
    last_seen = np.where(visible.T[:layers], frame.time, memory.last_seen)
    return replace(memory, last_seen=last_seen)


def _tracks(
    known: AtRest, memory: Memory, frame: Frame, fit: PairFits, visible: Mask, ambiguous: Mask
) -> Tracks:
    """Tracks of a frame from its fit."""
    layers, shape = known.layers, fit.state.fits.shape
    # Where the model leaves more than noise unexplained, the fit is less certain.
    excess = np.where(visible.any(axis=1), np.maximum(fit.misfit, 1.0), 1.0)
    covariance = fit.covariance * excess[:, None, None]
    fits = np.where(visible[..., None], fit.state.fits, np.nan)
    log_size, hue = np.full(shape[:2], np.nan), partial(np.full, shape[0], np.nan)
    if known.settings.free == 5:
        gained = fit.state.gains / known.state.gains
        # A pair that is not visible may have no light at all.
        light = np.log(gained, out=np.full_like(gained, np.nan), where=gained > 0.0)
        tie_light(light, visible.any(axis=1), known.fit.near, covariance, fits)
        p, q = fits[..., 3], fits[..., 4]
        log_size = fits[..., 2] + 0.5 * np.log(1.0 - p**2 - q**2)
        hue = partial(known.fit.hues, frame.image, fits)
    factor = _compression(known, frame.image, fit)
    if factor > 1.0:
        offset = (fit.state.fits - known.state.fits)[..., :2]
        moved = np.linalg.norm(np.where(visible[..., None], offset, 0.0), axis=2).max(axis=1)
        spread = deviations(factor, moved)
        covariance[:, :6, :6] *= spread[:, :, None] * spread[:, None]
    if known.settings.free == 5:
        # Where markers touch, sizes depend on the light between them, which is less certain.
        doubt = _TOUCHING_SIZE**2 * known.fit.touching(fits, visible)
        covariance[:, 2, 2] += doubt
        covariance[:, 5, 5] += doubt
    ambiguous = ambiguous | known.fit.crowded(fits, visible)
    covariance = covariance[:, : 3 * layers, : 3 * layers]
    covariance[np.repeat(~visible[:, :layers], 3, axis=1)] = np.nan
    return Tracks(
        time=frame.time,
        position=np.swapaxes(fits[:, :layers, :2], 0, 1),
        log_size=log_size[:, :layers].T,
        hue=hue,
        visible=visible[:, :layers].T,
        ambiguous=ambiguous[:, :layers].T,
        last_seen=memory.last_seen.copy(),
        covariance=covariance,
        compression=factor,
    )


def _compression(known: AtRest, image: Image, fit: PairFits) -> float:
    """What compression enlarged the deviations of a frame by; 1 for none."""
    residual = np.sqrt(fit.typical * (known.fit.noise**2 + 1.0 / 12.0))
    return compression(float(residual), fine_part(image, known.flat))
