"""Read-outs: what was learned from the node model's own histories, as data.

What a frame's marker pairs do is written as few numbers, the codes a: shifts y = m + U·a + noise. A
small network reads ΣFn, ΣFf and µ off the codes and the noise in them, a second one how far it may
be wrong. So it is a regression on everything that tissue, object and the history of a grip can do
together, which no prior on single forces knows. Snapshots of the chain travel with it: from what
they do to markers that sit elsewhere than designed, m and U of each specimen follow.
"""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from ....errors import UserError
from ....render import SensorDesign

Array = NDArray[np.float64]
Layers = tuple[tuple[Array, Array], ...]

#: ΣFn at which its scale turns from linear to logarithmic [N].
BEND = 0.4
#: Largest change of a marker's log size that is read.
_SIZE_CHANGE = 0.1
#: Arrays of more numbers are written short.
_MANY = 5000
_NETWORKS = ("totals", "deviations", "shapes")


@dataclass(frozen=True, kw_only=True)
class ReadOut:
    """A trained read-out, of one kind of sensor.

    Attributes
    ----------
    tissue_stiffness: of the fingertip that it was trained on [N/m]
    design: sensor that it was trained on
    noise: standard deviation of the design's shifts, shape (6M,)
    mean: of the shifts over their noise, shape (6M,)
    rows: of the shifts over their noise, that of each code, shape (K, 6M)
    left: variance that the codes leave of the shifts over their noise, shape (6M,)
    modes: displacements of the chain [m], shape (P, N, 2)
    snapshots: of the chain, in modes, shape (S, P)
    codes: of those snapshots, the strongest first, shape (S, K)
    scale: standard deviation of each code with unit noise, shape (K,)
    rates: how fast codes change, relative to each other, shape (K,)
    linear: codes, noise and 1 to totals, the best linear read-out, shape (K + 2, 3)
    totals: network of what is missing from that
    deviations: network of the logarithm of the totals' variances
    shapes: network of the distributions of force
    normal_shapes, friction_shapes: modes of those, the mean first, shape (Q + 1, N)
    correlation: of the totals' errors, shape (3, 3)
    prior: standard deviation of µ before any image
    """

    tissue_stiffness: float
    design: SensorDesign
    noise: Array
    mean: Array
    rows: Array
    left: Array
    modes: Array
    snapshots: Array
    codes: Array
    scale: Array
    rates: Array
    linear: Array
    totals: Layers
    deviations: Layers
    shapes: Layers
    normal_shapes: Array
    friction_shapes: Array
    correlation: Array
    prior: float


def limited(shifts: Array) -> Array:
    """Shifts (…, 6M) whose changes of log size are limited.

    A disc that turns its side on a sharp object nearly vanishes: no code is worth spending on it.
    """
    out = np.array(shifts).reshape(*np.shape(shifts)[:-1], -1, 3)
    out[..., 2] = np.clip(out[..., 2], -_SIZE_CHANGE, _SIZE_CHANGE)
    return out.reshape(np.shape(shifts))


def forward(layers: Layers, x: Array) -> Array:
    """Output of a network of rectified linear units, for inputs (…, I)."""
    for weights, bias in layers[:-1]:
        x = np.maximum(x @ weights + bias, 0.0)
    weights, bias = layers[-1]
    return x @ weights + bias


def slope(layers: Layers, x: Array) -> Array:
    """Derivative of the output by the input (O, I), at one input (I,)."""
    open_units = []
    for weights, bias in layers[:-1]:
        x = x @ weights + bias
        open_units.append(x > 0.0)
        x = np.maximum(x, 0.0)
    through = layers[-1][0].T
    for (weights, _), units in zip(layers[-2::-1], open_units[::-1], strict=True):
        through = (through * units) @ weights.T
    return through


def save_readout(readout: ReadOut, path: Path) -> None:
    """Write a read-out as single-precision arrays."""
    values = dict(vars(readout))
    design = np.frombuffer(msgspec.json.encode(values.pop("design")), dtype=np.uint8)
    for name in _NETWORKS:
        for k, (weights, bias) in enumerate(values.pop(name)):
            values[f"{name}_{k}_weights"], values[f"{name}_{k}_bias"] = weights, bias
    # Half of single precision is plenty for what is many numbers.
    short = {
        name: np.asarray(value, dtype=np.float16 if np.size(value) > _MANY else np.float32)
        for name, value in values.items()
    }
    with path.open("wb") as file:
        np.savez_compressed(file, design=design, **short)  # type: ignore[arg-type]


@lru_cache(maxsize=4)
def load_readout(path: Path) -> ReadOut:
    """Read a read-out.

    Raises
    ------
    UserError
        When the file is none.
    """
    try:
        with np.load(path) as file:
            design = msgspec.json.decode(file["design"].tobytes(), type=SensorDesign)
            names = [name for name in file.files if name != "design"]
            values = {name: file[name].astype(float) for name in names}
        networks = {
            name: tuple(
                (values.pop(f"{name}_{k}_weights"), values.pop(f"{name}_{k}_bias"))
                for k in range(sum(key.startswith(f"{name}_") for key in values) // 2)
            )
            for name in _NETWORKS
        }
        numbers = {name: float(values.pop(name)) for name in ("tissue_stiffness", "prior")}
        return ReadOut(design=design, **values, **networks, **numbers)  # type: ignore[arg-type]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UserError(f"{path} is not a trained read-out: {error}") from None
