"""Extreme cases of contact, air and bending, as data: metres, kilograms, seconds; y points up."""

import math
from dataclasses import replace

import numpy as np
from extreme_runs import FRAME, Ask, Case, energy_gain, exactly, resolved

from taichi_cloth.scene import cloth
from taichi_cloth.scene.material import Material
from taichi_cloth.scene.model import Particles, Scene, SpringDefaults, Springs, World
from taichi_cloth.scene.obstacles import Obstacle

G = 9.81
SIZE = (1000.0, 1000.0, 1000.0)
AT = np.array([500.0, 500.0, 0.0])  # where things happen
RADIUS = 0.02

# --- scenes ----------------------------------------------------------------------------------


def ball(centre, radius, **of):
    return Obstacle.build("sphere", centre=centre, radius=radius, **of)


def block(centre, half, **of):
    return Obstacle.build("box", centre=centre, half=half, **of)


def plane(normal=(0.0, 1.0, 0.0), point=AT, **of):
    return Obstacle.build("plane", point=point, normal=normal, **of)


# One of each shape, of which one moves, far away: so that all cases of a kind share their kernels.
FAR_AWAY = (
    ball([-1e5, 0.0, 0.0], 1.0, velocity=[-1.0, 0.0, 0.0]),
    block([-1e5, 50.0, 0.0], [1.0, 1.0, 1.0]),
    plane(point=[0.0, -1e5, 0.0]),
)


def among(*obstacles, x, v=None, between=(), k=100.0, gravity=(0.0, -G, 0.0), size=SIZE, **of):
    """Particles among obstacles; of: radius, mass, restitution, fixed, viscous."""
    x = np.array(x, np.float64).reshape(-1, 3)
    springs = Springs.build(between, x, stiffness=k) if len(between) else Springs.none()
    particles = Particles.build(x, v, **{"radius": RADIUS, **of})
    world = World(size=size, gravity=gravity, dt=FRAME, up="y", mouse="blow")
    return Scene("among", world, particles, springs, obstacles=(*obstacles, *FAR_AWAY))


def net(centre, n=5, spacing=0.1, k=50.0, m=0.01, **of):
    """A square net of n x n particles across x and z, and what `among` takes besides."""
    origin = np.asarray(centre) - [(n - 1) / 2 * spacing, 0.0, (n - 1) / 2 * spacing]
    particles, springs = cloth.grid(
        origin, n, n, spacing, links=("structural", "shear"), across=(1.0, 0.0, 0.0),
        down=(0.0, 0.0, 1.0), spring_defaults=SpringDefaults(stiffness=k),
    )  # fmt: skip
    return {"x": particles.position, "between": springs.between, "k": k, "mass": m, **of}


def together(made, **world):
    """The scene with particles that rest on each other."""
    return made.with_world(collisions=True, contact="resting", **world)


def sheets(count, gap=0.0):
    """`count` sheets of 2 x 2 particles, one on the other, on a plane."""
    corners = 0.3 * np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1], [1, 0, 1]])
    x = [AT + corners + [0, RADIUS + (2 * RADIUS + gap) * k, 0] for k in range(count)]
    pairs = np.array([[0, 1], [0, 2], [1, 3], [2, 3]])
    between = np.concatenate([pairs + 4 * k for k in range(count)])
    return together(
        among(plane(), x=x, between=between, k=50.0, mass=0.01, restitution=0.0), friction=0.3
    )


def blown(speed, gust=0.0, period=1.0, density=1.2, n=4, spacing=0.1, shift=None, pins=True):
    """A sheet that hangs from its upper row in wind across it."""
    particles, springs = cloth.grid(
        AT, n, n, spacing, links=("structural", "shear"), across=(1.0, 0.0, 0.0),
        down=(0.0, -1.0, 0.0), pinned=[(0, 0), (n - 1, 0)] * pins,
        spring_defaults=SpringDefaults(stiffness=200.0, damping=0.01),
    )  # fmt: skip
    particles = replace(particles, mass=np.full(n * n, 0.01))
    if shift is not None:
        particles = replace(particles, position=AT + shift(particles.position - AT))
    more = {
        "air": {"density": density, "drag": 1.0, "lift": 0.6},
        "wind": {"velocity": (0.0, 0.0, speed), "gust": gust, "period": period, "seed": 1},
    }
    world = World(size=SIZE, gravity=(0.0, -G, 0.0), dt=FRAME, up="y", mouse="blow", more=more)
    triangles = cloth.grid_triangles(n, n)
    return Scene("blown", world, particles, springs, triangles=triangles)


def bent(rigidity, n=6, spacing=0.05):
    """A net that resists bending, wavy by a hundredth of its spacing, free and weightless.

    It is near the origin: the many short steps of unstable methods would move f32 by less than it
    can hold elsewhere.
    """
    particles, springs = cloth.grid(
        np.array([1.0, 1.0, 0.0]), n, n, spacing, links=("structural", "shear"),
        across=(1.0, 0.0, 0.0), down=(0.0, 0.0, 1.0),
        spring_defaults=SpringDefaults(stiffness=50.0),
    )  # fmt: skip
    wave = 0.01 * spacing * np.sin(np.arange(n * n))
    x = particles.position + np.outer(wave, [0.0, 1.0, 0.0])
    particles = replace(particles, position=x, mass=np.full(n * n, 0.01))
    world = World(size=SIZE, gravity=(0.0, 0.0, 0.0), dt=FRAME, up="y", mouse="blow")
    stencils = cloth.grid_stencils(n, n, spacing, rigidity)
    return Scene("bent", world, particles, springs, stencils=stencils)


def thick(thickness, n=5, spacing=0.1, shift=lambda x: x):
    """A free and weightless cloth with a thickness; shift: of its positions about its corner."""
    particles, springs = cloth.grid(
        AT, n, n, spacing, links=("structural", "shear"), across=(1.0, 0.0, 0.0),
        down=(0.0, 0.0, 1.0),
        material=Material(density=0.2, thickness=thickness, stretch=20.0, shear=5.0),
    )  # fmt: skip
    particles = replace(particles, position=AT + shift(particles.position - AT))
    world = World(size=SIZE, gravity=(0.0, 0.0, 0.0), dt=FRAME, up="y", mouse="blow")
    return Scene("thick", world, particles, springs, triangles=cloth.grid_triangles(n, n))


# What the simulation of each kind has room for, and all the features of its cases.
def _most_solids():
    one = ball([-1e5, 99.0, 0.0], 1.0)
    n = 9
    made = among(one, one, one, **net(AT, n=n, viscous=np.linspace(0.01, 0.02, n * n)))
    return _varied(replace(made, springs=_varied_springs(made.springs)))


def _most_piles():
    made = sheets(52)
    return _varied(replace(made, springs=_varied_springs(made.springs)))


def _varied(made):
    """Particles whose numbers are not all alike."""
    n = len(made.particles)
    some = np.linspace(0.5, 1.0, n)
    particles = replace(made.particles, radius=RADIUS * some, restitution=0.5 * some)
    return replace(made, particles=particles)


def _varied_springs(springs):
    return replace(springs, stiffness=50.0 + np.linspace(0.0, 1.0, len(springs)))


KINDS = {
    "solids": _most_solids,
    "piles": _most_piles,
    "air": lambda: blown(1.0, 0.1),
    "bending": lambda: bent(1e-4),
    "thick": lambda: thick(0.05, n=6),
}

# --- what is asked ---------------------------------------------------------------------------

HEAVY = (
    "pairs move apart in proportion to inverse masses, so one that is 1e6 times as light gives way "
    "until it cannot, and iterations end before what it stands on has carried both"
)
BY_TURNS = (
    "sweeps take the air's forces of the sweep before, which do not settle where wind goes ten "
    "spacings in a step"
)
STALLED = (
    "steps so short that f32 moves nothing in them: forces stay, and speeds grow until it does"
)
ONE_BY_ONE = (
    "moves one particle at a time, so what two do to each other differs until sweeps converge"
)


def scale_of(run):
    """The largest number that positions are computed from."""
    places = [np.abs(run.x).max(initial=0.0)]
    for solid in run.sim.storage.solids[: -len(FAR_AWAY)]:
        places += [np.abs(solid.placed.centre).max(), *np.abs(solid.placed.sizes)]
    return max(p for p in places if p < 1e9)


def no_deeper(depth=0.0):
    """Within rounding of the numbers that distances are differences of, and `depth`."""
    words = "no particle is in an obstacle" + (f" by more than {depth:g} m" if depth else "")
    return Ask(words, lambda run: (run.sim.penetration(), depth + 64 * run.epsilon * scale_of(run)))


def no_faster(words, speed):
    def measure(run):
        return np.linalg.norm(run.v, axis=1).max(), speed * (1 + run.walk) + run.noise

    return Ask(f"no speed above {words}", measure)


def _unmoved(run):
    return np.abs(run.x - run.x0).max(initial=0.0) + np.abs(run.v).max(initial=0.0), 0.0


UNMOVED = Ask("no particle moves by a single bit", _unmoved)


def _stays(run):
    off = np.abs(run.x - run.x0).max()
    return off, run.rounding + run.noise * (1 + run.sim.time) + 64 * run.epsilon * AT[0]


STAYS = Ask("no particle moves, but by rounding", _stays)


def _falls(run):
    t, h = run.sim.time, run.steps.dt
    where = run.x0 + run.v0 * t + 0.5 * t * t * np.asarray(run.scene.world.gravity)
    off = np.abs(run.x - where)[run.free].max()
    first_order = 0.5 * G * h * t if run.claims.order == 1 else 0.0
    return off, 1.001 * first_order + run.rounding + 100 * run.epsilon * np.abs(where).max()


FALLS = Ask("free fall", _falls)


def slides(degrees, friction):
    """s = (g sin - mu g cos) t^2/2 down a slope, to what a first-order method is off."""
    rate = G * (math.sin(math.radians(degrees)) - friction * math.cos(math.radians(degrees)))

    def measure(run):
        t, h = run.sim.time, run.steps.dt
        off = abs(np.linalg.norm(run.x[0] - run.x0[0]) - 0.5 * rate * t * t)
        return off, 0.5 * rate * h * t * 1.001 + run.rounding + 1e-9

    return Ask(f"it goes {rate:.3g} t^2/2 down the slope", measure)


def _no_gain(run):
    """Kinetic energy and that of height and springs, beside the start's."""
    start = run.energy(run.x0, run.v0)
    scale = abs(start) + run.mass * G * 1.0
    gain = energy_gain(run.module, run.steps.dt, run.omega, run.done)
    fall = 0.0
    if run.claims.stability_limit == 0:  # v that falls behind g raises m (g dt)^2 / 2 a step
        fall = 0.5 * run.done * run.mass * (G * run.steps.dt) ** 2
    bound = 1.001 * fall + scale * (1e-6 + run.walk) + run.mass * run.noise**2
    return run.energy() - start * gain, bound


NO_GAIN = Ask("contacts add no energy", _no_gain)


def _overlap(bound):
    def measure(run):
        return run.sim.penetration() / (2 * RADIUS), bound

    return Ask(f"no overlap of more than {100 * bound:g} % of a diameter", measure)


def _momentum(run):
    m = run.scene.particles.mass[:, None]
    scale = (m * (np.abs(run.v) + np.abs(run.v0))).sum() + run.mass * run.noise
    missed = 0.01 * run.sim.work().unconverged
    off = np.abs((m * (run.v - run.v0)).sum(0)).max()
    return off, scale * (10 * run.walk + 100 * run.solver + missed) + run.mass * run.noise


MOMENTUM = Ask("momentum stays", _momentum, {"vbd": (1.0, ONE_BY_ONE)})


def _bending_energy(run):
    """All energy, of bending too, beside the start's."""
    run.kept.setdefault("start", run.sim.energy().total if run.done == 0 else None)
    now = run.sim.energy().total
    start = run.kept["start"]
    if start is None:
        from taichi_cloth.simulation import diagnostics

        everything = np.ones(len(run.scene.springs), bool)
        start = diagnostics.energy(run.scene, run.x0, run.v0, everything).total
        run.kept["start"] = start
    gain = energy_gain(run.module, run.steps.dt, run.omega, run.done)
    noise = run.mass * run.noise**2
    return now, start * gain * (1.1 + run.walk + 100 * run.solver) + noise


BENDING = Ask("energy, that of bending too, within the claims and 10%", _bending_energy)


def _finite(run):
    return 0.0 if np.isfinite(run.x).all() and np.isfinite(run.v).all() else 1.0, 0.5


FINITE = Ask("the state is finite", _finite)


def _on_its_side(run):
    return (AT[1] - run.x[:, 1]).max(), 0.0


# --- cases -----------------------------------------------------------------------------------

STEPS = exactly(FRAME, 4, 60)
HARDLY = resolved(0.5, frames=30)
BRIEFLY = resolved(0.1, frame=1e-3, frames=100)


def on_slope(degrees, friction, **of):
    slope = math.radians(degrees)
    normal = np.array([math.sin(slope), math.cos(slope), 0.0])
    return among(plane(normal, friction=friction), x=AT + RADIUS * normal, **of)


def spun():
    ring = [
        AT + [0.0, 0.5 + RADIUS, 0.0] + 0.05 * np.array([math.cos(a), 0.0, math.sin(a)])
        for a in np.linspace(0, 2 * math.pi, 8, endpoint=False)
    ]
    return among(ball(AT, 0.5, friction=0.5, spin=[0.0, 0.0, 1e4]), x=ring)


def struck():
    """A free net that a ball hits at 100 m/s."""
    above = ball(AT + [0.0, 2.0, 0.0], 0.3, velocity=[0.0, -100.0, 0.0], friction=0.3)
    return among(above, gravity=(0.0, 0.0, 0.0), **net(AT, n=9))


def shot(speed, thick):
    return among(
        block(AT - [0.0, thick, 0.0], [5.0, thick, 5.0]),
        x=[AT + [0.1 * k, 1.0 + 0.05 * k, 0.0] for k in range(8)],
        v=np.tile([0.0, -speed, 0.0], (8, 1)), restitution=0.0,
    )  # fmt: skip


SOLIDS = [
    Case(
        "started_inside_an_obstacle",
        lambda: among(ball(AT, 1.0), **net(AT + [0.0, 0.1, 0.0])),
        HARDLY,
        (no_deeper(), FINITE),
        "may",
        kind="solids",
    ),
    Case(
        "started_at_the_centre_of_a_ball",
        lambda: among(ball(AT, 0.5), x=AT),
        STEPS,
        (no_deeper(), no_faster("that of the fall", G * 1.0)),
        kind="solids",
    ),
    Case(
        "ball_at_100_m_per_s_through_a_cloth",
        struck,
        BRIEFLY,
        (no_deeper(), FINITE),
        "may",
        kind="solids",
    ),
    Case(
        "friction_0",
        lambda: on_slope(45.0, 0.0),
        STEPS,
        (slides(45.0, 0.0), no_deeper()),
        kind="solids",
    ),
    Case("friction_1e3", lambda: on_slope(89.0, 1e3), STEPS, (UNMOVED,), kind="solids"),
    Case(
        "restitution_1_at_rest",
        lambda: among(plane(restitution=1.0), x=AT + [0.0, RADIUS, 0.0], restitution=1.0),
        STEPS,
        (UNMOVED,),
        kind="solids",
    ),
    Case(
        "restitution_1_from_1_m",
        lambda: among(plane(restitution=1.0), x=AT + [0.0, 1.0 + RADIUS, 0.0]),
        exactly(FRAME, 4, 600),
        (NO_GAIN, no_deeper()),
        kind="solids",
    ),
    Case(
        "spin_of_1e4_degrees_per_s",
        spun,
        exactly(FRAME, 16, 60),
        (no_deeper(), no_faster("that of the surface", math.radians(1e4) * (0.5 + RADIUS) + G)),
        kind="solids",
    ),
    Case(
        "obstacle_at_1e6_m",
        lambda: among(
            block([1e6, 0.0, 0.0], [1.0, 1.0, 1.0]),
            x=[1e6, 1.0 + 1.0, 0.0],
            radius=0.5,
            size=(4e6, 4e6, 4e6),
        ),  # fmt: skip
        STEPS,
        (no_deeper(), no_faster("that of the fall", 1.1 * math.sqrt(2 * G * 1.0))),
        kind="solids",
    ),
    Case(
        "ball_of_radius_1e6_m",
        lambda: among(ball([500.0, 500.0 - 1e6, 0.0], 1e6), x=AT + [0.0, 0.5 + RADIUS, 0.0]),
        STEPS,
        (no_deeper(), no_faster("that of the fall", 1.1 * math.sqrt(2 * G * 0.6))),
        kind="solids",
    ),
    Case(
        "ball_of_radius_1e-6_m",
        lambda: among(ball(AT, 1e-6), x=AT + [1e-4, 0.5, 0.0]),
        exactly(FRAME, 64, 60),
        (no_deeper(), no_faster("that of the fall", 1.05 * G)),
        kind="solids",
    ),
    Case(
        "obstacle_smaller_than_a_cell",
        lambda: among(ball(AT, 0.02, friction=0.3), **net(AT + [0.05, 0.1, 0.05], n=6)),
        HARDLY,
        (no_deeper(), FINITE),
        kind="solids",
    ),
    Case(
        "wedge_between_two_obstacles",
        lambda: among(
            plane((0.17, 0.985, 0.0)),
            plane((-0.17, 0.985, 0.0)),
            x=AT + [0.0, 0.5, 0.0],
            v=[[0.0, -5.0, 0.0]],
        ),  # fmt: skip
        STEPS,
        (no_deeper(1e-4), no_faster("that of the fall", 5.0 + G)),
        kind="solids",
    ),
    Case(
        "crushed_between_two_balls",
        lambda: among(
            ball(AT + [0.0, 0.5, 0.0], 0.4, velocity=[0.0, -1.0, 0.0]),
            ball(AT - [0.0, 0.5, 0.0], 0.4, velocity=[0.0, 1.0, 0.0]),
            x=AT + [0.001, 0.0, 0.0],
            gravity=(0.0, 0.0, 0.0),
        ),  # fmt: skip
        exactly(FRAME, 4, 30),
        (FINITE,),
        "may",
        kind="solids",
    ),
    Case(
        "at_1e4_m_per_s_onto_a_plate_of_1_mm",
        lambda: shot(1e4, 5e-4),
        exactly(FRAME, 4, 30),
        (Ask("all stay on their side", _on_its_side), no_deeper()),
        "may",
        kind="solids",
    ),
]

PILES = [
    Case(
        "stack_of_50_sheets",
        lambda: sheets(50),
        exactly(FRAME, 8, 30),
        (_overlap(0.5), NO_GAIN),
        "may",
        checks=5,
        kind="piles",
    ),
    Case(
        "everything_at_one_point_resting",
        lambda: together(among(x=np.tile(AT, (40, 1)), gravity=(0.0, 0.0, 0.0))),
        exactly(FRAME, 8, 30),
        (MOMENTUM, NO_GAIN),
        checks=5,
        kind="piles",
    ),
    Case(
        "a_heavy_ball_on_a_light_one",
        lambda: together(
            among(
                plane(),
                x=[AT + [0, RADIUS, 0], AT + [0, 3 * RADIUS, 0]],
                mass=[1.0, 1e6],
                restitution=0.0,
            )  # fmt: skip
        ),
        exactly(FRAME, 8, 30),
        (_overlap(0.5), NO_GAIN),
        checks=5,
        errors={"*": (3.0, HEAVY)},
        kind="piles",
    ),
    Case(
        "radii_1e3_apart",
        lambda: together(
            among(plane(), x=[AT + [0, 5.0, 0], AT + [0.001, 10.1, 0]], radius=[5.0, 5e-3])
        ),
        exactly(FRAME, 8, 60),
        (Ask("no overlap of more than 1e-3", lambda run: (run.sim.penetration(), 1e-3)), NO_GAIN),
        checks=5,
        kind="piles",
    ),
]

AIR = [
    Case(
        "wind_of_1e3_m_per_s",
        lambda: blown(1e3),
        BRIEFLY,
        (no_faster("ten times the wind's", 1e4), FINITE),
        "may",
        kind="air",
        errors={"vbd": (10.0, BY_TURNS)},
    ),
    Case(
        "gusts_of_1e-6_s",
        lambda: blown(5.0, gust=0.5, period=1e-6),
        BRIEFLY,
        (no_faster("three times the gust's", 3 * 5.0 * (1 + 0.5 * 2.9)), FINITE),
        kind="air",
    ),
    Case(
        "air_as_dense_as_lead",
        lambda: blown(1.0, density=1e4),
        BRIEFLY,
        (no_faster("ten times the wind's", 10.0), FINITE),
        "may",
        kind="air",
    ),
    Case(
        "degenerate_triangles",
        lambda: replace(
            blown(10.0, shift=lambda x: x * [1.0, 0.0, 0.0], pins=False),
            springs=Springs.none(),
        ),
        exactly(FRAME, 4, 30),
        (FALLS,),
        kind="air",
    ),
    Case(
        "sheet_of_1e-4_m",
        lambda: blown(1.0, spacing=3e-5),
        resolved(0.01, frame=1e-3, frames=10),
        (no_faster("ten times the wind's", 10.0), FINITE),
        "may",
        kind="air",
    ),
    Case(
        "sheet_of_100_m",
        lambda: blown(1.0, spacing=30.0),
        BRIEFLY,
        (no_faster("ten times the wind's", 10.0), FINITE),
        "may",
        kind="air",
    ),
]

BENT = [
    Case(
        "bending_rigidity_1e3",
        lambda: bent(1e3),
        resolved(0.01, frame=1e-4, frames=100, most=100_000),
        (BENDING, MOMENTUM),
        kind="bending",
    ),
    Case(
        "bending_rigidity_1e-12",
        lambda: bent(1e-12),
        HARDLY,
        (BENDING, MOMENTUM),
        kind="bending",
        errors={"explicit_euler": (460.0, STALLED)},
    ),
]

THICK = [
    Case("thickness_larger_than_spacing", lambda: thick(0.45), HARDLY, (STAYS,), kind="thick"),
    Case("thickness_of_1e-6_m", lambda: thick(1e-6), HARDLY, (STAYS,), kind="thick"),
    Case(
        "everything_at_one_point_with_thickness",
        lambda: thick(0.05, shift=lambda x: 0.0 * x),
        HARDLY,
        (MOMENTUM, FINITE),
        "may",
        kind="thick",
    ),
    Case(
        "folded_flat_onto_itself",
        lambda: thick(0.05, shift=lambda x: np.abs(x - [0.2, 0.0, 0.0])),
        HARDLY,
        (MOMENTUM, NO_GAIN),
        "may",
        kind="thick",
    ),
]

CASES = [*SOLIDS, *PILES, *AIR, *BENT, *THICK]
