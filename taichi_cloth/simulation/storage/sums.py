"""Sums over a scene for each of its particles (NumPy)."""

import numpy as np

from taichi_cloth.scene.model import Scene


def summed_springs(scene: Scene, pulling: np.ndarray) -> np.ndarray:
    """Sums of the stiffness and damping of each particle's springs, (n, 2).

    pulling: which springs do, (s,) bool. Stencils count as springs, with half of the row sums of
    their stiffness matrices.
    """
    springs, count = scene.springs.select(pulling), len(scene.particles)
    rows = np.column_stack(
        [
            np.bincount(springs.between.ravel(), np.repeat(of, 2), count)
            for of in (springs.stiffness, springs.damping)
        ]
    )
    stencils = scene.stencils_among(pulling)
    weight, of = np.abs(stencils.weight), stencils.owner
    total = np.bincount(of, weight, len(stencils)) * stencils.stiffness(scene.particles.fixed)
    rows[:, 0] += np.bincount(stencils.particle, weight * total[of] / 2, count)
    return rows
