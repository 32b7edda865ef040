"""Training of a read-out: codes of the markers' shifts, and networks that read forces off them."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..extras import need
from ..model import Fingertip
from ..render import SensorDesign
from ..tracking import Z90
from ..tracking.forces.chain import BEND, Layers, ReadOut, forward
from .histories import Snapshots

Array = NDArray[np.float64]

#: Number of codes.
CODES = 100
#: Modes of the chain.
MODES = 80
#: Snapshots that are kept with a read-out.
KEPT = 300
#: Modes of the distribution of either force.
SHAPES = 12
#: Noise trained with, in units of a single frame's: from averages of many frames to a poor camera.
NOISE = (0.3, 1.6)
#: One in this many histories is held out from the networks' training; their errors are learned
#: from these.
HELD_OUT = 5
#: Snapshots per step of the training.
_BATCH = 512
#: Learning rate at the start.
_RATE = 1.5e-3
#: Mean of the logarithm of a squared normal deviate.
_LOG_SQUARE_MEAN = -1.27
#: Its standard deviation.
_LOG_SQUARE_DEVIATION = 2.22


@dataclass(frozen=True, kw_only=True)
class Basis:
    """Modes by which snapshots are written as few numbers.

    Attributes
    ----------
    noise: standard deviation of each shift, shape (D,)
    mean, rows: of the whitened shifts, principal components, shapes (D,) and (K, D)
    left: variance that the codes leave of the whitened shifts, shape (D,)
    scale: standard deviation of each code with unit noise, shape (K,)
    normal, friction: modes of either force over ΣFn, the mean first, shape (Q + 1, N)
    displacement, shifts: of the chain [m] and of the markers in some snapshots, shapes (S, N, 2)
        and (S, D)
    """

    noise: Array
    mean: Array
    rows: Array
    left: Array
    scale: Array
    normal: Array
    friction: Array
    displacement: Array
    shifts: Array

    def codes(self, shifts: Array) -> Array:
        """Codes (…, K) of shifts (…, D) without noise."""
        return (shifts / self.noise - self.mean) @ self.rows.T

    def codes_without(self, shifts: Array, lost: NDArray[np.int64]) -> Array:
        """Codes (K,) of shifts (D,) that leaves out some of them, as `Learned` reads them."""
        white = shifts / self.noise - self.mean
        strength = self.scale**2 - 1.0
        rows = self.rows[:, lost]
        information = np.eye(len(rows)) + np.diag(1.0 / strength) - rows @ rows.T
        moment = self.rows @ white - rows @ white[lost]
        return np.linalg.solve(information, moment) * (1.0 + 1.0 / strength)

    def shapes(self, instants: Snapshots) -> Array:
        """Amounts of the modes of both forces, shape (S, 2Q)."""
        fields = ((instants.normal, self.normal), (instants.friction, self.friction))
        amounts = [
            (forces / instants.totals[:, :1] - modes[0]) @ modes[1:].T for forces, modes in fields
        ]
        return np.concatenate(amounts, axis=1)


@dataclass(frozen=True, kw_only=True)
class Lessons:
    """Training data: of each snapshot its codes, shapes of the forces, totals and history.

    Shapes (S, K), (S, 2Q), (S, 3) and (S,).
    """

    codes: Array
    shapes: Array
    totals: Array
    history: NDArray[np.int64]


def make_basis(instants: Snapshots, shifts: Array, noise: Array) -> Basis:
    """Basis of some thousand snapshots, their shifts (S, D) and the shifts' noise (D,)."""
    white = (shifts / noise).astype(np.float32)
    mean = white.mean(axis=0)
    _, values, rows = np.linalg.svd(white - mean, full_matrices=False)
    strength = values[:CODES].astype(float) / np.sqrt(len(white))
    missed = white - mean - (white - mean) @ rows[:CODES].T @ rows[:CODES]
    modes = []
    for forces in (instants.normal, instants.friction):
        shares = forces / instants.totals[:, :1]
        middle = shares.mean(axis=0)
        modes.append(
            np.vstack([middle, np.linalg.svd(shares - middle, full_matrices=False)[2][:SHAPES]])
        )
    few = np.linspace(0, len(shifts) - 1, min(KEPT, len(shifts))).astype(int)
    return Basis(
        noise=noise,
        mean=mean.astype(float),
        rows=rows[:CODES].astype(float),
        left=missed.var(axis=0).astype(float),
        scale=np.sqrt(strength**2 + 1.0),
        normal=modes[0],
        friction=modes[1],
        displacement=instants.displacement[few].astype(float),
        shifts=shifts[few],
    )


def fit_readout(
    fingertip: Fingertip,
    design: SensorDesign,
    basis: Basis,
    lessons: Lessons,
    epochs: int,
    tell: Callable[[str], None],
) -> tuple[ReadOut, dict[str, float]]:
    """Read-out of lessons, and its RMS errors on histories held out.

    Parameters
    ----------
    fingertip: that the histories are of
    design: sensor that their markers are of
    basis: that their codes are in
    lessons: to learn from
    epochs: passes over all of them
    tell: called with the current step, for a progress line
    """
    noisy = partial(_noisy, np.random.default_rng(7), basis.scale)
    learn = partial(_train, epochs, tell)
    totals, held = lessons.totals, lessons.history % HELD_OUT == 0
    target = np.column_stack([np.arcsinh(totals[:, 0] / BEND), totals[:, 1:]])
    linear, network = _fit_totals(noisy, learn, lessons.codes[~held], target[~held])

    def errors() -> tuple[Array, Array]:
        x = noisy(lessons.codes[held])
        return x, target[held] - _with_one(x) @ linear - forward(network, x)

    def shapes() -> tuple[Array, Array]:
        return noisy(lessons.codes[~held]), lessons.shapes[~held]

    deviations, error, normalised = _fit_deviations(learn, errors)
    chain = basis.displacement
    u, s, rows = np.linalg.svd(chain.reshape(len(chain), -1), full_matrices=False)
    readout = ReadOut(
        tissue_stiffness=fingertip.tissue_stiffness,
        design=design,
        noise=basis.noise,
        mean=basis.mean,
        rows=basis.rows,
        left=basis.left,
        modes=rows[:MODES].reshape(MODES, *chain.shape[1:]),
        snapshots=(u * s)[:, :MODES],
        codes=basis.codes(basis.shifts),
        scale=basis.scale,
        rates=basis.scale**2,
        linear=linear,
        totals=network,
        deviations=deviations,
        shapes=learn("training shapes", (96,), shapes),
        normal_shapes=basis.normal,
        friction_shapes=basis.friction,
        correlation=np.asarray(np.corrcoef(np.clip(normalised, -5.0, 5.0).T)),
        prior=float(target[:, 2].std()),
    )
    rms = np.sqrt((error**2).mean(axis=0))
    return readout, dict(zip(("normal", "friction_n", "mu"), rms.tolist(), strict=True))


def _noisy(rng: np.random.Generator, scale: Array, codes: Array) -> Array:
    """Inputs of the networks (S, K + 1): codes with noise, over their scale, and its logarithm."""
    level = np.log(NOISE[0]) + np.log(NOISE[1] / NOISE[0]) * rng.random((len(codes), 1))
    noisy = codes + np.exp(level) * rng.standard_normal(codes.shape)
    return np.concatenate([noisy / scale, level], axis=1)


def _fit_totals(
    noisy: Callable[[Array], Array], learn: Callable[..., Layers], codes: Array, target: Array
) -> tuple[Array, Layers]:
    """Best linear read-out of the totals (K + 2, 3), and a network of the error that it leaves."""
    x = _with_one(noisy(codes))
    linear: Array = np.linalg.lstsq(x, target, rcond=None)[0].astype(float)
    unit = (target - x @ linear).std(axis=0)

    def examples() -> tuple[Array, Array]:
        x = noisy(codes)
        return x, (target - _with_one(x) @ linear) / unit

    return linear, _scaled(learn("training sums and friction", (320, 320), examples), unit)


def _fit_deviations(
    learn: Callable[..., Layers], errors: Callable[[], tuple[Array, Array]]
) -> tuple[Layers, Array, Array]:
    """Network of the logarithm of the errors' variances, errors, and errors over deviations.

    Parameters
    ----------
    learn: trains a network
    errors: inputs and errors of the totals on histories held out, with new noise
    """

    def examples() -> tuple[Array, Array]:
        x, error = errors()
        return x, (np.log(error**2 + 1e-12) - _LOG_SQUARE_MEAN) / _LOG_SQUARE_DEVIATION

    unit = np.full(3, _LOG_SQUARE_DEVIATION)
    network = _scaled(learn("training errors", (64, 64), examples), unit)
    x, error = errors()
    deviation = np.exp(0.5 * forward(network, x))
    # So that nine in ten errors lie within Z90 deviations.
    widen = np.quantile(abs(error / deviation), 0.9, axis=0) / Z90
    weights, bias = network[-1]
    network = (*network[:-1], (weights, bias + 2.0 * np.log(widen)))
    return network, error, error / (deviation * widen)


def _with_one(x: Array) -> Array:
    return np.concatenate([x, np.ones((len(x), 1))], axis=1)


def _scaled(layers: Layers, unit: Array) -> Layers:
    """Network whose outputs are multiplied by `unit`."""
    weights, bias = layers[-1]
    return (*layers[:-1], (weights * unit, bias * unit))


def _train(
    epochs: int,
    tell: Callable[[str], None],
    name: str,
    sizes: tuple[int, ...],
    examples: Callable[[], tuple[Array, Array]],
) -> Layers:
    """Network of rectified linear units; inputs and targets are made anew, with new noise."""
    network: Any = None
    for epoch in range(epochs):
        x, y = examples()
        network = network or need("sklearn.neural_network", "learn").MLPRegressor(
            hidden_layer_sizes=sizes,
            batch_size=min(_BATCH, len(x)),
            learning_rate_init=_RATE,
            alpha=1e-7,
            random_state=7,
        )
        network.partial_fit(x.astype(np.float32), y.astype(np.float32))
        # The steps shrink along a cosine.
        share = (epoch + 1) / epochs
        step = 0.5 * _RATE * (1.0 + np.cos(np.pi * share)) + 1e-6
        network._optimizer.learning_rate_init = step
        tell(f"{name}, {100 * share:.0f} %")
    return tuple(
        (weights.astype(float), bias.astype(float))
        for weights, bias in zip(network.coefs_, network.intercepts_, strict=True)
    )
