"""Implicit (backward) Euler: v += dt*a(x, v) and x += dt*v, with the new x and v on both sides.

Hairer, Wanner, Solving Ordinary Differential Equations II, IV.3; Baraff, Witkin, "Large steps in
cloth simulation", 1998, but solved until it has converged (`solvers/newton_cg.py`). First order,
stable at every dt; it damps an oscillation by 1/sqrt(1 + (dt*omega)^2) a step, which is its error.
"""

import math

import taichi as ti

from taichi_cloth.kernels.methods.contract import Claims, Method, backward_euler
from taichi_cloth.kernels.packs import read
from taichi_cloth.kernels.solvers import newton_cg, stages


@ti.func
def move(spec: ti.template(), state: ti.template(), i):
    """Take pack i to the end of the step, whose velocities the one stage has found."""
    new_v = stages.new_velocity(spec, state, i, read(spec, state.gain, i))
    dt = stages.time_of_part(state)
    stages.arrive(spec, state, i, dt * new_v, new_v)


METHOD = Method(
    claims=Claims(
        order=1,
        symplectic=False,
        implicit=True,
        stability_limit=math.inf,
        forces=0,
        settings=("tolerance",),
        choose=(
            "Stiff scenes at the frame's step that are to come to rest: it damps what is too fast, "
            "and slow motion with it."
        ),
    ),
    position_weight=1.0,
    force_times=((0, 1.0),),
    phases=newton_cg.phases(1.0, stages.start, move),
    stability_function=backward_euler,
    **newton_cg.keeps(),
)
