"""Checkpoints: the fields kept from step to step, and their copies to NumPy and back.

A run that goes on from a copy has the same bits as the one it was copied from if the copy has all
that later steps read before they write it. So every field of `State` is kept, unless it is named
here: a field that is added and forgotten costs memory, and no bit.

`LOADED` are filled by a load, from the scene and the run's settings alone, and no step changes
them. `WITHIN_STEP` are filled in each step before they are read, or only say what need not be
looked at: free balls, and the clearance of faces, which is forgotten where one goes back. Tests
hold both to that: by a run that goes on in new fields, and by comparing what is loaded before and
after a run.
"""

from dataclasses import dataclass
from typing import Any

import taichi as ti

from taichi_cloth.front_end.mending import kernel
from taichi_cloth.kernels.field_rows import copy_row, is_whole, kind_of, width_of
from taichi_cloth.kernels.forces import device_fields, load
from taichi_cloth.kernels.forces.contract import has
from taichi_cloth.kernels.loops import is_short
from taichi_cloth.kernels.spring_numbers import NUMBERS


def _names(text):
    """The names in a text, which are apart by blanks."""
    return frozenset(text.split())


# Fields of the packs and of the particles; of grids and the graph; of stencils; of pairs; of
# obstacles.
LOADED = _names(
    """w slot particle radius restitution held_by held_at pair_radius pair_restitution own
    n_packs n_pieces n_groups n_grids grid grid_of link forward link_shortest2 link_longest2 line
    n_csr_rows csr_slot csr_start csr_other csr_run first_copy n_copies
    n_colours colour_start coloured n_springs ends half shortest2 longest2 link_k line_k
    n_stencils stencil_start stencil_slot stencil_weight stencil_k row_stencils row_stencil
    row_weight side_start side n_stencil_colours stencil_colour graph_blocks members_start members
    closer_start closer_other closer_reach n_patches patch_start in_patches patch_place patch_of
    n_obstacles obstacle_shape obstacle_nodes obstacle_numbers obstacle_sizes obstacle_low
    obstacle_start obstacle_grid"""
)
# Where springs break, a step changes these after all.
CHANGED_BY_FRACTURE = frozenset({"csr_other", "link_k", "line_k", "stencil_k"})
WITHIN_STEP = _names(
    """saved_x saved_v saved_x_low saved_v_low begun_x begun_v begun_x_low jump ring_forces sums
    arrivals passed phase fault watching traction traction_damping
    link_axis link_across csr_axis csr_across joined
    over_pivots below blocks n_blocks block_of holds_fixed
    coarse pivots coarse_residual coarse_downhill coarse_product coarse_solved
    impulse link_impulse line_impulse stencil_impulse stencil_pull
    cell_end cell_of sorted_index sorted block_start bin_fill bin_start bin_size binned_cell
    binned_index near near_count near_start near_reach touching
    found found_start found_count found_reach near_from colour_size colours_at changed
    pushed_far pair_round touch touch_count touch_normal active n_active visited
    listed_begun pair_residual pair_iteration
    face face_hits face_left face_deep face_row face_count face_finds face_sweeps face_kick
    face_jump face_free face_push stirred
    free_ball face_clear face_seen face_way face_unseen
    opened_x opened_v free_x free_v ended_x held_x held_v contact_work accounting touched
    first_touch account_part contact_energy"""
)


@dataclass(frozen=True)
class Kept:
    """A field that is copied, `blocks` times `room` rows of `width` numbers each.

    kind: how it is indexed (`field_rows.py`); whole: whether it has whole numbers.
    """

    name: str
    field: Any
    kind: int
    blocks: int
    room: int
    width: int
    whole: bool


def is_kept(spec, state, method, name):
    """True if a field of a state is kept from step to step."""
    if name in WITHIN_STEP:
        return False
    loaded = LOADED - CHANGED_BY_FRACTURE if spec.fracture else LOADED
    loaded |= {*state.number_names, *state.count_names, *_numbers_of_springs(spec)}
    loaded |= {field.name for field in device_fields(spec) if field.value}
    loaded -= _changed_by_hand(spec)
    if method.begin is None:  # such a method keeps nothing: what it remembers is within a step
        loaded |= {"a", *method.vectors, *method.low_vectors, *method.traction_vectors}
        loaded |= {*method.numbers}
    return name not in loaded


def _changed_by_hand(spec):
    """Fields that a force changes without a load, such as the mouse's hold."""
    terms = [load(name) for name in spec.terms]
    fields = [field for term in terms if has(term.acts) for field in term.fields]
    return {"w", *(field.name for field in fields)} if fields else set()


def _numbers_of_springs(spec):
    """The names of the fields with numbers of springs that no step changes."""
    return {
        f"{place}_{number.letter}"
        for number in NUMBERS
        for place in ("csr", "link", "spring")
        if not number.changes(spec.terms)
        and f"{place}_{number.letter}" != "link_k"
        and not (place == "csr" and spec.packed_rows and spec.fracture)
    }


def kept(spec, state, method):
    """The fields of a state that are kept, those of the same rooms together.

    What is in objects of its own, such as the triangles in a `Surface`, is loaded.
    """
    found = [
        _described(state, name, field)
        for name, field in vars(state).items()
        if isinstance(field, ti.Field) and is_kept(spec, state, method, name)
    ]
    return tuple(sorted(found, key=lambda of: (of.room, of.blocks, of.name)))


def _described(state, name, field):
    rows = field.shape[0] if field.shape else 1
    of_links = rows != state.packs and rows % state.packs == 0 and name.startswith(("link", "line"))
    blocks = rows // state.packs if of_links else 1
    for of, room in state.by_component:
        if field is of:
            blocks = rows // room
    kind, width = kind_of(field), width_of(field)
    return Kept(name, field, kind, blocks, rows // blocks, width, is_whole(field))


def in_use(state, packs, particles, springs, patches):
    """The rows of each room of a state that are in use: {room: rows}.

    packs, particles, springs, patches: how many there are; springs: those on the graph.
    """
    room, rows = state.capacity, {}
    counts = (
        (state.packs, packs),
        *((slots, state.lanes * packs) for _, slots in state.by_component),
        (room.particles, particles),
        (room.springs, springs),
        (2 * room.springs, 2 * springs),
        (room.patches, patches),
        (room.patches**2, patches**2),  # of each two
    )
    for capacity, count in counts:  # where two have the same room, all that either uses
        rows[capacity] = max(min(count, capacity), rows.get(capacity, 1))
    return {capacity: count for capacity, count in rows.items() if capacity > 1}


def groups_of(fields):
    """Loops of `copy_kept`: for each room and number of blocks, one over the rows.

    (room, blocks, number of the group, its fields: (field, kind, width, whether it has whole
    numbers, number of the field)).
    """
    groups = {}
    for at, of in enumerate(fields):
        rows = groups.setdefault((of.room, of.blocks), [])
        rows.append((of.field, of.kind, of.width, of.whole, at))
    return tuple((*of, g, tuple(rows)) for g, (of, rows) in enumerate(groups.items()))


@kernel
def copy_kept(
    state: ti.template(),
    back: ti.template(),
    reals: ti.types.ndarray(),
    counts: ti.types.ndarray(),
    rows: ti.types.ndarray(),
    begins: ti.types.ndarray(),
):
    """Copy all that is kept to two arrays, (numbers,), field after field; `back`: from these.

    rows: (groups, 2): how many rows of each block are in use, and of all blocks; begins: (fields,):
    where each begins in the array of real or of whole numbers.
    """
    for room, blocks, g, fields in ti.static(state.kept_groups):
        if ti.static(is_short(room * blocks)):
            ti.loop_config(serialize=True)
        for i in range(rows[g, 1]):
            used = rows[g, 0]
            r = i // used * room + i % used
            for field, kind, width, whole, at in ti.static(fields):
                if ti.static(whole):
                    copy_row(field, kind, width, back, r, counts, begins[at] + i * width)
                else:
                    copy_row(field, kind, width, back, r, reals, begins[at] + i * width)
