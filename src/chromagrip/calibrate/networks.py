"""Training of a read-out: codes of the markers' shifts, and networks that read forces off them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from ..tracking import Z90, SensorCalibration
from ..tracking.forces.chain import (
    BEND,
    Layers,
    ReadOut,
    at_places,
    forward,
    network_inputs,
)
from .descent import Examples, fit_network
from .histories import Snapshots

Array = NDArray[np.float64]
#: In single or double precision.
Numbers = NDArray[np.floating]
Numbered = NDArray[np.int64]
Mask = NDArray[np.bool_]

#: Number of even codes of specimens that are exactly as designed …
CODES = 100
#: … and of those that variations add. Forces are read from both.
VARIED_CODES = 40
#: Number of odd codes: motion across the load's plane, and turns.
ODD_CODES = 30
#: Modes of the distribution of either force.
SHAPES = 12
#: Noise trained with, in units of a single frame's: from averages of many frames to compressed
#: pictures …
NOISE = (0.3, 4.0)
#: … and that of most snapshots.
USUAL_NOISE = (0.7, 1.3)
#: Units of the totals among which the network shares its effort.
_UNIT = np.array([0.25, 0.15, 0.6], dtype=np.float32)
#: Values of a basis that a read-out keeps.
_FIELDS = ("mean", "fields", "left", "strength", "modes", "amounts")


@dataclass(frozen=True, kw_only=True)
class NetworkSettings:
    """Tuned numbers of the training of a read-out's networks.

    Attributes
    ----------
    hidden: units of the layers of the network that reads the totals: products of codes need depth
    held_out: number of histories of which one is held out, for the networks of errors
    error_epochs: passes over the held-out lessons for each pass over the others
    shape_epochs: largest number of passes by which distributions of force are learned
    highest: share of the lessons that lie within the trained range
    """

    hidden: tuple[int, ...] = (256, 256, 256)
    held_out: int = 5
    error_epochs: int = 1
    shape_epochs: int = 10
    highest: float = 0.9995


@dataclass(frozen=True, kw_only=True)
class Basis:
    """Fields by which snapshots are written as few numbers.

    Attributes
    ----------
    noise: standard deviation of each shift of the design's pairs, floor included, shape (P, 6)
    frame: standard deviation of a frame's noise alone, shape (P, 6)
    mean: field, see `fields.FIELD`
    fields: of unit codes, the odd ones last, shape (K + O, …)
    left: variance that the codes leave at each station, shape (2, 3, T)
    strength: variance of each code, in units of its noise, shape (K + O,)
    modes: displacements of the chain [m], shape (Q, N, 2)
    amounts: of the modes with each even code and 1, shape (K + 1, Q)
    normal, friction: modes of either force over ΣFn, the mean first, shape (Q + 1, N)
    """

    noise: Array
    frame: Array
    mean: Array
    fields: Array
    left: Array
    strength: Array
    modes: Array
    amounts: Array
    normal: Array
    friction: Array

    @property
    def odd(self) -> Mask:
        """Odd fields, bool, one for each field."""
        return np.arange(len(self.fields)) >= len(self.amounts) - 1

    def shapes(self, instants: Snapshots) -> Array:
        """Amounts of the modes of both forces, shape (S, 2Q)."""
        fields = ((instants.normal, self.normal), (instants.friction, self.friction))
        amounts = [
            (forces / instants.totals[:, :1] - modes[0]) @ modes[1:].T for forces, modes in fields
        ]
        return np.concatenate(amounts, axis=1)


@dataclass(frozen=True, kw_only=True)
class Lessons:
    """Training data of S snapshots.

    Attributes
    ----------
    codes: even codes, with the noise of no frame, shape (S, K)
    level: noise of the frame, in units of the design's, shape (S,)
    context: statistics of the residual and the size of the odd codes, shape (S, C)
    shapes: amounts of the modes of both forces, shape (S, 2Q)
    totals: true ΣFn, signed ΣFf [N] and µ, shape (S, 3)
    history: number of the history, shape (S,)
    """

    codes: Array
    level: Array
    context: Array
    shapes: Array
    totals: Array
    history: Numbered


class Errors(TypedDict):
    """RMS errors of a read-out on histories held out, over all noise levels.

    Sums are asinh(force/BEND), relative where forces are large; µ is in logarithm, Γ is not.
    """

    normal: float
    friction: float
    mu: float
    margin: float


def make_basis(
    instants: Snapshots,
    designed: Array,
    varied: tuple[Array, Array],
    places: Array,
    noise: Array,
    frame: Array,
) -> Basis:
    """Basis of some thousand snapshots.

    Parameters
    ----------
    instants: the snapshots
    designed: fields of their shifts in a specimen that is exactly as designed, (S, 2, 3, T, H)
    varied: even and odd fields of their shifts under variations, each (S, 2, 3, T, H)
    places: of the design's pairs, shape (P, 2)
    noise, frame: standard deviations of their shifts, with the floor and without, shape (P, 6)
    """
    mean = designed.mean(axis=0)
    nominal, even, odd = (
        _whitened(part, is_odd, places, noise)
        for part, is_odd in ((designed - mean, False), (varied[0] - mean, False), (varied[1], True))
    )
    own = _components(nominal, CODES)
    axes = np.concatenate([own, _components(even - (even @ own.T) @ own, VARIED_CODES)])
    odd_axes = _components(odd, ODD_CODES)
    # Where all markers are at the design's places the axes are orthonormal.
    fields = [
        np.linalg.lstsq(white @ rows.T, part.reshape(len(part), -1), rcond=None)[0]
        for white, rows, part in ((even, axes, varied[0] - mean), (odd, odd_axes, varied[1]))
    ]
    codes = nominal @ axes.T
    missed = designed - mean - (codes @ fields[0]).reshape(designed.shape)
    # Mean over φ of a square: half of each harmonic's but the zeroth.
    share = np.where(np.arange(mean.shape[-1]) == 0, 1.0, 0.5)
    chain = instants.displacement.reshape(len(instants.displacement), -1).astype(float)
    mode_count = 60  # modes of the chain
    modes = _components(chain, mode_count)
    inputs = np.column_stack([codes, np.ones(len(codes))])
    return Basis(
        noise=noise,
        frame=frame,
        mean=mean,
        fields=np.concatenate(fields).reshape(-1, *mean.shape),
        left=(missed**2 @ share).mean(axis=0),
        strength=np.concatenate(
            [((white @ r.T) ** 2).mean(axis=0) for white, r in ((even, axes), (odd, odd_axes))]
        ),
        modes=modes.reshape(mode_count, *instants.displacement.shape[1:]),
        amounts=np.linalg.lstsq(inputs, chain @ modes.T, rcond=None)[0],
        normal=_distribution(instants, instants.normal),
        friction=_distribution(instants, instants.friction),
    )


def _distribution(instants: Snapshots, forces: Numbers) -> Array:
    """Mean and modes of forces (S, N) over ΣFn, shape (Q + 1, N)."""
    shares = forces / instants.totals[:, :1]
    middle = shares.mean(axis=0)
    return np.vstack([middle, _components(shares - middle, SHAPES)])


def _whitened(part: Array, odd: bool, places: Array, noise: Array) -> Array:
    """Shifts of the design's pairs over their noise (S, 6P), by fields (S, …)."""
    shifts = np.stack([_at_design(one, odd, places) for one in part]) / noise
    return shifts.reshape(len(part), -1)


def _components(values: Numbers, count: int) -> Array:
    """Principal components (count, D) of values (S, D)."""
    rows = np.linalg.eigh((values.T @ values).astype(float))[1]
    return np.asarray(rows[:, : -count - 1 : -1].T)


def _at_design(field: Array, odd: bool, places: Array) -> Array:
    """Shifts (P, 6) by one field (2, 3, T, H)."""
    at = at_places(field[None], np.array([odd]), np.stack([places] * 2))
    return at.at(0.0)[..., 0]


def fit_readout(
    calibration: SensorCalibration,
    basis: Basis,
    lessons: Lessons,
    ranges: Mapping[str, object],
    epochs: int,
    tell: Callable[[str], None],
    settings: NetworkSettings = NetworkSettings(),
) -> tuple[ReadOut, Errors]:
    """Train a read-out on lessons; returns it and its RMS errors on held-out histories.

    Parameters
    ----------
    calibration: calibration of the sensor of the lessons
    basis: basis of their codes
    lessons: training data
    ranges: ranges of the training data, for the file
    epochs: number of passes over the data
    tell: function called with the current step, for a progress line
    settings: tuned numbers of the training
    """
    context = lessons.context
    middle, spread = context.mean(axis=0), context.std(axis=0) + 1e-3
    scale = np.sqrt(basis.strength[: lessons.codes.shape[1]] + 1.0)
    held = lessons.history % settings.held_out == 0
    target = _targets(lessons.totals)
    course = _Course(
        lessons=replace(lessons, context=(context - middle) / spread),
        scale=scale.astype(np.float32),
        linear=_linear_sums(lessons, ~held),
        target=target,
        mean=np.array([0.0, 0.0, target[:, 2].mean()], dtype=np.float32),
        rng=np.random.default_rng(7),
    )

    learn = partial(_learn, tell)
    network = learn("sums and friction", ~held, epochs, course.sums, *settings.hidden)
    learn_errors = partial(learn, "errors", held, settings.error_epochs * epochs)
    errors = partial(course.errors, network)
    deviations, error, normalised = _fit_deviations(learn_errors, errors, np.flatnonzero(held))
    reach = np.sqrt(((lessons.codes / scale) ** 2).mean(axis=1))
    readout = ReadOut(
        tissue_stiffness=calibration.fingertip.tissue_stiffness,
        design=calibration.sensor,
        ranges=dict(ranges),
        context=np.stack([middle, spread, np.quantile(context, settings.highest, axis=0)]),
        reach=float(np.quantile(reach, settings.highest)),
        sums=course.linear.astype(float),
        targets=np.stack([course.mean, _UNIT]),
        totals=network,
        deviations=deviations,
        shapes=learn("shapes", ~held, min(epochs, settings.shape_epochs), course.shapes, 96),
        normal_shapes=basis.normal,
        friction_shapes=basis.friction,
        correlation=np.asarray(np.corrcoef(np.clip(normalised[:, :3], -5.0, 5.0).T)),
        prior=float(target[:, 2].std()),
        **{name: getattr(basis, name) for name in _FIELDS},
    )
    normal, friction, mu, margin = np.sqrt((error**2).mean(axis=0)).tolist()
    return readout, Errors(normal=normal, friction=friction, mu=mu, margin=margin)


def _learn(
    tell: Callable[[str], None],
    name: str,
    which: Mask,
    passes: int,
    examples: Examples,
    *sizes: int,
) -> Layers:
    """Network of these lessons, with hidden layers of these sizes."""
    numbers = np.flatnonzero(which)
    return fit_network(
        np.random.default_rng(7),
        len(numbers),
        lambda some: examples(numbers[some]),
        sizes,
        passes,
        lambda share: tell(f"training {name}, {100 * share:.0f} %"),
    )


@dataclass(frozen=True, kw_only=True)
class _Course:
    """Examples of every network.

    Attributes
    ----------
    lessons: their context in units of its deviation
    scale: standard deviation of each code with unit noise, shape (K,)
    linear: best linear read-out of both sums, shape (K + 1, 2)
    target: of each lesson, shape (S, 3)
    mean: of what the linear read-out does not read, shape (3,)
    rng: of the noise
    """

    lessons: Lessons
    scale: NDArray[np.float32]
    linear: NDArray[np.float32]
    target: Numbers
    mean: Numbers
    rng: np.random.Generator

    def inputs(self, some: Numbered) -> Numbers:
        """Inputs of some lessons: codes with new noise, and context."""
        lessons = self.lessons
        codes, level = lessons.codes[some], lessons.level[some, None]
        noisy = codes + level * self.rng.standard_normal(codes.shape, dtype=np.float32)
        return network_inputs(self.scale, self.linear, noisy, level, lessons.context[some])

    def base(self, x: Numbers) -> Numbers:
        """Linear estimate, from the inputs, to which the network's output is added."""
        count = 2 * len(self.scale)
        return self.mean + np.pad(x[:, count : count + 2], ((0, 0), (0, 1)))

    def sums(self, some: Numbered) -> tuple[Numbers, Numbers]:
        """Examples of the totals."""
        x = self.inputs(some)
        return x, (self.target[some] - self.base(x)) / _UNIT

    def errors(self, network: Layers, some: Numbered) -> tuple[Numbers, Numbers]:
        """Inputs, and errors of the totals and of Γ, (S, 4)."""
        x, target = self.inputs(some), self.target[some]
        read = self.base(x) + _UNIT * forward(network, x)
        return x, np.column_stack([target - read, _margins(target) - _margins(read)])

    def shapes(self, some: Numbered) -> tuple[Numbers, Numbers]:
        """Examples of the distributions of force."""
        return self.inputs(some), self.lessons.shapes[some]


def _linear_sums(lessons: Lessons, which: Mask) -> NDArray[np.float32]:
    """Linear read-out of ΣFn and ΣFf with the least relative error, shape (K + 1, 2)."""
    inputs = np.column_stack([lessons.codes[which], np.ones(which.sum(), dtype=np.float32)])
    light = 0.1  # force that is added to ΣFn before errors count relative to it [N]
    weight = 1.0 / (lessons.totals[which, :1] + light)
    weighted, target = inputs * weight, lessons.totals[which, :2] * weight
    # Each code has unit noise.
    noise = float((weight**2).sum()) * np.eye(inputs.shape[1])
    noise[-1, -1] = 0.0
    square = (weighted.T @ weighted).astype(float) + noise
    return np.linalg.solve(square, (weighted.T @ target).astype(float)).astype(np.float32)


def _targets(totals: Array) -> Numbers:
    """Asinh of ΣFn and ΣFf over BEND, and log µ, (S, 3): relative errors count."""
    sums = np.arcsinh(totals[:, :2] / BEND)
    return np.column_stack([sums, np.log(totals[:, 2])]).astype(np.float32)


def _fit_deviations(
    learn: Callable[..., Layers],
    errors: Callable[[Numbered], tuple[Numbers, Numbers]],
    unseen: Numbered,
) -> tuple[Layers, Numbers, Numbers]:
    """Network of the logarithm of the errors' variances, errors, and errors over deviations.

    Parameters
    ----------
    learn: fits a network to examples
    errors: inputs, and errors of the totals and of Γ, with new noise
    unseen: numbers of lessons of histories held out
    """
    log_square_mean = -1.27  # mean of the logarithm of a squared normal deviate
    log_square_deviation = 2.22  # its standard deviation

    def examples(some: Numbered) -> tuple[Numbers, Numbers]:
        x, error = errors(some)
        return x, (np.log(error**2 + 1e-12) - log_square_mean) / log_square_deviation

    network = _scaled(learn(examples, 64, 64), np.full(4, log_square_deviation, np.float32))
    x, error = errors(unseen)
    deviation = np.exp(0.5 * forward(network, x))
    # So that nine in ten errors lie within Z90 deviations.
    widen = np.quantile(abs(error / deviation), 0.9, axis=0) / Z90
    weights, bias = network[-1]
    network = (*network[:-1], (weights, bias + 2.0 * np.log(widen)))
    return network, error, error / (deviation * widen)


def _scaled(layers: Layers, unit: Numbers) -> Layers:
    """Network whose outputs are multiplied by `unit`."""
    weights, bias = layers[-1]
    return (*layers[:-1], (weights * unit, bias * unit))


def _margins(target: Numbers) -> Numbers:
    """Γ of (asinh(ΣFn/BEND), asinh(ΣFf/BEND), log µ), shape (S, 3) to (S,), between −1 and 1."""
    normal, friction = np.sinh(np.clip(target[:, 0], 0.02, 5.0)), np.sinh(target[:, 1])
    return np.clip(1.0 - abs(friction) / (np.exp(target[:, 2]) * normal), -1.0, 1.0)
