"""Force field from tracks on a dome, by fitting a simulated contact to them.

A yellow layer on the rigid core does not move, and one moving layer does not determine the force
on each node. It determines a contact: an object of two curvatures, its stiffness and friction, and
the path on which it was pressed, shifted and turned (`contact_state`). Other frames are refused.
"""

import math
from dataclasses import dataclass, replace

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
from .contact_starts import Rivals, Start, light_presses, other_objects, start_from_rest
from .contact_state import CURVES, FRICTION, MOVING, OBJECT
from .contact_way import sums_of
from .key_shifts import Key, Shifts
from .keys import Backoff, far_on, thinned
from .marker_response import DomeResponse
from .settings import ContactSettings
from .untouched import untouched_field

Array = NDArray[np.float64]

#: Indices of the log sizes of both layers among the values of a pair.
_SIZES = (2, 5)
#: Reason for which a frame is refused.
_UNLIKE = "no contact of a smooth, convex object explains the markers"


@dataclass(frozen=True, kw_only=True)
class Memory:
    """State of a grasp from frame to frame.

    Attributes
    ----------
    rivals: starts next to the solutions
    refits: interval from one refit of the object to the next
    doubtful: misfit above which other objects are tried
    last: solution of the last key frame; None without a contact
    now: contact in the last frame
    covariance: covariance of ln ΣFn, ΣFf, ln µ and the wrench in the last key frame, shape (7, 7)
    searches: interval from one search of a contact to the next, while none is found
    refused: shifts of the last frame that was searched, if no contact explained it
    odd: whether the last fitted object has no supported shape; it is still tracked, as it may get
        one again
    """

    rivals: Rivals
    refits: Backoff
    searches: Backoff
    doubtful: float
    last: Solution | None = None
    now: Followed | None = None
    covariance: Array | None = None
    refused: Shifts | None = None
    odd: bool = False


class ContactReading:
    """Estimates forces from the tracks of one dome by a fitted contact, frame after frame.

    Parameters
    ----------
    calibration: calibration of the sensor
    rest: tracks of the unloaded sensor
    settings: tuned parameters

    Raises
    ------
    UserError
        For a sensor without silicone, or a pad.
    """

    _memory: Memory

    def __init__(
        self,
        calibration: SensorCalibration,
        rest: Tracks,
        settings: ContactSettings = ContactSettings(),
    ) -> None:
        dome = calibration.sensor.round_dome("reconstructor contact")
        self.dome, self._settings = dome, settings
        self._shifts = MarkerShifts(calibration, rest, math.pi / 2)
        sensor = self._shifts.sensor
        self._response = DomeResponse(sensor, dome, self._shifts.places)
        self._fit = ContactFit(dome, self._response, settings.fit)
        place, size = settings.place_error_px, settings.size_error
        self._error = np.diag(np.tile([place, place, size], 2) ** 2)
        # A layer on the core does not move.
        moving = np.array(layer_depths(sensor, dome)) < (1.0 - ON_CORE) * dome.thickness
        self._moving = np.repeat(moving, 3)
        # They depend on the dome alone: made here, the first frame of a contact is not late.
        self._presses = light_presses(self._fit, settings.starts)
        self.reset()

    def reset(self) -> None:
        """Forget previous frames: the next one is fitted from rest."""
        settings = self._settings
        self._memory = Memory(
            rivals=Rivals.from_first(settings.starts),
            refits=Backoff.from_first(1, settings.refit_every, settings.refit_patience),
            searches=Backoff.from_first(1, settings.search_every, settings.search_patience),
            doubtful=settings.doubtful,
        )

    def update(self, tracks: Tracks) -> ForceField:
        """Estimate the force field of a frame.

        Raises
        ------
        NoEstimateError
            When too few pairs are visible, and when no contact explains them.
        """
        shifts = self._read(tracks)
        nothing = shifts.cost(shifts.seen)
        if nothing < self._settings.untouched:
            self.reset()
            return untouched_field(self.dome, self._hidden(shifts) ** 2)
        if not self._explained(shifts):
            raise NoEstimateError(_UNLIKE)
        memory = self._memory
        if memory.odd:
            raise NoEstimateError(_UNLIKE)
        assert memory.last is not None
        assert memory.now is not None
        if not memory.now.contact.forces.any() or self._is_noise(memory.last, shifts, nothing):
            self.reset()
            return untouched_field(self.dome, self._hidden(shifts) ** 2)
        assert memory.covariance is not None
        return self._field(memory.last, memory.now.contact, memory.covariance)

    def _hidden(self, shifts: Shifts) -> float:
        """Standard deviation of a force hidden by noise [N]: the largest undetected press."""
        light = self._presses[0]
        seen = float(np.linalg.norm(shifts.apply(light.image[shifts.used])))
        return light.force * math.sqrt(self._settings.explained) / max(seen, 1e-9) / Z90

    def _explained(self, shifts: Shifts) -> bool:
        """Explain a frame by a contact; False if none does, or if it is too early to search again.

        A search, and a refit of an object that has no supported shape, takes longer than a frame
        lasts. While the contact stays refused, both become rarer.
        """
        refused = self._memory.refused
        if refused is not None:
            self._memory = replace(self._memory, searches=self._memory.searches.next_chance())
            if self._waits(shifts, refused):
                return self._kept(shifts)
        last = self._memory.last
        found = self._followed(shifts) or self._found(shifts)
        searches = self._memory.searches
        if not found:
            self.reset()
        if not found or self._memory.last is not last:
            good = found and not self._memory.odd
            refused, searches = None if good else shifts, searches.tried(better=good)
            self._memory = replace(self._memory, refused=refused, searches=searches)
        return found

    def _kept(self, shifts: Shifts) -> bool:
        """Follow a refused contact without a key frame; False if there is none to follow."""
        memory = self._memory
        if memory.last is None or memory.now is None:
            return False
        try:
            now, _ = self._fit.follow(memory.last.object_, memory.now, shifts)
        except UserError:
            return False
        self._memory = replace(memory, now=now)
        return True

    def _waits(self, shifts: Shifts, refused: Shifts) -> bool:
        """Whether markers have not moved since the last search, or moved little and not for long.

        Parameters
        ----------
        refused: shifts in the last search, which no contact explained
        """
        settings = self._settings
        before = np.zeros((len(refused.used), refused.values.shape[1]))
        before[refused.used] = refused.values
        both = refused.used[shifts.used, None]
        moved = shifts.apply((shifts.values - before[shifts.used]) * both)
        way = float(moved @ moved)
        same = way < settings.same * shifts.count and (shifts.used == refused.used).all()
        if same and self._memory.last is None:
            return True
        size = float(shifts.seen @ shifts.seen)
        return way < settings.changed * size and not self._memory.searches.due

    def _is_noise(self, solution: Solution, shifts: Shifts, nothing: float) -> bool:
        """Whether noise explains the first frame of a contact almost as well.

        Parameters
        ----------
        nothing: cost of the shifts without contact
        """
        if len(solution.keys) > 1:
            return False
        return nothing - solution.misfit * shifts.count < self._settings.explained

    def _followed(self, shifts: Shifts) -> bool:
        """Follow the contact of the previous frame; refit the object if it has moved far enough."""
        settings, memory = self._settings, self._memory
        if memory.last is None or memory.now is None:
            return False
        last = memory.last
        try:
            now, misfit = self._fit.follow(last.object_, memory.now, shifts)
        except UserError:
            return False
        if misfit < memory.doubtful and not far_on(self.dome, last.keys, now.pose, settings.keys):
            self._memory = replace(memory, now=now)
            return True
        keys = thinned(self.dome, (*last.keys, Key(shifts=shifts, pose=now.pose)), settings.keys)
        start = last.object_, keys
        try:
            kept, telling = self._fit.hold(last, keys, now)
        except UserError:
            return self._taken(self._better(None, start, settings.refit_rounds), start)
        solution, doubtful, refits = kept, kept.misfit > memory.doubtful, memory.refits
        if not doubtful and telling:
            refits = refits.next_chance()
        if doubtful or (telling and refits.due):
            solution = self._refitted(kept)
            refits = refits.tried(better=solution is not kept)
        rivals, rival = memory.rivals.next(self.dome, solution)
        if rival is not None:
            before, solution = solution, self._rival(solution, rival)
            rivals = rivals.tried(better=solution.cost < before.cost - settings.rival_gain)
        self._memory = replace(memory, refits=refits, rivals=rivals)
        return self._taken(solution, start)

    def _refitted(self, held: Solution) -> Solution:
        """Refit the object to the key frames of a solution; return the latter if none is better."""
        doubtful = held.misfit > self._memory.doubtful
        try:
            solution = self._fit.along_chord(held, doubtful)
        except UserError:
            solution = None
        if solution is None or solution.misfit > self._memory.doubtful:
            start, rival_of = (held.object_, held.keys), None if doubtful else held
            solution = self._better(solution, start, self._settings.refit_rounds, rival_of)
        return held if solution is None or solution.cost > held.cost else solution

    def _found(self, shifts: Shifts) -> bool:
        """Find the contact of a frame from rest."""
        start = start_from_rest(self._fit, self._presses, shifts, self._settings.starts)
        return self._taken(self._better(None, start, self._settings.rounds), start)

    def _taken(self, solution: Solution | None, start: Start) -> bool:
        """Accept a solution, or one from another object if it is doubtful; False if none fits."""
        settings = self._settings
        if solution is None or solution.misfit > self._memory.doubtful:
            for other in other_objects(self.dome, *start, settings.starts):
                solution = self._better(solution, other, settings.rounds)
        if solution is None or solution.misfit > settings.misfit:
            return False
        self._memory = replace(
            self._memory,
            last=solution,
            now=self._fit.last_of(solution),
            covariance=self._spread(solution),
            doubtful=max(settings.doubtful, settings.worse * solution.misfit),
            odd=self._unlike(solution),
        )
        return True

    def _unlike(self, solution: Solution) -> bool:
        """Whether an object is hollow or an edge, or contradicts markers near it."""
        settings = self._settings
        along_x, along_y, mixed = solution.object_[CURVES] * self.dome.radius
        mean, half = 0.5 * (along_x + along_y), math.hypot(0.5 * (along_x - along_y), mixed)
        own = np.diag(solution.covariance)[MOVING:][CURVES][:2].max()
        doubt = self.dome.radius * math.sqrt(own)  # a light touch hardly shows a shape
        if solution.odd_misfit > settings.unlike:
            return True
        # A hollow may be a soft plane: reject it only if the fit is bad.
        shaped = mean - half < settings.hollow - doubt or mean + half > settings.edge + doubt
        return shaped and solution.misfit > settings.shaped_misfit

    def _better(
        self,
        solution: Solution | None,
        start: Start,
        rounds: int,
        rival_of: Solution | None = None,
    ) -> Solution | None:
        """Fit from another start; return the better of both solutions."""
        try:
            other = self._fit.fit_keys(*start, rounds, rival_of)
        except UserError:
            return solution
        return other if solution is None or other.misfit < solution.misfit else solution

    def _rival(self, solution: Solution, start: Start) -> Solution:
        """Fit from the next rival if one is due; return the better of both solutions."""
        try:
            other = self._fit.fit_keys(*start, self._settings.rival_rounds, rival_of=solution)
        except UserError:
            return solution
        return other if other.misfit < solution.misfit else solution

    def _read(self, tracks: Tracks) -> Shifts:
        """Shifts of a frame, with their whitening matrices."""
        settings = self._settings
        values, certain = self._shifts(tracks, settings.least_markers)
        # Focus and light change all sizes equally; most markers are far from the contact.
        for size in _SIZES:
            values[:, size] -= np.median(values[certain, size])
        moving = np.flatnonzero(self._moving)
        noise = self._shifts.noise(tracks)[certain] + self._error
        # Imperfect markers and the linear silicone cause an error proportional to the motion.
        places = values[certain].reshape(-1, 2, 3)[:, :, :2]
        moved = np.linalg.norm(places, axis=-1).repeat(3, axis=1)
        moved[:, _SIZES] = 0.0
        noise[:, range(6), range(6)] += (settings.share_error * moved) ** 2
        noise = noise[:, moving[:, None], moving]
        whiten = np.zeros((len(noise), len(moving), len(self._moving)))
        whiten[:, :, moving] = np.linalg.inv(np.linalg.cholesky(noise))
        return Shifts(values=values[certain], whiten=whiten, used=certain, settings=settings.shifts)

    def _field(self, solution: Solution, contact: PosedContact, whole: Array) -> ForceField:
        """Force field of a contact.

        Parameters
        ----------
        whole: covariance of ln ΣFn, ΣFf, ln µ and the wrench, shape (7, 7)
        """
        settings = self._settings
        mu = math.exp(solution.object_[FRICTION])
        deviation = math.sqrt(whole[2, 2])
        sums = sums_of(contact)
        share = sums[1] / max(mu * sums[0], 1e-12)
        # Covariance of (ΣFn, ΣFf), and variance of Γ = 1 − ΣFf/(µ·ΣFn) with all correlations.
        scale = np.array([sums[0], 1.0])
        totals = whole[:2, :2] * np.outer(scale, scale)
        own = settings.normal_error * sums[0], settings.friction_error * sums[1]
        totals += np.diag([own[0] ** 2, own[1] ** 2])
        slope = np.array([share, -1.0 / max(mu * sums[0], 1e-12), share])
        spread = math.hypot(math.sqrt(float(slope @ whole[:3, :3] @ slope)), settings.margin_error)
        points = lattice(self.dome).points
        whole_skin = contact.everywhere(len(points))
        field = ForceField(
            position=points + whole_skin.displacement,
            normal=whole_skin.normal,
            friction=whole_skin.friction,
            contact=whole_skin.normal > settings.touching * max(contact.normal.sum(), 1e-9),
            totals_covariance=totals,
            directions=whole_skin.normals,
        )
        # Torsion causes slip, too.
        slips = margin_within(field, mu) < settings.observable_margin
        reading = FrictionReading(
            value=mu,
            deviation=mu * deviation,
            observable=deviation < settings.observed and slips,
            totals_covariance=tuple(mu * scale * whole[2, :2]),
            margin_deviation=spread,
            logarithmic=True,
        )
        return replace(
            field,
            friction_reading=reading,
            wrench_covariance=whole[3:, 3:] + _wrench_error(field, mu, settings),
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
        """Wrench of a contact: force along x, y, z [N] and torque about z [N·m], (…, 4)."""
        place = lattice(self.dome).points[contact.nodes] + contact.displacement
        turn = place[..., 0] * contact.forces[..., 1] - place[..., 1] * contact.forces[..., 0]
        return np.concatenate([contact.forces.sum(axis=-2), turn.sum(-1)[..., None]], axis=-1)


def _wrench_error(field: ForceField, mu: float, settings: ContactSettings) -> Array:
    """Covariance of the wrench due to the model errors of the sums, shape (4, 4).

    The error of friction may have any direction, and the largest torque that friction can hold.
    """
    assert field.directions is not None
    press = field.normal @ field.directions
    out = np.diag([(settings.friction_error * field.total_friction) ** 2] * 3 + [0.0])
    out[:3, :3] += settings.normal_error**2 * np.outer(press, press)
    out[3, 3] = (settings.friction_error * mu * torsion(field)[2]) ** 2
    return out
