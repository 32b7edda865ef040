"""Most probable forces on the nodes of a dome, from the whitened shifts of its markers.

Forces are those that the linear skin carries. Traction is smooth (a Gaussian process along the
skin) within a zone, and zero outside. Nodes that would be pulled leave the zone, nodes next to it
may join. The image is not linear in the forces: derivatives are those at rest, and residuals are
computed from the full image model.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from .....model import Dome
from .....model.dome import lattice
from ..marker_response import DomeResponse
from .map import WhitenedMap
from .settings import TractionFitSettings

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Table = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class Frame:
    """Shifts of all P pairs in a frame.

    Attributes
    ----------
    values: shifts (x, y, log size) of both layers, shape (P, 6)
    weights: weight of each pair; 0 for invisible ones, shape (P,)
    """

    values: Array
    weights: Array

    @property
    def count(self) -> int:
        """Number of independent values."""
        return max(6 * int((self.weights > 0.0).sum()), 1)


@dataclass(frozen=True, kw_only=True)
class Tractions:
    """Forces that explain a frame, with their covariance.

    Attributes
    ----------
    nodes: indices of the n nodes in contact, shape (n,)
    linear: forces that the linear skin carries on them [N], shape (n, 3)
    common: common change of all log sizes of each layer, shape (2,)
    factor: lower Cholesky factor of the information matrix of `common` and `linear`, shape
        (2 + 3n, 2 + 3n)
    weights: weight of each pair in it, shape (P,)
    misfit: mean squared residual of the shifts over their variance
    level: assumed variance of the noise over that of the tracker
    worst: largest median squared residual of a pair and its neighbours
    """

    nodes: Index
    linear: Array
    common: Array
    factor: Array
    weights: Array
    misfit: float
    level: float
    worst: float

    def spread(self, slopes: Array) -> Array:
        """Factor S of the covariance S·Sᵀ of k values with derivatives (k, n, 3) by `linear`."""
        whole = np.zeros((len(slopes), len(self.factor)))
        whole[:, len(self.common) :] = slopes.reshape(len(slopes), -1)
        half = scipy.linalg.solve_triangular(self.factor, whole.T, lower=True, check_finite=False)
        return math.sqrt(self.level) * np.asarray(half.T)


class TractionFit:
    """Fits tractions on one dome to the shifts of its markers.

    Parameters
    ----------
    dome: body
    response: response of its markers to forces
    beside: neighbours of each node, see `skin.neighbours`
    places: positions of the pairs on the skin at rest [m], shape (P, 3)
    noise: covariance of the pairs' shifts, shape (P, 6, 6)
    prepared: nodes whose products are computed at construction, shape (n,)
    settings: tuned parameters
    """

    def __init__(
        self,
        dome: Dome,
        response: DomeResponse,
        beside: Index,
        places: Array,
        noise: Array,
        prepared: Index,
        settings: TractionFitSettings,
    ) -> None:
        self._settings = settings
        nodes = lattice(dome)
        self._points, self._areas, self._outwards = nodes.points, nodes.areas, nodes.outwards
        self._beside = beside
        self._amplitude = settings.amplitude * dome.young
        self._length = settings.length * dome.radius
        self._response = response
        reach = settings.under * dome.spacing
        under = scipy.spatial.KDTree(self._points).query_ball_point(places, reach)
        self._below = [np.asarray(each, np.int64) for each in under]
        around = scipy.spatial.KDTree(places).query(places, k=min(settings.around, len(places)))[1]
        self._around = np.asarray(around, np.int64)
        self._noise = np.einsum("pii->pi", noise)
        self._whiten = np.linalg.inv(np.linalg.cholesky(noise))
        self._map = WhitenedMap(response, self._whiten, prepared)
        self._priors: dict[bytes, Array] = {}

    def frame(self, values: Array, seen: NDArray[np.bool_], noise: Array) -> Frame:
        """Make a Frame of shifts (P, 6), visible pairs (P,), and covariances of the shifts."""
        larger = (np.einsum("pii->pi", noise) / self._noise).mean(axis=1)
        weights = np.where(larger > self._settings.noisier, 1.0 / np.maximum(larger, 1.0), 1.0)
        return Frame(
            values=np.where(seen[:, None], values, 0.0), weights=np.where(seen, weights, 0.0)
        )

    def cost(self, frame: Frame) -> float:
        """Sum of squares of the whitened shifts, without common changes of size."""
        residual = self._whitened(frame.values)
        rows = np.arange(WhitenedMap.COMMON)
        columns = self._map.columns(rows).astype(np.float64)
        weights = np.repeat(frame.weights * self._odd(residual), 6)
        information = (columns * weights) @ columns.T + np.eye(len(rows)) / self._settings.focus**2
        moment = columns @ (weights * residual)
        return float(weights @ residual**2 - moment @ np.linalg.solve(information, moment))

    def touched(self, frame: Frame, clearly: bool = False) -> bool:
        """Whether some group of neighbouring pairs has moved more than noise explains."""
        settings = self._settings
        most = float(self._energy(frame).max())
        return most > (settings.clearly if clearly else settings.touched)

    def _energy(self, frame: Frame) -> Array:
        """Median squared shift of each pair and its neighbours, over that of noise, (P,)."""
        values, seen = frame.values.copy(), frame.weights > 0.0
        values[:, [2, 5]] -= np.median(values[seen][:, [2, 5]], axis=0)
        shifts = self._whitened(values).reshape(-1, 6)
        energy = frame.weights * (shifts**2).sum(axis=1)
        # Most pairs are far from a contact, unless the whole dome is in one.
        usual = max(min(float(np.median(energy[seen])), 6.0), 1e-9)
        return _medians(energy[self._around]) / usual

    def fit(self, frame: Frame, start: Tractions | None) -> Tractions | None:
        """Fit forces to a frame; None if no node is pressed.

        Parameters
        ----------
        start: forces of the previous frame; None: start from rest
        """
        settings = self._settings
        if start is None:
            nodes = self._under(frame)
            linear, common = np.zeros((len(nodes), 3)), np.zeros(WhitenedMap.COMMON)
        else:
            nodes, linear, common = start.nodes, start.linear, start.common
        misfit = math.inf
        for turn in range(settings.few_rounds if start is not None else settings.rounds):
            changes = settings.changes if start is None else 1 if turn else settings.few_changes
            found, moved = self._round(frame, nodes, linear, common, changes)
            if found is None or moved < settings.settled:
                break
            if turn and found.misfit > max(settings.stuck * misfit, settings.large):
                break
            misfit = found.misfit
            nodes, linear, common = found.nodes, found.linear, found.common
        if start is not None and found is not None and found.worst > settings.elsewhere:
            return self.fit(frame, None)
        return found

    def answer(self, found: Tractions, change: Array) -> Array:
        """Change of the forces (n, 3) that compensates a change of predicted shifts (P, 6)."""
        columns = self._map.columns(self._map.rows(found.nodes))
        weighted = np.repeat(found.weights, 6) * self._whitened(change)
        moment = columns @ weighted.astype(np.float32)
        solved = scipy.linalg.lapack.dpotrs(found.factor, moment.astype(np.float64), lower=1)[0]
        return -np.asarray(solved[WhitenedMap.COMMON :]).reshape(-1, 3)

    def _round(
        self, frame: Frame, nodes: Index, linear: Array, common: Array, changes: int
    ) -> tuple[Tractions | None, float]:
        """Make a Gauss–Newton step, in which nodes leave and join the zone.

        Parameters
        ----------
        changes: largest number of solutions, each for another zone

        Returns
        -------
        New forces, and norm of the change of the whitened shifts.
        """
        settings = self._settings
        residual = self._residual(frame, nodes, linear, common)
        weights = frame.weights * self._odd(residual)
        weighted = np.repeat(weights, 6) * residual
        misfit = float(weighted @ residual) / frame.count
        level = float(np.clip(misfit, settings.lowest_level, settings.highest_level))
        energy = frame.weights * (residual.reshape(-1, 6) ** 2).sum(axis=1)
        # Compute all products once, for the zone and its neighbours.
        wide = self._with_beside(nodes) if changes > 1 else nodes
        rows = self._map.rows(wide)
        products = self._map.products(rows, weights)
        before = np.zeros(len(rows), np.float32)
        before[_unknowns(np.searchsorted(wide, nodes))] = np.concatenate([common, linear.ravel()])
        moment = self._map.columns(rows) @ weighted.astype(np.float32) + products @ before
        moment = moment.astype(np.float64)
        zone, joined = np.searchsorted(wide, nodes), changes == 1
        for left in reversed(range(changes)):
            if len(zone) < settings.fewest_nodes:
                return None, 0.0
            some = _unknowns(zone)
            information = products[some[:, None], some].astype(np.float64)
            self._add_prior(information, wide[zone], level)
            factor, solved = _solved(information, moment[some])
            forces = solved[WhitenedMap.COMMON :].reshape(-1, 3)
            pressed = self._pressed(wide[zone], forces)
            if not left or (joined and pressed.all()):
                break
            if pressed.all():
                joined, after = True, self._joined(wide, zone, solved, moment, products, level)
                if len(after) == len(zone):
                    break
                zone = after
            else:
                zone = zone[pressed]
        change = -before
        change[some] += solved.astype(np.float32)
        found = Tractions(
            nodes=wide[zone], linear=forces, common=solved[: WhitenedMap.COMMON], factor=factor,
            weights=weights, misfit=misfit, level=level,
            worst=float(_medians(energy[self._around]).max()),
        )  # fmt: skip
        return found, math.sqrt(max(float(change @ products @ change), 0.0))

    def _pressed(self, nodes: Index, forces: Array) -> NDArray[np.bool_]:
        settings = self._settings
        pressure = self._pressure(nodes, forces)
        largest = pressure.max()
        along = np.linalg.norm(forces, axis=1) / self._areas[nodes]
        pulled = pressure < settings.least_pressure * largest
        weak = pressure < settings.weak_pressure * largest
        slippery = along > settings.largest_ratio * pressure
        return np.asarray(~(pulled | (weak & slippery)))

    def _with_beside(self, nodes: Index) -> Index:
        """Nodes and their neighbours."""
        if len(nodes) > self._settings.most_nodes:
            return nodes
        reached = np.zeros(len(self._points) + 1, np.bool_)
        reached[self._beside[nodes]] = True
        return np.flatnonzero(reached[:-1])

    def _joined(
        self, wide: Index, zone: Index, solved: Array, moment: Array, products: Table, level: float
    ) -> Index:
        """Add those neighbours to the zone that the residual of the shifts would press.

        Parameters
        ----------
        wide: nodes of the zone and their neighbours, shape (w,)
        zone: indices of the zone among them
        solved: common changes of size, and forces of the zone
        moment, products: right-hand side and information matrix for all of `wide`
        """
        others = np.setdiff1d(np.arange(len(wide)), zone, assume_unique=True)
        if not len(others):
            return zone
        count = WhitenedMap.COMMON
        some, free = _unknowns(zone), _unknowns(others)[count:]
        prior, forces = level * self._inverse(wide), solved[count:].reshape(-1, 3)
        left = moment[free] - products[free[:, None], some] @ solved.astype(np.float32)
        slope = left.reshape(-1, 3)
        slope -= prior[np.ix_(others, zone)] @ forces
        information = products[free[:, None], free].astype(np.float64)
        for k in range(3):
            information[k::3, k::3] += prior[np.ix_(others, others)]
        _, step = _solved(information, slope.ravel())
        pressure = self._pressure(wide[others], step.reshape(-1, 3))
        join = pressure > self._settings.joining * self._pressure(wide[zone], forces).max()
        return np.sort(np.concatenate([zone, others[join]]))

    def _pressure(self, nodes: Index, forces: Array) -> Array:
        return np.asarray(
            -np.einsum("ij,ij->i", forces, self._outwards[nodes]) / self._areas[nodes]
        )

    def _add_prior(self, information: Array, nodes: Index, level: float) -> None:
        """Add the prior to the information matrix of the shifts."""
        prior, count = level * self._inverse(nodes), WhitenedMap.COMMON
        for k in range(3):
            information[count + k :: 3, count + k :: 3] += prior
        information[np.arange(count), np.arange(count)] += level / self._settings.focus**2

    def _inverse(self, nodes: Index) -> Array:
        """Information matrix of the prior for one component of the forces [1/N²], (n, n)."""
        settings = self._settings
        key = nodes.tobytes()
        found = self._priors.pop(key, None)
        if found is None:
            points, areas = self._points[nodes], self._areas[nodes]
            alike = np.exp(
                -0.5 * scipy.spatial.distance.cdist(points, points, "sqeuclidean") / self._length**2
            )
            alike[np.diag_indices(len(nodes))] += settings.rough
            upper, _ = scipy.linalg.lapack.dpotri(scipy.linalg.lapack.dpotrf(alike)[0])
            found = np.triu(upper) + np.triu(upper, 1).T
            found /= self._amplitude**2 * np.outer(areas, areas)
            if len(self._priors) >= settings.kept_priors:
                del self._priors[next(iter(self._priors))]
        self._priors[key] = found
        return found

    def _residual(self, frame: Frame, nodes: Index, linear: Array, common: Array) -> Array:
        """Whitened residual of the shifts, shape (6·P,)."""
        left = frame.values - self._response(nodes, linear)
        left[:, [2, 5]] -= common
        return self._whitened(left)

    def _whitened(self, shifts: Array) -> Array:
        return np.asarray(np.einsum("pij,pj->pi", self._whiten, shifts).ravel())

    def _odd(self, residual: Array) -> Array:
        """Weight of each pair, (P,); less than 1 if its residual differs from its neighbours'.

        After motion of the contact, residuals are large but similar to those of neighbours.
        """
        size = np.sqrt((residual.reshape(-1, 6) ** 2).mean(axis=1))
        around = _medians(size[self._around[:, 1:]])
        odd = self._settings.odd * np.maximum(around, 1.0)
        return np.minimum(1.0, (odd / np.maximum(size, odd)) ** 2)

    def _under(self, frame: Frame) -> Index:
        """Nodes under the pairs that have moved most."""
        settings = self._settings
        energy = self._energy(frame)
        moved = np.flatnonzero(energy > max(settings.moved * float(energy.max()), settings.touched))
        moved = moved[np.argsort(-energy[moved], kind="stable")[: settings.most_pairs]]
        return np.unique(np.concatenate([self._below[pair] for pair in moved]))


def _medians(values: Array) -> Array:
    """Median of each row of k values, (n, k); ten times as fast as `np.median`."""
    ordered, half = np.sort(values, axis=1), values.shape[1] // 2
    if values.shape[1] % 2:
        return ordered[:, half]
    return 0.5 * (ordered[:, half - 1] + ordered[:, half])


def _unknowns(places: Index) -> Index:
    """Indices of the unknowns: common changes of size, and forces of the nodes at `places`."""
    each = WhitenedMap.COMMON + 3 * places[:, None] + np.arange(3)
    return np.concatenate([np.arange(WhitenedMap.COMMON), each.ravel()])


def _solved(information: Array, moment: Array) -> tuple[Array, Array]:
    """Lower Cholesky factor of the information, which is overwritten, and solution for a moment."""
    # LAPACK is called directly: wrappers cost as much as the factorisation of a small zone.
    factor, _ = scipy.linalg.lapack.dpotrf(information.T, lower=1, clean=1, overwrite_a=1)
    return factor, scipy.linalg.lapack.dpotrs(factor, moment, lower=1)[0]
