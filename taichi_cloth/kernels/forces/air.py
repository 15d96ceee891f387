"""Air: quadratic drag and lift on each triangle of a surface, in wind that may come in gusts.

A triangle of area A and unit normal n, whose corners move relative to the air at the mean velocity
u, with its part u_n = (u.n) n along the normal and the rest u_t along the surface, gets the force

    f = - 1/2 density A [ drag |u_n| + lift |u_t|^2 / |u| ] u_n,

a pressure: air that glides along a thin sheet hardly pulls at it (Wejchert, Haumann, "Animation
aerodynamics", 1991; Ling, Damodaran, Gay, "Aerodynamic force models for animating cloth motion in
air flow", 1996). On a plate at the angle a to the stream it is 1/2 density A |u|^2 sin a times
(drag sin a + lift cos^2 a). So `drag` is that of a plate across the stream: a flat sheet of mass
sigma an area falls at sqrt(2 sigma g / (density drag)). `lift` is by how much the force across the
stream grows with a small angle, and what keeps a flag up. Still air only takes energy: f.u <= 0.
(A lift at a right angle to u, with a part along the surface, would drive a sheet that falls flat
sideways: stalled plates have no such thrust.)

The wind is the same everywhere: velocity (1 + gust g(t)), where g is a sum of sinusoids of
incommensurable periods around `period`, with phases by `seed`, and a root mean square of 1. It is a
function of time alone: replays and finer steps see the same.
"""

import functools
import math
from dataclasses import replace

import numpy as np
import taichi as ti

from taichi_cloth.kernels.forces.contract import (
    NUMBER,
    TRACTION,
    VECTOR,
    Absent,
    DeviceField,
    Key,
    Term,
    Variant,
)
from taichi_cloth.kernels.sine import sine_of_turn

# Frequencies of a gust's waves, times the period: square roots of primes over that of the third, of
# which no two have a common multiple.
WAVES = tuple(math.sqrt(prime / 5) for prime in (2, 3, 5, 7))
PEAK = math.sqrt(2 * len(WAVES))  # what the sum of all waves never exceeds
HEIGHT = math.sqrt(2 / len(WAVES))  # of each, for a root mean square of 1
LIGHT = 0.01  # part of its speed that a variant's air takes from a sheet that crosses its cell

AIR = Key(
    "air",
    "drag and lift of surfaces",
    "",
    table=(
        Key("density", "of the air", "mass / length^3", minimum=0.0),
        Key("drag", "coefficient of a plate across the stream", "1", minimum=0.0, default=1.0),
        Key("lift", "coefficient of the force across the stream", "1", minimum=0.0, default=0.0),
    ),
    in_space=True,
)
WIND = Key(
    "wind",
    "velocity of the air",
    "",
    table=(
        Key("velocity", "its mean", "length / time", vector=True),
        Key("gust", "root mean square of its relative change", "1", minimum=0.0, default=0.0),
        Key("period", "around which its gusts return", "time", minimum=1e-9, default=1.0),
        Key("seed", "of the gusts' phases", "", minimum=0.0, default=0.0, whole=True),
    ),
    needs="air",
    in_space=True,
)


def _of(world, key):
    """The values of a table of [world] with its defaults; all 0 where there is none."""
    absent = {part.name: 0.0 if part.default is None else part.default for part in key.table}
    return absent | dict(world.more.get(key.name, {}))


def _pressure(name):
    """Make a function of half the density of the air times a coefficient."""

    def value(world, particles):
        air = _of(world, AIR)
        return 0.5 * air["density"] * air[name]

    return value


def mean_wind(world):
    """The mean velocity of the air, (dim,)."""
    velocity = _of(world, WIND)["velocity"]
    return np.broadcast_to(np.asarray(velocity, np.float64), (world.dim,))


@functools.cache
def _phases(seed):
    """The phases of a gust's waves, in turns."""
    return tuple(np.random.default_rng(seed).random(len(WAVES)).tolist())


def gust(world, time):
    """The relative change of the wind at a time."""
    wind = _of(world, WIND)
    turns = np.array(WAVES) * (time / wind["period"]) + _phases(int(wind["seed"]))
    return wind["gust"] * HEIGHT * float(np.sin(2 * np.pi * turns).sum())


def strongest(world):
    """At most by how much the wind is stronger than its mean."""
    return 1.0 + PEAK * _of(world, WIND)["gust"]


def _rate(k):
    return lambda world, particles: WAVES[k] / _of(world, WIND)["period"]


def _phase(k):
    return lambda world, particles: _phases(int(_of(world, WIND)["seed"]))[k]


@ti.func
def prepare(spec: ti.template(), state: ti.template(), time):
    """Compute the wind at a time."""
    turns = ti.Vector.zero(state.real, ti.static(len(WAVES)))
    for k in ti.static(range(len(WAVES))):
        rate, phase = ti.static(_wave(state, k))
        turn = time * ti.cast(rate[None], state.wide) + ti.cast(phase[None], state.wide)
        turns[k] = ti.cast(turn - ti.floor(turn), state.real)
    waves = ti.cast(0.0, state.real)
    if ti.static(ti.cfg.arch == ti.cpu):
        for k in range(ti.static(len(WAVES))):  # the series is compiled once
            waves += sine_of_turn(state.real, turns[k])
    else:
        # Where a vector is read at a place known only at run time, loops of a kernel share Taichi's
        # constants, which Vulkan's do not find where there are several such loops, as with `rk4`.
        for k in ti.static(range(len(WAVES))):
            waves += sine_of_turn(state.real, turns[k])
    for axis in ti.static(range(3)):
        change = 1.0 + state.wind_gust[None] * ti.static(HEIGHT) * waves
        state.wind[axis] = state.wind_velocity[axis] * change


def _wave(state, k):
    """The fields of the rate and the phase of wave number k."""
    return getattr(state, f"gust_rate_{k}"), getattr(state, f"gust_phase_{k}")


@ti.func
def _relative(state: ti.template(), area, v):
    """Of a triangle: its size, its normal, and its velocity relative to the air."""
    size = ti.sqrt(area[0] * area[0] + area[1] * area[1] + area[2] * area[2])
    n = ti.select(size > 0.0, 1.0 / size, 0.0 * size) * area
    u = v
    for axis in ti.static(range(3)):
        u[axis] = v[axis] - state.wind[axis]
    return size, n, u


@ti.func
def law(spec: ti.template(), state: ti.template(), area, v):
    """The force of the air on a triangle."""
    size, n, u = _relative(state, area, v)
    along = u[0] * n[0] + u[1] * n[1] + u[2] * n[2]
    u_n = along * n
    u_t = u - u_n
    across2 = u_t[0] * u_t[0] + u_t[1] * u_t[1] + u_t[2] * u_t[2]
    speed = ti.sqrt(along * along + across2)
    inverse = ti.select(speed > 0.0, 1.0 / speed, 0.0 * speed)
    pressure = state.air_drag[None] * ti.max(along, -1.0 * along)
    lift = state.air_lift[None] * inverse
    return (-1.0 * size * (pressure + lift * across2)) * u_n


@ti.func
def gradient(spec: ti.template(), state: ti.template(), area, v):
    """The pressure, which is the law's force over -area, and its derivatives by v and by area."""
    size, n, u = _relative(state, area, v)
    inverse_size = ti.select(size > 0.0, 1.0 / size, 0.0 * size)
    along = u[0] * n[0] + u[1] * n[1] + u[2] * n[2]
    speed = ti.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    inverse = ti.select(speed > 0.0, 1.0 / speed, 0.0 * speed)
    part = ti.min(ti.max(along * inverse, -1.0), 1.0)  # cosine of the angle with the normal
    # It is (drag |along| + lift across2 / speed) along, a function of `along` and of the speed.
    drag, lift, cos2 = state.air_drag[None], state.air_lift[None], part * part
    against = ti.max(along, -1.0 * along)
    pressure = (drag * against + lift * (1.0 - cos2) * speed) * along
    by_along = 2.0 * drag * against + lift * (1.0 - 3.0 * cos2) * speed
    by_speed = lift * (1.0 + cos2) * along
    by_v = by_along * n + (by_speed * inverse) * u
    by_area = (by_along * inverse_size) * (u - along * n)
    return [pressure, by_v, by_area]


@ti.func
def damping(spec: ti.template(), state: ti.template(), area, v):
    """The derivative -df/dv along the normal, where the speed along the surface is kept."""
    size, n, u = _relative(state, area, v)
    along = u[0] * n[0] + u[1] * n[1] + u[2] * n[2]
    u_t = u - along * n
    across2 = u_t[0] * u_t[0] + u_t[1] * u_t[1] + u_t[2] * u_t[2]
    speed = ti.sqrt(along * along + across2)
    inverse = ti.select(speed > 0.0, 1.0 / speed, 0.0 * speed)
    part = across2 * inverse
    lift = state.air_lift[None] * part * part * inverse
    return size * (2.0 * state.air_drag[None] * ti.max(along, -1.0 * along) + lift)


def twin(area, v, time, world):
    """The law in NumPy."""
    air = _of(world, AIR)
    size = np.linalg.norm(area, axis=1, keepdims=True)
    n = area / np.where(size > 0, size, 1.0)
    u = v - mean_wind(world) * (1.0 + gust(world, time))
    along = (u * n).sum(axis=1, keepdims=True)
    u_t = u - along * n
    speed = np.linalg.norm(u, axis=1, keepdims=True)
    across2 = (u_t**2).sum(axis=1, keepdims=True)
    lift = air["lift"] * across2 / np.where(speed > 0, speed, 1.0)
    return -0.5 * air["density"] * size * (air["drag"] * np.abs(along) + lift) * along * n


def bound(corners, v, world):
    """Bounds on the law's derivatives however a triangle is turned, in the strongest wind.

    At the relative speed u of the triangle's corners drag has the derivative
    density A drag |u|, lift at most half of that. By the area vector both have at most 3 times the
    largest pressure, and that vector has half an edge as its derivative by a corner.
    """
    air = _of(world, AIR)
    a, b, c = (corners[:, k] for k in range(3))
    size = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    edge = np.max([np.linalg.norm(q - p, axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0)
    speed = np.linalg.norm(v, axis=1) + strongest(world) * np.linalg.norm(mean_wind(world))
    half = 0.5 * air["density"] * speed
    resistance = half * size * (2.0 * air["drag"] + air["lift"])
    stiffness = half * speed * 3.0 * (air["drag"] + air["lift"]) * edge / 2
    return stiffness, resistance


def steady(world):
    """A world whose wind is constantly at its strongest."""
    if "wind" not in world.more:
        return world
    strong = tuple((strongest(world) * mean_wind(world)).tolist())
    return replace(world, more={**world.more, "wind": {"velocity": strong}})


def present(scene):
    """True if the scene has air and surfaces in it."""
    return _of(scene.world, AIR)["density"] > 0 and len(scene.triangles) > 0


def variant(scene):
    """The scene without its air, or with thin air; None where it has no surfaces in space."""
    if scene.world.dim != 3 or len(scene.triangles) == 0:
        return None
    used, more = present(scene), dict(scene.world.more)
    if used:
        del more["air"]
        more.pop("wind", None)
    else:
        a, b, c = (scene.particles.position[corner] for corner in scene.triangles.T)
        size = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
        length = math.sqrt(size / len(scene.triangles)) or 1.0
        mass = float(scene.particles.mass[np.unique(scene.triangles)].sum())
        more["air"] = {"density": LIGHT * mass / (size * length or 1.0), "drag": 1.0, "lift": 0.5}
    about = f"on {len(scene.triangles)} triangles"
    return Variant("air", used, about, scene.with_world(more=more))


TERM = Term(
    adds=TRACTION,
    keys=(AIR, WIND),
    present=present,
    fields=(
        DeviceField("air_drag", NUMBER, _pressure("drag")),
        DeviceField("air_lift", NUMBER, _pressure("lift")),
        DeviceField("wind_velocity", VECTOR, lambda world, particles: mean_wind(world)),
        DeviceField("wind_gust", NUMBER, lambda world, particles: _of(world, WIND)["gust"]),
        *(DeviceField(f"gust_rate_{k}", NUMBER, _rate(k)) for k in range(len(WAVES))),
        *(DeviceField(f"gust_phase_{k}", NUMBER, _phase(k)) for k in range(len(WAVES))),
        DeviceField("wind", VECTOR),
    ),
    law=law,
    acts=Absent("it always acts"),
    after_step=Absent("it changes nothing"),
    stiffness=Absent("it has no potential: what it has of stiffness is no symmetric matrix"),
    damping=damping,
    gradient=gradient,
    across=Absent("it does not act along springs"),
    energy=Absent("it comes from outside: it has no potential"),
    twin=twin,
    bound=bound,
    variant=variant,
    timed=True,
    steady=steady,
    prepare=prepare,
)
