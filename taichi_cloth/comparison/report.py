"""A comparison on the terminal and as JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_cloth import console
from taichi_cloth.comparison.compare import EXIST, Comparison, Difference, Event
from taichi_cloth.console import percent
from taichi_cloth.errors import counted

if TYPE_CHECKING:
    from rich.console import Console

ROWS = 10  # of the table of distances, besides those at which something happens
SPARED = (
    "frame of B",
    "frame of A",
    "frame",
    "max",
    "farthest",
    "rms",
)  # where a terminal is narrow


def show(found: Comparison, to: Console) -> None:
    """Print both runs, the distance over time, and what differs first."""
    _show_runs(found, to)
    if not found.identical:
        _show_distances(found, to)
    for line in findings(found):
        console.say(to, f"- {line}", hang=2)


def _show_runs(found: Comparison, to: Console) -> None:
    """Names of the runs, their differences, and what they share."""
    of_a = {**found.settings_a, "frames": found.frames_a}
    of_b = {**found.settings_b, "frames": found.frames_b}
    names = list(dict.fromkeys([*of_a, *of_b]))
    differ = [name for name in names if of_a.get(name) != of_b.get(name)]
    lines = [("", found.a, found.b)]
    lines += [(name, _word(of_a.get(name)), _word(of_b.get(name))) for name in differ]
    console.print_table(to, "A beside B", ["", "A", "B"], lines)
    shared = [name for name in names if name not in (*differ, "scene_hash")]
    alike = [f"{name} {_word(of_a[name])}" for name in shared]
    console.say(to, f"both: {', '.join(alike)}")


def _word(value: Any) -> str:
    if value is None:
        return "not known"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _show_distances(found: Comparison, to: Console) -> None:
    headers = ["time", "frame of A", "frame of B", "rms", "rms, parts", "max", "max, parts"]
    headers += ["farthest", "what happens"]
    happens = happenings(found)
    chosen = set(np.linspace(0, len(found.time) - 1, ROWS).round().astype(int).tolist())
    lines: list[Sequence[str]] = []
    styles: list[str | None] = []
    for k in sorted({k for k in chosen | set(happens) if 0 <= k < len(found.time)}):
        rms, largest = found.rms[k], found.max[k]
        lines.append((
            f"{found.time[k]:.5g}", str(found.frame_a[k]), str(found.frame_b[k]),
            f"{rms:.3g}", percent(rms / found.scale), f"{largest:.3g}",
            percent(largest / found.scale), str(found.farthest[k]) if largest else "",
            "; ".join(happens.get(k, [])),
        ))  # fmt: skip
        styles.append("bold" if k in happens else None)
    if (found.frame_a == found.frame_b).all():
        headers[1] = "frame"
        del headers[2]
        lines = [[*line[:2], *line[3:]] for line in lines]
    title = f"How far apart they are: {counted(found.particles, 'particle')} at the ends of frames"
    left_out = console.print_table(
        to, title, headers, lines, ("what happens",), spared=SPARED, styles=styles
    )
    if left_out:
        names = ", ".join(reversed(left_out))
        console.say(to, f"- left out, for the terminal is narrow: {names}", hang=2)


def happenings(found: Comparison) -> dict[int, list[str]]:
    """Events in short, by the index of its frame among those of a comparison; -1: before."""
    said: list[tuple[float, str]] = []
    if found.difference:
        said.append((found.difference.time, "first difference"))
    for event in (found.first_break, found.first_touch):
        if event:
            said.append((event.time, in_short(event)))
    if found.parted is not None:
        said.append((found.parted, parted_in_short(found)))
    happens: dict[int, list[str]] = {}
    for time, words in said:
        k = int(np.abs(found.time - time).argmin()) if time >= found.time[0] else -1
        happens.setdefault(k, []).append(words)
    return happens


def findings(found: Comparison) -> list[str]:
    """Sentences: whether they are the same, what differs first, and by how much in the end."""
    said = [_sameness(found)]
    if found.difference:
        said.append(_first_difference(found.difference))
    said += _of_events(found)
    if found.difference is None:
        return said
    limit, scale = limit_of(found), found.scale
    if found.parted is None:
        k = int(found.rms.argmax())
        said.append(
            f"they stay together: never farther apart (rms) than {percent(found.rms[k] / scale)} "
            f"({found.rms[k]:.3g}), at time {found.time[k]:.5g}; the limit is {limit}"
        )
    else:
        said.append(f"they part at time {found.parted:g}: first with {_apart_by(found)}")
    said.append(
        f"error of A against B over all frames, as trade has it: {percent(found.error)} "
        f"({found.distance.trajectory:.3g}), in parts of {found.scale_is} in B, {scale:.4g}"
    )
    return said


def _sameness(found: Comparison) -> str:
    common = len(found.time)
    beyond = [
        f"{name} has {counted(count - common, 'frame')} that the other has not"
        for name, count in (("A", found.frames_a), ("B", found.frames_b))
        if count > common
    ]
    more = f"; {', '.join(beyond)}" if beyond else ""
    if found.identical:
        return f"identical to the bit in all {counted(common, 'frame')}"
    if found.difference is None:
        return f"identical to the bit in the {counted(common, 'frame')} at the same times{more}"
    return f"compared: {counted(common, 'frame')} at the same times{more}"


def _first_difference(first: Difference) -> str:
    frames = f"frame {first.frame_a}"
    if first.frame_a != first.frame_b:
        frames += f" of A and {first.frame_b} of B"
    said = f"the first difference: {first.what}, {frames} (time {first.time:.5g})"
    if first.particle is None:
        return said
    if first.what == EXIST:
        return f"{said}: particle {first.particle} is in one only"
    return f"{said}: particle {first.particle}, {first.distance:.3g} apart"


def _of_events(found: Comparison) -> list[str]:
    """Sentences on breaks and touches."""
    said = []
    for event, a, b, things in (
        (found.first_break, found.break_a, found.break_b, "breaks"),
        (found.first_touch, found.touch_a, found.touch_b, "touches"),
    ):
        if things == "touches" and found.touches_unknown:
            said.append(f"touches are not known: {found.touches_unknown}")
        elif event is not None:
            others = f"; {event.others} more differ" * bool(event.others)
            where = " in that frame" * (things == "touches" and bool(event.others))
            said.append(f"the first of the {things} that differ: {in_words(event)}{others}{where}")
        elif a is not None or b is not None:
            said.append(
                f"all {things} are the same; the first is at time {a if b is None else b:.5g}"
            )
    return said


def in_words(event: Event, names: tuple[str, str] = ("A", "B")) -> str:
    """An event, and when each run has it; names: of the runs."""
    if event.kind == "break":
        ends = " and ".join(map(str, event.particles))
        what = f"spring {event.spring} (particles {ends}) breaks"
    elif len(event.particles) > 1:
        what = f"particles {event.particles[0]} and {event.particles[1]} touch"
    else:
        what = f"particle {event.particles[0]} touches {event.thing}"
    a, b = event.a, event.b
    if a is None or b is None:
        return f"{what} only in {names[b is not None]}, at time {event.time:.5g}"
    return f"{what} at time {a:.5g} in {names[0]}, {b:.5g} in {names[1]}"


def in_short(event: Event, names: tuple[str, str] = ("A", "B")) -> str:
    """An event in a word or two, with the run that has it first; names: of the runs."""
    a, b = (math.inf if time is None else time for time in (event.a, event.b))
    run = names[0] if a < b else names[1]
    if event.kind == "break":
        return f"spring {event.spring} breaks in {run}"
    if len(event.particles) > 1:
        return f"{event.particles[0]} and {event.particles[1]} touch in {run}"
    return f"{event.particles[0]} touches {event.thing} in {run}"


def _is_far(found: Comparison) -> bool:
    """True if it is by their distance that two runs part, and not by who is there."""
    return bool(found.rms[found.time == found.parted].max() > found.limit)


def _apart_by(found: Comparison) -> str:
    """By what two runs part, in words."""
    if _is_far(found):
        return f"an rms distance above {limit_of(found)}"
    return "a particle that only one of them has"


def parted_in_short(found: Comparison) -> str:
    """The same in a word or two."""
    return f"farther than {limit_of(found)}" if _is_far(found) else "a particle in one only"


def limit_of(found: Comparison) -> str:
    """The limit in words."""
    return percent(found.within) if found.relative else f"{found.within:g}"


def as_json(found: Comparison) -> dict[str, Any]:
    """A comparison as JSON values, by the names of `Comparison`."""
    values = dict(vars(found))
    values["distance"] = vars(found.distance)
    values["difference"] = vars(found.difference) if found.difference else None
    for name in ("first_break", "first_touch"):
        event = values[name]
        values[name] = {**vars(event), "time": event.time} if event else None
    for name, value in values.items():
        if isinstance(value, np.ndarray):
            values[name] = value.tolist()
    return {**values, "error": found.error, "limit": found.limit}
