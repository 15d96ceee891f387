"""The second run of ``taichi-cloth run --beside``: made, shown, told of, and kept in files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_cloth.beside import given as besides
from taichi_cloth.beside.given import Given
from taichi_cloth.console import percent
from taichi_cloth.errors import InputError, RunFailure, counted, milliseconds
from taichi_cloth.files.pending import is_device
from taichi_cloth.files.recordings import Recordings
from taichi_cloth.files.trajectory import Recordable
from taichi_cloth.render import style
from taichi_cloth.settings.options import RunOptions
from taichi_cloth.ui.chrome.beside import DistanceReading
from taichi_cloth.ui.text import Word

if TYPE_CHECKING:
    from taichi_cloth.beside.twin import Twin
    from taichi_cloth.simulation.simulation import Simulation

NAMES = "the left run", "the right run"
KEPT = ("save", "export")  # files that the second run has, too
SECOND = 60.0  # frames
SHOWN = 600  # frames of a graph of ten seconds


def asked(options: RunOptions) -> Given | None:
    """The settings of `--beside`; None: no second run. Raises InputError."""
    if options.beside is None or options.beside.strip() == besides.NONE:
        return None
    return besides.read(options.beside)


def path_of(path: str) -> str:
    """The file of the second run: NAME-beside.npz for NAME.npz; a device takes both."""
    first = Path(path)
    return path if is_device(first) else str(first.with_name(f"{first.stem}-beside{first.suffix}"))


def files_of(options: RunOptions) -> RunOptions:
    """The options with the files of the second run."""
    first = {name: getattr(options, name) for name in KEPT}
    paths: dict[str, Any] = {name: path and path_of(path) for name, path in first.items()}
    return replace(options, **paths)


class Beside:
    """Two runs side by side, as a window and the command line tell of them. twin: the second."""

    def __init__(self, twin: Twin) -> None:
        self.twin = twin

    @property
    def sim(self) -> Simulation:
        """The second run."""
        return self.twin.sim

    @property
    def spent(self) -> float:
        """Seconds that its last frame took."""
        return self.twin.spent

    @property
    def took(self) -> float:
        """Seconds that it took then to go along, with the look at how far the two are apart."""
        return self.twin.took

    def check(self) -> None:
        """Raise RunFailure where the second run has stopped."""
        failure = self.twin.failure
        if failure is not None:
            raise RunFailure(f"the run beside stopped, and the first went on: {failure}")

    def text(self) -> str:
        """Its words in a log's header: the settings given, with the topology that it has."""
        run = {**self.twin.given.run, "topology": self.sim.topology}
        return str(replace(self.twin.given, run=run))

    def names(self) -> tuple[str, str]:
        """Names of the two, by what they differ in."""
        from taichi_cloth.simulation import live

        first, own = self.twin.first, self.twin.own
        theirs = [live.setting(first, one.name).read(first) for one in own]
        return self._name(first, theirs), self._name(self.sim, [one.value for one in own])

    def _name(self, sim: Simulation, values: Sequence[object]) -> str:
        """The name of one of them. values: those of the scene's settings that the two differ in."""
        words = [sim.method, counted(sim.substeps, "substep")]
        run = self.twin.given.run
        words += [f"{name} {value:g}" for name, value in sim.solver.items() if name in run]
        both = self.twin.first, self.sim
        for name in ("topology", "execution"):  # which a log notes, also where they are the same
            if name in run and len({getattr(other, name) for other in both}) > 1:
                words.append(getattr(sim, name))
        for one, value in zip(self.twin.own, values, strict=True):
            times = "x" * one.times
            words.append(f"{one.name.replace('_', ' ')} {times}{_written(value)}")
        return ", ".join(words)

    def stopped(self) -> str:
        """Why the second one stands still; "": it does not."""
        return str(self.twin.failure or "")

    def reading(self) -> DistanceReading:
        """Their distance, in words."""
        watch = self.twin.watch
        now, rows = watch.now, watch.last(SHOWN)
        scale = watch.scale
        age = np.array([watch.frame - row.frame for row in rows]) / SECOND
        parts = np.array([[row.rms, row.max] for row in rows]).reshape(-1, 2) / scale
        value = percent(now.rms / scale) if now else "not known" if self.stopped() else "0 %"
        metres = bool(self.sim.scene.world.up)
        details = []
        if now:
            details = [f"rms {_length(now.rms, metres)}", f"largest {_length(now.max, metres)}"]
        return DistanceReading(value, tuple(details), style.INK, age, parts[:, 0], parts[:, 1])

    def finding(self) -> Word | None:
        """The first difference, in short."""
        if self.stopped():
            return Word(f"right stopped in frame {self.sim.frame + 1}", style.BAD, 1)
        event = self.twin.watch.first
        if event is None:
            return None
        from taichi_cloth.comparison import report

        words = report.in_short(event, ("left", "right"))
        return Word(f"first to differ: {words}, time {event.time:.5g}", style.WARN, 2)

    def findings(self, frames: int) -> list[str]:
        """Sentences on the whole run, of so many frames: what it cost, how far apart the two are,
        and what differed first.
        """
        from taichi_cloth.comparison import report

        watch = self.twin.watch
        distance, scale = watch.distance(), watch.scale
        at_end, over_all = distance.final_rms / scale, distance.trajectory / scale
        said = [
            f"at the end {percent(at_end)} apart (rms {distance.final_rms:.3g}, "
            f"largest {distance.final_max:.3g}); over all frames {percent(over_all)} "
            f"({distance.trajectory:.3g}), in parts of {watch.scale_is} in the right run, "
            f"{scale:.4g}"
        ]
        if distance.trajectory_max == 0.0:
            said = ["no particle was ever apart from itself"]
        if frames > 1:
            said.insert(
                0, f"beside it {milliseconds(self.twin.later[0] / (frames - 1))} ms a frame"
            )
        for event, things in ((watch.first_break, "breaks"), (watch.first_touch, "touches")):
            if event is not None:
                more = f"; {event.others} more differ in that frame" * bool(event.others)
                words = report.in_words(event, NAMES)
                said.append(f"the first of the {things} that differ: {words}{more}")
        if watch.touches_unknown:
            said.append(f"touches are not known: {watch.touches_unknown}")
        return said


def _written(value: object) -> str:
    if value is None:
        return "off"
    if isinstance(value, bool):
        return "on" if value else "off"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _length(value: float, metres: bool) -> str:
    return f"{1e3 * value:.3g} mm" if metres else f"{value:.3g}"


def begun(
    first: Simulation,
    options: RunOptions,
    make: Callable[[RunOptions], Simulation],
    paced: bool,
) -> Beside | None:
    """The second run beside a first one, from where that stands; None: nobody asked for one.

    make: a simulation of the same scene with other options. paced: whether frames must come in
    time. InputError where it cannot be, or has the first one's settings.
    """
    given = asked(options)
    if given is None:
        return None
    from taichi_cloth.beside.twin import Twin
    from taichi_cloth.kernels import methods

    method = given.run.get("method", first.method)
    taken = methods.load(method).claims.settings
    other = besides.options_of(options, given, first.dt, taken)
    resumed = options.resume is not None
    if resumed and method != first.method and "topology" not in {*given.run, *options.given}:
        other = replace(other, topology="auto")  # the checkpoint's is of its method
    try:
        sim = make(other)
    except InputError as error:
        raise InputError(f"--beside {given}: {error}") from None
    twin = Twin(first, sim, given, resumed)
    twin.check_differs()
    twin.watch.paced = paced
    return Beside(twin)


class BothRecordings(Recordings):
    """Recordings of two runs, each in files of its own. second: of the other one."""

    def __init__(self, first: Recordings, second: Recordings, beside: Simulation) -> None:
        super().__init__(first.trajectory, first.export)
        self.second, self._beside = second, beside

    def record(self, sim: Recordable, *, last: bool = False) -> None:
        """Take note of both runs' present frames."""
        super().record(sim, last=last)
        if self._beside.frame == sim.frame:  # else it stands still
            self.second.record(self._beside, last=last)

    def rewind(self, frame: int) -> None:
        """Forget the frames after `frame`, of both."""
        super().rewind(frame)
        self.second.rewind(frame)
