"""The command line: ``taichi-cloth COMMAND``.

Which command is meant, its help, signals, and the exit status. Flags and help texts are made from
the settings that a command and the scenes declare. Anything a user gets wrong ends in one line and
exit status 2. Taichi is imported only once a run starts.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import signal
import sys
from collections.abc import Sequence
from typing import TextIO

from taichi_cloth import imports, signals
from taichi_cloth.errors import InputError, RunFailure, nearest
from taichi_cloth.files import pending
from taichi_cloth.scene.source import DEFAULT_SCENE, names_file
from taichi_cloth.settings import options, sweeps
from taichi_cloth.settings.options import PROGRAM
from taichi_cloth.version import __version__

COMMANDS = {
    "run": "run a scene, in a window or headless (the default command)",
    "list": "show scenes, methods and the backends usable here",
    "doctor": "show what this machine offers, and what each missing thing would need",
    "stability": "compute the largest stable steps of a scene, and find the real ones by runs",
    "trade": "measure a scene's error beside its cost, by method, step and precision",
    "tune": "find the cheapest setting that meets an error, or the best that fits a frame's time",
    "compare": "compare two recordings of a scene, or a session with a finer run of it",
    "bench": "measure speed, and beside it the error, here and beside other programs",
    "explain": "show what a scene uses, what is compiled for it, and what each feature costs",
}
# Commands are imported when they are started: help must not wait for what a run needs.
# Those on a scene: the module whose main(source, options) does it, and the class of its settings.
SCENE_COMMANDS: dict[str, tuple[str, type[options.Options]]] = {
    "run": ("taichi_cloth.cli.run", options.RunOptions),
    "stability": ("taichi_cloth.stability.command", sweeps.StabilityOptions),
    "trade": ("taichi_cloth.advice.trade", sweeps.TradeOptions),
    "tune": ("taichi_cloth.advice.tune", sweeps.TuneOptions),
    "explain": ("taichi_cloth.explain.command", options.ExplainOptions),
}
# Those that read their words themselves: the module whose main(words) does it.
OWN_WORDS = {"bench": "taichi_cloth.cli.bench", "compare": "taichi_cloth.cli.compare"}
# Those that take no words: the module whose main() does it.
PLAIN_COMMANDS = {"list": "taichi_cloth.cli.listing", "doctor": "taichi_cloth.cli.doctor"}


INTERRUPTED = f"{PROGRAM}: interrupted"
# Of Taichi 1.7.4, CUDA and Vulkan.
_REFUSED_MEMORY = re.compile(r"memory allocation (\(\d+ B\) |has )?failed|OUT_OF_(\w+_)?MEMORY")


def main(arguments: Sequence[str] | None = None) -> int:
    """Do what the command line says; return the exit status."""
    _open_closed_streams()
    # Taichi's banner, and its question for a newer version, are not what the user asked for.
    os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")
    os.environ.setdefault("TI_SKIP_VERSION_CHECK", "ON")
    # Matrices are small here: threads of OpenBLAS would wait for each other, and for Taichi's.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # A file's name may hold what the terminal's encoding lacks.
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
    words = list(sys.argv[1:] if arguments is None else arguments)
    # A terminated run ends like an interrupted one: with its files saved.
    with signals.taken(
        INTERRUPTED, pending.discard_all, gives_back=arguments is not None
    ) as ending:
        return _status(words, ending)


def _status(arguments: Sequence[str], ending: signals.Ending | None) -> int:
    """Do what the words say, and tell how it ended; the exit status.

    ending: knows of the signals that came, if it hears them.
    """
    try:
        status = _dispatch(arguments)
        sys.stdout.flush()
        signals.check()
        return status
    except (InputError, RunFailure) as error:
        _say_error(str(error))
        return error.exit_status
    except KeyboardInterrupt as interrupt:
        return _interrupted(interrupt, ending)
    except BrokenPipeError:
        # The reader went away (`| head`). Python would complain once more at exit.
        _abandon(sys.stdout)
        return 141
    except OSError as error:  # a full disk, mostly
        _say_error(f"{error.filename or _somewhere()}: {error.strerror or error}")
        with contextlib.suppress(OSError):
            _abandon(sys.stdout)
        return 3
    except Exception as error:
        # While a library's compiled part is imported, an interrupt comes as that one's failure.
        if (behind := _interrupt_behind(error)) is not None:
            return _interrupted(behind, ending)
        if not _lacks_memory(error):
            raise
        _say_error(f"there is not enough memory ({error}); take fewer particles, or less beside it")
        return 3
    finally:
        try:
            sys.stderr.flush()
        except OSError:  # what could not be said there changes no status
            with contextlib.suppress(OSError):
                _abandon(sys.stderr)


def _open_closed_streams() -> None:
    """Let standard streams that were closed from the start (`>&-`) lead nowhere: Python has none
    for them, and the next file that is opened would take their number, and what is printed.
    """
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass
    os.close(number)
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115


def _say_error(text: str) -> None:
    """One line on standard error, if that can be written to."""
    with contextlib.suppress(OSError):
        print(f"{PROGRAM}: error: {' '.join(text.split())}", file=sys.stderr, flush=True)


def _somewhere() -> str:
    """The likely place of a system's error that does not say it."""
    try:
        os.getcwd()
    except OSError:
        return "the current folder, which was removed; change to another one"
    return "standard output, a file or a temporary one (TMPDIR)"


def _abandon(stream: TextIO) -> None:
    """Let go what could not be written to a stream; Python would complain once more at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _lacks_memory(error: Exception) -> bool:
    """True if the system refused memory, to Python or to Taichi, which has an error for all."""
    of_taichi = isinstance(error, RuntimeError) and _REFUSED_MEMORY.search(str(error))
    return isinstance(error, MemoryError) or bool(of_taichi)


def _interrupted(interrupt: KeyboardInterrupt, ending: signals.Ending | None) -> int:
    """Say that it was; the exit status."""
    if ending:
        ending.tell(_tell)
    else:
        _tell()
    return 128 + int(interrupt.args[0] if interrupt.args else signal.SIGINT)


def _tell() -> None:
    with contextlib.suppress(OSError):
        print(INTERRUPTED, file=sys.stderr, flush=True)


def _interrupt_behind(error: BaseException | None) -> KeyboardInterrupt | None:
    """The interrupt that an import has made an error of, if one has."""
    if not isinstance(error, (ImportError, SystemError)):
        return None
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error


def _dispatch(arguments: Sequence[str]) -> int:
    """Start the command that is asked for; without one, a run. Returns its exit status."""
    if arguments[:1] in (["-h"], ["--help"]):
        print(_help())
        return 0
    if arguments[:1] == ["--version"]:
        print(f"{PROGRAM} {__version__}")
        return 0
    if not arguments or arguments[0].startswith("-"):
        arguments = ["run", *arguments]
    command, *rest = arguments
    if command in SCENE_COMMANDS:
        return _start_on_scene(command, rest)
    if command in PLAIN_COMMANDS:
        return _start_plain(command, rest)
    if command in OWN_WORDS:
        main = imports.module(OWN_WORDS[command]).main
        with signals.raising():
            status: int = main(rest)
        return status
    raise InputError(f"unknown command '{command}'; {_command_hint(command)}")


def _start_on_scene(command: str, arguments: Sequence[str]) -> int:
    from taichi_cloth.cli import scene_command

    module, settings = SCENE_COMMANDS[command]
    about = "" if command == "run" else f"{COMMANDS[command].capitalize()}.\n"
    words = scene_command.read(command, settings, arguments, about)
    if words is None:
        return 0
    main = imports.module(module).main
    signals.check()
    # A run ends between two frames. Studies keep what is finished, and end anywhere.
    with contextlib.nullcontext() if command == "run" else signals.raising():
        status: int = main(*words)
    return status


def _start_plain(command: str, arguments: Sequence[str]) -> int:
    if list(arguments) in (["-h"], ["--help"]):
        from taichi_cloth.settings.arguments import laid_out

        print(laid_out(f"usage: {PROGRAM} {command}\n\n{COMMANDS[command].capitalize()}."))
        return 0
    if arguments:
        raise InputError(f"{command}: unexpected '{arguments[0]}'; it takes no arguments")
    status: int = imports.module(PLAIN_COMMANDS[command]).main()
    return status


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
    from taichi_cloth.settings.arguments import laid_out

    commands = "\n".join(f"  {name:10} {says}" for name, says in COMMANDS.items())
    others = [name for name in SCENE_COMMANDS if name != "run"]
    return laid_out(
        f"usage: {PROGRAM} [run] [SCENE | FILE.toml | MESH.obj] [flags]\n"
        f"       {PROGRAM} {' | '.join(others)} [SCENE | FILE.toml | MESH.obj] [flags]\n"
        f"       {PROGRAM} compare A.npz B.npz | [SCENE] --events FILE.jsonl [flags]\n"
        f"       {PROGRAM} bench [PART ...] [flags]\n"
        f"       {PROGRAM} list | doctor | --version | --help\n\n"
        "An interactive cloth and spring-mass simulator.\n\n"
        f"commands:\n{commands}\n\n"
        f"Without a command it runs the scene '{DEFAULT_SCENE}'.\n"
        f"'{PROGRAM} run --help' shows all flags of a run, '{PROGRAM} run SCENE --help' those of "
        "a scene, too.\n\n"
        "exit status: 0 done, 1 tune: no setting was confirmed, compare: they differ, "
        "2 the input was refused, 3 the simulation failed"
    )
