"""TR-BDF2: the trapezoidal rule over a step's first part, then the formula BDF2 over all of it.

BDF2 is the backward differentiation formula of second order. Bank, Coughran, Fichtner, Grosse,
Rose, Smith, "Transient simulation of silicon devices and circuits", IEEE Trans. Computer-Aided
Design 4, 1985; Hosea, Shampine, "Analysis and implementation of TR-BDF2", Applied Numerical
Mathematics 20, 1996. Second order, stable at every dt. It damps what is too fast for dt, like
implicit Euler, and hardly damps what is slow enough. With a first part of (2 - sqrt 2) dt, both
stages are implicit Euler's equations over the same time (`solvers/newton_cg.py`).
"""

import math

import taichi as ti

from taichi_cloth.kernels.contact import velocity_jump
from taichi_cloth.kernels.methods.contract import Claims, Method
from taichi_cloth.kernels.packs import read, write
from taichi_cloth.kernels.solvers import newton_cg, stages

PART = 2.0 - math.sqrt(2.0)  # part of the step over which the trapezoidal rule goes
TAU = PART / 2.0  # time of each stage, as a part of the step
# The second stage starts this part of the first one's way from the step's start.
FROM_FIRST = 1.0 / (PART * (2.0 - PART))
TRAPEZOIDAL, BACKWARD = 0, 1  # stages


def stability_function(z):
    """The factor by which a step multiplies the y of y' = mu y, where z = dt mu."""
    first = (1 + TAU * z) / (1 - TAU * z)
    return (FROM_FIRST * first + 1 - FROM_FIRST) / (1 - TAU * z)


@ti.func
def stay(spec: ti.template(), state: ti.template(), i):
    """Start with pack i where it is: the trapezoidal rule needs the acceleration there."""
    stages.keep_start(spec, state, i)
    stages.begin_at(spec, state, i, read(spec, state.x, i))
    v = read(spec, state.v, i)
    write(spec, state.gain, i, 0.0 * v)  # so that the residual is the acceleration


@ti.func
def go_on(spec: ti.template(), state: ti.template(), i):
    """Take pack i from one stage to the next, and from the last one to the end of the step."""
    tau, stage = TAU * stages.time_of_part(state), state.stage[None]
    x, v = read(spec, state.old_x, i), read(spec, state.old_v, i)
    old_v, gain = v + velocity_jump(spec, state, i, x, v), read(spec, state.gain, i)
    if stage == stages.ONLY_EVALUATE:
        first = tau * read(spec, state.residual, i)
        write(spec, state.first, i, first)
        stages.start_from(spec, state, i, tau * old_v, old_v + first)
    elif stage == TRAPEZOIDAL:
        first = FROM_FIRST * (read(spec, state.first, i) + gain)
        write(spec, state.first, i, first)
        way = (FROM_FIRST * tau) * (old_v + read(spec, state.v, i))
        write(spec, state.way, i, way)
        stages.start_from(spec, state, i, way, old_v + first)
    else:
        new_v = stages.new_velocity(spec, state, i, read(spec, state.first, i) + gain)
        stages.arrive(spec, state, i, read(spec, state.way, i) + tau * new_v, new_v)


METHOD = Method(
    claims=Claims(
        order=2,
        symplectic=False,
        implicit=True,
        stability_limit=math.inf,
        forces=0,
        settings=("tolerance",),
        choose=(
            "Stiff scenes whose slow motion counts: that is hardly damped, and what is too fast is "
            "damped away."
        ),
    ),
    position_weight=0.5,
    force_times=((stages.ONLY_EVALUATE, 0.0), (TRAPEZOIDAL, PART), (BACKWARD, 1.0)),
    phases=newton_cg.phases(TAU, stay, go_on, first=stages.ONLY_EVALUATE, last=BACKWARD),
    stability_function=stability_function,
    # What velocities gain until a stage starts, and how far from the step's start the second does.
    **newton_cg.keeps("first", "way"),
)
