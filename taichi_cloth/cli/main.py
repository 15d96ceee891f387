"""The command line: ``taichi-cloth COMMAND``.

Settings of a run are declared in `options.RunOptions`, those of a scene by the scene itself; flags
and help texts are made from both. Anything a user gets wrong ends in one line and exit status 2.
Taichi is imported only once a run starts.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import signal
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taichi_cloth import __version__
from taichi_cloth.errors import InputError, SimulationFailure, nearest
from taichi_cloth.settings.arguments import (
    DEFAULT_SCENE,
    PROGRAM,
    Request,
    flag,
    flags_help,
    names_file,
    parse_scene_command,
    split,
)
from taichi_cloth.settings.options import HEADLESS_FRAMES, RunOptions, parameters_of

if TYPE_CHECKING:
    from taichi_cloth.files.trajectory import Trajectory
    from taichi_cloth.runtime import Device
    from taichi_cloth.scene.model import Scene
    from taichi_cloth.simulation.simulation import Simulation

COMMANDS = {
    "run": "run a scene, in a window or headless (the default command)",
    "list": "show scenes, methods and the backends usable here",
    "doctor": "show what this machine offers, and what each missing thing would need",
    "stability": "compute the largest stable steps of a scene, and find the real ones by runs",
    "trade": "measure a scene's error beside its cost, by method, step and precision",
    "tune": "find the cheapest setting that meets an error, or the best that fits a frame's time",
    "bench": "measure speed, and beside it the error, here and beside other programs",
    "explain": "show what a scene uses, what is compiled for it, and what each feature costs",
}
# Commands on a scene that keep to themselves: where each is, and the class of its settings.
SCENE_COMMANDS: dict[str, tuple[str, str]] = {
    "stability": ("taichi_cloth.stability.command", "StabilityOptions"),
    "trade": ("taichi_cloth.trade.command", "TradeOptions"),
    "tune": ("taichi_cloth.trade.tune", "TuneOptions"),
    "explain": ("taichi_cloth.explain.command", "ExplainOptions"),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Do what the command line says; return the exit status."""
    # Taichi's banner, and its question for a newer version, are not what the user asked for.
    os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")
    os.environ.setdefault("TI_SKIP_VERSION_CHECK", "ON")
    # A terminated run ends like an interrupted one: with its files saved.
    with contextlib.suppress(ValueError):  # not in the main thread
        signal.signal(signal.SIGTERM, _interrupt)
    try:
        status = _dispatch(list(sys.argv[1:] if arguments is None else arguments))
        sys.stdout.flush()
        return status
    except (InputError, SimulationFailure) as error:
        message = " ".join(str(error).split())
        print(f"{PROGRAM}: error: {message}", file=sys.stderr)
        return error.exit_status
    except KeyboardInterrupt as interrupt:
        print(f"{PROGRAM}: interrupted", file=sys.stderr)
        return 143 if interrupt.args == (signal.SIGTERM,) else 130
    except BrokenPipeError:
        # The reader went away (`| head`). Python would complain once more at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141


def _interrupt(*_):
    raise KeyboardInterrupt(signal.SIGTERM)


def _dispatch(arguments: list[str]) -> int:
    if not arguments or (
        arguments[0].startswith("-") and arguments[0] not in ("-h", "--help", "--version")
    ):
        return _run_command(arguments)
    command, *rest = arguments
    if command in ("-h", "--help"):
        print(_help())
    elif command == "--version":
        print(f"{PROGRAM} {__version__}")
    elif command == "run":
        return _run_command(rest)
    elif command == "bench":
        return _bench(rest)
    elif command in SCENE_COMMANDS:
        return _scene_command(command, rest)
    elif command in ("list", "doctor"):
        if rest in (["-h"], ["--help"]):
            print(f"usage: {PROGRAM} {command}\n\n{COMMANDS[command].capitalize()}.")
            return 0
        if rest:
            raise InputError(f"{command}: unexpected '{rest[0]}'; it takes no arguments")
        return _list() if command == "list" else _doctor()
    else:
        raise InputError(f"unknown command '{command}'; {_command_hint(command)}")
    return 0


def _command_hint(word: str) -> str:
    from taichi_cloth.scene import library

    if word in library.names() or names_file(word):
        return f"did you mean '{PROGRAM} run {word}'?"
    commands = {f"{PROGRAM} run {name}": name for name in library.names()}
    commands |= {name: name for name in COMMANDS}
    hint = nearest(word, commands.values())
    meant = next((c for c, name in commands.items() if hint == f"did you mean '{name}'?"), None)
    return f"did you mean '{meant}'?" if meant else f"known: {', '.join(COMMANDS)}"


def _help() -> str:
    commands = "\n".join(f"  {name:9} {says}" for name, says in COMMANDS.items())
    return (
        f"usage: {PROGRAM} [run] [SCENE | FILE.toml] [flags]\n"
        f"       {PROGRAM} {' | '.join(SCENE_COMMANDS)} [SCENE | FILE.toml] [flags]\n"
        f"       {PROGRAM} bench [PART ...] [flags]\n"
        f"       {PROGRAM} list | doctor | --version | --help\n\n"
        "An interactive cloth and spring-mass simulator.\n\n"
        f"commands:\n{commands}\n\n"
        f"Without a command it runs the scene '{DEFAULT_SCENE}'.\n"
        f"'{PROGRAM} run --help' shows all flags of a run, '{PROGRAM} run SCENE --help' those of "
        "a scene, too.\n\n"
        "exit status: 0 done, 2 the input was refused, 3 the simulation failed"
    )


# ------------------------------------------------------------------------------------------
# Running


def _run_command(arguments: Sequence[str]) -> int:
    request = parse_scene_command("run", RunOptions, arguments, "")
    if request is None:
        return 0
    options = _consistent(request.options)
    request = replace(request, options=options)
    if options.dt == "auto" and "substeps" in request.given:
        raise InputError("--substeps: --dt auto chooses them; give one of the two")
    scene = request.build()

    # Everything that can be refused is refused before Taichi starts, and leaves no file.
    from taichi_cloth.files import events
    from taichi_cloth.files.trajectory import Trajectory
    from taichi_cloth.ui import film, interaction

    log = interaction.load(options.events) if options.events else None
    if log:
        options = _as_recorded(request, log.header)
    for path, kind in ((options.image, film.Image), (options.video, film.Film)):
        if path:
            kind(path).discard()
    with contextlib.ExitStack() as unfinished:
        trajectory = Trajectory(options.save, options.every) if options.save else None
        if trajectory:
            unfinished.callback(trajectory.discard)
        recorder = events.Recorder(options.record) if options.record else None
        if recorder:
            unfinished.callback(recorder.discard)
        return _run(scene, options, log, recorder, trajectory)


def _as_recorded(request: Request, header: Mapping[str, Any]) -> RunOptions:
    """The options with the recording's dt, substeps and so on where none are given."""
    recorded = {
        name: header[name]
        for name in ("dt", "substeps", "method", "topology")
        if name in header and name not in request.given
    }
    if recorded.get("dt") == "auto" and "substeps" in request.given:
        del recorded["dt"]  # substeps of the user's own: of the scene's frames, too
    if request.options.dt == "auto":
        recorded.pop("substeps", None)
    return _consistent(replace(request.options, **recorded))


def _consistent(options: RunOptions) -> RunOptions:
    """The options with what follows from them filled in; refuses those that exclude each other."""
    from taichi_cloth.kernels.methods import METHODS

    if options.method not in METHODS:
        raise InputError(
            f"--method: unknown method '{options.method}'; {nearest(options.method, METHODS)}"
        )
    if options.headless:
        if options.view not in ("auto", "none"):
            raise InputError(f"--headless and --view {options.view} exclude each other; give one")
        options = replace(options, view="none")
    if options.threads is not None:
        if options.arch != "cpu":
            raise InputError(f"--threads: only --arch cpu takes it, not {options.arch}")
        if options.execution == "auto":
            path = "serial" if options.threads == 1 else "parallel"
            options = replace(options, execution=path)
    written: dict[str, str] = {}
    for name in ("record", "save", "image", "video"):
        path = getattr(options, name)
        if path is None:
            continue
        twin = written.setdefault(os.path.realpath(path), name)
        if twin != name and os.path.isfile(path) | (not os.path.exists(path)):
            raise InputError(f"--{twin} and --{name} would write the same file, {path}")
    return options


def _run(scene: Scene, options: RunOptions, log, recorder, trajectory: Trajectory | None) -> int:
    """Run a checked scene; finishes the recorder and the trajectory however the run ends."""
    import numpy

    from taichi_cloth import runtime
    from taichi_cloth.limits.auto_step import above_limit
    from taichi_cloth.simulation.simulation import Simulation
    from taichi_cloth.ui import app
    from taichi_cloth.ui.opening import open_view

    # Numbers that overflow are the watchdog's to report, in one line.
    numpy.seterr(all="ignore")
    device = runtime.start(
        options.arch, options.precision, options.threads, fast_math=options.fast_math
    )
    sim = Simulation(
        scene,
        method=options.method,
        dt=options.dt,
        substeps=options.substeps,
        execution=options.execution,
        topology=options.topology,
        tolerance=options.tolerance,
        iterations=options.iterations,
    )
    view = open_view(
        options.view,
        scene.world,
        size=options.size,
        title=f"{PROGRAM}: {scene.name}",
        pictures=bool(options.image or options.video),
    )
    with contextlib.closing(view):
        frames = options.frames
        if frames is None and not view.visible:
            frames = HEADLESS_FRAMES
        seed = options.seed
        if seed is None:
            seed = log.header.get("seed", 0) if log else 0
        if log:
            log.header["seed"] = seed
            _note_differences(log.header, app.log_header(sim, view, seed))
        if recorder:
            recorder.write_header(app.log_header(sim, view, seed, replay=log))
        if not options.quiet:
            print(_first_line(sim, device, view), flush=True)
            warning = above_limit(sim)
            if warning:
                print(f"{PROGRAM}: warning: {warning}", file=sys.stderr, flush=True)

        begin = time.perf_counter()
        failure = None
        try:
            summary = app.run(
                sim,
                view,
                frames=frames,
                replay=log,
                recorder=recorder,
                trajectory=trajectory,
                film=options.video,
                image=options.image,
                paused=options.paused,
                quiet=options.quiet,
                seed=seed,
                device=device.describe(),
            )
        except (KeyboardInterrupt, SimulationFailure) as error:
            failure = error
        if trajectory:
            if isinstance(failure, SimulationFailure):
                trajectory.record(sim, last=True)
            trajectory.save(_meta(sim, device))
        if recorder:
            recorder.close()
        if failure:
            raise failure
        if not options.quiet:
            print(_last_line(sim, summary, time.perf_counter() - begin))
            _note_unconverged(sim)
    return 0


def _first_line(sim: Simulation, device: Device, view) -> str:
    """Scene, method, dt, substeps, device, execution path and view."""
    steps = f"{sim.substeps} substep{'s' * (sim.substeps > 1)}"
    width, height = view.size
    window = f"window {view.name} {width}x{height}" if view.visible else "headless"
    return (
        f"{sim.scene.name}: {sim.particle_count} particles, {sim.spring_count} springs; "
        f"{sim.method}, dt {sim.dt:g}, {steps}; "
        f"{device.describe()}, {sim.execution} {sim.topology}; {window}"
    )


def _last_line(sim: Simulation, summary, seconds: float) -> str:
    """Frames, time a frame, steps a second, and the execution path."""
    frames = summary.frames
    if not frames:
        return f"0 frames in {seconds:.2f} s"
    done = f"{frames} frame{'s' * (frames > 1)} in {seconds:.2f} s"
    if frames == 1:
        return done
    a_frame = summary.simulate / (frames - 1)
    return (
        f"{done}: {1e3 * a_frame:.3g} ms a frame to simulate after the first, "
        f"{sim.substeps / a_frame:.4g} steps/s, {sim.execution} {sim.topology}"
    )


def _note_unconverged(sim: Simulation):
    """Say on standard error how many steps' solutions missed their tolerance."""
    work = sim.work()
    if work.unconverged:
        tolerance = sim.solver["tolerance"]
        print(
            f"{PROGRAM}: note: {work.unconverged} of {work.steps} steps did not converge to a "
            f"relative residual of {tolerance:g}; use a smaller step or a larger --tolerance",
            file=sys.stderr,
        )


def _note_differences(recorded: Mapping[str, Any], present: Mapping[str, Any]):
    """Say on standard error where a replay's settings are not those of the recording."""
    notes = [
        f"{key} {present[key]} (recorded: {recorded[key]})"
        for key in ("scene", "dt", "substeps", "method", "topology")
        if key in recorded and key in present and recorded[key] != present[key]
    ]
    if notes:
        print(f"{PROGRAM}: note: replaying with {', '.join(notes)}", file=sys.stderr)


def _meta(sim: Simulation, device: Device) -> dict[str, Any]:
    """What a saved trajectory says about its run."""
    import platform

    import numpy
    import taichi

    return {
        "scene": sim.scene.name,
        "method": sim.method,
        "dt": sim.dt,
        "substeps": sim.substeps,  # the last ones, where they follow the springs
        "dt_auto": sim.follows,
        "precision": device.precision,
        "arch": device.arch,
        "device": device.describe(),
        "execution": sim.execution,
        "topology": sim.topology,
        "versions": {
            "taichi_cloth": __version__,
            "taichi": ".".join(map(str, taichi.__version__)),
            "numpy": numpy.__version__,
            "python": platform.python_version(),
        },
    }


# ------------------------------------------------------------------------------------------
# Other commands


def _scene_command(command: str, arguments: Sequence[str]) -> int:
    from taichi_cloth.settings import options

    module, settings = SCENE_COMMANDS[command]
    about = COMMANDS[command].capitalize() + ".\n"
    request = parse_scene_command(command, getattr(options, settings), arguments, about)
    return 0 if request is None else importlib.import_module(module).main(request)


def _list() -> int:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    from taichi_cloth import runtime
    from taichi_cloth.kernels import methods
    from taichi_cloth.scene import library

    # A pipe or a file has no width: give whole sentences a line where they fit.
    console = Console() if sys.stdout.isatty() else Console(width=160)

    def table(*headers: str) -> Table:
        return Table(*headers, box=box.SIMPLE_HEAD, header_style="bold", pad_edge=False)

    shown = table("scene", "what it shows", "parameters")
    for name in library.names():
        parameters = (f"{flag(k)} {p.default}" for k, p in library.parameters(name).items())
        shown.add_row(name, library.description(name), "\n".join(parameters))
    console.print(shown)

    shown = table("method", "what it is")
    for name in methods.METHODS:
        shown.add_row(name, _summary_of(Path(methods.__path__[0], f"{name}.py")))
    console.print(shown)

    shown = table("backend", "usable here")
    for name, lack in runtime.usable_backends().items():
        shown.add_row(name, "yes" if lack is None else f"no: needs {lack}")
    console.print(shown)
    return 0


def _summary_of(path: Path) -> str:
    """The first line of a source file's docstring, read without running the file."""
    import ast

    docstring = ast.get_docstring(ast.parse(path.read_text("utf-8"))) or ""
    return docstring.partition("\n")[0]


def _doctor() -> int:
    from taichi_cloth.cli import doctor

    return doctor.main()


def _bench(arguments: Sequence[str]) -> int:
    from taichi_cloth import benchmarks
    from taichi_cloth.settings.options import BenchOptions

    parameters = parameters_of(BenchOptions)
    known = {flag(name): parameter for name, parameter in parameters.items()}
    switches = {word for word, parameter in known.items() if parameter.type is bool}
    texts, parts, wants_help = split(arguments, known, switches, "bench")
    if wants_help:
        listed = "\n".join(f"  {part:10} {benchmarks.summary(part)}" for part in benchmarks.PARTS)
        usage = f"{PROGRAM} bench [PART ...] [flags]"
        print(flags_help(usage, f"Parts (default: all):\n{listed}", {"flags": parameters}))
        return 0
    for part in parts:
        if part not in benchmarks.PARTS:
            raise InputError(f"bench: unknown part '{part}'; {nearest(part, benchmarks.PARTS)}")
    values = {
        word[2:]: True if word in switches else known[word].parse(word, text)
        for word, text in texts.items()
    }

    from taichi_cloth.benchmarks import command

    return command.main(parts, BenchOptions(**values))
