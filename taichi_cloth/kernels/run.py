"""The two ways to run one method: whole frames in one launch, or loop by loop in parallel.

`method` is a method's step, a ti.func over the containers. Inside the serial kernel its loops run
on one thread, which for small scenes beats starting threads for each loop; in the parallel kernel
they are top-level loops, each of them parallel.
"""

import taichi as ti

from taichi_cloth.kernels.fracture import break_springs
from taichi_cloth.kernels.watch import NO_FAULT, keep, look_up


@ti.func
def substep(method: ti.template(), features: ti.template(), state: ti.template(), step):
    """Step number `step` (from 1) of a method, then fracture from the positions it reached."""
    look_up(state)
    method(features, state)
    if ti.static(features.fracture):
        break_springs(features, state, step)


@ti.kernel
def frames_serial(
    method: ti.template(),
    features: ti.template(),
    state: ti.template(),
    done: ti.i32,
    frames: ti.i32,
    substeps: ti.i32,
) -> ti.i32:
    """Frames after `done` steps, each kept and checked, in one launch; returns how many passed.

    Nothing is computed after a frame that fails; its fault is in state.fault.
    """
    passed = 0
    ti.loop_config(serialize=True)
    for k in range(frames * substeps):
        if passed == k // substeps:
            if k % substeps == 0:
                keep(state)
            substep(method, features, state, done + k + 1)
            if (k + 1) % substeps == 0 and state.fault[None] == NO_FAULT:
                passed += 1
    return passed


@ti.kernel
def substep_parallel(
    method: ti.template(), features: ti.template(), state: ti.template(), step: ti.i32
):
    """Step number `step`, every loop of it parallel."""
    substep(method, features, state, step)
