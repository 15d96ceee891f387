"""Cloths for tests of where particles and springs are stored, and what they come to."""

import hashlib
from dataclasses import replace

import numpy as np
from hypothesis import strategies as st

from taichi_cloth import runtime
from taichi_cloth.scene import scenefile
from taichi_cloth.scene.cloth import grid, grid_triangles
from taichi_cloth.scene.model import (
    ParticleDefaults,
    Particles,
    Scene,
    SpringDefaults,
    Springs,
    World,
)
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.simulation.storage import adjacency

LINKS = ("structural", "shear", "bend")
SIDES = ("left", "right", "top", "bottom", "front", "back")


def cloth(
    columns,
    rows,
    links=("structural",),
    dim=2,
    *,
    walls=(),
    drag=0.0,
    damping=0.0,
    break_force=None,
    break_in=None,
    own_numbers=False,
    speed=2.0,
    **world,
):
    """A crumpled cloth that flies about.

    own_numbers: other stiffness and so on for each kind. break_in: by kind.
    """
    kinds = {kind: 1.0 + 0.3 * k * own_numbers for k, kind in enumerate(links)}
    particles, springs = grid(
        (100.0, 100.0, 0.0)[:dim],
        columns,
        rows,
        20.0,
        links=links,
        pinned=[(0, 0), (columns - 1, rows // 2)],
        particle_defaults=ParticleDefaults(mass=1.5, radius=4.0, viscous=drag, restitution=0.6),
        stiffness={kind: 0.2 * factor for kind, factor in kinds.items()},
        damping={kind: damping * factor for kind, factor in kinds.items()},
        rest_length={kind: 20.0 for kind in kinds},
        break_force={kind: break_force and break_force * factor for kind, factor in kinds.items()},
        break_in=break_in,
    )
    rng = np.random.default_rng(columns * rows)
    particles.position[:] += rng.uniform(-4, 4, particles.position.shape)
    particles.velocity[:] += rng.normal(0, speed, particles.position.shape)
    size = (200.0 + 20.0 * columns, 200.0 + 20.0 * rows, 60.0)[:dim]
    return Scene(
        "cloth",
        World(size, gravity=(0.01, 0.05, 0.02)[:dim], walls=walls, **world),
        particles,
        springs,
        particle_defaults=ParticleDefaults(viscous=drag),
        spring_defaults=SpringDefaults(stiffness=0.1, damping=damping, break_force=break_force),
    )


def motion(sim, *, frames=30, act=None):
    """Positions, velocities and whole springs after some frames; act(sim) half way."""
    sim.advance(frames // 2)
    if act:
        act(sim)
    sim.advance(frames // 2)
    return sim.positions(), sim.velocities(), sim.springs_alive()


def assert_same(one, other, tolerance=0.0):
    """Two results of `motion` are equal: to the last bit, unless a tolerance is given."""
    np.testing.assert_array_equal(one[2], other[2])
    for a, b in zip(one[:2], other[:2], strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=tolerance)


def joined(*parts):
    """Particles and springs of several (particles, springs)."""
    particles, springs = parts[0]
    for more, ties in parts[1:]:
        ties = replace(ties, between=ties.between + len(particles))
        particles, springs = particles.joined(more), springs.joined(ties)
    return particles, springs


def mixed(dim=3, **options):
    """Two cloths, one hanging from the other by a chain of particles that are on no grid."""
    defaults = {"drag": 0.01, "damping": 0.02, "break_force": 1.5, "walls": SIDES[: 2 * dim]}
    one = cloth(9, 6, LINKS[:2], dim, own_numbers=True, **(defaults | options))
    two = cloth(5, 9, ("structural", "bend"), dim, **(defaults | options))
    limit = one.spring_defaults.break_force
    chain = Particles.build(np.full((5, dim), 10.0) + 4.0 * np.arange(5)[:, None], radius=4.0)
    between = np.array([[0, 1], [1, 2], [2, 3], [3, 4]])
    ties = Springs.build(between, chain.position, stiffness=0.3, break_force=limit and 2 * limit)
    particles, springs = joined(
        (two.particles, two.springs), (chain, ties), (one.particles, one.springs)
    )
    n = len(two.particles)
    ends = np.array([[n - 1, n], [n + 4, n + 5], [3, n + 20], [0, n - 1]])
    damping = 3 * one.spring_defaults.damping
    ties = Springs.build(
        ends, particles.position, stiffness=0.2, damping=damping, break_force=limit and 3 * limit
    )
    return replace(one, particles=particles, springs=springs.joined(ties))


# --- any springs -----------------------------------------------------------------------------


@st.composite
def particles_and_springs(draw):
    """(particle count, springs, grids, springs made by grids) of cloths among loose particles."""
    count, between, stiffness, grids = 0, [np.zeros((0, 2), int)], [], []
    for k in range(draw(st.integers(1, 2))):
        count += draw(st.integers(0, 3))  # loose particles before it
        links = LINKS[: draw(st.integers(1, 3))]
        columns, rows = draw(st.integers(2, 40)), draw(st.integers(2, 20))
        springs = grid((0.0, 0.0), columns, rows, 1.0, links=links)[1]
        between.append(springs.between + count)
        stiffness.append(np.full(len(springs), 1.0 + k))
        grids.append(adjacency.Grid(count, columns, rows))
        count += columns * rows
    count += draw(st.integers(0, 3))
    between, stiffness = np.concatenate(between), np.concatenate(stiffness)
    made = Springs.build(between, np.zeros((count, 2)), stiffness=stiffness, rest_length=1.0)
    return count, made, grids


@st.composite
def edits(draw, springs, count):
    """The same springs with some removed, and others added, in any order."""
    some = st.lists(st.integers(0, len(springs) - 1), max_size=4)
    kept = np.setdiff1d(np.arange(len(springs)), draw(some))
    pairs = {tuple(sorted(pair)) for pair in springs.between[kept].tolist()}
    end = st.integers(0, count - 1)
    more = [(a, b) for a, b in draw(st.lists(st.tuples(end, end), max_size=4)) if a != b]
    more = [pair for pair in {tuple(sorted(pair)) for pair in more} if pair not in pairs]
    extra = Springs.build(np.reshape(more, (-1, 2)).astype(int), np.zeros((count, 2)))
    edited = springs.select(kept).joined(extra)
    order = np.random.default_rng(draw(st.integers(0, 9))).permutation(len(edited))
    return edited.select(order)


# --- for every number of threads -------------------------------------------------------------

# Two cloths, one of them with all kinds of links, tied to each other by springs on the graph.
TWO_CLOTHS = """
[world]
size = [600.0, 500.0]
gravity = [0.0, 0.05]
walls = true
collisions = COLLISIONS
[particle]
viscous = 0.02
radius = 4.0
[spring]
stiffness = 0.3
damping = 0.1
break_force = 1.2
[[cloths]]
origin = [50.0, 30.0]
columns = 23
rows = 17
spacing = 20.0
pinned = [[0, 0], [22, 0]]
[[cloths]]
origin = [60.0, 400.0]
columns = 14
rows = 5
spacing = 15.0
links = ["structural", "shear", "bend"]
[[springs]]
between = [380, 395]
[[springs]]
between = [385, 400]
"""


def bits(precision, method, collisions, threads, contact=None, **settings):
    """What two cloths come to with so many threads, in lanes: a digest, and how many springs held.

    Starts Taichi anew: for a process of its own.
    """
    runtime.start("cpu", precision, threads=threads)
    text = TWO_CLOTHS.replace("COLLISIONS", str(collisions).lower())
    if contact:
        text = text.replace("walls = true", f"walls = true\ncontact = '{contact}'\nfriction = 0.2")
    scene = scenefile.parse(text)
    sim = Simulation(scene, method, topology="lanes", execution="parallel", lanes=2, **settings)
    sim.advance(90)
    state = sim.positions(), sim.velocities(), sim.springs_alive()
    return [hashlib.sha256(of.tobytes()).hexdigest() for of in state], int(state[2].sum())


# Thinner than the spacing of `loose_sheet`, which comes down onto it between its particles.
ROD = {"ends": [[4.0, 0.95, 0.013], [6.0, 0.95, 0.017]], "radius": 0.006, "friction": 0.6}


def loose_sheet(*obstacles, speed=0.0, break_force=None, viscous=1e-3, **world):
    """A loose cloth of cells of 50 mm that falls, or flies down, onto what is in its way."""
    cloth, ties = grid(
        [4.8, 1.0, -0.2],
        9,
        9,
        0.05,
        links=["structural", "shear"],
        across=[1, 0, 0],
        down=[0, 0, 1],
        particle_defaults=ParticleDefaults(mass=0.001, radius=0.002, viscous=viscous),
        spring_defaults=SpringDefaults(stiffness=20.0, damping=0.005, break_force=break_force),
    )
    cloth.velocity[:, 1] = -speed
    given = {"size": (10.0, 10.0, 10.0), "gravity": (0.0, -9.81, 0.0), "dt": 1 / 60, "up": "y"}
    triangles = grid_triangles(9, 9)
    world = World(**(given | world))
    return Scene("sheet", world, cloth, ties, triangles=triangles, obstacles=obstacles)
