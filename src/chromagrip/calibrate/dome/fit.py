"""Least squares on known presses of a dome: its silicone, and what is not known of each press.

The unknowns of the silicone are x: core, Poisson's ratio, depths of the layers in it, ln E, and the
gains of the markers' places and sizes, each as its distance from the design in prior standard
deviations. E scales all forces alike and moves no marker. A gain stands for what a tracker and the
linear silicone get wrong in all presses alike. What comes before ln E changes the elasticity, which
takes seconds to solve: those derivatives are taken on a coarse skin.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from msgspec.structs import replace as changed
from numpy.typing import NDArray

from ...model import ModelError
from ...tracking import SensorCalibration, Tracks
from ...tracking.forces import (
    CameraPose,
    SiliconeValues,
    silicone_names,
    silicone_of,
    with_silicone,
)
from ..presses import Press
from .pressing import OWN, Pressing

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Data:
    """Shifts of P pairs under K presses, W values of each.

    Attributes
    ----------
    presses: K of them
    shifts: (x, y, log size) of both layers since rest, shape (K, P, 6)
    visible: shape (K, P)
    tells: which of the six count
    weights: of the W values in all presses, inverse root of their covariance, (P, KW, KW)
    """

    presses: list[Press]
    shifts: Array
    visible: NDArray[np.bool_]
    tells: NDArray[np.int64]
    weights: Array

    def whitened(self, values: Array) -> Array:
        """Shifts (K, P, 6) in independent deviations, shape (P·K·W,)."""
        some = np.where(self.visible[..., None], values[..., self.tells], 0.0)
        by_pair = some.swapaxes(0, 1).reshape(len(self.weights), -1)
        return np.einsum("pij,pj->pi", self.weights, by_pair).ravel()


@dataclass(frozen=True, kw_only=True)
class Point:
    """A silicone and its presses, and what they would show.

    Attributes
    ----------
    x: of the silicone and two gains, shape (V + 2,)
    own: unknowns of each press, shape (K, 8)
    shifts: shape (K, P, 6)
    held: forces and torques at the design's Young's modulus, shape (K, 4)
    """

    x: Array
    own: Array
    shifts: Array
    held: Array


class SiliconeFit:
    """Fits one sensor's silicone.

    Parameters
    ----------
    nominal: calibration of the design
    rest: tracks of the unloaded sensor
    pose: of its camera
    data: of the presses

    Attributes
    ----------
    names: of the V values of the silicone, in the order of x; the last one is Young's modulus
    spread: their prior deviations and those of the gains, shape (V + 2,)
    """

    #: Highest ν.
    highest_ratio = 0.494
    #: Error of a known force as a share of it.
    force_share = 0.01
    #: Derivatives by the unknowns of a press are taken over so many of their units: nodes that
    #: begin to touch make a force jump.
    many_units = 5.0

    def __init__(
        self, nominal: SensorCalibration, rest: Tracks, pose: CameraPose, data: Data
    ) -> None:
        self.data, self._nominal, self._rest, self._pose = data, nominal, rest, pose
        design = silicone_of(nominal)
        assert design is not None
        self._design = design
        # Prior deviations: of thickness and depths as shares, of depths at least 0.05 mm, of ν and
        # of ln E.
        share, least_mm = 0.05, 0.05
        known = {
            "core_mm": share * 1e3 * nominal.sensor.dome.thickness,
            "poisson": 0.01,
            "magenta_depth_mm": max(share * design.magenta_depth_mm, least_mm),
            "yellow_depth_mm": max(share * (design.yellow_depth_mm or 0.0), least_mm),
            "young_kpa": 0.2,
        }
        self.names = silicone_names(nominal.sensor)
        gains = (0.02, 0.05)  # prior deviations for places and sizes
        self.spread = np.array([*(known[name] for name in self.names), *gains])
        #: Which of x is ln E.
        self._young = len(self.names) - 1
        self._pressing = self._supposed(np.zeros(len(self.spread)))

    def values(self, x: Array) -> SiliconeValues:
        """The silicone at x."""
        off = dict(zip(self.names, (self.spread * x).tolist(), strict=False))
        design, inner = self._design, self._design.yellow_depth_mm
        return SiliconeValues(
            core_mm=design.core_mm + off["core_mm"],
            young_kpa=design.young_kpa * math.exp(off["young_kpa"]),
            poisson=min(design.poisson + off["poisson"], self.highest_ratio),
            magenta_depth_mm=design.magenta_depth_mm + off["magenta_depth_mm"],
            yellow_depth_mm=None if inner is None else inner + off["yellow_depth_mm"],
        )

    def start(self) -> Point:
        """The design, each press at the place whose image is most like its picture."""
        owns = []
        for k, press in enumerate(self.data.presses):
            shown = np.zeros_like(self.data.shifts)
            shown[k] = self.data.shifts[k]
            target = self.data.whitened(shown)

            def alike(image: Array, k: int = k, target: Array = target) -> float:
                shown = np.zeros_like(self.data.shifts)
                shown[k] = image
                seen = self.data.whitened(shown)
                return float(seen @ target) / max(float(np.linalg.norm(seen)), 1e-9)

            owns.append(self._pressing.start(press, alike))
        return self._at(np.zeros(len(self.spread)), np.stack(owns))

    def settled(self, point: Point, rounds: int) -> Point:
        """Fit the unknowns of a point's presses, ln E and the gains again."""
        damping = 1e-3
        residual = self.residual(point)
        least_gain = 0.3  # smallest gain of a step, in squared deviations
        for _ in range(rounds):
            slopes = self._slopes(point)
            while damping < 1e3:
                moved = self._moved(point, _step(slopes, residual, damping))
                after = None if moved is None else self.residual(moved)
                if moved is not None and after is not None and after @ after < residual @ residual:
                    break
                damping *= 10.0
            else:
                return point
            gain = float(residual @ residual - after @ after)
            point, residual, damping = moved, after, max(0.1 * damping, 1e-6)
            if gain < least_gain:
                break
        return point

    def elastic_slopes(self, point: Point) -> Array:
        """Derivatives of the residual by what comes before ln E, shape (rows, V − 1)."""
        coarse = Point(**{**vars(point), **self._shown(self._supposed(point.x, True), point.own)})
        here, columns = self.residual(coarse), []
        for k, name in enumerate(self.names[:-1]):
            # Away from the edge of what ν may be.
            step = -1.0 if name == "poisson" else 1.0
            x = point.x.copy()
            x[k] += step
            there = replace(coarse, **self._shown(self._supposed(x, True), point.own))
            columns.append((self.residual(replace(there, x=coarse.x)) - here) / step)
        return np.stack(columns, axis=1)

    def stepped(self, point: Point, elastic: Array) -> tuple[Point, Array, NDArray[np.bool_]]:
        """One round over all unknowns.

        Parameters
        ----------
        elastic: see `elastic_slopes`

        Returns
        -------
        point: the next one
        covariance: of the V values of x, and of ln of the forces of the presses, as they are
            read off the markers and the gauge together, shape (V + K, V + K)
        held: which of the values the presses do not determine, shape (V,)
        """
        slopes = self._slopes(point)
        count, young = len(self.names), self._young
        whole = np.concatenate([elastic, slopes], axis=1)
        whole[self._prior_rows()[:young], np.arange(young)] = 1.0
        inverse = np.linalg.inv(whole.T @ whole)
        rows = np.zeros((count + len(point.own), whole.shape[1]))
        rows[:count, :count] = np.eye(count)
        rows[count:] = self.force_share * whole[self._force_rows()]
        covariance = rows @ inverse @ rows.T
        open_from = 0.8  # share of the prior deviation above which a value counts as undetermined
        held = np.sqrt(np.diag(covariance)[:count]) > open_from
        held[young] = False
        free = np.ones(whole.shape[1], np.bool_)
        free[:count] = ~held
        # What is not determined goes back to the design.
        step = np.zeros(whole.shape[1])
        step[:count][held] = -point.x[:count][held]
        residual = self.residual(point) + whole @ step
        step[free] = np.linalg.lstsq(whole[:, free], -residual, rcond=None)[0]
        longest = 2.0  # longest step of x [prior deviations]
        step[:young] = np.clip(step[:young], -longest, longest)
        x = point.x.copy()
        farthest = 4.0  # farthest x [prior deviations]
        x[:young] = np.clip(x[:young] + step[:young], -farthest, farthest)
        ratio = self.names.index("poisson")
        x[ratio] = min(x[ratio], (self.highest_ratio - self._design.poisson) / self.spread[ratio])
        self._pressing = self._supposed(x)
        moved = self._moved(replace(point, x=x), step[young:])
        if moved is None:
            moved = self._at(x, point.own)
        return moved, covariance, held

    def residual(self, point: Point) -> Array:
        """Residuals of the pictures, the forces and the priors, in standard deviations."""
        scaled = self.spread * point.x
        forces = point.held * math.exp(scaled[self._young])
        known = self.data.presses
        normal = np.array([press.normal for press in known])
        lateral = np.array([press.lateral for press in known])
        torque = np.array([press.torque for press in known])
        thickness = self._pressing.dome.thickness
        mean, deviation = self._prior(point.own)
        across = 0.02  # error of a force across the normal, as a share of the normal force
        torque_share = 0.05  # error of a torque over force times thickness
        return np.concatenate(
            [
                self.data.whitened(self.seen(point) - self.data.shifts),
                np.log(np.maximum(forces[:, 0], 1e-9) / normal) / self.force_share,
                (forces[:, 1] - lateral) / (across * normal),
                forces[:, 2] / (across * normal),
                (forces[:, 3] - torque) / (torque_share * normal * thickness),
                ((point.own - mean) / deviation).ravel(),
                point.x,
            ]
        )

    def seen(self, point: Point) -> Array:
        """Shifts as a tracker is to see them, shape (K, P, 6)."""
        place, size = (self.spread * point.x)[len(self.names) :]
        return point.shifts * (1.0 + np.tile([place, place, size], 2))

    def _prior(self, own: Array) -> tuple[Array, Array]:
        known = [self._pressing.prior(each) for each in own]
        return np.stack([mean for mean, _ in known]), np.stack([by for _, by in known])

    def _force_rows(self) -> NDArray[np.int64]:
        count = len(self.data.presses)
        return self.data.weights[..., 0].size + np.arange(count)

    def _prior_rows(self) -> NDArray[np.int64]:
        count = len(self.data.presses)
        first = self.data.weights[..., 0].size + count * (4 + OWN)
        return first + np.arange(len(self.spread))

    def _supposed(self, x: Array, coarse: bool = False) -> Pressing:
        """Presses on a dome of that elasticity, with the design's Young's modulus."""
        elastic = x.copy()
        elastic[self._young] = 0.0
        known = with_silicone(self._nominal, self.values(elastic))
        silicone = known.sensor.silicone
        # Pitch of the skin on which derivatives by the elasticity are taken, over the radius.
        coarse_pitch = 1 / 12
        if coarse and silicone is not None:
            dome = known.sensor.dome
            pitch = 1e3 * max(dome.spacing, coarse_pitch * dome.radius)
            sensor = changed(known.sensor, silicone=changed(silicone, pitch_mm=pitch))
            known = replace(known, sensor=sensor)
        return Pressing(known, self._rest, self._pose)

    def _shown(self, pressing: Pressing, own: Array) -> dict[str, Array]:
        """Predicted shifts of all presses, see `Point`."""
        each = [pressing(p, o) for p, o in zip(self.data.presses, own, strict=True)]
        return {"shifts": np.stack([s for s, _ in each]), "held": np.stack([h for _, h in each])}

    def _at(self, x: Array, own: Array) -> Point:
        return Point(x=x, own=own, **self._shown(self._pressing, own))

    def _moved(self, point: Point, step: Array) -> Point | None:
        """The point with ln E, gains and unknowns of its presses moved, if it can be there."""
        x, count = point.x.copy(), len(point.x) - self._young
        x[self._young :] += step[:count]
        own_step = step[count:].reshape(point.own.shape)
        own = point.own + self.many_units * self._pressing.units * own_step
        try:
            return self._at(x, self._pressing.limited(own))
        except ModelError:
            return None

    def _slopes(self, point: Point) -> Array:
        """Derivatives by ln E, gains and the presses' unknowns over their units, (rows, 3 + 8K)."""
        here = self.residual(point)
        first = len(point.x) - self._young
        columns = np.zeros((len(here), first + point.own.size))
        for k in range(first):
            x = point.x.copy()
            x[self._young + k] += 1e-3
            columns[:, k] = (self.residual(replace(point, x=x)) - here) / 1e-3
        units = self.many_units * self._pressing.units
        for k, press in enumerate(self.data.presses):
            for j in range(OWN):
                own, shifts, held = point.own.copy(), point.shifts.copy(), point.held.copy()
                own[k, j] += units[j]
                shifts[k], held[k] = self._pressing(press, own[k])
                there = replace(point, own=own, shifts=shifts, held=held)
                columns[:, first + OWN * k + j] = self.residual(there) - here
        return columns


def _step(slopes: Array, residual: Array, damping: float) -> Array:
    information = slopes.T @ slopes
    damped = information + damping * np.diag(np.diag(information))
    return -np.asarray(np.linalg.solve(damped, slopes.T @ residual), np.float64)


def fit_silicone(
    fit: SiliconeFit, point: Point, rounds: int, tell: Callable[[str], None]
) -> tuple[Point, Array, NDArray[np.bool_]]:
    """Best silicone, its covariance and what is undetermined, see `SiliconeFit.stepped`.

    Raises
    ------
    UserError
        When the contacts do not converge.
    """
    elastic = None
    # Change of the silicone in a round, in its deviations, at which it has been found.
    arrived = 0.2
    for number in range(1, rounds + 1):
        tell(f"elasticity, round {number} of at most {rounds}")
        if number < rounds or elastic is None:
            elastic = fit.elastic_slopes(point)
        before = point
        point, covariance, held = fit.stepped(point, elastic)
        point = fit.settled(point, 2)
        count = len(fit.names)
        spread = np.sqrt(np.diag(covariance)[:count])
        if (abs(point.x - before.x)[:count] < arrived * spread).all():
            break
    return point, covariance, held
