"""How one method is run: whole frames in one launch, or a launch for each step or phase.

`method` is a method's step, a ti.func over the containers; `loops.py` says how its loops run.
"""

import taichi as ti

from taichi_cloth.kernels.fracture import break_springs
from taichi_cloth.kernels.loops import COUNTER, PIECE, barrier
from taichi_cloth.kernels.solvers.phases import run_one_of
from taichi_cloth.kernels.watchdog import all_well, begin_step, checkpoint


@ti.func
def substep(method: ti.template(), spec: ti.template(), state: ti.template(), t, step):
    """Step number `step` (from 1) of a method, then fracture from the positions it reached."""
    begin_step(state, step)
    method(spec, state, t)
    if ti.static(spec.fracture):
        break_springs(spec, state, t)


@ti.func
def frames_as_thread(
    method: ti.template(), spec: ti.template(), state: ti.template(), t, done, frames, substeps
):
    """Frames after `done` steps, each kept and checked; state.passed counts those that passed.

    Nothing is computed after a frame that fails; its fault is in state.fault.
    """
    passed = 0
    for k in range(frames * substeps):
        if passed == k // substeps:
            if k % substeps == 0:
                checkpoint(spec, state, t)
            substep(method, spec, state, t, done + k + 1)
            if (k + 1) % substeps == 0:
                if all_well(state):
                    passed += 1
                barrier(spec, state)  # before the next frame forgets the fault
    if t == 0:
        state.passed[None] = passed


@ti.kernel
def frames_in_one_launch(
    method: ti.template(),
    spec: ti.template(),
    state: ti.template(),
    done: ti.i32,
    frames: ti.i32,
    substeps: ti.i32,
) -> ti.i32:
    """Frames after `done` steps on spec.threads threads; returns how many passed."""
    if ti.static(spec.threads == 1):
        ti.loop_config(serialize=True)
        for t in range(1):
            frames_as_thread(method, spec, state, t, done, frames, substeps)
    else:
        state.arrivals[COUNTER] = 0
        # Else Taichi starts no more threads than there are cores, and the others wait forever.
        ti.loop_config(parallelize=spec.threads)
        for i in range(spec.threads * PIECE):
            if i % PIECE == 0:
                frames_as_thread(method, spec, state, i // PIECE, done, frames, substeps)
    return state.passed[None]


@ti.kernel
def begin_launch(begin: ti.template(), spec: ti.template(), state: ti.template()):
    """What a method computes before its first step, every loop of it a parallel one.

    A kernel of its own: compile time grows with the square of what is in one.
    """
    begin(spec, state, 0)


@ti.kernel
def begin_step_launch(state: ti.template(), step: ti.i32):
    """Before the phases of step number `step`."""
    for _ in range(1):
        begin_step(state, step)
        state.phase[None] = 0


@ti.kernel
def phase_launch(phase: ti.template(), spec: ti.template(), state: ti.template()) -> ti.i32:
    """One phase of a step, every loop of it a parallel one; returns the next one."""
    phase(spec, state, 0)
    return state.phase[None]


@ti.kernel
def phases_in_one_launch(
    phased: ti.template(), these: ti.template(), spec: ti.template(), state: ti.template()
) -> ti.i32:
    """Phases of a step on spec.threads threads, while they are among `these`; returns the next."""
    if ti.static(spec.threads == 1):
        ti.loop_config(serialize=True)
        for t in range(1):
            while run_one_of(phased, these, spec, state, t):
                pass
    else:
        state.arrivals[COUNTER] = 0
        ti.loop_config(parallelize=spec.threads)
        for i in range(spec.threads * PIECE):
            if i % PIECE == 0:
                while run_one_of(phased, these, spec, state, i // PIECE):
                    pass
    return state.phase[None]


@ti.kernel
def end_step_launch(spec: ti.template(), state: ti.template()):
    """After the phases of a step: fracture."""
    break_springs(spec, state, 0)


@ti.kernel
def substep_launch(method: ti.template(), spec: ti.template(), state: ti.template(), step: ti.i32):
    """Step number `step`, every loop of it a parallel one."""
    substep(method, spec, state, 0, step)
