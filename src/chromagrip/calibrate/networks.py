"""Training of a read-out: codes of what the markers do, and networks that read forces off them."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..extras import need
from ..model import Fingertip
from ..render import SensorDesign
from ..tracking.forces.chain.readout import BEND, Layers, ReadOut, forward
from .histories import Snapshots

Array = NDArray[np.float64]

#: Codes, modes of the chain, snapshots that travel with a read-out, modes of either force's shape.
CODES, MODES, KEPT, SHAPES = 100, 80, 300, 12
#: Noise trained with, in units of a single frame's: from averages of many frames to a poor camera.
NOISE = (0.3, 1.6)
#: Histories that the networks never see; errors are learned from them.
HELD_OUT = 5
_BATCH, _RATE = 512, 1.5e-3


@dataclass(frozen=True, kw_only=True)
class Basis:
    """How snapshots are written as few numbers.

    Attributes
    ----------
    noise: standard deviation of each shift, shape (D,)
    mean, rows: of the whitened shifts, principal components, shapes (D,) and (K, D)
    left: variance that the codes leave of the whitened shifts, shape (D,)
    scale: standard deviation of each code with unit noise, shape (K,)
    normal, friction: modes of either force over ΣFn, the mean first, shape (Q + 1, N)
    seen, shifts: the chain [m] and the shifts of some snapshots, shapes (S, N, 2) and (S, D)
    """

    noise: Array
    mean: Array
    rows: Array
    left: Array
    scale: Array
    normal: Array
    friction: Array
    seen: Array
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
        seen = self.rows @ white - rows @ white[lost]
        return np.linalg.solve(information, seen) * (1.0 + 1.0 / strength)

    def shapes(self, seen: Snapshots) -> Array:
        """Amounts of the modes of both forces, shape (S, 2Q)."""
        amounts = [
            (forces / seen.totals[:, :1] - modes[0]) @ modes[1:].T
            for forces, modes in ((seen.normal, self.normal), (seen.friction, self.friction))
        ]
        return np.concatenate(amounts, axis=1)


@dataclass(frozen=True, kw_only=True)
class Lessons:
    """What is learned from: of each snapshot its codes, forces' shapes, totals and history.

    Shapes (S, K), (S, 2Q), (S, 3) and (S,).
    """

    codes: Array
    shapes: Array
    totals: Array
    history: NDArray[np.int64]


def make_basis(seen: Snapshots, shifts: Array, noise: Array) -> Basis:
    """Basis of some thousand snapshots and their shifts (S, D)."""
    white = (shifts / noise).astype(np.float32)
    mean = white.mean(axis=0)
    _, values, rows = np.linalg.svd(white - mean, full_matrices=False)
    strength = values[:CODES].astype(float) / np.sqrt(len(white))
    missed = white - mean - (white - mean) @ rows[:CODES].T @ rows[:CODES]
    modes = []
    for forces in (seen.normal, seen.friction):
        over = forces / seen.totals[:, :1]
        middle = over.mean(axis=0)
        modes.append(
            np.vstack([middle, np.linalg.svd(over - middle, full_matrices=False)[2][:SHAPES]])
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
        seen=seen.seen[few].astype(float),
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
    """Read-out of lessons, and its RMS errors on histories that it has not seen.

    Parameters
    ----------
    fingertip: that the histories are of
    design: sensor that their markers are of
    basis: that their codes are in
    lessons: to learn from
    epochs: passes over all of them
    tell: is called with what is being done
    """
    rng = np.random.default_rng(7)
    codes, scale, totals_true = lessons.codes, basis.scale, lessons.totals
    held = lessons.history % HELD_OUT == 0
    target = np.column_stack([np.arcsinh(totals_true[:, 0] / BEND), totals_true[:, 1:]])
    known, told = codes[~held], target[~held]

    def inputs(clean: Array) -> Array:
        level = np.log(NOISE[0]) + np.log(NOISE[1] / NOISE[0]) * rng.random((len(clean), 1))
        noisy = clean + np.exp(level) * rng.standard_normal(clean.shape)
        return np.concatenate([noisy / scale, level], axis=1)

    first = inputs(known)
    linear = np.linalg.lstsq(_with_one(first), told, rcond=None)[0]
    left = (told - _with_one(first) @ linear).std(axis=0)

    def missing(x: Array, wanted: Array) -> Array:
        return (wanted - _with_one(x) @ linear) / left

    def train(sizes: tuple[int, ...], make: Callable[[], tuple[Array, Array]], what: str) -> Layers:
        return _train(sizes, make, epochs, lambda share: tell(f"{what}, {100 * share:.0f} %"))

    def for_totals() -> tuple[Array, Array]:
        x = inputs(known)
        return x, missing(x, told)

    totals = _scaled(train((320, 320), for_totals, "training sums and friction"), left)

    def errors() -> tuple[Array, Array]:
        x = inputs(codes[held])
        return x, target[held] - _with_one(x) @ linear - forward(totals, x)

    def for_deviations() -> tuple[Array, Array]:
        x, error = errors()
        # Mean and deviation of the logarithm of a squared normal deviate.
        return x, (np.log(error**2 + 1e-12) + 1.27) / 2.22

    deviations = _scaled(train((64, 64), for_deviations, "training errors"), np.full(3, 2.22))
    x, error = errors()
    sure = np.exp(0.5 * forward(deviations, x))
    # So that nine in ten errors lie within 1.645 deviations.
    widen = np.quantile(abs(error / sure), 0.9, axis=0) / 1.645
    weights, bias = deviations[-1]
    deviations = (*deviations[:-1], (weights, bias + 2.0 * np.log(widen)))

    def for_shapes() -> tuple[Array, Array]:
        return inputs(known), lessons.shapes[~held]

    u, s, rows = np.linalg.svd(basis.seen.reshape(len(basis.seen), -1), full_matrices=False)
    z = error / (sure * widen)
    readout = ReadOut(
        tissue_stiffness=fingertip.tissue_stiffness,
        design=design,
        noise=basis.noise,
        mean=basis.mean,
        rows=basis.rows,
        left=basis.left,
        modes=rows[:MODES].reshape(MODES, *basis.seen.shape[1:]),
        snapshots=(u * s)[:, :MODES],
        codes=basis.codes(basis.shifts),
        scale=scale,
        rates=scale**2,
        linear=linear,
        totals=totals,
        deviations=deviations,
        shapes=train((96,), for_shapes, "training shapes"),
        normal_shapes=basis.normal,
        friction_shapes=basis.friction,
        correlation=np.asarray(np.corrcoef(np.clip(z, -5.0, 5.0).T)),
        prior=float(target[:, 2].std()),
    )
    rms = np.sqrt((error**2).mean(axis=0))
    return readout, dict(zip(("normal", "friction_n", "mu"), rms.tolist(), strict=True))


def _with_one(x: Array) -> Array:
    return np.concatenate([x, np.ones((len(x), 1))], axis=1)


def _scaled(layers: Layers, unit: Array) -> Layers:
    """Network whose outputs are multiplied by `unit`."""
    weights, bias = layers[-1]
    return (*layers[:-1], (weights * unit, bias * unit))


def _train(
    sizes: tuple[int, ...],
    make: Callable[[], tuple[Array, Array]],
    epochs: int,
    progress: Callable[[float], None],
) -> Layers:
    """Network of rectified linear units; inputs and targets are made anew, with new noise."""
    network: Any = None
    for epoch in range(epochs):
        x, y = make()
        network = network or _regressor(sizes, min(_BATCH, len(x)))
        network.partial_fit(x.astype(np.float32), y.astype(np.float32))
        # The steps shrink along a cosine.
        share = (epoch + 1) / epochs
        step = 0.5 * _RATE * (1.0 + np.cos(np.pi * share)) + 1e-6
        network._optimizer.learning_rate_init = step
        progress(share)
    return tuple(
        (weights.astype(float), bias.astype(float))
        for weights, bias in zip(network.coefs_, network.intercepts_, strict=True)
    )


def _regressor(sizes: tuple[int, ...], batch: int) -> object:
    return need("sklearn.neural_network", "learn").MLPRegressor(
        hidden_layer_sizes=sizes, batch_size=batch, learning_rate_init=_RATE, alpha=1e-7,
        random_state=7,
    )  # fmt: skip
