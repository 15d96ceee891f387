"""Settings that a person can change: each says its unit, its limits and what it does.

Flags of the command line are made from these declarations, so a setting is described once.
"""

from __future__ import annotations

import builtins
import math
import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from numbers import Real
from typing import Any, TypeVar

from taichi_cloth.errors import InputError, clipped, nearest

PROGRAM = "taichi-cloth"  # the command whose flags set them

Number = TypeVar("Number", int, float)


@dataclass(frozen=True)
class Parameter:
    """One setting: its help, unit and limits; type and default are filled in where it is used.

    minimum, maximum: inclusive limits; above: exclusive lower limit; infinite: whether inf is
        allowed, too.
    choices: the words allowed, if only some are; of a number, those allowed in its place.
    metavar: stands for the value in help texts.
    repeated: whether the flag may be given several times, each with a value.
    """

    help: str
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    above: float | None = None
    infinite: bool = False
    choices: tuple[str, ...] = ()
    metavar: str = ""
    repeated: bool = False
    type: type = str
    default: Any = None

    def with_type(self, type_: builtins.type, default: Any) -> Parameter:
        """The parameter with the type and default that it has where it is used."""
        return replace(self, type=type_, default=default)

    def check(self, name: str, value: Any) -> Any:
        """Return `value` if it is allowed for the setting called `name`, else raise InputError.

        None is allowed where it is the default, which then follows from other settings.
        """
        if value is None and self.default is None:
            return value
        if self.type in (int, float) and value not in self.choices:
            number = isinstance(value, Real) and not isinstance(value, bool)
            if number and hasattr(value, "item"):
                value = value.item()  # a scalar of NumPy's
            broken = isinstance(value, float) and math.isfinite(value) and not value.is_integer()
            if not number or (self.type is int and broken):
                kind = "a whole number" if self.type is int else "a number"
                raise InputError(f"{name} must be {kind}, is {value!r}")
            finite = abs(value) <= sys.float_info.max or (self.infinite and value == math.inf)
            for broken, says in (
                (not finite, "must be a finite number"),
                (
                    self.above is not None and not value > self.above,
                    f"must be above {self.above}" if self.above else "must be positive",
                ),
                (
                    self.minimum is not None and not value >= self.minimum,
                    f"must be at least {self.minimum}",
                ),
                (
                    self.maximum is not None and not value <= self.maximum,
                    f"must be at most {self.maximum}",
                ),
            ):
                if broken:
                    raise InputError(f"{name} {says}, is {_shown(value)}")
        elif self.choices and value not in self.choices:
            hint = nearest(str(value), self.choices)
            raise InputError(f"{name}: unknown value '{clipped(str(value))}'; {hint}")
        return value

    def parse(self, name: str, text: str) -> Any:
        """The value that `text` stands for; raises InputError if it is none or not allowed."""
        if self.type in (int, float) and text not in self.choices:
            try:
                value = number_of(self.type, text)
            except ValueError:
                kind = "a whole number" if self.type is int else "a number"
                kind += "".join(f" or {word}" for word in self.choices)
                raise InputError(f"{name} must be {kind}, is '{clipped(text)}'") from None
            return self.check(name, value)
        if self.type is tuple:
            return _parse_size(name, text)
        return self.check(name, text)

    def describe(self) -> str:
        """Help, unit, limits and default in one line."""
        notes = [self.unit] if self.unit else []
        if self.above is not None:
            notes.append(f"above {self.above:g}" if self.above else "positive")
        if self.minimum is not None and self.maximum is not None:
            notes.append(f"{_written(self.minimum)} to {_written(self.maximum)}")
        elif self.minimum is not None:
            notes.append(f"at least {_written(self.minimum)}")
        elif self.maximum is not None:
            notes.append(f"at most {_written(self.maximum)}")
        if self.default not in (None, False, True):
            notes.append(f"default {self.default}")
        return f"{self.help} ({', '.join(notes)})" if notes else self.help


def number_of(type_: Callable[[str], Number], text: str) -> Number:
    """The number that a person wrote, by `int` or `float`, in the digits 0 to 9 and no others.

    Raises ValueError where it is none. Python's own functions also take digits of every script,
    underscores between them, and spaces around them.
    """
    if not re.fullmatch(r"[-+.0-9a-zA-Z]+", text):
        raise ValueError(f"'{text}' is not a number")
    return type_(text)


def _shown(value: float) -> str:
    """A number as it is, cut where it is long; Python does not write one of 4301 digits."""
    try:
        return clipped(str(value))
    except ValueError:
        return "one of thousands of digits"


def _written(limit: float) -> str:
    """A limit as one writes it: 100000, not 1e+05."""
    return str(limit) if isinstance(limit, int) else f"{limit:g}"


def _parse_size(name: str, text: str) -> tuple[int, int]:
    """'800x600' as (800, 600); raises InputError for anything else, or a size no window has."""
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(re.fullmatch("[0-9]{1,30}", part) for part in parts):
        says = "must be WIDTHxHEIGHT in pixels, such as 800x600"
        raise InputError(f"{name} {says}; is '{clipped(text)}'")
    width, height = map(int, parts)
    if not (min(width, height) >= 16 and max(width, height) <= 8192):
        raise InputError(f"{name}: width and height must be 16 to 8192 pixels, are {clipped(text)}")
    return width, height


ASSIGNMENT = Parameter(
    "a value in the place of the scene's own, by a key of scene files: world.gravity=[0,0.1], "
    "particle.viscous=0.02; may be repeated",
    metavar="KEY=VALUE",
    repeated=True,
)


def setting(default: Any, help_: str, type_: type | None = None, **limits: Any) -> Any:
    """A dataclass field with its `Parameter` in its metadata."""
    parameter = Parameter(help_, **limits).with_type(type_ or type(default), default)
    return field(default=default, metadata={"parameter": parameter})


AnyOptions = TypeVar("AnyOptions", bound="Options")


@dataclass(frozen=True)
class Options:
    """The settings of a command: each field is declared by `setting`.

    given: names of the settings that were asked for; the others have their defaults.
    """

    given: frozenset[str] = field(default=frozenset(), kw_only=True)

    @classmethod
    def from_given(cls: type[AnyOptions], values: Mapping[str, Any]) -> AnyOptions:
        """The options with these values, which were asked for, and defaults for the rest."""
        return cls(**values, given=frozenset(values))

    def words(self) -> list[str]:
        """The settings that were asked for, as one would write them after a command."""
        names = [name for name in parameters_of(type(self)) if name in self.given]
        return flag_words({name: getattr(self, name) for name in names})


def parameters_of(settings: type[Options]) -> dict[str, Parameter]:
    """The declared parameters of a command's settings, by field name."""
    declared = {f.name: f.metadata.get("parameter") for f in fields(settings)}
    return {name: parameter for name, parameter in declared.items() if parameter is not None}


def flag(name: str) -> str:
    """The flag of the setting called `name`."""
    return "--" + name.replace("_", "-")


def flag_words(values: Mapping[str, Any]) -> list[str]:
    """The flags that give settings these values, as one would write them."""
    words = []
    for name, value in values.items():
        if isinstance(value, bool):
            words.append(flag(name if value else f"no_{name}"))
        else:
            words += [flag(name), str(value)]
    return words


ARCHS = ("cpu", "gpu", "cuda", "vulkan", "opengl", "metal")
PRECISIONS = ("f32", "f64", "compensated")  # the last: f32 with compensated sums
PATHS = ("serial", "parallel")
TOPOLOGIES = ("lanes", "graph")
# What some methods take to solve a step's equations: their defaults. See their `CLAIMS`.
SOLVER_SETTINGS = {"tolerance": 1e-6, "iterations": 10}
VIEWS = ("auto", "ggui", "gui", "none")
SHOWN = ("surface", "springs", "particles")  # what may be drawn of a cloth
HEADLESS_FRAMES = 600


@dataclass(frozen=True)
class RunOptions(Options):
    """Settings of one run."""

    arch: str = setting("cpu", "where to compute; gpu is the best there is", choices=ARCHS)
    precision: str = setting(
        "f32",
        "floating-point numbers; compensated: f32 whose sums keep what rounding takes",
        choices=PRECISIONS,
    )
    method: str = setting("symplectic_euler", "time-integration method", metavar="NAME")
    dt: float | str | None = setting(
        None,
        "time of one frame (default: the scene's); auto: substeps that stay stable",
        float,
        above=0,
        choices=("auto",),
        metavar="X|auto",
    )
    substeps: int = setting(
        1, "steps a frame, each of dt / N", minimum=1, maximum=1_000_000, metavar="N"
    )
    tolerance: float | None = setting(
        None,
        f"implicit methods: relative residual (default {SOLVER_SETTINGS['tolerance']:g})",
        float,
        above=0,
        maximum=0.1,
        metavar="X",
    )
    unconverged: str = setting(
        "fail",
        "implicit methods: what a run is most of whose steps miss the tolerance",
        choices=("fail", "accept"),
    )
    iterations: int | None = setting(
        None,
        f"xpbd, vbd: sweeps a step (default {SOLVER_SETTINGS['iterations']})",
        int,
        minimum=1,
        maximum=1_000_000,
        metavar="N",
    )
    execution: str = setting(
        "auto",
        "one thread, all of them, or the faster",
        choices=("auto", *PATHS),
    )
    topology: str = setting(
        "auto",
        "regular grids in vector lanes, all springs as a graph, or the faster",
        choices=("auto", *TOPOLOGIES),
    )
    threads: int | None = setting(
        None,
        "CPU threads; 1 runs serially, more in parallel (default: all, where that is faster)",
        int,
        minimum=1,
        maximum=1024,
        metavar="N",
    )
    fast_math: bool | None = setting(
        None,
        "let the compiler reorder floating-point operations (default: in f32 only)",
        bool,
    )
    view: str = setting("auto", "window to use; auto takes the best there is", choices=VIEWS)
    headless: bool = setting(False, "no window, the same as --view none")
    size: tuple | None = setting(
        None, "window size in pixels (default: the scene's)", tuple, metavar="WxH"
    )
    frames: int | None = setting(
        None,
        f"stop after N frames (headless default {HEADLESS_FRAMES})",
        int,
        minimum=1,
        metavar="N",
    )
    seed: int | None = setting(
        None,
        "seed of the velocities of clicked particles (default: the log's, else 0)",
        int,
        minimum=0,
        maximum=2**32 - 1,
        metavar="N",
    )
    events: str | None = setting(None, "replay an interaction log", str, metavar="FILE.jsonl")
    record: str | None = setting(None, "write an interaction log", str, metavar="FILE.jsonl")
    save: str | None = setting(
        None, "save the trajectory (of a window: since the last r)", str, metavar="FILE.npz"
    )
    export: str | None = setting(
        None,
        "write frames for other programs: a folder or NAME.ply or .obj (a file each), or a file "
        ".npz, .pc2, .usda, .usd",
        str,
        metavar="DIR|FILE",
    )
    every: int = setting(1, "save and export every Nth frame only", minimum=1, metavar="N")
    image: str | None = setting(None, "save the last frame as a picture", str, metavar="FILE.png")
    video: str | None = setting(None, "save all frames as a film", str, metavar="FILE.mp4|gif")
    show: str | None = setting(
        None,
        "draw cloths as these: surface, springs, particles (default: in 3-D surface, else the "
        "others)",
        str,
        metavar="A,B",
    )
    status: bool = setting(True, "the status in the window, in pictures and films", bool)
    paused: bool = setting(False, "start paused")
    quiet: bool = setting(False, "print nothing but errors")


@dataclass(frozen=True)
class StabilityOptions(Options):
    """Settings of the command `stability`."""

    output: str | None = setting(
        None, "folder of the results (default: ./stability-SCENE)", str, metavar="DIR"
    )
    method: str | None = setting(
        None, "only this method (default: all that have a limit)", str, metavar="NAME"
    )
    quiet: bool = setting(False, "print nothing but errors")


@dataclass(frozen=True)
class BenchOptions(Options):
    """Settings of the benchmark."""

    rounds: int | None = setting(
        None,
        "counted rounds of each contest (default: 7, with --quick 3)",
        int,
        minimum=2,
        maximum=1000,
        metavar="N",
    )
    quick: bool = setting(False, "smaller sizes and fewer rounds: about a minute")
    output: str = setting("bench/results", "folder of the results", metavar="DIR")
    arch: str | None = setting(
        None,
        "backend of the part gpu (default: cuda and vulkan)",
        str,
        choices=tuple(arch for arch in ARCHS if arch not in ("cpu", "gpu")),
    )
    tables: str | None = setting(
        None,
        "fill a document's tables from the results; without a PART nothing is measured",
        str,
        metavar="FILE.md",
    )


@dataclass(frozen=True)
class ComparisonOptions(Options):
    """What `trade` and `tune` compare, and how."""

    methods: str | None = setting(None, "methods to compare (default: all)", str, metavar="A,B")
    precisions: str | None = setting(
        None, "precisions to compare (default: all; with --quick f32,f64)", str, metavar="A,B"
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
        "frames to compare (default: about a swing of the slowest vibration)",
        int,
        minimum=1,
        maximum=100_000,
        metavar="N",
    )
    quick: bool = setting(False, "fewer settings and shorter timing: within a minute")
    execution: str = setting("auto", "one thread, or all of them", choices=("auto", *PATHS))
    topology: str = setting("auto", "how springs are stored", choices=("auto", *TOPOLOGIES))
    threads: int | None = setting(
        None, "CPU threads (default: all)", int, minimum=1, maximum=1024, metavar="N"
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

    error: str | None = setting(
        None,
        "find the cheapest setting with at most this trajectory error: in world units, or with %, "
        "in parts of the largest displacement",
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


def _as_in_run(name: str) -> Any:
    """A setting that is the same as one of a run."""
    parameter = parameters_of(RunOptions)[name]
    return field(default=parameter.default, metadata={"parameter": parameter})


@dataclass(frozen=True)
class ExplainOptions(Options):
    """Settings of `explain`."""

    arch: str = _as_in_run("arch")
    precision: str = _as_in_run("precision")
    method: str = _as_in_run("method")
    dt: float | None = setting(
        None, "time of one frame (default: the scene's)", float, above=0, metavar="X"
    )
    substeps: int = _as_in_run("substeps")
    execution: str = _as_in_run("execution")
    topology: str = _as_in_run("topology")
    threads: int | None = setting(
        None, "CPU threads (default: all)", int, minimum=1, maximum=1024, metavar="N"
    )
    quick: bool = setting(False, "fewer rounds: about a third of the time")
    json: bool = setting(False, "print JSON instead of tables")
    all: bool = setting(False, "explain all built-in scenes, and what a cloth's links cost")
    tables: str | None = setting(
        None, "with --all: fill a document's tables", str, metavar="FILE.md"
    )


def shown_parts(text: str) -> frozenset[str]:
    """The words of `SHOWN` that `text` names, by commas. Raises InputError for any other."""
    words = [word.strip() for word in text.split(",")]
    for word in words:
        if word not in SHOWN:
            raise InputError(f"--show: unknown word '{clipped(word)}'; {nearest(word, SHOWN)}")
    return frozenset(words)


OneRun = TypeVar("OneRun", RunOptions, ExplainOptions)


def check_run(options: OneRun) -> OneRun:
    """Return the options of one run, with the execution path that `threads` implies.

    Raises InputError for an unknown method, and for threads of a backend that has none.
    """
    from taichi_cloth.kernels.methods import METHODS

    if options.method not in METHODS:
        raise InputError(
            f"--method: unknown method '{options.method}'; {nearest(options.method, METHODS)}"
        )
    if isinstance(options, RunOptions) and options.show is not None:
        shown_parts(options.show)
    if options.threads is None:
        return options
    if options.arch != "cpu":
        raise InputError(f"--threads: only --arch cpu takes it, not {options.arch}")
    if options.execution != "auto" or options.threads > 1:
        return options  # several threads may be used: where they only wait, one goes on
    return replace(options, execution="serial")
