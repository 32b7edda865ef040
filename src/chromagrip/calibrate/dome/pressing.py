"""Known presses on a dome of silicone: what its markers would show, and what holds the object.

A press has unknowns of its own, in the order of `contact_state`:

    shift along x and y, press, twist | place (2), ln µ, ln σ0

The object is rigid, of a known radius. All forces are those of the silicone's stiffness as
supposed. They grow with Young's modulus, and what the markers show does not change.
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ...model import ModelError
from ...model.dome import lattice
from ...tracking import SensorCalibration, Tracks
from ...tracking.forces import CameraPose, MarkerShifts
from ...tracking.forces.dome import (
    BRISTLE,
    CURVES,
    FRICTION,
    MOVING,
    PLACE,
    PRESS,
    STIFFNESS,
    ContactWay,
    DomeResponse,
    moves_of,
    pose_of,
    prior_of,
    units_of,
)
from ..presses import Press

Array = NDArray[np.float64]

#: Number of unknowns of a press, and which of those of an object they are.
OWN = 8
_OF_OBJECT = [0, 1, FRICTION, BRISTLE]


class Pressing:
    """Presses on one dome.

    Parameters
    ----------
    calibration: of the sensor, with the silicone as supposed
    rest: tracks of the unloaded sensor
    pose: of the specimen's camera
    """

    #: Deepest press over the thickness.
    deepest = 0.7

    def __init__(self, calibration: SensorCalibration, rest: Tracks, pose: CameraPose) -> None:
        dome = calibration.sensor.round_dome("a fit of presses")
        self.dome = dome
        places = MarkerShifts(calibration, rest, np.inf, pose).places
        self._response = DomeResponse(calibration.sensor, dome, places)
        self._way = ContactWay(dome)

    def __call__(self, press: Press, own: Array) -> tuple[Array, Array]:
        """Predict the shifts of the markers and the force on the object under a press.

        Parameters
        ----------
        press: press
        own: unknowns of the press, shape (8,)

        Returns
        -------
        shifts: (x, y, log size) of both layers since rest, shape (P, 6)
        held: force on the object along the normal, and across it along x and y [N], and torque
            about the normal [N·m], shape (4,)

        Raises
        ------
        UserError
            When the contact does not converge.
        """
        object_, pose, rest = self._object(press, own), own[:MOVING], np.zeros(MOVING)
        down = np.zeros(MOVING)
        down[PRESS] = pose[PRESS]
        contact = self._way.step(self._way.untouched(object_), object_, rest, down)
        contact = self._way.step(contact, object_, down, pose)
        axes, _ = pose_of(self.dome, object_, rest)
        force = contact.forces.sum(axis=0) @ axes
        points = lattice(self.dome).points[contact.nodes] + contact.displacement
        torque = np.cross(points, contact.forces).sum(axis=0) @ axes[:, 2]
        shifts = self._response(contact.nodes, contact.linear)
        return shifts, np.array([-force[2], force[0], force[1], torque])

    def start(self, press: Press, alike: Callable[[Array], float]) -> Array:
        """Unknowns to start from: the place whose image is most alike, and the press of the force.

        Parameters
        ----------
        alike: says how alike shifts (P, 6) are to the picture's
        """
        light_press = 0.1  # press of a start over the thickness
        light = light_press * self.dome.thickness
        tried = [self._from(place, light) for place in _places()]
        scores = [alike(self(press, own)[0]) for own in tried]
        last = own = tried[int(np.argmax(scores))]
        first_power = 1.6  # how fast a force grows with the depth of a press, to begin with
        power, before = first_power, None
        rounds = 4  # rounds that find the force
        for _ in range(rounds):
            try:
                force = float(self(press, own)[1][0])
            except ModelError:  # too deep; the fit goes on from the last one
                return last
            last = own
            now = math.log(own[PRESS]), math.log(max(force, 1e-6))
            if before is not None and abs(now[0] - before[0]) > 1e-4:
                power = float(np.clip((now[1] - before[1]) / (now[0] - before[0]), 1.0, 3.0))
            before = now
            deeper = float(np.clip((math.log(press.normal) - now[1]) / power, -1.5, 1.5))
            own = own.copy()
            own[PRESS] = min(own[PRESS] * math.exp(deeper), self.deepest * self.dome.thickness)
        return own

    def _from(self, place: tuple[float, float], depth: float) -> Array:
        own = np.zeros(OWN)
        own[PRESS] = depth
        own[MOVING:] = prior_of(self.dome).mean[_OF_OBJECT]
        own[MOVING : MOVING + 2] = place
        return own

    def _object(self, press: Press, own: Array) -> Array:
        """Unknowns of the object as `contact_state` has them."""
        object_ = np.zeros(8)
        object_[_OF_OBJECT] = own[MOVING:]
        object_[CURVES] = [1.0 / press.radius] * 2 + [0.0] if press.radius else 0.0
        rigid = 1e11  # stiffness of a rigid object [N/m³]; it gives way by less than 1 µm
        object_[STIFFNESS] = math.log(rigid)
        return object_

    def prior(self, own: Array) -> tuple[Array, Array]:
        """Mean and deviation of the unknowns of a press, shape (8,) each."""
        known, mean, deviation = prior_of(self.dome), np.zeros(OWN), np.empty(OWN)
        mean[MOVING:] = known.mean[_OF_OBJECT]
        deviation[MOVING:] = known.deviation[_OF_OBJECT]
        deviation[:MOVING] = moves_of(self.dome, own[:MOVING])
        # How deep a press is, its force tells.
        deviation[PRESS] = self.dome.thickness
        return mean, deviation

    @property
    def units(self) -> Array:
        """Change of each unknown that derivatives are taken over, shape (8,)."""
        every = units_of(self.dome)
        return np.concatenate([every[:MOVING], every[MOVING:][_OF_OBJECT]])

    def limited(self, own: Array) -> Array:
        """Unknowns (…, 8) within what a press can have."""
        out, object_ = own.copy(), own[..., MOVING:]
        out[..., PRESS] = np.clip(own[..., PRESS], 1e-6, self.deepest * self.dome.thickness)
        farthest = 0.8  # farthest place from the apex [rad]
        out[..., MOVING : MOVING + 2] = np.clip(object_[..., PLACE], -farthest, farthest)
        out[..., MOVING + 2] = np.clip(object_[..., 2], math.log(0.03), math.log(4.0))
        out[..., MOVING + 3] = np.clip(object_[..., 3], math.log(2e8), math.log(2e11))
        return out


def _places() -> list[tuple[float, float]]:
    """Places that a press may be at, as turns about x and y [rad]."""
    # Starts of a place: angles from the apex [rad], and how many around it.
    starts = ((0.0, 1), (0.2, 6), (0.45, 10))
    return [
        (angle * math.cos(turn), angle * math.sin(turn))
        for angle, count in starts
        for turn in 2.0 * math.pi * np.arange(count) / count
    ]
