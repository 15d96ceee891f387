"""Fields of `State` back into NumPy arrays: by kernels, or by the host where it shares the memory.

Arrays have the device's precision, or are int32. n: particles; s: springs on the graph; l: links.
"""

import numpy as np
import taichi as ti

from taichi_cloth.front_end.mending import kernel
from taichi_cloth.kernels.grids import link_index
from taichi_cloth.kernels.loops import is_short
from taichi_cloth.kernels.packs import is_by_component, slot_number, slot_value
from taichi_cloth.kernels.state import ALIVE

# Of so many particles or springs the host reads what a kernel of all threads would read no sooner.
# Of 192 particles it takes 3 us for 50, and no kernel has to be compiled.
FEW = 4096
# Marks of springs lie in a row: so many take the host less than a kernel takes to start.
FEW_MARKS = 100_000


def is_by_host(state, count):
    """True if the host reads so many particles: on a processor, where they are few."""
    return state.memory is not None and count <= FEW


def are_marks_by_host(state, count):
    """True if the host reads the marks of so many springs on the graph."""
    return state.memory is not None and count <= FEW_MARKS


def vectors_in_memory(spec, state, field, out):
    """Read vectors by the host, as `read_vectors` does: `is_by_host`."""
    slots, rows = state.memory.of(state.slot)[: len(out)], state.memory.of(field)
    if spec.lanes == 1:
        np.take(rows, slots, axis=0, out=out, mode="clip")
    elif is_by_component(spec, field):
        out[...] = rows.reshape(spec.dim, -1)[:, slots].T
    else:
        packs = rows.reshape(-1, spec.dim, spec.lanes)
        out[...] = packs[slots // spec.lanes, :, slots % spec.lanes]


def fracture_in_memory(state, count):
    """Read marks of so many springs by the host, (count, 2), as `read_fracture` does."""
    marks = state.memory.of(state.status), state.memory.of(state.break_step)
    return np.stack([of[:count] for of in marks], axis=1)


def broken_in_memory(state, count):
    """The number of so many springs that are breaking or gone, counted by the host."""
    return int(np.count_nonzero(state.memory.of(state.status)[:count] != ALIVE))


def work_in_memory(state):
    """Take the counts of work, (3,), by the host where it shares the memory."""
    counts = state.memory.of(state.work)
    work = counts.copy()
    counts[:] = 0
    return work


@kernel
def read_vectors(
    spec: ti.template(), state: ti.template(), field: ti.template(), out: ti.types.ndarray()
):
    """Copy a field of vectors in packs to `out` (n, dim), in the order of the particles."""
    ti.loop_config(serialize=state.is_short)
    for i in range(out.shape[0]):
        vector = slot_value(spec, field, state.slot[i])
        for axis in ti.static(range(spec.dim)):
            out[i, axis] = vector[axis]


@kernel
def take_work(state: ti.template(), out: ti.types.ndarray()):
    """Copy the counts of the solver's work (`state.WORK`) to `out` (3,), and set them to 0."""
    ti.loop_config(serialize=True)  # to wake another thread takes longer
    for i in range(out.shape[0]):
        out[i] = state.work[i]
        state.work[i] = 0


@kernel
def read_fracture(state: ti.template(), out: ti.types.ndarray()):
    """Copy status and break_step of the springs on the graph to `out` (s, 2)."""
    for s in range(out.shape[0]):
        out[s, 0] = state.status[s]
        out[s, 1] = state.break_step[s]


@kernel
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


@kernel
def read_numbers(field: ti.template(), places: ti.types.ndarray(), out: ti.types.ndarray()):
    """Copy the numbers of half-springs out, (s,): those at `places` (s,) in a field of theirs."""
    for s in range(out.shape[0]):
        out[s] = field[places[s]]


@kernel
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


@kernel
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
