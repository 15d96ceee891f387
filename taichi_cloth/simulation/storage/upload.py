"""From a scene to the device: what fields are filled with, in the order in which a load does."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Any

import numpy as np

from taichi_cloth.kernels import clock, loops, rest
from taichi_cloth.kernels.forces import device_fields, has_tractions
from taichi_cloth.kernels.watchdog import NO_FAULT
from taichi_cloth.simulation.numbers import Numbers
from taichi_cloth.simulation.storage.boxes import Real, collision_grid, inner_box
from taichi_cloth.simulation.storage.filling import as_real, wrong_size
from taichi_cloth.simulation.storage.spring_filling import SpringFilling
from taichi_cloth.simulation.storage.sums import summed_springs
from taichi_cloth.simulation.storage.surface_filling import SurfaceFilling


class Upload(SpringFilling, SurfaceFilling):
    """Puts a snapshot on the device, whole or in part."""

    def numbers(self, numbers: Numbers) -> None:
        """Fill what is one number for all."""
        world, particles = self.snapshot.scene.world, self.snapshot.scene.particles
        inner_low, inner_high = inner_box(world, particles, self.real)
        first_time, first_time_low = clock.split(numbers.first_time, self.real)
        values: dict[str, Any] = {
            "n": len(particles),
            "iterations": numbers.iterations,
            "first_step": numbers.first_step,
            "first_time": first_time,
            "first_time_low": first_time_low,
            "dt_low": clock.split(numbers.dt, self.real)[1],
            "dt": numbers.dt,
            "speed_limit": numbers.speed_limit,
            "tolerance": numbers.tolerance,
            "least_scale": np.abs(world.gravity).max(),
            "pair_friction": world.friction,
            "one": 1.0,
            "low": world.low,
            "high": world.high,
            "inner_low": inner_low,
            "inner_high": inner_high,
        } | self._of_forces([*self.state.count_names, *self.state.number_names])
        radius = particles.radius
        if self.spec.thick:
            spheres = self.snapshot.scene.spheres
            radius, values["skin"] = spheres.radius, min(spheres.skin, np.finfo(self.real).max)
        if rest.needed(self.spec):
            values["rest_way"], values["rest_span"] = rest.way_and_span(
                self.snapshot.scene, numbers.dt
            )
        values |= collision_grid(world, radius, self.spec.thick)
        for name in (*self.state.count_names, *self.state.number_names):
            self._to.put(getattr(self.state, name), values[name])
        self._bring()

    def _of_forces(self, names: Collection[str]) -> dict[str, Any]:
        """Contents that the forces put into those of their fields that have these names.

        InputError where one does not fit the device's precision.
        """
        scene = self.snapshot.scene
        found = {
            field.name: field.value(scene.world, scene.particles)
            for field in device_fields(self.spec)
            if field.value and field.name in names
        }
        for name, value in found.items():
            if np.abs(value).max(initial=0) > np.finfo(self.real).max:
                raise wrong_size(self.real, [name.replace("_", " ")], 0)
        return found

    def all(self) -> None:
        """Fill everything but `numbers`, which come first."""
        self._cells()
        self._of_particles()
        if self.spec.springs:
            self._graph()
        if self.spec.links:
            self._links()
        if self.spec.blocks_on_graph:
            self._blocks()
        if self.spec.obstacles:
            self._obstacles()
        if has_tractions(self.spec):
            self._tractions()
        if self.spec.faces:
            self._faces()
        if self.spec.thick:
            self._closer_pairs()
        self._bending()
        self._end()

    def particles_again(self) -> None:
        """Fill all that depends on the motion of particles, their masses and which are fixed, once
        everything is there; with the bits that `all` leaves.
        """
        self._of_particles()
        self._bending()
        self._end()

    def _end(self) -> None:
        """Take everything to the device."""
        if self.spec.thick:  # lists of pairs are made anew
            self._to.put(self.state.outdated, 1)
            self._to.put(self.state.overfull, 0)
        self._bring()

    def _of_particles(self) -> None:
        """The particles themselves, and what is summed up for them."""
        self._particles()
        if "summed_springs" in self.needs:
            self._summed_springs()
        self._halos(name for name in self.state.vector_names if self._is_haloed(name))
        self.halo_numbers()

    def _is_haloed(self, name: str) -> bool:
        """True if neighbours read a field of vectors."""
        return any(getattr(self.state, name) is field for field in self.state.haloed)

    def halo_numbers(self) -> None:
        """The halos of what is a number for each particle, for methods that read neighbours'."""
        if "spring_colours" in self.needs:
            self._halos(self.state.particle_names)

    def _halos(self, names: Iterable[str]) -> None:
        """The halos of fields, by name."""
        if self.spec.halo:
            for field in (getattr(self.state, name) for name in names):
                if field.shape:
                    self._to.renew_halos(self.spec, field, self.placement.layout.grid)

    def _bending(self) -> None:
        """The weights of stencils, which depend on what is fixed."""
        if self.spec.stencils:
            k = self._stencil_numbers(self.placement.graph_stencils)
            self._to.put(self.state.stencil_k, k)
        if self.spec.lines:
            lines, k = self.placement.line_places, self._stencil_numbers(self.placement.lines)
            self._of_kinds(self.state.line_k, self.spec.line_kinds, lines, k)

    # --- particles -------------------------------------------------------------------------

    def _cells(self) -> None:
        """The packs and the grids, and that nothing was done with them yet."""
        state, layout = self.state, self.placement.layout
        for field, number in zip(
            (state.n_packs, state.n_pieces, state.n_groups, state.n_grids),
            (layout.n_packs, *loops.levels_of(layout.n_packs), len(layout.grid)),
            strict=True,
        ):
            self._to.put(field, number)
        self._to.put(state.grid, layout.grid)
        if self.spec.links:
            self._to.put(state.grid_of, layout.grid_of)
        self._to.clear(state.arrivals, loops.COUNTER_SIZE)
        if self.spec.resting:
            self._to.put(state.unsettled, 0)

    def _particles(self) -> None:
        p, x = self.snapshot.scene.particles, self.snapshot.x
        with np.errstate(all="ignore"):
            w = np.where(p.fixed, 0.0, 1.0 / p.mass)
        grips = self.snapshot.grips
        by, at = (np.full(len(x), -1), 0.0 * x) if grips is None else (grips.by, grips.at)
        still = p.fixed & (by < 0)  # a fixed particle never moves, unless something holds it
        v = np.where(still[:, None], 0.0, self.snapshot.v)
        values = {"x": x, "v": v, "w": w, "radius": p.radius, "restitution": p.restitution}
        values |= {"held_by": by + 1.0, "held_at": at}
        if self.spec.compensated:
            values |= {"x_low": _low(x, self.real), "v_low": _low(v, self.real)}
        if self.spec.thick:
            spheres = self.snapshot.scene.spheres
            restitution = np.where(spheres.thick, 0.0, p.restitution)
            values |= {"pair_radius": spheres.radius, "pair_restitution": restitution}
        vectors, names = self.state.vector_names, self.state.particle_names
        values |= self._of_forces([*vectors, *names])
        rows = as_real(self.real, "particle", *(values[name] for name in (*vectors, *names)))
        weights = rows[:, len(vectors) * x.shape[1] + names.index("w")]
        vanished = (w > 0) & (weights == 0)
        if vanished.any():
            raise wrong_size(self.real, "particle", int(vanished.argmax()))
        slot, state, dim = self.placement.layout.slot, self.state, x.shape[1]
        world = self.snapshot.scene.world
        for k, name in enumerate(vectors):
            # Slots without a particle are past no wall.
            elsewhere = (world.low + world.high) / 2 if name == "x" else 0
            columns = rows[:, k * dim : (k + 1) * dim]
            self._of_particle(getattr(state, name), columns, elsewhere)
        for column, name in zip(rows.T[len(vectors) * dim :], names, strict=True):
            self._of_particle(getattr(state, name), column)
        self._to.put(state.slot, slot)
        self._of_particle(state.particle, np.arange(len(slot), dtype=np.int32), NO_FAULT)
        if self.spec.obstacles and not self.spec.moving:
            self._to.clear(state.free_ball, self.placement.layout.n_packs * self.spec.lanes)

    def _summed_springs(self) -> None:
        """Sums of the stiffness and damping of each particle's springs."""
        rows = summed_springs(self.snapshot.scene, self.snapshot.pulling)
        self._of_particle(self.state.summed_k, rows[:, 0])
        self._of_particle(self.state.summed_c, rows[:, 1])


def _low(values: np.ndarray, real: Real) -> np.ndarray:
    """The low parts of values, which the device's precision cannot hold."""
    with np.errstate(all="ignore"):
        low = values - values.astype(real)
    return np.where(np.isfinite(low), low, 0.0)  # `values` themselves are refused
