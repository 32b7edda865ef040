"""Derivatives of all whitened shifts by forces on nodes, and the products of these derivatives.

The products are computed once for each node that comes near a contact. A frame then only gathers
those of its zone.
"""

import numpy as np
from numpy.typing import NDArray

from ..marker_response import DomeResponse

Array = NDArray[np.float64]
Table = NDArray[np.float32]
Index = NDArray[np.int64]


class WhitenedMap:
    """Derivatives of one sensor's whitened shifts by forces, cached by node.

    The first unknowns are not forces, but common changes of all log sizes of a layer, due to focus
    or light.

    Parameters
    ----------
    response: response of the markers to forces
    whiten: matrices from each pair's shifts to independent values, shape (P, 6, 6)
    nodes: prepared nodes, shape (n,)
    most: largest number of nodes whose products are kept; above it all are computed again
    """

    #: Number of unknowns that are not forces.
    COMMON = 2

    def __init__(
        self, response: DomeResponse, whiten: Array, nodes: Index, most: int = 700
    ) -> None:
        self._most = most
        self._response = response
        self._whiten = whiten.astype(np.float32)
        self._empty()
        self.rows(nodes)

    def _empty(self) -> None:
        self._slot: dict[int, int] = {}
        self._nodes: list[int] = []
        pairs = len(self._whiten)
        # Log sizes are the third and the sixth value of a pair.
        common = np.zeros((self.COMMON, pairs, 6), np.float32)
        common[[0, 1], :, [2, 5]] = 1.0
        self._columns = self._whitened(common)
        self._gram = self._columns @ self._columns.T

    def rows(self, nodes: Index) -> Index:
        """Row indices of the unknowns of n nodes, (COMMON + 3n,); missing rows are computed."""
        missing = [int(node) for node in nodes if int(node) not in self._slot]
        if missing:
            if len(self._nodes) + len(missing) > self._most:
                self._empty()
                missing = [int(node) for node in nodes]
            self._make(np.array(missing, np.int64))
        slots = np.array([self._slot[int(node)] for node in nodes], np.int64)
        each = self.COMMON + 3 * slots[:, None] + np.arange(3)
        return np.concatenate([np.arange(self.COMMON), each.ravel()])

    def columns(self, rows: Index) -> Table:
        """Derivatives of the whitened shifts by unknowns, shape (len(rows), 6·P)."""
        return self._columns[rows]

    def products(self, rows: Index, weights: Array) -> Table:
        """Products of the derivatives of r unknowns, with a weight (P,) for each pair, (r, r)."""
        whole = self._gram[rows[:, None], rows]
        less = np.flatnonzero(weights < 1.0)
        if len(less):
            columns = self._columns.reshape(len(self._columns), -1, 6)
            missing = np.sqrt(1.0 - weights[less, None], dtype=np.float32)
            some = (columns[np.ix_(rows, less)] * missing).reshape(len(rows), -1)
            whole -= some @ some.T
        return whole

    def _make(self, nodes: Index) -> None:
        columns = self._response.of_nodes(nodes).reshape(3 * len(nodes), -1, 6)
        added = self._whitened(columns)
        whole = np.concatenate([self._columns, added])
        across = whole @ added.T
        old = len(self._columns)
        gram = np.empty((len(whole), len(whole)), np.float32)
        gram[:old, :old] = self._gram
        gram[:, old:] = across
        gram[old:, :old] = across[:old].T
        self._columns, self._gram = whole, gram
        for node in nodes:
            self._slot[int(node)] = len(self._nodes)
            self._nodes.append(int(node))

    def _whitened(self, shifts: Table) -> Table:
        """Whiten shifts (c, P, 6), shape (c, 6·P)."""
        turned = np.matmul(self._whiten, shifts.transpose(1, 2, 0))  # (P, 6, c)
        return np.ascontiguousarray(turned.transpose(2, 0, 1)).reshape(len(shifts), -1)
