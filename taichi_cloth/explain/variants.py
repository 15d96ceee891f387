"""A scene with one feature less, or more: what the cost of a feature is measured by (NumPy)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from taichi_cloth.errors import counted
from taichi_cloth.kernels import forces
from taichi_cloth.kernels.forces.contract import PARTICLE_NUMBER, Variant, has
from taichi_cloth.scene.cloth import LINKS, grid_stencils
from taichi_cloth.scene.features import Features
from taichi_cloth.scene.model import WALLS, Particles, Scene, SpringDefaults, Springs
from taichi_cloth.scene.obstacles import CONTACTS, Obstacle
from taichi_cloth.scene.solids import planes
from taichi_cloth.scene.spheres import nearness
from taichi_cloth.scene.stencils import Stencils
from taichi_cloth.simulation.storage import adjacency

# Of what is added where a scene has none. Light enough for the scene's own step to stay stable.
LIGHT_SPRING = 0.2  # stiffness of a link, of the median spring's
LIGHT_BENDING = 0.01  # rigidity of cloth, of stiffness * spacing^2
FAR_TO_BREAK = 1e3  # break force, of stiffness * length: never reached
OF_MOTION = ("velocity", "spin", "starts", "stops", "grip")  # keys of obstacles that move
ODD = 1.0 + 1e-6  # what one number is multiplied by, so that it has to be stored for each


def variants(scene: Scene, on_graph: bool) -> Iterator[Variant]:
    """One variant of a checked scene for each feature that can be switched.

    on_graph: whether the springs are stored as lists, where it matters that they are all alike.
    """
    features = scene.features()
    yield from _forces(scene)
    yield from _links(scene)
    yield from _bending(scene)
    if len(scene.springs):
        yield _fracture(scene, features.fracture)
    if features.obstacles:
        yield _obstacles(scene, features)
    if features.moving:
        yield _at_rest(scene)
    if features.resting and not features.thick:
        yield _original_pairs(scene)
    if scene.world.contact == CONTACTS[0]:
        yield _walls(scene, features)
    if scene.world.collisions or not features.thick:  # whose pairs collide in any case
        yield _collisions(scene)
    if features.thick:
        yield _thickness(scene)
    if scene.world.mouse == "spawn":
        about = "clicks add particles and springs"
        yield Variant("mouse: spawn", True, about, scene.with_world(mouse="none"))
    if on_graph:
        yield from _uniform_springs(scene, features)
    yield from _uniform_particles(scene, features)
    if scene.world.dim == 2:
        yield Variant("third dimension", False, "the same scene in a plane", _in_space(scene))


def _forces(scene: Scene) -> Iterator[Variant]:
    """A variant for each force, as its file makes it."""
    for name in forces.TERMS:
        term = forces.load(name)
        variant = term.variant(scene) if has(term.variant) else None
        if variant is not None:
            yield variant


def _walls(scene: Scene, features: Features) -> Variant:
    if features.walls:
        about = counted(len(features.walls), "wall") + ", one is the floor" * features.floor
        return Variant("walls", True, about, scene.with_world(walls=()))
    walls = tuple(name for name, (axis, _) in WALLS.items() if axis < scene.world.dim)
    walled = scene.with_world(walls=walls)
    about = f"{len(walls)} walls" + ", one is the floor" * walled.features().floor
    return Variant("walls", False, about, walled)


def _obstacles(scene: Scene, features: Features) -> Variant:
    """The scene without obstacles, ground and resting walls."""
    world = scene.world
    walls = world.walls if world.contact == CONTACTS[0] else ()
    contact = world.contact if world.collisions else CONTACTS[0]
    friction = 0.0 if contact == CONTACTS[0] else world.friction
    bare = scene.with_world(ground=None, friction=friction, contact=contact, walls=walls)
    about = ", ".join(features.obstacles)
    return Variant("obstacles", True, about, replace(bare, obstacles=()))


def _at_rest(scene: Scene) -> Variant:
    """The scene with its obstacles at rest where they start."""
    still = tuple(
        replace(
            obstacle,
            values={k: v for k, v in obstacle.values.items() if k not in OF_MOTION},
        )
        for obstacle in scene.obstacles
    )
    about = "obstacles have velocities or spins"
    return Variant("moving obstacles", True, about, replace(scene, obstacles=still))


def _original_pairs(scene: Scene) -> Variant:
    """The scene whose pairs bounce and do not rest; what rests on walls does so on planes there."""
    world, particles = scene.world, scene.particles
    own = particles.restitution if len(particles) else scene.particle_defaults.restitution
    walls = tuple(
        Obstacle.build(
            "plane",
            point=point,
            normal=normal,
            friction=world.friction,
            restitution=float(np.median(own)),  # walls have none of their own
        )
        for _, point, normal in planes(replace(world, ground=None))
    )
    friction = 0.0 if world.ground is None else world.friction
    bouncing = replace(world, contact=CONTACTS[0], walls=(), friction=friction)
    bounces = scene.with_parts(world=bouncing, obstacles=scene.obstacles + walls)
    return Variant("resting pairs", True, "pairs rest on each other", bounces)


def _collisions(scene: Scene) -> Variant:
    collide, particles = scene.world.collisions, scene.particles
    radius = float(np.median(particles.radius)) if len(particles) else 0.0
    about = f"of {counted(len(particles), 'particle')}, radius {radius:g}"
    return Variant("collisions", collide, about, scene.with_world(collisions=not collide))


def _thickness(scene: Scene) -> Variant:
    """The scene whose cloths pass through themselves."""
    particles = scene.particles
    thin = replace(particles, thickness=np.zeros(len(particles)))
    wide = 2 * scene.spheres.radius[scene.spheres.thick]
    about = f"spheres of {counted(len(wide), 'particle')}, as wide as {wide.max():.4g}"
    near = nearness(particles.position, scene.spheres)
    about = "; ".join([about, *scene.spheres.widened[:1], *([near] if near else [])])
    return Variant("self-collision", True, about, replace(scene, particles=thin))


def _uniform_springs(scene: Scene, features: Features) -> Iterator[Variant]:
    """One spring gets a number of its own, where all share theirs and none can be added."""
    springs = scene.springs
    if features.uniform_springs and len(springs) > 1 and not scene.world.takes_clicks:
        stiffness = springs.stiffness.copy()
        stiffness[0] *= ODD
        changed = replace(scene, springs=replace(springs, stiffness=stiffness))
        yield Variant("uniform springs", True, "all have the same numbers", changed)


def _uniform_particles(scene: Scene, features: Features) -> Iterator[Variant]:
    """One particle gets numbers of its own, where all share theirs and something reads them."""
    particles = scene.particles
    terms = [forces.load(name) for name in forces.present_in(scene)]
    stored = [field.shape for term in terms if has(term.fields) for field in term.fields]
    bodies = bool(features.walls or features.collisions or features.obstacles)
    read = PARTICLE_NUMBER in stored or bodies
    if features.uniform_particles and len(particles) > 1 and read:
        radius, viscous = particles.radius.copy(), particles.viscous.copy()
        radius[0], viscous[0] = radius[0] * ODD, viscous[0] * ODD
        changed = replace(scene, particles=replace(particles, radius=radius, viscous=viscous))
        yield Variant("uniform particles", True, "all have the same numbers but mass", changed)


def kinds_of_links(scene: Scene) -> np.ndarray:
    """For each spring the kind of link out of `LINKS` that it is in a regular grid, else ''."""
    kind = np.full(len(scene.springs), "", dtype="U10")
    a, b = scene.springs.between.min(axis=1), scene.springs.between.max(axis=1)
    for of in adjacency.find_grids(scene.springs.between, len(scene.particles)):
        end = of.first + of.rows * of.columns
        inside = (a >= of.first) & (b < end)
        rows, columns = (
            (b - of.first) // of.columns - (a - of.first) // of.columns,
            (b - of.first) % of.columns - (a - of.first) % of.columns,
        )
        for name, offsets in LINKS.items():
            for column, row in offsets:
                kind[inside & (columns == -column) & (rows == -row)] = name
    return kind


def _links(scene: Scene) -> Iterator[Variant]:
    """A variant for each kind of link of a grid: without it, or, where no grid has it, with it."""
    kind = kinds_of_links(scene)
    present = [name for name in LINKS if (kind == name).any()]
    if not present:
        return
    for name in LINKS:
        if name not in present:
            more = _more_links(scene, name, kind == present[0])
            if len(more):
                about = f"{counted(len(more), 'spring')} of {LIGHT_SPRING:g} times the stiffness"
                with_more = replace(scene, springs=scene.springs.joined(more))
                yield Variant(f"{name} links", False, about, with_more)
        elif len(present) > 1:
            without = replace(scene, springs=scene.springs.select(kind != name))
            about = counted(int((kind == name).sum()), "spring")
            yield Variant(f"{name} links", True, about, without)


def _bending(scene: Scene) -> Iterator[Variant]:
    """Every grid bends, with a light rigidity, where nothing in the scene does."""
    springs, parts = scene.springs, []
    for of in adjacency.find_grids(springs.between, len(scene.particles)):
        kind = (springs.between >= of.first) & (springs.between < of.first + of.rows * of.columns)
        spacing = float(springs.rest_length[kind.all(axis=1)].min())
        rigidity = LIGHT_BENDING * float(np.median(springs.stiffness)) * spacing**2
        if spacing > 0 and rigidity > 0:
            parts.append(grid_stencils(of.columns, of.rows, spacing, rigidity, first=of.first))
    stencils = Stencils.concatenated(parts)
    if len(stencils) and not (scene.stencils.bending > 0).any():
        about = f"of {counted(len(stencils), 'stencil')}, light"
        yield Variant("bending", False, about, replace(scene, stencils=stencils))


def _more_links(scene: Scene, name: str, like: np.ndarray) -> Springs:
    """Links of a kind in every grid; like: (s,) bool, the springs whose numbers they resemble."""
    pairs = [np.zeros((0, 2), np.int64)]
    for of in adjacency.find_grids(scene.springs.between, len(scene.particles)):
        row, column = np.divmod(np.arange(of.rows * of.columns), of.columns)
        for step, rise in LINKS[name]:
            far_row, far_column = row + rise, column + step
            there = (far_row >= 0) & (far_column >= 0) & (far_column < of.columns)
            here = of.first + np.flatnonzero(there)
            far = of.first + (far_row * of.columns + far_column)[there]
            pairs.append(np.stack([here, far], axis=1))
    between, springs = np.concatenate(pairs), scene.springs.select(like)
    count = len(scene.particles)
    keys, taken = (np.sort(of, axis=1) @ (count, 1) for of in (between, scene.springs.between))
    between = between[~np.isin(keys, taken)]  # none twice between the same two
    defaults = SpringDefaults(stiffness=LIGHT_SPRING * float(np.median(springs.stiffness)))
    return Springs.build(
        between,
        scene.particles.position,
        defaults=defaults,
        damping=float(np.median(springs.damping)),
        break_force=float(np.median(springs.break_force)),
        break_in=springs.break_in[0],
    )


def _fracture(scene: Scene, used: bool) -> Variant:
    springs, defaults = scene.springs, scene.spring_defaults
    finite = np.isfinite(springs.break_force)
    if used:
        force = np.full(len(springs), np.inf)
        about = f"{counted(int(finite.sum()), 'spring')} can break"
        defaults = replace(defaults, break_force=None)
    else:
        length = np.maximum(springs.rest_length, springs.rest_length.max(initial=1.0))
        force = FAR_TO_BREAK * np.maximum(springs.stiffness, 1e-12) * length
        about = f"{counted(len(springs), 'spring')} could break, none does"
    springs = replace(springs, break_force=force)
    changed = replace(scene, springs=springs, spring_defaults=defaults)
    return Variant("fracture", used, about, changed)


def _in_space(scene: Scene) -> Scene:
    """A 2-D scene in the middle plane of a deep 3-D world."""
    world, particles = scene.world, scene.particles

    def deepened(vectors: np.ndarray) -> np.ndarray:
        return np.column_stack([vectors, np.zeros(len(vectors))])

    world = replace(world, size=(*world.size, max(world.size)), gravity=(*world.gravity, 0.0))
    columns = vars(particles) | {
        "position": deepened(particles.position),
        "velocity": deepened(particles.velocity),
    }
    return replace(scene, world=world, particles=Particles(**columns))
