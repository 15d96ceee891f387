"""The scene's time on the device: what moves by itself, or blows, is a function of it.

It is counted from the host's clock by the number of steps since that last changed, so that replays,
finer steps and runs that go on from a saved state see the same time. It is in f64 also where the
state is not (but on Metal, which has none): in f32, after a thousand seconds, time would go on by
jerks, and with it what depends on it.
"""

import taichi as ti

from taichi_cloth.kernels.forces import load

NUMBERS = ("first_time", "first_time_low", "dt_low")  # state.<name>, of a state that is timed
COUNTS = ("first_step",)


def timed(spec):
    """True if anything that a specialization has asks for the time."""
    return spec.moving or any(load(name).timed for name in spec.terms)


def may_be_cut(state):
    """True if the method keeps count of parts into which it cuts a step (`newton_cg.py`)."""
    return hasattr(state, "halvings")


def split(value, real):
    """A number as the device holds it, and what that leaves over, for `NUMBERS`: (high, low)."""
    high = float(real(value))
    return high, value - high


@ti.func
def time_at_start(state: ti.template()):
    """The scene's time at the start of the present step, in f64 where the device has it."""
    return _time_after(state, state.step[None] - 1)


@ti.func
def time_at_end(state: ti.template()):
    """The scene's time at the end of the present step, in f64 where the device has it."""
    return _time_after(state, state.step[None])


@ti.func
def time_of_forces(state: ti.template()):
    """The scene's time at which the method takes its forces in the present stage of its step."""
    part = ti.cast(ti.static(state.force_times[0][1]), state.wide)
    for stage, other in ti.static(state.force_times[1:]):
        if state.stage[None] == stage:
            part = ti.cast(other, state.wide)
    if ti.static(may_be_cut(state)):
        part = (wide(state, state.parts_done[None]) + part) / wide(state, 1 << state.halvings[None])
    dt = wide(state, state.dt[None]) + wide(state, state.dt_low[None])
    return time_at_start(state) + part * dt


@ti.func
def _time_after(state: ti.template(), steps):
    """The time after so many steps since the start of the run."""
    first = wide(state, state.first_time[None]) + wide(state, state.first_time_low[None])
    dt = wide(state, state.dt[None]) + wide(state, state.dt_low[None])
    return first + ti.cast(steps - state.first_step[None], state.wide) * dt


@ti.func
def wide(state: ti.template(), number):
    """A number in f64, or in f32 where the device has nothing wider."""
    return ti.cast(number, state.wide)
