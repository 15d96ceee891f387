"""Mouse and keyboard: what the user can do with them, as events, and what the keys are called."""

from __future__ import annotations

import string
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

from taichi_cloth.errors import InputError
from taichi_cloth.files.events import Kind, number, numbers, pair, text, word_of
from taichi_cloth.render.camera import POSE
from taichi_cloth.ui.x11 import Input

BUTTONS = ("left", "middle", "right")
WHEEL = {4: 1.0, 5: -1.0}  # X's numbers of the wheel's buttons -> notches away from the user
BUTTON_NAMES = {"LMB": "left", "MMB": "middle", "RMB": "right"}  # by GGUI's and ti.GUI's names
# Names of the keys that a log can hold. Shifted letters and signs are keys of their own only where
# the program gives them a meaning.
NAMED_KEYS = (
    *("space", "ctrl", "shift", "alt", "tab", "return", "escape", "backspace", "delete"),
    *("up", "down", "left", "right", "home", "end", "page_up", "page_down"),
    *(f"f{n}" for n in range(1, 13)),
)
KEYS = frozenset(NAMED_KEYS) | frozenset(
    string.ascii_lowercase + string.digits + string.punctuation
)
# Keys whose names differ in GGUI, ti.GUI or X.
_KEY_NAMES = {
    " ": "space",
    "space": "space",
    "Escape": "escape",
    "Control_L": "ctrl",
    "Control_R": "ctrl",
    "Control": "ctrl",
    "Shift_L": "shift",
    "Shift_R": "shift",
    "Shift": "shift",
    "Return": "return",
    "Tab": "tab",
    "ISO_Left_Tab": "tab",
    "BackSpace": "backspace",
    "Home": "home",
    "KP_Home": "home",
    "Up": "up",
    "Down": "down",
    "Left": "left",
    "Right": "right",
    "F1": "f1",
    ".": ".",
    "period": ".",
    "KP_Decimal": ".",
    ",": ",",
    "+": "+",
    "=": "+",
    "plus": "+",
    "equal": "+",
    "KP_Add": "+",
    "-": "-",
    "minus": "-",
    "KP_Subtract": "-",
    "comma": ",",
    "bracketleft": "[",
    "bracketright": "]",
    "KP_Enter": "return",
    "Delete": "delete",
    **{sign: sign for sign in (*string.digits, ",", "[", "]")},
    **{f"KP_{digit}": digit for digit in string.digits},
}

# What the program's own keys ask for, beside those of the camera.
STEP_KEYS, BACK_KEYS, SLOW_KEY, RESET_KEY = (".", "right"), (",", "left"), "q", "r"
HELP_KEYS = ("f1", "tab")
COMMANDS = {
    "p": "pause",
    "space": "pause",
    **dict.fromkeys(STEP_KEYS, "step"),
    **dict.fromkeys(BACK_KEYS, "back"),
    SLOW_KEY: "slow",
    RESET_KEY: "reset",
    "h": "status",
    "d": "show",
    "e": "strain",
    "s": "picture",
    "v": "film",
    "w": "checkpoint",
    "x": "export",
    "l": "timeline",
    "m": "meters",
    "a": "error",
    "y": "ghost",
    "o": "settings",
    "k": "why",
    "u": "survive",
    **dict.fromkeys(HELP_KEYS, "help"),
    "escape": "quit",
}
# Those that act on the window alone: they work while a log is replayed, too.
WINDOW_KEYS = COMMANDS.keys() - {"space", RESET_KEY, "u"}
# Of the camera: what there is fills the picture; its pose before; that of the start.
FRAME_KEY, BACK_KEY, HOME_KEY = "f", "z", "home"
DRAGS = {"left": "turn", "right": "pan"}  # what moves the camera by which button
ORBIT = "orbit"  # what "turn" was in logs of old, and still is there
NEARER_KEYS, FARTHER_KEYS = ("+", "=", "up"), ("-", "down")


def key_name(key: str) -> str | None:
    """Our name of the key that a window calls `key`; None for one that has no meaning here."""
    if key in _KEY_NAMES:
        return _KEY_NAMES[key]
    letter = key.lower()
    return letter if letter in string.ascii_lowercase and len(letter) == 1 else None


@dataclass(frozen=True)
class Event:
    """One thing the user did with mouse or keyboard.

    kind: "move", "press", "release" or "wheel"; "leave" where the pointer left the window, which is
        in no log; "tool" where one is taken up, and "view" where the camera is moved by what is not
        a key: these say what came of an event before.
    pos: (x, y) in window pixels, origin top left, y down (None for keys).
    button: "left", "middle" or "right".
    key: lower-case name out of `KEYS` ("space", "ctrl", "f1", ".", "a").
    delta: wheel notches, positive away from the user.
    about: the point (3,) of a world in space that the wheel, or a key, comes nearer to, or that a
        tool's press means; None: that of what the camera looks at, and not into the world.
    name: of the tool that is in hand from now on; "": none.
    drag: out of `DRAGS`, or `ORBIT`, what the button that went down last does while it is held.
    pose: the camera's from now on (`Camera.pose`).
    """

    kind: str
    pos: tuple[float, float] | None = None
    button: str | None = None
    key: str | None = None
    delta: float = 0.0
    about: tuple[float, ...] | None = None
    name: str | None = None
    drag: str | None = None
    pose: tuple[float, ...] | None = None

    def fields(self) -> dict[str, Any]:
        """Its fields in a log's line."""
        said: dict[str, Any] = {}
        if self.pos is not None:
            said["pos"] = [float(self.pos[0]), float(self.pos[1])]
        if self.button is not None:
            said["button"] = self.button
        if self.key is not None:
            said["key"] = self.key
        if self.kind == "wheel":
            said["delta"] = float(self.delta)
        for word in ("name", "drag"):
            if getattr(self, word) is not None:
                said[word] = getattr(self, word)
        for word in ("about", "pose"):
            if getattr(self, word) is not None:
                said[word] = [float(number) for number in getattr(self, word)]
        return said


def fewest_moves(events: Iterable[Event]) -> list[Event]:
    """The events with one move, the last, in place of several that follow each other."""
    out: list[Event] = []
    for event in events:
        if event.kind == "move" and out and out[-1].kind == "move":
            out.pop()
        out.append(event)
    return out


def changed(kind: str, key: str, held: set[str]) -> list[Event]:
    """The event of a key, unless it only repeats what the key already does (auto-repeat).

    held: the keys that are down, of which it takes note.
    """
    if (kind == "press") == (key in held):
        return []
    (held.add if kind == "press" else held.discard)(key)
    return [Event(kind, key=key)]


def said_by_x(inputs: Iterable[Input], size: tuple[int, int], held: set[str]) -> Iterator[Event]:
    """The events that X sent to a window (width, height), each where the pointer was then.

    held: as of `changed`.
    """
    w, h = size
    for given in inputs:
        if given.kind == "move":
            if 0 <= given.pos[0] <= w and 0 <= given.pos[1] <= h:
                yield Event("move", pos=given.pos)
        elif given.button in WHEEL:
            if given.kind == "press":
                yield Event("wheel", pos=given.pos, delta=WHEEL[given.button])
        elif 1 <= given.button <= len(BUTTONS):
            yield Event(given.kind, pos=given.pos, button=BUTTONS[given.button - 1])
        else:
            names = [name for name in map(key_name, given.keys) if name]
            yield from changed(given.kind, names[0], held) if names else ()


def released(held: set[str]) -> list[Event]:
    """The events by which all keys that are held are let go; they are held no more."""
    events = [Event("release", key=key) for key in sorted(held)]
    held.clear()
    return events


def _press_or_release(kind: str, values: dict[str, Any]) -> Event:
    if ("button" in values) == ("key" in values):
        raise InputError(f"a {kind} event needs either 'button' or 'key'")
    if "about" in values and values.get("key", "+") not in (*NEARER_KEYS, *FARTHER_KEYS):
        raise InputError("'about' goes with a button, or a key that comes nearer, as '+' does")
    if "button" in values and "pos" not in values:
        raise InputError(f"'pos' is missing; a {kind} of a button needs it")
    return Event(kind, **values)


def _view(values: dict[str, Any]) -> Event:
    if len(values) != 1:
        raise InputError("a view event needs either 'drag' or 'pose'")
    if "pose" in values and not values["pose"][3] > 0:
        raise InputError(f"pose: the distance must be positive, is {values['pose'][3]:g}")
    return Event("view", **values)


def _kinds() -> tuple[Kind[Event], ...]:
    pressed = {
        "pos": pair,
        "button": word_of(BUTTONS, BUTTONS),
        "key": word_of(KEYS, NAMED_KEYS),
    }
    aimed = {"pos": pair, "about": numbers(3)}
    return (
        Kind("move", {"pos": pair}, {}, lambda values: Event("move", **values)),
        Kind("press", {}, {**pressed, "about": numbers(3)}, partial(_press_or_release, "press")),
        Kind("release", {}, pressed, partial(_press_or_release, "release")),
        Kind("wheel", {"delta": number}, aimed, lambda values: Event("wheel", **values)),
        Kind("tool", {"name": text}, {}, lambda values: Event("tool", **values)),
        Kind("view", {}, {"drag": word_of([*DRAGS.values(), ORBIT]), "pose": numbers(POSE)}, _view),
    )


KINDS = _kinds()  # of the events that every log may hold
