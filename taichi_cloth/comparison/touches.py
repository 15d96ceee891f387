"""The first touch that two runs do not share, from their positions and their scenes' geometry.

A run records no touches, and need not: what lies on a surface at the end of a frame, or came to one
and left it within the frame, is seen afterwards (`scene.penetration.touching`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taichi_cloth.comparison.recordings import Pair, Recording
from taichi_cloth.errors import InputError
from taichi_cloth.scene.fingerprint import scene_hash
from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.penetration import Moment, touches, touching
from taichi_cloth.scene.solids import Solid, solids
from taichi_cloth.scene.source import SceneSource
from taichi_cloth.trade.errors import Samples

MOST = 20_000_000  # particles times frames that are looked through: a minute or so


class Unknown(Exception):
    """Why nothing is known of touches: a clause."""


@dataclass(frozen=True)
class FirstTouch:
    """A touch that two runs do not share.

    particle: who touches; thing: what, 'ground', 'obstacle 0', 'left wall' or 'particle 7'.
    a, b: the frames of both, counted from 0, the start, among those that they have in common, at
    whose end it is seen first; None: in none. others: how many more differ in that frame.
    """

    particle: int
    thing: str
    a: int | None
    b: int | None
    others: int


@dataclass(frozen=True)
class Touches:
    """The finding: the first touch of each run, as a frame as in `FirstTouch`, None where there
    is none, and the first that they do not share. In a scene where nothing can touch, all None.
    """

    a: int | None = None
    b: int | None = None
    differing: FirstTouch | None = None


def scene_of(recording: Recording) -> Scene:
    """The scene of a recording as it was at the start, made again; raises Unknown."""
    meta, label = recording.saved.meta, recording.label
    if not isinstance(meta.get("scene_source"), dict):
        raise Unknown(f"{label} does not say how its scene is made")
    try:
        scene = SceneSource.from_json(meta["scene_source"]).build()
    except InputError as error:
        raise Unknown(f"the scene of {label} cannot be made again: {error}") from None
    except (KeyError, TypeError, ValueError):
        raise Unknown(f"{label} does not say how its scene is made") from None
    if scene_hash(scene) != meta.get("scene_hash"):
        raise Unknown(f"the scene of {label} is another one now than when it was recorded")
    return scene


def find(pair: Pair, scenes: tuple[Scene, Scene]) -> Touches:
    """Look through the frames that both have, up to the first touch that they do not share.

    Raises Unknown where that would take too long.
    """
    a, b = pair.samples()
    things: list[str] = []
    times = np.concatenate([[0.0], pair.time])
    runs = [_Run(scene, of, times, things) for scene, of in zip(scenes, (a, b), strict=True)]
    if not any(run.can_touch for run in runs):
        return Touches()
    if any(len(scene.particles) > a.x.shape[1] for scene in scenes):
        raise Unknown("the recordings have fewer particles than the scene")
    if a.x.shape[0] * a.x.shape[1] > MOST:
        raise Unknown("there are too many particles and frames to look for touches")
    first: list[int | None] = [None, None]
    ever = [np.zeros(0, np.int64)] * 2
    differing: FirstTouch | None = None
    for frame in range(len(times)):
        for k, run in enumerate(runs):
            seen = run.codes(frame)
            if len(seen) and first[k] is None:
                first[k] = frame
            ever[k] = np.union1d(ever[k], seen)
        apart = np.setxor1d(ever[0], ever[1])
        if len(apart):
            code = int(apart[0])
            differing = _seen_later(runs, code, frame, len(apart) - 1, code in ever[0])
            break
    for k, run in enumerate(runs):
        if differing is not None and first[k] is None:
            first[k] = run.first(frame + 1)
    return Touches(first[0], first[1], differing)


def _seen_later(runs: list[_Run], code: int, frame: int, others: int, in_a: bool) -> FirstTouch:
    """The touch `code` that one run has at `frame`, with the frame at which the other has it."""
    other = runs[1] if in_a else runs[0]
    later = other.first(frame + 1, code)
    particle, thing = runs[0].words(code)
    seen = (frame, later) if in_a else (later, frame)
    return FirstTouch(particle, thing, seen[0], seen[1], others)


class Contacts:
    """Touching pairs in runs of a scene, as numbers that several runs share.

    things: names of what is touched, which these runs share, to which a scene's are added. A
    particle i on thing t is t n + i; the pair i, j is -(i n + j) - 1.

    possible: whether anything can touch.
    """

    def __init__(self, scene: Scene, things: list[str]) -> None:
        self._scene, self._things = scene, things
        self._solids: list[Solid] = solids(scene)
        self.possible = touches(scene, self._solids)
        self._n = len(scene.particles)

    def moment(self, x: np.ndarray, v: np.ndarray, time: float) -> Moment:
        """Positions and velocities (n or more, dim) at a time, of the scene's own particles."""
        return Moment(x[: self._n], v[: self._n], time)

    def codes(self, now: Moment, before: Moment | None) -> np.ndarray:
        """Pairs that touch now, or bounced since a frame before, ascending."""
        if not self.possible:
            return np.zeros(0, np.int64)
        found = touching(self._scene, self._solids, now, before)
        codes = [-(found.pairs @ np.array([self._n, 1])) - 1]
        for name, particles in found.things.items():
            if name not in self._things:
                self._things.append(name)
            codes.append(self._things.index(name) * self._n + particles)
        ascending: np.ndarray = np.unique(np.concatenate(codes).astype(np.int64))
        return ascending

    def words(self, code: int) -> tuple[int, str]:
        """The particle of a code, and what it touches."""
        if code < 0:
            i, j = divmod(-code - 1, self._n)
            return i, f"particle {j}"
        thing, particle = divmod(code, self._n)
        return particle, self._things[thing]


class _Run:
    """A run's scene, and what touches in its frames. samples: at `times`, (frames + 1,)."""

    def __init__(
        self, scene: Scene, samples: Samples, times: np.ndarray, things: list[str]
    ) -> None:
        self._contacts = Contacts(scene, things)
        self.can_touch, self.words = self._contacts.possible, self._contacts.words
        self._samples, self._times = samples, times

    def _moment(self, frame: int) -> Moment:
        x, v = self._samples.x[frame], self._samples.v[frame]
        return self._contacts.moment(x, v, float(self._times[frame]))

    def codes(self, frame: int) -> np.ndarray:
        """Pairs that touch at the end of a frame, or bounced within it, ascending."""
        before = self._moment(frame - 1) if frame else None
        return self._contacts.codes(self._moment(frame), before)

    def first(self, frame: int, code: int | None = None) -> int | None:
        """The first frame from `frame` on in which anything, or `code`, touches; None: in none."""
        for later in range(frame, len(self._times)):
            found = self.codes(later)
            if len(found) if code is None else code in found:
                return later
        return None
