"""Two recordings of one scene: how far apart they are over time, and what differs first."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from taichi_cloth.comparison import touches
from taichi_cloth.comparison.recordings import Pair, Recording
from taichi_cloth.errors import InputError
from taichi_cloth.files.trajectory import Saved
from taichi_cloth.scene.model import Scene
from taichi_cloth.settings import accepted
from taichi_cloth.settings.options import WITHIN
from taichi_cloth.settings.parameters import error_limit
from taichi_cloth.trade import errors
from taichi_cloth.trade.errors import Distance, Samples

EXIST = "particles that exist"  # what differs, where one run has a particle and the other not yet


@dataclass(frozen=True)
class Difference:
    """The first frame in which two recordings have not the same bits.

    time: of its end; frame_a, frame_b: its numbers. what: 'position', 'velocity', 'springs that
    hold' or 'particles that exist'. particle: of those that differ there the one that is farthest
    from itself; of springs, None. distance: how far that is [length].
    """

    time: float
    frame_a: int
    frame_b: int
    what: str
    particle: int | None
    distance: float


@dataclass(frozen=True)
class Event:
    """A break or a touch that two runs do not share: the first there is.

    kind: 'break' or 'touch'. particles: a spring's two ends; who touches, and whom. spring: its
    number, None of a touch. thing: what is touched, 'ground', 'obstacle 0', 'left wall',
    'particle 7'; '' of a break. a, b: the end of the frame in which each run has it, among the
    frames that both have [time]; None: not in that run. others: how many more the two do not share,
    of touches those of the same frame.
    """

    kind: str
    particles: tuple[int, ...]
    spring: int | None
    thing: str
    a: float | None
    b: float | None
    others: int

    @property
    def time(self) -> float:
        """When the runs begin to differ in it."""
        return min(time for time in (self.a, self.b) if time is not None)


@dataclass(frozen=True)
class Comparison:
    """Two recordings, A and B, of one scene side by side; B is what A is measured against.

    a, b: what they are called. settings_a, settings_b: what is known of their runs. particles:
    how many are measured, those that are free. frames_a, frames_b: how many frames each has.

    time, frame_a, frame_b: (k,), of the frames that both have at the same time. rms, max: (k,),
    root of the mean square, and largest, distance of a particle [length]; farthest: (k,) int, the
    particle of the latter. scale: what parts are of, the largest displacement of a particle in B
    [length], and scale_is what that is. distance: over all these frames, as `trade` has it.

    identical: whether both have the same frames with the same bits. difference: the first frame of
    other bits, None where those that both have are the same.
    first_break, first_touch: the first that they do not share, None where there is none.
    break_a, break_b, touch_a, touch_b: when each run has its first one at all [time].
    touches_unknown: why nothing is known of touches; '': it is.

    within, relative: the limit, in parts of the scale or [length]. parted: the end of the first
    frame at which the rms distance is above it, or a particle is in one of them only [time]; None:
    there is none.
    """

    a: str
    b: str
    settings_a: dict[str, Any]
    settings_b: dict[str, Any]
    particles: int
    frames_a: int
    frames_b: int
    time: np.ndarray
    frame_a: np.ndarray
    frame_b: np.ndarray
    rms: np.ndarray
    max: np.ndarray
    farthest: np.ndarray
    scale: float
    scale_is: str
    distance: Distance
    identical: bool
    difference: Difference | None
    first_break: Event | None
    first_touch: Event | None
    break_a: float | None
    break_b: float | None
    touch_a: float | None
    touch_b: float | None
    touches_unknown: str
    within: float
    relative: bool
    parted: float | None

    @property
    def error(self) -> float:
        """The error of A against B, as `trade` has it: in parts of the scale."""
        return self.distance.trajectory / self.scale

    @property
    def limit(self) -> float:
        """The limit [length]."""
        return self.within * self.scale if self.relative else self.within


def compare(
    a: Saved | str | Path,
    b: Saved | str | Path,
    *,
    within: float | str = WITHIN,
    scene: Scene | None = None,
) -> Comparison:
    """Compare two recordings of one scene, frame by frame at the same times.

    a, b: paths of saved trajectories (`run --save`, `Trajectory.save`), or what `load_trajectory`
        read. B is what A is measured against: parts are of the largest displacement in B.
    within: beyond which rms distance the runs have parted: a length, or with % a part of that.
    scene: of both, to look for touches with; None: each is made again as its recording says.

    Raises InputError, in one line, for what is no recording, and for recordings of other particles
    or without a frame at the same time.
    """
    limit, relative = read_limit("within", within)
    of: Any = scene
    if not (of is None or isinstance(of, Scene)):
        raise InputError(f"compare: scene must be a Scene, is {accepted.shown(of)}")
    pair = Pair.of(Recording.read(a, "A"), Recording.read(b, "B"))
    of_a, of_b = pair.samples()
    free = ~(pair.a.fixed & pair.b.fixed)
    if not free.any():
        raise InputError(f"{pair.a.label}: has no particle that can move: nothing to compare")
    rms, largest, farthest = _distances(of_a, of_b, free)
    scale, scale_is = errors.extent(of_b, free, _diagonal(of_b))
    alone = (np.isnan(of_a.x[1:]) != np.isnan(of_b.x[1:])).any(axis=(1, 2))
    above = np.flatnonzero((rms > (limit * scale if relative else limit)) | alone)
    found, unknown = _touches(pair, scene)
    difference = _first_difference(pair)
    springs_a, springs_b = (errors.break_frames(of) for of in (of_a, of_b))
    frames = np.concatenate([[0.0], pair.time])
    same_frames = len(pair.time) == len(pair.a.saved.time) == len(pair.b.saved.time)
    return Comparison(
        a=pair.a.label, b=pair.b.label,
        settings_a=pair.a.settings(), settings_b=pair.b.settings(),
        particles=int(free.sum()),
        frames_a=len(pair.a.saved.time), frames_b=len(pair.b.saved.time),
        time=pair.time,
        frame_a=pair.a.saved.frame[pair.a_frames], frame_b=pair.b.saved.frame[pair.b_frames],
        rms=rms, max=largest, farthest=farthest, scale=scale, scale_is=scale_is,
        distance=errors.distance(of_a, of_b, free),
        identical=difference is None and same_frames, difference=difference,
        first_break=_first_break(pair, springs_a, springs_b, frames),
        first_touch=_first_touch(found, frames),
        break_a=_when(errors.first_frame(springs_a), frames),
        break_b=_when(errors.first_frame(springs_b), frames),
        touch_a=_when(found.a, frames), touch_b=_when(found.b, frames),
        touches_unknown=unknown,
        within=limit, relative=relative,
        parted=float(pair.time[above[0]]) if len(above) else None,
    )  # fmt: skip


def read_limit(name: str, given: float | str) -> tuple[float, bool]:
    """A limit, and whether it is a part: a number, or a text 'X' or 'X%'. Raises InputError."""
    if isinstance(given, str):
        return error_limit(name, given)
    return accepted.number(name, given, above=0), False


def _distances(
    a: Samples, b: Samples, free: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """rms, largest and farthest particle of each frame but the start, (k,)."""
    rms, largest = (of(a, b, free)[1:] for of in (errors.rms_by_frame, errors.max_by_frame))
    square = np.nan_to_num(errors.squares(a, b, free)[1:], nan=-1.0)
    return rms, largest, np.flatnonzero(free)[square.argmax(axis=1)]


def _diagonal(samples: Samples) -> float:
    """The length through what a recording shows; 1 where that is a point."""
    x = samples.x[~np.isnan(samples.x).any(axis=2)]
    return float(np.linalg.norm(np.ptp(x, axis=0))) or 1.0


def _first_difference(pair: Pair) -> Difference | None:
    a, b, i, j = pair.a.saved, pair.b.saved, pair.a_frames, pair.b_frames
    bits = {
        name: (_bits(getattr(a, name)[i]) != _bits(getattr(b, name)[j])).any(axis=-1)
        for name in ("position", "velocity")
    }
    springs = (a.spring_alive[i] != b.spring_alive[j]).any(axis=1)
    other = np.flatnonzero(bits["position"].any(axis=1) | bits["velocity"].any(axis=1) | springs)
    if not len(other):
        return None
    k = int(other[0])
    what, particle, distance = "springs that hold", None, 0.0
    x, y = a.position[i[k]], b.position[j[k]]
    for name, differ in bits.items():
        if differ[k].any():
            away = np.linalg.norm(x - y, axis=1)
            exists = np.isnan(x).any(axis=1) != np.isnan(y).any(axis=1)
            what = EXIST if exists.any() else name
            among = np.flatnonzero(exists if exists.any() else differ[k])
            particle = int(among[np.nan_to_num(away[among]).argmax()])
            distance = float(np.nan_to_num(away[particle]))
            break
    time, frames = float(pair.time[k]), (int(a.frame[i[k]]), int(b.frame[j[k]]))
    return Difference(time, frames[0], frames[1], what, particle, distance)


def _bits(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, np.float64).view(np.int64)


def _first_break(pair: Pair, a: np.ndarray, b: np.ndarray, times: np.ndarray) -> Event | None:
    """a, b: the frame in which each spring broke, (s,), -1 for those that hold."""
    differ = np.flatnonzero(a != b)
    if not len(differ):
        return None
    never = len(times)
    first = np.minimum(np.where(a < 0, never, a), np.where(b < 0, never, b))[differ]
    spring = int(differ[first.argmin()])
    ends = tuple(map(int, pair.a.saved.spring[spring]))
    when = [_when(int(frame) if frame >= 0 else None, times) for frame in (a[spring], b[spring])]
    return Event("break", ends, spring, "", when[0], when[1], len(differ) - 1)


def _first_touch(found: touches.Touches, times: np.ndarray) -> Event | None:
    one = found.differing
    if one is None:
        return None
    whom = one.thing.removeprefix("particle ")
    others = (int(whom),) if whom != one.thing else ()
    when = _when(one.a, times), _when(one.b, times)
    return Event("touch", (one.particle, *others), None, one.thing, when[0], when[1], one.others)


def _when(frame: int | None, times: np.ndarray) -> float | None:
    return None if frame is None else float(times[frame])


def _touches(pair: Pair, scene: Scene | None) -> tuple[touches.Touches, str]:
    """Differences in touches, and why they are not known, if they are not."""
    try:
        if scene is not None:
            n = pair.a.saved.position.shape[1]
            if len(scene.particles) > n:
                raise InputError(
                    f"scene: '{scene.name}' has {len(scene.particles)} particles, and the "
                    f"recordings {n}; give the scene that they are of"
                )
            return touches.find(pair, (scene, scene)), ""
        first = touches.scene_of(pair.a)
        same = pair.a.saved.meta.get("scene_hash") == pair.b.saved.meta.get("scene_hash")
        return touches.find(pair, (first, first if same else touches.scene_of(pair.b))), ""
    except touches.Unknown as why:
        return touches.Touches(), str(why)
