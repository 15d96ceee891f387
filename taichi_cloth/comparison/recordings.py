"""Two recordings as they are compared: whether they go together, and at which frames."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from taichi_cloth.errors import InputError, counted
from taichi_cloth.files import trajectory
from taichi_cloth.files.trajectory import Saved
from taichi_cloth.scene.rules import refuse_changed
from taichi_cloth.scene.source import SceneSource
from taichi_cloth.trade.errors import Samples

LOST = 1e150  # no square of a longer way is a number: a particle that far is nowhere
SAME_TIME = 1e-6  # of the shortest frame: times as near as this are one, however they were added up
# What of a run's settings is shown beside the other's.
SETTINGS = (
    *("scene", "arguments", "scene_hash", "method", "dt", "substeps", "tolerance", "iterations"),
    *("precision", "arch", "topology", "lanes", "execution", "version"),
)


@dataclass(frozen=True)
class Recording:
    """A recording as it is compared.

    label: what it is called in sentences, such as its file's name. saved: its arrays. start:
    (n, dim) where its particles began: at the scene's start, or where they were seen first. fixed:
    (n,) bool, which particles were fixed at the start.
    """

    label: str
    saved: Saved
    start: np.ndarray
    fixed: np.ndarray

    @classmethod
    def read(cls, source: Saved | str | Path, label: str) -> Recording:
        """The recording at a path, or one that was read; label: of one without a path.

        InputError where there is none, for one without a frame, and for one in which a particle
        is lost: how far that is from anything is no number.
        """
        saved = source if isinstance(source, Saved) else trajectory.load(source)
        label = label if isinstance(source, Saved) else str(source)
        k, n, dim = saved.position.shape
        if k == 0:
            raise InputError(f"{label}: has no frame; record at least one")
        later = saved.time[1:] > saved.time[:-1]
        if not (later.all() and np.isfinite(saved.time).all()):
            raise InputError(f"{label}: is damaged: its times do not grow from frame to frame")
        _refuse_lost(saved, label)
        there = ~np.isnan(saved.position).any(axis=2)
        seen = saved.position[there.argmax(axis=0), np.arange(n)]
        start = np.full((n, dim), np.nan) if saved.start is None else saved.start
        start = np.where(np.isnan(start), seen, start)
        fixed = saved.fixed
        if fixed is None:  # of an earlier version: what never moved
            fixed = ((saved.position == seen) & (saved.velocity == 0)).all(axis=(0, 2))
        return cls(label, saved, start, fixed)

    @property
    def scene(self) -> str | None:
        """The name of its scene; None where nobody said."""
        name = self.saved.meta.get("scene")
        return name if isinstance(name, str) else None

    def settings(self) -> dict[str, Any]:
        """Facts of its run, by the names of `SETTINGS`."""
        meta = self.saved.meta
        versions = meta.get("versions")
        version = versions.get("taichi_cloth") if isinstance(versions, dict) else None
        arguments = meta.get("arguments")
        words = " ".join(map(str, arguments)) if isinstance(arguments, list) else ""
        known = {**meta, "version": version, "arguments": words or None}
        if meta.get("dt_auto"):
            known |= {"substeps": f"{known.get('substeps')} at the end (--dt auto)"}
        return {name: known[name] for name in SETTINGS if known.get(name) is not None}

    def samples(self, frames: np.ndarray) -> Samples:
        """Its start and its frames with these indices, (k,), as `trade` has them."""
        saved = self.saved
        whole = np.ones((1, len(saved.spring)), bool)
        return Samples(
            x=np.concatenate([self.start[None], saved.position[frames]]),
            v=np.concatenate([np.zeros_like(self.start)[None], saved.velocity[frames]]),
            alive=np.concatenate([whole, self._unbroken()[frames]]),
        )

    def _unbroken(self) -> np.ndarray:
        """Which springs hold, or are still to come with a particle that is, (k, springs) bool."""
        saved = self.saved
        began = saved.position[0] if saved.start is None else saved.start
        later = np.isnan(began).any(axis=1)[saved.spring].any(axis=1)
        came: np.ndarray = np.logical_or.accumulate(saved.spring_alive, axis=0)
        unbroken: np.ndarray = saved.spring_alive | (later & ~came)
        return unbroken


@dataclass(frozen=True)
class Pair:
    """Two recordings of the same particles, and the frames that they have at the same times.

    a_frames, b_frames: indices into the frames of each, (k,).
    """

    a: Recording
    b: Recording
    a_frames: np.ndarray
    b_frames: np.ndarray

    @classmethod
    def of(cls, a: Recording, b: Recording) -> Pair:
        """Put two recordings side by side; InputError, which says what differs, if they cannot."""
        check_same_particles(a, b)
        check_same_rules(a, b)
        step = min(_shortest(a.saved.time), _shortest(b.saved.time))
        slack = SAME_TIME * step if np.isfinite(step) else SAME_TIME * abs(a.saved.time[0])
        at = np.searchsorted(b.saved.time, a.saved.time - slack)
        near = at.clip(max=len(b.saved.time) - 1)
        same = np.abs(b.saved.time[near] - a.saved.time) <= slack
        if not same.any():
            raise InputError(
                f"{a.label} and {b.label} have no frame at the same time: {_frames(a)}, "
                f"{_frames(b)}; record both with the same --dt and --every, or one with a whole "
                "number of the other's frames in each of its own"
            )
        return cls(a, b, np.flatnonzero(same), near[same])

    @property
    def time(self) -> np.ndarray:
        """The times of the frames that both have, (k,)."""
        time: np.ndarray = self.a.saved.time[self.a_frames]
        return time

    def samples(self) -> tuple[Samples, Samples]:
        """Start and common frames of both."""
        return self.a.samples(self.a_frames), self.b.samples(self.b_frames)


def check_same_particles(a: Recording, b: Recording) -> None:
    """Raise InputError, which says what differs, unless both record the same particles."""
    (_, n, dim), (_, m, other_dim) = a.saved.position.shape, b.saved.position.shape
    differ = []
    if n != m:
        differ.append(f"{counted(n, 'particle')} and {m}")
    if dim != other_dim:
        differ.append(f"{dim}-D and {other_dim}-D")
    springs = len(a.saved.spring), len(b.saved.spring)
    if springs[0] != springs[1]:
        differ.append(f"{counted(springs[0], 'spring')} and {springs[1]}")
    elif not differ and not np.array_equal(a.saved.spring, b.saved.spring):
        differ.append("springs between other particles")
    named = a.scene is not None and b.scene is not None and a.scene != b.scene
    if named and (differ or springs[0] == 0):  # springs show that a renamed scene is the same one
        differ.insert(0, f"scenes '{a.scene}' and '{b.scene}'")
    if differ:
        raise InputError(
            f"{a.label} and {b.label} are not of the same particles: {', '.join(differ)}; "
            "compare two runs of one scene"
        )


def check_same_rules(a: Recording, b: Recording) -> None:
    """Raise InputError where the rules of their scene have changed between the two."""
    models = [of.saved.meta.get("model", 1) for of in (a, b)]
    if models[0] == models[1]:
        return
    older, newer = (a, b) if models[0] < models[1] else (b, a)
    try:
        scene = SceneSource.from_json(newer.saved.meta["scene_source"]).build()
    except (InputError, KeyError, TypeError):  # its file is not there any more, or says another
        return
    refuse_changed(
        scene, {**older.saved.meta, "version": older.settings().get("version")}, older.label
    )


def _refuse_lost(saved: Saved, label: str) -> None:
    """Raise InputError, which says who and when, where a particle's place or speed is no number.

    Before a particle exists its rows are NaN, all of them.
    """
    nan = np.isnan(saved.position).all(axis=2) & np.isnan(saved.velocity).all(axis=2)
    to_come = np.logical_and.accumulate(nan, axis=0)
    for what, values in (("position", saved.position), ("velocity", saved.velocity)):
        lost = ~(np.abs(values) < LOST).all(axis=2) & ~to_come
        if lost.any():
            k, particle = np.argwhere(lost)[0]
            where = ", ".join(f"{number:g}" for number in values[k, particle])
            raise InputError(
                f"{label}: particle {particle} is lost in frame {saved.frame[k]}: its {what} is "
                f"({where}); record again, up to the frame before"
            )


def _shortest(times: np.ndarray) -> float:
    return float(np.diff(times).min()) if len(times) > 1 else np.inf


def _frames(of: Recording) -> str:
    """Times of a recording's frames."""
    times = of.saved.time
    if len(times) == 1:
        return f"that of {of.label} is at {times[0]:g}"
    return (
        f"those of {of.label} are from {times[0]:g} to {times[-1]:g}, {times[1] - times[0]:g} apart"
    )
