"""Judgement of a fit: which markers are visible, torn off, or confused with another one."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .at_rest import AtRest
from .kernels.survey_kernels import survey
from .memory import Look, Memory
from .pair_state import PairFits, PairState

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]


def judge(known: AtRest, memory: Memory, image: Image, fits: PairFits, start: PairState) -> Look:
    """Judge a fit, after fitting unexplained pairs again with each layer alone.

    Pairs that were lost before are tried in turns, a part in each frame.
    """
    limit = np.where(known.odd, np.inf, known.limits(fits))
    if (fits.misfit > limit).any():
        turn = (np.arange(len(fits.misfit)) - memory.frames) % known.settings.looks.turns == 0
        tried = turn | memory.visible.any(axis=1)
        fits = known.fit.fit_apart(image, fits, start, tried, limit, known.settings.steps)
    return surveyed(known, memory, fits)


def surveyed(known: AtRest, memory: Memory, fits: PairFits) -> Look:
    """Judge a fit: visible, torn and overlapping markers."""
    pairs = fits.state.present.shape
    visible, torn, on_others = (np.empty(pairs, dtype=np.bool_) for _ in range(3))
    touching = np.empty(len(visible), dtype=np.bool_)
    fit, share = known.fit, np.nan if known.share is None else known.share
    survey(
        fits.state.fits, fits.misfit, fits.state.present, known.state.fits, fit.near,
        fit.optics.neighbours, known.limits(fits), known.settings.looks.torn * known.pitch, share,
        fit.crowded_radii, visible, torn, on_others, touching,
    )  # fmt: skip
    for markers in (visible, torn, on_others):
        markers[known.odd] = False
    if torn.any():
        torn &= _off_course(known, memory, fits.state, visible)
    return Look(fits, visible, torn, on_others, touching)


def worth(look: Look) -> int:
    """Number of visible markers that are not torn, minus the number of torn ones."""
    return int(look.visible.sum()) - 2 * int(look.torn.sum())


def better(first: Look, second: Look) -> Look:
    """Choose the look that finds more markers; with equal numbers, the one with less misfit."""

    def rank(look: Look) -> tuple[int, float]:
        return worth(look), -float(look.fits.misfit[look.visible.any(axis=1)].sum())

    return max(first, second, key=rank)


def astray(known: AtRest, memory: Memory, look: Look, few: int) -> bool:
    """Whether a marker is torn off, or more than `few` were lost since the last frame.

    Those that went over the edge of the field do not count.
    """
    newly = known.lost(look.visible) - known.lost(memory.visible)
    if not (newly > few or look.torn.any()):
        return False
    gone = known.edge.hidden(memory.expected().fits[..., :2])
    newly -= known.lost(look.visible | ~gone) - known.lost(memory.visible | ~gone)
    return bool((look.torn & ~gone).any()) or newly > few


def blind(known: AtRest, visible: Mask) -> bool:
    """Whether fewer than half of the markers (M, 2) are visible."""
    return 2 * int(visible.sum()) < int(known.state.present.sum())


def untangled(known: AtRest, memory: Memory, image: Image, look: Look) -> Look:
    """Fit markers that lie on others again, from positions predicted by the pair's other layer.

    Two discs that pass over each other can be confused, or both fitted to what they cover together.
    Their partners in the other layer move less or more, and lie apart.
    """
    if known.share is None:
        return look
    state, visible, on_others = look.fits.state, look.visible, look.on_others
    if not on_others.any():
        return look
    displacement = (state.fits - known.state.fits)[..., :2]
    clear = visible & ~on_others
    least = known.settings.looks.moved * known.pitch
    far = clear.all(axis=1) & (abs(displacement[:, 0]).max(axis=1) > least)
    first, second = displacement[far, 0], displacement[far, 1]
    # The ratio in the image is not quite that of the layers, which lie at different depths.
    share = (first * second).sum() / (first**2).sum() if far.any() else known.share
    if not share:  # a layer that stays at rest does not predict the other one
        return look
    expected = np.stack([displacement[:, 1] / share, displacement[:, 0] * share], axis=1)
    off = np.linalg.norm(displacement - expected, axis=2)
    wrong = on_others & clear[:, ::-1] & (off > known.settings.looks.aside * known.fit.radius)
    if not wrong.any():
        return look
    places = state.fits.copy()
    places[wrong, :2] = (known.state.fits[..., :2] + expected)[wrong]
    start = replace(state, fits=places)
    fits = known.fit.fit(image, start, known.settings.steps)
    return better(look, judge(known, memory, image, fits, start))


def _off_course(known: AtRest, memory: Memory, state: PairState, visible: Mask) -> Mask:
    """Mask (M, 2) of markers whose step follows neither their last step nor their neighbours'.

    Strongly compressed skin is not torn: its markers got there step by step, each as it moved in
    the previous frame, or as its neighbours move in this one.
    """
    near = known.fit.near
    step = (state.fits - memory.start.fits)[..., :2]
    around = np.where(visible[..., None], step, 0.0)[near].sum(axis=1)
    around /= np.maximum(visible[near].sum(axis=1), 1)[..., None]
    off = [abs(step - way).max(axis=2) for way in (memory.velocity[..., :2], around)]
    off_course = np.minimum(*off) > known.settings.looks.went_on * known.pitch
    return np.asarray(off_course | ~memory.intact)
