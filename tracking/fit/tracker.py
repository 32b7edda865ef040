"""The default tracker: every frame is fitted afresh to the known shapes, from where motion leads.

Errors do not add up, and what is not explained is lost, not guessed. Markers keep their numbers by
continuity in time; where that tears, or loses markers, all are found anew and numbered from the
rim inwards, see `relocate`.
"""

from dataclasses import asdict, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ...render import Frame
from ..detection import RestFrame, read_rest
from ..palette import Palette
from ..trackers import check_frame
from ..tracks import Tracks
from .neighbour_kernels import tie_light, torn_off
from .pair_fit import PairFit, PairFits, PairState
from .relocate import Relocator

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

#: A misfit this many times the typical one is no marker; the typical one counts up to _WORST.
_LOST, _WORST = 6.0, 20.0
#: Fits this much worse than at rest have the colours and the blur fitted as well.
_WORSE = 1.1
#: Frames until that is tried again; twice as many where it did not make this much of it.
_PATIENCE, _BETTER = 4, 0.98
#: Neighbours that moved this much apart, and layers off each other, are torn [pitch].
_TORN = 0.4
#: A marker that lies on another one, this far from where its pair's other layer has it, is another
#: one, or both [radii]; pairs that moved by this tell how far the layers move [pitch].
_ASIDE, _MOVED = 0.2, 0.1
#: A marker that held together and went on within this of where it was expected is itself [pitch].
_WENT_ON = 0.2
#: Newly lost markers that make all be looked for: this many, or this share.
_FEW, _FEW_SHARE = 3, 0.02
#: Of a rest frame's markers, at least this share must look like markers.
_AT_REST = 0.7
#: How wrong the log size of a marker may be that touches another one of its layer.
_TOUCHING_SIZE = 0.003
#: Of a fit to a frame, and to the frames of rest, at most.
STEPS, _REST_STEPS = 6, 24
#: Frames until the quick tracker looks again for what it has lost.
_GLANCES = 8


class Look(NamedTuple):
    """A fit to a frame; layers that it explains, and those torn off their neighbours, (M, 2)."""

    fits: PairFits
    visible: NDArray[np.bool_]
    torn: NDArray[np.bool_]


class MarkerTracker:
    """Fits place, size and strain of all markers of both layers, and the light on them.

    Parameters
    ----------
    palette: of the markers
    noise: standard deviation of the camera noise [grey levels]; rounding is added to it
    """

    #: Numbers of each layer that are fitted; rows of the image that are read, every so manieth;
    #: and the step after which a fit has arrived [px].
    free, stride, arrived = 5, 1, 0.05

    def __init__(self, palette: Palette, noise: float) -> None:
        self._palette, self._noise = palette, noise
        self._layers = len(palette.names)
        sensor = palette.sensor
        self._share = None if sensor is None else sensor.follow[-1] / sensor.follow[0]

    def reset(self, rest: list[Frame]) -> Tracks:
        """Find the markers in frames of the unloaded sensor; their mean is the rest they keep.

        Raises
        ------
        UserError
            When there is no frame, or it does not show the sensor's markers.
        """
        seen = read_rest(rest, self._palette)
        self._fit, at_rest = self._fit_rest(seen, rest)
        self._relocator = Relocator(seen, self._palette)
        self._pitch, self._shape = seen.pitch, seen.image.shape
        self._rest = at_rest.state
        self._typical = max(1.0, at_rest.typical)
        self._waited, self._patience = 0, _PATIENCE
        visible = self._visible(at_rest)
        self._seen, self._glances = visible, 0
        self._whole = visible
        self._last_seen = np.where(visible.T, rest[-1].time, np.nan)[: self._layers]
        self._next = replace(self._rest, slopes=np.zeros_like(self._rest.slopes))
        self._velocity = np.zeros_like(self._rest.fits)
        self.rest = self._tracks(rest[-1], at_rest, visible, np.zeros_like(visible))
        return self.rest

    def _fit_rest(self, seen: RestFrame, rest: list[Frame]) -> tuple[PairFit, PairFits]:
        """Shapes from the mean of the frames; then the mean of the fits to each."""
        mean = np.rint(seen.image).astype(np.uint8)
        fit = PairFit(seen, self._palette, self._noise)
        found = fit.fit(mean, fit.start, _REST_STEPS)
        if found.typical > _WORSE:
            found = fit.tune(mean, found, found.state.fits, STEPS)
        good: Any = self._visible(found).any(axis=1)
        if good.sum() < _AT_REST * len(good):
            raise UserError(
                f"only {good.sum()} of {len(good)} markers of the rest frame look like markers"
            )
        start = fit.take_shapes(found.state)
        fit = fit.with_effort(self.free, self.stride, self.arrived)
        fits = [fit.fit(frame.image, start, STEPS) for frame in rest]
        at_rest = replace(
            start,
            fits=np.mean([f.state.fits for f in fits], axis=0),
            gains=np.mean([f.state.gains for f in fits], axis=0),
        )
        misfit = np.mean([f.misfit for f in fits], axis=0)
        covariance = np.mean([f.covariance for f in fits], axis=0) / len(rest)
        return fit, PairFits(at_rest, misfit, covariance)

    def update(self, frame: Frame) -> Tracks:
        """Markers in the next frame.

        Raises
        ------
        UserError
            When the frame has another size than the rest frame.
        """
        check_frame(frame, self._shape)
        image = frame.image
        start = replace(self._next, fits=self._next.fits + self._velocity)
        look = self._judge(image, self._first_fit(image, start), start)
        if self._astray(look, 0):
            # The skin may have turned round.
            still = replace(self._next, slopes=np.zeros_like(self._rest.slopes))
            look = _better(look, self._judge(image, self._fit.fit(image, still, STEPS), still))
        look = self._untangled(image, look)
        ambiguous = look.torn
        few = max(_FEW, int(_FEW_SHARE * len(look.visible)))
        steady = not self._astray(look, few)
        if not steady:
            located = self._relocator(image)
            start = self._located(located.position, located.gains)
            again = self._judge(image, self._fit.fit(image, start, STEPS), start)
            if _worth(again) >= _worth(look):
                look = again
                unsure = np.zeros_like(look.visible)
                unsure[:, : self._layers] = located.ambiguous.T
                ambiguous = look.visible & (look.torn | unsure)
        # Lost in the light, not in the motion.
        typical = look.fits.typical
        worse = typical > _WORSE * self._typical
        self._waited += 1
        tried = worse or (typical > _WORSE and self._waited > self._patience)
        if tried:
            self._waited, self._patience = 0, _PATIENCE if worse else 2 * self._patience
            tuned = self._fit.tune(image, look.fits, self._next.fits, STEPS)
            if not self._fit.faded(tuned.state):
                how = tuned.state
                now = replace(start, absorbed=how.absorbed, width=how.width, black=how.black)
                look = self._judge(image, tuned, now)
                ambiguous = look.visible & (look.torn | ambiguous)
                before, typical = typical, look.fits.typical
                if typical < _BETTER * before:
                    self._patience = _PATIENCE
        if tried or not self._typical / _WORSE < typical < _WORSE * self._typical:
            self._typical = max(1.0, min(typical, 1e6))
        self._remember(look, steady)
        self._last_seen = np.where(look.visible.T[: self._layers], frame.time, self._last_seen)
        return self._tracks(frame, look.fits, look.visible, ambiguous)

    @property
    def state(self) -> dict[str, Any]:
        """Everything that changes from frame to frame."""
        return {
            **asdict(self._next),
            "velocity": self._velocity.copy(),
            "last_seen": self._last_seen.copy(),
            "typical": self._typical,
            "seen": self._seen.copy(),
            "whole": self._whole.copy(),
            "waited": self._waited,
            "glances": self._glances,
            "patience": self._patience,
        }

    @state.setter
    def state(self, values: dict[str, Any]) -> None:
        own = dict(values)
        self._velocity = np.array(own.pop("velocity"))
        self._last_seen = np.array(own.pop("last_seen"))
        self._typical = float(own.pop("typical"))
        self._waited, self._patience = int(own.pop("waited")), int(own.pop("patience"))
        self._seen, self._glances = np.array(own.pop("seen")), int(own.pop("glances"))
        self._whole = np.array(own.pop("whole"))
        self._next = PairState(**own)

    def _first_fit(self, image: Image, start: PairState) -> PairFits:
        """Fit of a frame from where its markers are expected."""
        return self._fit.fit(image, start, STEPS)

    def _judge(self, image: Image, found: PairFits, start: PairState) -> Look:
        """What of a fit is visible; of pairs that are not, each layer is tried alone."""
        limit = self._limit(found)
        if (found.misfit > limit).any():
            found = self._fit.fit_apart(image, found, start, limit, STEPS)
        visible = self._visible(found)
        return Look(found, visible, self._torn(found, visible))

    def _untangled(self, image: Image, look: Look) -> Look:
        """Look again at markers that lie on others, from where the other layer has them.

        Two discs that pass over each other can be taken for each other, or both for what they cover
        together. Their other layer moves less, or more, and lies apart.
        """
        if self._share is None:
            return look
        state, visible = look.fits.state, look.visible
        on_others = self._fit.crowded(state.fits, visible)
        if not on_others.any():
            return look
        moved = (state.fits - self._rest.fits)[..., :2]
        clear = visible & ~on_others
        far = clear.all(axis=1) & (abs(moved[:, 0]).max(axis=1) > _MOVED * self._pitch)
        first, second = moved[far, 0], moved[far, 1]
        # What a layer moves in the image is not quite its share: it lies deeper.
        share = (first * second).sum() / (first**2).sum() if far.any() else self._share
        expected = np.stack([moved[:, 1] / share, moved[:, 0] * share], axis=1)
        off = np.linalg.norm(moved - expected, axis=2)
        wrong = on_others & clear[:, ::-1] & (off > _ASIDE * self._fit.radius)
        if not wrong.any():
            return look
        fits = state.fits.copy()
        fits[wrong, :2] = (self._rest.fits[..., :2] + expected)[wrong]
        start = replace(state, fits=fits)
        again = self._judge(image, self._fit.fit(image, start, STEPS), start)
        return _better(look, again)

    def _astray(self, look: Look, few: int) -> bool:
        """Whether markers have been taken for others, or more than a few have been lost at once."""
        newly = self._lost(look.visible) - self._lost(self._seen)
        return bool(look.torn.any()) or newly > few

    def _lost(self, visible: NDArray[np.bool_]) -> int:
        """Markers that were there at rest and are not visible."""
        return int((~visible & self._rest.present).sum())

    def _visible(self, found: PairFits) -> NDArray[np.bool_]:
        """Layers whose fit explains their pixels, shape (M, 2)."""
        explained = found.misfit < self._limit(found)
        return np.asarray(explained[:, None] & found.state.present)

    def _limit(self, found: PairFits) -> float:
        """Largest misfit of a marker that is there."""
        return _LOST * min(max(1.0, found.typical), _WORST)

    def _torn(self, found: PairFits, visible: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Markers that moved otherwise than most of their neighbours, or their other layer."""
        moved = (found.state.fits - self._rest.fits)[..., :2]
        torn = torn_off(moved, visible, self._fit.near, _TORN * self._pitch)
        if self._layers == 2 and self._share is not None:
            off = abs(moved[:, 1] - self._share * moved[:, 0]).max(axis=1) > _TORN * self._pitch
            torn |= (off & visible.all(axis=1))[:, None]
        if not torn.any():
            return np.asarray(torn)
        # Skin that is pressed together strongly is not torn: its markers got there step by step,
        # as they went before or as those around them go now.
        went, seen, near = (found.state.fits - self._next.fits)[..., :2], visible, self._fit.near
        around = np.where(seen[..., None], went, 0.0)[near].sum(axis=1)
        around /= np.maximum(seen[near].sum(axis=1), 1)[..., None]
        off = [abs(went - way).max(axis=2) for way in (self._velocity[..., :2], around)]
        off_course = np.minimum(*off) > _WENT_ON * self._pitch
        return np.asarray(torn & (off_course | ~self._whole))

    def _located(self, position: Array, gains: Array) -> PairState:
        """Start from positions (L, M, 2) that were found without the fit."""
        fits = self._rest.fits.copy()
        known = np.isfinite(position)
        at = np.swapaxes(fits, 0, 1)[: self._layers, :, :2]
        at[known] = position[known]
        return replace(self._next, fits=fits, gains=gains, slopes=np.zeros_like(self._rest.slopes))

    def _remember(self, look: Look, steady: bool) -> None:
        """Start of the next frame; lost markers go with their neighbours."""
        visible, state = look.visible, look.fits.state
        moved = np.where(visible[..., None], state.fits - self._rest.fits, np.nan)
        either: Any = visible.any(axis=1)
        gains = np.where(either[:, None], state.gains, np.nan)
        for m in np.flatnonzero((~visible & self._rest.present).any(axis=1)):
            near = self._fit.near[m]
            for k in np.flatnonzero(~visible[m]):
                with_it = near[visible[near, k]]
                moved[m, k] = np.median(moved[with_it, k], axis=0) if len(with_it) else 0.0
            if np.isnan(gains[m, 0]):
                lit = near[visible[near].any(axis=1)]
                gains[m] = gains[lit].mean(axis=0) if len(lit) else self._next.gains[m]
        fits = self._rest.fits + np.nan_to_num(moved)
        state = replace(state, gains=np.where(np.isnan(gains), 1.0, gains))
        self._go_on(state, fits, visible & steady)
        self._seen, self._whole = visible, visible & ~look.torn

    def _go_on(self, state: PairState, fits: Array, steady: NDArray[np.bool_]) -> None:
        """Start of the next frame, from fits that those that are steady came to from the last."""
        # Neighbours move alike: their mean is a steadier guess than what each has done.
        moved = np.where(steady[..., None], (fits - self._next.fits)[..., :2], 0.0)
        near = self._fit.near
        self._velocity[..., :2] = (moved + moved[near].sum(axis=1)) / (1 + near.shape[1])
        self._next = replace(state, fits=fits, present=self._rest.present)

    def _tracks(
        self,
        frame: Frame,
        found: PairFits,
        visible: NDArray[np.bool_],
        ambiguous: NDArray[np.bool_],
    ) -> Tracks:
        layers, shape = self._layers, found.state.fits.shape
        # What the model does not explain is not certain either.
        excess = np.where(visible.any(axis=1), np.maximum(found.misfit, 1.0), 1.0)
        covariance = found.covariance * excess[:, None, None]
        fits = np.where(visible[..., None], found.state.fits, np.nan)
        log_size, hue = np.full(shape[:2], np.nan), np.full(shape[0], np.nan)
        if self.free == 5:
            light = np.log(found.state.gains / self._rest.gains)
            tie_light(light, visible.any(axis=1), self._fit.near, covariance, fits)
            p, q = fits[..., 3], fits[..., 4]
            log_size = fits[..., 2] + 0.5 * np.log(1.0 - p**2 - q**2)
            hue = self._fit.hues(frame.image, fits)
            # Where markers touch, sizes are only as good as what is known of light between them.
            doubt = _TOUCHING_SIZE**2 * self._fit.touching(fits, visible)
            covariance[:, 2, 2] += doubt
            covariance[:, 5, 5] += doubt
        ambiguous = ambiguous | self._fit.crowded(fits, visible)
        covariance = covariance[:, : 3 * layers, : 3 * layers]
        covariance[np.repeat(~visible[:, :layers], 3, axis=1)] = np.nan
        return Tracks(
            time=frame.time,
            position=np.swapaxes(fits[:, :layers, :2], 0, 1),
            log_size=log_size[:, :layers].T,
            hue=hue,
            visible=visible[:, :layers].T,
            ambiguous=ambiguous[:, :layers].T,
            last_seen=self._last_seen.copy(),
            covariance=covariance,
        )


def _worth(look: Look) -> int:
    """Markers that are found and hold together, less those that do not."""
    return int(look.visible.sum()) - 2 * int(look.torn.sum())


def _better(first: Look, second: Look) -> Look:
    """The look that finds more, or else explains it better."""

    def rank(look: Look) -> tuple[int, float]:
        return _worth(look), -float(look.fits.misfit[look.visible.any(axis=1)].sum())

    return max(first, second, key=rank)


class QuickTracker(MarkerTracker):
    """Fits places alone, to every other row, in a single step while the markers go on as they did.

    Shapes are taken as at rest, and hues are not measured. Where the step does not explain all
    markers that were seen, the frame is fitted as `MarkerTracker` does.
    """

    free, stride, arrived = 2, 2, 0.3

    def update(self, frame: Frame) -> Tracks:
        """Markers in the next frame; see `MarkerTracker.update`."""
        check_frame(frame, self._shape)
        start = replace(self._next, fits=self._next.fits + self._velocity, present=self._seen)
        found = self._fit.glance(frame.image, start)
        gone_on = found.misfit < self._limit(found)
        self._glances += 1
        if (gone_on | ~self._seen.any(axis=1)).all() and not (
            self._glances > _GLANCES and self._lost(self._seen)
        ):
            self._go_on(found.state, found.state.fits, self._seen)
            self._last_seen = np.where(self._seen.T[: self._layers], frame.time, self._last_seen)
            return self._tracks(frame, found, self._seen, np.zeros_like(self._seen))
        self._glances = 0
        return super().update(frame)
