"""Extreme cases, as data: a scene, its steps, and what is asked of every method on it."""

import math
from dataclasses import replace

import extreme_contacts
import numpy as np
from extreme_contacts import ONE_BY_ONE
from extreme_runs import (
    FRAME,
    Ask,
    Case,
    Steps,
    energy_gain,
    exactly,
    many,
    mode_after,
    of_implicit,
    of_limit,
    resolved,
)

from taichi_cloth import runtime
from taichi_cloth.kernels.forces.blow import REACH, STRENGTH
from taichi_cloth.scene import cloth
from taichi_cloth.scene.model import Particles, Scene, Springs, World

LARGE = (1000.0, 1000.0, 1000.0)
GRAVITY = (0.0, 9.8, 0.0)
WEIGHTLESS = (0.0, 0.0, 0.0)

# --- what is asked ---------------------------------------------------------------------------

NONLINEAR = 0.1  # part of the energy that steps may be off where springs turn, or jump through 0
JUMP = 0.2  # where all forces turn round in the first step


def energy(depth=0.0, slack=0.0, stiff=False):
    """depth: how far potential energy may fall below the start's; slack: relative; stiff: with
    what a solver's tolerance leaves beside far stiffer modes."""

    def measure(run):
        start = run.energy(run.x0, run.v0) + depth
        gain = energy_gain(run.module, run.steps.dt, run.omega, run.done)
        most = start * gain * (1 + slack + run.walk + 100 * run.solver)
        noise = run.noise
        if stiff and run.claims.implicit and run.claims.symplectic:  # the others damp it
            noise += run.solver_noise(start)
        return run.energy() + depth, (math.sqrt(most) + math.sqrt(run.mass / 2) * noise) ** 2

    more = f" and {100 * slack:g}%" if slack else ""
    return Ask("energy within the claims" + more, measure)


def _momentum(run):
    m, t = run.scene.particles.mass, run.sim.time
    fall = run.mass * t * np.asarray(run.scene.world.gravity)
    before, now = (m[:, None] * run.v0).sum(0), (m[:, None] * run.v).sum(0)
    energy = max(run.energy(run.x0, run.v0), run.energy())
    scale = math.sqrt(2 * run.mass * energy) + np.abs(fall).sum()
    missed = 0.01 * run.sim.work().unconverged
    off = np.abs(now - before - fall).max()
    return off / scale if scale > 0 else off, 10 * run.walk + 100 * run.solver + missed


MOMENTUM = Ask(
    "momentum",
    _momentum,
    {"vbd": (1.0, ONE_BY_ONE)},
)


def _falls(run):
    t, h = run.sim.time, run.steps.dt
    g = np.asarray(run.scene.world.gravity)
    p, free = run.scene.particles, run.free
    where = run.x0 + run.v0 * t + 0.5 * g * t * t
    first_order = 0.5 * np.abs(g).max() * h * t if run.claims.order == 1 else 0.0
    off = np.abs(run.x - where)[free].max() if len(p) else 0.0
    scale = np.abs(where).max()
    return off, 1.001 * first_order + run.rounding + 100 * run.epsilon * scale


FALLS = Ask("free fall", _falls)


def _unmoved(run):
    return np.abs(run.x - run.x0).max(initial=0.0) + np.abs(run.v).max(initial=0.0), 0.0


UNMOVED = Ask("no particle moves by a single bit", _unmoved)


def _together(run):
    return np.ptp(run.x, axis=0).max(), 0.0


TOGETHER = Ask("particles that coincide and move alike stay together, to the bit", _together)


def _centre(run):
    m = run.scene.particles.mass
    off = np.abs((m[:, None] * (run.x - run.x0)).sum(0)).max() / m.sum()
    scale = np.abs(run.x0).max() + math.sqrt(2 * run.energy(run.x0, run.v0) / run.mass)
    return off, scale * (run.walk + 100 * run.solver) + run.rounding


CENTRE = Ask("the centre of mass stays, to rounding", _centre)


def no_more_than(words, of, bound):
    """of(run) at most bound(run) or a number."""
    return Ask(words, lambda run: (of(run), bound(run) if callable(bound) else bound))


def _converged(run):
    return run.sim.work().unconverged, 0


CONVERGED = Ask("every step's solution converges", _converged)


# --- scenes ----------------------------------------------------------------------------------


def scene(x, between=(), *, v=None, k=1.0, rest=None, damping=0.0, gravity=WEIGHTLESS, **of):
    """A 3-D scene; of: mass, fixed, viscous."""
    x = np.array(x, np.float64).reshape(-1, 3)
    springs = Springs.none()
    if len(between):
        springs = Springs.build(between, x, stiffness=k, rest_length=rest, damping=damping)
    particles = Particles.build(x, v, radius=0.01, **of) if len(x) else Particles.none(3)
    world = World(size=LARGE, gravity=gravity, dt=FRAME, mouse="blow")
    return Scene("extreme", world, particles, springs)


def oscillator(rest=1.0):
    """One mass on a spring to a fixed particle, pulled by 0.05 along x; omega is 1."""
    x = [[1, 1, 0], [1.05 + rest, 1, 0]]
    return scene(x, [[0, 1]], k=1.0, rest=rest, fixed=[True, False])


def linear_oscillator():
    """With a spring of no length, which is linear however far it swings."""
    return oscillator(rest=0.0)


def pulled(run, x=None):
    """How far the mass of an oscillator is from its rest."""
    x = run.x if x is None else x
    return x[1, 0] - x[0, 0] - run.scene.springs.rest_length[0]


def line(k, n=8, spacing=0.25, m=1.0, noise=1e-3):
    """Masses in a line between two fixed ones, with random velocities along it: a linear system.

    k: stiffness of each of the n + 1 springs.
    """
    x = np.zeros((n + 2, 3))
    x[:, 0] = 1 + spacing * np.arange(n + 2)
    x[:, 1] = 1
    v = np.zeros_like(x)
    v[1:-1, 0] = noise * np.random.default_rng(1).standard_normal(n)
    between = np.column_stack([np.arange(n + 1), np.arange(1, n + 2)])
    fixed = [True, *[False] * n, True]
    return scene(x, between, v=v, k=k, rest=spacing, mass=m, fixed=fixed)


def hanging(n, k, m, gravity=GRAVITY, at_rest=False, damping=0.0):
    """A vertical chain of n springs below a fixed particle; m: of each mass. Its statics are
    linear: each spring carries what hangs below it."""
    m = np.concatenate([[1.0], np.broadcast_to(m, n)])
    x = np.ones((n + 1, 3)) * [1, 1, 0]
    x[:, 1] = 1 + 0.25 * np.arange(n + 1)
    between = np.column_stack([np.arange(n), np.arange(1, n + 1)])
    made = scene(
        x,
        between,
        k=k,
        rest=0.25,
        mass=m,
        gravity=gravity,
        damping=damping,
        fixed=[True, *[False] * n],
    )
    if at_rest:
        made = replace(made, particles=replace(made.particles, position=statics(made)))
    return made


def statics(chain):
    """Positions of a chain of `hanging` at rest."""
    m, s = chain.particles.mass[1:], chain.springs
    carried = np.cumsum(m[::-1])[::-1] * chain.world.gravity[1]
    x = chain.particles.position.copy()
    x[1:, 1] = x[0, 1] + np.cumsum(s.rest_length + carried / s.stiffness)
    return x


def net(n=5, spacing=0.125, k=100.0, m=0.1, links=("structural", "shear"), **of):
    """A square cloth of n x n particles across x and z; its springs at rest. of: as in `scene`."""
    origin = [2.0, 2.0, 0.0]
    particles, springs = cloth.grid(
        origin, n, n, spacing, links=links, down=(0.0, 0.0, 1.0), across=(1.0, 0.0, 0.0)
    )
    x = particles.position
    return scene(x, springs.between, k=k, rest=springs.rest_length, mass=m, **of)


def placed(made, x, v=None):
    """The scene with its particles elsewhere, springs as they are."""
    v = made.particles.velocity if v is None else v
    return replace(made, particles=replace(made.particles, position=x, velocity=v))


def moved(change, at=(2.0, 2.0, 0.0), **of):
    """A net whose positions are change(x - centre) + at."""

    def build():
        made = net(**of)
        centre = made.particles.position.mean(0)
        return placed(made, at + change(made.particles.position - centre))

    return build


def random_box():
    made = net()
    side = 2 * np.ptp(made.particles.position[:, 0])
    x = np.random.default_rng(2).uniform(0, side, made.particles.position.shape)
    return placed(made, x + [2, 2, -side / 2])


def noisy(amplitude, seed=3):
    return lambda x: x + amplitude * np.random.default_rng(seed).standard_normal(x.shape)


def at_one_point(made, where=(2.0, 2.0, 0.0)):
    return placed(made, np.tile(np.array(where), (len(made.particles), 1)))


def contact_scene(x, v=None, between=(), *, gravity=(0.0, 0.0), size=(10.0, 10.0), **of):
    """A 2-D scene with four walls, collisions and springs that may break."""
    x = np.array(x, np.float64).reshape(-1, 2)
    spring = {k: of.pop(k) for k in ("k", "rest", "break_force", "damping") if k in of}
    springs = Springs.none()
    if len(between):
        springs = Springs.build(
            between,
            x,
            stiffness=spring.get("k", 1.0),
            rest_length=spring.get("rest"),
            break_force=spring.get("break_force"),
            damping=spring.get("damping"),
        )
    world = World(
        size=size,
        gravity=gravity,
        dt=FRAME,
        walls=("left", "right", "top", "bottom"),
        collisions=True,
    )
    of = {"radius": 0.1, **of}
    return Scene("contact", world, Particles.build(x, v, **of), springs)


# What the simulation of each kind has room for, and all the features of its cases.
def _most_springs():
    made = net(n=7, damping=0.1, viscous=np.linspace(0.01, 0.02, 49))
    k = 100.0 + np.arange(len(made.springs))
    return replace(made, springs=replace(made.springs, stiffness=k))


def _most_contact():
    x = 1 + np.stack(np.meshgrid(np.arange(8.0), np.arange(8.0)), axis=-1).reshape(-1, 2)
    between = np.column_stack([np.arange(63), np.arange(1, 64)])
    return contact_scene(
        x,
        between=between,
        k=1.0 + np.arange(63.0),
        break_force=1e3,
        radius=np.linspace(0.1, 0.2, 64),
    )


KINDS = {"springs": _most_springs, "contact": _most_contact} | extreme_contacts.KINDS


# --- cases: the stability limit --------------------------------------------------------------


def _amplitude(run):
    """|x| of the oscillator, and the largest that the discrete map ever makes of the start."""
    gain = math.sqrt(energy_gain(run.module, run.steps.dt, 1.0, run.done))
    return abs(pulled(run)), abs(pulled(run, run.x0)) * gain * (1 + run.walk)


def _modes(run):
    """The mode that takes most of what the discrete map ever makes of its start, and rounding."""
    n, h = len(run.x) - 2, run.steps.dt
    k = run.scene.springs.stiffness[0]
    w2, modes = np.linalg.eigh(k * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)))
    # Rounding of positions changes velocities at every step, by either sign.
    noise = 2 * math.sqrt(run.done) * h * k * run.epsilon * np.abs(run.x).max()
    said = []
    for w, mode in zip(np.sqrt(w2), modes.T, strict=True):
        gain = math.sqrt(energy_gain(run.module, h, w, run.done))
        most = gain * (abs(mode @ run.v0[1:-1, 0]) + noise)  # at the start all is velocity
        said.append((w * abs(mode @ (run.x - run.x0)[1:-1, 0]), most * (1 + run.walk)))
    return max(said, key=lambda pair: pair[0] / pair[1])


AMPLITUDE = Ask("the amplitude is at most what the method's discrete map makes of it", _amplitude)
MODES = Ask("every mode is at most what the method's discrete map makes of it", _modes)


def _has_failed(run):
    return 1.0, 0.0


MUST_FAIL = Ask("it fails, by name, in the frame in which it leaves its bounds", _has_failed)


def _growth(run):
    """Energy of the oscillator against (1 + h^2 w^2)^n, of methods unstable at every step."""
    exact = (1 + (run.steps.dt * 1.0) ** 2) ** run.done
    ratio = run.energy() / run.energy(run.x0, run.v0)
    return abs(ratio / exact - 1), 1e-9 + run.walk + 4 * run.noise / 0.05


def unit_line():
    made = line(np.ones(9), spacing=1.0, noise=0.02)
    return replace(made, springs=replace(made.springs, rest_length=np.zeros(9)))


LIMIT = [
    Case("limit_0.995", linear_oscillator, of_limit(0.995, 100_000), (AMPLITUDE,)),
    Case("limit_1.005", linear_oscillator, of_limit(1.005, 100_000), (MUST_FAIL,), "must"),
    Case("limit_0.995_line", unit_line, of_limit(0.995, 100_000), (MODES,)),
    Case("limit_1.005_line", unit_line, of_limit(1.005, 100_000), (MUST_FAIL,), "must"),
    Case(
        "no_limit",
        linear_oscillator,
        lambda module, made: Steps(0.1, 100, 100) if module.claims.stability_limit == 0 else None,
        (Ask("energy grows by (1 + dt^2 omega^2) a step, no more and no less", _growth),),
    ),
]


# --- cases: long implicit steps --------------------------------------------------------------


def hung_net():
    made = net(n=7, k=1000.0, gravity=GRAVITY)
    fixed = np.zeros(49, bool)
    fixed[[0, 6]] = True
    return replace(made, particles=replace(made.particles, fixed=fixed))


TURNING = "second order is not monotone: energy of springs that turn may rise in a long step"


SWEEPS = (
    "10 sweeps carry a pull 10 springs far at most, and hardly at all past unequal masses or in a "
    "long step: springs seem softer; use more --substeps or --iterations (Macklin et al., 2019)"
)


def sweeps_miss(**factors):
    """How many times the bound methods with sweeps take: three times what was measured."""
    return {method: (factor, SWEEPS) for method, factor in factors.items()}


def midpoint_gains(factor):
    """How many times the bound implicit midpoint takes: three times what was measured."""
    why = (
        "conserves the energy of linear springs only: long steps of turning ones feed on it "
        "(Simo, Tarnow, ZAMP 43, 1992)"
    )
    return {"implicit_midpoint": (factor, why)}


# What the net can fall: as far as its diagonal is long, and as it stretches under all its weight.
HUNG_DEPTH = 4.9 * 9.8 * (0.75 * math.sqrt(2) + 7 * 4.9 * 9.8 / 1000)


def _statics(run):
    off = np.abs(run.x - statics(run.scene)).max()
    # From the start it decays by a factor of at least 1/(1 + dt^2 w^2) a step, w the slowest.
    return off / np.ptp(run.x0[:, 1]), 1e-6 + 1e3 * run.epsilon


def _settled(run):
    if run.claims.symplectic or run.sim.frame < run.steps.frames:
        return 0.0, 1.0
    return _statics(run)


IMPLICIT = [
    Case(
        f"implicit_{dt}s",
        hung_net,
        of_implicit(dt, 60),
        (energy(HUNG_DEPTH),),
        errors={**midpoint_gains(2000), **sweeps_miss(xpbd=soft, vbd=softer)},
    )
    for dt, soft, softer in ((0.1, 5, 13), (0.5, 500, 12e3), (1.0, 8e3, 2e5))
] + [
    Case(
        "implicit_1s_statics",
        lambda: hanging(8, 100.0, 0.1),
        of_implicit(1.0, 200),
        (
            energy(depth=0.1 * 9.8 * 8 * 3.0),
            Ask(
                "methods that damp end at the statics, to 1e-6 of the length",
                _settled,
                {"xpbd": (45.0, SWEEPS), "vbd": (45.0, SWEEPS)},
            ),
        ),
        errors=sweeps_miss(xpbd=1200, vbd=700),
    ),
    Case(
        "implicit_1000s",
        hung_net,
        of_implicit(1000.0, 20),
        (energy(HUNG_DEPTH),),
        fails="may",
        errors={
            **midpoint_gains(2000),
            **sweeps_miss(vbd=8),
            "tr_bdf2": (3.0, TURNING),
        },
    ),
]


def tr_bdf2_factor(z):
    """What a step of TR-BDF2 makes of y' = mu y, where z = dt mu (Hosea, Shampine, 1996)."""
    part = 2 - math.sqrt(2)
    left = 1 - part / 2 * z
    first = (1 + part / 2 * z) / left
    return (first - (1 - part) ** 2) / (part * (2 - part)) / left


def swinging(hertz):
    """The oscillator with another stiffness: omega is 2 pi hertz."""

    def build():
        made = linear_oscillator()
        k = np.array([(2 * math.pi * hertz) ** 2])
        return replace(made, springs=replace(made.springs, stiffness=k))

    return build


def _damped(run):
    """What is left of the energy, against what the method makes of it on paper."""
    y = run.omega * run.steps.dt
    left = 1 / (1 + y * y)  # backward Euler
    if run.claims.symplectic:
        left = 1.0
    elif run.claims.order == 2:
        left = abs(tr_bdf2_factor(1j * y)) ** 2
    ratio = run.energy() / run.energy(run.x0, run.v0)
    noise = run.done * run.solver + run.walk + 4 * run.noise / (0.05 * run.omega)
    return abs(ratio / left**run.done - 1), 1e-9 + 4 * noise


IMPLICIT += [
    Case(
        f"damping_at_{hertz}_Hz",
        swinging(hertz),
        of_implicit(1 / 60, frames),
        (Ask("each step damps by what theory says: backward Euler by 1 + dt^2 omega^2", _damped),),
    )
    for hertz, frames in ((1, 60), (5, 20))
]


# --- cases: ratios ---------------------------------------------------------------------------


def stiff_and_soft(soft, stiff):
    return line(np.where(np.arange(9) % 2, stiff, soft), noise=1.0)


HEAVY_SAG = 0.3


def heavy_below(ratio):
    """5 light masses above a heavy one that stretches its 6 springs by 0.3 m in all."""
    k = ratio * 9.8 * 6 / HEAVY_SAG
    return hanging(6, k, [1, 1, 1, 1, 1, ratio])


def _sag(run):
    """How far the heavy mass has come below the start, and twice its static sag."""
    most = np.ptp(statics(run.scene)[-1] - run.x0[-1])
    sag = run.x[-1, 1] - run.x0[-1, 1]
    swing = math.sqrt(energy_gain(run.module, run.steps.dt, run.omega, run.done))
    return sag, 2.1 * most * swing * (1 + run.walk)


def _hangs(run):
    """It comes down at all: the static sag over the lowest place so far."""
    most = np.ptp(statics(run.scene)[-1] - run.x0[-1])
    run.kept["low"] = max(run.kept.get("low", 0.0), run.x[-1, 1] - run.x0[-1, 1])
    if run.sim.frame < run.steps.frames:
        return 0.0, 1.0
    return most / run.kept["low"], 1.1


HEAVY = (
    Ask("the heavy mass sags at most 2.1 times its static sag", _sag),
    Ask("and comes down to its static sag", _hangs),
)

RATIOS = [
    Case(
        f"stiffness_ratio_1e{power}",
        lambda power=power: stiff_and_soft(10.0 ** (8 - power), 1e8),
        resolved(0.3),
        (energy(stiff=True),),
        errors=sweeps_miss(vbd=factor),
    )
    for power, factor in ((6, 120), (8, 4))
] + [
    Case(
        "mass_ratio_1e3",
        lambda: heavy_below(1e3),
        resolved(0.8),
        HEAVY,
        errors=sweeps_miss(xpbd=13),
    ),
    Case(
        "mass_ratio_1e5",
        lambda: heavy_below(1e5),
        resolved(0.8),
        HEAVY,
        errors=sweeps_miss(xpbd=24),
    ),
]


def rates_apart():
    """Two oscillators that have nothing to do with each other: omega 1 and 1e6."""
    x = [[1, 1, 0], [2.05, 1, 0], [1, 2, 0], [2.05, 2, 0]]
    return scene(x, [[0, 1], [2, 3]], k=[1.0, 1e12], rest=1.0, fixed=[True, False, True, False])


def _slow(run):
    """The slow one against x0 cos t; a step's error of first order is omega^2 dt t/2 at most."""
    t, h = run.sim.time, run.steps.dt
    order = 1.0 * h * t if run.claims.order == 1 else h * h * t
    off = abs(pulled(run) - 0.05 * math.cos(t))
    return off, 0.05 * order * 1.01 + 1e-9 + run.rounding + 10 * run.solver


RATIOS.append(
    Case(
        "rates_1e6_apart",
        rates_apart,
        resolved(0.1, frame=0.01, frames=10),
        (energy(stiff=True), Ask("the slow part follows x0 cos t to the method's order", _slow)),
    )
)


# --- cases: degenerate and violent starts ----------------------------------------------------

PAIR = [[2.0, 2.0, 0.0], [2.0, 2.0, 0.0]]
FREE = (energy(slack=NONLINEAR), MOMENTUM)


def one_moved_onto_another():
    made = net()
    x = made.particles.position.copy()
    x[12] = x[13]
    return placed(made, x)


def fast_corner():
    made = net()
    v = np.zeros((25, 3))
    v[0] = [-1e4 / math.sqrt(2), 0, -1e4 / math.sqrt(2)]
    return placed(made, made.particles.position, v)


def without_length():
    made = net()
    return replace(made, springs=replace(made.springs, rest_length=np.zeros(len(made.springs))))


def flat_line():
    """A net whose rows all lie upon each other; springs between rows have length 0."""
    made = net(links=("structural",))
    x = made.particles.position.copy()
    x[:, 2] = 0.0
    return placed(made, x)


def mirrored():
    """A net between two fixed sides, what is between them the other way round."""
    made = net()
    fixed = np.isin(np.arange(25) % 5, (0, 4))
    x = made.particles.position.copy()
    x[~fixed, 0] = x[0, 0] + x[4, 0] - x[~fixed, 0]
    made = placed(made, x)
    return replace(made, particles=replace(made.particles, fixed=fixed))


def pinned_point():
    made = at_one_point(net(gravity=GRAVITY))
    fixed = np.zeros(25, bool)
    fixed[[0, 4]] = True
    return replace(made, particles=replace(made.particles, fixed=fixed))


def spinning():
    """A dumbbell stretched by its spin, omega 0.9 of where it would fly apart."""
    k, m, rest = 100.0, 0.1, 0.2
    spin = 0.9 * math.sqrt(2 * k / m)
    length = rest / (1 - spin**2 * m / (2 * k))
    x = np.array([[2 - length / 2, 2, 0], [2 + length / 2, 2, 0]])
    v = np.array([[0, -spin * length / 2, 0], [0, spin * length / 2, 0]])
    return scene(x, [[0, 1]], v=v, k=k, rest=rest, mass=m)


def _spin(run):
    """Angular momentum: kept by symplectic methods, which keep quadratic invariants."""

    def of(x, v):
        return np.cross(x - x.mean(0), v - v.mean(0)).sum(0)[2]

    ratio = of(run.x, run.v) / of(run.x0, run.v0)
    relative = run.walk + 2 * run.rounding / np.ptp(run.x0[:, 0]) + 100 * run.solver
    if run.claims.symplectic:
        return abs(ratio - 1), relative
    gain = energy_gain(run.module, run.steps.dt, run.omega, run.done)
    return abs(ratio), gain * (1 + relative)


RUN = resolved(1.0, frame=0.1, frames=30)
STARTS = [
    Case(
        "zero_rest_length",
        without_length,
        RUN,
        (energy(), MOMENTUM, CENTRE),
    ),
    Case(
        "coincident_pair",
        lambda: scene(PAIR, [[0, 1]], k=100.0, rest=0.1, gravity=GRAVITY),
        RUN,
        (TOGETHER, FALLS),
    ),
    Case(
        "coincident_pair_apart",
        lambda: scene(PAIR, [[0, 1]], v=[[1e-3, 0, 0], [-1e-3, 0, 0]], k=100.0, rest=0.1),
        RUN,
        FREE,
        errors=midpoint_gains(16),
    ),
    Case(
        "nearly_coincident",
        lambda: scene([[0, 0, 0], [1e-12, 0, 0]], [[0, 1]], k=100.0, rest=0.1),
        RUN,
        FREE,
        errors=midpoint_gains(16),
    ),
    Case(
        "coincident_in_a_net",
        one_moved_onto_another,
        RUN,
        FREE,
        errors={**midpoint_gains(600), "tr_bdf2": (3.0, TURNING)},
    ),
    Case(
        "all_at_one_point",
        lambda: at_one_point(net(gravity=GRAVITY)),
        RUN,
        (energy(2.5 * 9.8 * 4.9 * 9.3, NONLINEAR), MOMENTUM),
        errors=midpoint_gains(4),
    ),
    Case(
        "all_at_one_pinned_point",
        pinned_point,
        RUN,
        (energy(depth=2.5 * 9.8 * 2.0, slack=NONLINEAR),),
        errors=midpoint_gains(25),
    ),
    Case("random_box", random_box, RUN, FREE, errors=midpoint_gains(3)),
    Case("flattened", flat_line, RUN, (UNMOVED,)),
    Case(
        "flattened_disturbed",
        moved(lambda x: noisy(1e-6)(x * [1, 1, 0])),
        RUN,
        FREE,
        errors=midpoint_gains(75),
    ),
    Case("mirrored", mirrored, RUN, (energy(slack=NONLINEAR),), errors=midpoint_gains(40)),
    Case("compressed_50_percent", moved(lambda x: 0.5 * x), RUN, FREE, errors=midpoint_gains(130)),
    Case(
        "compressed_to_1e-9",
        moved(lambda x: 1e-9 * x),
        RUN,
        (energy(slack=JUMP), MOMENTUM),
        errors=midpoint_gains(40),
    ),
    Case(
        "stretched_10_times",
        moved(lambda x: 10.0 * x, at=(4.0, 4.0, 0.0)),
        RUN,
        FREE,
        errors=midpoint_gains(3),
    ),
    Case(
        "stretched_1000_times", moved(lambda x: 1000.0 * x, at=(500.0, 500.0, 0.0), n=3), RUN, FREE
    ),
    Case("corner_at_1e4_m_per_s", fast_corner, RUN, FREE),
    Case(
        "spinning",
        spinning,
        RUN,
        (Ask("angular momentum is kept by symplectic methods, never raised by others", _spin),),
    ),
]


# --- cases: long runs ------------------------------------------------------------------------


def _drift(run):
    # A solver takes for rest what moves with less than its tolerance, of gravity here.
    slowest = 1000.0 * (2 * math.sin(math.pi / 14)) ** 2  # omega^2 of three masses, k/m = 1000
    still = 4 * run.solver * 9.8 / slowest
    return np.abs(run.x - run.x0).max(), 0.75 * run.walk / 10 + still


LONG = [
    Case(
        "1e6_steps_at_rest",
        lambda: hanging(3, 100.0, 0.1, at_rest=True),
        many(1_000_000, 0.2),
        (
            Ask(
                "a chain at rest stays there: 10 eps sqrt(n) of its length, a solver's tolerance",
                _drift,
            ),
        ),
    ),
    Case(
        "1e6_steps_in_motion",
        oscillator,
        many(1_000_000, 0.2),
        (energy(slack=1e-3),),
    ),
    Case(
        "1e5_steps_unloaded",
        lambda: net(n=3, links=("structural",)),
        many(100_000, 0.2),
        (UNMOVED,),
    ),
]


# --- cases: offsets and small steps ----------------------------------------------------------


def far_chain(offset):
    """A damped chain that hangs at rest, far from the origin."""

    def build():
        made = hanging(4, 100.0, 0.1, at_rest=True, damping=1.0)
        world = replace(made.world, size=(4e6, 4e6, 4e6))
        made = replace(made, world=world)
        return placed(made, made.particles.position + [offset, offset, 0])

    return build


def _stays_there(run):
    ulp = run.epsilon * np.abs(run.x0).max()
    unfinished = 1e-8 if "iterations" in run.claims.settings else 0.0
    return np.abs(run.x - run.x0).max(), 4 * len(run.x) * ulp + unfinished


OFFSETS = [
    Case(
        f"offset_1e{power}",
        far_chain(10.0**power),
        resolved(2.0, frames=120),
        (
            Ask(
                "a chain at rest stays there, to 4 last places a particle (sweeps: 1e-8 m)",
                _stays_there,
            ),
        ),
    )
    for power in range(1, 7)
]


def _gathers_speed(run):
    fall = 9.8 * run.sim.time
    return abs(run.v[0, 1] - fall), fall * (1e-6 + run.walk + run.done * run.epsilon)


def far_drop():
    made = scene([[2, 2, 0]], gravity=GRAVITY)
    made = replace(made, world=replace(made.world, size=(4e6, 4e6, 4e6)))
    return placed(made, made.particles.position + [1e6, 1e6, 0])


OFFSETS += [
    Case(
        "falling_at_1e6_m",
        far_drop,
        exactly(FRAME, 256, 60),
        (Ask("speed is g t, however coarse positions are", _gathers_speed),),
    )
]
OFFSETS += [
    Case(
        f"substeps_{substeps}",
        lambda: scene([[1.5, 1.5, 0]], gravity=GRAVITY),
        exactly(FRAME, substeps, 60),
        (FALLS,),
    )
    for substeps in (256, 1000)
]


# --- cases: counts ---------------------------------------------------------------------------


def strip(columns, rows):
    """A 1 x N or N x 1 cloth, held at its first particle, swinging down from a horizontal line."""
    n = columns * rows
    particles, springs = cloth.grid(
        [2.0, 2.0, 0.0],
        columns,
        rows,
        0.125,
        down=(0.0, 0.0, 1.0),
        pinned=[(0, 0)],
        links=("structural", "shear", "bend"),
    )
    made = scene(particles.position, springs.between, k=100.0, rest=springs.rest_length)
    made = replace(made, world=replace(made.world, gravity=GRAVITY))
    m = replace(made.particles, mass=np.full(n, 0.1), fixed=particles.fixed)
    return replace(made, particles=m)


STRIP_DEPTH = 0.1 * 8 * 9.8 * 3.0
COUNTS = [
    Case("one_particle", lambda: scene([[2, 2, 0]], gravity=GRAVITY), RUN, (FALLS,)),
    Case("no_particles", lambda: scene([], gravity=GRAVITY), RUN, (UNMOVED,)),
    Case(
        "all_pinned",
        lambda: placed(m := net(gravity=GRAVITY, fixed=True), m.particles.position * 1.5),
        RUN,
        (UNMOVED,),
    ),
    Case("grid_1x1", lambda: strip(1, 1), RUN, (UNMOVED,)),
    Case(
        "grid_1x8",
        lambda: strip(1, 8),
        RUN,
        (energy(STRIP_DEPTH, NONLINEAR),),
        errors=midpoint_gains(12),
    ),
    Case(
        "grid_8x1",
        lambda: strip(8, 1),
        RUN,
        (energy(STRIP_DEPTH, NONLINEAR),),
        errors=midpoint_gains(12),
    ),
    Case("grid_2x1", lambda: strip(2, 1), RUN, (energy(0.1 * 9.8, NONLINEAR),)),
]


# --- cases: numbers --------------------------------------------------------------------------


def tiny():
    """An oscillator whose amplitude is below the smallest normal number."""
    amplitude = float(np.finfo(_real()).tiny) / 16
    x = [[0, 0, 0], [amplitude, 0, 0]]
    return scene(x, [[0, 1]], k=1.0, rest=0.0, fixed=[True, False])


def _real():
    return np.float64 if runtime.current_device().precision == "f64" else np.float32


def _tiny(run):
    gain = math.sqrt(energy_gain(run.module, run.steps.dt, 1.0, run.done))
    return np.abs(run.x).max(), run.scene.particles.position[1, 0] * gain * 1.01


def fast(speed):
    return lambda: scene([[2, 2, 0], [3, 2, 0]], [[0, 1]], v=[[0, 0, 0], [speed(), 0, 0]])


def huge():
    return float(np.finfo(_real()).max) * 1e-3


def too_stiff():
    return scene([[1, 1, 0], [3, 1, 0]], [[0, 1]], k=huge(), rest=1.0, fixed=[True, False])


def _no_more_energy(run):
    return run.energy(), 1.1 * run.energy(run.x0, run.v0)


def _still(run):
    """Hardly time to move: x0 + v0 t, t = 1e-28."""
    return np.abs(run.x - run.x0).max() + np.abs(run.v - run.v0).max(), 1e-20


def in_units_of(unit):
    made = random_box()
    p, s, w = made.particles, made.springs, made.world
    size = tuple(length * unit for length in w.size)
    return replace(
        made,
        world=replace(w, size=size),
        particles=replace(p, position=p.position * unit, velocity=p.velocity * unit),
        springs=replace(s, rest_length=s.rest_length * unit),
    )


def _near_limit(run):
    return np.abs(run.v).max(), run.sim.speed_limit


NUMBERS = [
    Case(
        "denormals",
        tiny,
        exactly(0.1, 10, 100),
        (Ask("the amplitude is at most what the discrete map makes of it, or 0", _tiny),),
        refused=("f32",),
    ),
    Case("overflowing_speed", fast(huge), exactly(FRAME, 4, 10), (MUST_FAIL,), "must"),
    Case(
        "overflowing_stiffness",
        too_stiff,
        lambda module, made: Steps(FRAME, 4, 10),
        (Ask("energy at most the start's, and 10%", _no_more_energy),),
        "may",
    ),
    Case(
        "above_the_speed_limit",
        fast(lambda: 1.01 * 100 * 1000 * math.sqrt(3) / FRAME),
        exactly(FRAME, 4, 1),
        (MUST_FAIL,),
        "must",
    ),
    Case(
        "below_the_speed_limit",
        fast(lambda: 0.99 * 100 * 1000 * math.sqrt(3) / FRAME),
        exactly(FRAME, 4, 1),
        (MOMENTUM, energy(slack=NONLINEAR)),
    ),
    Case(
        "steps_of_1e-30",
        lambda: placed(m := random_box(), m.particles.position),
        exactly(1e-29, 10, 10),
        (Ask("nothing has moved, nothing is lost: to 1e-20", _still),),
    ),
    Case("units_of_2^-20_m", lambda: in_units_of(2.0**-20), RUN, FREE),
    Case("units_of_2^20_m", lambda: in_units_of(2.0**20), RUN, FREE),
]


# --- cases: driven ---------------------------------------------------------------------------


def _blow_far(sim, frame):
    if frame == 1:
        centre = sim.positions().mean(0)
        sim.blow_ray(centre, [0.0, 1.0, 0.0], [1000.0, 0.0, 0.0])


def _blown(run):
    """Momentum: strength*(reach - distance)*1000 for each particle, for one frame."""
    p = run.scene.particles
    from_line = (run.x0 - run.x0.mean(0)) * [1, 0, 1]
    distance = np.linalg.norm(from_line, axis=1)
    push = STRENGTH * (REACH - distance).sum() * 1000.0 * run.steps.frame
    expected = push if run.sim.frame > 1 else 0.0
    off = np.abs((p.mass[:, None] * run.v).sum(0) - [expected, 0, 0]).max()
    return off / push, run.walk + 1e-6 + 100 * run.solver


def _vary(sim, frame):
    sim.set_step(sim.scene.world.dt * (0.01 + 0.99 * np.random.default_rng(frame).random()))


def _followed(run):
    """The oscillator against the discrete map with the same steps."""
    if math.isinf(run.claims.stability_limit):
        return run.energy(), run.energy(run.x0, run.v0) * (1 + run.walk + 1e-3)
    state = run.kept.setdefault("state", [0, np.array([0.05, 0.0])])
    for frame in range(state[0], run.sim.frame):
        h = run.scene.world.dt * (0.01 + 0.99 * np.random.default_rng(frame).random())
        state[1] = mode_after(run.module, h, 1.0, state[1])
    state[0] = run.sim.frame
    off = abs(pulled(run) - state[1][0])
    return off, 0.05 * run.walk + 4 * run.rounding


def varied():
    return oscillator().with_world(dt=0.5)


DRIVEN = [
    Case(
        "mouse_jumps_1e3",
        net,
        resolved(1.0, frame=0.1, frames=10),
        (
            Ask(
                "momentum is the pointer's force times the frame, in that frame alone",
                _blown,
                {"vbd": (0.01, ONE_BY_ONE)},
            ),
        ),
        drive=_blow_far,
    ),
    Case(
        "dt_changes_every_step",
        varied,
        lambda module, made: Steps(0.5, 1, 300 if module.claims.stability_limit > 0 else 50),
        (
            Ask(
                "it follows the discrete map with the same steps; implicit: energy falls", _followed
            ),
        ),
        drive=_vary,
    ),
]


# --- cases: damping --------------------------------------------------------------------------


def dragged():
    return scene([[2, 2, 0]], v=[[1.0, 0, 0]], mass=1e-3, viscous=1e3)


def _stops(run):
    """It comes to rest after v0/d, d = 1e6/s; a step may overshoot by what it does at once."""
    return abs(run.x[0, 0] - 2), 2 * (1e-6 + run.epsilon * 2) + run.steps.dt * 1e-3


def dashpots():
    """A dumbbell whose ends approach; its dashpot's rate is 1e5/s."""
    return scene([[2, 2, 0], [3, 2, 0]], [[0, 1]], v=[[1, 0, 0], [-1, 0, 0]], k=1.0, damping=5e4)


DAMPING = [
    Case(
        "drag_of_1e6_per_s",
        dragged,
        resolved(0.1, frame=0.01, frames=100),
        (
            no_more_than("speed never grows", lambda r: np.abs(r.v).max(), 1.0),
            Ask("it stops after twice v0/d at most, and a thousandth of v0 dt", _stops),
            CONVERGED,
        ),
    ),
    Case("dashpot_too_strong_for_the_step", dashpots, exactly(0.01, 1, 100), FREE, "may"),
    Case("dashpot_of_1e5_per_s", dashpots, resolved(0.1, frame=0.01, frames=100), FREE),
]


# --- cases: contacts and fracture ------------------------------------------------------------


def _above_floor(run):
    high = run.scene.world.size[1]
    reach = run.x[:, 1] + run.scene.particles.radius
    return (reach - high).max(), 2 * run.epsilon * high


def _inside(run):
    """What is beyond a wall is what a step at that speed may cross."""
    size = np.asarray(run.scene.world.size)
    radius = run.scene.particles.radius[:, None]
    beyond = np.maximum(run.x + radius - size, radius - run.x).max()
    speed = np.linalg.norm(run.v0, axis=1).max() + 9.8 * run.sim.time
    return beyond, speed * run.steps.dt


def _no_faster(run):
    speed = np.linalg.norm(run.v0, axis=1).max() + 9.8 * run.sim.time
    return np.linalg.norm(run.v, axis=1).max(), speed * (1 + run.walk)


FLOOR = Ask("no particle is below the floor, to 2 units in the last place", _above_floor)
WALLS = Ask("nothing is farther beyond a wall than it goes in a step", _inside)
SLOWER = Ask("no speed above v0 + g t", _no_faster)


def _collided(run):
    """Two balls, 1 kg at 1 m/s onto 1e5 kg at rest: Newton's law of restitution."""
    m1, m2 = run.scene.particles.mass
    if run.sim.frame < run.steps.frames:
        return 0.0, 1.0
    after = np.array([(m1 - m2) / (m1 + m2), 2 * m1 / (m1 + m2)])
    return np.abs(run.v[:, 0] - after).max(), 10 * run.epsilon


CROWD = (
    "all collisions of a step start from the same state: a ball that overlaps many others gets all "
    "of their impulses at once, each as large as if it were the only one"
)


def crowd():
    """40 balls that overlap each other many times over, and fly about."""
    random = np.random.default_rng(5)
    x = 5 + 0.3 * random.uniform(-1, 1, (40, 2))
    v = 0.1 * random.standard_normal((40, 2))
    return contact_scene(x + 495, v, restitution=0.7, size=(1000.0, 1000.0))


def torn():
    x = [[1 + 0.5 * i, 2.0] for i in range(10)]
    between = np.column_stack([np.arange(9), np.arange(1, 10)])
    return contact_scene(
        np.array(x) * [1.5, 1.0], None, between, k=100.0, rest=0.5, break_force=1e-30, radius=0.1
    )


def _all_gone(run):
    if run.sim.frame == 0:
        return 0.0, 0.0
    return run.sim.springs_alive().sum(), 0


def one_holds():
    """An unbreakable spring among breakable ones, all stretched 100 times."""
    x = [[1.0, 2.0], [2.0, 2.0], [3.0, 2.0], [4.0, 2.0]]
    return contact_scene(
        x, None, [[0, 1], [1, 2], [2, 3]], k=1.0, rest=0.01, break_force=[0.5, np.inf, 0.5]
    )


def _only_it(run):
    if run.sim.frame == 0:
        return 0.0, 0.0
    return float((run.sim.springs_alive() != [False, True, False]).sum()), 0


FALL = exactly(FRAME, 8, 120)
CONTACTS = [
    Case(
        "floor_at_1e4_m_per_s",
        lambda: contact_scene([[5.0, 5.0]], [[0.0, 1e4]], gravity=(0.0, 9.8), restitution=0.5),
        FALL,
        (FLOOR, WALLS, SLOWER),
        kind="contact",
    ),
    Case(
        "corner_at_1e4_m_per_s_of_walls",
        lambda: contact_scene([[9.0, 9.0]], [[1e4, 1e4]], restitution=1.0),
        FALL,
        (FLOOR, WALLS, SLOWER),
        kind="contact",
    ),
    Case(
        "resting_1e5_steps_on_the_floor",
        lambda: contact_scene([[5.0, 9.8]], gravity=(0.0, 9.8), restitution=0.0),
        exactly(FRAME, 100, 1000),
        (FLOOR, no_more_than("it rests", lambda r: np.abs(r.v[:, 1]).max(), 2 * 9.8 * 0.2)),
        kind="contact",
    ),
    Case(
        "coincident_balls",
        lambda: contact_scene([[5.0, 1.0]] * 20, gravity=(0.0, 9.8)),
        exactly(FRAME, 8, 30),
        (TOGETHER, FALLS),
        kind="contact",
    ),
    Case(
        "balls_of_mass_ratio_1e5",
        lambda: contact_scene([[4.0, 5.0], [5.0, 5.0]], [[1.0, 0.0], [0.0, 0.0]], mass=[1.0, 1e5]),
        exactly(FRAME, 8, 90),
        (Ask("speeds after the impact as momentum and restitution 1 have them", _collided),),
        kind="contact",
    ),
    Case(
        "overlapping_crowd",
        crowd,
        exactly(FRAME, 8, 60),
        (MOMENTUM, energy()),
        errors={"*": (3e5, CROWD)},
        kind="contact",
    ),
    Case(
        "all_springs_break_at_once",
        torn,
        exactly(FRAME, 8, 10),
        (Ask("all springs are gone after the first frame", _all_gone), WALLS),
        kind="contact",
    ),
    Case(
        "one_spring_holds",
        one_holds,
        exactly(FRAME, 8, 10),
        (Ask("the breakable ones are gone, the unbreakable one holds", _only_it),),
        kind="contact",
    ),
]

CASES = {
    case.name: case
    for case in [
        *LIMIT,
        *IMPLICIT,
        *RATIOS,
        *STARTS,
        *LONG,
        *OFFSETS,
        *COUNTS,
        *NUMBERS,
        *DRIVEN,
        *DAMPING,
        *CONTACTS,
        *extreme_contacts.CASES,
    ]
}
