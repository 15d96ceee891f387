"""The numbers of a run that may change while it goes on, and what they may be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taichi_cloth.errors import InputError
from taichi_cloth.kernels import methods
from taichi_cloth.kernels.methods.contract import Claims
from taichi_cloth.runtime import current_device
from taichi_cloth.scene.model import Scene, World
from taichi_cloth.settings import accepted
from taichi_cloth.settings.options import MOST_ITERATIONS, MOST_TOLERANCE, SOLVER_SETTINGS

# A particle that would cross the world this many times in one frame is lost, not fast.
RUNAWAY_CROSSINGS = 100.0


@dataclass(frozen=True)
class Numbers:
    """Numbers for the device. dt: time of a step; speed_limit: above it a particle runs away;
    tolerance, iterations: of solvers, 0 for methods that take none. first_time, first_step: the
    scene's time, and the steps done until then, from which the device counts time on (`clock`).
    """

    dt: float
    speed_limit: float
    tolerance: float
    iterations: int
    first_time: float
    first_step: int


def asked_step(
    world: World, dt: float | str | None, substeps: int | None
) -> tuple[bool, tuple[float | str, int]]:
    """True if a run chooses its substeps, and its dt and substeps: what it was asked for, else what
    its scene says.

    InputError where substeps are given that are to be chosen.
    """
    if dt == "auto" and isinstance(dt, str):
        if substeps not in (None, 1):
            raise InputError("--substeps: --dt auto chooses them; give one of the two")
        return True, (world.dt, 1)
    own = world.substeps
    if dt is None and substeps is None and own == "auto":
        return True, (world.dt, 1)
    if substeps is None:
        substeps = 1 if isinstance(own, str) else own
    return False, (world.dt if dt is None else dt, substeps)


def checked_step(dt: float | str, substeps: int) -> tuple[float, int]:
    """(dt, substeps), if there can be such steps; else InputError.

    Also where the device's precision takes one for zero or for infinite: the clock would go on, and
    nothing move.
    """
    checked = accepted.number("--dt", dt, above=0.0)
    substeps = accepted.whole_number("--substeps", substeps, 1)
    device, step = current_device(), checked / substeps
    limits = np.finfo(np.float64 if device.real == "f64" else np.float32)
    least, most = float(limits.tiny), float(limits.max)
    if step < least or checked > most:
        # Their quotient may be taken for 0.
        short = f"{checked:g}" if substeps == 1 else f"{checked:g} / {substeps}"
        small = f"a step of {short} is less than {least:.3g}, the least"
        beyond = small if step < least else f"{checked:.3g} is more than {most:.3g}, the most"
        raise InputError(f"--dt: {beyond} that {device.precision} holds; use other units of time")
    return checked, substeps


def runaway_speed(scene: Scene, dt: float) -> float:
    """The speed above which a particle runs away, with frames of `dt`; world units / time."""
    return RUNAWAY_CROSSINGS * float(np.linalg.norm(scene.world.size)) / dt


def solver_settings(
    method: str, claims: Claims, tolerance: float | None, iterations: int | None
) -> dict[str, float]:
    """The settings that a method takes, by name; InputError for one that it does not."""
    given = {"tolerance": tolerance, "iterations": iterations}
    for name, value in given.items():
        if value is None:
            continue
        if name not in claims.settings:
            takers = [m for m in methods.METHODS if name in methods.load(m).claims.settings]
            raise InputError(f"--{name}: {method} does not take it; {', '.join(takers)} do")
        if name == "iterations":
            accepted.whole_number("--iterations", value, 1, MOST_ITERATIONS)
        else:
            accepted.number("--tolerance", value, above=0.0, maximum=MOST_TOLERANCE)
    chosen = {name: value for name, value in given.items() if value is not None}
    return {name: chosen.get(name, SOLVER_SETTINGS[name]) for name in claims.settings}
