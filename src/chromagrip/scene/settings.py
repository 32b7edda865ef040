"""Tables of a scene: object, load, fingertip, camera and the errors of the truth path."""

import math
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta

from ..errors import UserError
from ..model import SpringLaw, Surface
from ..strict_toml import NotNegative, Positive, Table
from ..thesis import LOAD_TIMES_S, LOADS_N

#: Lengths of `object.size_mm` for each shape, in their order.
SIZES = {
    "ball": (),
    "cylinder": ("radius", "length"),
    "box": ("x", "y", "z"),
    "capsule": ("radius", "length"),
    "torus": ("radius of the ring", "radius of the tube"),
    "cone": ("radius", "height"),
}

Part = Annotated[float, Meta(ge=0.0, lt=1.0)]
Force = Annotated[float, Meta(ge=-100.0, le=100.0)]
Friction = Annotated[float, Meta(gt=0.0, le=5.0)]
Torque = Annotated[float, Meta(ge=-1e4, le=1e4)]
Angle = Annotated[float, Meta(ge=-360.0, le=360.0)]
Offset = Annotated[float, Meta(ge=-100.0, le=100.0)]


class ObjectSettings(Table, frozen=True):
    """The object that is gripped.

    Attributes
    ----------
    stiffness_kpa: Young's modulus at the start [kPa]
    friction: friction coefficient µ
    friction_times_s, frictions: times [s] and the µ that replaces `friction` from each of them on
    friction_places_mm, friction_factors: places along the surface [mm] and factors on µ there;
        linear between the places, constant outside them
    creeps, creep_s: share by which the object's compliance rises, and its time constant [s]
    radius_mm: radius of the surface [mm]; inf: flat, negative: hollow
    profile_mm: points (x, z) of the surface [mm], z into the object; empty: flat or round
    surface: surface of a sliding object: it `travels` with the object, or it `stays` and only
        friction follows the object
    dahl_stiffness_n_per_m, dahl_exponent: bristle stiffness of a node [N/m] and exponent of the
        Dahl law
    drag_n_s_per_m: damper from the object to ground [N·s/m]
    shape: shape of the object on a dome; a `ball` has `radius_mm`, the others `size_mm`
    size_mm: lengths of the shape, see `SIZES` [mm]
    rounding_mm: radius of the shape's edges [mm]
    mesh: file of triangles, in place of the shape
    mesh_unit_mm: length of a unit of that file [mm]
    mesh_cells: number of cells of the mesh's grid along its longest side
    turned_deg: rotation vector of the object, in the sensor's axes [°]
    beside_mm: offset of the object's origin from the apex, along x and y [mm]
    """

    stiffness_kpa: Positive = 200.0
    friction: Friction = 0.5
    friction_times_s: tuple[NotNegative, ...] = ()
    frictions: tuple[Friction, ...] = ()
    friction_places_mm: tuple[Annotated[float, Meta(ge=-100.0, le=100.0)], ...] = ()
    friction_factors: tuple[Annotated[float, Meta(ge=0.01, le=100.0)], ...] = ()
    creeps: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.0
    creep_s: Positive = 1.0
    radius_mm: float = math.inf
    profile_mm: tuple[tuple[float, float], ...] = ()
    surface: Surface = "travels"
    dahl_stiffness_n_per_m: Positive = 5000.0
    dahl_exponent: Annotated[float, Meta(ge=0.1, le=2.0)] = 0.7
    drag_n_s_per_m: Positive = 120.0
    shape: Literal["ball", "cylinder", "box", "capsule", "torus", "cone"] = "ball"
    size_mm: tuple[Positive, ...] = ()
    rounding_mm: NotNegative = 0.0
    mesh: str = ""
    mesh_unit_mm: Positive = 1.0
    mesh_cells: Annotated[int, Meta(ge=16, le=256)] = 96
    turned_deg: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    beside_mm: tuple[Offset, Offset] = (0.0, 0.0)

    def __post_init__(self) -> None:
        if not 1.0 <= abs(self.radius_mm) <= 1e9 and self.radius_mm != math.inf:
            raise UserError(
                f"radius_mm = {self.radius_mm} must be at least 1, hollow at most -1, and no more "
                "than 1e9 unless it is inf"
            )
        if self.profile_mm and self.radius_mm != math.inf:
            raise UserError("radius_mm must be inf with profile_mm")
        _check_knots("friction_times_s", self.friction_times_s, "frictions", self.frictions)
        places, factors = self.friction_places_mm, self.friction_factors
        _check_knots("friction_places_mm", places, "friction_factors", factors)
        self._check_shape()

    def _check_shape(self) -> None:
        """Refuse lengths that do not fit the shape, and two shapes at once."""
        names, sizes = SIZES[self.shape], self.size_mm
        if self.mesh and (self.shape != "ball" or sizes or self.rounding_mm):
            raise UserError(
                "mesh takes the place of shape, size_mm and rounding_mm; leave them out"
            )
        if self.radius_mm != math.inf and (self.mesh or self.shape != "ball"):
            what = "mesh" if self.mesh else f"shape = {self.shape}"
            raise UserError(f"radius_mm is for a ball; it must be inf with {what}")
        if len(sizes) != len(names):
            allowed = f"[{', '.join(names)}]" if names else "empty, its size is radius_mm"
            raise UserError(f"size_mm of a {self.shape} must be {allowed}, got {list(sizes)}")

    @property
    def changes(self) -> bool:
        """True if friction or stiffness change with time."""
        return bool(self.friction_times_s) or self.creeps > 0.0

    def friction_at(self, time: float) -> float:
        """µ at `time`, before its factor along the surface."""
        return _held(self.friction_times_s, self.frictions, time, self.friction)

    def stiffness_kpa_at(self, time: float) -> float:
        """Young's modulus at `time` [kPa]: the compliance of a standard linear solid."""
        return self.stiffness_kpa / (1.0 - self.creeps * math.expm1(-time / self.creep_s))


class LoadSettings(Table, frozen=True):
    """Lateral load on the object; it is 0 before the first of its times.

    Attributes
    ----------
    times_s, forces_n: times [s] and load along x at each of them [N]
    interpolation: `hold` keeps each force until the next time, `linear` interpolates
    sine_n, sine_hz: amplitude [N] and frequency [Hz] of a sine that is added from the first time on
    sideways_n: load along y at each time [N]; empty: no such load
    twists_nmm: torque about the contact's normal, z, at each time [N·mm]; empty: no torque
    """

    times_s: tuple[NotNegative, ...] = LOAD_TIMES_S
    forces_n: tuple[Force, ...] = LOADS_N
    interpolation: Literal["hold", "linear"] = "hold"
    sine_n: Annotated[float, Meta(ge=0.0, le=100.0)] = 0.0
    sine_hz: Positive = 1.0
    sideways_n: tuple[Force, ...] = ()
    twists_nmm: tuple[Torque, ...] = ()

    def __post_init__(self) -> None:
        _check_knots("times_s", self.times_s, "forces_n", self.forces_n)
        for name, values in (("sideways_n", self.sideways_n), ("twists_nmm", self.twists_nmm)):
            if values:
                _check_knots("times_s", self.times_s, name, values)

    def force(self, time: float) -> float:
        """Load along x at `time` [N]."""
        force, times = self._at(self.forces_n, time), self.times_s
        if not self.sine_n or not times or time < times[0]:
            return force
        return force + self.sine_n * math.sin(2.0 * math.pi * self.sine_hz * (time - times[0]))

    def sideways(self, time: float) -> float:
        """Load along y at `time` [N]."""
        return self._at(self.sideways_n, time)

    def twist(self, time: float) -> float:
        """Torque about z at `time` [N·m]."""
        return 1e-3 * self._at(self.twists_nmm, time)

    def _at(self, values: tuple[float, ...], time: float) -> float:
        if not values or time < self.times_s[0]:
            return 0.0
        if self.interpolation == "hold":
            return _held(self.times_s, values, time, 0.0)
        return float(np.interp(time, self.times_s, values))


def _check_knots(
    knots_name: str, knots: tuple[float, ...], values_name: str, values: tuple[float, ...]
) -> None:
    if len(knots) != len(values):
        raise UserError(
            f"{knots_name} has {len(knots)} entries and {values_name} {len(values)}; "
            "both need the same number"
        )
    if tuple(sorted(set(knots))) != knots:
        raise UserError(f"{knots_name} must increase, got {list(knots)}")


def _held(times: tuple[float, ...], values: tuple[float, ...], time: float, before: float) -> float:
    """Value at the last of the times up to `time`; `before` if all times are later."""
    past = [value for t, value in zip(times, values, strict=True) if t <= time]
    return past[-1] if past else before


class FingertipSettings(Table, frozen=True):
    """The chain of the node model.

    Attributes
    ----------
    model: force law of the springs; see `Fingertip.law`
    nodes: number of nodes, odd
    step_ms: longest step [ms]; a frame period is a whole number of steps
    calm_um_per_s: speed of the nodes below which a frame period is one step, if grip and load also
        change by less than a hundredth [µm/s]; 0: never
    """

    model: SpringLaw = "split"
    nodes: Annotated[int, Meta(ge=11, le=20001)] = 251
    step_ms: Annotated[float, Meta(gt=0.0, le=100.0)] = 1.0
    calm_um_per_s: NotNegative = 0.0


class CameraSettings(Table, frozen=True):
    """Timing and noise of the camera's frames.

    Attributes
    ----------
    rate_hz: frames per second [Hz]
    latency_frames: number of frames between a frame and the command that answers it
    exposure_ms: length of the exposure [ms], which ends at the frame's instant; the frame shows its
        middle. `defects.motion_blur` is an exposure that also blurs
    dropped: share of frames that never reach the controller; the grip is then held
    late: share of frames that reach the controller one frame later than the latency
    friction_bias: error added to the estimated µ, and so to Γ, such as from a wrong calibration
    noise_levels: standard deviation of a pixel [grey levels]
    rest_frames: number of frames of the unloaded sensor before the run
    """

    rate_hz: Annotated[float, Meta(gt=0.0, le=1e5)] = 100.0
    latency_frames: Annotated[int, Meta(ge=0, le=1000)] = 1
    exposure_ms: NotNegative = 0.0
    dropped: Part = 0.0
    late: Part = 0.0
    friction_bias: Annotated[float, Meta(ge=-1.0, le=1.0)] = 0.0
    noise_levels: Annotated[float, Meta(ge=0.0, le=50.0)] = 2.0
    rest_frames: Annotated[int, Meta(ge=1, le=1000)] = 16


class TruthSettings(Table, frozen=True):
    """Errors of the truth path.

    Attributes
    ----------
    margin_noise: standard deviation of white noise on Γ
    """

    margin_noise: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.0
