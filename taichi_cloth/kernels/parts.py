"""Parts of a step that are compiled each by itself: Taichi's real functions.

Taichi searches a kernel as a whole for what is computed in it twice, which takes a time with the
square of the kernel; a real function is searched by itself. So in scenes with cloth that has a
thickness, whose kernels are the longest, the method's step and each act of the contacts that end it
is one: they compile in half the time or less (docs/speed.md, "Start-up"), to the same bits. In
others it would gain nothing, and loops that run for a short time would miss what Taichi does for
kernels alone: to keep what they do not change.

No kernel and no function calls more than one of them: the first act's calls the second's, and so
on. Taichi names what it keeps in its cache by all functions that are called, in an order that their
addresses decide: of two it would often not find what it has.
"""

import taichi as ti

from taichi_cloth.front_end import mending


def has_parts(spec):
    """True if a step of a specialization is compiled in parts.

    Lanes would be slower so: those of implicit methods half as fast.
    """
    runs_frames = spec.lanes == 1 and not spec.one_launch_per_step
    return runs_frames and spec.thick and mending.functions_work()


def in_turn(state, acts):
    """A function (spec, state, t) that runs acts, ti.funcs of these, one after the other.

    The state keeps it, because it keeps the state, of whose fields it is made.
    """
    if acts not in state.functions:
        rest = in_turn(state, acts[1:]) if acts[1:] else None
        state.functions[acts] = _followed(acts[0], rest)
    return state.functions[acts]


def _followed(act, rest):
    """A function that runs an act, and then the function `rest`, unless that is None."""
    goes_on = rest is not None

    @ti.real_func
    def run(spec: ti.template(), state: ti.template(), t: ti.i32):
        act(spec, state, t)
        if ti.static(goes_on):
            rest(spec, state, t)

    return run
