"""Kernels that copy fields of `State` back into NumPy arrays.

Arrays have the device's precision, or are int32. n: particles; s: springs on the graph; l: links.
"""

import taichi as ti

from taichi_cloth.kernels.grids import link_index
from taichi_cloth.kernels.loops import is_short
from taichi_cloth.kernels.packs import slot_number, slot_value
from taichi_cloth.kernels.state import ALIVE


@ti.kernel
def read_vectors(
    spec: ti.template(), state: ti.template(), field: ti.template(), out: ti.types.ndarray()
):
    """Copy a field of vectors in packs to `out` (n, dim), in the order of the particles."""
    ti.loop_config(serialize=state.is_short)
    for i in range(out.shape[0]):
        vector = slot_value(spec, field, state.slot[i])
        for axis in ti.static(range(spec.dim)):
            out[i, axis] = vector[axis]


@ti.kernel
def take_work(state: ti.template(), out: ti.types.ndarray()):
    """Copy the counts of the solver's work (`state.WORK`) to `out` (3,), and set them to 0."""
    ti.loop_config(serialize=True)  # to wake another thread takes longer
    for i in range(out.shape[0]):
        out[i] = state.work[i]
        state.work[i] = 0


@ti.kernel
def read_fracture(state: ti.template(), out: ti.types.ndarray()):
    """Copy status and break_step of the springs on the graph to `out` (s, 2)."""
    for s in range(out.shape[0]):
        out[s, 0] = state.status[s]
        out[s, 1] = state.break_step[s]


@ti.kernel
def read_link_fracture(
    spec: ti.template(), state: ti.template(), links: ti.types.ndarray(), out: ti.types.ndarray()
):
    """Copy status and break_step of links to `out` (l, 2).

    links: (l, 2): kind, slot of the earlier end.
    """
    for i in range(links.shape[0]):
        link = link_index(state, links[i, 0], 0) * spec.lanes + links[i, 1]
        out[i, 0] = slot_number(spec, state.link_status, link)
        out[i, 1] = slot_number(spec, state.link_step, link)


@ti.kernel
def read_numbers(field: ti.template(), places: ti.types.ndarray(), out: ti.types.ndarray()):
    """Copy the numbers of half-springs out, (s,): those at `places` (s,) in a field of theirs."""
    for s in range(out.shape[0]):
        out[s] = field[places[s]]


@ti.kernel
def read_link_numbers(
    spec: ti.template(),
    state: ti.template(),
    field: ti.template(),
    links: ti.types.ndarray(),
    out: ti.types.ndarray(),
):
    """Copy the links' own numbers in a field out, (l,); links: (l, 2): kind, slot."""
    for i in range(links.shape[0]):
        link = link_index(state, links[i, 0], 0) * spec.lanes + links[i, 1]
        out[i] = slot_number(spec, field, link)


@ti.kernel
def count_broken(spec: ti.template(), state: ti.template()) -> ti.i32:
    """The number of springs, on the graph and of grids, that are breaking or gone."""
    count = 0
    if ti.static(spec.fracture and spec.springs):
        if ti.static(is_short(state.status.shape[0])):
            ti.loop_config(serialize=True)
        for s in range(state.n_springs[None]):
            count += ti.cast(state.status[s] != ALIVE, ti.i32)
    if ti.static(spec.fracture and spec.kinds > 0):
        if ti.static(is_short(state.link_status.shape[0])):
            ti.loop_config(serialize=True)
        for i in range(state.n_packs[None]):
            for lane in ti.static(range(spec.lanes)):
                for s in range(spec.kinds):
                    link = link_index(state, s, i) * spec.lanes + lane
                    status = slot_number(spec, state.link_status, link)
                    count += ti.cast(status != ALIVE, ti.i32)
    return count
