"""The scene as an ordinary differential equation, in NumPy and SciPy, running no kernel of ours.

The forces are the twins that their terms declare (`kernels/forces`); contacts and breaking springs
are events, at which the solution ends: beyond them it is not smooth, and no high order survives.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.kernels import forces
from taichi_cloth.kernels.forces.contract import ACCELERATION, CURVATURE, FORCE, TENSION, has
from taichi_cloth.limits import tractions
from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.solids import held, solids
from taichi_cloth.scene.triangles import corner_shares

if TYPE_CHECKING:
    from scipy.integrate import DOP853

TOLERANCE = 1e-13  # of one step: relative, and in parts of the lengths that `_absolute` takes
MOST_MOMENTS = 64  # of a step, at which collisions are looked for


class Forces:
    """Acceleration of a scene's particles, without contacts, and what would be an event."""

    def __init__(self, scene: Scene):
        from scipy import sparse

        particles, springs = scene.particles, scene.springs
        n, s = len(particles), len(springs)
        self.dim = scene.world.dim
        self.free = ~particles.fixed
        self.inverse_mass = np.where(particles.fixed, 0.0, 1.0 / particles.mass)[:, None]
        terms = [forces.load(name) for name in forces.present_in(scene)]
        self.twins = [(term.adds, term.twin) for term in terms if has(term.twin)]
        rows = np.repeat(np.arange(s), 2)
        signs = np.tile([-1.0, 1.0], s)
        # Row of a spring: minus one at its first end, one at its second.
        self.difference = sparse.csr_matrix((signs, (rows, springs.between.ravel())), shape=(s, n))
        self.gather = self.difference.T.tocsr()
        self.reads_rate = any(t.adds == TENSION and has(t.damping) for t in terms)
        # Row of a stencil: the weights of its particles.
        stencils = scene.stencils
        entries = stencils.weight, (stencils.owner, stencils.particle)
        self.bent = sparse.csr_matrix(entries, shape=(len(stencils), n))
        self.stencil_k = stencils.stiffness(particles.fixed)
        self.shortest, self.longest = springs.lengths_held()
        self.breaks = bool(np.isfinite(springs.break_force).any())
        self.shares = corner_shares(particles.position, scene.triangles)
        self.scene, self.solids = scene, solids(scene)
        self.carried = bool((held(scene, self.solids)[0] >= 0).any())

    def acceleration(self, x: np.ndarray, v: np.ndarray, t: float = 0.0) -> np.ndarray:
        """Acceleration (n, dim) at positions x and velocities v (n, dim), at the time t."""
        world, particles = self.scene.world, self.scene.particles
        force = -self._pull(x, v)
        if self.bent.shape[0]:
            curvature = self.bent @ x
            for adds, twin in self.twins:
                if adds == CURVATURE:
                    force += self.bent.T @ twin(curvature, self.stencil_k)
        a = np.zeros_like(x)
        for adds, twin in self.twins:
            if adds == ACCELERATION:
                a += twin(x, v, world, particles)
            elif adds == FORCE:
                force += twin(x, v, world, particles)
        triangles = self.scene.triangles
        force += tractions.forces_on_particles(x, v, t, world, triangles, self.shares)
        total: np.ndarray = np.where(self.free[:, None], a, 0.0) + self.inverse_mass * force
        return total

    def _pull(self, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        """The forces of the springs on their particles, negated (n, dim)."""
        along = self.difference @ x
        length = np.sqrt((along**2).sum(axis=1))
        with np.errstate(all="ignore"):
            unit = np.where(length[:, None] > 0, along / length[:, None], 0.0)
        rate = ((self.difference @ v) * unit).sum(axis=1) if self.reads_rate else None
        tension = np.zeros_like(length)
        for adds, twin in self.twins:
            if adds == TENSION:
                tension += twin(length, rate, self.scene.springs)
        pull: np.ndarray = self.gather @ (tension[:, None] * unit)
        return pull

    def slope(self, t: float, y: np.ndarray) -> np.ndarray:
        """dy/dt of y = (x, v), flat."""
        x, v = y.reshape(2, -1, self.dim)
        return np.stack([v, self.acceleration(x, v, t)]).ravel()

    def event(self, t: float, x: np.ndarray, v: np.ndarray) -> str | None:
        """An event here that is no part of the equation: a contact, a break; None: nothing."""
        particles, world = self.scene.particles, self.scene.world
        for wall in world.walls:
            axis, side = world.side(wall)
            bound = world.high[axis] if side > 0 else world.low[axis]
            hit = (side * (bound - x[:, axis]) < particles.radius) & (side * v[:, axis] > 0)
            if (hit & self.free).any():
                return f"particle {int((hit & self.free).argmax())} hits the wall '{wall}'"
        if self.carried:
            return "an obstacle moves fixed particles"
        for solid in self.solids:
            distance, n = solid.distances(x, t)
            centre, _ = solid.pose(t)
            u = ((v - solid.velocities(x - centre, t)) * n).sum(axis=1)
            hit = (distance < particles.radius) & (u < 0) & self.free
            if hit.any():
                return f"particle {int(hit.argmax())} touches {solid.name}"
        if self.breaks:
            length = np.sqrt(((self.difference @ x) ** 2).sum(axis=1))
            beyond = (length > self.longest) | (length < self.shortest)
            if beyond.any():
                return f"spring {int(beyond.argmax())} breaks"
        if world.collisions and len(x) > 1:
            return self._collision(x, v)
        return None

    def _collision(self, x: np.ndarray, v: np.ndarray) -> str | None:
        from scipy.spatial import cKDTree

        radius = self.scene.particles.radius
        pairs = cKDTree(x).query_pairs(2.0 * radius.max(), output_type="ndarray")
        if len(pairs) == 0:
            return None
        i, j = pairs.T
        d = x[j] - x[i]
        distance2 = (d**2).sum(axis=1)
        closing = ((v[i] - v[j]) * d).sum(axis=1) >= 0
        hit = (distance2 <= (radius[i] + radius[j]) ** 2) & (distance2 > 0) & closing
        hit &= self.free[i] | self.free[j]
        if not hit.any():
            return None
        first = int(hit.argmax())
        return f"particles {i[first]} and {j[first]} collide"


@dataclass(frozen=True)
class SmoothTrajectory:
    """Positions and velocities (times, n, dim) at the times up to `until`; NaN beyond.

    event: what ends it there; None: nothing, it is whole. given_up: it took too long.
    """

    x: np.ndarray
    v: np.ndarray
    until: float
    event: str | None = None
    given_up: bool = False


def solve(
    scene: Scene,
    times: np.ndarray,
    budget: float = np.inf,
    tell: Callable[[float], None] = lambda done: None,
) -> SmoothTrajectory:
    """The solution at `times` (ascending, from 0) by SciPy's DOP853 at a tolerance of 1e-13.

    Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, II.5. budget: seconds after
    which it is given up. tell: shown the part that is done; what it raises ends the solution.
    """
    from scipy.integrate import DOP853

    forces, particles = Forces(scene), scene.particles
    v = np.where(particles.fixed[:, None], 0.0, particles.velocity)
    y = np.stack([particles.position, v])
    shape = (len(times), *particles.position.shape)
    out = np.full((2, *shape), np.nan)
    out[:, times <= 0] = y[:, None]

    def ended(until: float, event: str | None = None, given_up: bool = False) -> SmoothTrajectory:
        return SmoothTrajectory(out[0], out[1], until, event, given_up)

    end = float(times[-1])
    event = forces.event(0.0, *y)
    if event or end <= 0:
        return ended(0.0, event)
    begin = time.perf_counter()
    solver = DOP853(
        forces.slope,
        0.0,
        y.ravel(),
        end,
        max_step=float(np.diff(times).max()),  # what is between frames could go unseen
        rtol=TOLERANCE,
        atol=_absolute(scene, end),
    )
    until = 0.0
    while solver.status == "running":
        solver.step()
        if solver.status == "failed" or not np.isfinite(solver.y).all():
            return ended(until, given_up=True)
        event = _event_in_step(solver, forces, shape[1:])
        if event:
            return ended(until, event)
        _keep_states(solver, times, out)
        until = solver.t
        tell(until / end)
        if time.perf_counter() - begin > budget:
            return ended(until, given_up=True)
    return ended(until)


def _absolute(scene: Scene, end: float) -> np.ndarray:
    """The absolute tolerance of y = (x, v), flat: alike in every unit of length and time.

    Of x a tenth of what the relative one is of the farthest coordinate; of v what adds up to that.
    """
    x = scene.particles.position
    length = float(np.abs(x).max()) or float(np.linalg.norm(scene.world.size))
    of_x = np.full(x.size, 0.1 * TOLERANCE * length)
    return np.concatenate([of_x, of_x / end])


def _keep_states(solver: DOP853, times: np.ndarray, out: np.ndarray) -> None:
    """Note the states at the times within the last step in `out`, (2, times, n, dim)."""
    inside = (times > solver.t_old) & (times <= solver.t)
    if inside.any():
        at = solver.dense_output()(times[inside]).T.reshape(-1, 2, *out.shape[2:])
        out[:, inside] = at.swapaxes(0, 1)
    if solver.t == times[-1]:
        out[:, -1] = solver.y.reshape(2, *out.shape[2:])


def _event_in_step(solver: DOP853, forces: Forces, shape: tuple[int, ...]) -> str | None:
    """Find what happens within the last step: so often that no particle passes another."""
    x, v = solver.y.reshape(2, *shape)
    moments = 1
    if forces.scene.world.collisions:
        reach = forces.scene.particles.radius.min(initial=np.inf)
        fastest = np.linalg.norm(v, axis=1).max(initial=0.0)
        moved = fastest * (solver.t - solver.t_old)
        moments = int(np.clip(np.ceil(4.0 * moved / max(reach, 1e-300)), 1, MOST_MOMENTS))
    if moments > 1:
        within = solver.dense_output()
        for t in np.linspace(solver.t_old, solver.t, moments, endpoint=False)[1:]:
            event = forces.event(t, *within(t).reshape(2, *shape))
            if event:
                return event
    return forces.event(solver.t, x, v)
