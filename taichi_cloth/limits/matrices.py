"""Stiffness and damping of a network as sparse matrices, and their largest eigenvalues.

Eigenvalues are found by Lanczos' method (ARPACK), which takes the same products with K as power
iteration and needs some tens of them where that needs thousands: the largest eigenvalues of a cloth
lie close together.
"""

from __future__ import annotations

import contextlib
import math
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.limits.network import Network

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

MANY = 20_000  # degrees of freedom from which an eigenvalue to a thousandth is enough


def laplacian(network: Network, weights: np.ndarray, diagonal: np.ndarray) -> csr_matrix:
    """M^-1/2 (Laplacian + diagonal) M^-1/2 among the f free particles, (f, f).

    weights: (s,), of springs; diagonal: (n,).
    """
    return _free_block(network, *_edges(network.springs.between, weights), diagonal, 1)


def edges_matrix(network: Network, weights: np.ndarray) -> csr_matrix:
    """The Laplacian itself, (n, n), of springs with these weights (s,)."""
    from scipy import sparse

    n = len(network.particles)
    rows, columns, values = _edges(network.springs.between, weights)
    return sparse.csr_matrix((values, (rows, columns)), shape=(n, n))


def stencil_matrix(network: Network) -> csr_matrix:
    """M^-1/2 Q M^-1/2 of the free particles, (f, f): Q is what stencils add to K on each axis."""
    from scipy import sparse

    stencils, particles = network.stencils, network.particles
    entries = stencils.weight, (stencils.owner, stencils.particle)
    curvature = sparse.csr_matrix(entries, shape=(len(stencils), len(particles)))
    free = ~particles.fixed
    scaled = curvature[:, free] @ sparse.diags(1.0 / np.sqrt(particles.mass[free]))
    return (scaled.T @ sparse.diags(network.on_curvature) @ scaled).tocsr()


def _edges(between: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The Laplacian's entries: rows, columns, values."""
    a, b = between.T
    rows, columns = np.concatenate([a, b, a, b]), np.concatenate([a, b, b, a])
    return rows, columns, np.concatenate([weights, weights, -weights, -weights])


def _free_block(
    network: Network,
    rows: np.ndarray,
    columns: np.ndarray,
    values: np.ndarray,
    diagonal: np.ndarray,
    dim: int,
) -> csr_matrix:
    """M^-1/2 (entries + diagonal) M^-1/2 of the free particles' degrees of freedom.

    rows, columns, values: the entries, of which those at one place add up; diagonal: (n,).
    """
    from scipy import sparse

    particles = network.particles
    n = len(particles)
    whole = sparse.csr_matrix((values, (rows, columns)), shape=(n * dim, n * dim))
    whole = whole + sparse.diags(np.repeat(diagonal, dim))
    free = np.repeat(~particles.fixed, dim)
    scale = sparse.diags(1.0 / np.sqrt(np.repeat(particles.mass, dim)[free]))
    return (scale @ whole.tocsr()[free][:, free] @ scale).tocsr()


def largest_eigenvalue(
    matrix: csr_matrix, start: np.ndarray | None = None, rough: bool = False
) -> tuple[float, np.ndarray]:
    """The largest eigenvalue of a symmetric matrix, and its vector; alike on every run.

    start: a vector near it, where one is known.
    rough: of a large matrix to some thousandths, where the residual is added as a precaution.
    """
    n = matrix.shape[0]
    if n <= 32:
        values, vectors = np.linalg.eigh(matrix.toarray())
        return float(values[-1]), vectors[:, -1]
    from scipy.sparse.linalg import ArpackNoConvergence, eigsh

    if matrix.nnz == 0 or not abs(matrix).max():
        return 0.0, np.eye(n, 1)[:, 0]
    noise = np.random.default_rng(0).standard_normal(n)
    if start is not None and (start @ start) > 0:  # with a part along whatever it lacks
        noise = start / np.sqrt(start @ start) + 1e-3 * noise / math.sqrt(n)
    # An eigenvalue is off by the square of its residual, and by no more than it where the next
    # one is as near, as on a large cloth.
    tolerances = (1e-6, 1e-4, 1e-2) if n <= MANY else (1e-2, 5e-2) if rough else (1e-3, 1e-2)
    for tolerance in tolerances:
        with contextlib.suppress(ArpackNoConvergence):
            values, vectors = eigsh(
                matrix, 1, which="LA", v0=noise, tol=tolerance, ncv=min(n, 30), maxiter=100
            )
            return float(values[-1]), vectors[:, -1]
    return float(abs(matrix).sum(axis=1).max()), np.full(n, 1 / math.sqrt(n))


def stiffness_and_damping(network: Network) -> tuple[csr_matrix, csr_matrix]:
    """M^-1/2 K M^-1/2 and M^-1/2 C M^-1/2 of the free particles, in the geometry as it is.

    Rows are the free particles' coordinates, particle by particle.
    """
    dim = network.position.shape[1]
    along, t = network.geometry
    k, c = network.along_springs
    held, drag = network.on_particles
    nn = along[:, :, None] * along[:, None, :]
    stiff = k[:, None, None] * ((1 - t)[:, None, None] * nn + t[:, None, None] * np.eye(dim))
    stiffness = _from_blocks(network, stiff, held)
    if len(network.stencils):
        from scipy import sparse

        stiffness = stiffness + sparse.kron(stencil_matrix(network), sparse.identity(dim), "csr")
    return (
        stiffness,
        _with_triangles(network, _from_blocks(network, c[:, None, None] * nn, drag)),
    )


def _with_triangles(network: Network, damping: csr_matrix) -> csr_matrix:
    """The damping matrix with what the forces on triangles add to it.

    The block of a triangle acts between any two of its corners, by the product of their shares.
    """
    if len(network.triangles) == 0:
        return damping
    blocks, corners = network.damping_of_triangles, network.triangles
    shares, axis = network.shares, np.arange(3)
    shape = (len(corners), 3, 3, 3, 3)  # triangle, corner and axis of the row, of the column
    dofs = 3 * corners[:, :, None] + axis
    rows = np.broadcast_to(dofs[:, :, :, None, None], shape)
    columns = np.broadcast_to(dofs[:, None, None, :, :], shape)
    values = shares[:, :, None, None, None] * shares[:, None, None, :, None]
    values = values * blocks[:, None, :, None, :]
    entries = rows.ravel(), columns.ravel(), values.ravel()
    none = np.zeros(len(network.particles))
    return damping + _free_block(network, *entries, none, 3)


def _from_blocks(network: Network, blocks: np.ndarray, diagonal: np.ndarray) -> csr_matrix:
    """The matrix to which every spring adds its block (s, dim, dim), and each particle (n,)."""
    dim = blocks.shape[1]
    ends, others, sign = _edges(network.springs.between, np.ones(len(blocks)))
    axis = np.arange(dim)
    shape = (len(ends), dim, dim)
    rows = np.broadcast_to(ends[:, None, None] * dim + axis[:, None], shape)
    columns = np.broadcast_to(others[:, None, None] * dim + axis, shape)
    values = sign[:, None, None] * np.concatenate([blocks] * 4)
    entries = rows.ravel(), columns.ravel(), values.ravel()
    return _free_block(network, *entries, diagonal, dim)
