"""From a scene to the device: its triangles, what is in its way, and cloths on each other."""

from __future__ import annotations

from typing import Any

import numpy as np

from taichi_cloth.kernels import poses, rest
from taichi_cloth.kernels.obstacles import contract
from taichi_cloth.kernels.transfer import Transfer
from taichi_cloth.scene.solids import met_by_faces
from taichi_cloth.scene.triangles import corner_shares, springs_of_sides
from taichi_cloth.simulation.storage.filling import Filling, as_real


class SurfaceFilling(Filling):
    """Fills what air, obstacles and other cloths need."""

    # --- surfaces --------------------------------------------------------------------------

    def _tractions(self) -> None:
        """The triangles on which forces act, and that they give particles nothing yet."""
        self._surface(self.state.surface, self.snapshot.scene.triangles, self._to)
        x = self.snapshot.x
        self._of_particle(self.state.traction, np.zeros(x.shape))
        self._of_particle(self.state.traction_damping, np.zeros(len(x)))

    def _faces(self) -> None:
        """The triangles that meet obstacles, and that nothing is known of them yet."""
        state = self.state
        elements = self.snapshot.scene.elements
        elements = elements[~self.snapshot.judged.of(elements)[1]]
        self._surface(state.elements, elements, self._to)
        slots = self.placement.layout.slot[elements]
        self._to.put(state.face_row, np.searchsorted(np.unique(slots), slots))
        self._to.put(state.faces_unsettled, 0)
        self._of_particle(state.face_kick, np.zeros(self.snapshot.x.shape))
        self._to.put(state.face_unseen, 1)
        if rest.needed(self.spec):
            self._of_particle(state.rest_x, self.snapshot.x)
            self._of_particle(state.rest_v, np.zeros(self.snapshot.x.shape))
            self._to.put(state.rest_phase, rest.MOVES)
            self._to.put(state.rest_steps, 0)

    def surface_alone(self, surface: Any, triangles: np.ndarray) -> None:
        """Triangles (m, 3) of particles, into a `kernels.fields.Surface` with fields of its own."""
        to: Any = Transfer(surface)
        self._surface(surface, triangles, to)
        to.bring(self.launcher.launch)

    def _surface(self, surface: Any, triangles: np.ndarray, to: Any) -> None:
        """Triangles (m, 3) of particles, into a `kernels.fields.Surface`.

        Where the last two corners are one it is an edge, which that particle has once.
        """
        layout, scene = self.placement.layout, self.snapshot.scene
        slots = layout.slot[triangles].astype(np.int32)
        # Where the device has the status of each spring, and at the end that of none.
        place = np.full(len(scene.springs) + 1, -1, np.int64)
        place[self.placement.graph_springs] = np.arange(len(self.placement.graph_springs))
        place[self.placement.links] = -2 - self._index(self.placement.link_places)
        shares = corner_shares(scene.particles.position, triangles)
        order = np.argsort(slots.ravel(), kind="stable")
        order = order[(order % 3 < 2) | (slots[order // 3, 1] != slots[order // 3, 2])]
        rows, start = np.unique(slots.ravel()[order], return_index=True)
        to.put(surface.n_triangles, len(slots))
        to.put(surface.n_rows, len(rows))
        to.put(surface.corner, slots)
        to.put(surface.side, place[springs_of_sides(triangles, scene.springs.between)])
        to.put(surface.share, shares)
        to.put(surface.row_slot, rows)
        to.put(surface.row_start, np.append(start, order.size))
        to.put(surface.row_triangle, order // 3)
        to.put(surface.row_share, shares.ravel()[order])

    # --- pairs -----------------------------------------------------------------------------

    def _closer_pairs(self) -> None:
        """The pairs that keep less than the sum of their radii, and the patches of particles."""
        spheres, state = self.snapshot.scene.spheres, self.state
        start, other, reach = spheres.rows_by_place()
        self._to.put(state.closer_start, start)
        self._to.put(state.closer_other, other)
        self._to.put(state.closer_reach, reach)
        sizes, mine = np.diff(spheres.patch_start), spheres.in_patches
        self._to.put(state.n_patches, len(sizes))
        self._to.put(state.patch_start, spheres.patch_start)
        self._to.put(state.in_patches, mine)
        place = np.zeros(len(self.snapshot.x), np.int32)
        place[mine] = np.arange(len(mine))
        self._to.put(state.patch_place, place)
        self._to.put(state.patch_of, np.repeat(np.arange(len(sizes)), sizes))

    # --- obstacles -------------------------------------------------------------------------

    def _obstacles(self) -> None:
        """Obstacles, a row each, and the nodes of their grids one after the other."""
        counts, found, nodes = [], [], [np.zeros((1, 4))]
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
            sizes = np.zeros(contract.SIZES)
            sizes[: len(placed.sizes)] = placed.sizes
            low = np.zeros(3) if placed.low is None else placed.low
            pose = placed.centre, placed.turn.ravel(), solid.velocity, solid.spin
            span = [solid.starts, min(solid.stops, contract.FAR)]
            found.append(np.concatenate([numbers, sizes, low, *pose, span]))
        names = [solid.name for solid in self.solids]
        columns = as_real(self.real, names, *np.transpose(found))
        ends = np.cumsum([len(contract.NUMBERS), contract.SIZES, 3])
        of_shape, of_size, of_low, start = np.split(columns, ends, axis=1)
        state, shape = self.state, np.array(counts)
        self._to.put(state.n_obstacles, len(shape))
        self._to.put(state.obstacle_shape, shape[:, 0])
        self._to.put(state.obstacle_nodes, shape[:, 1:])
        self._to.put(state.obstacle_numbers, of_shape)
        self._to.put(state.obstacle_sizes, of_size)
        self._to.put(state.obstacle_low, of_low)
        self._to.put(state.obstacle_start, start)
        size = poses.pose_size(self.spec.dim)
        rows = self._to.rows(state.obstacle_pose, len(start))
        rows[...] = 0
        rows[:, : 2 * size] = np.tile(start[:, :size], 2)  # at both ends of the step
        if state.has_nodes:
            self._to.put(state.obstacle_grid, np.concatenate(nodes[1:] or nodes))
