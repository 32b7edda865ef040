"""Statistics of the residual of a frame's shifts after the codes, which reveal unknown motions.

Noise is independent between pairs, whereas a motion that no code describes is smooth. So the
residual of each layer and component is split into a smooth part, spanned by a few functions of the
place, and the rest.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Angles from the apex at which the functions peak [°].
_PEAKS_DEG = (0.0, 12.0, 24.0, 38.0, 55.0, 75.0)
#: Number of harmonics of φ, from the zeroth.
_HARMONICS = 4
#: Number of statistics: a smooth and a rough part for each layer and component.
STATISTICS = 12
#: Share of the noise's variance that is added before a logarithm, as a lower bound.
_LEAST = 0.01


@dataclass(frozen=True, kw_only=True)
class Smooth:
    """F orthonormal functions at the places of P pairs, shape (F, P)."""

    functions: NDArray[np.float32]

    def statistics(self, residual: NDArray[np.floating], used: NDArray[np.bool_]) -> Array:
        """Logarithms of the mean squares of both parts, shape (…, STATISTICS).

        Parameters
        ----------
        residual: whitened residuals, 0 where a pair is not used, shape (…, P, 6)
        used: whether each pair is used, shape (…, P)
        """
        smooth = self.functions @ residual
        in_smooth = (smooth**2).sum(axis=-2)
        whole = (residual**2).sum(axis=-2)
        share = used.mean(axis=-1, keepdims=True)
        count, pairs = self.functions.shape
        rough = np.maximum(whole - in_smooth, 0.0) / ((pairs - count) * share)
        parts = np.concatenate([in_smooth / (count * share), rough], axis=-1)
        return np.asarray(np.log(parts + _LEAST), dtype=float)


def smooth_functions(places: Array) -> Smooth:
    """Make the functions for P pairs at places (P, 2), see `fields`."""
    theta, phi = places.T
    peaks = np.deg2rad(_PEAKS_DEG)
    hats = np.stack([np.interp(theta, peaks, row) for row in np.eye(len(peaks))])
    waves = [np.ones_like(phi)]
    for m in range(1, _HARMONICS):
        waves += [np.cos(m * phi), np.sin(m * phi)]
    products = np.concatenate([hats * wave for wave in waves])
    # Near the axis azimuth has no meaning: there the products are nearly dependent.
    u, s, _ = np.linalg.svd(products.T, full_matrices=False)
    return Smooth(functions=u[:, s > 1e-3 * s[0]].T.astype(np.float32))
