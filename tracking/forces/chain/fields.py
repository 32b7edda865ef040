"""Fields: shift of the markers per unit of a code, at every place and for any azimuth of the load.

A field is given in polar coordinates of the image: the shift away from the image's middle, the
shift along the circle around it, and the log size. Each is a function of θ at stations, times
harmonics of φ − ψ, with the azimuth ψ of the load. Fields that are mirror-symmetric to the load's
plane are even: radial shift and size have cos m(φ − ψ), the tangential shift has sin m(φ − ψ). In
odd fields sine and cosine are exchanged; they describe twist and motion across the plane.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Numbers = NDArray[np.floating]

#: Angles θ between which fields are linear [rad]: finer where objects touch. The axis is left out,
#: as it has no radial direction.
STATIONS = np.deg2rad(np.concatenate([np.linspace(0.1, 46.0, 41), np.linspace(48.8, 89.9, 16)]))
#: Number of harmonics of φ, from the zeroth.
HARMONICS = 4
#: Number of azimuths on each circle from which a field is computed.
CIRCLE = 16
#: Number of layers, and of components (radial, tangential, log size) of a field.
_LAYERS = 2
_COMPONENTS = 3
#: Shape of one field.
FIELD = (_LAYERS, _COMPONENTS, len(STATIONS), HARMONICS)


@dataclass(frozen=True, kw_only=True)
class Azimuths:
    """Harmonics of K fields at P pairs, from which the values for any azimuth follow.

    Attributes
    ----------
    amounts: amplitude of each of H harmonics at each pair's θ, shape (H, 2, 3, P, K)
    odd: whether each field is odd, shape (K,)
    phi: azimuth of each layer's markers [rad], shape (2, P)
    """

    amounts: NDArray[np.float32]
    odd: NDArray[np.bool_]
    phi: Array

    def at(self, azimuth: float) -> Array:
        """Shifts (x, y, log size) of both layers by each field, shape (P, 6, K).

        Parameters
        ----------
        azimuth: azimuth of the load [rad]
        """
        order = np.arange(HARMONICS)[:, None, None] * (self.phi - azimuth)
        cos, sin = np.cos(order).astype(np.float32), np.sin(order).astype(np.float32)
        total = np.zeros(self.amounts.shape[1:], dtype=np.float32)
        odd = np.searchsorted(self.odd, True)
        for m, part in enumerate(self.amounts):
            for fields, (first, second) in (
                (slice(None, odd), (cos[m], sin[m])),
                (slice(odd, None), (sin[m], cos[m])),
            ):
                total[:, ::2, :, fields] += part[:, ::2, :, fields] * first[:, None, :, None]
                total[:, 1, :, fields] += part[:, 1, :, fields] * second[:, :, None]
        along, across, size = np.moveaxis(total, 1, 0)
        c, s = np.cos(self.phi)[..., None], np.sin(self.phi)[..., None]
        shifts = np.stack([along * c - across * s, along * s + across * c, size], axis=2)
        layers, pairs, components, count = shifts.shape
        return shifts.transpose(1, 0, 2, 3).reshape(pairs, layers * components, count)


def at_places(fields: Numbers, odd: NDArray[np.bool_], places: Array) -> Azimuths:
    """Evaluate K fields (K, 2, 3, T, H), the odd ones last, at the places (2, P, 2) of pairs."""
    values = np.stack(
        [at_angles(fields[:, k], places[k, :, 0], axis=2) for k in range(_LAYERS)], axis=1
    )
    # From (K, 2, 3, P, H), move the fields to the last axis.
    amounts = np.ascontiguousarray(np.moveaxis(values, (4, 0), (0, 4)), dtype=np.float32)
    return Azimuths(amounts=amounts, odd=odd, phi=places[..., 1])


def at_angles(values: Numbers, theta: Array, axis: int) -> Array:
    """Interpolate values at STATIONS along an axis linearly at angles θ (P,) [rad]."""
    index = np.clip(np.searchsorted(STATIONS, theta, side="right") - 1, 0, len(STATIONS) - 2)
    share = (theta - STATIONS[index]) / np.diff(STATIONS)[index]
    shape = [1] * values.ndim
    shape[axis] = len(theta)
    share = np.clip(share, 0.0, 1.0).reshape(shape)
    low, high = (np.take(values, index + k, axis=axis).astype(float) for k in (0, 1))
    return np.asarray(low + share * (high - low))


def circle_places() -> Array:
    """Places (T·C, 2) at which `fields_on_circles` needs shifts."""
    theta, phi = np.meshgrid(STATIONS, 2.0 * np.pi * np.arange(CIRCLE) / CIRCLE, indexing="ij")
    return np.stack([theta.ravel(), phi.ravel()], axis=-1)


def fields_on_circles(shifts: Array) -> tuple[Array, Array]:
    """Even and odd fields (S, 2, 3, T, H) from shifts (S, T·C, 6) at `circle_places`."""
    phi = 2.0 * np.pi * np.arange(CIRCLE) / CIRCLE
    values = shifts.reshape(len(shifts), len(STATIONS), CIRCLE, _LAYERS, _COMPONENTS)
    x, y, size = np.moveaxis(values, -1, 0)
    c, s = np.cos(phi)[:, None], np.sin(phi)[:, None]
    polar = np.stack([x * c + y * s, y * c - x * s, size])  # (3, S, T, C, 2)
    order = np.arange(HARMONICS)[:, None] * phi
    weight = np.full(HARMONICS, 2.0 / CIRCLE)
    weight[0] = 1.0 / CIRCLE
    cos = np.einsum("kstcl,mc->slktm", polar, weight[:, None] * np.cos(order), optimize=True)
    sin = np.einsum("kstcl,mc->slktm", polar, weight[:, None] * np.sin(order), optimize=True)
    even, odd = cos.copy(), sin.copy()
    even[:, :, 1], odd[:, :, 1] = sin[:, :, 1], cos[:, :, 1]
    return even, odd
