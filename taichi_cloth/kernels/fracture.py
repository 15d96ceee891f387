"""Springs that break: over its break force a spring pulls for one more step, then it is gone."""

import taichi as ti

from taichi_cloth.kernels.state import ALIVE, BREAKING, GONE


@ti.func
def break_springs(features: ti.template(), state: ti.template(), frame):
    """End of a step: remove the springs that were breaking; mark those now over their limit.

    The limit is compared as a squared length (force k*(l - rest) > limit means
    l > rest + limit/k), so no root is taken and both ends of a spring share one decision.
    """
    for s in range(state.n_springs[None]):
        if state.status[s] == BREAKING:
            state.status[s] = GONE
            for end in ti.static(range(2)):
                h = state.half[s][end]
                state.k[h] = 0.0
                if ti.static(features.dashpots):
                    state.c[h] = 0.0
        elif state.status[s] == ALIVE:
            d = state.x[state.ends[s][1]] - state.x[state.ends[s][0]]
            if d.dot(d) > state.break_length2[s]:
                state.status[s] = BREAKING
                state.break_frame[s] = frame


@ti.kernel
def mark_overstretched(features: ti.template(), state: ti.template(), frame: ti.i32):
    """Before the first step: springs that start over their limit pull once and are gone."""
    break_springs(features, state, frame)
