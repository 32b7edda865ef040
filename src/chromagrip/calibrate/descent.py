"""Networks of rectified linear units, fitted by Adam in single precision.

Examples are made batch by batch, each time with new noise, so that no array is as long as the
lessons. A general library would need them whole, and takes twice the time.
"""

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..tracking.forces.chain import Layers

Short = NDArray[np.float32]
#: Inputs and targets of examples of these numbers, each (B, …).
Examples = Callable[[NDArray[np.int64]], tuple[Short, Short]]

#: Examples of a step.
BATCH = 1024


def fit_network(
    rng: np.random.Generator,
    count: int,
    examples: Examples,
    sizes: tuple[int, ...],
    epochs: int,
    tell: Callable[[float], None],
) -> Layers:
    """Network with the least mean square error.

    Parameters
    ----------
    rng: of the first weights and of the order of examples
    count: of examples
    examples: makes some of them
    sizes: units of each hidden layer
    epochs: passes over all of them
    tell: called after each pass with the share that is done
    """
    x, y = examples(np.arange(min(count, 2)))
    widths = (x.shape[1], *sizes, y.shape[1])
    values = [
        (rng.standard_normal((n, m)) * math.sqrt(2.0 / n)).astype(np.float32)
        for n, m in pairwise(widths)
    ]
    values[-1] *= 0.1
    values += [np.zeros(m, dtype=np.float32) for m in widths[1:]]
    means, squares = ([np.zeros_like(value) for value in values] for _ in range(2))
    batches = -(-count // BATCH)
    step, layers = 0, len(sizes) + 1
    first_rate = 2e-3  # step size at the start; it falls along a cosine
    last_rate = 1e-3  # step size at the end, over that at the start
    # Decay of the means of slopes and of their squares in a step (Kingma and Ba 2015).
    decays = (0.9, 0.999)
    least_root = 1e-8  # added to the root of the mean square
    for epoch in range(epochs):
        for part in np.array_split(rng.permutation(count), batches):
            slopes = _slopes(values, layers, *examples(part))
            step += 1
            share = step / (epochs * batches)
            rate = first_rate * (
                last_rate + (1.0 - last_rate) * 0.5 * (1.0 + math.cos(math.pi * share))
            )
            rate *= math.sqrt(1.0 - decays[1] ** step) / (1.0 - decays[0] ** step)
            for value, slope, mean, square in zip(values, slopes, means, squares, strict=True):
                mean += np.float32(1.0 - decays[0]) * (slope - mean)
                slope *= slope
                square += np.float32(1.0 - decays[1]) * (slope - square)
                value -= np.float32(rate) * mean / (np.sqrt(square) + np.float32(least_root))
        tell((epoch + 1) / epochs)
    return tuple(zip(values[:layers], values[layers:], strict=True))


def _slopes(values: list[Short], layers: int, x: Short, y: Short) -> list[Short]:
    """Derivative of half the mean square error by each weight and bias."""
    outputs = [x]
    for k in range(layers):
        x = x @ values[k]
        x += values[layers + k]
        if k < layers - 1:
            np.maximum(x, np.float32(0.0), out=x)
            outputs.append(x)
    error = (x - y) / np.float32(len(y))
    slopes: list[Short] = [np.empty(0, dtype=np.float32)] * (2 * layers)
    for k in reversed(range(layers)):
        slopes[k], slopes[layers + k] = outputs[k].T @ error, error.sum(axis=0)
        if k:
            error = error @ values[k].T
            error *= outputs[k] > 0.0
    return slopes
