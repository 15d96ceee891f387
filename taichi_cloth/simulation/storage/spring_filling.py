"""From a scene to the device: its springs and what bends, on the graph and as links of grids."""

from __future__ import annotations

import numpy as np

from taichi_cloth.kernels.spring_numbers import (
    NUMBERS,
    K,
    own_columns,
    shared_columns,
    stored_fields,
)
from taichi_cloth.kernels.state import BREAKING, GONE
from taichi_cloth.scene.model import Springs
from taichi_cloth.simulation.storage import adjacency, layouts, packing
from taichi_cloth.simulation.storage.filling import Filling, as_real


class SpringFilling(Filling):
    """Fills what springs and stencils need."""

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
        row = half.row
        near: np.ndarray = np.arange(slots)
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
        numbers = self._spring_numbers(springs)
        numbers[marks[:, 0] == GONE] = 0
        placed = np.zeros((len(rows.run) * packing.LANES, numbers.shape[1]), numbers.dtype)
        placed[rows.place] = numbers[half.spring]
        state = self.state
        self._to.put(state.first_copy, len(rows.start) - 1)
        self._to.put(state.n_copies, rows.copies)
        self._to.put(state.csr_start, rows.start)
        self._to.put(state.csr_run, rows.run)
        self._to.put(state.csr_other, rows.copied[: rows.copies * packing.LANES])
        self._springs_at("csr", placed)
        if self.spec.fracture:
            places = half.near[half.half], rows.place[half.half], marks
            self._break_marks(springs, np.column_stack(places))

    def _half_springs(
        self, near: np.ndarray, row: np.ndarray, far: np.ndarray, numbers: np.ndarray
    ) -> None:
        """Compressed rows: those of the slots `near` begin at `row`, with far ends `far`.

        numbers: of each half-spring, or one row where all have the same.
        """
        state = self.state
        self._to.put(state.n_csr_rows, len(near))
        self._to.put(state.csr_slot, near)
        self._to.put(state.csr_start, row)
        self._to.put(state.csr_other, far)
        self._springs_at("csr", numbers)

    def _springs_at(self, place: str, numbers: np.ndarray) -> None:
        """The numbers of springs (s, numbers) at a place (`kernels.spring_numbers`); one row where
        all have the same.
        """
        for column, field in stored_fields(self.spec, self.state, place):
            self._to.put_shared(field, numbers[:, column])

    def _spring_colours(self, ends: np.ndarray, numbers: np.ndarray) -> None:
        """The springs one by one, by colour: slots of their ends (s, 2), and their numbers."""
        self._colour_starts(self.placement.colours)
        self._to.put(self.state.ends, ends)
        self._springs_at("spring", numbers)

    def _colour_starts(self, colours: np.ndarray) -> None:
        """The begin of each of the sorted colours of springs, or of particles."""
        start = _starts(colours)
        self._to.put(self.state.n_colours, len(start) - 1)
        self._to.put(self.state.colour_start, start)

    def _particle_colours(self, near: np.ndarray) -> None:
        """The particles at the slots `near`, which have springs on the graph, by colour."""
        layout = self.placement.layout
        colour = np.full(layout.n_packs * layout.lanes, -1)
        colour[layout.slot] = self.placements.particle_colours()
        colour = colour[near]
        order = np.argsort(colour, kind="stable")
        order = order[colour[order] >= 0]
        self._colour_starts(colour[order])
        self._to.put(self.state.coloured, order)
        apart = np.zeros(len(order))
        self._to.scatter(self.spec, self.state.own, layout.n_packs, near[order], apart, 1)

    def _break_marks(self, springs: Springs, indices: np.ndarray) -> None:
        """Fill in what fracture needs; indices: (s, 6), ends, half-springs, status, break step."""
        state = self.state
        self._to.put(state.n_springs, len(springs))
        self._to.put(state.ends, indices[:, :2])
        self._to.put(state.half, indices[:, 2:4])
        self._to.put(state.status, indices[:, 4])
        self._to.put(state.break_step, indices[:, 5])
        shortest2, longest2 = layouts.squares_held(springs).T
        self._to.put_shared(state.shortest2, shortest2)
        self._to.put_shared(state.longest2, longest2)

    def _blocks(self) -> None:
        """The blocks of particles that solvers move as one."""
        block = self.placements.blocks()
        order = np.argsort(block, kind="stable")
        start = _starts(block[order])
        self._of_particle(self.state.block_of, block)
        self._to.put(self.state.graph_blocks, len(start) - 1)
        self._to.put(self.state.members_start, start)
        self._to.put(self.state.members, self.placement.layout.slot[order])

    # --- stencils --------------------------------------------------------------------------

    def _stencil_numbers(self, mine: np.ndarray) -> np.ndarray:
        """Factors of the curvature vectors of some stencils, (m,); 0 where one is gone.

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
        """The parts of listed stencils of the particle in each slot, (slots,)."""
        listed = self.snapshot.scene.stencils.select(self.placement.graph_stencils)
        return np.bincount(self.placement.layout.slot[listed.particle], minlength=slots)

    def _stencils(self, near: np.ndarray) -> None:
        """The listed stencils; near: the slots of the particles that have compressed rows."""
        mine, layout = self.placement.graph_stencils, self.placement.layout
        listed = self.snapshot.scene.stencils.select(mine)
        slots = layout.slot[listed.particle]
        order = np.argsort(slots, kind="stable")
        rows = np.append(np.searchsorted(slots[order], near), len(order))
        state = self.state
        self._to.put(state.n_stencils, len(listed))
        self._to.put(state.stencil_start, listed.start)
        self._to.put(state.stencil_slot, slots)
        self._to.put(state.stencil_weight, listed.weight)
        self._to.put(state.row_stencils, rows)
        self._to.put(state.row_stencil, listed.owner[order])
        self._to.put(state.row_weight, listed.weight[order])
        if "spring_colours" in self.needs:
            start = _starts(self.placement.stencil_colours)
            self._to.put(state.n_stencil_colours, len(start) - 1)
            self._to.put(state.stencil_colour, start)
        if self.spec.fracture:
            self._stencil_sides(mine)

    def _stencil_sides(self, mine: np.ndarray) -> None:
        """The springs that listed stencils need, by their places."""
        scene, placement = self.snapshot.scene, self.placement
        of, spring = scene.stencil_sides
        place = np.zeros(len(scene.springs), np.int64)
        place[placement.graph_springs] = np.arange(len(placement.graph_springs))
        if self.spec.links:
            place[placement.links] = -1 - self._index(placement.link_places)
        number = np.full(len(scene.stencils), -1)
        number[mine] = np.arange(len(mine))
        listed = number[of] >= 0
        stencil, side = number[of][listed], place[spring[listed]]
        order = np.argsort(stencil, kind="stable")
        start = np.append(0, np.cumsum(np.bincount(stencil, minlength=len(mine))))
        self._to.put(self.state.side_start, start)
        self._to.put(self.state.side, side[order])

    # --- links of grids --------------------------------------------------------------------

    def _links(self) -> None:
        spec, state, layout = self.spec, self.state, self.placement.layout
        links, places = self.placement.links, self.placement.link_places
        reaches = np.array([*spec.links, *(2 * np.array(line) for line in spec.lines)], np.int32)
        self._to.put(state.link, reaches)
        self._to.put(state.forward, spec.forward)
        if spec.lines:
            self._to.put(state.line, spec.lines)
        # The largest number instead of infinity, which f32 kernels may assume not to occur.
        most, none = np.finfo(self.real).max, np.zeros(layout.held.shape[:2])
        shared = [
            (field, layout.shared.get(NUMBERS[at].column, none))
            for at, field in shared_columns(spec, state)
        ]
        held = (state.link_shortest2, 0), (state.link_longest2, 1)
        shared += [(field, layout.held[:, :, at]) for field, at in held]
        for field, numbers in shared:
            rows = self._to.rows(field, len(numbers))
            rows[...] = 0
            rows[:, : numbers.shape[1]] = np.minimum(numbers, most)
        own = self._spring_numbers(self.snapshot.scene.springs.select(links))
        status, step = self.snapshot.marks[links].T
        own[status == GONE, K] = 0  # what is gone has no stiffness
        for column, field in own_columns(spec, state):
            self._of_kinds(field, spec.kinds, places, own[:, column])
        if spec.fracture:
            self._of_kinds(state.link_status, spec.kinds, places, status)
            self._of_kinds(state.link_step, spec.kinds, places, step)
            packs = places[status == BREAKING, 1] // spec.lanes
            self._to.put(state.breaking, np.bincount(packs, minlength=layout.n_packs))

    def _spring_numbers(self, springs: Springs) -> np.ndarray:
        """The numbers of springs, a column each (s, numbers): `kernels.spring_numbers`."""
        return as_real(self.real, "spring", *(getattr(springs, n.column) for n in NUMBERS))


def _starts(colours: np.ndarray) -> np.ndarray:
    """The begin of each colour, or block, that occurs in a sorted array, and the array's end."""
    start = np.flatnonzero(np.diff(colours, prepend=-1))
    return np.append(start, len(colours)).astype(np.int32)
