"""Why a run failed, and what to change: the step against the method's limit in any geometry."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from taichi_cloth.errors import InputError
from taichi_cloth.kernels import methods
from taichi_cloth.kernels.solvers.stages import ROUGH, may_be_rough
from taichi_cloth.limits.auto_step import (
    MOST,
    SubstepController,
    limit_below,
    substeps_needed,
)
from taichi_cloth.limits.bounds import Bounds, any_geometry, gershgorin, step_within
from taichi_cloth.limits.network import Network
from taichi_cloth.limits.precision import WATCHED
from taichi_cloth.scene.model import Scene, World
from taichi_cloth.scene.stencils import Stencils


def describe_fault(
    world: World, position: np.ndarray, velocity: np.ndarray, speed_limit: float
) -> str:
    """The fault of a particle that the watchdog stopped, position and velocity (dim,)."""
    if not (np.isfinite(position).all() and np.isfinite(velocity).all()):
        return "has a position or velocity that is not a finite number"
    speed = float(np.linalg.norm(velocity))
    if speed > speed_limit:
        return f"runs away at speed {speed:.3g} (limit {speed_limit:.3g})"
    if speed > WATCHED**0.5:
        return f"has speed {speed:.3g}, and only speeds up to {WATCHED**0.5:.2g} are watched"
    if np.abs(position).sum() > WATCHED:
        return f"is {np.abs(position).max():.3g} away, and only {WATCHED:.2g} is watched"
    beyond = {wall: _beyond(world, wall, position) for wall in world.walls}
    if beyond and max(beyond.values()) > 0:
        wall = max(beyond, key=lambda name: beyond[name])
        how_far = f"ended {beyond[wall]:.3g} beyond the wall '{wall}'"
        return f"{how_far}: it crossed more than the world in a step"
    return "crossed more than the world in a step, past a wall of it"


def _beyond(world: World, wall: str, position: np.ndarray) -> float:
    """The distance of a position (dim,) beyond a wall; negative: short of it."""
    axis, side = world.side(wall)
    bound = world.high[axis] if side > 0 else world.low[axis]
    return float(side * (position[axis] - bound))


def likely_cause(
    start: Scene,
    network: Network,
    method: str,
    dt: float,
    substeps: int,
    precision: str,
    speed_limit: float,
    tolerance: float = 0.0,
) -> tuple[str, str]:
    """Likely cause and remedy of a failure.

    start: the scene that the run began with. network: the last good state.
    method: name of the method.
    dt, substeps: time of a frame, and the steps it was cut into.
    precision: the type of numbers, such as "float32".
    speed_limit: the speed at which a particle is lost.
    tolerance: of methods that solve their steps to one.
    """
    speed = np.linalg.norm(network.velocity, axis=1)
    if len(speed) and not speed.max() <= min(speed_limit, WATCHED**0.5):
        return (
            f"particle {speed.argmax()} has a speed of {speed.max():.3g} before any step",
            "use a lower speed, or a shorter --dt",
        )
    if found := _too_long_from_the_start(start, method, dt, substeps):
        return found
    module, h = methods.load(method), dt / substeps
    bounds = gershgorin(network)
    limit = step_within(module, bounds)
    if limit == 0 and math.isfinite(bounds.omega2):
        which = "undamped springs"
        if bounds.damping > 0:
            which = "springs that dashpots damp along their axis alone"
        return f"{method} is unstable on {which} at every dt", "use --method symplectic_euler"
    if not math.isfinite(bounds.omega2) or 0 < limit * MOST < dt:
        held = precision if not math.isfinite(bounds.omega2) else f"frames of {dt:.3g}"
        return f"springs too stiff for {held}", "use softer springs or --method xpbd"
    if h > limit > 0:  # by Gershgorin; look closer
        bounds = any_geometry(network)
        limit = step_within(module, bounds)
    if not h > limit:
        if tolerance > ROUGH and may_be_rough(module):
            why = f"a tolerance of {tolerance:g}, which leaves steps half solved"
            return why, f"use --tolerance {ROUGH:g}"
        return "forces or starting speeds too large for the step", "use more --substeps"
    return _too_long(network, bounds, method, h, limit, substeps_needed(dt, limit))


def _too_long_from_the_start(
    start: Scene, method: str, dt: float, substeps: int
) -> tuple[str, str] | None:
    """Cause and remedy where steps were too long before anything moved; None: they were not.

    It is that which there is to mend: what flies apart when a run fails asks for far shorter ones.
    """
    module, began = methods.load(method), Network.from_scene(start)
    limit = limit_below(dt / substeps, module, began)
    if limit is None or not limit.dt > 0:
        return None
    try:
        needed = SubstepController(method, module, dt).choose(began)
    except InputError:  # more than there may be, or none in every geometry
        return None
    return _too_long(began, any_geometry(began), method, dt / substeps, limit.dt, needed)


def _too_long(
    network: Network,
    bounds: Bounds,
    method: str,
    h: float,
    limit: float,
    substeps: int,
) -> tuple[str, str]:
    """Cause and remedy where a step `h` is above `limit`; `substeps` would do."""
    needed = f"use --substeps {substeps}"
    _, drag_of = network.on_particles
    drag = float((drag_of / network.particles.mass)[bounds.damped]) * (1 + 1e-6)
    whole = gershgorin(network)
    calm = replace(network, triangles=network.triangles[:0], shares=network.shares[:0])
    calm_bounds = gershgorin(calm)  # without the air
    # What the step has too much of: the springs' part in it, and that of damping.
    stiff, viscid = h * h * bounds.omega2, 2.0 * h * bounds.damping
    without, all_of = calm_bounds.omega2, whole.omega2
    if viscid > stiff:
        without, all_of = calm_bounds.damping, whole.damping
    if without < all_of / 2:
        return (
            f"a step of {h:.3g} is too long for the air at the triangles around particle "
            f"{bounds.damped}",
            f"{needed} or a smaller --dt",
        )
    if bounds.damping > drag and viscid > 0.1 * stiff:
        return (
            f"a step of {h:.3g} is too long for the springs' dashpots at particle {bounds.damped}",
            f"{needed}, a smaller --dt, or less damping",
        )
    if viscid > stiff:
        return (
            f"a step of {h:.3g} is above {limit:.3g}, the stable limit of the drag on particle "
            f"{bounds.damped}",
            f"{needed} or a smaller --dt",
        )
    unbent = gershgorin(replace(calm, stencils=Stencils.none())).omega2
    what = "springs" if unbent > calm_bounds.omega2 / 2 else "bending"
    return (
        f"a step of {h:.3g} is above {limit:.3g}, the stable limit of {method} "
        f"(set by the {what} at particle {bounds.particle})",
        f"{needed}, a smaller --dt, or softer springs",
    )
