"""The physical laws, each written once, as functions on values: those of one particle or of a pack.

Letters are those of the field's papers: x position, v velocity, k stiffness, c damping,
w inverse mass (0 = fixed), e restitution, n unit normal. Vectors are (dim,) or, for a pack, those
of `vectors.py`; numbers are one, or (lanes,). Units are the scene's own.
"""

import taichi as ti

from taichi_cloth.kernels.packs import dot

# Inverse mass of a fixed particle in a collision. Exactly zero would do as well, but the reference
# trajectories were computed with this mass, and collisions amplify the difference of 1e-8 past
# their tolerance. It is zero to what is as heavy as it: where the inverse mass is HEAVY or less.
FIXED_INVERSE_MASS = 1e-9
HEAVY = 1e-6


def branches_at_roots():
    """True if a square root has a branch, over which compilers move no load: in f32 on CUDA, where
    `root` can do without, as `fast_math` allows (not as exact for the smallest numbers).
    """
    return ti.cfg.arch == ti.cuda and ti.cfg.default_fp == ti.f32 and ti.cfg.fast_math


@ti.func
def root(a):
    """The square root of a number that is not negative.

    Where several springs of a particle are computed, all that they need is read at once so, and not
    for each one after the root of the one before. A step of Newton's, which CUDA's root takes, too,
    makes of its approximation the same number.
    """
    if ti.static(not branches_at_roots()):
        return ti.sqrt(a)
    else:
        inverse = ti.rsqrt(a)
        near = a * inverse
        return ti.select(a > 0.0, near + 0.5 * inverse * (a - near * near), 0.0)


@ti.func
def length(d):
    """The length of the vectors d."""
    return root(dot(d, d))


@ti.func
def unit(d, length):
    """The directions of the vectors d, at length 1; zero where d is zero and has no direction.

    length: that of d.
    """
    return ti.select(length > 0.0, 1.0 / length, 0.0 * length) * d


@ti.func
def spring_tension(length, k, rest):
    """The force with which a spring pulls its ends together: Hooke's law, k*(length - rest).

    length, rest: of the spring as it is and at rest [length]; k: stiffness [force / length].
    Hooke, De Potentia Restitutiva, 1678.
    """
    return k * (length - rest)


@ti.func
def stiffness_axis(along, k, across):
    """The vector a of which a spring's stiffness matrix is across*I + a a^T.

    The matrix has the stiffness k along the unit vectors `along` and the stiffness `across`, which
    is not more, in every direction at right angles to them.
    """
    return ti.sqrt(ti.max(k - across, 0.0)) * along


@ti.func
def stiffness_product(d, axis, across):
    """The product of a spring's stiffness matrix with the vectors d; axis: `stiffness_axis`."""
    return across * d + dot(axis, d) * axis


@ti.func
def spring_stiffness_across(length, k, rest, least):
    """The spring's stiffness across its axis, k*(1 - rest/length), at least `least` times k.

    It is negative where the spring is compressed. This stiffness and k, the one along the axis, are
    the eigenvalues of the spring's stiffness matrix. With `least` = 0 none is negative, and the
    matrix is the nearest such one (Choi, Ko, "Stable but responsive cloth", 2002). Where both ends
    coincide, and there is no axis, it is k in every direction.
    """
    return k * ti.max(1.0 - rest * ti.select(length > 0.0, 1.0 / length, 0.0 * length), least)


@ti.func
def dashpot_tension(dv, along, c):
    """The force with which a dashpot pulls a spring's ends together: c times the lengthening rate.

    dv: velocity of the other end relative to this one; along: unit vector from this end to the
    other; c: damping [force / velocity].
    """
    return c * dot(dv, along)


@ti.func
def drag_force(v, viscous):
    """The viscous drag on particles, -viscous*v (Stokes, 1851); viscous: [force / velocity]."""
    return -1.0 * viscous * v


@ti.func
def drag_factor(w, viscous, dt):
    """The part that is left of a change of velocity in a step of dt under drag at the new velocity.

    It is 1 / (1 + dt*w*viscous), what backward Euler gives for drag alone.
    """
    return 1.0 / (1.0 + dt * w * viscous)


@ti.func
def blow_force(distance, displacement, reach, strength):
    """One component of the moving pointer's force on particles `distance` away from it.

    It falls linearly to zero at `reach` and points along the pointer's displacement.
    displacement: that component of it [length]; strength: [force / length^2].
    """
    return strength * ti.max(reach - distance, 0.0) * displacement


@ti.func
def wall_bounce(gap, vn, e):
    """The change of the velocity along a wall's outward normal; zero where the wall is not hit.

    It is Newton's law of restitution: a particle that is past the wall and still moves outward
    leaves with e times its speed.
    gap: how far the particle's surface is short of the wall (negative: past it) [length];
    vn: velocity along the outward normal; e: restitution, 0 to 1.
    """
    return ti.select(ti.min(-1.0 * gap, vn) > 0.0, (-1.0 - e) * vn, 0.0 * vn)


@ti.func
def friction(slide, lost, mu):
    """The part of a velocity along a surface that friction takes, and whether it is all of it.

    It is Coulomb's law in a step (Coulomb, Theorie des machines simples, 1785): at most mu times
    what the normal velocity has lost, at most to rest.
    slide: velocity (dim,) relative to the surface, along it; lost: change of the normal velocity by
    the contact, not negative; mu: coefficient.
    """
    speed, most = length(slide), mu * lost
    stops = most >= speed
    part = 1.0 + 0.0 * speed
    if not stops:
        part = most / speed
    return (-1.0 * part) * slide, stops


@ti.func
def pair_bounce(d, v1, v2, w1, w2, reach, e):
    """The velocity change of particle 1 in a collision with particle 2; zero if there is none.

    It is Newton's law of restitution (Newton, Principia, 1687, scholium to the laws of motion) with
    the momentum of both conserved. They collide if they touch and do not move apart; coincident
    centres have no normal, so nothing happens.
    d: vector from 1 to 2; v1, v2, w1, w2: their velocities and inverse masses; reach: sum of their
    radii; e: restitution of the pair.
    """
    distance2 = d.dot(d)
    change = 0.0 * d
    if distance2 <= reach * reach and distance2 > 0.0 and w1 > 0.0:
        n = d / ti.sqrt(distance2)
        closing = (v1 - v2).dot(n)
        other = ti.select((w2 == 0.0) & (w1 > HEAVY), FIXED_INVERSE_MASS, w2)
        impulse = ti.select(closing >= 0.0, -(1.0 + e) * closing * (w1 / (w1 + other)), 0.0)
        change = impulse * n
    return change
