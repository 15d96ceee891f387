"""Phases, for what goes on until it has converged: solvers, and contacts of faces.

They are a small state machine. Each phase is a ti.func(spec, state, t) that ends by saying which
one is next: by `go_to`, or by setting state.phase in a loop, before which there was another one:
some threads may yet have to read which phase they are in. In a launch of whole frames all threads
go from phase to phase together, and so do the blocks that stay on a CUDA GPU, be it for one step.
On other GPUs each phase is a launch, with spec.one_launch_per_step, and the host asks which one is
next. A phase must then not put its loops under a condition: what is not wanted is a loop over
nothing, or becomes another phase. On packs of several lanes a launch holds only some of a method's
phases (its `launches`), for as long as these lead to each other, because compile time grows with
the square of what is in a kernel.
"""

import functools

import taichi as ti

from taichi_cloth.kernels.loops import barrier

DONE = -1


@ti.func
def go_to(spec: ti.template(), state: ti.template(), t, phase):
    """End a phase by saying which one is next, or DONE after the last.

    All threads must give the same one.
    """
    barrier(spec, state, t)
    set_alone(spec, state.phase, t, phase)
    barrier(spec, state, t)


@ti.func
def set_alone(spec: ti.template(), field: ti.template(), t, value):
    """Set a 0-D field on one thread; the others must not read it before the next barrier."""
    if ti.static(spec.one_launch_per_step):
        for _ in range(1):
            field[None] = value
    else:
        if t == 0:
            field[None] = value


@functools.cache
def stepping(phases):
    """A ti.func(spec, state, t) that runs phases from the first one on until they are done."""
    every = tuple(range(len(phases)))

    @ti.func
    def step(spec: ti.template(), state: ti.template(), t):
        go_to(spec, state, t, 0)
        while state.phase[None] != DONE:
            _run_one_of(phases, every, spec, state, t)

    return step


@functools.cache
def together(phases, these):
    """A ti.func(spec, state, t) that runs phases for as long as the next one is one of `these`.

    phases: all phases of a method; these: the numbers of some.
    """

    @ti.func
    def run(spec: ti.template(), state: ti.template(), t):
        while _run_one_of(phases, these, spec, state, t):
            pass

    return run


@ti.func
def _run_one_of(
    phases: ti.template(), these: ti.template(), spec: ti.template(), state: ti.template(), t
):
    """Run the phase that comes next, if it is one of `these`; return 1 if it was, else 0.

    phases: all phases of a method; these: the numbers of some.
    """
    current, found = state.phase[None], 0
    for k in ti.static(these):
        if current == k:
            _run(ti.static(phases[k]), spec, state, t)
            found = 1
    return found


@ti.func
def _run(phase: ti.template(), spec: ti.template(), state: ti.template(), t):
    phase(spec, state, t)
