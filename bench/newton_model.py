"""Scenes of ours as models of the installed `newton`, and its solvers on them.

Positions, velocities, masses, fixed particles, gravity, rest lengths, stiffnesses and axial
dashpots are ours, in our units, as 32-bit floats; in a plane, z is 0. What stands still, a sphere
or the ground, is a shape of its; a particle touches it at its radius, as with us. On the CPU it has
one thread.

Its Style3D has triangles in the place of springs. A triangle with a right angle whose sides follow
warp and weft has the energy (area/2) (ku (|u|/L - 1)² + kv (|v|/M - 1)²), beside a shear term that
may be 0: that of springs along these sides, of ku M / 2L and kv L / 2M. So it has the springs of a
grid whose links are structural, to the last bit of their stiffness, and no others: none across a
cell, and no dashpots.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from taichi_cloth.errors import InputError
from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.obstacles import Obstacle
from taichi_cloth.simulation.storage import adjacency

# By the name in tables: the class, and whether it takes a number of iterations.
SOLVERS = {
    "Newton, semi-implicit": ("SolverSemiImplicit", False),
    "Newton, XPBD": ("SolverXPBD", True),
    "Newton, VBD": ("SolverVBD", True),
    "Newton, Style3D": ("SolverStyle3D", True),
}
OF_PANELS = "SolverStyle3D"  # the one that has triangles, and no springs
# What our material is in Newton's numbers. tri_ka, edge_ke and tri_drag mean another thing in each
# of its solvers (1.8.0), so that none of them is used.
SPRINGS_AS = "spring_stiffness is k, spring_damping the dashpot; no tri_ka, edge_ke, tri_drag"
PANELS_AS = (
    "tri_aniso_ke is k L / W along the sides of a cell of L x W, twice that at an edge, without "
    "shear; no tri_ka, edge_ke, tri_drag"
)
PENALTIES = ("SolverSemiImplicit", "SolverVBD", OF_PANELS)  # contacts are springs with dashpots
LINEAR_ITERATIONS = 20  # of Style3D's conjugate gradients in each of its iterations
RECORDED = 32  # steps in a recording, at most: an even number, so that it ends where it began
GAP = 0.1  # m, beyond a particle's radius: what it may go in a step, and still be seen to touch


def model_of(scene: Scene, solver: str = "", contact_stiffness: float = 0.0) -> Any:
    """The scene as a `newton.Model` on the CPU for this class of solvers.

    contact_stiffness: of the springs, in units of force per length, with which penalties keep a
    particle out, damped critically for the mean mass. Particles are coloured by our springs, as
    VBD needs: its own colours are those of triangles. Raises InputError where a scene has what
    Newton, or this solver, has not (`lacking`).
    """
    lacks = lacking(scene, solver)
    if lacks:
        raise InputError(f"scene '{scene.name}': {lacks}")
    import newton

    particles, springs = scene.particles, scene.springs
    builder = newton.ModelBuilder()
    if solver == OF_PANELS:
        _add_panels(builder, scene)
    else:
        builder.add_particles(
            pos=in_space(particles.position).tolist(),
            vel=in_space(np.zeros_like(particles.velocity)).tolist(),
            mass=[0.0] * len(particles),
            radius=[0.0] * len(particles),
        )
        builder.spring_indices = springs.between.ravel().tolist()
        builder.spring_rest_length = springs.rest_length.tolist()
        builder.spring_stiffness = springs.stiffness.tolist()
        builder.spring_damping = springs.damping.tolist()
        builder.spring_control = [0.0] * len(springs)
    builder.particle_mass = np.where(particles.fixed, 0.0, particles.mass).tolist()
    fixed = particles.fixed[:, None]
    builder.particle_qd = in_space(np.where(fixed, 0.0, particles.velocity)).tolist()
    builder.particle_radius = particles.radius.tolist()
    damping = 2.0 * float(np.sqrt(contact_stiffness * particles.mass[~particles.fixed].mean()))
    _add_shapes(builder, scene, contact_stiffness, damping)
    colour = adjacency.vertex_colours(springs.between, len(particles))
    colour[colour < 0] = 0  # what no spring holds touches nobody
    builder.set_coloring([np.flatnonzero(colour == c) for c in range(colour.max(initial=0) + 1)])
    model = builder.finalize(device="cpu")
    model.set_gravity(tuple(in_space(np.array([scene.world.gravity]))[0]))
    # Particles do not touch each other.
    model.particle_grid, model.particle_max_radius = None, 0.0
    model.soft_contact_ke, model.soft_contact_kd = contact_stiffness, damping
    model.soft_contact_mu = 0.0
    return model


def material_of(solver: str) -> str:
    """Our springs in the numbers of a solver, in words."""
    return f"material: {PANELS_AS if solver == OF_PANELS else SPRINGS_AS}"


def lacking(scene: Scene, solver: str = "") -> str:
    """The lacks of Newton's models here, or of this class of solvers, for a scene; '': none."""
    world, springs = scene.world, scene.springs
    rough = ("friction", "restitution")
    lacks = {
        "drag": (scene.particles.viscous != 0).any(),
        "particles that touch each other": scene.collides,
        "walls": bool(world.walls),
        "friction": world.ground is not None and world.friction,
        "friction and bounces": any(o.value(key) for o in scene.obstacles for key in rough),
        "obstacles but spheres that stand still": not all(map(_is_still_sphere, scene.obstacles)),
        "springs that break": np.isfinite(springs.break_force).any(),
        "stencils": len(scene.stencils) > 0,
    }
    for what, there in lacks.items():
        if there:
            return f"Newton's models here have no {what}"
    if solver == OF_PANELS:
        if (springs.damping != 0).any():
            return "Style3D has no dashpots"
        if _panels(scene) is None:
            return "Style3D has triangles, and no springs but those along a grid's rows and columns"
    return ""


def _is_still_sphere(obstacle: Obstacle) -> bool:
    moving = any(np.any(obstacle.value(key)) for key in ("spin", "velocity", "grip"))
    return obstacle.shape == "sphere" and not moving


def _add_shapes(builder: Any, scene: Scene, stiffness: float, damping: float) -> None:
    """Things that stand still; as Newton takes the mean of both, they have particles' numbers."""
    import newton
    import warp

    cfg = newton.ModelBuilder.ShapeConfig(ke=stiffness, kd=damping, mu=0.0)
    for obstacle in scene.obstacles:
        (centre,) = in_space(np.array([obstacle.value("centre")], float))
        at = warp.transform(centre.tolist(), warp.quat_identity())
        builder.add_shape_sphere(-1, xform=at, radius=float(obstacle.value("radius")), cfg=cfg)
    if scene.world.ground is not None:
        up = np.eye(3)["xyz".index(scene.world.up)]
        builder.add_shape_plane(plane=(*up, -float(scene.world.ground)), cfg=cfg)


def _panels(scene: Scene) -> tuple[int, int, np.ndarray, np.ndarray] | None:
    """Rows and columns of the grid that all particles are, and the indices of its springs along
    rows (rows, columns - 1) and columns (rows - 1, columns); None where springs are any others.
    """
    n, between = len(scene.particles), np.sort(scene.springs.between, axis=1)
    grids = adjacency.find_grids(between, n)
    if len(grids) != 1 or grids[0].columns * grids[0].rows != n:
        return None
    columns, rows = grids[0].columns, grids[0].rows
    if len(between) != rows * (columns - 1) + columns * (rows - 1):
        return None
    index = {tuple(pair): number for number, pair in enumerate(between.tolist())}
    number = np.arange(n).reshape(rows, columns)
    pairs = (number[:, :-1], number[:, 1:]), (number[:-1], number[1:])
    found = [
        np.array([index.get(pair, -1) for pair in zip(a.flat, b.flat, strict=True)])
        for a, b in pairs
    ]
    if any((of < 0).any() for of in found):
        return None
    return rows, columns, found[0].reshape(rows, -1), found[1].reshape(-1, columns)


def _add_panels(builder: Any, scene: Scene) -> None:
    """Two triangles a cell that have the energy of the springs; masses are set afterwards."""
    import newton
    import warp
    from newton.solvers import style3d

    panels = _panels(scene)
    assert panels
    rows, columns, along, down = panels
    number = np.arange(rows * columns).reshape(rows, columns)
    springs = scene.springs
    triangles, sides, stiffness = [], [], []
    for side in (1, -1):  # the triangle at a cell's first corner, and that at its last
        here = (slice(None, -1), slice(None, -1)) if side > 0 else (slice(1, None), slice(1, None))
        across = (here[0], slice(1, None) if side > 0 else slice(None, -1))
        below = (slice(1, None) if side > 0 else slice(None, -1), here[1])
        u, v = along[here[0]], down[:, here[1]]
        # The triangles on both sides of a spring share its stiffness; at an edge there is one.
        both = np.full(along.shape, 0.5), np.full(down.shape, 0.5)
        both[0][[0, -1]], both[1][:, [0, -1]] = 1.0, 1.0
        length, width = springs.rest_length[u], springs.rest_length[v]
        ku = springs.stiffness[u] * both[0][here[0]] * 2 * length / width
        kv = springs.stiffness[v] * both[1][:, here[1]] * 2 * width / length
        corners = np.stack([number[here], number[across], number[below]], axis=-1)
        triangles.append(corners.reshape(-1, 3))
        sides.append(side * np.stack([length, width], axis=-1).reshape(-1, 2))
        stiffness.append(np.stack([ku, kv, 0 * ku], axis=-1).reshape(-1, 3))
    size = np.concatenate(sides)
    flat = np.zeros((len(size), 3, 2))
    flat[:, 1, 0], flat[:, 2, 1] = size.T
    newton.solvers.SolverStyle3D.register_custom_attributes(builder)
    style3d.add_cloth_mesh(
        builder,
        pos=warp.vec3(0.0),
        rot=warp.quat_identity(),
        vel=warp.vec3(0.0),
        vertices=in_space(scene.particles.position).tolist(),
        indices=np.concatenate(triangles).ravel().tolist(),
        density=0.0,
        panel_verts=flat.reshape(-1, 2).tolist(),
        panel_indices=np.arange(3 * len(size)).tolist(),
        tri_aniso_ke=[warp.vec3(*of) for of in np.concatenate(stiffness).tolist()],
        edge_aniso_ke=warp.vec3(0.0),
    )


def in_space(vectors: np.ndarray) -> np.ndarray:
    """Vectors (n, 2 or 3) with three components, the third 0 where there was none."""
    return np.pad(vectors, ((0, 0), (0, 3 - vectors.shape[1])))


class Stepper:
    """One of Newton's solvers on a scene of ours. solver: its class; settings: those of its own.

    recorded: whether steps are recorded once and replayed (`wp.ScopedCapture`), as Newton's own
    examples do; the bits are those of steps that Python launches. A model with shapes is looked
    through for contacts in each step.
    """

    def __init__(self, model: Any, solver: str, recorded: bool = False, **settings: Any):
        import newton

        kind = getattr(newton.solvers, solver)
        if solver == OF_PANELS:
            config = kind.Config(linear_iterations=LINEAR_ITERATIONS, **settings)
            self._solver = kind(model, config=config)
            if model.shape_count:  # without what cloth does to itself
                self._solver.collision.stiff_vf = 0.0
                self._solver.collision.stiff_ee = 0.0
                self._solver.collision.stiff_ef = 0.0
            else:
                self._solver.collision = None
        else:
            self._solver = kind(model, **settings)
        self._control = model.control()
        self._states = model.state(), model.state()
        self._now = 0  # which of both states is the present one
        self._recorded = recorded
        self._graphs: dict[tuple[float, int, int], Any] = {}  # by dt, steps, and the first state
        self._pipeline = self._contacts = None
        if model.shape_count:
            self._pipeline = newton.CollisionPipeline(model, soft_contact_gap=GAP)
            self._contacts = self._pipeline.contacts()

    def advance(self, dt: float, steps: int) -> None:
        """So many steps of dt."""
        if not self._recorded:
            self._launch(dt, steps)
            return
        import warp

        for part in _parts(steps):
            warp.capture_launch(self._graph(dt, part))
            self._now = (self._now + part) % 2

    def prepare(self, dt: float, steps: int) -> None:
        """Record what so many steps of dt replay, where steps are recorded; do none of them."""
        now = self._now
        for part in _parts(steps) if self._recorded else ():
            self._graph(dt, part)
            self._now = (self._now + part) % 2
        self._now = now

    def positions(self) -> np.ndarray:
        """(n, 3), float32."""
        x: np.ndarray = self._states[self._now].particle_q.numpy()
        return x

    def velocities(self) -> np.ndarray:
        """(n, 3), float32."""
        v: np.ndarray = self._states[self._now].particle_qd.numpy()
        return v

    def _graph(self, dt: float, steps: int) -> Any:
        """A replay of so many steps from the present state; recording it changes no state."""
        key = dt, steps, self._now
        if key not in self._graphs:
            import warp

            with warp.ScopedCapture(device="cpu") as capture:
                self._launch(dt, steps)
            self._now = key[2]
            self._graphs[key] = capture.graph
        return self._graphs[key]

    def _launch(self, dt: float, steps: int) -> None:
        for _ in range(steps):
            now, after = self._states[self._now], self._states[1 - self._now]
            now.clear_forces()
            if self._pipeline is not None:
                self._pipeline.collide(now, self._contacts)
            self._solver.step(now, after, self._control, self._contacts, dt)
            self._now = 1 - self._now


def _parts(steps: int) -> list[int]:
    """Steps of the recordings that make up so many; all but the last one are alike."""
    whole, rest = divmod(steps, RECORDED)
    return [RECORDED] * whole + [rest] * (rest > 0)
