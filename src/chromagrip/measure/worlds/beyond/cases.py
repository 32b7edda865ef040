"""Deviations of the grasps of `beyond` from the training conditions, one function per kind."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import msgspec
import numpy as np

from ....model import ForceField
from ....render import Defects, Frame, SensorDesign
from ....tracking import SensorCalibration, load_calibration
from ..compressed import Codec
from ..force_scenes import NOISE, Pictures, Specimen
from ..grasps import STIFFNESS_ERROR, WORLDS, calibration, random_grasp
from .carried_skin import CarriedSkin, Motion
from .finished_pictures import each, gradient, lit, of_run, rolled, shifted, tilted
from .unlike_grasps import Draw, with_law

Random = np.random.Generator

#: Range of Γ where the kind of grasp decides on it.
_LOOSE = (0.02, 0.92)
#: Least ΣFn [N].
_LEAST = 0.3
#: σ0 [N/m] and n of the friction laws, and the drags [N·s/m] that differ from the default.
SIGMAS = (300.0, 1000.0, 3000.0, 10000.0)
EXPONENTS = (0.5, 1.0, 1.5, 2.0)
_DRAGS = (30.0, 400.0)
_DRAG = 120.0
#: σ0 of a bristle so stiff that friction is Coulomb's [N/m].
_NO_BRISTLE = 1e5

#: Whether a grasp that ends with a true field and Γ belongs to a kind, for bounds of Γ.
Fits = Callable[[ForceField, float, float, float], bool]


def in_bin(field: ForceField, margin: float, low: float, high: float) -> bool:
    """Whether Γ is in its bin and something is gripped."""
    return low <= margin <= high and field.total_normal >= _LEAST


def loosely(field: ForceField, margin: float, low: float, high: float) -> bool:
    """Whether something is gripped and held, with whatever Γ the kind leads to."""
    return in_bin(field, margin, *_LOOSE)


def slides(field: ForceField, margin: float, low: float, high: float) -> bool:
    """Whether all of the contact slides, or nearly."""
    return margin < 0.05 and field.total_normal >= _LEAST


def twice(field: ForceField, margin: float, low: float, high: float) -> bool:
    """Whether contact is in two places."""
    begins = np.diff(field.contact.astype(int), prepend=0) > 0
    return int(begins.sum()) == 2 and loosely(field, margin, low, high)


@dataclass(frozen=True, kw_only=True)
class Case:
    """Deviations of one grasp.

    Attributes
    ----------
    specimen: that grasps
    known: calibration that estimators are given
    draw: draws object, grip and load
    fits: whether the run belongs to the kind
    noise: that the tracker is told [grey levels]
    pictures: what becomes of the frames
    film: whether `pictures` needs every frame of the run
    labels: parts of the group that it belongs to
    """

    specimen: Specimen
    known: SensorCalibration
    draw: Draw = random_grasp
    fits: Fits = in_bin
    noise: float = NOISE
    pictures: Pictures | None = None
    film: bool = False
    labels: tuple[str, ...] = ()


#: Draws the case of a grasp from random numbers and its index.
Group = Callable[[Random, int], Case]


@lru_cache(maxsize=1)
def _as_told() -> Case:
    """A specimen that is as its shipped calibration says, of a stiffness that is known."""
    known = replace(load_calibration("thesis"), stiffness_deviation=0.0)
    specimen = Specimen(
        fingertip=known.fingertip, sensor=known.sensor, defects=Defects(), renderer="painter"
    )
    return Case(specimen=specimen, known=known)


def _sign(rng: Random) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _about(rng: Random, share: float) -> float:
    """A factor up to a share from 1, seldom near it."""
    return 1.0 + _sign(rng) * share * rng.uniform(0.3, 1.0)


def _log_uniform(rng: Random, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _class(value: float, edges: tuple[float, ...], unit: str) -> str:
    """Label of the class of a value."""
    at = int(np.searchsorted(edges, value))
    return f"{edges[at - 1]:g}-{edges[at]:g}{unit}"


# ---- where the camera sits ----


def _pictured(pictures: Pictures, *labels: str) -> Case:
    return replace(_as_told(), pictures=pictures, labels=labels)


def _moving(motion: Motion, *labels: str) -> Case:
    case = _as_told()
    skin = CarriedSkin(case.specimen.sensor, case.specimen.fingertip.nodes, motion)
    return replace(case, specimen=replace(case.specimen, membrane_map=skin), labels=labels)


def roll(rng: Random, index: int) -> Case:
    """Roll by 0.3° to 15°: of finished pictures, and of the camera before it takes them."""
    degrees = _log_uniform(rng, 0.3, 15.0)
    angle, label = np.deg2rad(degrees) * _sign(rng), _class(degrees, (0.3, 1.0, 4.0, 15.0), "deg")
    if index % 3 == 2:
        return _moving(Motion(roll=angle), label, "before-the-lens")
    return _pictured(each(rolled(angle, smooth=index % 3 == 1)), label, "finished")


def camera(rng: Random, index: int) -> Case:
    """Pictures shifted by 1 to 20 px and scaled by .95 to 1.05: one, the other, or both."""
    kind = ("shift", "scale", "both")[index % 3]
    direction, length = rng.uniform(0.0, 2.0 * np.pi), _log_uniform(rng, 1.0, 20.0)
    scale = 1.0 if kind == "shift" else _about(rng, 0.05)
    if kind == "scale":
        length = 0.0
    return _pictured(
        each(shifted((length * np.cos(direction), length * np.sin(direction)), scale)), kind
    )


def tilt(rng: Random, index: int) -> Case:
    """Camera tilted by 1° to 4°."""
    degrees = rng.uniform(1.0, 4.0)
    lens = _as_told().specimen.sensor.view.camera
    change = tilted(lens, np.deg2rad(degrees), rng.uniform(0.0, 2.0 * np.pi))
    return _pictured(each(change), _class(degrees, (1.0, 2.0, 4.0), "deg"))


# ---- how the skin moves ----


def azimuth(rng: Random, index: int) -> Case:
    """Load turned about the grip's axis by 3° to 180°."""
    edges = (3.0, 15.0, 45.0, 180.0)
    low, high = edges[index % 3], edges[index % 3 + 1]
    degrees = rng.uniform(low, high) * _sign(rng)
    return _moving(Motion(azimuth=np.deg2rad(degrees)), f"{low:g}-{high:g}deg")


def out_of_plane(rng: Random, index: int) -> Case:
    """Shear, radial motion and contraction off the chain's plane, each alone and all together."""
    kind = ("shear", "radial", "contraction", "mixed")[index % 4]
    every = Motion(
        shear=rng.uniform(0.85, 1.1),
        radial=0.05 * _sign(rng) * rng.uniform(0.3, 1.0),
        contraction=rng.uniform(0.05, 0.3),
    )
    motion = every if kind == "mixed" else replace(Motion(), **{kind: getattr(every, kind)})
    return _moving(motion, kind)


def twist(rng: Random, index: int) -> Case:
    """Contact turned about the grip's axis by 2° to 10°."""
    degrees = rng.uniform(2.0, 10.0)
    label = _class(degrees, (2.0, 5.0, 10.0), "deg")
    return _moving(Motion(twist=np.deg2rad(degrees) * _sign(rng)), label)


# ---- the specimen ----


def _with_sensor(sensor: SensorDesign, *labels: str) -> Case:
    case = _as_told()
    return replace(case, specimen=replace(case.specimen, sensor=sensor), labels=labels)


def layers(rng: Random, index: int) -> Case:
    """Yellow that follows by ±10 % more or less, and depths that are off by ±15 %."""
    kind = ("follow", "depth", "both")[index % 3]
    sensor = _as_told().specimen.sensor
    follow = _about(rng, 0.10) if kind != "depth" else 1.0
    outer, inner = (_about(rng, 0.15) if kind != "follow" else 1.0 for _ in range(2))
    change = msgspec.structs.replace
    magenta = change(sensor.magenta, depth_mm=outer * sensor.magenta.depth_mm)
    yellow = change(
        sensor.inner,
        depth_mm=inner * sensor.inner.depth_mm,
        follow=follow * sensor.inner.follow,
    )
    return _with_sensor(change(sensor, magenta=magenta, yellow=yellow), kind)


def _fingertip(labels: tuple[str, ...], known: SensorCalibration, **factors: float) -> Case:
    """A specimen with scaled stiffnesses, and the calibration that the estimator receives."""
    case = _as_told()
    tip = case.specimen.fingertip
    made = replace(tip, **{key: value * getattr(tip, key) for key, value in factors.items()})
    return replace(
        case, specimen=replace(case.specimen, fingertip=made), known=known, labels=labels
    )


def poisson(rng: Random, index: int) -> Case:
    """Tissue's Poisson factor off by ±20 %, or the membrane's stiffness alone by ±15 %."""
    known = _as_told().known
    if index % 2:
        return _fingertip(("membrane",), known, membrane_stiffness=_about(rng, 0.15))
    return _fingertip(("tissue",), known, poisson_tissue=_about(rng, 0.20))


def stiffness(told: bool) -> Group:
    """Both stiffnesses off by up to a tenth each, as in `mismatched`; or both by a tenth.

    Where the spread is not told, that of the sensor's design is taken for it.
    """

    def group(rng: Random, index: int) -> Case:
        tissue, membrane = 1.0 + STIFFNESS_ERROR * rng.uniform(-1.0, 1.0, 2)
        known, label = load_calibration("thesis"), "up-to-a-tenth"
        if told:
            known = replace(
                known, stiffness_deviation=calibration("mismatched").stiffness_deviation
            )
        elif index % 2:
            tissue = membrane = 1.0 + STIFFNESS_ERROR * _sign(rng)
            label = "a-tenth"
        return _fingertip((label,), known, tissue_stiffness=tissue, membrane_stiffness=membrane)

    return group


# ---- object, grip and load ----


def drawing(draw: Draw, fits: Fits = loosely, label: str = "") -> Group:
    """Another object, or another grip and load over time."""
    labels = (label,) if label else ()
    return lambda rng, index: replace(_as_told(), draw=draw, fits=fits, labels=labels)


def in_turn(*groups: Group) -> Group:
    """Groups that take turns."""
    return lambda rng, index: groups[index % len(groups)](rng, index // len(groups))


def friction_law(rng: Random, index: int) -> Case:
    """Every σ0 with every n, no bristle at all, and other drags."""
    kinds = len(SIGMAS) * len(EXPONENTS)
    at = index % (kinds + 8)
    sigma, exponent = SIGMAS[at // 4 % 4], EXPONENTS[at % 4]
    drag = _DRAG
    labels: tuple[str, ...] = (f"sigma0-{sigma:.0f}", f"n-{exponent:g}")
    if at >= kinds + 4:
        drag = _DRAGS[at % 2]
        labels = (f"drag-{drag:g}",)
        sigma, exponent = 5000.0, 0.7
    elif at >= kinds:
        sigma, labels = _NO_BRISTLE, ("no-bristle",)
    draw = with_law(sigma, exponent, drag)
    return replace(_as_told(), draw=draw, fits=loosely, labels=labels)


def mismatched(group: Group) -> Group:
    """A group with the sensors of the world `mismatched`, and what is told of them."""

    def drawn(rng: Random, index: int) -> Case:
        specimen = WORLDS["mismatched"](rng)
        return replace(group(rng, index), specimen=specimen, known=calibration("mismatched"))

    return drawn


# ---- light and camera ----


def blurred(rng: Random, index: int) -> Case:
    """A lens whose blur is off by ±30 %."""
    sensor = _as_told().specimen.sensor
    change = msgspec.structs.replace
    settings = change(sensor.camera, blur_px=_about(rng, 0.30) * sensor.camera.blur_px)
    return _with_sensor(change(sensor, camera=settings), "blur")


def uneven(rng: Random, index: int) -> Case:
    """Light that falls by 20 % across the picture."""
    size = _as_told().specimen.sensor.camera
    light = gradient(size.width_px, size.height_px, 0.2, rng.uniform(0.0, 2.0 * np.pi))
    return _pictured(each(lit(light)), "gradient")


def dim(rng: Random, index: int) -> Case:
    """Light that is 10 to 20 % dimmer than the design's."""
    return _pictured(each(lit(1.0 - rng.uniform(0.1, 0.2))), "dim")


def dim_later(rng: Random, index: int) -> Case:
    """Light that is 10 to 20 % dimmer than at rest."""
    return _pictured(of_run(lit(1.0 - rng.uniform(0.1, 0.2))), "dim-after-rest")


def wrong_noise(rng: Random, index: int) -> Case:
    """A tracker that is told half, or half as much again, of the noise."""
    return replace(_as_told(), noise=(0.5, 1.5)[index % 2] * NOISE, labels=("noise",))


def dusty(rng: Random, index: int) -> Case:
    """Ten to forty specks of dust."""
    case = _as_told()
    dust = Defects(dust=int(rng.integers(10, 41)))
    return replace(case, specimen=replace(case.specimen, defects=dust), labels=("dust",))


def redrawn(rng: Random, index: int) -> Case:
    """Another renderer, and a chain of twice the nodes."""
    case = _as_told()
    tip = replace(case.specimen.fingertip, nodes=501)
    return replace(
        case,
        specimen=replace(case.specimen, fingertip=tip, renderer="pyrender"),
        labels=("renderer",),
    )


def compressed(codecs: Mapping[str, Codec]) -> Group:
    """Frames through codecs in turn, those at rest in the same film or as they were taken."""

    def group(rng: Random, index: int) -> Case:
        label, codec = list(codecs.items())[index % len(codecs)]
        if index // len(codecs) % 2:
            return replace(
                _pictured(lambda rest, run: (rest, codec(run)), label, "rest-png"), film=True
            )
        return replace(_pictured(_filmed(codec), label, "rest-filmed"), film=True)

    return group


def _filmed(codec: Codec) -> Pictures:
    """One film that begins with the frames at rest."""

    def pictures(rest: list[Frame], run: list[Frame]) -> tuple[list[Frame], list[Frame]]:
        film = codec([*rest, *run])
        return film[: len(rest)], film[len(rest) :]

    return pictures
