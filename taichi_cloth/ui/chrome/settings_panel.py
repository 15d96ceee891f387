"""The panel of settings: the scene, and each setting with its value and what it costs, all live.

Made from `simulation.live`. By mouse: drag a slider, click a switch, click a choice for its list
and a word of that, turn the wheel to scroll, click twice for the scene's own value. By keys: up and
down go from row to row, also where none is chosen yet; left and right change; return unfolds a
choice and takes a word of it; digits and return set a number, backspace takes one away; delete goes
back to the scene's value.
"""

from __future__ import annotations

import math
import operator
import string
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.errors import InputError
from taichi_cloth.render import style
from taichi_cloth.render.picture import Rect
from taichi_cloth.render.tiles import Panel, Tile
from taichi_cloth.simulation import live
from taichi_cloth.simulation.engine import compiles_in_background
from taichi_cloth.simulation.setting_costs import SettingCosts
from taichi_cloth.ui import text
from taichi_cloth.ui.chrome import settings_rows as rows
from taichi_cloth.ui.chrome.budget import HOLD, METHOD, OFF, SETS, Budget
from taichi_cloth.ui.chrome.contract import COLUMN
from taichi_cloth.ui.chrome.settings_rows import OPEN, Placed, Row
from taichi_cloth.ui.inputs import Event
from taichi_cloth.ui.scenes import Scenes

if TYPE_CHECKING:
    from taichi_cloth.simulation.live import Setting, Value
    from taichi_cloth.simulation.running_costs import RunningCosts
    from taichi_cloth.simulation.simulation import Simulation
    from taichi_cloth.ui.controls import Controls

REFRESH = 0.2  # seconds between looks at what was set elsewhere, as by a tool
TWICE = 0.35  # seconds within which two clicks are a double click
NOTCH = 0.02  # of a slider's length that an arrow key moves
TYPED = frozenset(string.digits + ".-e")
CHANGING = frozenset({"left", "right", "return", "delete", "backspace"})
SCENE = "scene"  # a row that unfolds, as the method's does
UNFOLDING = (SCENE, METHOD, HOLD)
MOST_BLOCKS = 500  # pictures of rows that are kept
FOOT = 4  # lines of the foot at least
NOTHING_HELD = "nothing is held: click, and choose"
HINT = "click a setting, or press down; click twice for the scene's own value; ~: predicted"


class SettingsPanel:
    """The panel; what it sets goes through the controls, which log it.

    sim: whose settings. frames: what its frames took. scenes: what the window may go on with.
    notice: says what was told lately. budget: what the run may be kept to; None: nothing.
    given: what was set since the last `flush`, by name; of several values the last one counts.
    """

    name, label, key, place = "settings", "settings", "o", COLUMN

    def __init__(
        self,
        sim: Simulation,
        controls: Controls,
        frames: RunningCosts,
        scenes: Scenes,
        notice: Callable[[], str | None],
        budget: Budget | None = None,
    ) -> None:
        self._sim, self._controls, self._scenes, self._budget = sim, controls, scenes, budget
        self._notice = notice
        self._costs = SettingCosts(sim, frames)
        self._rows: list[Placed] = []
        self._read_at, self._shape = -np.inf, (0, 0)
        self._values: list[tuple[Setting, Value]] = []
        self._read_of: tuple[tuple[object, ...], object] = (None, None), None
        self._chosen = ""  # the name of the row that the keys change
        self._unfolded = ""  # the name of the choice whose words are listed
        self._typed = ""
        self._dragged = ""
        self._first = 0  # pixels that are scrolled away
        self._clicked: tuple[str, float] = "", -np.inf
        self._wanted: str | None = None  # the scene that is to be opened
        self.given: dict[str, Value] = {}
        self.focused = False
        self._blocks: dict[tuple[Placed, int, int, bool, str], tuple[np.ndarray, str]] = {}
        self._drawn: tuple[object, Panel] | None = None
        self._noted: tuple[object, tuple[str, str]] | None = None
        self._foot = 0  # pixels

    # --- what is drawn ---------------------------------------------------------------------

    def panel(self, rect: Rect, height: int) -> Panel:
        """It as it is now, in its rectangle. height: of the text, pixels."""
        self._read(rect.width, height)
        note = self._note()
        lines = [_lines(words, rect.width - 2 * rows.pad(height), height) for words in note]
        most = max(int((rect.height / (2 * height) - 0.8) / 1.3), 1)  # half is the settings'
        self._foot = round((1.3 * min(max(sum(map(len, lines)), FOOT), most) + 0.8) * height)
        lines = [lines[0][:most], lines[1][: max(most - len(lines[0]), 0)]]
        self._scroll(0, rect)  # of what was there before a list was closed, less may be left
        state = (rect, height, tuple(self._rows), note, self._chosen, self._typed, self._first)
        if self._drawn is None or self._drawn[0] != state:
            self._drawn = state, self._anew(rect, height, note, lines)
        return self._drawn[1]

    def _read(self, width: int, height: int) -> None:
        """Read all values anew, where the last reading is old."""
        now = time.perf_counter()
        if now < self._read_at + REFRESH and (width, height) == self._shape:
            return
        self._costs.look()
        self._read_at, self._shape = now, (width, height)
        self._rows = rows.place(list(self._found()), width, height)

    def _settings(self) -> list[tuple[Setting, Value]]:
        """The settings with their values, read anew where something was set."""
        sim = self._sim
        scenes = sim.storage.scene, sim.scene
        run = sim.method, sim.dt, sim.substeps, tuple(sim.solver.items())
        if not (all(map(operator.is_, scenes, self._read_of[0])) and run == self._read_of[1]):
            self._read_of = scenes, run
            self._blocks.clear()
            self._values = [(one, one.read(sim)) for one in live.settings_of(sim)]
        return self._values

    def _found(self) -> Iterator[Row]:
        """The rows as they are now."""
        yield from self._of_scene()
        yield from self._of_budget()
        group = ""
        for one, value in self._settings():
            if one.group != group:
                yield Row("", one.group, cost="cost now" if not group else "")
                group = one.group
            cost = self._costs.of(one, value)
            yield Row(
                one.name, one.label, rows.shown(one, value), cost.words, cost.used, one, value,
                fixed=bool(one.fixed), changed=not rows.same(value, one.own),
            )  # fmt: skip
            if one.name == METHOD == self._unfolded:
                for word in one.words:
                    now = word == value
                    limit, cost = self._costs.least(word), self._costs.option(one, word)
                    yield Row(
                        f"{METHOD}:{word}", word, limit, cost.words, setting=one, option=word,
                        changed=now,
                    )  # fmt: skip

    def _of_scene(self) -> Iterator[Row]:
        here = self._sim.scene.name
        yield Row(SCENE, SCENE, rows.marked(here), fixed=bool(self._scenes.fixed))
        for name in self._scenes.about if self._unfolded == SCENE else ():
            full, button = f"{SCENE}:{name}", self._chosen == f"{SCENE}:{name}" and name != here
            yield Row(
                full, name, "now" if name == here else "", OPEN if button else "", option=name,
                changed=name == here, button=button,
            )  # fmt: skip

    def _of_budget(self) -> Iterator[Row]:
        budget = self._budget
        if budget is None:
            return
        yield Row(
            HOLD, HOLD, rows.marked(budget.chosen), fixed=bool(budget.fixed),
            changed=budget.chosen != OFF,
        )  # fmt: skip
        for word in budget.words if self._unfolded == HOLD else ():
            now = word == budget.chosen
            yield Row(f"{HOLD}:{word}", word, "now" if now else "", option=word, changed=now)

    def _note(self) -> tuple[str, str]:
        """The words at the foot: what the chosen row is and costs, or what was refused."""
        row, notice = self._row(self._chosen), self._notice()
        key = (row, notice, self._costs.looks, self._budget.why if self._budget else "")
        if self._noted is None or self._noted[0] != key:
            first, second = self._said(row) if row else (self._costs.frame, HINT)
            self._noted = key, (first, notice or second)
        return self._noted[1]

    def _said(self, row: Row) -> tuple[str, str]:
        one, about = row.setting, self._scenes.about
        if self._budget and row.name.partition(":")[0] == HOLD:
            return self._budget.fixed or self._budget.why or NOTHING_HELD, self._budget.about
        if row.name == SCENE:
            return self._scenes.fixed or "click, choose one, open it", about.get(
                self._sim.scene.name, ""
            )
        if one is None:
            here = self._sim.scene.name
            closes = f"in the place of {here}, whose files are finished; compiles, and waits"
            return about[row.option], "this one" if row.option == here else closes
        if row.option:
            there = row.option == row.number or row.option == one.read(self._sim)
            said = self._costs.option(one, row.option).said
            waits = "" if there else _waiting(one.compiles(self._sim, row.option))
            return said + waits, self._costs.advice(row.option)
        if one.fixed:
            return one.fixed, one.help
        said = self._costs.of(one, row.number).said
        if one.kind == live.FLAG:
            said += _waiting(one.compiles(self._sim, not row.number))
        named = one.unit not in ("", "1", live.TIMES)
        return said, f"{one.help} ({one.unit}, in the scene's units)" if named else one.help

    def _anew(
        self, rect: Rect, height: int, note: tuple[str, str], lines: list[list[str]]
    ) -> Panel:
        if len(self._blocks) > MOST_BLOCKS:
            self._blocks.clear()
        pixels = np.empty((rect.height, rect.width, 3), np.uint8)
        pixels[:] = style.PAPER
        pixels[:, :1] = style.WALL
        room = self._room(rect)
        said = []
        for placed in self._rows:
            top, name = placed.top - self._first, placed.row.name
            if top < 0 or top + placed.tall > room:
                continue
            chosen = bool(name) and name == self._chosen
            key = placed, rect.width, height, chosen, self._typed if chosen else ""
            if key not in self._blocks:
                self._blocks[key] = rows.draw(*key)
            pixels[top : top + placed.tall], words = self._blocks[key]
            said.append(words)
        foot = pixels[room:]
        foot[:] = style.SURROUND
        y = 0.4 * height
        for parts, color in zip(lines, (style.INK, style.MUTED), strict=True):
            for part in parts:
                text.write(foot, part, (rows.pad(height), y), height, color)
                y += 1.3 * height
        self._draw_bar(pixels, room)
        return Panel(rect.x, rect.y, Tile(pixels), "\n".join([*said, *note]))

    def _draw_bar(self, pixels: np.ndarray, room: int) -> None:
        """Draw how far it is scrolled, where not all of it is seen."""
        whole = self._whole()
        if whole > room:
            top, tall = (round(n * room / whole) for n in (self._first, room))
            pixels[top : top + tall, -3:] = style.WALL

    # --- what is done ----------------------------------------------------------------------

    def take(self, event: Event, rect: Rect, height: int) -> bool:
        """React to the pointer in the panel, and to keys that mean something to it."""
        self._read(rect.width, height)  # it may have been opened since the last picture
        if event.key is not None:
            used = self._uses(event.key)
            if used and event.kind == "press":
                self._key(event.key, rect)
            return used
        if event.pos is None:
            return False
        if event.kind == "wheel":
            self._scroll(-event.delta * 3 * height, rect)
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
        under = (n for n in self._rows if n.row.name and n.top <= y < n.top + n.tall)
        placed = next(under, None) if pos[1] - rect.y < self._room(rect) else None
        if placed is None:
            self._leave()
            return
        row, now, before = placed.row, time.perf_counter(), self._chosen
        twice = self._clicked[0] == row.name and now - self._clicked[1] < TWICE
        self._clicked = row.name, now
        self._choose(row.name)
        one = row.setting
        if row.option:
            if one is not None or before == row.name or row.name.startswith(HOLD):
                self._take_option(row)
        elif twice and one is not None:
            self._set(one, one.own)
        elif row.name in UNFOLDING:
            self._unfold("" if self._unfolded == row.name else row.name)
        elif one is not None and rows.is_on_slider(placed, y - placed.top, height):
            self._dragged = row.name
            self._slide(pos, rect, height)
        elif one is not None and one.kind == live.FLAG and pos[0] > rect.x + 0.4 * rect.width:
            self._step(one, 1)

    def _slide(self, pos: tuple[float, float], rect: Rect, height: int) -> None:
        row = self._row(self._dragged)
        if row is not None and row.setting is not None:
            first, wide = rows.track(rect.width, height)
            self._set(row.setting, rows.at(row.setting, (pos[0] - rect.x - first) / wide))

    def _uses(self, key: str) -> bool:
        """True if a key means something to the panel; all others are the window's."""
        if key in ("up", "down"):
            return True
        row = self._row(self._chosen)
        if row is None or key == "escape":
            return self.focused
        if row.option or row.name in (SCENE, HOLD):
            return key in ("left", "right", "return")
        if row.setting is None:
            return False
        typed = row.setting.kind in (live.NUMBER, live.COUNT) and key in TYPED
        begins = key != "e" or bool(self._typed)  # no number begins with it
        return key in CHANGING or (typed and begins)

    def _key(self, key: str, rect: Rect) -> None:
        names = [placed.row.name for placed in self._rows if placed.row.name]
        row = self._row(self._chosen)
        if key in ("up", "down"):
            step = 1 if key == "down" else -1
            begin = names.index(row.name) if row else min(-step, 0)
            self._choose(names[(begin + step) % len(names)])
            self._show(rect)
        elif key == "escape" or row is None:
            self._unfold("")  # else the next one would quit, with the list still open
            self._leave()
        elif row.option or row.name in (SCENE, HOLD):
            self._key_of_choice(key, row)
            self._show(rect)
        elif row.setting is not None:
            self._key_of_setting(key, row.setting)

    def _key_of_choice(self, key: str, row: Row) -> None:
        """A key on the scene, or on one of the words of a choice."""
        owner = row.name.partition(":")[0]
        if key == "left" or (key == "return" and row.name == self._unfolded):
            self._choose(owner)
            self._unfold("")
        elif key == "return" and row.option:
            self._take_option(row)
        elif key in ("right", "return"):
            self._unfold(owner)

    def _key_of_setting(self, key: str, one: Setting) -> None:
        if key in ("left", "right"):
            self._step(one, 1 if key == "right" else -1)
        elif key == "delete":
            self._set(one, one.own)
        elif key == "backspace":
            self._typed = self._typed[:-1]
        elif key == "return" and one.name == METHOD:
            self._unfold("" if self._unfolded == METHOD else METHOD)
        elif key == "return":
            self._enter(one)
        elif key in TYPED and one.kind in (live.NUMBER, live.COUNT):
            self._typed += key

    def _enter(self, one: Setting) -> None:
        """Set what was typed, or tell that it is no number."""
        typed, self._typed = self._typed, ""
        try:
            number = float(typed or "nan")
        except ValueError:
            number = math.nan
        if math.isfinite(number):
            self._set(one, round(number) if one.kind == live.COUNT else number)
        elif typed:
            self._controls.tell(f"{one.label}: {typed} is no number that it can have")

    def _step(self, one: Setting, way: int) -> None:
        """The next or the last word, the other way of a switch, a notch of a slider."""
        value = one.read(self._sim)
        if one.kind == live.WORD:
            self._set(one, one.words[(one.words.index(str(value)) + way) % len(one.words)])
        elif one.kind == live.FLAG:
            self._set(one, not value)
        elif value is not None:
            new = rows.at(one, rows.share(one, float(value)) + way * NOTCH)
            if one.kind == live.COUNT and new == value:
                new = max(int(value) + way, int(one.low))
            self._set(one, new)

    def _take_option(self, row: Row) -> None:
        """Set a choice to one of its words, or ask for that scene."""
        if row.setting is not None:
            self._set(row.setting, row.option)
        elif self._budget and row.name.startswith(HOLD):
            self._hold(row.option)
        elif row.option != self._sim.scene.name:
            self._wanted = row.option

    def _hold(self, word: str) -> None:
        """Keep the run to another budget, or tell why not."""
        assert self._budget is not None
        self._unfold("")
        self._choose(HOLD)
        self._controls.tell(None)
        try:
            self._budget.choose(word)
        except InputError as error:
            self._controls.tell(str(error))
        self._read_at = -np.inf

    def _set(self, one: Setting, value: Value) -> None:
        """Give a setting a value before the next frame, if that is another one."""
        if not one.fixed and not rows.same(value, self.given.get(one.name, one.read(self._sim))):
            self.given[one.name] = value

    @property
    def compiles(self) -> bool:
        """True if what was set since the last `flush` compiles kernels."""
        found = [live.setting(self._sim, name) for name in self.given]
        return any(one.compiles(self._sim, self.given[one.name]) for one in found)

    def flush(self) -> None:
        """Have what was set take effect."""
        given, self.given = self.given, {}
        self._controls.tell(None)
        for name, value in given.items():
            self._controls.set(name, value)
            if self._budget and name in (*SETS, METHOD):
                said = self._budget.by_hand(name)
                if said:
                    self._controls.tell(said)
        self._costs.hurry()
        self._read_at = -np.inf

    def forget(self) -> None:
        """Let what was set be as it was."""
        self.given = {}

    def take_scene(self) -> str | None:
        """The scene that the user asked for since the last call; None: none."""
        wanted, self._wanted = self._wanted, None
        return wanted

    def _choose(self, name: str) -> None:
        """Have the keys change a row."""
        self.focused, self._typed = True, ""
        if name != self._chosen:
            self._chosen, self._read_at = name, -np.inf
            self._controls.tell(None)

    def _unfold(self, name: str) -> None:
        """List the words of a choice, in the place of those of another one; "": of none."""
        fixed = {SCENE: self._scenes.fixed, HOLD: self._budget.fixed if self._budget else ""}
        if not fixed.get(name):
            self._unfolded, self._read_at = name, -np.inf
            self._read(*self._shape)

    def _leave(self) -> None:
        self.focused, self._chosen, self._typed, self._dragged = False, "", "", ""
        self._read_at = -np.inf

    def _row(self, name: str) -> Row | None:
        placed = self._placed(name)
        return placed.row if placed else None

    def _placed(self, name: str) -> Placed | None:
        return next((one for one in self._rows if name and one.row.name == name), None)

    def _whole(self) -> int:
        return self._rows[-1].top + self._rows[-1].tall if self._rows else 0

    def _room(self, rect: Rect) -> int:
        """Pixels for settings: the rest is the foot."""
        return max(rect.height - self._foot, 0)

    def _scroll(self, pixels: float, rect: Rect) -> None:
        end = max(self._whole() - self._room(rect), 0)
        self._first = int(np.clip(self._first + pixels, 0, end))

    def _show(self, rect: Rect) -> None:
        """Scroll so that the chosen row is seen, with the words below it where it is unfolded."""
        placed = self._placed(self._chosen)
        if placed is not None:
            low, high = placed.top + placed.tall - self._room(rect), placed.top
            self._scroll(min(max(self._first, low), high) - self._first, rect)


def _lines(words: str, width: int, height: int) -> list[str]:
    return text.wrapped(words, width, height) if words else []


def _waiting(compiles: bool) -> str:
    """The consequence of a change that compiles."""
    if not compiles:
        return ""
    return "; compiles, and waits" if compiles_in_background() else "; compiles"
