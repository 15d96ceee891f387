"""Settings to compare, and those in which a scene is tried, by the methods' claims."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from taichi_cloth.errors import InputError, clipped, counted, nearest
from taichi_cloth.limits.bounds import any_geometry, step_within
from taichi_cloth.limits.eigenmodes import stable_step
from taichi_cloth.limits.modes import ROUND_OFF
from taichi_cloth.limits.network import Network
from taichi_cloth.scene.model import Scene
from taichi_cloth.settings.options import (
    ARCHS,
    PRECISIONS,
    RunOptions,
    default_fast_math,
    parameters_of,
)
from taichi_cloth.settings.parameters import number_of
from taichi_cloth.settings.sweeps import ComparisonOptions
from taichi_cloth.sweeps.within import SHORT, Clock, clock

DOUBLINGS = 6  # of the number of substeps, from the fewest that a method takes
SHORT_DOUBLINGS = 4
ITERATIONS = (1, 4, 16)  # sweeps a step, of methods that take their number
SHORT_ITERATIONS = (1, 8)
FAR_MORE = 16  # times as many substeps as another method: who needs them is compared where named
CONVERGED_TOLERANCE = 1e-13  # relative residual, in f64
CONVERGED_ITERATIONS = 256
# Scenes with fewer particles run on the graph: lanes compile three times as long for little speed.
FEW_PARTICLES = 2000
SERIAL_BEST = 5000  # particles up to which one thread does as well as several


# What settings that share a process have in common: backend, precision, fast_math.
Process = tuple[str, str, bool]


@dataclass(frozen=True)
class Setting:
    """The way a scene is run: what `run` takes as flags of the same names.

    dt: time of a frame; a step is dt / substeps. tolerance, iterations: None where the method
    takes none, or takes what it has by itself.
    """

    method: str
    dt: float
    substeps: int
    precision: str = "f64"
    fast_math: bool = False
    arch: str = "cpu"
    iterations: int | None = None
    tolerance: float | None = None

    @property
    def process(self) -> Process:
        """The key that it shares with all settings of its process."""
        return self.arch, self.precision, self.fast_math

    @property
    def step(self) -> float:
        """Time of a step."""
        return self.dt / self.substeps

    @property
    def series(self) -> tuple[str, str, str, bool, int | None, float | None]:
        """The key that it shares with all settings that differ in nothing but their step."""
        return self.method, *self.process, self.iterations, self.tolerance

    @property
    def lacks_fast_math(self) -> bool:
        """True if fast_math was switched off."""
        return default_fast_math(self.precision) and not self.fast_math

    def describe_solver(self) -> str:
        """'8 iterations', 'tolerance 1e-06', or nothing."""
        words = []
        if self.iterations is not None:
            words.append(counted(self.iterations, "iteration"))
        if self.tolerance is not None:
            words.append(f"tolerance {self.tolerance:g}")
        return ", ".join(words)

    def describe(self) -> str:
        """Method, steps, solver and device in words."""
        exact = " without fast_math" if self.lacks_fast_math else ""
        device = f"{self.arch} {self.precision}{exact}"
        steps, solver = counted(self.substeps, "substep"), self.describe_solver()
        return ", ".join(filter(None, [self.method, steps, solver, device]))

    def words(self) -> list[str]:
        """The flags of `run` that stand for it."""
        words = ["--method", self.method, "--dt", _exact(self.dt)]
        words += ["--substeps", str(self.substeps)]
        if self.iterations is not None:
            words += ["--iterations", str(self.iterations)]
        if self.tolerance is not None:
            words += ["--tolerance", _exact(self.tolerance)]
        words += ["--arch", self.arch, "--precision", self.precision]
        if self.lacks_fast_math:
            words.append("--no-fast-math")
        return words


def choose(scene: Scene, options: ComparisonOptions, time: Clock | None = None) -> list[Setting]:
    """The settings that a scene is compared in. Raises InputError for words that are none.

    time: for which they are planned, in the place of the options'.

    Where the number of substeps is left open, it doubles from the fewest that are stable, as the
    limit is known. Methods that are stable at no step, or need far more of them than others, are
    compared where they are named. Numbers that springs may make too few as they turn come last.
    """
    from taichi_cloth.kernels import methods

    names = _words("--methods", options.methods, methods.METHODS)
    precisions = _words("--precisions", options.precisions, PRECISIONS)
    short = (time or clock(options.within, options.quick)).short
    if short and options.precisions is None:
        precisions = [word for word in precisions if word in ("f32", "f64")]
    archs = _words("--archs", options.archs or "cpu", [arch for arch in ARCHS if arch != "gpu"])
    asked = _numbers("--substeps", options.substeps, "substeps")
    iterations = _numbers("--iterations", options.iterations, "iterations")
    tolerances = _numbers("--tolerances", options.tolerances, "tolerance")
    dt = options.dt or scene.world.dt
    needs = _needs(scene, dt, names)
    least = max(1.0, min((n.here for n in needs.values() if n.ever and n.here), default=1.0))

    settings: list[Setting] = []
    for method in names:
        takes = methods.load(method).claims.settings
        sweeps: Sequence[int | None] = [None]
        residuals: Sequence[float | None] = [None]
        if "iterations" in takes:
            sweeps = iterations or (SHORT_ITERATIONS if short else ITERATIONS)
        if "tolerance" in takes:
            residuals = tolerances or [None]
        need = needs[method]
        if not options.methods and not (need.ever and need.here <= FAR_MORE * least):
            continue
        counts = asked or _doubling(need.here, short)
        counts = sorted(counts, key=lambda count, sure=need.sure: (count < sure, count))
        for arch in archs:
            for precision, fast_math in _maths(precisions, options.without_fast_math):
                settings += [
                    Setting(method, dt, count, precision, fast_math, arch, sweep, residual)
                    for sweep in sweeps
                    for residual in residuals
                    for count in counts
                ]
    _refuse_unused("--iterations", iterations, "iterations", settings)
    _refuse_unused("--tolerances", tolerances, "tolerance", settings)
    return settings


def unplanned(scene: Scene, options: ComparisonOptions, chosen: Collection[Setting]) -> list[str]:
    """The rest of a plan without a limit of time beyond the settings chosen, in a line, or none."""
    beyond = [one for one in choose(scene, options, Clock()) if one not in chosen]
    if not beyond:
        return []
    precisions = {one.precision for one in chosen}
    sweeps = {one.iterations for one in chosen}
    words = list(dict.fromkeys(one.precision for one in beyond if one.precision not in precisions))
    known = [one for one in beyond if one.precision in precisions]
    others = sorted({one.iterations for one in known if one.iterations is not None} - sweeps)
    if others:
        words.append(f"{' and '.join(map(str, others))} iterations")
    if any(one.iterations in sweeps for one in known):
        words.append("more substeps")
    return [f"{counted(len(beyond), 'setting')} that {SHORT:g} s and more plan: {', '.join(words)}"]


def _maths(precisions: Sequence[str], also_without: bool) -> list[tuple[str, bool]]:
    """Precisions, each with or without fast_math, or f32 with both."""
    maths = []
    for precision in precisions:
        maths.append((precision, default_fast_math(precision)))
        if also_without and default_fast_math(precision):
            maths.append((precision, False))
    return maths


def converged(setting: Setting) -> Setting | None:
    """The setting with its solver converged, in f64; None where its method has no solver."""
    from taichi_cloth.kernels import methods

    takes = methods.load(setting.method).claims.settings
    if not takes:
        return None
    return Setting(
        setting.method,
        setting.dt,
        setting.substeps,
        iterations=CONVERGED_ITERATIONS if "iterations" in takes else None,
        tolerance=CONVERGED_TOLERANCE if "tolerance" in takes else None,
    )


class Need(NamedTuple):
    """The substeps that a method needs to be stable: at the start, and however springs turn; and
    whether it ever is (else those with which it grows slowly).
    """

    here: float
    sure: float
    ever: bool


def _needs(scene: Scene, dt: float, names: Sequence[str]) -> dict[str, Need]:
    """The needs of each method; of many particles the bound for every geometry stands for both."""
    from taichi_cloth.kernels import methods

    network = Network.from_scene(scene)
    bounds, needs = any_geometry(network), {}
    for name in names:
        method = methods.load(name)
        within = step_within(method, bounds)
        sure = dt / (within or 2.0 / max(math.sqrt(bounds.omega2), bounds.damping))
        here = sure
        if within and sure > 1 and len(scene.particles) <= FEW_PARTICLES:
            here = min(sure, dt / stable_step(method, network, exact=False).dt)
        needs[name] = Need(here * (1 - ROUND_OFF), sure * (1 - ROUND_OFF), within > 0)
    return needs


def _doubling(needed: float, short: bool) -> list[int]:
    """Numbers of substeps, where at least `needed` are stable."""
    fewest = max(1, math.ceil(needed))
    return [fewest << k for k in range(SHORT_DOUBLINGS if short else DOUBLINGS)]


def _exact(number: float) -> str:
    """A number in a command: as short as it may be read back to the bit."""
    short = f"{number:.12g}"
    return short if float(short) == number else repr(float(number))


def _words(flag: str, text: str | None, known: Sequence[str]) -> list[str]:
    """The words of a list 'a,b', all that are known where there is none."""
    if text is None:
        return list(known)
    words = [word.strip() for word in text.split(",") if word.strip()]
    for word in words:
        if word not in known:
            raise InputError(f"{flag}: unknown '{clipped(word)}'; {nearest(word, known)}")
    if not words:
        raise InputError(f"{flag}: names nothing; known: {', '.join(known)}")
    return list(dict.fromkeys(words))


def _numbers(flag: str, text: str | None, name: str) -> list[Any]:
    """The numbers of a list '1,2,4', sorted; empty where there is none. name: of what each is, of
    the options of a run, whose limits it has.
    """
    if text is None:
        return []
    setting = parameters_of(RunOptions)[name]
    type_, numbers = setting.type, set()
    for word in text.split(","):
        try:
            number = number_of(type_, word.strip())
        except ValueError:
            number = type_(0)
        if not 0 < number < math.inf:
            kind = "whole numbers from 1" if type_ is int else "positive numbers"
            raise InputError(
                f"{flag} must be {kind}, separated by commas; has '{clipped(word.strip())}'"
            )
        numbers.add(setting.check(flag, number))
    return sorted(numbers)


def _refuse_unused(
    flag: str, given: Sequence[float], name: str, settings: Sequence[Setting]
) -> None:
    if given and all(getattr(setting, name) is None for setting in settings):
        raise InputError(f"{flag}: none of the chosen methods takes it")
