"""What may be changed in a simulation while it runs, as its users call it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from taichi_cloth.settings import accepted
from taichi_cloth.simulation import editing
from taichi_cloth.simulation.snapshot import Snapshot
from taichi_cloth.simulation.storage import Storage


class Changes(ABC):
    """The part of a `Simulation` that changes its numbers, motion, springs and particles."""

    storage: Storage

    @property
    @abstractmethod
    def steps(self) -> int:
        """Steps done since the start."""

    @property
    @abstractmethod
    def particle_count(self) -> int:
        """How many particles there are."""

    @abstractmethod
    def _edit(self, now: Snapshot, edited: Snapshot, left: np.ndarray | None = None) -> None:
        """Go on from an edited state; left: which of the particles are left, all where absent."""

    def set(
        self,
        *,
        particles: ArrayLike | None = None,
        springs: ArrayLike | None = None,
        kind: str | None = None,
        **changes: Any,
    ) -> None:
        """Change numbers of the scene, or the motion of particles, from the next step on.

        Time, what is broken, what was spawned and all that is not named stay as they are. With
        dt "auto" the substeps are chosen anew.

        changes: by name, one value for all that are selected or one for each:
            mass, radius, viscous, restitution (`ParticleProperties`), fixed (bool), color (3);
            positions, velocities (m, dim), in world units; fixed particles keep velocity 0;
            stiffness, rest_length, break_force, damping (`SpringProperties`); None for a break
            force: unbreakable, for a rest length: the distance that the ends have now;
            bending, the rigidity of cloths that have one, all or (m,) for each stencil;
            gravity (dim,) and the further keys of [world] that forces declare.
        particles: indices, or a mask (n,), of those that get the values; absent: all.
        springs: likewise for springs (s,); kind: instead, "structural", "shear" or "bend": those of
            the scene's regular grids that are links of this kind.

        Setting what is so already changes no bit of the run; other values make methods that keep
        vectors from step to step (`verlet`) compute them anew. A feature that the scene has not had
        (damping, drag, springs that break, numbers that differ) is compiled at its first use.
        Raises InputError, and leaves all as it was, for unknown names, wrong shapes, numbers
        outside of their limits, positions outside the world, and steps that dt "auto" cannot take.
        """
        now = self.storage.snapshot()
        selection = editing.Selection(particles, springs, kind)
        self._edit(now, editing.with_values(now, changes, selection))

    def pin(self, particles: ArrayLike) -> None:
        """Fix particles, by indices or a mask (n,), where they are now."""
        count = self.particle_count
        chosen = accepted.selection("pin: particles", particles, count, "particle")
        self.set(fixed=True, particles=chosen)

    def unpin(self, particles: ArrayLike) -> None:
        """Let particles go, by indices or a mask (n,); they start at rest."""
        count = self.particle_count
        chosen = accepted.selection("unpin: particles", particles, count, "particle")
        self.set(fixed=False, particles=chosen)

    def add_spring(self, i: int, j: int, **numbers: float | None) -> int:
        """Tie particles i and j by a spring; return its index.

        numbers: stiffness and the others of `SpringProperties`; absent: the scene's defaults, for
        the rest length the distance that the two have now. Where a spring of theirs is broken or
        cut, that one is whole again with these numbers. InputError where one holds already.
        """
        now = self.storage.snapshot()
        edited, index = editing.with_spring(now, i, j, numbers)
        self._edit(now, edited)
        return index

    def cut(self, springs: ArrayLike) -> None:
        """Let springs be gone at once, by indices or a mask (s,). They count as broken."""
        now = self.storage.snapshot()
        self._edit(now, editing.with_cut(now, springs, self.steps))

    def remove(self, particles: ArrayLike) -> np.ndarray:
        """Remove particles, by indices or a mask (n,), with all springs at them.

        What is left is numbered from 0 in the order it had, springs too; those that are broken
        remain listed. Returns which particles these are by their old indices, (m,).
        """
        now = self.storage.snapshot()
        edited, left = editing.without(now, particles)
        self._edit(now, edited, left if len(left) < len(now.x) else None)
        return left
