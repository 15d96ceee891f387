"""Steps whose rounds are not known beforehand: solvers that go on until they have converged.

Such a method is a small state machine. Each of its phases is a ti.func(spec, state, t) that ends
with `go_to`. In a launch of whole frames all threads go from phase to phase together. Where loops
are one launch per step a phase is a launch, and the host asks which one is next; so a phase must not put its
loops under a condition: what is not wanted is a loop over nothing, or a phase of its own. In packs
of lanes, where compile time grows with the square of what is in a kernel, a launch holds some of
the phases, the method's `launches`, for as long as they lead to each other.
"""

import functools

import taichi as ti

from taichi_cloth.kernels.loops import barrier

DONE = -1


@ti.func
def go_to(spec: ti.template(), state: ti.template(), t, phase):
    """End of a phase: which one is next, DONE after the last. Read by all threads alike."""
    barrier(spec, state)
    set_alone(spec, state.phase, t, phase)
    barrier(spec, state)


@ti.func
def set_alone(spec: ti.template(), field: ti.template(), t, value):
    """of[None] = value, by one thread; what others read of it comes after a barrier."""
    if ti.static(spec.one_launch_per_step):
        for _ in range(1):
            field[None] = value
    else:
        if t == 0:
            field[None] = value


@functools.cache
def stepping(phases):
    """The step that goes through `phases`, as a ti.func: for launches of whole frames."""
    every = tuple(range(len(phases)))

    @ti.func
    def step(spec: ti.template(), state: ti.template(), t):
        go_to(spec, state, t, 0)
        while state.phase[None] != DONE:
            run_one_of(phases, every, spec, state, t)

    return step


@ti.func
def run_one_of(
    phases: ti.template(), these: ti.template(), spec: ti.template(), state: ti.template(), t
):
    """Run the phase that comes next, if it is one of `these`; whether it was."""
    current, found = state.phase[None], 0
    for k in ti.static(these):
        if current == k:
            _run(ti.static(phases[k]), spec, state, t)
            found = 1
    return found


@ti.func
def _run(phase: ti.template(), spec: ti.template(), state: ti.template(), t):
    phase(spec, state, t)
