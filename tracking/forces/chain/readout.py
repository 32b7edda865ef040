"""Read-outs: networks trained on simulated histories of the node model, stored as data.

The shifts of a frame's marker pairs are reduced to few coefficients, the codes a: y = m + U·a +
noise. A small network estimates ΣFn, ΣFf and µ from the codes, their noise and the statistics of
the residual; a second one estimates the errors of the first. The training covers tissue, object and
history of a grip together, which a prior on forces does not. The mean m and the patterns U are
fields over the dome, which are evaluated for each specimen and azimuth of the load.
"""

import zipfile
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from ....errors import UserError
from ....render import SensorDesign
from ....strange_files import array_names, read_arrays

Array = NDArray[np.float64]
#: Array in single or double precision.
Numbers = NDArray[np.floating]
#: Weights (I, O) and bias (O,) of each layer of a network; float32 in a read-out from a file.
Layers = tuple[tuple[Numbers, Numbers], ...]

#: ΣFn at which its scale changes from linear to logarithmic [N].
BEND = 0.4
#: Bound to which codes are clipped, in units of their scale.
LARGEST_CODE = 6.0
#: Bound to which changes of a marker's log size are clipped.
SIZE_CHANGE = 0.1
#: Fields of a read-out that are texts.
_TEXTS = ("design", "ranges")
#: Fields of a read-out that are networks.
_NETWORKS = ("totals", "deviations", "shapes")


@dataclass(frozen=True, kw_only=True)
class ReadOut:
    """A trained read-out for one kind of sensor, with K even and O odd codes.

    Attributes
    ----------
    tissue_stiffness: tissue stiffness of the fingertip used in training [N/m]
    design: sensor used in training
    ranges: ranges covered by the training, by name
    mean: mean field of the shifts, see `fields.FIELD`
    fields: fields of unit codes, the odd ones last, shape (K + O, …)
    left: residual variance of the shifts at each station [px², px², 1], shape (2, 3, T)
    strength: variance of each code in units of its noise, shape (K + O,)
    modes: Q displacement modes of the chain [m], shape (Q, N, 2)
    amounts: amplitudes of the modes per even code, and constant, shape (K + 1, Q)
    context: mean, standard deviation and maximum of the C statistics of a frame, shape (3, C)
    reach: largest size of the codes, see `size_of`
    sums: linear read-out of ΣFn and signed ΣFf from codes and 1 [N], shape (K + 1, 2)
    targets: mean and unit of the outputs of `totals`, shape (2, 3)
    totals: network for log µ, and for asinh(sum/BEND) of both sums minus the linear read-out
    deviations: network for the logarithms of the variances of the totals and of Γ
    shapes: network for the distributions of forces
    normal_shapes, friction_shapes: modes of these distributions, mean first, shape (Q + 1, N)
    correlation: correlation of the totals' errors, shape (3, 3)
    prior: standard deviation of log µ without an image
    """

    tissue_stiffness: float
    design: SensorDesign
    ranges: dict[str, object]
    mean: Array
    fields: Array
    left: Array
    strength: Array
    modes: Array
    amounts: Array
    context: Array
    reach: float
    sums: Array
    targets: Array
    totals: Layers
    deviations: Layers
    shapes: Layers
    normal_shapes: Array
    friction_shapes: Array
    correlation: Array
    prior: float

    @property
    def codes(self) -> int:
        """Number K of even codes, from which forces are estimated."""
        return len(self.amounts) - 1

    @property
    def odd(self) -> NDArray[np.bool_]:
        """Whether each field is odd, shape (K + O,)."""
        return np.arange(len(self.fields)) >= self.codes

    @cached_property
    def scale(self) -> Array:
        """Standard deviation of each even code including unit noise, shape (K,)."""
        return np.sqrt(self.strength[: self.codes] + 1.0)

    def size_of(self, codes: Numbers) -> Numbers:
        """RMS of even codes (…, K) over their scale, a measure of the skin's motion."""
        return np.sqrt(((codes / self.scale) ** 2).mean(axis=-1))

    def inputs(self, codes: Array, level: float, context: Array) -> Numbers:
        """Inputs of the networks for a frame, see `network_inputs`.

        Parameters
        ----------
        codes: even codes, shape (K,)
        level: noise of the weak codes
        context: statistics of the frame, shape (C,)
        """
        middle, spread = self.context[:2]
        return network_inputs(self.scale, self.sums, codes, level, (context - middle) / spread)

    def slope(self, codes: Array, by_input: Numbers) -> Array:
        """Derivatives (3, K) of the totals by the codes, from those by network inputs (3, I)."""
        count = self.codes
        straight = by_input[:, :count] * (abs(codes) < LARGEST_CODE * self.scale) / self.scale
        bent = by_input[:, count : 2 * count] / (np.hypot(codes, 2.0) * bent_scale(self.scale))
        base = (self.sums[:-1] / np.hypot(BEND, np.append(codes, 1.0) @ self.sums)).T
        slope = straight + bent + by_input[:, 2 * count : 2 * count + 2] @ base
        slope *= self.targets[1][:, None]
        slope[:2] += base
        return np.asarray(slope)

    @cached_property
    def rates(self) -> Array:
        """Relative rates of change of the even codes, shape (K,)."""
        return self.strength[: self.codes] + 1.0


def bent_scale(scale: Numbers) -> Numbers:
    """Scale of the asinh form of each code, see `network_inputs`."""
    return np.maximum(np.arcsinh(scale / 2.0), 1.0)


def linear_sums(sums: Numbers, codes: Numbers) -> Numbers:
    """Asinh(sum/BEND) of both sums by the linear read-out of codes (…, K), shape (…, 2)."""
    return np.arcsinh((codes @ sums[:-1] + sums[-1]) / np.asarray(BEND, dtype=codes.dtype))


def network_inputs(
    scale: Numbers, sums: Numbers, codes: Numbers, level: Numbers | float, context: Numbers
) -> Numbers:
    """Make the inputs of the networks, shape (…, 2K + 2 + 1 + C).

    Forces span three decades: each code is given in units of its scale, and also on a scale that is
    linear in the range of noise and logarithmic above.

    Parameters
    ----------
    scale: standard deviation of each code, shape (K,)
    sums: linear read-out of both sums, shape (K + 1, 2)
    codes: even codes, shape (…, K)
    level: noise of the weak codes, shape (…, 1) or a number
    context: statistics of the frame in units of their standard deviation, shape (…, C)
    """
    straight = np.clip(codes / scale, -LARGEST_CODE, LARGEST_CODE)
    bent = np.arcsinh(codes / 2.0) / bent_scale(scale)
    base = linear_sums(sums, codes)
    return np.concatenate([straight, bent, base, np.atleast_1d(np.log(level)), context], axis=-1)


def limited(shifts: Array) -> Array:
    """Clip the changes of log size in shifts (…, 6M) or (…, M, 6).

    A disc seen edge-on, on a sharp object, nearly vanishes; it must not dominate the codes.
    """
    limited = np.array(shifts, order="C")
    sizes = limited.reshape(-1, 3)[:, 2]
    np.clip(sizes, -SIZE_CHANGE, SIZE_CHANGE, out=sizes)
    return limited


def forward(layers: Layers, x: Numbers) -> Numbers:
    """Evaluate a ReLU network for inputs (…, I), in their precision."""
    for weights, bias in layers[:-1]:
        x = np.maximum(x @ weights + bias, 0.0)
    weights, bias = layers[-1]
    return x @ weights + bias


def linearised(layers: Layers, x: Numbers) -> tuple[Numbers, Numbers]:
    """Output (O,) of a network at one input (I,), and its Jacobian with respect to it (O, I)."""
    active = []
    for weights, bias in layers[:-1]:
        x = np.maximum(x @ weights + bias, 0.0)
        active.append(x > 0.0)
    weights, bias = layers[-1]
    derivative = weights.T
    for (before, _), units in zip(layers[-2::-1], active[::-1], strict=True):
        # One product after the other: for three outputs a library's product of matrices is slower.
        derivative = np.stack([before @ (row * units) for row in derivative])
    return x @ weights + bias, derivative


def save_readout(readout: ReadOut, path: Path) -> None:
    """Write a read-out as single-precision arrays."""
    values = {field.name: getattr(readout, field.name) for field in fields(readout)}
    texts = {
        name: np.frombuffer(msgspec.json.encode(values.pop(name)), dtype=np.uint8)
        for name in _TEXTS
    }
    for name in _NETWORKS:
        for k, (weights, bias) in enumerate(values.pop(name)):
            values[f"{name}_{k}_weights"], values[f"{name}_{k}_bias"] = weights, bias
    short = {
        # Large arrays are written in half precision.
        name: np.asarray(value, dtype=np.float16 if np.size(value) > 5000 else np.float32)
        for name, value in values.items()
    }
    with path.open("wb") as file:
        np.savez_compressed(file, **texts, **short)  # type: ignore[arg-type]


@lru_cache(maxsize=4)
def load_readout(path: Path) -> ReadOut:
    """Load a read-out; its networks are in single precision, in which they are evaluated.

    Raises
    ------
    UserError
        When the file cannot be read, or is not a read-out.
    """
    if path.is_file() and not zipfile.is_zipfile(path):
        raise UserError(f"{path} is not a trained read-out")
    names = array_names(path)
    absent = {f.name for f in fields(ReadOut)} - {*names, *_NETWORKS}
    if absent:
        raise UserError(f"{path} is not a trained read-out: it has no {min(absent)}")
    try:
        stored = read_arrays(path, names)
        design = msgspec.json.decode(stored.pop("design").tobytes(), type=SensorDesign)
        ranges = msgspec.json.decode(stored.pop("ranges").tobytes(), type=dict)
        networks = {name: _network(stored, name) for name in _NETWORKS}
        numbers = {name: float(stored.pop(name)) for name in ("tissue_stiffness", "reach", "prior")}
        arrays = {name: value.astype(float) for name, value in stored.items()}
        return ReadOut(design=design, ranges=ranges, **arrays, **networks, **numbers)  # type: ignore[arg-type]
    except UserError:
        raise
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise UserError(f"{path} is not a trained read-out: {error}") from None


def _network(stored: dict[str, Numbers], name: str) -> Layers:
    """Remove the layers of a network from the arrays of a file, and return them."""
    count = sum(key.startswith(f"{name}_") for key in stored) // 2
    return tuple(
        (
            stored.pop(f"{name}_{k}_weights").astype(np.float32),
            stored.pop(f"{name}_{k}_bias").astype(np.float32),
        )
        for k in range(count)
    )
