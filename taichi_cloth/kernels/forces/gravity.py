"""Gravity, which gives every free particle the acceleration g, whatever its mass."""

import numpy as np
import taichi as ti

from taichi_cloth.kernels.forces.contract import (
    ACCELERATION,
    VECTOR,
    Absent,
    DeviceField,
    Term,
)
from taichi_cloth.kernels.packs import everywhere, with_component, zeros


@ti.func
def law(spec: ti.template(), state: ti.template(), i):
    """The acceleration g, for each lane of a pack."""
    a = zeros(spec, state)
    for axis in ti.static(range(spec.dim)):
        a = with_component(a, axis, everywhere(spec, state.gravity[axis]))
    return a


def energy(x, v, world, particles, springs):
    """The potential energy -m g.x of all free particles."""
    mass = np.where(particles.fixed, 0.0, particles.mass)
    return float(-(mass * (x @ np.asarray(world.gravity))).sum())


def twin(x, v, world, particles):
    """The law in NumPy."""
    return np.broadcast_to(np.asarray(world.gravity, np.float64), x.shape)


TERM = Term(
    adds=ACCELERATION,
    keys=Absent("[world] gravity is a key that every scene has"),
    present=lambda scene: True,
    fields=(DeviceField("gravity", VECTOR, lambda world, particles: world.gravity),),
    law=law,
    acts=Absent("it always acts"),
    after_step=Absent("it changes nothing"),
    stiffness=Absent("it is the same everywhere"),
    damping=Absent("it is the same at every velocity"),
    across=Absent("it does not act along springs"),
    energy=energy,
    twin=twin,
    bound=Absent("a constant force makes no step unstable"),
    variant=Absent("every scene has it, be it zero: it is one addition"),
)
