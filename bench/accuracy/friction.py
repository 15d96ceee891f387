"""The order that survives contact with friction: what lands on a slope, slides, and stays.

Bodies fall through air that resists, land on a slope one after the other, lose what points into it
and some of what points along it (Coulomb, 1785), slide on and come to rest or do not: a solution in
closed form. A cloth that lands on the same slope is held against a fine run.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bench.accuracy.experiments import ON_GRAPH, solved, trajectory
from taichi_cloth.kernels import methods
from taichi_cloth.scene.cloth import grid
from taichi_cloth.scene.model import ParticleDefaults, Particles, Scene, SpringDefaults, World
from taichi_cloth.scene.obstacles import Obstacle
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.trade.reference import fine_method

G, SLOPE, RADIUS = 9.81, np.radians(30.0), 0.05
DRAG = 1.0  # of a body, over its mass: so that no method is exact in the air
DT, FRAMES = 0.05, 30  # seconds of a frame
BEFORE = 5  # the last frame that ends before anything has landed
SUBSTEPS = (2, 4, 8, 16, 32)
BODIES = 24
SLIDES, STICKS = 0.2, 0.9  # coefficients of friction below and above the tangent of the slope
NORMAL = np.array([np.sin(SLOPE), np.cos(SLOPE)])
DOWN = np.array([np.cos(SLOPE), -np.sin(SLOPE)])
FOOT = np.array([20.0, 70.0])  # a point of the slope
CLOTH_SUBSTEPS, FINE = (32, 64, 128, 256, 512), 4096
CLOTH_BEFORE, CLOTH_LANDED = 5, 7  # of the cloth: likewise, and the first past its landing
AT_REST = 6  # frames at the end, in which nothing that sticks moves
LEAST = 1e-11  # what is smaller is rounding


def _world() -> dict[str, Any]:
    return {"size": (200.0, 100.0), "gravity": (0.0, -G), "dt": DT, "up": "y"}


def bodies(friction: float) -> Scene:
    """Bodies above a slope, at heights of which no two are in a ratio that steps could favour."""
    heights = 0.5 + 1.1 * np.sort(np.random.default_rng(1).uniform(size=BODIES))
    along = 0.5 * np.arange(BODIES)
    x = FOOT + np.outer(heights + RADIUS, NORMAL) + np.outer(along, DOWN)
    v = np.tile(1.5 * DOWN, (BODIES, 1))
    plane = Obstacle.build("plane", point=FOOT, normal=NORMAL, friction=friction)
    particles = Particles.build(x, v, radius=RADIUS, viscous=DRAG)
    return Scene("slope", World(**_world()), particles, obstacles=(plane,))


def exact(scene: Scene, friction: float, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places of a scene's bodies at `times`, (times, n, 2), and when each lands (n,)."""
    start = scene.particles.position - FOOT
    height, along = start @ NORMAL - RADIUS, start @ DOWN
    speed = scene.particles.velocity @ DOWN
    fall, slide = -G * np.cos(SLOPE) / DRAG, G * np.sin(SLOPE) / DRAG  # final velocities in the air
    landed = np.full(len(height), 0.5)
    for _ in range(60):  # Newton's method, on a function that is concave and falls
        rate = fall * (1 - np.exp(-DRAG * landed))
        left = height + fall * landed - fall * (1 - np.exp(-DRAG * landed)) / DRAG
        landed = landed - left / rate
    at = _went(speed, slide, landed)
    hit = -fall * (1 - np.exp(-DRAG * landed))
    fast = slide + (speed - slide) * np.exp(-DRAG * landed)
    left_over = np.maximum(fast - friction * hit, 0.0)
    final = slide + friction * fall  # of what slides; negative: it comes to rest
    stops = np.full(len(height), np.inf)
    if final < 0:
        stops = np.log1p(left_over / -final) / DRAG
    elif (left_over == 0).any():
        raise ValueError("a body that slides must not be stopped as it lands")
    found = []
    for t in times:
        air, ground = np.minimum(t, landed), np.clip(t - landed, 0.0, stops)
        h = np.where(t < landed, height + fall * air - fall * (1 - np.exp(-DRAG * air)) / DRAG, 0.0)
        s = along + np.where(
            t < landed, _went(speed, slide, air), at + _went(left_over, final, ground)
        )
        found.append(FOOT + np.outer(h + RADIUS, NORMAL) + np.outer(s, DOWN))
    return np.array(found), landed


def _went(speed: np.ndarray, final: float, t: np.ndarray) -> np.ndarray:
    """The way of something whose speed tends to `final` as drag has it."""
    way: np.ndarray = final * t + (speed - final) * (1 - np.exp(-DRAG * t)) / DRAG
    return way


def cloth() -> Scene:
    """A small soft cloth that lands on a slope with one side first, and slides."""
    spring = SpringDefaults(stiffness=60.0, damping=0.05)
    normal, down = np.array([*NORMAL, 0.0]), np.array([*DOWN, 0.0])
    foot = np.array([*FOOT, 0.0])
    particles, springs = grid(
        (foot + (0.3 + RADIUS) * normal).tolist(), 4, 4, 0.25, spring_defaults=spring,
        particle_defaults=ParticleDefaults(mass=0.05, radius=RADIUS, viscous=0.02),
        across=(0.95 * down + 0.3 * normal).tolist(), down=[0.1, 0.0, 1.0],
        links=("structural", "shear"),
    )  # fmt: skip
    world = World(size=(200.0, 100.0, 50.0), gravity=(0.0, -G, 0.0), dt=DT, up="y")
    plane = Obstacle.build("plane", point=foot, normal=normal, friction=SLIDES)
    return Scene("cloth", world, particles, springs, obstacles=(plane,))


def orders_with_friction(
    names: Sequence[str] = methods.METHODS,
) -> dict[str, dict[str, float | None]]:
    """The order of each method before a contact with friction, at it and past it.

    before, at, past: of bodies that slide, before the first one lands, at the end of the frame in
    which each has landed, and at the end of the run; stuck: of bodies that come to rest, at the
    end; creep: how far these went in the last frames; cloth_before, cloth: of a cloth, before it
    lands and over all frames past that. None where the errors are rounding.
    """
    times = DT * np.arange(1, FRAMES + 1)
    found: dict[str, dict[str, float | None]] = {name: {} for name in names}
    sliding, sticking, sheet = bodies(SLIDES), bodies(STICKS), cloth()
    ways, landed = exact(sliding, SLIDES, times)
    ends, _ = exact(sticking, STICKS, times)
    first, each = np.ceil(landed / DT).astype(int) - 1, np.arange(BODIES)
    fine = trajectory(Simulation(sheet, fine_method(), **ON_GRAPH), FRAMES, FINE)
    for name in names:
        sim = Simulation(sliding, name, **ON_GRAPH, **solved(name))
        errors: dict[str, list[float]] = {}

        def note(kind: str, apart: np.ndarray, into: dict[str, list[float]] = errors) -> None:
            into.setdefault(kind, []).append(float(np.sqrt((apart**2).sum(axis=-1).mean())))

        for substeps in SUBSTEPS:
            x = trajectory(sim, FRAMES, substeps)
            note("before", x[BEFORE - 1] - ways[BEFORE - 1])
            note("at", x[first, each] - ways[first, each])
            note("past", x[-1] - ways[-1])
        creep = 0.0
        sim.load_scene(sticking)
        for substeps in SUBSTEPS:
            x = trajectory(sim, FRAMES, substeps)
            note("stuck", x[-1] - ends[-1])
            creep = max(creep, float(np.abs(x[-1] - x[-AT_REST]).max()))
        sim = Simulation(sheet, name, **ON_GRAPH, **solved(name))
        for substeps in CLOTH_SUBSTEPS:
            x = trajectory(sim, FRAMES, substeps)
            note("cloth_before", x[CLOTH_BEFORE - 1] - fine[CLOTH_BEFORE - 1])
            note("cloth", x[CLOTH_LANDED - 1 :] - fine[CLOTH_LANDED - 1 :])
        found[name] = {
            kind: _order(CLOTH_SUBSTEPS if "cloth" in kind else SUBSTEPS, of)
            for kind, of in errors.items()
        } | {"creep": creep}
    return found


def _order(halved: Sequence[int], errors: Sequence[float]) -> float | None:
    """The slope of a line through errors by steps that halve; None where all are rounding."""
    points = [
        (np.log2(substeps), np.log2(error))
        for substeps, error in zip(halved, errors, strict=True)
        if error > LEAST
    ]
    if len(points) < 2:
        return None
    halvings, logs = np.array(points).T
    return float(-np.polyfit(halvings, logs, 1)[0])
