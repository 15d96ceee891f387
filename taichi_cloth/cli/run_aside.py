"""Compiling beside a run, in another process, kernels that run faster, for runs to come."""

from __future__ import annotations

import contextlib
import pickle
import tempfile
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taichi_cloth import runtime
from taichi_cloth.cli import run_kernels
from taichi_cloth.errors import one_line
from taichi_cloth.measuring.worker import Worker, WorkerFailed
from taichi_cloth.settings.options import RunOptions

if TYPE_CHECKING:
    from taichi_cloth.simulation.simulation import Simulation

COMPILED = f"{__name__}:Compiled"
AFTER = 20.0  # seconds that a run must have gone on before anything is compiled beside it
NICE = 19  # all that is left of the processor is enough


@dataclass(frozen=True)
class Faster:
    """Kernels that run faster than those that a run has.

    words: what they are called. what: they and the kind of run, as in `aside.Tried`. how: of a
    `Simulation` that has them, besides what it shares with the run's.
    """

    words: str
    what: str
    how: dict[str, Any]

    @property
    def doing(self) -> str:
        """A window's words while they are compiled."""
        return f"compiling {self.words} for later runs"

    @property
    def done(self) -> str:
        """Its words afterwards."""
        return f"{self.words} are there for later runs"


@contextlib.contextmanager
def compiled_beside(sim: Simulation, options: RunOptions) -> Iterator[None]:
    """Meanwhile compile kernels that run faster than the run's, where there are some, and it lasts.

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
    """The process that compiles for runs like this one; None: there is none."""
    from taichi_cloth.simulation import aside

    if not runtime.keeps_kernels():
        return None
    faster = _faster(sim, options)
    if faster is None or aside.tried(faster.what).failed >= aside.TRIES:
        return None
    return Compiler(sim, faster)


def _faster(sim: Simulation, options: RunOptions) -> Faster | None:
    """The kernels that are worth to be compiled for runs like this one, if any are.

    Those of sixteen lanes, where a run has eight, or those of the graph that are not compiled soon.
    """
    from taichi_cloth.simulation import sixteen

    if sim.hurries:
        return Faster("faster kernels", f"graph/{sim.kind_of_run()}", {"topology": "graph"})
    lasts = run_kernels.may_choose(options) and run_kernels.lasts(sim.scene, options)
    if sim.topology != "lanes" or sim.lanes >= sixteen.LANES or not lasts:
        return None
    if not sixteen.pays(sim.storage, sim.method):
        return None
    how = {"topology": "lanes", "lanes": sixteen.LANES}
    return Faster(f"{sixteen.LANES} lanes", sixteen.compiled_as(sim.kind_of_run()), how)


class Compiler:
    """Has kernels compiled for the runs to come of a simulation's kind."""

    def __init__(self, sim: Simulation, faster: Faster) -> None:
        device = runtime.current_device()
        self._sim, self._faster = sim, faster
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
                **faster.how,
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
        from taichi_cloth.simulation import aside

        if self._ended.wait(AFTER):
            return
        self._sim.aside, why = self._faster.doing, ""
        try:
            done = self._compile()
        except (WorkerFailed, OSError) as error:
            # A process that the run's end has ended did not fail.
            done, why = False, "" if self._ended.is_set() else one_line(error)
        if done or why:
            aside.note(self._faster.what, why)
        self._sim.aside = self._faster.done if done else ""

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
    """In the other process: compiles kernels as a run does, which leaves them in the cache.

    scene: a file with a pickled one. device: as `runtime.start` takes it. how: as `Simulation`.
    """

    def __init__(self, scene: str, device: dict[str, Any], how: dict[str, Any]) -> None:
        from taichi_cloth.simulation.simulation import Simulation

        runtime.start("cpu", **device)
        sim = Simulation(
            pickle.loads(Path(scene).read_bytes()),
            compiling=lambda: None,  # so that it is listed what was compiled
            **how,
        )
        sim.advance(1)
        sim.positions(), sim.velocities(), sim.springs_alive()  # what runs read back, too
        if how["execution"] == "parallel":  # a run whose threads only wait goes on with one
            sim.load_as(how["topology"], "serial", sim.positions(), sim.velocities())
            sim.advance(1)
        runtime.stop()
