"""The world `beyond`: grasps outside what a read-out was trained on, one group for each kind.

The grasps of a group are those of the library wherever the kind leaves them: grasp 5 of the group
`roll` is grasp 5 of `azimuth` in another picture. What differs is put into specimen, pictures,
object or drive, never into what an estimator is told; the truth is the chain's field. Estimators
have the shipped calibration of the sensor, but in `stiffness-told`, where it states how far the
stiffnesses may be off. Parts of a group have labels, which are scored on their own too.
"""

from collections.abc import Mapping

import numpy as np

from ....errors import UserError
from ....model import History, ModelError, contact_forces, whole_friction
from ..compressed import h264, h265, jpeg, mjpeg
from ..force_scenes import PERIOD, ForceScene, Grasp, run_of, watch
from ..grasps import MARGINS, SEED, Ranges
from .cases import (
    Case,
    Group,
    azimuth,
    blurred,
    camera,
    compressed,
    dim,
    dim_later,
    drawing,
    dusty,
    friction_law,
    in_turn,
    layers,
    mismatched,
    out_of_plane,
    poisson,
    redrawn,
    roll,
    slides,
    stiffness,
    tilt,
    twice,
    twist,
    uneven,
    wrong_noise,
)
from .unlike_grasps import (
    bump,
    drawn_from,
    grip_step,
    load_step,
    patched,
    sliding,
    tilted_plane,
    trembling,
    two_bumps,
)

BEYOND = "beyond"
#: Numbers in seeds, beside those of the other worlds: of what is unlike, and of the grasps.
_UNLIKE, _GRASPS = 2, 3
#: Bins of Γ that the grasps of a group take turns in.
_BINS = 8
#: Draws of a grasp until one must have been in range.
_DRAWS = 400
#: Group of each kind.
GROUPS: Mapping[str, Group] = {
    "roll": roll,
    "camera": camera,
    "tilt": tilt,
    "azimuth": azimuth,
    "out-of-plane": out_of_plane,
    "twist": twist,
    "layers": layers,
    "poisson": poisson,
    "stiffness-told": stiffness(told=True),
    "stiffness-untold": stiffness(told=False),
    "friction-law": friction_law,
    "friction-law-mismatched": mismatched(friction_law),
    "friction": in_turn(
        drawing(drawn_from(Ranges(frictions=(0.1, 0.2))), label="mu-0.1-0.2"),
        drawing(drawn_from(Ranges(frictions=(1.0, 1.5))), label="mu-1-1.5"),
    ),
    "soft": drawing(drawn_from(Ranges(stiffnesses=(1.0, 40.0)))),
    "stiff": drawing(drawn_from(Ranges(stiffnesses=(1000.0, 2000.0)))),
    "grips": drawing(drawn_from(Ranges(normals=(7.0, 14.0)))),
    "hollow": drawing(drawn_from(Ranges(curvatures=(-90.0, -20.0), flat=0.0))),
    "round": drawing(drawn_from(Ranges(curvatures=(250.0, 333.0), flat=0.0))),
    "tilted-plane": drawing(tilted_plane),
    "bumps": drawing(bump),
    "two-contacts": drawing(two_bumps, twice),
    "patches": drawing(patched),
    "sliding": drawing(sliding, slides),
    "trembling": drawing(trembling),
    "grip-step": drawing(grip_step),
    "load-step": drawing(load_step),
    "optics": in_turn(blurred, uneven, dim, dim_later, wrong_noise, dusty),
    "renderer": redrawn,
    "h264": compressed({f"crf-{crf}": h264(crf) for crf in (4, 12, 18, 23, 28, 35)}),
    "h265": compressed({f"crf-{crf}": h265(crf) for crf in (12, 23, 28)}),
    "mjpeg": compressed({f"q-{quantiser}": mjpeg(quantiser) for quantiser in (2, 4, 8)}),
    "jpeg": compressed({f"quality-{quality}": jpeg(quality) for quality in (95, 90, 80, 60)}),
}
#: Groups whose pictures need OpenGL.
NEED_GL = ("renderer", "friction-law-mismatched")


def beyond_scenes(group: str, index: int, whole: bool = False) -> list[ForceScene]:
    """Scenes of a grasp of a group of GROUPS; the same arguments give the same bytes.

    With `whole` they have the tracks of all frames.
    """
    case, grasped, run, seed = beyond_grasp(group, index)
    return watch(
        case.known,
        case.specimen,
        grasped,
        run,
        seed,
        noise=case.noise,
        pictures=case.pictures,
        film=case.film,
        labels=case.labels,
        may_refuse=True,
        whole=whole,
    )


def beyond_grasp(group: str, index: int) -> tuple[Case, Grasp, History, int]:
    """A grasp of a group before any picture is taken: what is unlike, its run, a camera's seed."""
    rng = np.random.default_rng([SEED, _UNLIKE, list(GROUPS).index(group), index, 1])
    case = GROUPS[group](rng, index)
    # Γ is evenly spread over bins that take turns, in another order each turn.
    width = (MARGINS[1] - MARGINS[0]) / _BINS
    low = MARGINS[0] + width * ((5 * index + index // _BINS) % _BINS)
    grasps = np.random.default_rng([SEED, _GRASPS, 0, index, 1])
    for _ in range(_DRAWS):
        grasped = case.draw(grasps, low, low + width)
        try:
            run = run_of(case.specimen.fingertip, grasped)
        except ModelError:  # lost, pierced, or no equilibrium: no such grasp
            continue
        if _belongs(case, grasped, run, low, low + width):
            return case, grasped, run, int(rng.integers(2**32))
    raise UserError(f"no grasp of the group {group} in {_DRAWS} draws")


def _belongs(case: Case, grasped: Grasp, run: History, low: float, high: float) -> bool:
    """Whether a run ends as its kind asks."""
    state, tip = run.state(round(grasped.ends[-1] / PERIOD)), case.specimen.fingertip
    field = contact_forces(tip, grasped.obj, state)
    margin = field.safety_margin(whole_friction(tip, grasped.obj, state, field))
    return case.fits(field, margin, low, high)
