"""What an extreme case is made of: its steps, what is asked of it, and the run that is looked at.

A case asks for numbers with a bound each (`Ask`), which come from physics: a closed form, an
invariant, or what the method's claims say. A run may end with a SimulationFailure only where the
case says so, and the last good state must then be kept. Units are metres, kilograms and seconds;
y points down.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from taichi_cloth.limits.bounds import gershgorin, step_within
from taichi_cloth.limits.eigenmodes import stable_step
from taichi_cloth.limits.network import Network
from taichi_cloth.scene.model import Scene
from taichi_cloth.simulation.simulation import Simulation

FRAME = 1 / 60

# --- steps -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Steps:
    """dt of a frame, substeps, frames."""

    frame: float
    substeps: int
    frames: int

    @property
    def dt(self):
        return self.frame / self.substeps

    @property
    def count(self):
        return self.substeps * self.frames


MOST_STEPS = 1_000_000


def resolved(seconds=1.0, frame=FRAME, frames=60, part=0.1, most=MOST_STEPS):
    """Methods with a stability limit: `part` of it for `seconds`. Those without: one step a frame.

    A method that is unstable at every step takes steps with which energy cannot double; None where
    that would be more than `most` of them.
    """

    def choose(module, scene):
        limit = module.claims.stability_limit
        if math.isinf(limit):
            return Steps(frame, 1, frames)
        bounds = gershgorin(Network.from_scene(scene))
        h = part * step_within(module, bounds)
        if limit == 0:
            h = min(_inverse(seconds * bounds.omega2 / math.log(2)), _inverse(bounds.damping))
        substeps = max(1, math.ceil(frame / h * (1 - 1e-9)))
        steps = Steps(frame, substeps, math.ceil(seconds / frame * (1 - 1e-9)))
        return steps if steps.count <= most else None

    return choose


def _inverse(a):
    return 1 / a if a > 0 else math.inf


def exactly(frame, substeps, frames):
    """The same steps for every method."""
    return lambda module, scene: Steps(frame, substeps, frames)


def of_limit(part, count):
    """`count` steps of `part` of the limit, for methods that have one."""

    def choose(module, scene):
        if not 0 < module.claims.stability_limit < math.inf:
            return None
        h = part * stable_step(module, Network.from_scene(scene)).dt
        return Steps(10 * h, 10, count // 10)

    return choose


def of_implicit(frame, frames):
    """One step a frame, for implicit methods."""
    return lambda module, scene: Steps(frame, 1, frames) if module.claims.implicit else None


def many(count, product):
    """`count` steps of dt*omega = `product`; of methods unstable at every step, far smaller ones,
    with which energy cannot double."""

    def choose(module, scene):
        omega = math.sqrt(gershgorin(Network.from_scene(scene)).omega2)
        limit = module.claims.stability_limit
        h = (product if limit > 0 else math.sqrt(math.log(2) / count)) / omega
        return Steps(1000 * h, 1000, count // 1000)

    return choose


# --- what a method may do --------------------------------------------------------------------


def energy_gain(module, h, omega, steps):
    """By how much a method may raise the energy of modes up to `omega`, by its claims.

    For a linear system: of a mode, the largest norm of a power of its step as a matrix on
    (omega*x, v), squared. Methods without a limit are taken by their word not to raise it.
    """
    if math.isinf(module.claims.stability_limit) or omega == 0:
        return 1.0
    rates = omega * np.linspace(0.02, 1, 50)
    if module.stability_function:
        growth = np.abs(module.stability_function(1j * h * rates))
        return float(np.maximum(growth, 1.0).max() ** (2 * steps))
    gains = []
    for w in rates:
        values, vectors = np.linalg.eig(_scaled_map(module, h, w))
        assert np.abs(values).max() < 1 + 1e-9
        gains.append(np.linalg.cond(vectors) ** 2)
    return float(max(gains))


def _scaled_map(module, h, w):
    """A step of x'' = -w^2 x as a matrix on (w*x, v)."""
    step = module.amplification(h, w * w, 0.0)
    if len(step) == 3:  # the acceleration that it keeps is that of x
        step = step[:2] @ np.array([[1, 0], [0, 1], [-w * w, 0]])
    return np.diag([w, 1]) @ step @ np.diag([1 / w, 1])


def mode_after(module, h, w, start):
    """(w*x, v) of a mode after a step h, of methods with a limit."""
    if module.stability_function:
        z = (start[0] + 1j * start[1]) * module.stability_function(-1j * h * w)
        return np.array([z.real, z.imag])
    return _scaled_map(module, h, w) @ start


# --- a run -----------------------------------------------------------------------------------


@dataclass
class Run:
    """A case as it is run: what bounds may look at. x, v: as they are now, (n, dim); x0, v0: as
    they were at the start."""

    module: object
    sim: Simulation
    scene: Scene
    steps: Steps
    x: np.ndarray = None
    v: np.ndarray = None

    def __post_init__(self):
        self.kept = {}  # what an ask remembers from check to check
        self.look()
        self.x0, self.v0 = self.x, self.v  # as the device's precision has them

    def look(self):
        self.x, self.v = self.sim.positions(), self.sim.velocities()

    @property
    def claims(self):
        return self.module.claims

    @cached_property
    def epsilon(self):
        return float(np.finfo(self.sim.storage.real).eps)

    @property
    def done(self):
        """Steps so far."""
        return self.sim.steps

    @property
    def rounding(self):
        """What rounding may have added to a position: half a unit in the last place a step."""
        return 0.5 * self.done * self.epsilon * np.abs(self.x).max(initial=0.0)

    @property
    def walk(self):
        """Relative: roundings of many steps, of either sign."""
        return 100 * math.sqrt(self.done + 1) * self.epsilon

    @property
    def noise(self):
        """Velocity that rounding of positions gives: stiff springs take it for a stretch, at every
        step anew, by either sign."""
        stretch = 2 * self.epsilon * np.abs(self.x).max(initial=0.0)
        return self.omega**2 * self.steps.dt * stretch * math.sqrt(self.done)

    @property
    def solver(self):
        """Relative error that a solver's tolerance leaves in a step."""
        return self.sim.solver.get("tolerance", 0.0)

    def solver_noise(self, energy):
        """Velocity that is left of a step's residuals: a part of the largest acceleration, which in
        a step that is long for the stiffest mode is far beyond that of the others."""
        speed = math.sqrt(2 * max(energy, 0.0) / self.scene.particles.mass[self.free].min())
        rate = self.omega * max(1.0, self.omega * self.steps.dt)
        scale = rate * speed + np.abs(self.scene.world.gravity).max()
        return self.solver * self.steps.dt * scale * math.sqrt(self.done)

    @cached_property
    def omega(self):
        return math.sqrt(gershgorin(Network.from_scene(self.scene)).omega2)

    @cached_property
    def free(self):
        return ~self.scene.particles.fixed

    @cached_property
    def mass(self):
        return self.scene.particles.mass[self.free].sum()

    def energy(self, x=None, v=None):
        """Total energy; of gravity relative to the start."""
        x, v = (self.x, self.v) if x is None else (x, v)
        p, s = self.scene.particles, self.scene.springs
        a, b = s.between[self.sim.springs_alive()].T
        holds = s.select(self.sim.springs_alive())
        stretch = np.linalg.norm(x[b] - x[a], axis=1) - holds.rest_length
        fallen = (x - self.x0) @ np.asarray(self.scene.world.gravity)
        free, m = self.free, p.mass
        kinetic = 0.5 * (m[free, None] * v[free] ** 2).sum()
        return kinetic + 0.5 * (holds.stiffness * stretch**2).sum() - (m * fallen)[free].sum()


@dataclass(frozen=True)
class Ask:
    """What is asked of a run, in words, and measure(run) -> (value, bound) at every check.

    errors: methods that are wrong here: the largest value instead, and why.
    """

    words: str
    measure: Callable
    errors: dict[str, tuple[float, str]] = field(default_factory=dict)


@dataclass(frozen=True)
class Case:
    """name; scene() -> Scene; steps(module, scene) -> Steps, None where it does not apply.

    asks: what must hold at every check. fails: whether a run may end with a SimulationFailure:
    "never", "may", "must". drive(run, frame): before every frame. kind: which simulation runs it.
    refused: the precisions that cannot hold the scene, in which it must not start.
    checks: how often the run is looked at. errors: methods that are wrong here: how many times the
    bound they may take instead, measured, and why.
    """

    name: str
    scene: Callable
    steps: Callable
    asks: tuple[Ask, ...]
    fails: str = "never"
    refused: tuple[str, ...] = ()
    drive: Callable | None = None
    kind: str = "springs"
    checks: int = 20
    errors: dict[str, tuple[float, str]] = field(default_factory=dict)
