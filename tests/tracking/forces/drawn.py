"""Tracks of markers as a chain or a dome of silicone carries them, without a picture."""

import math
from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray

from chromagrip.model import (
    ContactObject,
    Dome,
    DomeState,
    Drive,
    Fingertip,
    History,
    Motion,
    Solid,
    simulate,
)
from chromagrip.model.dome import Stepper, lattice, resting
from chromagrip.render import DomeMap, SensorDesign, areas, centroids, load_sensor, outlines
from chromagrip.tracking import SensorCalibration, Tracks, load_calibration, sensor_as_designed
from chromagrip.tracking.forces.chain.sensitivity import MarkerResponse

Array = NDArray[np.float64]

#: A chain: its calibration, its design and its fingertip.
KNOWN = load_calibration("thesis")
SENSOR = load_sensor("thesis")
TIP = Fingertip()
#: Of (x, y, log size) of both layers, as the tracker reaches it at a noise of 2 levels.
NOISE = np.array([7.5e-3, 7.5e-3, 1.35e-3, 6e-3, 6e-3, 1.05e-3])
#: Of the image of the chain [px].
CENTRE = np.array([319.5, 239.5])
#: A dome: its calibration, its design and its silicone.
DOME_KNOWN = sensor_as_designed("dome-2020")
DESIGN = load_sensor("dome-2020")
DOME = DESIGN.dome
GRIP = 3.0


def made(time: float, position: Array, log_size: Array, deviations: Array) -> Tracks:
    """Tracks of markers (2, M) that are all seen, with standard deviations (6,)."""
    found = np.ones(log_size.shape, dtype=bool)
    return Tracks(
        time=time,
        position=position,
        log_size=log_size,
        hue=np.full(found.shape[1], np.nan),
        visible=found,
        ambiguous=~found,
        last_seen=np.full(found.shape, time),
        covariance=np.tile(np.diag(deviations**2), (found.shape[1], 1, 1)),
    )


class Specimen:
    """Draws tracks of a chain whose markers do not sit where the design has them."""

    def __init__(self, scatter: float = 0.0, turned_by: float = 0.0) -> None:
        rng = np.random.default_rng(3)
        places = SENSOR.places - [0.0, turned_by]
        cos, sin = np.cos(turned_by), np.sin(turned_by)
        self._turn = np.array([[cos, sin], [-sin, cos]])
        off = rng.normal(0.0, scatter, (2, *places.shape)) / 8e-3
        off[..., 1] /= np.maximum(np.sin(places[:, 0]), 0.02)
        self._response = MarkerResponse(SENSOR, places + off, TIP.angles())
        self.pairs = len(places)
        self.rest = self.tracks(np.zeros((TIP.nodes, 2)), 0.25, 0)

    def tracks(self, seen: Array, noise: float, seed: int, time: float = 0.0) -> Tracks:
        """Tracks for displacements (N, 2) [m]."""
        rng = np.random.default_rng(seed)
        shown = self._response.measured(seen.astype(float))
        shown = shown + noise * NOISE * rng.standard_normal(shown.shape)
        position = (np.stack([shown[:, :2], shown[:, 3:5]]) - CENTRE) @ self._turn + CENTRE
        return made(time, position, np.stack([shown[:, 2], shown[:, 5]]), noise * NOISE)


class Drawn:
    """Draws tracks of one dome, with noise.

    Parameters
    ----------
    sensor: design
    dome: its silicone
    seed: of the noise
    """

    def __init__(self, sensor: SensorDesign, dome: Dome, seed: int = 0) -> None:
        self._sensor, self._map = sensor, DomeMap(sensor, dome)
        self._random = np.random.default_rng(seed)
        self._none = np.zeros((len(lattice(dome).ring), 3))
        self._sizes, self._time = self._measured(self._none)[1], 0.0

    def __call__(self, linear: Array | None = None) -> Tracks:
        """Tracks for forces on the linear skin (N, 3) [N]; at rest for none."""
        place, size = self._measured(self._none if linear is None else linear)
        self._time += 1 / 60
        place = place + 0.01 * self._random.normal(size=place.shape)
        size = size - self._sizes + 1e-3 * self._random.normal(size=size.shape)
        return made(self._time, place, size, np.array([0.01, 0.01, 1e-3] * 2))

    def _measured(self, linear: Array) -> tuple[Array, Array]:
        image = outlines(self._map(linear), self._sensor.view)
        square = self._sensor.markers.form == "square"
        return centroids(image, square), 0.5 * np.log(areas(image, square))


#: An object that is none of the starts; its friction law is not that with which a search starts.
OBJECT = ContactObject(friction=0.45, stiffness=400.0, curvature=30.0)


@cache
def pulled(side: float = 1.0) -> History:
    """A chain pressed with 2 N in 0.1 s, then pulled until Γ is about 0.3; a state each 10 ms."""
    times = np.array([0.0, 0.1, 0.4, 0.5])
    normal, lateral = np.array([0.02, 2.0, 2.0, 2.0]), side * np.array([0.0, 0.0, 0.62, 0.62])
    drive = Drive(times=times, normal=normal, lateral=lateral)
    return simulate(TIP, OBJECT, drive, dt=2e-3, duration=0.5, every=5)


@lru_cache(maxsize=8)
def grasped(
    solid: Solid,
    azimuth: float,
    margin: float,
    frames: int = 24,
    torque: float = 0.0,
    pose: tuple[float, ...] = (0.0,) * 6,
) -> tuple[DomeState, ...]:
    """States of a grip and then a load that leaves a margin, with a torque [N·m], one a frame.

    The pose, its place [m] and rotation vector, is that of the object as it touches.
    """
    load = (1.0 - margin) * solid.friction * GRIP
    loads = np.zeros((4, 6))
    loads[1:, 2] = -GRIP
    loads[2:, :2] = load * math.cos(azimuth), load * math.sin(azimuth)
    loads[2:, 5] = torque
    motion = Motion(
        times=np.array([0.0, 0.2, 0.6, 0.7]),
        poses=np.tile(pose, (4, 1)),
        free=("x", "y", "z", "rz") if torque else ("x", "y", "z"),
        drag=(2.0, 2.0, 25.0, 0.0, 0.0, 1e-4 if torque else 0.0),
        loads=loads,
    )
    stepper = Stepper(DOME, solid, motion, resting(DOME, solid, motion))
    states = []
    for k in range(2 * frames):
        stepper.advance(0.7 * (k + 1) / (2 * frames))
        if k % 2:
            states.append(stepper.state())
    return tuple(states)


def known(dome: bool) -> SensorCalibration:
    return DOME_KNOWN if dome else KNOWN
