"""From a scene to the device: packs rows of numbers, and launches the kernels that take them.

One method a kernel of `kernels/transfer.py`, in the order in which a load calls them.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from taichi_cloth.errors import InputError
from taichi_cloth.kernels import clock, faces, loops, poses, surfaces, transfer
from taichi_cloth.kernels.collision_grid import most_cells
from taichi_cloth.kernels.forces import device_fields, has_tractions
from taichi_cloth.kernels.obstacles.contract import FAR, SIZES
from taichi_cloth.kernels.specialization import Specialization
from taichi_cloth.kernels.spring_numbers import NUMBERS
from taichi_cloth.kernels.state import GONE
from taichi_cloth.scene.model import Springs
from taichi_cloth.scene.solids import Solid, held, met_by_faces
from taichi_cloth.scene.triangles import corner_shares, springs_of_sides
from taichi_cloth.simulation.launch import Launcher
from taichi_cloth.simulation.numbers import Numbers
from taichi_cloth.simulation.snapshot import Snapshot
from taichi_cloth.simulation.storage import adjacency, layouts, packing
from taichi_cloth.simulation.storage.boxes import Real, collision_grid, inner_box
from taichi_cloth.simulation.storage.placement import Placement, Placements


@dataclass(frozen=True)
class Upload:
    """Where a snapshot goes: `state`, whose fields are of `spec`.

    placements: of its scene; placement: the one that is used. solids: what is in its way.
    needs: what the method asks of the host (`kernels.methods`). real: type of the device's numbers.
    """

    launcher: Launcher
    spec: Specialization
    state: Any
    snapshot: Snapshot
    placements: Placements
    placement: Placement
    solids: Sequence[Solid]
    needs: Collection[str]
    real: Real

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
        values |= collision_grid(world, radius, most_cells(len(radius), self.spec.thick))
        counts, reals = (
            np.concatenate([np.ravel(values[name]) for name in names])
            for names in (self.state.count_names, self.state.number_names)
        )
        arrays = counts.astype(np.int32), reals.astype(self.real)
        self.launcher.launch(transfer.load_numbers, self.state, *arrays)

    def _of_forces(self, names: Collection[str]) -> dict[str, Any]:
        """What the forces put into those of their fields that have these names.

        InputError where one does not fit the device's precision.
        """
        scene = self.snapshot.scene
        found = {
            field.name: field.value(scene.world, scene.particles)
            for field in device_fields(self.spec)
            if field.value and field.name in names
        }
        for name, value in found.items():
            if np.abs(value).max() > np.finfo(self.real).max:
                raise _wrong_size(self.real, [name.replace("_", " ")], 0)
        return found

    def all(self) -> None:
        """Fill everything but `numbers`, which come first."""
        self._cells()
        self._of_particles()
        if self.spec.springs:
            self._graph()
        if self.spec.links:
            self._links()
        if has_tractions(self.spec):
            self._launch(surfaces.clear_tractions)
        if self.spec.obstacles:
            self._obstacles()
        if has_tractions(self.spec):
            self.surface(self.state.surface, self.snapshot.scene.triangles)
        if self.spec.faces:
            self.surface(self.state.elements, self.snapshot.scene.elements)
            self.launcher.launch(faces.load_rows, self.state)
        if self.spec.thick:
            self._closer_pairs()
        self._bending()

    def particles_again(self) -> None:
        """Fill all that depends on the motion of particles, their masses and which are fixed, once
        everything is there; with the bits that `all` leaves.
        """
        self._of_particles()
        self._bending()
        if self.spec.thick:  # lists of pairs are made anew, as after a load
            self.state.outdated[None], self.state.overfull[None] = 1, 0

    def _of_particles(self) -> None:
        """The particles themselves, and what is summed up for them."""
        if len(self.snapshot.x):  # a kernel takes no empty array
            self._particles()
            if "summed_springs" in self.needs:
                self._summed_springs()
            if self.spec.halo and "spring_colours" in self.needs:
                self._launch(transfer.load_halo_numbers)

    def _bending(self) -> None:
        """What stencils pull with, which depends on what is fixed."""
        if self.spec.stencils:
            k = self._stencil_numbers(self.placement.graph_stencils)
            self.launcher.launch(transfer.load_stencil_numbers, self.state, k)
        if self.spec.lines:
            places, k = self.placement.line_places, self._stencil_numbers(self.placement.lines)
            self._launch(transfer.load_lines, places, k)

    def _launch(self, kernel: Any, *arguments: Any) -> None:
        self.launcher.launch(kernel, self.spec, self.state, *arguments)

    # --- particles -------------------------------------------------------------------------

    def _cells(self) -> None:
        layout = self.placement.layout
        packs = layout.n_packs
        levels = loops.levels_of(packs)
        self._launch(transfer.load_packs, packs, *levels, layout.grid, layout.grid_of)

    def _particles(self) -> None:
        p, x = self.snapshot.scene.particles, self.snapshot.x
        with np.errstate(all="ignore"):
            w = np.where(p.fixed, 0.0, 1.0 / p.mass)
        by, at = held(self.snapshot.scene, self.solids)
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
            raise _wrong_size(self.real, "particle", int(vanished.argmax()))
        self._launch(transfer.load_particles, self.placement.layout.slot, rows)
        self.launcher.renew_halos(self.spec, self.state)

    def _summed_springs(self) -> None:
        """Sums of the stiffness and damping of each particle's springs."""
        scene, count = self.snapshot.scene, len(self.snapshot.x)
        springs = scene.springs.select(self.snapshot.pulling)
        rows = np.column_stack(
            [
                np.bincount(springs.between.ravel(), np.repeat(of, 2), count)
                for of in (springs.stiffness, springs.damping)
            ]
        )
        # Of a stencil, half of the row sums of its stiffness matrix, as springs give theirs.
        stencils = scene.stencils_among(self.snapshot.pulling)
        weight, of = np.abs(stencils.weight), stencils.owner
        total = np.bincount(of, weight, len(stencils)) * stencils.stiffness(scene.particles.fixed)
        rows[:, 0] += np.bincount(stencils.particle, weight * total[of] / 2, count)
        self._launch(
            transfer.load_summed_springs, self.placement.layout.slot, rows.astype(self.real)
        )

    # --- springs on the graph --------------------------------------------------------------

    def _graph(self) -> None:
        """The springs that are on the graph, as rows of half-springs."""
        layout, mine = self.placement.layout, self.placement.graph_springs
        springs, marks = self.snapshot.scene.springs.select(mine), self.snapshot.marks[mine]
        ends, slots = layout.slot[springs.between], layout.n_packs * layout.lanes
        if layout.rows is not None:
            half = adjacency.half_springs(ends, slots, layout.rows.by_place)
            self._packed_rows(layout.rows, half, springs, marks)
            return
        half = adjacency.half_springs(ends, slots)
        near, row = np.arange(slots), half.row
        if self.spec.links:  # only those that have any
            near = np.flatnonzero(np.diff(half.row) + self._parts_at(slots))
            row = np.append(half.row[near], len(half.far))
        numbers = self._spring_numbers(springs)
        if self.spec.uniform_springs:
            numbers = numbers[:1]
        if "spring_colours" in self.needs:
            self._spring_colours(ends, numbers)
        far = np.where(marks[half.spring, 0] == GONE, half.near, half.far)
        self._half_springs(
            near, row, far, numbers if self.spec.uniform_springs else numbers[half.spring]
        )
        if "particle_colours" in self.needs:
            self._particle_colours(near)
        if self.spec.fracture:
            self._break_marks(springs, np.column_stack([ends, half.half, marks]))
        if self.spec.stencils:
            self._stencils(near)

    def _packed_rows(
        self,
        rows: packing.PackedRows,
        half: adjacency.HalfSprings,
        springs: Springs,
        marks: np.ndarray,
    ) -> None:
        """The springs, all of which are on the graph, as packed rows."""
        arrays = rows.start, rows.run, _not_empty(rows.copied)
        indices = [array.astype(np.int32) for array in arrays]
        numbers = self._spring_numbers(springs)
        numbers[marks[:, 0] == GONE] = 0
        placed = np.zeros((len(rows.run) * packing.LANES, numbers.shape[1]), numbers.dtype)
        placed[rows.place] = numbers[half.spring]
        self._launch(transfer.load_packed_rows, *indices, placed, rows.copies)
        if self.spec.fracture:
            places = half.near[half.half], rows.place[half.half], marks
            self._break_marks(springs, np.column_stack(places))

    def _half_springs(
        self, near: np.ndarray, row: np.ndarray, far: np.ndarray, numbers: np.ndarray
    ) -> None:
        """Compressed rows: those of the slots `near` begin at `row`, with far ends `far`.

        numbers: of each half-spring, or one row where all have the same.
        """
        self._launch(
            transfer.load_half_springs,
            _not_empty(near.astype(np.int32)),
            row.astype(np.int32),
            _not_empty(far.astype(np.int32)),
            _not_empty(numbers),
            len(near),
            len(far),
        )

    def _spring_colours(self, ends: np.ndarray, numbers: np.ndarray) -> None:
        """The springs one by one, by colour: slots of their ends (s, 2), and their numbers."""
        start = _starts(self.placement.colours)
        arrays = start, _not_empty(ends), _not_empty(numbers)
        self._launch(transfer.load_colours, len(start) - 1, *arrays)

    def _particle_colours(self, near: np.ndarray) -> None:
        """The particles at the slots `near`, which have springs on the graph, by colour."""
        layout = self.placement.layout
        colour = np.full(layout.n_packs * layout.lanes, -1)
        colour[layout.slot] = self.placements.particle_colours()
        colour = colour[near]
        order = np.argsort(colour, kind="stable")
        order = order[colour[order] >= 0]
        start = _starts(colour[order])
        arrays = start, _not_empty(order.astype(np.int32))
        self._launch(transfer.load_particle_colours, len(start) - 1, *arrays)

    def _break_marks(self, springs: Springs, indices: np.ndarray) -> None:
        """What fracture needs; indices: (s, 6), ends, half-springs, status and break step."""
        held = layouts.squares_held(springs).astype(self.real)
        if self.spec.uniform_springs:
            held = held[:1]
        arrays = _not_empty(indices.astype(np.int32)), _not_empty(held)
        self._launch(transfer.load_springs, len(springs), *arrays)

    # --- pairs -----------------------------------------------------------------------------

    def _closer_pairs(self) -> None:
        """The pairs that keep less than the sum of their radii, and the patches of particles."""
        spheres = self.snapshot.scene.spheres
        start, other, reach = spheres.rows_by_place()
        self.launcher.launch(
            transfer.load_closer_pairs,
            self.state,
            start.astype(np.int32),
            _not_empty(other.astype(np.int32)),
            _not_empty(reach.astype(self.real)),
            len(start) - 1,
            len(other),
        )
        self.launcher.launch(
            transfer.load_patches,
            self.state,
            spheres.patch_start.astype(np.int32),
            _not_empty(spheres.in_patches.astype(np.int32)),
            len(spheres.patch_start) - 1,
        )

    # --- surfaces --------------------------------------------------------------------------

    def surface(self, surface: Any, triangles: np.ndarray) -> None:
        """Triangles (m, 3) of particles, into a `kernels.state.Surface`.

        Where the last two corners are one it is an edge, which that particle has once.
        """
        layout, scene = self.placement.layout, self.snapshot.scene
        slots = layout.slot[triangles].astype(np.int32)
        # Where the device has the status of each spring, and at the end that of none.
        place = np.full(len(scene.springs) + 1, -1, np.int64)
        place[self.placement.graph_springs] = np.arange(len(self.placement.graph_springs))
        kind, slot = self.placement.link_places.astype(np.int64).T
        link = kind * self.state.packs * layout.lanes + slot
        place[self.placement.links] = -2 - link
        sides = place[springs_of_sides(triangles, scene.springs.between)]
        corners = np.column_stack([slots, sides]).astype(np.int32)
        shares = corner_shares(scene.particles.position, triangles).astype(self.real)
        order = np.argsort(slots.ravel(), kind="stable")
        order = order[(order % 3 < 2) | (slots[order // 3, 1] != slots[order // 3, 2])]
        rows, start = np.unique(slots.ravel()[order], return_index=True)
        self.launcher.launch(
            surfaces.load_surface,
            surface,
            _not_empty(corners),
            _not_empty(shares),
            _not_empty(rows.astype(np.int32)),
            np.append(start, order.size).astype(np.int32),
            _not_empty(order.astype(np.int32)),
            len(slots),
            len(rows),
        )

    # --- stencils --------------------------------------------------------------------------

    def _stencil_numbers(self, mine: np.ndarray) -> np.ndarray:
        """What multiplies the curvature vectors of some stencils, (m,); 0 where one is gone.

        Along lines the vector is the second difference itself.
        """
        scene = self.snapshot.scene
        stencils, (of, spring) = scene.stencils, scene.stencil_sides
        k = stencils.stiffness(scene.particles.fixed)
        k[of[~self.snapshot.pulling[spring]]] = 0.0
        if mine is self.placement.lines:
            k = k * stencils.weight[stencils.start[:-1] + 1] ** 2
        numbers: np.ndarray = as_real(self.real, "stencil", k[mine])[:, 0]
        return numbers

    def _parts_at(self, slots: int) -> np.ndarray:
        """How many parts of listed stencils the particle in each slot has, (slots,)."""
        listed = self.snapshot.scene.stencils.select(self.placement.graph_stencils)
        return np.bincount(self.placement.layout.slot[listed.particle], minlength=slots)

    def _stencils(self, near: np.ndarray) -> None:
        """The listed stencils; near: the slots of the particles that have compressed rows."""
        mine, layout = self.placement.graph_stencils, self.placement.layout
        listed = self.snapshot.scene.stencils.select(mine)
        slots = layout.slot[listed.particle]
        order = np.argsort(slots, kind="stable")
        rows = np.append(np.searchsorted(slots[order], near), len(order))
        self.launcher.launch(
            transfer.load_stencils,
            self.state,
            listed.start.astype(np.int32),
            slots.astype(np.int32),
            listed.weight.astype(self.real),
            rows.astype(np.int32),
            listed.owner[order].astype(np.int32),
            listed.weight[order].astype(self.real),
        )
        if "spring_colours" in self.needs:
            start = _starts(self.placement.stencil_colours)
            self.launcher.launch(transfer.load_stencil_colours, self.state, start)
        if self.spec.fracture:
            self._stencil_sides(mine)

    def _stencil_sides(self, mine: np.ndarray) -> None:
        """The springs that listed stencils need, by their places."""
        scene, placement = self.snapshot.scene, self.placement
        of, spring = scene.stencil_sides
        place = np.zeros(len(scene.springs), np.int64)
        place[placement.graph_springs] = np.arange(len(placement.graph_springs))
        if self.spec.links:
            kind, slot = placement.link_places.T.astype(np.int64)
            link = kind * self.state.packs * self.spec.lanes + slot
            place[placement.links] = -1 - link
        number = np.full(len(scene.stencils), -1)
        number[mine] = np.arange(len(mine))
        listed = number[of] >= 0
        stencil, side = number[of][listed], place[spring[listed]]
        order = np.argsort(stencil, kind="stable")
        start = np.append(0, np.cumsum(np.bincount(stencil, minlength=len(mine))))
        arrays = start.astype(np.int32), _not_empty(side[order].astype(np.int32))
        self.launcher.launch(transfer.load_stencil_sides, self.state, *arrays)

    # --- links of grids --------------------------------------------------------------------

    def _links(self) -> None:
        layout, links = self.placement.layout, self.placement.links
        none = np.zeros(layout.held.shape[:2])
        numbers = [layout.shared.get(n.column, none) for n in NUMBERS]
        shared = np.concatenate([np.stack(numbers, axis=2), layout.held], axis=2)
        # The largest number instead of infinity, which f32 kernels may assume not to occur.
        shared = np.minimum(shared, np.finfo(self.real).max).astype(self.real)
        own = self._spring_numbers(self.snapshot.scene.springs.select(links))
        rows = np.column_stack([self.placement.link_places, self.snapshot.marks[links]])
        self._launch(transfer.load_links, shared, rows, own)

    # --- obstacles -------------------------------------------------------------------------

    def _obstacles(self) -> None:
        """What is in the way, a row each, and the nodes of their grids one after the other."""
        counts, rows, nodes = [], [], [np.zeros((1, 4))]
        sharp = met_by_faces(self.snapshot.scene, self.solids)
        first = 0
        for solid in self.solids:
            placed, count = solid.placed, [0, 0, 0]
            if placed.nodes is not None:
                count = list(placed.nodes.shape[:3])
                nodes.append(placed.nodes.reshape(-1, 4))
            counts.append([self.spec.obstacles.index(solid.shape), first, *count])
            first += int(np.prod(count))
            scale = max((abs(size) for size in placed.sizes), default=0.0)
            restitution = -1.0 if solid.restitution is None else solid.restitution
            numbers = [solid.friction, restitution, placed.thin, placed.bound, scale, placed.cell]
            numbers += [float(solid.name in sharp), placed.round]
            sizes = np.zeros(SIZES)
            sizes[: len(placed.sizes)] = placed.sizes
            low = np.zeros(3) if placed.low is None else placed.low
            pose = placed.centre, placed.turn.ravel(), solid.velocity, solid.spin
            span = [solid.starts, min(solid.stops, FAR)]
            rows.append(np.concatenate([numbers, sizes, low, *pose, span]))
        names = [solid.name for solid in self.solids]
        arrays = np.array(counts, np.int32), as_real(self.real, names, *np.transpose(rows))
        grids = np.concatenate(nodes[1:] or nodes).astype(self.real)
        self._launch(poses.load_obstacles, *arrays, grids)

    def _spring_numbers(self, springs: Springs) -> np.ndarray:
        """The numbers of springs, a column each (s, numbers): `kernels.spring_numbers`."""
        return as_real(self.real, "spring", *(getattr(springs, n.column) for n in NUMBERS))


def as_real(real: Real, what: str | Sequence[str], *columns: np.ndarray) -> np.ndarray:
    """Columns side by side in the device's precision; InputError where one does not fit.

    what: for the message, "particle" or "spring", or what each of the rows is.
    """
    with np.errstate(all="ignore"):
        rows = np.column_stack(columns).astype(real)
    if not np.isfinite(rows).all():
        raise _wrong_size(real, what, int(np.isfinite(rows).all(axis=1).argmin()))
    return rows


def _wrong_size(real: Real, what: str | Sequence[str], index: int) -> InputError:
    place = f"{what} {index}" if isinstance(what, str) else what[index]
    wider = "; use --precision f64" if real is np.float32 else ""
    return InputError(
        f"{place} has a number too large or too small for {real.__name__}{wider} or other units"
    )


def _low(values: np.ndarray, real: Real) -> np.ndarray:
    """What the device's precision cannot hold of values."""
    with np.errstate(all="ignore"):
        low = values - values.astype(real)
    return np.where(np.isfinite(low), low, 0.0)  # `values` themselves are refused


def _starts(colours: np.ndarray) -> np.ndarray:
    """Where each colour that occurs begins in a sorted array, and the array's end."""
    start = np.flatnonzero(np.diff(colours, prepend=-1))
    return np.append(start, len(colours)).astype(np.int32)


def _not_empty(array: np.ndarray) -> np.ndarray:
    """The array, or one row of zeros where it is empty: a kernel takes no empty array."""
    return array if len(array) else np.zeros((1, *array.shape[1:]), array.dtype)
