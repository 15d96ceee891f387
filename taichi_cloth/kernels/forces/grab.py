"""The mouse's hold: particles are pulled to a place that moves, f = -k (x - target) - c v.

Each has a spring and a dashpot of its own (`scene.holding.Hold`), so what is let go keeps its
velocity. The field of each particle's stiffness is 0 but for those few that are held, and nothing
is read of it while nothing is.
"""

import numpy as np
import taichi as ti

from taichi_cloth.front_end.mending import kernel
from taichi_cloth.kernels.forces.contract import (
    COUNT,
    FORCE,
    PARTICLE_NUMBER,
    PARTICLE_VECTOR,
    VECTOR,
    Absent,
    DeviceField,
    Term,
)
from taichi_cloth.kernels.packs import (
    component,
    read,
    set_slot_number,
    set_slot_value,
    with_component,
)


@ti.func
def law(spec: ti.template(), state: ti.template(), i):
    """The pull on pack i; its particles that are not held have neither stiffness nor damping."""
    away = read(spec, state.x, i) - read(spec, state.grab_offset, i)
    for axis in ti.static(range(spec.dim)):
        away = with_component(away, axis, component(away, axis) - state.grab_place[axis])
    pull = -1.0 * read(spec, state.grab_k, i) * away
    return pull - read(spec, state.grab_c, i) * read(spec, state.v, i)


@ti.func
def acts(state: ti.template()):
    return state.grabbing[None] == 1


@ti.func
def stiffness(spec: ti.template(), state: ti.template(), number: ti.template(), i):
    """The derivative -df/dx at i, a number for each particle [force / length]."""
    return number(spec, state.grab_k, i)


@ti.func
def damping(spec: ti.template(), state: ti.template(), number: ti.template(), i):
    """The derivative -df/dv at i, a number for each particle [force / velocity]."""
    return number(spec, state.grab_c, i)


@kernel
def hold(
    spec: ti.template(),
    state: ti.template(),
    particles: ti.types.ndarray(),
    rows: ti.types.ndarray(),
    count: ti.i32,
    grabbing: ti.i32,
):
    """Hold some particles, or with zeros let them go.

    particles: (count,) or longer, their numbers; rows: (count, dim + 3) or longer: offsets from the
    pointer, stiffness, damping and inverse mass. grabbing: whether any particle is held then.
    """
    state.grabbing[None] = grabbing
    for m in range(count):
        slot = state.slot[particles[m]]
        offset = ti.Vector.zero(state.real, ti.static(spec.dim))
        for axis in ti.static(range(spec.dim)):
            offset[axis] = rows[m, axis]
        set_slot_value(spec, state.grab_offset, slot, offset)
        set_slot_number(spec, state.grab_k, slot, rows[m, spec.dim])
        set_slot_number(spec, state.grab_c, slot, rows[m, spec.dim + 1])
        set_slot_number(spec, state.w, slot, rows[m, spec.dim + 2])


@kernel
def move_hold(spec: ti.template(), state: ti.template(), place: ti.types.ndarray()):
    """Take what is held to another place (dim,)."""
    for axis in range(spec.dim):
        state.grab_place[axis] = place[axis]


def column(name):
    """The loader of a field from a number, or vector, of each particle that is held."""

    def value(world, particles):
        count = len(particles)
        if world.held is None:
            return np.zeros((count, world.dim) if name == "offset" else count)
        return world.held.among(count, name)

    return value


def energy_of(held, x, fixed):
    """The potential energy k (x - target)^2 / 2 of what a `Hold` holds that is not fixed."""
    away = x[held.particles] - held.targets
    free = ~fixed[held.particles]
    return float(0.5 * (held.stiffness * (away**2).sum(axis=1))[free].sum())


def energy(x, v, world, particles, springs):
    """The potential energy of what is held."""
    return 0.0 if world.held is None else energy_of(world.held, x, particles.fixed)


def twin(x, v, world, particles):
    """The law in NumPy."""
    force, held = np.zeros_like(x), world.held
    if held is not None:
        mine = held.particles
        force[mine] = -held.stiffness[:, None] * (x[mine] - held.targets)
        force[mine] -= held.damping[:, None] * v[mine]
    return force


def bound(world, particles, springs):
    """Its share of the stability limit: that of those particles which are held."""
    count = len(particles)
    if world.held is None:
        return np.zeros(count), np.zeros(count)
    return tuple(world.held.among(count, name) for name in ("stiffness", "damping"))


TERM = Term(
    adds=FORCE,
    keys=Absent("a run in a window has it, whatever its scene"),
    present=lambda scene: scene.world.tools,
    fields=(
        DeviceField("grab_offset", PARTICLE_VECTOR, column("offset")),
        DeviceField("grab_k", PARTICLE_NUMBER, column("stiffness")),
        DeviceField("grab_c", PARTICLE_NUMBER, column("damping")),
        DeviceField(
            "grab_place",
            VECTOR,
            lambda world, particles: world.held.place if world.held else np.zeros(world.dim),
        ),
        DeviceField("grabbing", COUNT, lambda world, particles: int(world.held is not None)),
    ),
    law=law,
    acts=acts,
    after_step=Absent("it changes nothing"),
    stiffness=stiffness,
    damping=damping,
    across=Absent("it does not act along springs"),
    energy=energy,
    twin=twin,
    bound=bound,
    variant=Absent("windows have it, not scenes"),
)
