"""Limits of a precision: scenes that it cannot hold are refused; of those not resolved a
run is warned.

The processor takes numbers below the smallest normal one for zero, so a product that falls below it
vanishes in silence. What is too large becomes infinite, which the watchdog names; lengths whose
squares would are refused here, because that is known before a run.
"""

from __future__ import annotations

from operator import attrgetter

import numpy as np

from taichi_cloth.errors import InputError
from taichi_cloth.limits.rounding import stall
from taichi_cloth.scene.model import Scene

# A step whose change of a coordinate is below so many halves of the coordinate's last bit is not
# resolved: rounding takes, or adds, more than a quarter of it.
HALF_BITS = 4.0
# Sums of coordinates, and squares of speeds, above it count as infinite in every precision
# (`watchdog.is_finite`).
WATCHED = float(np.finfo(np.float32).max)
# What lengths and the forces of springs depend on.
_LENGTHS = list(map(attrgetter, ("springs", "world", "particles.position", "particles.radius")))
# Loads of a spring's ends in its stiffness times its length, from which on a pendulum by `SWINGING`
# is off by some hundredths of a radian in two seconds, though each step converges (measured at
# 1/240 with a length and a mass of 1: f32 at 1e8 and 1e9, f64 at 1e12 and 1e13).
STIFFEST = {"f32": 1e7, "f64": 1e11}
SWINGING = ("implicit_midpoint", "tr_bdf2")
SMALL_STRETCH = 1e-6  # of a spring's length: a change of velocity by less may vanish


def refuse_unholdable(scene: Scene, precision: str, before: Scene | None = None) -> None:
    """InputError where a scene has numbers that a precision cannot compute with.

    precision: f32, f64 or compensated. before: a scene that was not refused; what is the same there
    is not looked at again. Looked at are the squares of lengths that springs and
    collisions compute, inverse masses, and the forces of springs stretched by their own length.
    """
    real = _real(precision)
    found = _unholdable(scene, real, before)
    if found is None:
        return
    wider = ""
    if real is np.float32 and _unholdable(scene, np.float64) is None:
        wider = "use --precision f64 or "
    raise InputError(f"{found} for {precision}; {wider or 'use '}other units")


def _unholdable(scene: Scene, real: type[np.floating], before: Scene | None = None) -> str | None:
    """The first number that a type cannot compute with, and why; None: there is none."""
    particles, springs = scene.particles, scene.springs
    tiny, most = float(np.finfo(real).tiny), float(np.finfo(real).max)
    shortest, longest = np.sqrt(tiny), np.sqrt(most)
    with np.errstate(all="ignore"):
        weight = np.where(particles.fixed, 1.0, 1.0 / particles.mass)
    row = _first((weight < tiny) | (weight > most))
    if row is not None:
        large = "large" if weight[row] < tiny else "small"
        return f"particle {row}: mass {particles.mass[row]:.4g} is too {large}"
    if before is not None and all(of(scene) is of(before) for of in _LENGTHS):
        return None
    far = np.abs(particles.position).sum(axis=1)
    row = _first(far > WATCHED)
    if row is not None:
        place = f"{far[row]:.4g} away, beyond the {WATCHED:.2g} that is watched"
        return f"particle {row}: its position is {place},"
    lengths = []
    if scene.world.collisions:
        lengths.append(("particle", "radius", particles.radius))
    if len(springs):
        a, b = springs.between.T
        with np.errstate(all="ignore"):
            apart = np.abs(particles.position[a] - particles.position[b]).max(axis=1)
        lengths += [("spring", "length", apart), ("spring", "rest_length", springs.rest_length)]
    for kind, name, value in lengths:
        row = _first((value > 0) & ((value < shortest) | (value > longest)))
        if row is not None:
            small = value[row] < shortest
            goes = f"falls below {tiny:.3g}" if small else f"exceeds {most:.3g}"
            size = "small" if small else "large"
            return f"{kind} {row}: {name} {value[row]:.4g} is too {size}, its square {goes},"
    if len(springs):
        with np.errstate(all="ignore"):
            force = springs.stiffness * np.maximum(apart, springs.rest_length)
        row = _first((force > 0) & (force < tiny) | ((springs.stiffness > 0) & (force == 0)))
        if row is not None and np.maximum(apart, springs.rest_length)[row] > 0:
            return f"spring {row}: stiffness {springs.stiffness[row]:.4g} is too small"
    return None


def _first(wrong: np.ndarray) -> int | None:
    """The first row of a mask (n,), None where there is none."""
    return int(wrong.argmax()) if wrong.any() else None


def unresolved(
    scene: Scene, acceleration: np.ndarray, dt: float, substeps: int, precision: str
) -> str | None:
    """One line that says what of a scene's start a precision cannot resolve, and what can.

    None where it resolves all. That is motion whose change of a coordinate in a step is about its
    last bit or less (`rounding.stall`), and what springs give to masses so heavy that it vanishes.

    acceleration: (n, dim), at the start. dt: time of a frame; substeps: steps it is cut into.
    """
    return _motion(scene, acceleration, dt, substeps, precision) or _vanishing(
        scene, dt / substeps, precision
    )


def too_stiff(scene: Scene, method: str, precision: str) -> str | None:
    """One line on springs so stiff that a method's swings are wrong by rounding; None: none is."""
    loads, most = stiffness_in_loads(scene), STIFFEST.get(precision, np.inf)
    if method not in SWINGING or not len(loads) or not loads.max() >= most:
        return None
    row = int(loads.argmax())
    remedies = ["softer springs", "an explicit method with shorter steps"]
    if precision == "f32" and loads[row] < STIFFEST["f64"]:
        remedies.insert(0, "--precision f64")
    return (
        f"spring {row} is so stiff that its load stretches it by {1.0 / loads[row]:.1g} of its "
        f"length: by {method} in {precision} what swings on it may be off by a tenth of a radian "
        f"in seconds, though every step converges; use {', or '.join(remedies)}"
    )


def stiffness_in_loads(scene: Scene) -> np.ndarray:
    """The stiffness of each spring times its length, in weights of its lighter free end, (s,)."""
    particles, springs = scene.particles, scene.springs
    g = float(np.linalg.norm(scene.world.gravity))
    if not len(springs) or not g > 0:
        return np.zeros(0)
    with np.errstate(all="ignore"):
        a, b = springs.between.T
        apart = np.linalg.norm(particles.position[a] - particles.position[b], axis=1)
        weight = np.where(particles.fixed, 0.0, 1.0 / particles.mass)[springs.between].max(axis=1)
        found: np.ndarray = springs.stiffness * np.maximum(apart, springs.rest_length) * weight / g
    return found


def _motion(
    scene: Scene, acceleration: np.ndarray, dt: float, substeps: int, precision: str
) -> str | None:
    p, step = scene.particles, dt / substeps
    start = p.position, p.velocity, acceleration, p.fixed, dt
    found = stall(*start, bits=_BITS[precision], sums="x")
    if not step < HALF_BITS * found.dt:
        return None
    finer = [
        name
        for name, bits in _BITS.items()
        if bits > _BITS[precision] and step >= HALF_BITS * stall(*start, bits=bits, sums="x").dt
    ]
    what = "stands still" if step < found.dt else "moves by its last bits"
    remedies = [f"use --precision {' or '.join(finer)}" if finer else "use longer steps"]
    remedies += ["fewer --substeps"] * (substeps > 1) + ["a place nearer to the origin"]
    return (
        f"particle {found.particle} {what} in {precision}: at {found.value:.4g} the next number is "
        f"{2 * found.dt * found.rate:.2g} away, and a step of {step:.3g} moves it by "
        f"{step * found.rate:.2g}; {', or '.join(remedies)}"
    )


def most_substeps(scene: Scene, acceleration: np.ndarray, dt: float, precision: str) -> int:
    """The most substeps of a frame whose motion a precision resolves, as `unresolved` has it.

    acceleration: (n, dim), at the start. dt: time of a frame.
    """
    p = scene.particles
    start = p.position, p.velocity, acceleration, p.fixed, dt
    found = stall(*start, bits=_BITS[precision], sums="x")
    return max(1, int(min(dt / (HALF_BITS * found.dt), 1e9))) if found.dt > 0 else 10**9


# Binary digits of a coordinate or velocity.
_BITS = {"f32": 24, "compensated": 47, "f64": 53}


def _vanishing(scene: Scene, step: float, precision: str) -> str | None:
    """A spring that gives an end nothing, because its mass makes it less than the least number."""
    p, springs = scene.particles, scene.springs
    if len(springs) == 0:
        return None
    with np.errstate(all="ignore"):
        a, b = springs.between.T
        apart = np.linalg.norm(p.position[a] - p.position[b], axis=1)
        force = springs.stiffness * np.maximum(apart, springs.rest_length)
        weight = np.where(p.fixed, 0.0, 1.0 / p.mass)[springs.between]
        given = SMALL_STRETCH * step * force[:, None] * weight
    lost = (given > 0) & (given < np.finfo(_real(precision)).tiny)
    row = _first(lost.any(axis=1))
    if row is None:
        return None
    end = int(springs.between[row][lost[row].argmax()])
    wider = ""
    if precision != "f64" and given[row].min() >= np.finfo(np.float64).tiny:
        wider = "--precision f64 or "
    return (
        f"what spring {row} gives particle {end} of mass {p.mass[end]:.3g} in a step is less than "
        f"the least number of {precision}: it vanishes, and momentum with it; use {wider}other "
        "units, or masses that differ less"
    )


def _real(precision: str) -> type[np.floating]:
    return np.float64 if precision == "f64" else np.float32
