"""Sensors of silicone as they are made: as their design says, or off it in all that it states."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from ....model import Dome
from ....render import DomeMap, Flaws, Membrane, SensorDesign, load_sensor
from ....sensing.camera import SimulatedCamera
from ....sensing.sensor import TactileSensor
from ....tracking.forces import yellow_moves
from ..force_scenes import NOISE

Array = NDArray[np.float64]

#: What is off the design in a mismatched specimen, up or down: shares of E and of the silicone's
#: thickness, depth of a layer in the silicone [mm], ν, centre of the image [px], roll of the camera
#: [°]. An inner layer that does not lie on the core is off up and down as the roll is.
OFF = {
    "young": 0.10,
    "thickness": 0.03,
    "depth_mm": 0.05,
    "poisson": 0.01,
    "centre_x_px": 0.5,
    "centre_y_px": 0.5,
    "roll_deg": 0.5,
}
#: Mismatched specimens of a design: an orthogonal array of two levels, so that each of OFF is up in
#: half of them, whatever another is.
SPECIMENS = 8
#: Those that are calibrated and read, of a design of two soft layers, which takes longest. E,
#: thickness and depths are up in one of them and down in the other.
_FEW = (3, 4)
#: Pitch of their nodes over the design's.
_FINER = 0.8
#: Calibrations of them; `fixtures/calibrated/make.py` makes them and says what they are.
_CALIBRATED = Path(__file__).parent / "calibrated"


@dataclass(frozen=True, kw_only=True)
class Specimen:
    """A sensor of silicone as it is made.

    Attributes
    ----------
    sensor: as made; its defects are those of its pictures
    dome: silicone
    renderer: name of the renderer that draws it
    roll: turn of its camera about the axis [rad]
    noise: of its camera [grey levels]
    """

    sensor: SensorDesign
    dome: Dome
    renderer: str = "painter"
    roll: float = 0.0
    noise: float = NOISE

    def camera(
        self, seed: int, field: Callable[[Array, Array], tuple[Array, Array]] | None = None
    ) -> SimulatedCamera:
        """Camera that takes its pictures; close it after use.

        Parameters
        ----------
        seed: of the noise and of the defects
        field: displacement and slopes of markers, as of `MarkerField`, at given places of both
            layers (2, M, 2) for what `carried` says of a state; None is the dome's own
        """
        sensor = self.sensor
        own = Flaws(sensor, sensor.defects, seed).places
        places = np.broadcast_to(sensor.places if own is None else own, (2, *sensor.places.shape))
        made = DomeMap(sensor, self.dome, places)
        turn = _about_axis(self.roll)

        def membrane(forces: Array) -> Membrane:
            one = made(forces) if field is None else made.of_field(*field(places, forces))
            return Membrane(centres=one.centres @ turn.T, axes=turn @ one.axes)

        return TactileSensor(
            sensor,
            body=self.dome,
            noise=self.noise,
            seed=seed,
            renderer=self.renderer,
            membrane_map=membrane,
        ).camera


def matched(name: str) -> Specimen:
    """A specimen as its design says, with the design's own defects."""
    sensor = load_sensor(name)
    return Specimen(sensor=sensor, dome=sensor.round_dome("this bench"))


def mismatched(name: str, index: int) -> Specimen:
    """A specimen that is off its design by all of OFF, with a finer mesh and another renderer.

    Parameters
    ----------
    name: of the design
    index: of the specimen; there are SPECIMENS
    """
    nominal = load_sensor(name)
    off = {key: sign * OFF[key] for key, sign in zip(OFF, signs(index), strict=True)}
    dome, camera, silicone = nominal.round_dome("this bench"), nominal.camera, nominal.silicone
    assert silicone is not None
    thickness = 1e3 * dome.thickness * (1.0 + off["thickness"])
    inner = thickness
    if yellow_moves(nominal):
        inner = nominal.inner.depth_mm + math.copysign(off["depth_mm"], off["roll_deg"])
    sensor = replace(
        nominal,
        silicone=replace(
            silicone,
            core_mm=1e3 * dome.radius - thickness,
            young_kpa=silicone.young_kpa * (1.0 + off["young"]),
            poisson=silicone.poisson + off["poisson"],
            pitch_mm=1e3 * dome.spacing * _FINER,
        ),
        magenta=replace(nominal.magenta, depth_mm=nominal.magenta.depth_mm + off["depth_mm"]),
        yellow=replace(nominal.inner, depth_mm=inner),
        camera=replace(
            camera,
            centre_px=(
                (camera.width_px - 1) / 2 + off["centre_x_px"],
                (camera.height_px - 1) / 2 + off["centre_y_px"],
            ),
        ),
    )
    return Specimen(
        sensor=sensor,
        dome=sensor.round_dome("this bench"),
        renderer="pyrender",
        roll=math.radians(off["roll_deg"]),
    )


def calibrated(name: str) -> tuple[int, ...]:
    """Mismatched specimens of a design that are calibrated and read."""
    return _FEW if yellow_moves(load_sensor(name)) else tuple(range(SPECIMENS))


def calibration_file(name: str, index: int) -> Path:
    """Calibration of a mismatched specimen from eight presses, one of `calibrated`.

    Parameters
    ----------
    name, index: as of `mismatched`
    """
    return _CALIBRATED / f"{name}-{index}.toml"


def signs(index: int) -> list[int]:
    """Whether each of OFF is up (1) or down (−1) in a specimen."""
    # Thickness and ν are the first two, because each pair of them needs tables of its own.
    a, b, c = (1 if index >> k & 1 else -1 for k in range(3))
    return [c, a, a * b, b, a * c, b * c, a * b * c]


def _about_axis(angle: float) -> Array:
    cos, sin = math.cos(angle), math.sin(angle)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
