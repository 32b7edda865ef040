"""Templates: the linearised model of each pair at its last full fit, kept until the pair moves.

A template holds the expected level of every pixel of a pair, its derivatives with respect to the
coverage by each layer, the normals of the edges, and the inverse information matrix of the pair's
unknowns. A frame then costs sixteen sums of products over the pixels: a step of the fit with the
derivatives of the template.
"""

import numpy as np
from numpy.typing import NDArray

from .kernels.run_lanes import BLOCK
from .kernels.template_kernels import UNKNOWNS, Pool

Array = NDArray[np.float64]


def empty_templates(pairs: int, neighbours: int, radius: float, rows: int) -> Pool:
    """Allocate templates, none of which is made yet.

    Parameters
    ----------
    pairs, neighbours: number of pairs, and of pairs that may come near each
    radius: radius of a marker with its blurred edge [px]
    rows: every `rows`-th row of the image is read
    """
    # Pixels of a pair over those of one marker; further pixels per row, as blocks are whole.
    room, spare = 1.6, 7.0
    lines = int(2.0 * room * radius / rows) + 2
    blocks = int((room * np.pi * radius**2 / rows + spare * lines) / BLOCK) + 1
    return Pool(
        levels=np.zeros((pairs, 3 * BLOCK * blocks), dtype=np.int16),
        tells=np.zeros((pairs, 10 * BLOCK * blocks), dtype=np.int8),
        units=np.zeros((pairs, 2)),
        runs=np.zeros((pairs, lines, 3), dtype=np.int32),
        counts=np.zeros((pairs, 2), dtype=np.int32),
        inverse=np.zeros((pairs, UNKNOWNS, UNKNOWNS), dtype=np.float32),
        fits=np.full((pairs, 2, 5), np.nan),
        gains=np.ones((pairs, 3)),
        slopes=np.zeros((pairs, 5)),
        lit=np.zeros((pairs, 2)),
        present=np.zeros((pairs, 2), dtype=np.bool_),
        misfit=np.full(pairs, np.inf),
        covariance=np.full((pairs, 9, 9), np.nan),
        seen=np.full((pairs, neighbours, 2, 2), np.nan, dtype=np.float32),
    )


#: Templates of no pair.
NO_TEMPLATES = empty_templates(0, 0, 0.0, 1)


def forget(pool: Pool, pairs: NDArray[np.bool_] | None = None) -> None:
    """Discard the templates of some pairs, shape (M,), or of all."""
    pool.counts[slice(None) if pairs is None else pairs, 0] = 0


def copied(pool: Pool) -> Pool:
    """Copy of all arrays of the templates."""
    return Pool._make(values.copy() for values in pool)
