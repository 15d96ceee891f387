"""`run --lanes`: which lanes a run takes, and compiling sixteen beside one that has eight."""

from __future__ import annotations

import contextlib
import pickle
import tempfile
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taichi_cloth import runtime
from taichi_cloth.cli import run_beside
from taichi_cloth.errors import InputError, one_line
from taichi_cloth.measuring import machine
from taichi_cloth.measuring.worker import Worker, WorkerFailed
from taichi_cloth.settings.options import HEADLESS_FRAMES, RunOptions

if TYPE_CHECKING:
    from taichi_cloth.scene.model import Scene
    from taichi_cloth.simulation.simulation import Simulation

EIGHT, SIXTEEN = "8", "16"
COMPILED = f"{__name__}:Compiled"
AFTER = 20.0  # seconds that a run must have gone on before anything is compiled beside it
NICE = 19  # all that is left of the processor is enough
# Particles times steps of a run without a window, above which sixteen lanes gain more than reading
# their kernels from the cache takes longer than those of eight: 2 ns each, and 0.2 to 0.3 s.
WORTH = 3e8
DOING = "compiling 16 lanes for later runs"
DONE = "16 lanes are there for later runs"


def consistent(options: RunOptions) -> RunOptions:
    """The options with the topology that sixteen lanes are of; refuses what has none."""
    if options.lanes != SIXTEEN or "lanes" not in options.given:
        return options
    if options.arch != "cpu":
        raise InputError(f"--lanes {SIXTEEN}: only --arch cpu has lanes, not {options.arch}")
    if options.topology == "graph":
        raise InputError(f"--lanes {SIXTEEN} and --topology graph exclude each other; give one")
    return replace(options, topology="lanes")


def word(lanes: object) -> str:
    """The word after `--lanes` for the lanes that a log or a checkpoint says it is of."""
    from taichi_cloth.simulation import sixteen

    return SIXTEEN if lanes == sixteen.LANES else EIGHT


def lanes_of(scene: Scene, options: RunOptions) -> int | str | None:
    """The lanes of a run, as `Simulation` takes them."""
    from taichi_cloth.kernels import methods
    from taichi_cloth.simulation import sixteen

    if runtime.current_device().arch != "cpu":
        return None  # a log of a run that had some may be replayed there
    most = methods.load(options.method).most_lanes(scene.world.dim)
    if options.lanes == SIXTEEN:
        if most is not None and most < sixteen.LANES:
            if "lanes" not in options.given:
                return None  # a log says it, of another method
            raise InputError(
                f"--lanes {SIXTEEN}: method {options.method} takes at most {most}; leave it out"
            )
        return sixteen.LANES
    return "auto" if _may_choose(options) and _lasts(scene, options) else None


def _may_choose(options: RunOptions) -> bool:
    """Whether a run may take sixteen lanes unasked.

    Bits of f32 may differ, so one that names its topology has eight, on every run; and runs beside
    each other have the same ones.
    """
    if options.lanes != "auto" or run_beside.asked(options) or options.hold:
        return False
    named = options.topology != "auto" and "lanes" not in options.given
    return not named and machine.vector_unit() == machine.WIDEST


def _lasts(scene: Scene, options: RunOptions) -> bool:
    """Whether a run is so long that other kernels may be worth the while."""
    from taichi_cloth.ui.opening import opens_window

    if options.frames is None and opens_window(options.view):
        return True
    steps = options.substeps * (options.frames or HEADLESS_FRAMES)
    return steps * len(scene.particles) >= WORTH


@contextlib.contextmanager
def compiled_beside(sim: Simulation, options: RunOptions) -> Iterator[None]:
    """Meanwhile compile the kernels of sixteen lanes, if the run has eight, lasts, and they pay.

    Another process does it, with what is left of the processor; it ends with the run at the latest.
    Whether it could is noted for `doctor`, and said to nobody else.
    """
    compiler = _compiler(sim, options)
    if compiler is None:
        yield
        return
    try:
        compiler.start()
        yield
    finally:
        compiler.end()


def _compiler(sim: Simulation, options: RunOptions) -> Compiler | None:
    """What compiles sixteen lanes for runs like this one; None: nothing does."""
    from taichi_cloth.simulation import sixteen

    if sim.topology != "lanes" or not _may_choose(options) or not _lasts(sim.scene, options):
        return None
    if sim.lanes >= sixteen.LANES or not sixteen.pays(sim.storage, sim.method):
        return None
    what = sim.kind_of_run()
    if sixteen.tried(what).failed >= sixteen.TRIES:
        return None
    return Compiler(sim, what)


class Compiler:
    """Has sixteen lanes compiled for the runs to come of a simulation's kind.

    what: the kind, as in `sixteen.Tried`.
    """

    def __init__(self, sim: Simulation, what: str) -> None:
        from taichi_cloth.simulation import sixteen

        device = runtime.current_device()
        self._sim, self._what = sim, what
        # As they are now: the run may change them, while a later one begins with them.
        self._scene = sim.scene
        self._asked = {
            "device": {
                "precision": device.precision,
                "threads": device.threads,
                "fast_math": device.fast_math,
            },
            "how": {
                "method": sim.method,
                "dt": sim.dt,
                "substeps": sim.substeps,
                "execution": sim.execution,
                "lanes": sixteen.LANES,
            },
        }
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._wait_and_compile, daemon=True)
        self._worker: Worker | None = None
        self._lock = threading.Lock()

    def start(self) -> None:
        """Compile after a while, in a thread that waits for another process."""
        self._thread.start()

    def end(self) -> None:
        """The run is over: what is not compiled by now is left."""
        with self._lock:
            self._ended.set()
            if self._worker:
                self._worker.kill()
        self._thread.join()

    def _wait_and_compile(self) -> None:
        from taichi_cloth.simulation import sixteen

        if self._ended.wait(AFTER):
            return
        self._sim.aside, why = DOING, ""
        try:
            done = self._compile()
        except (WorkerFailed, OSError) as error:
            # A process that the run's end has ended did not fail.
            done, why = False, "" if self._ended.is_set() else one_line(error)
        if done or why:
            sixteen.note(self._what, why)
        self._sim.aside = DONE if done else ""

    def _compile(self) -> bool:
        """Have a process of its own do it; False where the run ended before.

        Raises WorkerFailed.
        """
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as name:
            folder = Path(name)
            file = folder / "scene.pickle"
            file.write_bytes(pickle.dumps(self._scene))
            asked: dict[str, Any] = {**self._asked, "scene": str(file)}
            with self._lock:
                if self._ended.is_set():
                    return False
                self._worker = Worker(folder, {}, niceness=NICE)
            try:
                self._worker.ask(make=COMPILED, **{"as": "compiled", "with": asked})
            finally:
                self._worker.close()
        return True


class Compiled:
    """In the other process: compiles sixteen lanes as a run does, which leaves them in the cache.

    scene: a file with a pickled one. device: as `runtime.start` takes it. how: as `Simulation`.
    """

    def __init__(self, scene: str, device: dict[str, Any], how: dict[str, Any]) -> None:
        from taichi_cloth.simulation.simulation import Simulation

        runtime.start("cpu", **device)
        sim = Simulation(
            pickle.loads(Path(scene).read_bytes()),
            topology="lanes",
            compiling=lambda: None,  # so that it is listed what was compiled
            **how,
        )
        sim.advance(1)
        sim.positions(), sim.velocities(), sim.springs_alive()  # what runs read back, too
        if how["execution"] == "parallel":  # a run whose threads only wait goes on with one
            sim.load_as("lanes", "serial", sim.positions(), sim.velocities())
            sim.advance(1)
        runtime.stop()
