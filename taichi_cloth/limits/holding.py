"""The strength with which the mouse holds a particle, and the mass that keeps the step stable."""

from __future__ import annotations

import math

import numpy as np

from taichi_cloth.kernels.methods.contract import Method
from taichi_cloth.limits.bounds import Bounds, gershgorin, grows_within
from taichi_cloth.limits.network import Network

# Without springs a particle comes to the pointer within some frames: omega times a frame.
EAGER = 0.5


def strength(network: Network, frame: float, particles: np.ndarray) -> tuple[np.ndarray, ...]:
    """Stiffness and damping with which particles (m,) are held, (m,) each.

    What is held hangs from the pointer as it hangs from its neighbours: by a spring like the
    stiffest of its own, which lifts whatever that carries. One that is stiffer pulls the particle
    out of its cloth where the pointer is quick. A body without springs follows within some
    frames. It is damped critically for its own mass. frame: time of a frame.
    """
    mass, springs = network.particles.mass[particles], network.springs
    stiffest = np.zeros(len(network.position))
    np.maximum.at(stiffest, springs.between.ravel(), np.repeat(springs.stiffness, 2))
    free = mass * (EAGER / frame) ** 2
    stiffness = np.where(stiffest[particles] > 0, stiffest[particles], free)
    return stiffness, 2.0 * np.sqrt(stiffness * mass)


def added_mass(
    method: Method,
    network: Network,
    step: float,
    particles: np.ndarray,
    stiffness: np.ndarray,
    damping: np.ndarray,
) -> np.ndarray:
    """The mass that held particles (m,) must gain for the step to stay stable, (m,).

    Scenes may be run at the very limit of their step, as the original cloth is; whatever is added
    to their stiffness K or damping C then crosses it. A mass does not: a step h of limit s (2 for
    symplectic Euler) is stable where (h/s)^2 K + (h/s) C <= M, so a hold of k and c which weighs
    (h/s)^2 k + (h/s) c more leaves what there was. Steps that have room for both, and implicit
    methods, need none; nor do finer steps, in which it goes to 0.
    """
    limit = method.claims.stability_limit
    mass = network.particles.mass[particles]
    bounds = gershgorin(network)
    held = Bounds(
        bounds.omega2 + float((stiffness / mass).max()),
        -1,
        bounds.damping + float((damping / mass).max()),
        -1,
        bounds.least_damping,
    )
    if math.isinf(limit) or not grows_within(method, held, step):
        return np.zeros(len(particles))
    share = step / (limit or 2.0)  # explicit Euler has no limit to keep
    added: np.ndarray = share**2 * stiffness + share * damping
    return added
