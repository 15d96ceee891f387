"""The panel of settings: each with its value, its slider, and what it costs; all of them live.

Made from `simulation.live`. By mouse: drag a slider, click a word or a switch, turn the wheel to
scroll, click twice for the scene's own value. By keys: up and down choose, left and right change,
digits and return set a number, backspace takes one away, delete goes back to the scene's value.
"""

from __future__ import annotations

import string
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.simulation import live
from taichi_cloth.simulation.engine import compiles_in_background
from taichi_cloth.ui import style, text
from taichi_cloth.ui.chrome.contract import COLUMN
from taichi_cloth.ui.chrome.layout import Rect
from taichi_cloth.ui.inputs import Event
from taichi_cloth.ui.text import Color, Panel

if TYPE_CHECKING:
    from taichi_cloth.simulation.live import Setting, Value
    from taichi_cloth.simulation.running_costs import RunningCosts
    from taichi_cloth.simulation.simulation import Simulation
    from taichi_cloth.ui.controls import Controls

LINES = 1.5  # text heights that a setting without a slider takes; with one it takes SLIDER more
SLIDER = 0.75
REFRESH = 0.2  # seconds between readings of all values: some are columns of many springs
TWICE = 0.35  # seconds within which two clicks are a double click
NOTCH = 0.02  # of a slider's length that an arrow key moves
TYPED = frozenset(string.digits + ".-e")


@dataclass(frozen=True)
class _Line:
    """A heading, where there is no setting, or a setting with its value. top, tall: pixels from
    the panel's first line on.
    """

    top: int
    tall: int
    heading: str = ""
    setting: Setting | None = None
    value: Value = None


class SettingsPanel:
    """The panel; what it sets goes through the controls, which log it.

    sim: whose settings. costs: of frames so far.
    given: what was set since the last `flush`, by name; of several values the last one counts.
    """

    name, label, key, place = "settings", "settings", "o", COLUMN

    def __init__(self, sim: Simulation, controls: Controls, costs: RunningCosts) -> None:
        self._sim, self._controls, self._costs = sim, controls, costs
        self._lines: list[_Line] = []
        self._read_at, self._height = -np.inf, 0
        self._chosen = ""  # the name of the setting that the keys change
        self._typed = ""
        self._dragged = ""
        self._first = 0  # pixels that are scrolled away
        self._clicked: tuple[str, float] = "", -np.inf
        self.given: dict[str, Value] = {}
        self.focused = False
        self._drawn: tuple[object, Panel] | None = None

    # --- what is drawn ---------------------------------------------------------------------

    def panel(self, rect: Rect, height: int) -> Panel:
        """It as it is now, in its rectangle. height: of the text, pixels."""
        self._read(height)
        values = tuple((line.setting.name, line.value) for line in self._lines if line.setting)
        note = self._note()
        shown = self._chosen, self._typed, self._first, self.focused
        state = (rect, height, values, note, shown)
        if self._drawn is None or self._drawn[0] != state:
            self._drawn = state, self._anew(rect, height, note)
        return self._drawn[1]

    def _read(self, height: int) -> None:
        """Read all values anew, where the last reading is old."""
        now = time.perf_counter()
        if now < self._read_at + REFRESH and height == self._height:
            return
        self._read_at, self._height = now, height
        lines, top, group = [], 0, ""
        for one in live.settings_of(self._sim):
            if one.group != group:
                group = one.group
                lines.append(_Line(top, round(1.7 * height), heading=group))
                top += lines[-1].tall
            tall = round((LINES + SLIDER * _has_slider(one)) * height)
            lines.append(_Line(top, tall, setting=one, value=one.read(self._sim)))
            top += tall
        self._lines = lines

    def _note(self) -> tuple[str, str]:
        """The two lines at the foot: what the chosen setting is and costs, or what was refused."""
        line = self._line(self._chosen)
        if line is None or line.setting is None:
            return self._costs.now(self._sim).words(), HINT
        one, value = line.setting, line.value
        said = self._controls.notice or one.help
        if one.fixed:
            return one.fixed, said
        after = self._after(one)
        cost = self._costs.of(self._sim, one, value if after is None else after).words()
        what = "" if after is None else f"{_shown(one, after).strip(MARKS)}: "
        if after is not None and one.compiles(self._sim, after):
            cost += "; compiles, and waits" if compiles_in_background() else "; compiles"
        return what + cost, said

    def _after(self, one: Setting) -> Value:
        """What the next step to the right would set, of what is no number; None: a number."""
        if one.kind == live.WORD:
            return one.words[(one.words.index(str(one.read(self._sim))) + 1) % len(one.words)]
        return not one.read(self._sim) if one.kind == live.FLAG else None

    def _anew(self, rect: Rect, height: int, note: tuple[str, str]) -> Panel:
        pixels = np.empty((rect.height, rect.width, 3), np.uint8)
        pixels[:] = style.PAPER
        pixels[:, :1] = style.WALL
        room = self._room(rect, height)
        said = []
        for line in self._lines:
            top = line.top - self._first
            if top < 0 or top + line.tall > room:
                continue
            block = pixels[top : top + line.tall]
            if line.setting is None:
                y = line.tall - 1.3 * height
                text.write(block, line.heading, (_pad(height), y), height, style.KEY_INK)
            else:
                said.append(self._draw_line(block, line, height))
        foot = pixels[room:]
        foot[:] = style.SURROUND
        wide, y = rect.width - 2 * _pad(height), 0.4 * height
        for words, color in zip(note, (style.INK, style.MUTED), strict=True):
            for part in text.wrapped(words, wide, height)[:2]:
                text.write(foot, part, (_pad(height), y), height, color)
                y += 1.3 * height
        self._draw_bar(pixels, room)
        return Panel(rect.x, rect.y, pixels, "\n".join([*said, *note]))

    def _draw_line(self, block: np.ndarray, line: _Line, height: int) -> str:
        """Draw a setting into its pixels; returns what is written there."""
        one, value = line.setting, line.value
        assert one is not None
        chosen, pad = one.name == self._chosen, _pad(height)
        if chosen:
            block[:, 1:] = style.BUTTON
        changed = not _same(value, one.own)
        ink = style.MUTED if one.fixed else style.KEY_INK if changed else style.INK
        y = 0.25 * height
        words = self._typed + "_" if chosen and self._typed else _shown(one, value)
        room = block.shape[1] - 3 * pad - text.length(words, height)
        label = _cut(one.label, room, height)
        text.write(block, label, (pad, y), height, style.INK if chosen else style.MUTED)
        x = block.shape[1] - pad - text.length(words, height)
        text.write(block, words, (x, y), height, ink)
        if _has_slider(one):
            self._draw_slider(block, one, value, height, ink)
        return f"{label} {words}"

    def _draw_slider(
        self, block: np.ndarray, one: Setting, value: Value, height: int, ink: Color
    ) -> None:
        first, wide = _track(block.shape[1], height)
        middle, thick = round((LINES + 0.15) * height), max(1, height // 10)
        rows = slice(middle - thick, middle + thick)
        block[rows, first : first + wide] = style.WALL
        if value is None:
            return
        at = first + round(_share(one, float(value)) * wide)
        block[rows, first:at] = ink
        half = max(2, height // 5)
        block[middle - 2 * half : middle + 2 * half, at - half : at + half] = ink

    def _draw_bar(self, pixels: np.ndarray, room: int) -> None:
        """Draw how far it is scrolled, where not all of it is seen."""
        whole = self._whole()
        if whole > room:
            top, tall = (round(n * room / whole) for n in (self._first, room))
            pixels[top : top + tall, -3:] = style.WALL

    # --- what is done ----------------------------------------------------------------------

    def take(self, event: Event, rect: Rect, height: int) -> bool:
        """React to the pointer in the panel, and to keys where it has the keyboard."""
        if event.key is not None:
            if event.kind == "press":
                self._key(event.key, rect, height)
            return False
        if event.pos is None:
            return False
        if event.kind == "wheel":
            self._scroll(-event.delta * 3 * height, rect, height)
        elif event.kind == "press" and not rect.holds(event.pos):
            self._leave()
        elif event.kind == "press" and event.button == "left":
            self._press(event.pos, rect, height)
        elif event.kind == "move" and self._dragged:
            self._slide(event.pos, rect, height)
        elif event.kind == "release":
            self._dragged = ""
        return bool(self._dragged)

    def _press(self, pos: tuple[float, float], rect: Rect, height: int) -> None:
        y = pos[1] - rect.y + self._first
        under = (n for n in self._lines if n.setting and n.top <= y < n.top + n.tall)
        line = next(under, None) if pos[1] - rect.y < self._room(rect, height) else None
        if line is None or line.setting is None:
            self._leave()
            return
        one, now = line.setting, time.perf_counter()
        twice = self._clicked[0] == one.name and now - self._clicked[1] < TWICE
        self._clicked = one.name, now
        self.focused, self._chosen, self._typed = True, one.name, ""
        if twice:
            self._set(one, one.own)
        elif _has_slider(one) and y - line.top > LINES * height * 0.75:
            self._dragged = one.name
            self._slide(pos, rect, height)
        elif not _has_slider(one) and pos[0] > rect.x + 0.4 * rect.width:
            self._step(one, 1)

    def _slide(self, pos: tuple[float, float], rect: Rect, height: int) -> None:
        line = self._line(self._dragged)
        if line is None or line.setting is None:
            return
        first, wide = _track(rect.width, height)
        self._set(line.setting, _at(line.setting, (pos[0] - rect.x - first) / wide))

    def _key(self, key: str, rect: Rect, height: int) -> None:
        names = [line.setting.name for line in self._lines if line.setting]
        line = self._line(self._chosen)
        if key == "escape" or line is None or line.setting is None:
            self._leave()
        elif key in ("up", "down"):
            step = 1 if key == "down" else -1
            self._chosen, self._typed = names[(names.index(self._chosen) + step) % len(names)], ""
            self._show(rect, height)
        elif key in ("left", "right"):
            self._step(line.setting, 1 if key == "right" else -1)
        elif key == "delete":
            self._set(line.setting, line.setting.own)
        elif key == "backspace":
            self._typed = self._typed[:-1]
        elif key == "return":
            self._enter(line.setting)
        elif key in TYPED and line.setting.kind in (live.NUMBER, live.COUNT):
            self._typed += key

    def _enter(self, one: Setting) -> None:
        """Set what was typed."""
        typed, self._typed = self._typed, ""
        try:
            number = float(typed)
        except ValueError:
            return
        self._set(one, round(number) if one.kind == live.COUNT else number)

    def _step(self, one: Setting, way: int) -> None:
        """The next or the last word, the other way of a switch, a notch of a slider."""
        value = one.read(self._sim)
        if one.kind == live.WORD:
            self._set(one, one.words[(one.words.index(str(value)) + way) % len(one.words)])
        elif one.kind == live.FLAG:
            self._set(one, not value)
        elif value is not None:
            new = _at(one, _share(one, float(value)) + way * NOTCH)
            if one.kind == live.COUNT and new == value:
                new = max(int(value) + way, int(one.low))
            self._set(one, new)

    def _set(self, one: Setting, value: Value) -> None:
        """Give a setting a value before the next frame, if that is another one."""
        if not one.fixed and not _same(value, self.given.get(one.name, one.read(self._sim))):
            self.given[one.name] = value

    @property
    def compiles(self) -> bool:
        """Whether what was set since the last `flush` compiles kernels."""
        found = [live.setting(self._sim, name) for name in self.given]
        return any(one.compiles(self._sim, self.given[one.name]) for one in found)

    def flush(self) -> None:
        """Have what was set take effect."""
        given, self.given = self.given, {}
        self._controls.forget_notice()
        for name, value in given.items():
            self._controls.set(name, value)
        self._read_at = -np.inf

    def forget(self) -> None:
        """Let what was set be as it was."""
        self.given = {}

    def _leave(self) -> None:
        self.focused, self._chosen, self._typed, self._dragged = False, "", "", ""

    def _line(self, name: str) -> _Line | None:
        return next(
            (line for line in self._lines if line.setting and line.setting.name == name), None
        )

    def _whole(self) -> int:
        return self._lines[-1].top + self._lines[-1].tall if self._lines else 0

    def _room(self, rect: Rect, height: int) -> int:
        """Pixels for settings: the rest is the foot."""
        return max(rect.height - round(6.0 * height), 0)

    def _scroll(self, pixels: float, rect: Rect, height: int) -> None:
        end = max(self._whole() - self._room(rect, height), 0)
        self._first = int(np.clip(self._first + pixels, 0, end))

    def _show(self, rect: Rect, height: int) -> None:
        """Scroll so that the chosen setting is seen."""
        line = self._line(self._chosen)
        if line is not None:
            low, high = line.top + line.tall - self._room(rect, height), line.top
            self._scroll(min(max(self._first, low), high) - self._first, rect, height)


MARKS = "\u2039 \u203a"  # around a word that may be another one
HINT = "click a setting; twice: the scene's own value"


def _has_slider(one: Setting) -> bool:
    return one.kind in (live.NUMBER, live.COUNT) and not one.fixed


def _same(a: Value, b: Value) -> bool:
    if isinstance(a, (int, float)) and isinstance(b, (int, float)):
        return bool(np.isclose(float(a), float(b), rtol=1e-6, atol=0))
    return a == b


def _share(one: Setting, value: float) -> float:
    """How far along its slider a value is, 0 to 1."""
    low, high = one.low, one.high
    if one.log and value > 0:
        low, high, value = np.log(low), np.log(high), np.log(value)
    return float(np.clip((value - low) / (high - low), 0, 1))


def _at(one: Setting, share: float) -> Value:
    """The value at a place of its slider, to three digits."""
    share = float(np.clip(share, 0, 1))
    if one.log:
        value = one.low * (one.high / one.low) ** share
    else:
        value = one.low + share * (one.high - one.low)
        if abs(value) < 0.005 * (one.high - one.low):
            value = 0.0  # a slider that goes through zero stops there
    return round(value) if one.kind == live.COUNT else float(f"{value:.3g}")


def _shown(one: Setting, value: Value) -> str:
    """A value as it is written, with its unit."""
    if value is None:
        return "off"
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, str):
        return f"{MARKS[0]} {value} {MARKS[-1]}"
    unit = f" {one.unit}" if len(one.unit) <= 8 and one.unit else ""
    return f"{value:.4g}{unit}"


def _cut(words: str, room: float, height: int) -> str:
    """As much of `words` as fits into `room` pixels."""
    while len(words) > 1 and text.length(words, height) > room:
        words = words[:-1]
    return words


def _track(width: int, height: int) -> tuple[int, int]:
    """Where a slider begins in the panel, and how long it is, pixels."""
    pad = _pad(height) + max(2, height // 5)
    return pad, max(width - 2 * pad, 1)


def _pad(height: int) -> int:
    return round(0.7 * height)
