"""Laws of two particles that rest on each other, and of obstacles.

Positions of two that overlap go apart in proportion to inverse masses, and velocities of two that
touch lose what closes them in, with friction (Coulomb, 1785), and with restitution in the first
iteration (Newton, 1687), for pairs that meet faster than gravity lets them in some steps. That
keeps their momentum and never adds to their kinetic energy. `resting_pairs.py` has all pairs act
at once, `swept_pairs.py` one after the other.

at, other: places in the order by cells, or with a thickness in `state.in_patches`.
"""

import taichi as ti

from taichi_cloth.kernels import laws
from taichi_cloth.kernels.collision_grid import slot_of, sorted_radius
from taichi_cloth.kernels.kept_pairs import before_of
from taichi_cloth.kernels.obstacles.contract import FRICTION
from taichi_cloth.kernels.packs import epsilon, slot_number
from taichi_cloth.kernels.poses import (
    END,
    centre_of,
    signed_distance,
    to_local,
    to_world,
    velocity_at,
)

SLACK = 1e-4  # of a pair's reach, within which they touch
MEETS = 4.0  # gravity times dt: a pair that closes in faster bounces
ROUNDINGS = 4.0  # of the coordinates, that an overlap may have
OVERLAP, APPROACH = range(2)  # columns of state.touching and state.pair_residual


@ti.func
def clear_residual(spec: ti.template(), state: ti.template(), i):
    """Begin to find what an iteration leaves of overlaps and approaches: run once."""
    for kind in ti.static((OVERLAP, APPROACH)):
        state.pair_residual[state.pair_iteration[None] & 1, kind] = 0.0


@ti.func
def may_touch(spec: ti.template(), state: ti.template(), x, d, reach):
    """True if two particles of cloth, apart by d, are near enough to be asked whether they touch;
    x: of one of them."""
    far = ti.static(1.0 + 2.0 * SLACK) * reach
    for axis in ti.static(range(spec.dim)):  # `abs` of vectors crashes in lanes
        far += ti.static(2.0 * ROUNDINGS * epsilon(state)) * ti.abs(x[axis])
    return d.dot(d) <= far * far


@ti.func
def meeting(spec: ti.template(), state: ti.template(), at, other, x, d, relative, reach, passed):
    """The meeting of two particles: normal towards the other, gap, normal part of their relative
    velocity, whether they overlap and whether they approach, as 1 or 0.

    x: of the particle; d, relative: from it to the other one, and that one's velocity less its own;
    reach: how near they may come; passed: whether they passed through each other in this step.
    """
    distance = laws.length(d)
    n = laws.unit(d, distance)
    if ti.static(spec.thick):
        if passed:
            before = before_of(spec, state, at, other)
            n = laws.unit(before, laws.length(before))
            distance = d.dot(n)
    if distance == 0.0:  # they have no normal: any will do, the other way for the other one
        n[0] = ti.select(state.sorted_index[at] < state.sorted_index[other], 1.0, -1.0)
    gap = distance - reach
    size = ti.abs(x[0])
    for axis in ti.static(range(1, spec.dim)):
        size = ti.max(size, ti.abs(x[axis]))
    u = relative.dot(n)
    rounding = ti.static(ROUNDINGS * epsilon(state)) * size
    overlaps = ti.select(gap < -1.0 * rounding, 1, 0)
    approaches = ti.select((gap <= SLACK * reach + rounding) & (u < 0.0), 1, 0)
    return n, gap, u, overlaps, approaches


@ti.func
def impulse(spec: ti.template(), state: ti.template(), at, other, n, relative, u):
    """The change by a pair that approaches of the velocity of the particle at `at`, and the part of
    that which is friction: both times minus the sum of their inverse masses, over its own.

    n, relative, u: as `meeting` has them.
    """
    e = 0.0 * u
    if state.pair_iteration[None] == 0 and -1.0 * u > (
        MEETS * state.least_scale[None] * state.dt[None]
    ):
        a = slot_of(spec, state, state.sorted_index[at])
        b = slot_of(spec, state, state.sorted_index[other])
        e = _restitution(spec, state, a) * _restitution(spec, state, b)
    lost = -(1.0 + e) * u
    taken, _ = laws.friction(relative - u * n, lost, state.pair_friction[None])
    return lost * n + taken, taken


@ti.func
def _restitution(spec: ti.template(), state: ti.template(), slot):
    """The restitution of a particle against others: a cloth has none."""
    if ti.static(spec.thick):
        return slot_number(spec, state.pair_restitution, slot)
    else:
        return slot_number(spec, state.restitution, slot)


@ti.func
def out_of_obstacles(spec: ti.template(), state: ti.template(), at, x, v):
    """Position and velocity of a particle, put onto the obstacles that it was pushed into."""
    radius = sorted_radius(spec, state, at)
    if ti.static(spec.thick):
        radius = slot_number(spec, state.radius, slot_of(spec, state, state.sorted_index[at]))
    for o in range(state.n_obstacles[None]):
        d = x - centre_of(spec, state, o, END)
        distance, local_n = signed_distance(spec, state, o, to_local(spec, state, o, END, d))
        gap = distance - radius
        if gap <= SLACK * radius:
            n = to_world(spec, state, o, END, local_n)
            surface_v = velocity_at(spec, state, o, d - gap * n)
            relative = v - surface_v
            u = relative.dot(n)
            x += (-1.0 * ti.min(gap, 0.0)) * n  # `-=` of vectors crashes in lanes
            if u < 0.0:
                taken, _ = laws.friction(
                    relative - u * n, -1.0 * u, state.obstacle_numbers[o, FRICTION]
                )
                v += taken - u * n
                x += (ti.static(state.position_weight) * state.dt[None]) * taken
    return x, v
