"""Settings that a person can change: each says its unit, its limits and what it does.

Flags of the command line are made from these declarations, so a setting is described once.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, TypeVar

from taichi_cloth.errors import InputError, clipped, nearest
from taichi_cloth.settings.parameters import Parameter

PROGRAM = "taichi-cloth"  # the command whose flags set them


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

    def words(self, without: Container[str] = ()) -> list[str]:
        """The settings that were asked for, as one would write them after a command, but those
        `without`.
        """
        asked = (name for name in parameters_of(type(self)) if name in self.given)
        names = [name for name in asked if name not in without]
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
# What some methods take to solve a step's equations, by the names in their claims: the defaults.
SOLVER_SETTINGS = {"tolerance": 1e-6, "iterations": 10}
MOST_SUBSTEPS = MOST_ITERATIONS = 1_000_000
MOST_TOLERANCE = 1  # nothing solved at all
# What shows pictures: the files of a folder (`ui/presenters/`), found without importing any.
_PRESENTERS = sorted((Path(__file__).parents[1] / "ui" / "presenters").glob("[a-z]*.py"))
VIEWS = ("auto", *(file.stem for file in _PRESENTERS if file.stem != "contract"))
STRAIN = "strain"  # drawn: the colours of what springs bear
SHOWN = ("surface", "springs", "particles", STRAIN)  # what may be drawn of a cloth
HEADLESS_FRAMES = 600
# Options of a run that name a file, or a folder, which it writes.
WRITES = ("save", "record", "checkpoint", "export", "image", "video", "report")
WITHIN = "1%"  # how far apart two runs may be that are still together: most eyes see no less


def default_fast_math(precision: str) -> bool:
    """True if fast_math is on by itself in a precision, out of `PRECISIONS`."""
    return precision == "f32"


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
        1, "steps a frame, each of dt / N", minimum=1, maximum=MOST_SUBSTEPS, metavar="N"
    )
    tolerance: float | None = setting(
        None,
        "implicit methods: relative residual; above 0.1 rough, and faster (default "
        f"{SOLVER_SETTINGS['tolerance']:g})",
        float,
        above=0,
        maximum=MOST_TOLERANCE,
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
        maximum=MOST_ITERATIONS,
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
    lanes: str = setting(
        "auto",
        "particles in a vector of a regular grid: 8 (or the method's fewer), 16, which take longer "
        "to compile, or 16 where they pay and earlier runs have compiled them",
        choices=("auto", "8", "16"),
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
    checkpoint: str | None = setting(
        None,
        "save where the run is at its end, from which --resume goes on bit for bit",
        str,
        metavar="FILE.npz",
    )
    resume: str | None = setting(
        None,
        "go on from a checkpoint of this scene: as it was, or with another method, step or solver",
        str,
        metavar="FILE.npz",
    )
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
    report: str | None = setting(
        None,
        "write what led to the end into one page (a run that fails has one beside its other files)",
        str,
        metavar="FILE.html",
    )
    survivors: bool = setting(
        False,
        "where the run fails, look for the cheapest setting that survives, by running it, for up "
        "to two minutes (in a window: k)",
    )
    every: int = setting(1, "save and export every Nth frame only", minimum=1, metavar="N")
    image: str | None = setting(None, "save the last frame as a picture", str, metavar="FILE.png")
    video: str | None = setting(None, "save all frames as a film", str, metavar="FILE.mp4|gif")
    pictures: str | None = setting(
        None,
        "folder of what the keys s and v save in a window (default: the current one)",
        str,
        metavar="DIR",
    )
    show: str | None = setting(
        None,
        "draw cloths as these: surface, springs, particles (default: in 3-D surface, else the "
        "others); strain: in colours of what springs bear",
        str,
        metavar="A,B",
    )
    status: bool = setting(True, "the status in the window, in pictures and films", bool)
    meters: bool = setting(False, "show meters in the window, in pictures and films")
    beside: str | None = setting(
        None,
        "run the scene a second time beside the first, under the same mouse, with these settings; "
        "none: without the second one that a log has",
        str,
        metavar="KEY=VALUE,...",
    )
    error_meter: bool = setting(
        False,
        "measure how wrong each second is: another process makes it again at a finer step (a "
        "headless run waits for that)",
    )
    ghost: bool = setting(
        False,
        "draw where finer steps would be as a ghost, its distance magnified; measures as "
        "--error-meter does",
    )
    hold: str | None = setting(
        None,
        "choose method and substeps while it runs: the most accurate whose frames are in time "
        "(60fps, 12ms), or the cheapest with which each second's error is at most this (1%)",
        str,
        metavar="60fps|1%",
    )
    strict: bool = setting(
        False, "with --hold: end with status 1 where that was not held after a search of 3 seconds"
    )
    text_size: float | None = setting(
        None,
        "size of the text in windows, pictures and films, in parts of the usual (default: 1; in a "
        "window what the screen's settings want)",
        float,
        minimum=0.5,
        maximum=4,
        metavar="X",
    )
    paused: bool = setting(False, "start paused")
    quiet: bool = setting(False, "print nothing but errors")
    verbose: bool = setting(False, "say what a scene file leaves open, and what is taken for it")


def within_setting() -> Any:
    """The setting of a command that leaves out what does not fit in a time."""
    return setting(
        None,
        "leave out what does not fit in this time, and say what (60s, 5min)",
        str,
        metavar="TIME",
    )


def quick_setting() -> Any:
    """The setting beside it that says a minute in a word."""
    return setting(False, "the same as --within 60s")


def resume_setting() -> Any:
    """The setting of a sweep that goes on where an earlier run of it ended."""
    return setting(False, "go on with what an earlier run of the same command has finished")


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
    within: str | None = within_setting()
    quick: bool = quick_setting()
    json: bool = setting(False, "print JSON instead of tables")
    all: bool = setting(False, "explain all built-in scenes, and what a cloth's links cost")
    tables: str | None = setting(
        None, "with --all: fill a document's tables", str, metavar="FILE.md"
    )


@dataclass(frozen=True)
class CompareOptions(Options):
    """Settings of `compare`."""

    events: str | None = setting(
        None,
        "run a session again: as this log has it (A), and with one of the next four flags (B)",
        str,
        metavar="FILE.jsonl",
    )
    substeps: int | None = setting(
        None, "B: steps a frame", int, minimum=1, maximum=MOST_SUBSTEPS, metavar="N"
    )
    dt: float | None = setting(
        None,
        "B: time of a step, as the log's frames stay: the longest that is not longer and that "
        "divides them",
        float,
        above=0,
        metavar="X",
    )
    method: str | None = setting(None, "B: time-integration method", str, metavar="NAME")
    precision: str | None = setting(None, "B: floating-point numbers", str, choices=PRECISIONS)
    frames: int | None = setting(
        None,
        "frames to run (default: 60 past the log's last event)",
        int,
        minimum=1,
        maximum=100_000,
        metavar="N",
    )
    order: bool = setting(
        False, "run a third time, finer by as much again, and measure the order of convergence"
    )
    keep: str | None = setting(
        None, "folder that keeps the recordings of these runs", str, metavar="DIR"
    )
    within: str | None = setting(
        None,
        "how far apart is near enough (rms, at each frame): in the scene's unit, or with % in "
        "parts of the largest displacement; exit status 0 up to that, and else only for the same "
        "bits",
        str,
        metavar="X|X%",
    )
    picture: str | None = setting(None, "draw the distance over time", str, metavar="FILE.png|svg")
    json: bool = setting(False, "print nothing but JSON")


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
