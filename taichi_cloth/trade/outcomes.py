"""Outcomes of a study's settings, and how one says that it failed, or that the machine did."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from taichi_cloth.errors import InputError, RunFailure, counted
from taichi_cloth.measuring.worker import ENDED, WorkerFailed
from taichi_cloth.scene.model import Scene
from taichi_cloth.sweeps.within import Clock, rounded_up
from taichi_cloth.trade import reference
from taichi_cloth.trade.errors import Samples
from taichi_cloth.trade.settings import Setting

REFUSED = "InputError: "  # how a worker says that
UNTIMED = "no time came from "  # how a study says so of the machine that is timed alone
# How one says that the machine was at fault, and not the setting: a full disk, a killed process.
LOST = (ENDED, UNTIMED, "OSError: ", "MemoryError: ")
LOST_REMEDY = (
    "see that there is memory, and room for temporary files (TMPDIR) and in the folder of "
    "--output, and start again"
)
FOUR_TIMES = 4  # the time in which not even kernels were compiled, of which nothing is known
LONGER = 10.0  # times a run: a few of them, their timing, and how wrong they are
UNTIMED_REMEDY = "see that the scheduler and a worker there answer, and --resume"


@dataclass
class Outcome:
    """The outcome of a setting: its samples' file, its work, the seconds of each timed run, and the
    name of the machine that they were taken on.

    lost: whether it came to nothing because of the machine, such as a full disk. sampled_in:
    seconds that the run took of which there are samples; read_in: those in which they were read.
    """

    setting: Setting
    status: str = "ok"
    file: Path | None = None
    force_evaluations: int | None = None
    sweeps: int | None = None
    unconverged: int | None = None
    lost: bool = False
    seconds: list[float] = field(default_factory=list)
    timed_on: str = ""
    about: dict[str, Any] = field(default_factory=dict)
    sampled_in: float = 0.0
    read_in: float = 0.0

    @property
    def ok(self) -> bool:
        return self.status == "ok"

    def samples(self) -> Samples:
        """The states that it is judged by."""
        if self.file is None:
            raise ValueError(f"{self.setting.describe()}: {self.status}")
        return Samples.read(self.file)


class StudyFailure(RunFailure):
    """Not even the reference could be computed, or the machine failed."""


@dataclass
class Result:
    """The findings of a study, whole or, where it was interrupted, as far as it was finished.

    outcomes: of the settings, in their order; converged: those with a converged solver, by setting.
    interrupted: by what, which the caller raises once it has kept what was finished; None: whole.
    frames: that settings ran, None where none was to begin.
    clock: the time that it had; left_out: what did not fit in it, a line each. longest: seconds of
    the shortest run that was known not to fit.
    """

    scene: Scene
    outcomes: list[Outcome]
    converged: dict[Setting, Outcome]
    horizon: reference.Horizon | None
    reference: reference.Reference | None
    interrupted: KeyboardInterrupt | None = None
    frames: int | None = None
    clock: Clock = field(default_factory=Clock)
    left_out: list[str] = field(default_factory=list)
    longest: float = 0.0

    def check_some(self, asked: Clock) -> None:
        """Raise InputError where the time that was asked for was over before there was anything."""
        if not self.outcomes and not self.interrupted and asked.limited:
            more = f"try --within {rounded_up(FOUR_TIMES * asked.seconds)}"
            if self.longest:
                needed = rounded_up(asked.seconds + LONGER * self.longest)
                frames = counted(self.frames or 0, "frame")
                more = f"one takes {self.longest:.3g} s for {frames}; use about --within {needed}"
            raise InputError(
                f"--within {asked.describe()}: not one setting was finished by then; {more}, or "
                "fewer --frames"
            )

    def check_whole(self) -> None:
        """Raise StudyFailure where the machine lost settings: the others are no fair choice."""
        lost = [outcome for outcome in self.outcomes if outcome.lost]
        if lost:
            why = lost[0].status.removeprefix("failed: ")
            remedy = UNTIMED_REMEDY if why.startswith(UNTIMED) else LOST_REMEDY
            raise StudyFailure(
                f"{len(lost)} of {len(self.outcomes)} settings were lost, the first because {why}; "
                f"{remedy}"
            )


def failed_by(outcome: Outcome, failure: WorkerFailed) -> Outcome:
    """The outcome of a setting that a worker could not even make or run."""
    text = str(failure)
    outcome.status, outcome.lost = f"failed: {text}", text.startswith(LOST)
    if text.startswith(REFUSED):
        outcome.status = f"refused: {text.removeprefix(REFUSED)}"
    return outcome
