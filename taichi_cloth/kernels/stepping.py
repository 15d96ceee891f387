"""Kernels that run a method: whole frames in one launch, or a launch for each step or phase.

`method` is a method's step, a ti.func(spec, state, t); `loops.py` says how its loops run. done:
how many steps came before; steps are numbered from 1.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import taichi as ti

from taichi_cloth.front_end.mending import kernel
from taichi_cloth.kernels.forces import load
from taichi_cloth.kernels.forces.contract import has
from taichi_cloth.kernels.fracture import break_springs
from taichi_cloth.kernels.lane_memory import lane_memory_type, see
from taichi_cloth.kernels.loops import BLOCK, COUNTER, PIECE, barrier, in_blocks
from taichi_cloth.kernels.near_pairs import find_pairs
from taichi_cloth.kernels.parts import has_parts, in_turn
from taichi_cloth.kernels.resting_pairs import iterate
from taichi_cloth.kernels.settling import acts_of, ends_step, goes_on, once_a_step, settle
from taichi_cloth.kernels.watchdog import all_well, begin_step, checkpoint


def _parts(method, spec, state):
    """The method's step and the acts of contacts at its end, as ti.funcs(spec, state, t)."""
    return once_a_step(method), *acts_of(spec, state)


@ti.func
def substep(method: ti.template(), spec: ti.template(), state: ti.template(), t, step):
    """Run step number `step` of a method, then break springs by the positions that it reached."""
    begin_step(state, step)
    if ti.static(has_parts(spec)):
        going = 1
        while going == 1:
            ti.static(in_turn(state, _parts(method, spec, state)))(spec, state, t)
            going = goes_on(state)
    else:
        method(spec, state, t)
        settle(spec, state, t)
    _leave_step(spec, state, t)


def after_steps(spec):
    """The parts of the scene's forces at the end of each step, as ti.funcs."""
    terms = [load(name) for name in spec.terms]
    return [term.after_step for term in terms if has(term.after_step)]


def has_end(spec):
    """True if anything comes at the end of a step, so that `end_step` is not empty."""
    return bool(spec.fracture or after_steps(spec) or ends_step(spec))


@ti.func
def end_step(spec: ti.template(), state: ti.template(), t):
    """End a step: its contacts, what forces do then, and fracture from the positions it reached."""
    settle(spec, state, t)
    _leave_step(spec, state, t)


@ti.func
def _leave_step(spec: ti.template(), state: ti.template(), t):
    for after_step in ti.static(after_steps(spec)):
        after_step(spec, state, t)
    if ti.static(spec.fracture):
        break_springs(spec, state, t)


@ti.func
def frames_as_thread(
    method: ti.template(), spec: ti.template(), state: ti.template(), t, done, frames, substeps
):
    """Run frames as thread t, with a checkpoint before each; state.passed counts those that passed.

    done: steps before the first frame; frames: how many; substeps: steps in each. A frame passes if
    the watchdog has found no fault in it. Nothing is computed after one that has not; its fault is
    in state.fault.
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
                barrier(spec, state, t)  # before the next frame forgets the fault
    if t == 0:
        state.passed[None] = passed


class Kernels(NamedTuple):
    """Kernels that see the memory of lanes: see `kernels_of`."""

    frames: Callable
    once: Callable


@functools.cache
def kernels_of(lanes, real):
    """The kernels for packs of so many lanes of numbers of a type.

    memory: of each kernel State.lane_memory (`lane_memory.py`).
    """
    memory_type = lane_memory_type(lanes, real)

    @kernel
    def run_frames(
        method: ti.template(),
        spec: ti.template(),
        state: ti.template(),
        memory: memory_type,
        done: ti.i32,
        frames: ti.i32,
        substeps: ti.i32,
    ) -> ti.i32:
        """Run frames on spec.threads threads; return how many passed (see `frames_as_thread`)."""
        ti.static(see(memory))
        if ti.static(spec.threads == 1):
            ti.loop_config(serialize=True)
            for t in range(1):
                frames_as_thread(method, spec, state, t, done, frames, substeps)
        elif ti.static(in_blocks(spec)):
            ti.loop_config(block_dim=BLOCK)
            for t in range(spec.threads):
                frames_as_thread(method, spec, state, t, done, frames, substeps)
        else:
            state.arrivals[COUNTER] = 0
            # Else Taichi starts no more threads than there are cores, and the others wait forever.
            ti.loop_config(parallelize=spec.threads)
            for i in range(spec.threads * PIECE):
                if i % PIECE == 0:
                    frames_as_thread(method, spec, state, i // PIECE, done, frames, substeps)
        return state.passed[None]

    @kernel
    def run_once(
        body: ti.template(), spec: ti.template(), state: ti.template(), memory: memory_type
    ) -> ti.i32:
        """Run body(spec, state, t) on spec.threads threads; return the phase that is next.

        body: `phases.together` of some phases of a step, what ends a step, a frame's checkpoint, or
        what a method computes before its next step.
        """
        ti.static(see(memory))
        if ti.static(spec.threads == 1):
            ti.loop_config(serialize=True)
            for t in range(1):
                body(spec, state, t)
        elif ti.static(in_blocks(spec)):
            ti.loop_config(block_dim=BLOCK)
            for t in range(spec.threads):
                body(spec, state, t)
        else:
            state.arrivals[COUNTER] = 0
            ti.loop_config(parallelize=spec.threads)
            for i in range(spec.threads * PIECE):
                if i % PIECE == 0:
                    body(spec, state, i // PIECE)
        return state.phase[None]

    return Kernels(run_frames, run_once)


@kernel
def begin_launch(begin: ti.template(), spec: ti.template(), state: ti.template(), done: ti.i32):
    """Compute what a method wants before its next step, with every loop run in parallel."""
    for _ in range(1):
        state.step[None] = done
    begin(spec, state, 0)


@kernel
def begin_step_launch(state: ti.template(), step: ti.i32):
    """Prepare the phases of step number `step`, of which the first comes next."""
    begin_step(state, step)
    state.phase[None] = 0


@kernel
def phase_launch(phase: ti.template(), spec: ti.template(), state: ti.template()) -> ti.i32:
    """Run one phase of a step, with every loop run in parallel; return the phase that is next."""
    phase(spec, state, 0)
    return state.phase[None]


@kernel
def end_step_launch(spec: ti.template(), state: ti.template()):
    """End a step after its phases."""
    end_step(spec, state, 0)


@kernel
def method_launch(method: ti.template(), spec: ti.template(), state: ti.template(), step: ti.i32):
    """Run step number `step` up to its free end, with every loop run in parallel."""
    begin_step(state, step)
    method(spec, state, 0)


@kernel
def act_launch(act: ti.template(), spec: ti.template(), state: ti.template()):
    """Do one of the acts that end a step."""
    act(spec, state, 0)


@kernel
def find_pairs_launch(spec: ti.template(), state: ti.template()):
    """Find who may rest on whom."""
    find_pairs(spec, state, 0)


@kernel
def iterate_launch(spec: ti.template(), state: ti.template(), done: ti.i32):
    """Do an iteration of resting pairs, after `done` of them."""
    iterate(spec, state, 0, done)


@kernel
def substep_launch(method: ti.template(), spec: ti.template(), state: ti.template(), step: ti.i32):
    """Run step number `step`, with every loop run in parallel."""
    substep(method, spec, state, 0, step)
