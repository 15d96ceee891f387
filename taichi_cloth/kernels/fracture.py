"""Springs that break: over its break force a spring pulls for one more step, then it is gone."""

import taichi as ti

from taichi_cloth.kernels.springs_graph import number
from taichi_cloth.kernels.state import ALIVE, BREAKING, GONE


@ti.func
def mark_overstretched(features: ti.template(), state: ti.template(), s, step):
    """Mark spring s where its force exceeds its break force at the present positions.

    The limit is compared as a squared length (force k*(l - rest) > limit means
    l > rest + limit/k), so no root is taken and both ends of a spring share one decision.
    """
    if state.status[s] == ALIVE:
        d = state.x[state.ends[s][1]] - state.x[state.ends[s][0]]
        if d.dot(d) > number(features, state.break_length2, s):
            state.status[s] = BREAKING
            state.break_step[s] = step


@ti.func
def break_springs(features: ti.template(), state: ti.template(), step):
    """End of a step: remove the springs that were breaking; mark those now over their limit."""
    for s in range(state.n_springs[None]):
        if state.status[s] == BREAKING:
            state.status[s] = GONE
            for end in ti.static(range(2)):
                # A spring from a particle to itself pulls nowhere.
                state.far[state.half[s][end]] = state.ends[s][end]
        else:
            mark_overstretched(features, state, s, step)


@ti.kernel
def mark_new_springs(features: ti.template(), state: ti.template(), step: ti.i32):
    """Outside of steps: springs that are over their limit from the start pull once and are gone."""
    for s in range(state.n_springs[None]):
        mark_overstretched(features, state, s, step)
