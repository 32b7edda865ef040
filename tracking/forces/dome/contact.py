"""Force field from tracks on a dome: the contact that explains them is found by synthesis.

A yellow layer that lies on the rigid core does not move, and one moving layer does not tell free
tractions. It tells a contact: an object of two curvatures, its stiffness and friction, and how it
has been pressed, shifted and turned (`contact_state`). What no such contact explains is refused.
"""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ....errors import UserError
from ....model import ForceField, FrictionReading, margin_within, torsion
from ....model.dome import PosedContact, lattice
from ....render import layer_depths
from ...tracks import Tracks
from ..calibration import SensorCalibration
from ..friction import Z90
from ..reconstructors import NoEstimateError
from ..shifts import MarkerShifts
from ..silicone_values import ON_CORE
from .contact_fit import ContactFit
from .contact_solution import Followed, Solution
from .contact_starts import Rivals, Start, light_press, other_objects, start_from_rest
from .contact_state import CURVES, FRICTION, MOVING, OBJECT
from .contact_way import sums_of
from .key_shifts import Key, Shifts
from .keys import Backoff, far_on, thinned
from .marker_response import DomeResponse
from .untouched import untouched_field

Array = NDArray[np.float64]

#: Fewer visible pairs than this do not determine a contact.
MIN_MARKERS = 12
#: Error of a marker's place [px] and log size that the linear silicone and the round object leave.
PLACE_ERROR, SIZE_ERROR = 0.02, 5e-3
#: The same of a place as a share of how far the marker has moved.
_SHARE_ERROR = 0.015
#: Places of the log sizes of both layers among the values of a pair.
_SIZES = (2, 5)
#: Sum of squares of shifts in deviations below which nothing touches.
_UNTOUCHED = 100.0
#: Sum of squares that a contact must explain to be one.
_TOLD = 60.0
#: Largest mean squared residual of the shifts in a solution.
_MISFIT = 2.0
#: Largest median squared residual of the pairs that have moved (a few pairs of any specimen are
#: outliers): for aligned markers, and its increase per misalignment over marker size. Misaligned
#: markers are tracked worse.
_MEDIAN_MISFIT = (0.25, 2.4)
#: The same for the product of median and mean.
_BOTH_MISFITS = (0.06, 4.0)
#: Curvatures times the radius of the dome that no smooth, convex object of its size has.
_HOLLOW, _EDGE = -0.2, 4.5
#: Largest mean squared residual of the shifts with such an object; above it, it is rejected.
_SHAPED = 0.8
#: Mean square of a change of the shifts, in deviations, below which a refused frame is the same.
_SAME = 0.5
#: Rounds of a fit from rest, and of one that starts near its solution.
_ROUNDS, _FEW_ROUNDS = 25, 8
#: Rounds of a rival: of a better one there are more in the next turn.
_RIVAL_ROUNDS = 4
#: The object is fitted again at least in every 8th key frame that could change the estimate.
_REFIT_EVERY = 8
#: Unsuccessful refits after which the interval between them doubles.
_REFITS_IN_VAIN = 3
#: A rival is worth looking for more if its cost is so much less, in squared deviations.
_WORTH = 1.0
#: Mean square of what is left at which other objects are tried, or so many times that of the
#: solution before.
_DOUBTFUL, _WORSE = 1.2, 1.3
#: Deviation of ln µ below which µ is observable, and the margin from which on it is not.
_OBSERVED, _OBSERVABLE_MARGIN = 0.3, 0.85
#: Deviation of Γ that the layer's thickness and the friction law leave, and of ΣFn and ΣFf as
#: shares.
_MARGIN_ERROR, _NORMAL_ERROR, _FRICTION_ERROR = 0.03, 0.04, 0.04
#: Why a frame is refused.
_UNLIKE = "no contact of a smooth, convex object explains the markers"
#: Normal force above which a node is in contact, over the force of all.
_TOUCHING = 1e-6


class ContactReading:
    """Reads a contact off the tracks of one dome, frame after frame.

    Parameters
    ----------
    calibration: of the sensor
    rest: tracks of the unloaded sensor

    Raises
    ------
    UserError
        For a sensor without silicone, or a pad.
    """

    def __init__(self, calibration: SensorCalibration, rest: Tracks) -> None:
        dome = calibration.sensor.round_dome("reconstructor contact")
        self.dome = dome
        self._shifts = MarkerShifts(calibration, rest, math.pi / 2, halves=True)
        sensor = self._shifts.sensor
        self._response = DomeResponse(sensor, dome, self._shifts.places)
        self._fit = ContactFit(dome, self._response)
        self._error = np.diag(np.tile([PLACE_ERROR, PLACE_ERROR, SIZE_ERROR], 2) ** 2)
        # A layer on the core stays where it is, whatever the forces are.
        moving = np.array(layer_depths(sensor, dome)) < (1.0 - ON_CORE) * dome.thickness
        self._tells = np.repeat(moving, 3)
        crooked = 1e-3 * sensor.defects.crookedness_mm / (2.0 * float(sensor.half_sizes.max()))
        self._typical, self._both = (
            base + slope * crooked for base, slope in (_MEDIAN_MISFIT, _BOTH_MISFITS)
        )
        self._light = light_press(self._fit)
        self.reset()

    def reset(self) -> None:
        """Forget the frames before: the next one is sought from rest."""
        #: Solution of the last key frame; None where there is none.
        self.last: Solution | None = None
        self._now: Followed | None = None
        self._covariance = np.zeros((7, 7))
        self._rivals, self._refits = Rivals(self.dome), Backoff(1, _REFIT_EVERY, _REFITS_IN_VAIN)
        self._doubtful = _DOUBTFUL
        self._refused: Shifts | None = None
        #: Whether the last fitted object has no supported shape. It is still tracked: it may
        #: get one again.
        self._odd = False

    def update(self, tracks: Tracks) -> ForceField:
        """Force field of a frame.

        Raises
        ------
        NoEstimateError
            When fewer than MIN_MARKERS pairs are visible, and when no contact explains them.
        """
        shifts = self._read(tracks)
        nothing = shifts.cost(np.zeros((len(shifts.used), 6)))
        if nothing < _UNTOUCHED:
            self.reset()
            return untouched_field(self.dome, self._hidden(shifts) ** 2)
        again = self._is_refused(shifts)
        if again or not (self._followed(shifts) or self._found(shifts)):
            refused = self._refused if again else shifts
            self.reset()
            self._refused = refused
            raise NoEstimateError(_UNLIKE)
        self._refused = None
        if self._odd:
            raise NoEstimateError(_UNLIKE)
        assert self._now is not None
        if not self._now.contact.forces.any() or self._tells_little(shifts, nothing):
            self.reset()
            return untouched_field(self.dome, self._hidden(shifts) ** 2)
        return self._field()

    def _hidden(self, shifts: Shifts) -> float:
        """Standard deviation of a force that noise hides [N]: that of a press just not told."""
        force, image = self._light
        seen = float(np.linalg.norm(shifts.apply(image[shifts.used])))
        return force * math.sqrt(_TOLD) / max(seen, 1e-9) / Z90

    def _is_refused(self, shifts: Shifts) -> bool:
        """Whether markers are where they were in a frame that no contact explained."""
        if self._refused is None or (shifts.used != self._refused.used).any():
            return False
        moved = shifts.apply(shifts.values - self._refused.values)
        return float(moved @ moved) < _SAME * shifts.count

    def _tells_little(self, shifts: Shifts, nothing: float) -> bool:
        """Whether the first frame of a contact is explained by noise hardly worse than by it.

        Parameters
        ----------
        nothing: sum of squares of the shifts where nothing touches
        """
        assert self.last is not None
        if len(self.last.keys) > 1:
            return False
        return nothing - self.last.misfit * shifts.count < _TOLD

    def _followed(self, shifts: Shifts) -> bool:
        """Follow the contact of the frame before; fit the object anew where it has moved on."""
        if self.last is None or self._now is None:
            return False
        last = self.last
        try:
            now, misfit = self._fit.follow(last.object_, self._now, shifts)
            if misfit < self._doubtful and not far_on(self.dome, last.keys, now.pose):
                self._now = now
                return True
        except UserError:
            return False
        keys = thinned(self.dome, (*last.keys, Key(shifts=shifts, pose=now.pose)))
        start = last.object_, keys
        try:
            held, tells = self._fit.hold(last, keys, now)
        except UserError:
            return self._taken(self._better(None, start, _FEW_ROUNDS), start)
        solution = held
        if held.misfit > self._doubtful or (tells and self._refits.due()):
            solution = self._again(held)
            self._refits.tried(better=solution is not held)
        rival = self._rivals.next(solution)
        if rival is not None:
            before, solution = solution, self._rival(solution, rival)
            self._rivals.tried(better=solution.cost < before.cost - _WORTH)
        return self._taken(solution, start)

    def _again(self, held: Solution) -> Solution:
        """The object fitted anew to the key frames of a solution; the same where none is better."""
        doubtful = held.misfit > self._doubtful
        try:
            solution = self._fit.along_chord(held, doubtful)
        except UserError:
            solution = None
        if solution is None or solution.misfit > self._doubtful:
            start, rival_of = (held.object_, held.keys), None if doubtful else held
            solution = self._better(solution, start, _FEW_ROUNDS, rival_of)
        return held if solution is None or solution.cost > held.cost else solution

    def _found(self, shifts: Shifts) -> bool:
        """Find the contact of a frame from rest."""
        start = start_from_rest(self._fit, shifts)
        return self._taken(self._better(None, start, _ROUNDS), start)

    def _taken(self, solution: Solution | None, start: Start) -> bool:
        """Go on with a solution, or with one from another object where it is doubtful."""
        if solution is None or solution.misfit > self._doubtful:
            for other in other_objects(self.dome, *start):
                solution = self._better(solution, other, _ROUNDS)
        if solution is None or solution.misfit > _MISFIT:
            return False
        self._odd = self._unlike(solution)
        self.last, self._now = solution, self._fit.last_of(solution)
        self._covariance = self._spread(solution)
        self._doubtful = max(_DOUBTFUL, _WORSE * solution.misfit)
        return True

    def _unlike(self, solution: Solution) -> bool:
        """Whether an object is hollow, an edge, or not what most markers near it show."""
        along_x, along_y, mixed = solution.object_[CURVES] * self.dome.radius
        mean, half = 0.5 * (along_x + along_y), math.hypot(0.5 * (along_x - along_y), mixed)
        own = np.diag(solution.covariance)[MOVING:][CURVES][:2].max()
        doubt = self.dome.radius * math.sqrt(own)  # a light touch tells little of a shape
        if solution.typical > self._typical or solution.typical * solution.misfit > self._both:
            return True
        # A soft plane is as well explained by a hollow: only what fits badly is one.
        shaped = mean - half < _HOLLOW - doubt or mean + half > _EDGE + doubt
        return shaped and solution.misfit > _SHAPED

    def _better(
        self,
        solution: Solution | None,
        start: Start,
        rounds: int,
        rival_of: Solution | None = None,
    ) -> Solution | None:
        """The better of a solution and that from another start."""
        try:
            other = self._fit.fit_keys(*start, rounds, rival_of)
        except UserError:
            return solution
        return other if solution is None or other.misfit < solution.misfit else solution

    def _rival(self, solution: Solution, start: Start) -> Solution:
        """The better of a solution and a rival's."""
        try:
            other = self._fit.fit_keys(*start, _RIVAL_ROUNDS, rival_of=solution)
        except UserError:
            return solution
        return other if other.misfit < solution.misfit else solution

    def _read(self, tracks: Tracks) -> Shifts:
        values, certain = self._shifts(tracks, MIN_MARKERS)
        # Focus and light change all sizes alike, and most markers are far from the contact.
        for size in _SIZES:
            values[:, size] -= np.median(values[certain, size])
        tells = np.flatnonzero(self._tells)
        noise = self._shifts.noise(tracks)[certain] + self._error
        # Blurred, crooked markers and the linear silicone are off by a share of the motion.
        places = values[certain].reshape(-1, 2, 3)[:, :, :2]
        moved = np.linalg.norm(places, axis=-1).repeat(3, axis=1)
        moved[:, _SIZES] = 0.0
        noise[:, range(6), range(6)] += (_SHARE_ERROR * moved) ** 2
        noise = noise[:, tells[:, None], tells]
        whiten = np.zeros((len(noise), len(tells), len(self._tells)))
        whiten[:, :, tells] = np.linalg.inv(np.linalg.cholesky(noise))
        return Shifts(values=values[certain], whiten=whiten, used=certain)

    def _field(self) -> ForceField:
        assert self.last is not None
        assert self._now is not None
        solution, contact = self.last, self._now.contact
        normal = contact.normal
        mu = math.exp(solution.object_[FRICTION])
        whole = self._covariance
        deviation = math.sqrt(whole[2, 2])
        sums = sums_of(contact)
        share = sums[1] / max(mu * sums[0], 1e-12)
        # Of (ΣFn, ΣFf), and of Γ = 1 − ΣFf/(µ·ΣFn) with all their correlations.
        scale = np.array([sums[0], 1.0])
        totals = whole[:2, :2] * np.outer(scale, scale)
        totals += np.diag([(_NORMAL_ERROR * sums[0]) ** 2, (_FRICTION_ERROR * sums[1]) ** 2])
        slope = np.array([share, -1.0 / max(mu * sums[0], 1e-12), share])
        spread = math.hypot(math.sqrt(float(slope @ whole[:3, :3] @ slope)), _MARGIN_ERROR)
        points = lattice(self.dome).points
        whole_skin = contact.everywhere(len(points))
        field = ForceField(
            position=points + whole_skin.displacement,
            normal=whole_skin.normal,
            friction=whole_skin.friction,
            contact=whole_skin.normal > _TOUCHING * max(normal.sum(), 1e-9),
            totals_covariance=totals,
            directions=whole_skin.normals,
        )
        # Torsion makes the skin slip as a pull does.
        slips = margin_within(field, mu) < _OBSERVABLE_MARGIN
        reading = FrictionReading(
            value=mu,
            deviation=mu * deviation,
            observable=deviation < _OBSERVED and slips,
            totals_covariance=tuple(mu * scale * whole[2, :2]),
            margin_deviation=spread,
            logarithmic=True,
        )
        return replace(
            field,
            friction_reading=reading,
            wrench_covariance=whole[3:, 3:] + _wrench_error(field, mu),
        )

    def _spread(self, solution: Solution) -> Array:
        """Covariance of ln ΣFn, ΣFf [N], ln µ and the wrench in the last key frame, shape (7, 7).

        The wrench is the force along x, y, z [N] and the torque about z [N·m].
        """
        changes = solution.changes
        sums = sums_of(changes.contact)
        slopes = np.zeros((7, MOVING + len(OBJECT)))
        slopes[:2] = (sums_of(changes.changed) - sums).T
        slopes[3:] = (self._wrench(changes.changed) - self._wrench(changes.contact)).T
        slopes /= self._fit.units
        slopes[0] /= max(float(sums[0]), 1e-12)
        slopes[2, MOVING + FRICTION] = 1.0
        return np.asarray(slopes @ solution.covariance @ slopes.T)

    def _wrench(self, contact: PosedContact) -> Array:
        """Force along x, y, z [N] and torque about z [N·m], shape (…, 4)."""
        place = lattice(self.dome).points[contact.nodes] + contact.displacement
        turn = place[..., 0] * contact.forces[..., 1] - place[..., 1] * contact.forces[..., 0]
        return np.concatenate([contact.forces.sum(axis=-2), turn.sum(-1)[..., None]], axis=-1)


def _wrench_error(field: ForceField, mu: float) -> Array:
    """Covariance of the wrench that the same errors of the sums leave, shape (4, 4).

    That of friction may be along any direction, and turn as much as friction could at most.
    """
    assert field.directions is not None
    press = field.normal @ field.directions
    out = np.diag([(_FRICTION_ERROR * field.total_friction) ** 2] * 3 + [0.0])
    out[:3, :3] += _NORMAL_ERROR**2 * np.outer(press, press)
    out[3, 3] = (_FRICTION_ERROR * mu * torsion(field)[2]) ** 2
    return out
