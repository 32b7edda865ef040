"""Grasps with true forces and the tracks of their images, on which force estimates are scored.

A grasp is an object with grip and load over time. Forces are estimated at its scored instants:
from the last ten frames before such an instant (0.1 s at 100 Hz), or from the last frame alone.
Grip and load have been held for half a second by then, except in the set `controlled`, where the
controller goes on.

In the world `matched` the sensor is as its calibration says. In the world `mismatched` its
stiffnesses, its camera and its layers differ, its chain has twice the nodes, and another renderer
draws it. Shape, k_c and µ of the object are unknown to every estimator in both worlds. A third
world is in `worlds.beyond`.
"""

import dataclasses
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from msgspec.structs import replace

from ...loop.grasp import grasp
from ...model import ContactObject, Drive, Fingertip, History, contact_forces
from ...render import Defects
from ...scene.scene import load_scene
from ...sensing.sensor import open_camera
from ...thesis import DESIRED_MARGIN, LOADS_N, OBJECTS
from ...tracking import SensorCalibration, load_calibration
from .force_scenes import ForceScene, Grasp, Specimen, run_of, watch

#: Time in which forces settle after grip and load: the object's drag lets friction lag behind [s].
_SETTLED = 0.5
#: Range of µ in the library.
FRICTIONS = (0.2, 0.9)
#: Range of the objects' curvatures [1/m].
CURVATURES = (0.0, 230.0)
#: Range of the contact stiffness k_c [N/m].
STIFFNESSES = (80.0, 1000.0)
#: Range of ΣFn [N].
NORMALS = (0.4, 6.0)
#: Range of Γ.
MARGINS = (0.05, 0.85)
#: Number of bins of that range; grasps are spread evenly over them.
_BINS = 8
#: Amount by which round objects raise Γ over 1 − load/(µ·grip), at most.
_ROUNDER = 0.1
#: Rounds in which the grip for it is found.
_ROUNDS = 5
#: Largest relative error of the stiffnesses that a mismatched sensor's calibration states.
STIFFNESS_ERROR = 0.10
#: Largest relative error of its focal length.
_FOCAL_ERROR = 0.003
#: Largest error of its image centre, along x and y [px].
_CENTRE_ERROR = 0.5
#: Defects of a mismatched sensor: a fifth of a marker between the layers, and the precision of cut
#: stencils.
_DEFECTS = Defects(misalignment_mm=0.1, misplacement_mm=0.02)
#: Seed of the random numbers; no training may use it.
SEED = 606


@dataclass(frozen=True, kw_only=True)
class Ranges:
    """Ranges that random grasps are drawn from, by default those of the library.

    Attributes
    ----------
    frictions: of µ
    curvatures: of the objects [1/m]
    flat: share of flat objects
    stiffnesses: of k_c [N/m], evenly in the logarithm
    normals: of the grip [N]
    """

    frictions: tuple[float, float] = FRICTIONS
    curvatures: tuple[float, float] = CURVATURES
    flat: float = 1.0 / 7.0
    stiffnesses: tuple[float, float] = STIFFNESSES
    normals: tuple[float, float] = NORMALS


#: Ranges of the library.
LIBRARY_RANGES = Ranges()


@lru_cache(maxsize=2)
def calibration(world: str = "matched") -> SensorCalibration:
    """Calibration that every estimator is given: in both worlds the same but for its uncertainty.

    An error that is uniform up to a tenth to either side has a standard deviation of 0.058.
    """
    deviation = {"matched": 0.0, "mismatched": STIFFNESS_ERROR / np.sqrt(3.0)}[world]
    return dataclasses.replace(load_calibration("thesis"), stiffness_deviation=deviation)


def _matched(_rng: np.random.Generator) -> Specimen:
    known = calibration()
    return Specimen(
        fingertip=known.fingertip, sensor=known.sensor, defects=Defects(), renderer="painter"
    )


def _mismatched(rng: np.random.Generator) -> Specimen:
    known = calibration()
    tissue, membrane = 1.0 + STIFFNESS_ERROR * rng.uniform(-1.0, 1.0, 2)
    camera = known.sensor.camera
    focal = 1.0 + _FOCAL_ERROR * rng.uniform(-1.0, 1.0)
    x, y = _CENTRE_ERROR * rng.uniform(-1.0, 1.0, 2)
    true = replace(
        camera,
        focal_px=tuple(focal * length for length in camera.focal_px or ()),
        centre_px=((camera.width_px - 1) / 2 + x, (camera.height_px - 1) / 2 + y),
    )
    return Specimen(
        fingertip=Fingertip(
            nodes=501,
            tissue_stiffness=tissue * known.fingertip.tissue_stiffness,
            membrane_stiffness=membrane * known.fingertip.membrane_stiffness,
        ),
        sensor=replace(known.sensor, camera=true),
        defects=_DEFECTS,
        renderer="pyrender",
    )


def random_grasp(
    rng: np.random.Generator, low: float, high: float, ranges: Ranges = LIBRARY_RANGES
) -> Grasp:
    """A second of random grip and load to a margin from low to high, at which both are held.

    The margin here is 1 − load/(µ·grip); on round objects Γ is somewhat larger.
    """
    mu, curvature = rng.uniform(*ranges.frictions), rng.uniform(*ranges.curvatures)
    if rng.random() < ranges.flat:
        curvature = 0.0
    stiffness = float(np.exp(rng.uniform(*np.log(ranges.stiffnesses))))
    inner = np.sort(rng.uniform(0.05, 0.95, rng.integers(1, 7)))
    points = np.concatenate([[0.0, 0.03], inner, [1.0, 1.0 + _SETTLED]])
    # Linear in the logarithm of the grip and in Γ; at some points either keeps its value.
    grip = np.log(rng.uniform(*ranges.normals, len(points)))
    margin = rng.uniform(0.0, 1.0, len(points))
    margin[:2] = 1.0
    for values, share in ((grip, 0.4), (margin, 0.3)):
        for k in range(2, len(points) - 2):
            if rng.random() < share:
                values[k] = values[k - 1]
    margin[-2] = rng.uniform(low, high)
    grip[-1], margin[-1] = grip[-2], margin[-2]
    sign = np.full(len(points), rng.choice([-1.0, 1.0]))
    if rng.random() < 0.25:  # the load acted the other way before
        sign[: rng.integers(2, len(points) - 1)] *= -1.0
    times = np.linspace(0.0, points[-1], 751)
    normal = np.exp(np.interp(times, points, grip))
    lateral = mu * normal * np.interp(times, points, sign * (1.0 - margin))
    touching = np.clip(times / 0.03, 0.0, 1.0)
    return Grasp(
        obj=ContactObject(stiffness=stiffness, friction=mu, curvature=curvature),
        drive=Drive(
            times=times, normal=np.maximum(touching * normal, 0.02), lateral=touching * lateral
        ),
        ends=(1.0 + _SETTLED,),
    )


def object_changes(index: int) -> dict[str, float]:
    """One of the 27 objects of the thesis, as changes of a scene."""
    keys = ("object.friction", "object.stiffness_kpa", "object.radius_mm")
    return dict(zip(keys, OBJECTS[index], strict=True))


def contact_object(index: int) -> ContactObject:
    """One of the 27 objects of the thesis."""
    return load_scene("camera-100hz", object_changes(index)).build_object()


def _static(index: int) -> Grasp:
    """Gripped so that Γ = 0.3 after the larger load has settled."""
    obj, known = contact_object(index), calibration().fingertip
    times = np.array([0.0, 0.05, 0.2, 0.5, 0.5 + 2 * _SETTLED])
    load = LOADS_N[1]
    grip = load / (obj.friction * (1.0 - DESIRED_MARGIN))
    for _ in range(_ROUNDS):
        grasped = Grasp(
            obj=obj,
            drive=Drive(
                times=times,
                normal=np.array([0.02, grip, grip, grip, grip]),
                lateral=np.array([0.0, 0.0, 0.0, load, load]),
            ),
            ends=(float(times[-1]),),
        )
        run = run_of(known, grasped)
        field = contact_forces(known, obj, run.state(len(run) - 1))
        # On round objects ΣFn differs from the grip and ΣFf from the load.
        grip *= (1.0 - field.safety_margin(obj.friction)) / (1.0 - DESIRED_MARGIN)
    return grasped


def _conservative(index: int) -> Grasp:
    """A grip of 5 N under the loads of the thesis's experiment."""
    small, large = LOADS_N
    return Grasp(
        obj=contact_object(index),
        drive=Drive(
            times=np.array([0.0, 0.05, 0.1, 0.1, 0.7, 0.7]),
            normal=np.array([0.02, 5.0, 5.0, 5.0, 5.0, 5.0]),
            lateral=np.array([0.0, 0.0, 0.0, small, small, large]),
        ),
        ends=(0.6, 1.3),
    )


def _controlled(index: int) -> Grasp:
    """Grip and load of a run of Safety Margin Control with the object's true forces."""
    scene = load_scene("camera-100hz", {"path": "truth", **object_changes(index)})
    with closing(open_camera(scene)) as camera:
        steps = [(s.index * scene.period, s.grip, s.load) for s in grasp(scene, camera)]
    times, grip, load = np.repeat(np.array(steps).T, 2, axis=1)
    return Grasp(
        obj=scene.build_object(),
        drive=Drive(times=times[1:], normal=grip[:-1], lateral=load[:-1]),
        ends=(0.5, 1.2, 1.9),
    )


#: Sensors of each world.
WORLDS: dict[str, Callable[[np.random.Generator], Specimen]] = {
    "matched": _matched,
    "mismatched": _mismatched,
}
#: Sets of known grasps beside the library, 27 each.
KNOWN: dict[str, Callable[[int], Grasp]] = {
    "objects": _static,
    "conservative": _conservative,
    "controlled": _controlled,
}
LIBRARY = "library"


def scenes(world: str, kind: str, index: int, whole: bool = False) -> list[ForceScene]:
    """Scenes of a grasp; the same arguments give the same bytes.

    Parameters
    ----------
    world: of WORLDS
    kind: `library`, of grasps drawn at random, or of KNOWN
    index: of the grasp
    whole: whether they have the tracks of all frames
    """
    rng = np.random.default_rng(seed_of(world, kind, index))
    specimen = WORLDS[world](rng)
    if kind == LIBRARY:
        # Γ is evenly spread over bins that take turns.
        width = (MARGINS[1] - MARGINS[0]) / _BINS
        low = MARGINS[0] + index % _BINS * width
        grasped, run = _drawn(rng, specimen.fingertip, low, low + width)
    else:
        grasped = KNOWN[kind](index)
        run = run_of(specimen.fingertip, grasped)
    seed = int(rng.integers(2**32))
    return watch(calibration(world), specimen, grasped, run, seed, whole=whole)


def _drawn(
    rng: np.random.Generator, fingertip: Fingertip, low: float, high: float
) -> tuple[Grasp, History]:
    """Random grasp that ends with Γ from low to high and ΣFn in range."""
    while True:
        grasped = random_grasp(rng, max(low - _ROUNDER, 0.0), high)
        run = run_of(fingertip, grasped)
        field = contact_forces(fingertip, grasped.obj, run.state(len(run) - 1))
        held = NORMALS[0] <= field.total_normal <= NORMALS[1]
        if held and low <= field.safety_margin(grasped.obj.friction) <= high:
            return grasped, run


def seed_of(world: str, kind: str, index: int) -> list[int]:
    """Seed of a grasp; it ends with 1 because trailing zeros do not change a seed."""
    return [SEED, list(WORLDS).index(world), [LIBRARY, *KNOWN].index(kind), index, 1]
