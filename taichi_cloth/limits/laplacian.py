"""The Laplacian of a network's springs, made once for all states in which the same springs hold.

Forces on triangles change its diagonal from state to state. Putting a sparse matrix together costs
as much as some tens of products with it, and only the numbers on the diagonal are new. They are
added and scaled as `matrices.laplacian` does it, entry by entry, and entries stay in the order that
they have there: so the bits of the matrix and of its products are those of one made anew.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.limits.matrices import edges_matrix, laplacian
from taichi_cloth.limits.network import Network

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix


class Laplacian:
    """M^-1/2 (Laplacian + diagonal) M^-1/2 among the f free particles, for one diagonal or another.

    network, weights: as `matrices.laplacian` takes them.
    """

    def __init__(self, network: Network, weights: np.ndarray) -> None:
        self._network, self._weights = network, weights
        self._free = ~network.particles.fixed
        self._scale = 1.0 / np.sqrt(network.particles.mass[self._free])
        self._edges = edges_matrix(network, weights)
        self._own = self._edges.diagonal()[self._free]
        self._last: csr_matrix | None = None  # one made anew, whose entries these are:
        self._there = np.zeros(0, bool)  # which particles have an entry on the diagonal
        self._on_diagonal: np.ndarray = np.zeros(0, np.int64)
        self._rows: np.ndarray = np.zeros(0, np.int64)
        self._columns: np.ndarray = np.zeros(0, np.int64)
        self._values = np.zeros(0)

    def with_diagonal(self, diagonal: np.ndarray) -> csr_matrix:
        """The matrix (f, f) with a diagonal (n,)."""
        from scipy import sparse

        added = diagonal[self._free]
        there = self._own + added != 0.0
        if self._last is None or not np.array_equal(there, self._there):
            return self._anew(diagonal, there)
        values = self._values.copy()
        values[self._on_diagonal] += added[self._rows[self._on_diagonal]]
        values = self._scale[self._rows] * values * self._scale[self._columns]
        last = self._last
        return sparse.csr_matrix((values, last.indices, last.indptr), shape=last.shape)

    def _anew(self, diagonal: np.ndarray, there: np.ndarray) -> csr_matrix:
        """The same, with note taken of where its entries are."""
        made = laplacian(self._network, self._weights, diagonal)
        self._last, self._there = made, there
        self._rows = np.repeat(np.arange(made.shape[0]), np.diff(made.indptr))
        self._columns = made.indices
        self._on_diagonal = np.flatnonzero(self._rows == self._columns)
        inside = self._edges[self._free][:, self._free]
        # Where there is no entry, SciPy answers with a matrix instead of an array.
        values = inside[self._rows, self._columns] if len(self._rows) else np.zeros(0)
        self._values = np.asarray(values).ravel()
        return made
