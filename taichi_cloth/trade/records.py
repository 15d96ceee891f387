"""A study's journal: which runs of which settings are finished, and what came of them."""

from __future__ import annotations

import platform
from dataclasses import astuple
from pathlib import Path
from typing import Any

import numpy as np

from taichi_cloth.scene.fingerprint import scene_hash
from taichi_cloth.scene.model import Scene
from taichi_cloth.sweeps.journal import Entry, Journal, key_of
from taichi_cloth.trade.ode import SmoothTrajectory
from taichi_cloth.trade.outcomes import Outcome
from taichi_cloth.trade.settings import Setting


class Records:
    """The runs of a study in a journal; frames: of a run."""

    def __init__(self, journal: Journal):
        self.journal = journal
        self._hashes: dict[int, tuple[Scene, str]] = {}

    # --- samples -------------------------------------------------------------------------

    def sampled(self, scene: Scene, setting: Setting, frames: int) -> Outcome | None:
        """The outcome of a setting, without its times; None where it was not run yet."""
        entry = self.journal.get(self.sample_key(scene, setting, frames))
        return None if entry is None else _outcome(setting, entry)

    def keep_sample(
        self,
        scene: Scene,
        setting: Setting,
        frames: int,
        found: dict[str, Any],
        about: dict[str, Any],
        file: Path,
    ) -> Outcome:
        """Keep what a `Trial` found, and its file."""
        key = self.sample_key(scene, setting, frames)
        return _outcome(setting, self.journal.add(key, result_of(found, about), file))

    def keep_failure(self, scene: Scene, setting: Setting, frames: int, outcome: Outcome) -> None:
        """Keep that a setting could not be run, unless the machine was at fault."""
        if not outcome.lost:
            self.journal.add(self.sample_key(scene, setting, frames), failure_of(outcome))

    # --- times ---------------------------------------------------------------------------

    def timed(self, scene: Scene, outcome: Outcome, frames: int) -> bool:
        """True if the times of a setting are known; they are then the outcome's."""
        entry = self.journal.get(self.time_key(scene, outcome.setting, frames))
        if entry is not None:
            _put_times(outcome, entry.result)
        return entry is not None

    def keep_times(
        self,
        scene: Scene,
        outcome: Outcome,
        frames: int,
        seconds: list[float],
        about: dict[str, Any],
    ) -> None:
        """Keep the seconds of a setting's runs on this machine."""
        kept = times_of(seconds, about)
        self.journal.add(self.time_key(scene, outcome.setting, frames), kept)
        _put_times(outcome, kept)

    # --- the differential equation -------------------------------------------------------

    def solved(self, scene: Scene, times: np.ndarray) -> SmoothTrajectory | None:
        """The smooth solution at these times; None where it was not computed yet."""
        entry = self.journal.get(self._solution_key(scene, times))
        if entry is None or entry.file is None:
            return None
        with np.load(entry.file) as file:
            return SmoothTrajectory(file["x"], file["v"], **entry.result)

    def keep_solution(self, scene: Scene, times: np.ndarray, solved: SmoothTrajectory) -> None:
        """Keep the smooth solution."""
        with self.journal.written(".npz") as file:
            np.savez(file, x=solved.x, v=solved.v)
        result = {"until": solved.until, "event": solved.event, "given_up": solved.given_up}
        self.journal.add(self._solution_key(scene, times), result, file)

    def _solution_key(self, scene: Scene, times: np.ndarray) -> str:
        return key_of("smooth", self._hash(scene), len(times), float(times[-1]))

    def sample_key(self, scene: Scene, setting: Setting, frames: int) -> str:
        """The key of a setting's samples."""
        return self._key("sample", scene, setting, frames)

    def time_key(self, scene: Scene, setting: Setting, frames: int) -> str:
        """The key of a setting's times."""
        return self._key("time", scene, setting, frames)

    def _key(self, kind: str, scene: Scene, setting: Setting, frames: int) -> str:
        return key_of(kind, self._hash(scene), *astuple(setting), frames)

    def _hash(self, scene: Scene) -> str:
        if id(scene) not in self._hashes:
            self._hashes[id(scene)] = scene, scene_hash(scene)
        return self._hashes[id(scene)][1]


def result_of(found: dict[str, Any], about: dict[str, Any]) -> dict[str, Any]:
    """The kept part of a `Trial`'s findings, and of its words on itself."""
    result = {name: of for name, of in found.items() if name != "failed"}
    return result | {"status": found["failed"] or "ok", "about": about}


def failure_of(outcome: Outcome) -> dict[str, Any]:
    """The kept part of a setting that could not be run."""
    return {"status": outcome.status, "about": outcome.about}


def times_of(seconds: list[float], about: dict[str, Any]) -> dict[str, Any]:
    """The kept seconds of runs on this machine, and the words of the `Trial` here."""
    return {"seconds": seconds, "host": platform.node(), "about": about}


def _put_times(outcome: Outcome, kept: dict[str, Any]) -> None:
    """Make times the outcome's; its device is then the one that was timed."""
    outcome.seconds, outcome.timed_on = kept["seconds"], kept["host"]
    outcome.about = kept["about"]


def _outcome(setting: Setting, entry: Entry) -> Outcome:
    return Outcome(setting, file=entry.file, **entry.result)
