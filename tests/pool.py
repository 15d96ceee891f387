"""Simulations that tests share: whatever compiles the same is compiled once.

A test asks the pool for a scene, run in some way, and gets a simulation at that scene's start. It
is its own until the pool is asked for the like again.
"""

from dataclasses import replace

import inside
import numpy as np

from taichi_cloth.kernels import methods
from taichi_cloth.scene.cloth import LINKS, grid
from taichi_cloth.scene.model import Particles, Scene, Springs
from taichi_cloth.settings.options import SOLVER_SETTINGS
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.simulation.storage import layouts

# How much a simulation has room for: particles on the graph, with twice as many springs; in lanes
# a cloth of so many columns and rows, a small one beside it, and a few particles on no grid.
ROOM, COLUMNS, ROWS, LOOSE = 1500, 44, 40, 16


class Pool:
    """Asked for a simulation, takes the one it has for that kind of scene, or makes it."""

    def __init__(self):
        self._made = {}

    def __call__(
        self,
        scene,
        method="symplectic_euler",
        dt=None,
        substeps=1,
        *,
        topology="graph",
        execution="serial",
        lanes=2,
        another=False,
        **solver,
    ):
        """A simulation at the start of `scene`, as `Simulation` would make it with these settings.

        lanes: few, which compile in a third of the time; what holds for any number. another: a
        second one beside that which the same words gave before.
        """
        follows = dt == "auto"
        links = ()
        if topology == "lanes":
            stored = layouts.on_grids(scene.springs, len(scene.particles), lanes)
            links = tuple(stored.links)
        world = scene.world
        walls = frozenset(world.walls)
        thick = scene.features().thick
        pairs = world.collisions, world.contact, thick
        kind = (world.dim, walls, pairs, world.mouse == "spawn", links)
        compiled = inside.way_to_compile()
        key = method, topology, execution, lanes, follows, another, kind, compiled
        sim = self._made.get(key)
        if sim is None or (sim.topology, sim.execution) != (topology, execution):
            how = {"topology": topology, "execution": execution, "lanes": lanes}
            sim = Simulation(
                _widest(scene, links, thick), method, "auto" if follows else 1.0, **how
            )
            self._made[key] = sim
        for name in methods.load(method).claims.settings:
            sim.solver[name] = solver.pop(name, SOLVER_SETTINGS[name])
        assert not solver, f"{method} takes no {', '.join(solver)}"
        sim.load_scene(scene, None if follows else dt, substeps)
        return sim


def _widest(scene, links, thick):
    """A scene with all features there are in the world of `scene`, and room for many more.

    What is compiled for it runs every scene of such a world, and of such links in lanes.
    """
    world = scene.world
    if world.mouse != "spawn":
        world = replace(world, mouse="blow")
    middle = np.add(world.low, world.high) / 2
    size = float(np.min(np.subtract(world.high, world.low)))
    parts = []
    if links:
        kinds = [kind for kind in LINKS if {(-c, -r) for c, r in LINKS[kind]} <= set(links)]
        assert len(links) == 2 * len(kinds), f"links that no cloth has: {links}"
        for columns, rows in ((COLUMNS, ROWS), (4, 4)):
            parts.append(grid(middle, columns, rows, size / 100, links=kinds))
    loose = np.arange(LOOSE if links else ROOM)
    x = middle + 0.001 * size * np.column_stack(
        [loose / len(loose), *[0 * loose] * (len(middle) - 1)]
    )
    some = Particles.build(
        x, radius=1e-3 * (1 + loose), viscous=0.01 * (1 + loose), thickness=1e-6 * size * thick
    )
    # Beside cloths a chain, which is no grid and stays on the graph.
    steps = (1,) if links else (1, 2)
    pairs = [[i, i + step] for step in steps for i in loose[:-step]]
    ones = np.ones(len(pairs))
    ties = Springs.build(
        pairs, x, stiffness=np.linspace(1, 2, len(pairs)), damping=ones, break_force=9 * ones
    )
    parts.append((some, ties))
    particles, springs = parts[0]
    for more, tied in parts[1:]:
        tied = replace(tied, between=tied.between + len(particles))
        particles, springs = particles.joined(more), springs.joined(tied)
    return Scene("wide", world, particles, springs)
