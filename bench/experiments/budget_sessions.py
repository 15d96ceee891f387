"""A minute of pulling and tearing, by a mouse that follows a script, in any view.

The script knows no scene: it goes for places where cloth is at the start, and pulls, cuts and blows
there; every twelve seconds it goes back to the start. The same seed makes the same events.
"""

import numpy as np

from taichi_cloth.ui import opening
from taichi_cloth.ui.inputs import Event

FRESH = 12 * 60  # frames from one start to the next
WHERE = (0.2, 0.75, 0.1, 0.7)  # left, right, top and bottom of where it goes for, parts of the room
TOOLS = {"g": 0.7, "c": 0.15, "b": 0.15}  # keys, and how often each is taken up


def events_by_frame(frames, seed):
    """{frame: [(kind, key or place in parts of the room, button or None)]} of a session."""
    rng, found, frame, tool, fresh = np.random.default_rng(seed), {}, 30, "", FRESH

    def at(when, *what):
        found.setdefault(when, []).append(what)

    while frame < frames:
        if frame >= fresh:
            at(frame, "key", "r")
            fresh += FRESH
            tool = ""
        chosen = rng.choice(list(TOOLS), p=list(TOOLS.values()))
        if chosen != tool:
            tool = chosen
            at(frame + 1, "key", tool)
        left, right, top, bottom = WHERE
        start = np.array([rng.uniform(left, right), rng.uniform(top, bottom)])
        way = rng.normal(0.0, 0.15, 2)
        length = int(rng.integers(8, 30))
        at(frame + 2, "move", tuple(start))
        at(frame + 3, "press", tuple(start))
        for k in range(1, length + 1):
            at(frame + 3 + k, "move", tuple(np.clip(start + way * k / length, 0.02, 0.98)))
        end = frame + 3 + length + int(rng.integers(1, 12))
        at(end, "release", tuple(np.clip(start + way, 0.02, 0.98)))
        frame = end + int(rng.integers(5, 25))
    return found


class Hand:
    """The mouse of a script over a view: its `poll` is the view's, and the script's events."""

    def __init__(self, view, script):
        self._view, self._script, self._frame, self._poll = view, script, 0, view.poll
        view.poll = self.poll

    def poll(self):
        given, frame = self._poll(), self._frame
        self._frame += 1
        return [*given, *(self._event(*what) for what in self._flat(frame))]

    def _flat(self, frame):
        for kind, what in self._script.get(frame, ()):
            if kind == "key":
                yield "press", what
                yield "release", what
            else:
                yield kind, what

    def _event(self, kind, what):
        if isinstance(what, str):
            return Event(kind, key=what)
        room = self._view.room
        x, y = (room.x, room.y) if room else (0, 0)
        w, h = (room.width, room.height) if room else self._view.size
        pos = (x + what[0] * w, y + what[1] * h)
        return Event(kind, pos=pos, button=None if kind == "move" else "left")


def noting(file):
    """Have what each frame of a budget took written to a file: substeps, simulate, rest [s]."""
    from taichi_cloth.cli.run_budget import HeldBudget

    after_frame = HeldBudget.after_frame

    def noted(self, simulate, rest):
        file.write(f"{self._sim.substeps} {simulate:.6f} {rest:.6f}\n")
        after_frame(self, simulate, rest)

    HeldBudget.after_frame = noted


def scripted(frames, seed):
    """Have views that are opened from now on be used by the script."""
    before = opening.open_view

    def opened(*args, **given):
        view = before(*args, **given)
        Hand(view, events_by_frame(frames, seed))
        return view

    opening.open_view = opened


if __name__ == "__main__":
    import sys

    from taichi_cloth.cli.main import main

    seed, frames = int(sys.argv[1]), int(sys.argv[2])
    scripted(frames, seed)
    with open(sys.argv[3], "w") as file:
        noting(file)
        sys.exit(main(["run", *sys.argv[4:], "--frames", str(frames)]))
