"""The fields of what touches: the collision grid, pairs, obstacles, faces, and their account."""

import taichi as ti

from taichi_cloth.kernels import poses, rest
from taichi_cloth.kernels.collision_grid import BLOCK, MOST_BINS, MOST_KEPT, MOST_NEAR, most_cells
from taichi_cloth.kernels.fields import Fields, Surface, placed
from taichi_cloth.kernels.obstacles import contract
from taichi_cloth.kernels.pair_colours import COLOURS
from taichi_cloth.kernels.patches import ANCHOR_ROWS
from taichi_cloth.kernels.patches import BLOCK as PATCH_BLOCK

FACE_COLUMNS = 21  # of state.face (`faces.py`)
FACE_CONTACTS = 4  # that a triangle may have at once


def pairs_act_at_once():
    """True if a device has room for pairs of cloth that all act at once: where it is a GPU."""
    return ti.cfg.arch != ti.cpu


class ContactFields(Fields):
    """The part of a `State` that has what contacts need.

    The collision grid (`collision_grid.py`): grid_bits: binary logarithms of the cells along each
        axis; per_cell: cells per length along each; largest_radius: of those that are not in the
        cell of large ones; cell_end, sorted_index, sorted: the particles by cell; cell_of,
        block_start, bins, bin_bits (binary logarithm of the cells in a bin), bin_fill, bin_start,
        bin_size, binned_cell, binned_index: the sort's.
    Resting pairs (`resting_pairs.py`): near, near_count, touching, pair_friction,
        pair_residual, pair_iteration; unsettled: steps that ended before all pairs were apart.
    With thickness (`kept_pairs.py`, `patches.py`): pair_radius, pair_restitution: of particles for
        each other; skin: how much farther pairs are kept; outdated, overfull: whether they are to
        be listed anew, and whether some list was full in this step; n_patches, patch_start,
        in_patches, patch_place, patch_of: the particles of each patch by place, the place of each
        particle, and the patch of each place; patch_box, block_box: low and high corners of the
        boxes around a patch and its blocks; block_anchors: of the places of a block, with their
        radii; anchored: whether it was in this step; drift, stale: of each two patches, their drift
        and skin, and whether their lists are to be made anew;
        n_stale: how many; patch_ahead: how far a patch looks along its way; listed_x, listed_begun:
        their anchors, and where the step began; kept, kept_count: codes of pairs; found,
        found_reach, found_start, found_count: those that may touch in this step; far: whose step
        went far; closer_start, closer_other, closer_reach: `scene.spheres`.
        What is swept (`pair_colours.py`, `swept_pairs.py`): near_from, near, near_reach: pairs by
        colour; colour_size: how many; colours_at: the colours of a particle, as bits; changed: the
        sweep that changed it last, and one more; pushed_far: whether they pushed somebody farther
        than what was found allows for; pair_round: of how many rounds, 0 between steps. With one
        launch per step: near_start: the first row of those near a place; active, n_active: who has
        any; visited: the last iteration
        in which they are visited; touch, touch_normal, touch_count: the pairs that touch in one,
        with normals and gaps.

    Obstacles (`poses.py`), a row each: obstacle_shape: its number in spec.obstacles;
        obstacle_numbers, obstacle_sizes: of contact and of its shape; obstacle_start: its pose at
        time 0 and its velocities; obstacle_pose: its poses at both ends of the step,
        and (held) its mean rates in the next one; obstacle_part (moving): of the step, in which it
        moves; free_ball (not moving): of each slot, the middle of a ball that is free of obstacles,
        and the square of its radius (`obstruction.py`).
        held_by, held_at: what each particle goes with, 1 + its row, and where (`grips.py`).
        elements, face, face_hits, face_left, face_deep, face_row, face_count, face_finds,
        face_sweeps, faces_unsettled (faces): a `Surface` of what is tested against sharp
        obstacles, and what comes of that (`faces.py`); face_kick: what they have changed of each
        particle's velocity in a step in which any met something, face_jump: what walls and pairs
        had before; face_free, face_push: where it was before, and how far they have moved it;
        face_clear, face_seen, face_way, face_unseen: what need not be looked at
        (`face_clearance.py`); rest_x, rest_v, rest_way, rest_span, rest_phase, rest_steps, stirred:
        of what comes to rest (`rest.py`).
        obstacle_low, obstacle_nodes, obstacle_grid: of its grid of distances, where it has one.
    The account of contacts (`contact_account.py`): accounting: whether it is kept; opened_x,
        opened_v, free_x, free_v, ended_x: the step's start, free end and end; held_x, held_v: what
        walls changed as that was reached; contact_work: of each particle; touched: whether anything
        was, in the step; account_part; first_touch: the number of the first such step;
        contact_energy: what contacts gave in steps in which they gave any; contact_balance: in all,
        what they took set against it.
    """

    def _place_collision_grid(self, spec):
        n = max(self.capacity.particles, 1)
        cells = most_cells(n, spec.thick)
        self.grid_bits, self.per_cell = self._counts(spec.dim), self._scalars(spec.dim)
        self.bins, self.bin_bits = self._counts(), self._counts()
        self.largest_radius = self._scalars()
        self.count_names += ["grid_bits", "bins", "bin_bits"]
        self.number_names += ["per_cell", "largest_radius"]
        self.cell_end, self.cell_of, self.sorted_index = (
            self._counts(count) for count in (cells + 2, n, n)
        )
        # In two halves: what is being sorted, or goes from iteration to iteration, changes sides.
        self.sorted_half, self.sorted = n, self._scalars(2 * n, 2 * spec.dim + 2)
        if spec.resting:
            self.pair_friction, self.pair_residual = self._scalars(), self._raised(2, 2)
            self.number_names.append("pair_friction")
            self.near_count = self._counts(n)
            if not spec.thick:
                self.near = self._counts(n, MOST_NEAR)
            self.touching = self._scalars(n, 2)
            self.pair_iteration, self.unsettled = self._counts(), self._counts()
        if spec.thick:
            self._place_kept_pairs(spec)
        self.block_start = self._counts(cells // BLOCK + 1)
        self.bin_fill = self._counts(spec.threads * (MOST_BINS + 1))
        self.bin_start, self.bin_size = self._counts(MOST_BINS + 1), self._counts(MOST_BINS + 1)
        self.binned_cell, self.binned_index = self._counts(n), self._counts(n)

    def _place_kept_pairs(self, spec):
        n = max(self.capacity.particles, 1)
        self.skin = self._scalars()
        self.outdated, self.overfull, self.n_stale = (self._counts() for _ in range(3))
        self.number_names.append("skin")
        patches = max(self.capacity.patches, 1)
        self.n_patches, self.patch_start = self._counts(), self._counts(patches + 1)
        self.in_patches, self.patch_place, self.patch_of = (self._counts(n) for _ in range(3))
        self.anchored = self._counts(patches)
        blocks = n // PATCH_BLOCK + patches + 1
        self.block_box = self._scalars(blocks, 6)
        self.block_anchors = self._scalars(blocks, ANCHOR_ROWS * PATCH_BLOCK)
        self.drift, self.stale = self._scalars(patches**2, 4), self._counts(patches**2)
        self.patch_box, self.patch_ahead = self._scalars(patches, 30), self._scalars(patches)
        self.found, self.found_reach = self._counts(n * MOST_KEPT), self._scalars(n * MOST_KEPT)
        self.found_start, self.found_count = self._counts(n), self._counts(n)
        self.near, self.near_reach = self._counts(n * MOST_KEPT), self._scalars(n * MOST_KEPT)
        self.near_from, self.colour_size = self._counts(n * MOST_KEPT), self._counts(COLOURS + 1)
        self.colours_at, self.changed = self._counts(n), self._counts(n)
        self.pushed_far, self.pair_round = self._counts(), self._counts()
        if pairs_act_at_once():
            self.active, self.n_active = self._counts(n), self._counts()
            self.visited, self.near_start = self._counts(n), self._counts(n)
            self.touch, self.touch_count = self._counts(n * MOST_KEPT), self._counts(n)
            self.touch_normal = self._scalars(n * MOST_KEPT, spec.dim + 1)
        self.listed_x, self.listed_begun = (self._scalars(n, spec.dim) for _ in range(2))
        self.kept, self.kept_count = self._counts(n, MOST_KEPT), self._counts(n)
        self.far = self._counts(n)
        closer = self.capacity.closer + 1  # one more is read, of who has none
        self.closer_start, self.closer_other = self._counts(n + 1), self._counts(closer)
        self.closer_reach = self._scalars(closer)

    def _place_obstacles(self, spec):
        count, nodes = max(self.capacity.obstacles, 1), self.capacity.nodes
        self.n_obstacles = self._counts()
        self.obstacle_shape, self.obstacle_nodes = self._counts(count), self._counts(count, 4)
        self.obstacle_numbers = self._scalars(count, len(contract.NUMBERS))
        self.obstacle_sizes = self._scalars(count, contract.SIZES)
        self.obstacle_low = self._scalars(count, 3)
        self.obstacle_start = self._scalars(count, poses.start_size(spec.dim))
        self.obstacle_pose = self._scalars(count, poses.poses_size(spec))
        if spec.moving:
            self.obstacle_part = self._scalars(count)
        if not spec.moving:
            self.free_ball = self._scalars(self.packs * spec.lanes, spec.dim + 1)
        self.has_nodes = nodes > 0
        if self.has_nodes:
            self.obstacle_grid = self._scalars(nodes, 4)

    def _place_account(self, spec):
        held = ("held_x", "held_v") if spec.walls else ()
        for name in ("free_x", "free_v", "ended_x", "opened_x", "opened_v", *held):
            setattr(self, name, self._pack_vectors(spec))
        self.contact_work = self._pack_numbers(spec)
        self.accounting, self.touched = self._counts(), self._counts()
        self.first_touch, self.account_part = self._counts(), self._counts()
        self.contact_energy = placed(tree := ti.FieldsBuilder(), ti.field(self.wide))
        self.contact_balance = placed(tree, ti.field(self.wide))
        self.wide_tree = tree.finalize()

    def _place_faces(self, spec):
        m, n = max(self.capacity.elements, 1), self.capacity.particles
        self.elements = Surface(self.real, m, n, self._reals, self._integers)
        self.face = self._scalars(FACE_CONTACTS * m, FACE_COLUMNS)
        self.face_left, self.face_deep = self._raised(), self._raised()
        self.face_row, self.face_count = self._counts(m, 3), self._counts(max(min(n, 3 * m), 1))
        self.face_finds, self.face_sweeps = self._counts(), self._counts()
        self.faces_unsettled = self._counts()
        self.face_hits, self.face_clear = self._counts(m), self._scalars(m)
        rows = max(min(n, 3 * m), 1)
        self.face_seen, self.face_way = self._scalars(rows, spec.dim), self._scalars(rows)
        self.face_kick = self._pack_vectors(spec)
        self.face_jump = self._pack_vectors(spec)
        self.face_free, self.face_push = self._pack_vectors(spec), self._pack_vectors(spec)
        self.face_unseen = self._counts()
        if rest.needed(spec):
            self.rest_x, self.rest_v = self._pack_vectors(spec), self._pack_vectors(spec)
            self.rest_way, self.rest_span = self._scalars(), self._counts()
            self.rest_phase, self.rest_steps, self.stirred = (self._counts() for _ in range(3))
            self.number_names.append("rest_way")
            self.count_names.append("rest_span")
