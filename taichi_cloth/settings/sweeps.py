"""The settings of the commands that sweep: `stability`, `trade`, `tune`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from taichi_cloth.settings.options import (
    PATHS,
    TOPOLOGIES,
    Options,
    quick_setting,
    resume_setting,
    setting,
    within_setting,
)


def _on() -> Any:
    """The setting of a sweep that runs on other machines, too."""
    return setting(
        None, "run on the workers of this Dask scheduler", str, metavar="tcp://HOST:PORT"
    )


@dataclass(frozen=True)
class StabilityOptions(Options):
    """Settings of the command `stability`."""

    output: str | None = setting(
        None, "folder of the results (default: ./stability-SCENE)", str, metavar="DIR"
    )
    method: str | None = setting(
        None, "only this method (default: all that have a limit)", str, metavar="NAME"
    )
    within: str | None = within_setting()
    quick: bool = quick_setting()
    resume: bool = resume_setting()
    on: str | None = _on()
    quiet: bool = setting(False, "print nothing but errors")


@dataclass(frozen=True)
class ComparisonOptions(Options):
    """The settings that `trade` and `tune` compare, and how."""

    methods: str | None = setting(None, "methods to compare (default: all)", str, metavar="A,B")
    precisions: str | None = setting(
        None,
        "precisions to compare (default: all; within less than 2min f32,f64)",
        str,
        metavar="A,B",
    )
    archs: str | None = setting(None, "backends to compare (default: cpu)", str, metavar="A,B")
    substeps: str | None = setting(
        None,
        "steps a frame to compare (default: doubling, from what the method's limit allows)",
        str,
        metavar="N,M",
    )
    iterations: str | None = setting(
        None, "sweeps a step to compare, of methods that take them", str, metavar="N,M"
    )
    tolerances: str | None = setting(
        None, "residuals to compare, of methods that take them", str, metavar="X,Y"
    )
    without_fast_math: bool = setting(False, "compare f32 without fast_math, too")
    dt: float | None = setting(
        None, "time of one frame (default: the scene's)", float, above=0, metavar="X"
    )
    frames: int | None = setting(
        None,
        "the time that settings are judged over, in frames (default: the scene's own length, about "
        "a swing of its slowest vibration: 300 at least)",
        int,
        minimum=1,
        maximum=100_000,
        metavar="N",
    )
    within: str | None = within_setting()
    quick: bool = quick_setting()
    execution: str = setting("auto", "one thread, or all of them", choices=("auto", *PATHS))
    topology: str = setting("auto", "how springs are stored", choices=("auto", *TOPOLOGIES))
    threads: int | None = setting(
        None, "CPU threads (default: all)", int, minimum=1, maximum=1024, metavar="N"
    )
    resume: bool = resume_setting()
    on: str | None = _on()
    times_on: str | None = setting(
        None,
        "with --on: the worker's machine that is timed (default: this one)",
        str,
        metavar="HOST",
    )


@dataclass(frozen=True)
class TradeOptions(ComparisonOptions):
    """Settings of `trade`."""

    output: str | None = setting(
        None, "folder of the results (default: ./trade-SCENE)", str, metavar="DIR"
    )


@dataclass(frozen=True)
class TuneOptions(ComparisonOptions):
    """Settings of `tune`."""

    output: str | None = setting(
        None,
        "folder of what is finished, until the end (default: ./tune-SCENE)",
        str,
        metavar="DIR",
    )

    error: str | None = setting(
        None,
        "find the cheapest setting each of whose seconds is at most that wrong, as --error-meter "
        "has it: in world units, or with %, in parts of the second's motion",
        str,
        metavar="X|X%",
    )
    frame_time: str | None = setting(
        None, "find the most accurate setting whose frames take at most this", str, metavar="8ms"
    )
    penetration: str | None = setting(
        None,
        "find the cheapest setting whose deepest penetration is at most this, also beside --error "
        "or --frame-time: a length of the scene, or with m, cm or mm where y points up",
        str,
        metavar="1mm",
    )
    seed: int = setting(
        7, "seed of the disturbance of the run that confirms", minimum=0, maximum=2**32 - 1
    )
    json: bool = setting(False, "print nothing but JSON")
