"""The pointer's force: as the pointer moves, it blows along what is near it, for the next frame.

A particle at distance r from the pointer, which moved by d, gets f = STRENGTH max(REACH - r, 0) d,
the law of the original program. In 3-D the pointer is a line, the ray of sight. A program may put a
force for each particle in the pointer's place (`hold_push`).

In the original's units (a mass of 1, a frame that takes 1) this says that what is under the pointer
gains GAIN of its velocity in a frame. In other units that is what makes the strength, see
`strength_of`.
"""

import taichi as ti

from taichi_cloth.front_end.mending import kernel
from taichi_cloth.kernels import laws
from taichi_cloth.kernels.forces.contract import (
    COUNT,
    FORCE,
    NUMBER,
    PARTICLE_VECTOR,
    VECTOR,
    Absent,
    DeviceField,
    Term,
    Variant,
)
from taichi_cloth.kernels.loops import each_pack
from taichi_cloth.kernels.packs import (
    component,
    dot,
    read,
    set_slot_value,
    with_component,
    write,
)

REACH = 50.0  # world units from the pointer at which its force ends
STRENGTH = 0.002  # force per unit of displacement and of distance short of the reach
GAIN = REACH * STRENGTH  # part of the pointer's velocity that is gained in a frame right under it


def strength_of(reach, mass, frame):
    """The strength [force / length^2] with which particles of this mass gain GAIN.

    reach [length]; mass [mass]; frame: what one takes [time].
    """
    return GAIN * mass / (reach * frame**2)


@ti.func
def law(spec: ti.template(), state: ti.template(), i):
    """The forces on pack i that are held for this frame, or zero."""
    return read(spec, state.push, i)


@ti.func
def acts(state: ti.template()):
    return state.pushing[None] == 1


@kernel
def compute_push(spec: ti.template(), state: ti.template(), numbers: ti.types.ndarray()):
    """Compute state.push, the pointer's force on each particle, from where the particles are now.

    numbers: (3 dim + 2,): a point of the pointer's line, the line's unit direction (zero: the line
    is only that point, as in 2-D), the pointer's displacement, all in world units; then reach
    [length] and strength [force / length^2].
    """
    state.pushing[None] = 1
    for axis in ti.static(range(spec.dim)):
        state.pointer[axis] = numbers[axis]
        state.pointer_ray[axis] = numbers[spec.dim + axis]
        state.pointer_moved[axis] = numbers[2 * spec.dim + axis]
    state.pointer_reach[None] = numbers[3 * spec.dim]
    state.pointer_strength[None] = numbers[3 * spec.dim + 1]
    each_pack(spec, state, 0, _push_pack)


@ti.func
def _push_pack(spec: ti.template(), state: ti.template(), i):
    """Compute the pointer's force on pack i by the distance to the pointer's line."""
    x = read(spec, state.x, i)
    d, ray = 0.0 * x, 0.0 * x
    for axis in ti.static(range(spec.dim)):
        from_pointer = component(x, axis) - state.pointer[axis]
        d = with_component(d, axis, from_pointer)
        ray = with_component(ray, axis, 0.0 * from_pointer + state.pointer_ray[axis])
    d = d - dot(d, ray) * ray  # not -=, which whole vectors do not take
    reach, strength = state.pointer_reach[None], state.pointer_strength[None]
    distance, push = laws.length(d), 0.0 * x
    for axis in ti.static(range(spec.dim)):
        force = laws.blow_force(distance, state.pointer_moved[axis], reach, strength)
        push = with_component(push, axis, force)
    write(spec, state.push, i, push)


@kernel
def clear_push(state: ti.template()):
    """End the pointer's force."""
    state.pushing[None] = 0


@kernel
def hold_push(spec: ti.template(), state: ti.template(), forces: ti.types.ndarray()):
    """Store a force for each particle in state.push, in the place of the pointer's.

    forces: (n, dim), in the order of the particles.
    """
    state.pushing[None] = 1
    for i in range(forces.shape[0]):
        force = ti.Vector.zero(state.real, ti.static(spec.dim))
        for axis in ti.static(range(spec.dim)):
            force[axis] = forces[i, axis]
        set_slot_value(spec, state.push, state.slot[i], force)


def variant(scene):
    """The scene with the pointer's force switched over; None where clicks make particles."""
    used = scene.world.mouse == "blow"
    if scene.world.mouse == "spawn":
        return None
    changed = scene.with_world(mouse="none" if used else "blow")
    return Variant("mouse: blow", used, "not pushing", changed)


TERM = Term(
    adds=FORCE,
    keys=Absent('[world] mouse = "blow" is a key that every scene has'),
    present=lambda scene: scene.world.tools or scene.world.mouse == "blow",
    fields=(
        DeviceField("push", PARTICLE_VECTOR),
        DeviceField("pushing", COUNT),
        DeviceField("pointer", VECTOR),
        DeviceField("pointer_ray", VECTOR),
        DeviceField("pointer_moved", VECTOR),
        DeviceField("pointer_reach", NUMBER),
        DeviceField("pointer_strength", NUMBER),
    ),
    law=law,
    acts=acts,
    after_step=Absent("it changes nothing"),
    stiffness=Absent("it is held through a frame, wherever the particle goes"),
    damping=Absent("it does not depend on velocity"),
    across=Absent("it does not act along springs"),
    energy=Absent("it comes from outside: it has no potential"),
    twin=Absent("it is no part of a scene: references are computed without the pointer"),
    bound=Absent("a force that is held makes no step unstable"),
    variant=variant,
)
