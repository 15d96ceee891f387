"""The physical laws, each written once, as functions on values: of one particle, or of a cell's.

Letters as in the field's papers: x position, v velocity, k stiffness, c damping,
w inverse mass (0 = fixed), e restitution, n unit normal.
"""

import taichi as ti

from taichi_cloth.kernels.packs import dot, scaled

# Inverse mass of a fixed particle in a collision: a mass that no free particle comes near. Exactly
# zero would do as well, but the reference trajectories were computed with this mass, and
# collisions amplify the difference of 1e-8 past their tolerance.
FIXED_INVERSE_MASS = 1e-9


@ti.func
def length(d):
    """Length of the vectors d."""
    return ti.sqrt(dot(d, d))


@ti.func
def unit(d, length):
    """The vectors d at length 1; zero where both ends coincide, where no direction exists."""
    return scaled(ti.select(length > 0.0, 1.0 / length, 0.0 * length), d)


@ti.func
def spring_tension(length, k, rest):
    """Hooke's law: the force with which a spring pulls its ends together."""
    return k * (length - rest)


@ti.func
def stiffness_product(d, along, k, across):
    """A stiffness k along the unit vectors `along`, and another one across them, times d."""
    return scaled(across, d) + scaled((k - across) * dot(along, d), along)


@ti.func
def spring_stiffness_across(length, k, rest, least):
    """The spring's stiffness across its axis, k*(1 - rest/length), at least `least` times k.

    It is negative where the spring is compressed. With k along the axis it makes the derivative of
    the spring's force, whose eigenvalues these are: with `least` = 0 that is the nearest matrix
    without negative ones (Choi, Ko, "Stable but responsive cloth", 2002). Where both ends coincide,
    and there is no axis, it is k in every direction.
    """
    return k * ti.max(1.0 - rest * ti.select(length > 0.0, 1.0 / length, 0.0 * length), least)


@ti.func
def dashpot_tension(dv, along, c):
    """Damping along a spring's axis: c times the rate at which it lengthens.

    dv: velocity of the far end relative to the near one; along: unit vector to the far end.
    """
    return c * dot(dv, along)


@ti.func
def drag_force(v, viscous):
    """Viscous (Stokes) drag on one particle."""
    return scaled(-1.0 * viscous, v)


@ti.func
def drag_factor(w, viscous, dt):
    """What is left of a change of velocity in a step of dt where drag acts on the new velocity."""
    return 1.0 / (1.0 + dt * w * viscous)


@ti.func
def blow_force(distance, displacement, reach, strength):
    """Force of the moving pointer, along an axis, on a particle `distance` away from it.

    It falls linearly to zero at `reach` and points along the pointer's displacement.
    """
    return strength * ti.max(reach - distance, 0.0) * displacement


@ti.func
def wall_bounce(gap, vn, e):
    """Change of the velocity along a wall's outward normal; zero when the wall is not hit.

    gap: how far the particle's surface is short of the wall (negative: past it);
    vn: velocity along the outward normal.
    """
    return ti.select(ti.min(-1.0 * gap, vn) > 0.0, (-1.0 - e) * vn, 0.0 * vn)


@ti.func
def pair_bounce(d, v1, v2, w1, w2, reach, e):
    """Velocity change of particle 1 in a collision with particle 2; zero when they do not collide.

    d: vector from 1 to 2; reach: sum of the radii. Newton's law of restitution: they collide when
    they touch and do not move apart; coincident centres have no normal, so nothing happens.
    """
    distance2 = d.dot(d)
    change = 0.0 * d
    if distance2 <= reach * reach and distance2 > 0.0 and w1 > 0.0:
        n = d / ti.sqrt(distance2)
        closing = (v1 - v2).dot(n)
        if closing >= 0.0:
            change = -(1.0 + e) * closing * w1 / (w1 + ti.max(w2, FIXED_INVERSE_MASS)) * n
    return change
