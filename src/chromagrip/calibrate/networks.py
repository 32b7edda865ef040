"""Training of a read-out: codes of the markers' shifts, and networks that read forces off them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..extras import need
from ..tracking import Z90, SensorCalibration
from ..tracking.forces.chain import (
    BEND,
    Layers,
    ReadOut,
    at_places,
    forward,
    network_inputs,
)
from .histories import Snapshots

Array = NDArray[np.float64]
#: In single or double precision.
Numbers = NDArray[np.floating]

#: Number of even codes of specimens that are exactly as designed …
CODES = 100
#: … and of those that variations add. Forces are read from both.
VARIED_CODES = 40
#: Number of odd codes: motion across the load's plane, and turns.
ODD_CODES = 30
#: Modes of the chain.
MODES = 60
#: Modes of the distribution of either force.
SHAPES = 12
#: Noise trained with, in units of a single frame's: from averages of many frames to compressed
#: pictures …
NOISE = (0.3, 4.0)
#: … and that of most snapshots.
USUAL_NOISE = (0.7, 1.3)
#: One in this many histories is held out from the networks' training; their errors are learned
#: from these.
HELD_OUT = 5
#: Units of the totals among which the network shares its effort.
_UNIT = np.array([0.5, 0.43, 0.63])
#: Units of the layers of the network that reads them: products of codes need depth.
_HIDDEN = (256, 256, 256)
#: Snapshots per step of the training.
_BATCH = 512
#: Learning rate at the start.
_RATE = 1.5e-3
#: Share of the lessons that lie within what counts as trained.
_HIGHEST = 0.9995
#: Mean of the logarithm of a squared normal deviate.
_LOG_SQUARE_MEAN = -1.27
#: Its standard deviation.
_LOG_SQUARE_DEVIATION = 2.22


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
    def odd(self) -> NDArray[np.bool_]:
        """Whether each field is odd."""
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
    history: NDArray[np.int64]


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
    white = [
        (np.stack([_at_design(one, odd, places) for one in part]) / noise)
        .reshape(len(part), -1)
        .astype(np.float32)
        for part, odd in ((designed - mean, False), (varied[0] - mean, False), (varied[1], True))
    ]
    own = _components(white[0], CODES)
    beside = white[1] - (white[1] @ own.T) @ own
    rows = np.concatenate([own, _components(beside, VARIED_CODES)])
    fields, strengths, left = [], [], np.zeros(mean.shape[:3])
    # Mean over φ of a square: half of each harmonic's but the zeroth.
    share = np.where(np.arange(mean.shape[-1]) == 0, 1.0, 0.5)
    odd_rows = _components(white[2], ODD_CODES)
    for part, shifts, axes in (
        (varied[0] - mean, white[1], rows),
        (varied[1], white[2], odd_rows),
    ):
        codes, flat = shifts @ axes.T, part.reshape(len(part), -1)
        # Where all markers are at the design's places the axes are orthonormal.
        unit = np.linalg.lstsq(codes, flat, rcond=None)[0]
        fields.append(unit.reshape(-1, *mean.shape))
        strengths.append((codes.astype(float) ** 2).mean(axis=0))
        missed = part - (codes @ unit).reshape(part.shape)
        left += (missed**2 @ share).mean(axis=0)
    even_codes = white[0] @ rows.T
    chain = instants.displacement.reshape(len(instants.displacement), -1).astype(float)
    modes = _components(chain, MODES)
    inputs = np.column_stack([even_codes, np.ones(len(even_codes))])
    shapes = []
    for forces in (instants.normal, instants.friction):
        shares = forces / instants.totals[:, :1]
        middle = shares.mean(axis=0)
        shapes.append(np.vstack([middle, _components(shares - middle, SHAPES)]))
    return Basis(
        noise=noise,
        frame=frame,
        mean=mean,
        fields=np.concatenate(fields),
        left=left,
        strength=np.concatenate(strengths),
        modes=modes.reshape(MODES, *instants.displacement.shape[1:]),
        amounts=np.linalg.lstsq(inputs, chain @ modes.T, rcond=None)[0],
        normal=shapes[0],
        friction=shapes[1],
    )


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
) -> tuple[ReadOut, dict[str, float]]:
    """Read-out of lessons, and its RMS errors on histories held out.

    Parameters
    ----------
    calibration: of the sensor that the lessons are of
    basis: that their codes are in
    lessons: to learn from
    ranges: that they span, for the file
    epochs: passes over all of them
    tell: called with the current step, for a progress line
    """
    count = lessons.codes.shape[1]
    scale = np.sqrt(basis.strength[:count] + 1.0)
    middle, spread = lessons.context.mean(axis=0), lessons.context.std(axis=0) + 1e-3
    make = partial(_inputs, np.random.default_rng(7), scale, (lessons.context - middle) / spread)
    learn = partial(_train, epochs, tell)
    totals, held = lessons.totals, lessons.history % HELD_OUT == 0
    # Relative errors count, not those of the hardest grips.
    target = np.column_stack([np.arcsinh(totals[:, :2] / BEND), np.log(totals[:, 2])])
    target = target.astype(np.float32)
    middle = target.mean(axis=0)

    def sums() -> tuple[Numbers, Numbers]:
        return make(lessons, ~held), (target[~held] - middle) / _UNIT

    network = learn("training sums and friction", _HIDDEN, sums)

    def errors() -> tuple[Numbers, Numbers]:
        x = make(lessons, held)
        read = middle + _UNIT * forward(network, x)
        wrong = _margins(target[held]) - _margins(read)
        return x, np.column_stack([target[held] - read, wrong])

    def shapes() -> tuple[Numbers, Numbers]:
        return make(lessons, ~held), lessons.shapes[~held]

    deviations, error, normalised = _fit_deviations(learn, errors)
    readout = ReadOut(
        tissue_stiffness=calibration.fingertip.tissue_stiffness,
        design=calibration.sensor,
        ranges=dict(ranges),
        mean=basis.mean,
        fields=basis.fields,
        left=basis.left,
        strength=basis.strength,
        modes=basis.modes,
        amounts=basis.amounts,
        context=np.stack([middle, spread, np.quantile(lessons.context, _HIGHEST, axis=0)]),
        reach=float(np.quantile(np.sqrt(((lessons.codes / scale) ** 2).mean(axis=1)), _HIGHEST)),
        targets=np.stack([middle, _UNIT]),
        totals=network,
        deviations=deviations,
        shapes=learn("training shapes", (96,), shapes, min(epochs, 15)),
        normal_shapes=basis.normal,
        friction_shapes=basis.friction,
        correlation=np.corrcoef(np.clip(normalised[:, :3], -5.0, 5.0).T),
        prior=float(target[:, 2].std()),
    )
    rms = np.sqrt((error**2).mean(axis=0))
    return readout, dict(zip(("normal", "friction_n", "mu", "margin"), rms.tolist(), strict=True))


def _inputs(
    rng: np.random.Generator,
    scale: Array,
    context: Array,
    lessons: Lessons,
    which: NDArray[np.bool_],
) -> Numbers:
    """Inputs of the networks: codes with new noise, and context."""
    codes, level = lessons.codes[which], lessons.level[which, None]
    noisy = codes + level * rng.standard_normal(codes.shape, dtype=np.float32)
    return network_inputs(scale, noisy, level, context[which]).astype(np.float32)


def _fit_deviations(
    learn: Callable[..., Layers], errors: Callable[[], tuple[Numbers, Numbers]]
) -> tuple[Layers, Numbers, Numbers]:
    """Network of the logarithm of the errors' variances, errors, and errors over deviations.

    Parameters
    ----------
    learn: trains a network
    errors: inputs and errors of the totals on histories held out, with new noise
    """

    def examples() -> tuple[Numbers, Numbers]:
        x, error = errors()
        return x, (np.log(error**2 + 1e-12) - _LOG_SQUARE_MEAN) / _LOG_SQUARE_DEVIATION

    unit = np.full(4, _LOG_SQUARE_DEVIATION)
    network = _scaled(learn("training errors", (64, 64), examples), unit)
    x, error = errors()
    deviation = np.exp(0.5 * forward(network, x))
    # So that nine in ten errors lie within Z90 deviations.
    widen = np.quantile(abs(error / deviation), 0.9, axis=0) / Z90
    weights, bias = network[-1]
    network = (*network[:-1], (weights, bias + 2.0 * np.log(widen)))
    return network, error, error / (deviation * widen)


def _margins(target: Numbers) -> Numbers:
    """Γ of (asinh(ΣFn/BEND), asinh(ΣFf/BEND), log µ), shape (S, 3) to (S,), between −1 and 1."""
    normal, friction = np.sinh(np.clip(target[:, 0], 0.02, 5.0)), np.sinh(target[:, 1])
    return np.clip(1.0 - abs(friction) / (np.exp(target[:, 2]) * normal), -1.0, 1.0)


def _scaled(layers: Layers, unit: Numbers) -> Layers:
    """Network whose outputs are multiplied by `unit`."""
    weights, bias = layers[-1]
    return (*layers[:-1], (weights * unit, bias * unit))


def _train(
    epochs: int,
    tell: Callable[[str], None],
    name: str,
    sizes: tuple[int, ...],
    examples: Callable[[], tuple[Numbers, Numbers]],
    most: int | None = None,
) -> Layers:
    """Network of rectified linear units; inputs and targets are made anew, with new noise."""
    network: Any = None
    epochs = min(epochs, most or epochs)
    for epoch in range(epochs):
        x, y = examples()
        network = network or need("sklearn.neural_network", "learn").MLPRegressor(
            hidden_layer_sizes=sizes,
            batch_size=min(_BATCH, len(x)),
            learning_rate_init=_RATE,
            alpha=1e-7,
            random_state=7,
        )
        network.partial_fit(x, y.astype(np.float32))
        # The steps shrink along a cosine.
        share = (epoch + 1) / epochs
        step = 0.5 * _RATE * (1.0 + np.cos(np.pi * share)) + 1e-6
        network._optimizer.learning_rate_init = step
        tell(f"{name}, {100 * share:.0f} %")
    return tuple(
        (weights.astype(np.float32), bias.astype(np.float32))
        for weights, bias in zip(network.coefs_, network.intercepts_, strict=True)
    )
