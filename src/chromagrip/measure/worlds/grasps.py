"""Grasps with truth, as their images are tracked: what force and friction estimates are scored on.

A grasp is an object with grip and load over time; what is asked is the forces at its scored
instants. "0.1 s at 100 Hz" are the last ten frames up to such an instant, a single frame is the
last alone. Grip and load have been held for half a second by then, but in the set `controlled`,
where a controller goes on.

In the world `matched` the sensor is what its calibration says. In `mismatched` it is not: its
stiffnesses, its camera and its layers are off, its chain has twice the nodes, and another renderer
draws it. Shape, k_c and µ of the object are unknown to every estimator in both.
"""

import dataclasses
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import cv2
import numpy as np
from msgspec.structs import replace
from threadpoolctl import threadpool_limits

from ...loop.camera import SimulatedCamera
from ...loop.grasp import grasp, open_camera
from ...model import (
    ContactObject,
    Drive,
    Fingertip,
    ForceField,
    History,
    State,
    contact_forces,
    rest_state,
    simulate,
)
from ...render import Defects, SensorDesign, open_renderer
from ...scene.scene import load_scene
from ...tracking import MarkerTracker, Palette, SensorCalibration, Tracks
from ...tracking.forces.calibration import load_calibration

#: Time between frames [s], frames that are scored together, and frames at rest.
PERIOD, HELD_FRAMES, REST_FRAMES = 0.01, 10, 16
#: Noise of the camera [grey levels].
NOISE = 2.0
_STEP = 2e-3  # of the node model [s]
#: Until forces have settled after grip and load: the object's drag lets friction lag behind [s].
_SETTLED = 0.5
#: Before the scored frames the tracker is shown those after which the skin has moved by this [m].
_SHOWN = 0.15e-3
#: Ranges of the library: µ, curvature [1/m], k_c [N/m], ΣFn [N] and Γ.
FRICTIONS, CURVATURES, STIFFNESSES = (0.2, 0.9), (0.0, 230.0), (80.0, 1000.0)
NORMALS, MARGINS = (0.4, 6.0), (0.05, 0.85)
#: Parts of that range of Γ, and by how much round objects raise it over 1 − load/(µ·grip).
_BINS, _ROUNDER = 8, 0.1
#: Friction, stiffness [kPa] and radius [mm] of the 27 objects.
OBJECTS = list(product((0.3, 0.5, 0.7), (200.0, 32.0, 16.0), (np.inf, 20.0, 5.0)))
_LOADS = (0.25, 0.65)  # of the thesis's experiment [N]
#: Γ at which the objects are held, and the rounds in which the grip for it is found.
_HELD_MARGIN, _ROUNDS = 0.3, 5
#: Largest errors of a mismatched sensor's calibration: stiffnesses, focal length, its middle [px].
_STIFFNESS_ERROR, _FOCAL_ERROR, _CENTRE_ERROR = 0.10, 0.003, 0.5
#: A fifth of a marker, and as exactly as stencils are cut.
_DEFECTS = Defects(misalignment_mm=0.1, misplacement_mm=0.02)
#: Of the random numbers; no training may use it.
SEED = 606


@dataclass(frozen=True, kw_only=True)
class Specimen:
    """A sensor as it is, whatever the estimators are told.

    Attributes
    ----------
    fingertip, sensor, defects: as made
    renderer: that draws its images
    """

    fingertip: Fingertip
    sensor: SensorDesign
    defects: Defects
    renderer: str

    def camera(self, seed: int) -> SimulatedCamera:
        """That looks at it; close it after use."""
        return SimulatedCamera(
            self.sensor,
            open_renderer(self.renderer, self.sensor),
            self.fingertip.nodes,
            NOISE,
            seed,
            self.defects,
        )


@dataclass(frozen=True, kw_only=True)
class Grasp:
    """An object, grip and load over time [N], and the instants that are scored [s]."""

    obj: ContactObject
    drive: Drive
    ends: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class ForceScene:
    """What the tracker said up to a scored instant, and what is true then.

    Attributes
    ----------
    known: what is told of the specimen
    rest: its tracks, unloaded
    tracks: of the last HELD_FRAMES frames
    specimen, obj: that were in contact
    state: of the node model
    field: its contact forces
    """

    known: SensorCalibration
    rest: Tracks
    tracks: list[Tracks]
    specimen: Specimen
    obj: ContactObject
    state: State
    field: ForceField

    @property
    def margin(self) -> float:
        """True Γ."""
        return self.field.safety_margin(self.obj.friction)


@lru_cache(maxsize=2)
def calibration(world: str = "matched") -> SensorCalibration:
    """What every estimator is told of the sensor: the same in both worlds, but for how sure it is.

    Off by up to a tenth, and by anything up to that, is a standard deviation of 0.058.
    """
    sure = {"matched": 0.0, "mismatched": _STIFFNESS_ERROR / np.sqrt(3.0)}[world]
    return dataclasses.replace(load_calibration("thesis"), stiffness_deviation=sure)


def _matched(_rng: np.random.Generator) -> Specimen:
    known = calibration()
    return Specimen(
        fingertip=known.fingertip, sensor=known.sensor, defects=Defects(), renderer="painter"
    )


def _mismatched(rng: np.random.Generator) -> Specimen:
    known = calibration()
    tissue, membrane = 1.0 + _STIFFNESS_ERROR * rng.uniform(-1.0, 1.0, 2)
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


def random_grasp(rng: np.random.Generator, low: float, high: float) -> Grasp:
    """A second of grip and load that wander, to a margin from low to high; then both are held.

    Margins here are those of the load over the grip; on round objects Γ is somewhat larger.
    """
    mu, curvature = rng.uniform(*FRICTIONS), rng.uniform(*CURVATURES)
    if rng.random() < 1.0 / 7.0:
        curvature = 0.0
    stiffness = float(np.exp(rng.uniform(*np.log(STIFFNESSES))))
    inner = np.sort(rng.uniform(0.05, 0.95, rng.integers(1, 7)))
    points = np.concatenate([[0.0, 0.03], inner, [1.0, 1.0 + _SETTLED]])
    # Straight in the logarithm of the grip and in Γ; now and then either stays as it is.
    grip = np.log(rng.uniform(*NORMALS, len(points)))
    margin = rng.uniform(0.0, 1.0, len(points))
    margin[:2] = 1.0
    for values, share in ((grip, 0.4), (margin, 0.3)):
        for k in range(2, len(points) - 2):
            if rng.random() < share:
                values[k] = values[k - 1]
    margin[-2] = rng.uniform(low, high)
    grip[-1], margin[-1] = grip[-2], margin[-2]
    sign = np.full(len(points), rng.choice([-1.0, 1.0]))
    if rng.random() < 0.25:  # pulled the other way before
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
    """One of the 27 objects, as changes of a scene."""
    keys = ("object.friction", "object.stiffness_kpa", "object.radius_mm")
    return dict(zip(keys, OBJECTS[index], strict=True))


def _object(index: int) -> ContactObject:
    return load_scene("camera-100hz", object_changes(index)).build_object()


def _static(index: int) -> Grasp:
    """Gripped so that Γ = 0.3 once the larger load has come, and has settled."""
    obj, known = _object(index), calibration().fingertip
    times = np.array([0.0, 0.05, 0.2, 0.5, 0.5 + 2 * _SETTLED])
    grip = _LOADS[1] / (obj.friction * (1.0 - _HELD_MARGIN))
    for _ in range(_ROUNDS):
        grasped = Grasp(
            obj=obj,
            drive=Drive(
                times=times,
                normal=np.array([0.02, grip, grip, grip, grip]),
                lateral=np.array([0.0, 0.0, 0.0, _LOADS[1], _LOADS[1]]),
            ),
            ends=(float(times[-1]),),
        )
        run = _run(known, grasped)
        field = contact_forces(known, obj, run.state(len(run) - 1))
        # On round objects neither ΣFn is the grip nor ΣFf the load.
        grip *= (1.0 - field.safety_margin(obj.friction)) / (1.0 - _HELD_MARGIN)
    return grasped


def _conservative(index: int) -> Grasp:
    """A grip of 5 N under the loads of the thesis's experiment."""
    small, large = _LOADS
    return Grasp(
        obj=_object(index),
        drive=Drive(
            times=np.array([0.0, 0.05, 0.1, 0.1, 0.7, 0.7]),
            normal=np.array([0.02, 5.0, 5.0, 5.0, 5.0, 5.0]),
            lateral=np.array([0.0, 0.0, 0.0, small, small, large]),
        ),
        ends=(0.6, 1.3),
    )


def _controlled(index: int) -> Grasp:
    """What Safety Margin Control did with the object's true forces, played back."""
    scene = load_scene("camera-100hz", {"path": "truth", **object_changes(index)})
    with closing(open_camera(scene)) as camera:
        said = [(s.index * scene.period, s.grip, s.load) for s in grasp(scene, camera)]
    times, grip, load = np.repeat(np.array(said).T, 2, axis=1)
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


def scenes(world: str, kind: str, index: int) -> list[ForceScene]:
    """Scenes of a grasp; the same arguments give the same bytes.

    Parameters
    ----------
    world: of WORLDS
    kind: `library`, of grasps drawn at random, or of KNOWN
    index: of the grasp
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
        run = _run(specimen.fingertip, grasped)
    return _watch(calibration(world), specimen, grasped, run, int(rng.integers(2**32)))


def _drawn(
    rng: np.random.Generator, fingertip: Fingertip, low: float, high: float
) -> tuple[Grasp, History]:
    """Random grasp that ends with Γ from low to high and ΣFn in range."""
    while True:
        grasped = random_grasp(rng, max(low - _ROUNDER, 0.0), high)
        run = _run(fingertip, grasped)
        field = contact_forces(fingertip, grasped.obj, run.state(len(run) - 1))
        held = NORMALS[0] <= field.total_normal <= NORMALS[1]
        if held and low <= field.safety_margin(grasped.obj.friction) <= high:
            return grasped, run


def seed_of(world: str, kind: str, index: int) -> list[int]:
    """Seed of a grasp; trailing zeros would be no seed at all."""
    return [SEED, list(WORLDS).index(world), [LIBRARY, *KNOWN].index(kind), index, 1]


def _run(fingertip: Fingertip, grasped: Grasp) -> History:
    every = round(PERIOD / _STEP)
    duration = grasped.ends[-1]
    return simulate(fingertip, grasped.obj, grasped.drive, dt=_STEP, duration=duration, every=every)


def _watch(
    known: SensorCalibration, specimen: Specimen, grasped: Grasp, run: History, seed: int
) -> list[ForceScene]:
    """Take pictures of a run and track the markers in them, in one thread."""
    tip = specimen.fingertip
    ends = [round(end / PERIOD) for end in grasped.ends]
    scored = {k for end in ends for k in range(end - HELD_FRAMES + 1, end + 1)}
    found: dict[int, Tracks] = {}
    with threadpool_limits(1):
        cv2.setNumThreads(1)
        with closing(specimen.camera(seed)) as camera:
            tracker = MarkerTracker(Palette.of_sensor(known.sensor), NOISE)
            rest = tracker.reset(camera.expose_rest(rest_state(tip), REST_FRAMES))
            shown = np.zeros((tip.nodes, 2))
            for k in range(len(run)):
                state = run.state(k)
                seen = state.deformation.seen
                if k in scored or abs(seen - shown).max() > _SHOWN:
                    found[k] = tracker.update(camera.expose(state, k))
                    shown = seen
    return [
        ForceScene(
            known=known,
            rest=rest,
            tracks=[found[k] for k in range(end - HELD_FRAMES + 1, end + 1)],
            specimen=specimen,
            obj=grasped.obj,
            state=run.state(end),
            field=contact_forces(tip, grasped.obj, run.state(end)),
        )
        for end in ends
    ]
