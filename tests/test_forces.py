"""Every force keeps to its own declaration: law, twin, energy, derivatives, share of the limit."""

from dataclasses import replace

import numpy as np
import pytest
import taichi as ti
from cloths import mixed
from inside import spec_of, state_of

from taichi_cloth.front_end.mending import kernel
from taichi_cloth.kernels import forces
from taichi_cloth.kernels.accelerations import binds, damping_of, resists, stiffness_of
from taichi_cloth.kernels.forces.contract import (
    ACCELERATION,
    CURVATURE,
    FORCE,
    PARTS,
    TENSION,
    TRACTION,
    Absent,
    Term,
    has,
)
from taichi_cloth.kernels.packs import slot_number
from taichi_cloth.scene.cloth import grid, grid_stencils, grid_triangles
from taichi_cloth.scene.holding import Hold
from taichi_cloth.scene.model import Scene, World
from taichi_cloth.scene.stencils import mesh_stencils
from taichi_cloth.simulation.diagnostics import spring_forces, stencil_forces
from taichi_cloth.simulation.simulation import Simulation

NAMES = forces.TERMS


def everything():
    """A scene with every force that can be switched on, its particles moving; nothing breaks."""
    scene = mixed(walls=(), break_force=None)
    x = scene.particles.position
    lines, listed = grid_stencils(5, 9, 20.0, 3.0), mesh_stencils(x, grid_triangles(9, 6, 50), 2.0)
    scene = replace(scene, stencils=lines.joined(listed))
    for name in NAMES:
        term = forces.load(name)
        if not term.present(scene):
            variant = term.variant(scene) if has(term.variant) else None
            if variant is None:  # in a plane, or of windows alone
                continue
            changed = variant.scene
            assert term.present(changed), name
            more = {**scene.world.more, **changed.world.more}
            scene = replace(changed, world=replace(changed.world, more=more))
    v = np.random.default_rng(3).normal(size=scene.particles.position.shape)
    v[scene.particles.fixed] = 0.0
    return replace(scene, particles=replace(scene.particles, velocity=v))


def held():
    """That scene with some of its particles held by the mouse, a fixed one among them."""
    scene = everything().with_world(tools=True)
    rng, x = np.random.default_rng(5), scene.particles.position
    mine = np.append(rng.permutation(len(x))[:5], np.flatnonzero(scene.particles.fixed)[:1])
    mine = np.unique(mine)
    offset, place = rng.normal(size=(2, len(mine), x.shape[1]))
    k, c = rng.uniform(0.1, 0.5, (2, len(mine)))
    hold = Hold(mine, x[mine] + offset, place[0], k, c, scene.particles.mass[mine])
    return scene.with_world(held=hold)


def in_air():
    """A scene in space with every force on triangles, and what else there is, at its start."""
    cloth = grid((10.0, 10.0, 0.0), 4, 3, 5.0)
    world = World((100.0, 100.0, 100.0), (0.0, 0.1, 0.0))
    scene = Scene("in air", world, *cloth, triangles=grid_triangles(4, 3))
    for name in NAMES:
        term = forces.load(name)
        if term.adds == TRACTION:
            scene = term.variant(scene).scene
            assert term.present(scene), name
    return scene


def on_particles(scene, x, v):
    """Acceleration (n, dim) by the twins of all forces on particles."""
    total, mass = np.zeros_like(x), scene.particles.mass[:, None]
    for name in NAMES:
        term = forces.load(name)
        if has(term.twin) and term.adds in (ACCELERATION, FORCE):
            given = term.twin(x, v, scene.world, scene.particles)
            total = total + (given if term.adds == ACCELERATION else given / mass)
    return total


@pytest.mark.parametrize("part", PARTS)
def test_a_part_that_is_forgotten_is_named(part):
    whole = {name: getattr(forces.load("drag"), name) for name in PARTS}
    Term(**whole)
    del whole[part]
    with pytest.raises(TypeError, match=f"'{part}'"):
        Term(**whole)


@pytest.mark.parametrize(
    ("part", "value", "says"),
    [
        ("adds", "lift", "adds"),
        ("law", None, "law"),
        ("energy", Absent(""), "energy"),
        ("fields", (), "fields"),
        ("present", Absent("never"), "present"),
        ("adds", "curvature", "curvature"),
    ],
)
def test_a_part_that_makes_no_sense_is_named(part, value, says):
    whole = {name: getattr(forces.load("drag"), name) for name in PARTS}
    with pytest.raises(ValueError, match=says):
        Term(**whole | {part: value})


def test_laws_are_their_twins(topology, device):
    """A step of explicit Euler shows the acceleration at its start, exactly."""
    scene = held()
    x, v = scene.particles.position, scene.particles.velocity
    sim = Simulation(scene, "explicit_euler", topology=topology, execution="serial", lanes=2)
    sim.advance()
    free = ~scene.particles.fixed
    found = (sim.velocities() - v)[free] / scene.world.dt
    pulled = spring_forces(x, v, scene.springs)
    pulled += stencil_forces(x, scene.stencils, scene.particles.fixed)
    pulled /= scene.particles.mass[:, None]
    expected = (on_particles(scene, x, v) + pulled)[free]
    np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("name", [n for n in NAMES if has(forces.load(n).energy)])
def test_energies_are_potentials_of_twins(name):
    term, scene = forces.load(name), held()
    world, particles, springs = scene.world, scene.particles, scene.springs
    x, v, rng = particles.position, 0.0 * particles.velocity, np.random.default_rng(4)
    if term.adds == TENSION:
        springs = springs.select(np.arange(1))
        a, b = springs.between[0]
        d = x[b] - x[a]
        h, length = 1e-5, np.linalg.norm(d)
        slope = []
        for sign in (1, -1):
            moved = x.copy()
            moved[b] += sign * h * d / length
            slope.append(term.energy(moved, v, world, particles, springs))
        (tension,) = term.twin(np.array([length]), np.zeros(1), springs)
        assert (slope[0] - slope[1]) / (2 * h) == pytest.approx(tension, rel=1e-6)
        return
    others = springs
    if term.adds == CURVATURE:
        others = scene.stencils
        k = others.stiffness(particles.fixed)
        force = others.gathered(term.twin(others.curvature(x), k), len(x))
    else:
        force = term.twin(x, v, world, particles)
    if term.adds == ACCELERATION:
        force = force * particles.mass[:, None]
    way = np.where(particles.fixed[:, None], 0.0, rng.normal(size=x.shape))
    h = 1e-4
    work = term.energy(x + h * way, v, world, particles, others)
    work -= term.energy(x - h * way, v, world, particles, others)
    assert -work / (2 * h) == pytest.approx((force * way).sum(), rel=1e-6)


@kernel
def derivatives(spec: ti.template(), state: ti.template(), out: ti.types.ndarray()):
    """out (n, 2): stiffness and damping of the forces on each particle."""
    for i in range(out.shape[0]):
        if ti.static(binds(spec)):
            out[i, 0] = stiffness_of(spec, state, slot_number, state.slot[i])
        if ti.static(resists(spec)):
            out[i, 1] = damping_of(spec, state, slot_number, state.slot[i])


def test_stiffness_and_damping_are_derivatives_of_twins_and_inside_their_bounds(device):
    """Of forces on particles; those along springs: test_laws.py, test_stability.py."""
    scene = held()
    world, particles = scene.world, scene.particles
    x, v = particles.position, particles.velocity
    sim = Simulation(scene, topology="graph", execution="serial")
    found = np.zeros((len(x), 2))
    derivatives(spec_of(sim), state_of(sim), found)
    expected, bounds, h = np.zeros_like(found), np.zeros_like(found), 1e-4
    for name in NAMES:
        term = forces.load(name)
        if term.adds == FORCE and has(term.twin):
            for column, (dx, dv) in enumerate(((h, 0.0), (0.0, h))):
                there = term.twin(x + dx, v + dv, world, particles)
                here = term.twin(x - dx, v - dv, world, particles)
                expected[:, column] += -(there - here)[:, 0] / (2 * h)
        if has(term.bound) and term.adds in (ACCELERATION, FORCE):
            bounds += np.column_stack(term.bound(world, particles, scene.springs))
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)
    assert (expected <= bounds + 1e-9).all()


@pytest.mark.parametrize("name", [n for n in NAMES if has(forces.load(n).variant)])
def test_variants_switch_their_force_alone(name):
    term = forces.load(name)
    scene = everything() if term.adds != TRACTION else in_air()
    variant = term.variant(scene)
    assert variant.used and not term.present(variant.scene)
    before, after = forces.present_in(scene), forces.present_in(variant.scene)
    lost = {name} if name != "springs" else {"springs", "dashpots", "bending"}
    assert set(before) - set(after) == lost
