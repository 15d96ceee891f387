"""Changes of a simulation while it runs, as its users call them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from taichi_cloth.errors import InputError
from taichi_cloth.limits.holding import added_mass, strength
from taichi_cloth.scene.holding import Hold
from taichi_cloth.scene.penetration import overlapping
from taichi_cloth.settings import accepted
from taichi_cloth.simulation import editing
from taichi_cloth.simulation.acts import act
from taichi_cloth.simulation.part import Part


class Changes(Part):
    """The part of a `Simulation` that changes its numbers, motion, springs and particles."""

    @act
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
            gravity (dim,) and the further keys of [world] that forces declare; None: without one;
            friction, of the ground, resting walls and all obstacles; collisions (bool).
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
        """Fix particles, by indices or a mask (n,), where they are now.

        Those that are within the grip of an obstacle that moves are taken along by it.
        """
        count = self.particle_count
        chosen = accepted.selection("pin: particles", particles, count, "particle")
        self.set(fixed=True, particles=chosen)

    def unpin(self, particles: ArrayLike) -> None:
        """Let particles go, by indices or a mask (n,).

        They start at rest, those that an obstacle took along with its velocity.
        """
        count = self.particle_count
        chosen = accepted.selection("unpin: particles", particles, count, "particle")
        self.set(fixed=False, particles=chosen)

    @act
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

    @act
    def cut(self, springs: ArrayLike) -> None:
        """Let springs be gone at once, by indices or a mask (s,). They count as broken."""
        chosen = accepted.selection("cut: springs", springs, self.spring_count, "spring")
        if self.storage.cut(chosen, self.steps):
            self.storage.mark_new_springs(self.steps)
            return
        now = self.storage.snapshot()
        self._edit(now, editing.with_cut(now, chosen, self.steps))

    @act
    def remove(self, particles: ArrayLike) -> np.ndarray:
        """Remove particles, by indices or a mask (n,), with all springs at them.

        What is left is numbered from 0 in the order it had, springs too; those that are broken
        remain listed. Returns which particles these are by their old indices, (m,).
        """
        chosen = accepted.selection("remove: particles", particles, self.particle_count, "particle")
        self.let_go()
        now = self.storage.snapshot()
        edited, left = editing.without(now, chosen)
        self._edit(now, edited, left if len(left) < len(now.x) else None)
        return left

    # --- what a mouse does --------------------------------------------------------------------

    @act
    def prepare_tools(self) -> None:
        """Compile what mouse tools need beside the scene, if that is not done: for some seconds.

        They are holding, blowing, cutting and adding particles. The state stays as it is. A scene
        whose world has `tools` is compiled so from the start.
        """
        if self.scene.world.tools:
            return
        self.scene, self._ready = self.scene.with_world(tools=True), False
        now = self.storage.snapshot()
        self._edit(now, replace(now, scene=now.scene.with_world(tools=True)))

    @act
    def prepare_balls(self) -> None:
        """Let particles collide from now on, so that what is thrown does not pass through them.

        Compiles for some seconds. Where y points up they rest on each other. What collides is then
        on the graph, in logs too: lanes of what rests compile two to three times as long.
        InputError in a scene whose particles overlap from its start, which would burst.
        """
        world = self.scene.world
        if not world.collisions and not self.scene.features().thick:
            pairs = overlapping(self.scene)
            if len(pairs):
                i, j = pairs[0]
                raise InputError(
                    f"a ball would pass through here: particles such as {i} and {j} overlap from "
                    "the start, so they cannot collide; give them a smaller radius"
                )
        changes: dict[str, Any] = {"collisions": True, "tools": True}
        if world.up and not world.collisions:
            changes["contact"] = "resting"
        self.scene, self._ready = self.scene.with_world(**changes), False
        now = self.storage.snapshot()
        self._edit(now, replace(now, scene=now.scene.with_world(**changes)), topology="graph")

    def grab(
        self,
        particles: ArrayLike,
        place: ArrayLike,
        stiffness: ArrayLike | None = None,
        damping: ArrayLike | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Hold particles, by indices or a mask (n,), until `let_go`; others are let go.

        Each keeps its way from `place` (dim,), which `drag` moves. Fixed particles stay fixed.
        stiffness [force / length], damping [force / velocity]: one for all or (m,) for each; those
        of `limits.holding.strength` where absent. Where the step has no room for them, what is held
        weighs more meanwhile. Returns both, (m,) each.
        """
        count, dim = self.particle_count, self.scene.world.dim
        chosen = accepted.selection("grab: particles", particles, count, "particle")
        if len(chosen) == 0:
            raise InputError("grab: no particle to hold; give at least one")
        at = accepted.array("grab: place", place, (dim,), "one a dimension").copy()
        given: dict[int, np.ndarray] = {}
        for which, (name, value) in enumerate((("stiffness", stiffness), ("damping", damping))):
            if value is not None:
                numbers = accepted.numbers(f"grab: {name}", value)
                accepted.require(f"grab: {name}", numbers, numbers >= 0, "must not be negative")
                given[which] = accepted.fitted(f"grab: {name}", numbers, (len(chosen),), "held")
        self.prepare_tools()
        before, pulls = self.held(), list(self.hold_strength(chosen))
        self.let_go()
        for which, numbers in given.items():
            pulls[which] = numbers
        k, c = pulls
        offset = self.storage.positions()[chosen] - at
        mass = self.storage.scene.particles.mass[chosen]
        try:
            self._hold_by(Hold(chosen, offset, at, k, c, mass))
        except InputError:  # the precision cannot hold it
            if before is not None:
                self._hold_by(before)
            raise
        return k, c

    def weigh_hold(self) -> None:
        """Have what is held weigh what this one's own step needs, where another one grabbed it."""
        hold = self.held()
        if hold is not None:
            self.let_go()
            self._hold_by(hold)

    def _hold_by(self, hold: Hold) -> None:
        """Hold particles, of which none is held; they weigh meanwhile what the step needs."""
        step, pulls = self.dt / self.substeps, (hold.stiffness, hold.damping)
        more = added_mass(self._module, self.network(), step, hold.particles, *pulls)
        self._hold(hold, hold.mass + more)

    @act
    def _hold(self, hold: Hold, mass: np.ndarray) -> None:
        """Hold particles, which weigh `mass` (m,) meanwhile: as the step of who grabbed needs."""
        self.storage.grab(hold, mass)

    def hold_strength(self, particles: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Stiffness and damping with which `grab` holds particles by itself, (m,) each."""
        count = self.particle_count
        chosen = accepted.selection("hold_strength: particles", particles, count, "particle")
        k, c = strength(self.network(), self.dt, chosen)
        return k, c

    @act
    def drag(self, place: ArrayLike) -> None:
        """Take what is held to another `place` of the pointer, (dim,); without a hold: nothing."""
        dim = self.scene.world.dim
        place = accepted.array("drag: place", place, (dim,), "one a dimension")
        held = self.held()
        if held is not None:
            self.storage.drag(place)  # which refuses what the precision cannot hold
            held.place[:] = place

    @act
    def let_go(self) -> None:
        """Hold nothing any more: what was held goes on with the velocity that it has."""
        if self.held() is not None:
            self.storage.grab(None)

    def held(self) -> Hold | None:
        """The particles held now; None: none."""
        return self.storage.scene.world.held
