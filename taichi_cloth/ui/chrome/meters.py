"""The meters beside the world: what the last seconds were like, as graphs in one column."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.render import style
from taichi_cloth.render.picture import Rect
from taichi_cloth.render.tiles import Panel, Tile
from taichi_cloth.simulation.history import ROWS, SECONDS, History
from taichi_cloth.ui import text
from taichi_cloth.ui.chrome import graphs, instruments
from taichi_cloth.ui.chrome.beside import Second
from taichi_cloth.ui.chrome.contract import COLUMN
from taichi_cloth.ui.chrome.errors import Errors
from taichi_cloth.ui.chrome.instruments import Meter, Source
from taichi_cloth.ui.inputs import Event
from taichi_cloth.ui.schedule import FRAME_RATE

if TYPE_CHECKING:
    from taichi_cloth.simulation.gauges import Gauges
    from taichi_cloth.simulation.simulation import Simulation

REDRAWN = 0.15  # seconds between two drawings of a window's meters
LEAST, MOST = 2.0, 5.0  # heights of a graph, in heights of text
SMALL = 0.86  # of the height of text: of what stands beside a graph


class Meters:
    """The meters of a simulation: told of each frame, they read what is due, and draw themselves.

    Until they are told of a frame, or drawn, they read nothing.

    sim: whose they are. windowed: whether they keep to a small part of the time, and measure what a
    frame takes; without a window all follows from the frames, so that each run of the same has the
    same pictures. errors: what measures the error of what is seen, when asked to; None: nothing.
    beside: a second run; None: there is none.
    """

    name, label, key, place, focused = "meters", "meters", "m", COLUMN, False

    def __init__(
        self,
        sim: Simulation,
        *,
        windowed: bool = True,
        errors: Errors | None = None,
        beside: Second | None = None,
    ) -> None:
        self._sim, self._windowed, self._errors, self._beside = sim, windowed, errors, beside
        self._gauges: Gauges | None = None
        self._times = History(SECONDS, ROWS, 3) if windowed else None
        self._now = 0.0  # seconds that frames took, pauses left out
        self._drawn: tuple[object, Panel] | None = None
        self._due = 0.0
        # How often the run went elsewhere, and how often it had when that was last read.
        self._gone = self._looked = 0

    def restart(self) -> None:
        """Begin anew, after a reset, or where nobody looked for a while."""
        self._gauges, self._now, self._drawn = None, 0.0, None
        if self._times is not None:
            self._times.clear()

    @property
    def measures(self) -> bool:
        """True if the error of what is seen is measured."""
        return self._errors is not None and self._errors.on

    def switch(self, command: str) -> str:
        """Begin to measure the error of what is seen, or end ("error"), or go on to the next way to
        show the reference ("ghost"); what to tell the user.
        """
        if self._errors is None:
            return "nothing measures errors here"
        self._drawn = None
        if command == "ghost":
            return self._errors.next_ghost()
        self._errors.switch()
        return "measuring how wrong each second is" if self.measures else "error meter: off"

    def _reading(self) -> Gauges:
        """The gauges, from now on."""
        from taichi_cloth.simulation.gauges import Gauges

        if self._gauges is None:
            self._gauges = Gauges(self._sim, paced=self._windowed)
        return self._gauges

    def before_frame(self) -> None:
        """The facts needed before a frame is advanced."""
        self._reading().before_frame()

    def frame(self, simulate: float, draw: float, wait: float) -> None:
        """One frame is done; it took so many seconds to simulate, to draw, and waiting."""
        if self._gauges is None:  # they were opened while it was drawn
            return
        if self._times is None:
            self._now += 1.0 / FRAME_RATE
        else:
            self._now += simulate + draw + wait
            self._times.note(self._now, simulate, draw, wait)
        self._gauges.after_frame(self._now)

    def went(self) -> None:
        """The run went back to a frame, or on to one: values are that one's from now on, and the
        graphs those of the last seconds until the run goes on.
        """
        self._gone += 1

    def panel(self, rect: Rect, height: int) -> Panel:
        """The meters in a rectangle of the window; height: of the text, pixels.

        A window's are drawn anew now and then; between, it is the same object.
        """
        now = time.perf_counter()
        if self._drawn and self._windowed and now < self._due and _fits(self._drawn[1], rect):
            return self._drawn[1]
        error = self._errors.reading() if self.measures and self._errors else None
        apart = self._beside.reading() if self._beside else None
        # Those go on, and back, while a run stands still.
        said = tuple((found.value, found.details) for found in (error, apart) if found)
        state = rect, height, self._now, self._gone, said
        self._due = now + REDRAWN
        if self._drawn and self._drawn[0] == state:
            return self._drawn[1]
        gauges = self._reading()
        if gauges.state is None:
            gauges.after_frame(self._now)
        elif self._looked != self._gone:
            gauges.look()
        self._looked = self._gone
        source = Source(self._sim, gauges, self._times, self._now, error, apart)
        made = [meter for meter in (make(source) for make in instruments.ALL) if meter]
        panel = drawn(made, rect, height)
        self._drawn = state, panel
        return panel

    def take(self, event: Event, rect: Rect, height: int) -> bool:
        """Nothing in it reacts to the pointer."""
        return False


def _fits(panel: Panel, rect: Rect) -> bool:
    """True if a panel was drawn for this rectangle."""
    size = panel.tile.pixels.shape[:2]
    return (panel.x, panel.y, size) == (rect.x, rect.y, (rect.height, rect.width))


def drawn(meters: list[Meter], rect: Rect, height: int) -> Panel:
    """As many of the meters as a rectangle has room for, the first ones; height: of the text."""
    pixels = np.empty((rect.height, rect.width, 3), np.uint8)
    pixels[:] = style.PAPER
    pad, low = round(0.5 * height), round(LEAST * height)
    said: list[str] = []
    room = rect.height - pad
    # Details of few meters say more than all of them without; but all without, where they fit so.
    detailed = not (
        (_head(height, True) + low + pad) * len(meters)
        > room
        >= (_head(height, False) + low + pad) * len(meters)
    )
    head = _head(height, detailed)
    count = min(len(meters), max(room // (head + low + pad), 0))
    if count:
        graph = min(room // count - pad - head, round(MOST * height))
        for number, meter in enumerate(meters[:count]):
            box = Rect(pad, pad + number * (head + graph + pad), rect.width - 2 * pad, head + graph)
            said += _meter(pixels, box, meter, height, head if detailed else -head)
    return Panel(rect.x, rect.y, Tile(pixels), "\n".join(said))


def _head(height: int, detailed: bool) -> int:
    """Pixels above a graph: its title, and its details."""
    return round((1.25 + (1.2 if detailed else 0.0)) * height)


def _meter(pixels: np.ndarray, box: Rect, meter: Meter, height: int, head: int) -> list[str]:
    """Draw one meter into a box of pixels (h, w, 3); returns what is written on it.

    head: pixels above its graph; negative, where it shows no details.
    """
    small, detailed, head = max(round(SMALL * height), 10), head > 0, abs(head)
    end = box.x + box.width
    said = [meter.title, meter.value]
    value_at = end - text.length(meter.value, height)
    _say(pixels, meter.value, value_at, box.y, height, meter.state)
    _say(pixels, meter.title, box.x, box.y, height, style.INK)
    x = box.x + text.length(meter.title, height) + 0.6 * small
    if 0 < meter.rate < 0.75 * FRAME_RATE:
        rate = f"{meter.rate:.0f}/s" if meter.rate >= 0.95 else f"{meter.rate:.1f}/s"
        if x + text.length(rate, small) < value_at - 0.6 * small:
            _say(pixels, rate, x, box.y + 0.14 * height, small, style.MUTED)
            said.append(rate)
    x = box.x
    for words, color in meter.details if detailed else ():
        if x + text.length(words, small) > end:
            break
        _say(pixels, words, x, box.y + 1.25 * height, small, color)
        x += text.length(words, small) + 0.7 * small
        said.append(words)
    graph = Rect(box.x, box.y + head, box.width, box.height - head)
    return [*said, *_graph(pixels, graph, meter, small, max(2, round(height / 8)))]


def _graph(pixels: np.ndarray, box: Rect, meter: Meter, small: int, thick: int) -> list[str]:
    """Draw a graph with its scale at the left; returns what is written."""
    values = [curve.value for curve in meter.curves]
    every = np.concatenate([np.array(meter.ends), *(v[np.isfinite(v)] for v in values)])
    low, high = graphs.scale(float(every.min()), float(every.max()))
    labels = meter.label(high), meter.label(low)
    widest = max(text.length(label, small) for label in labels)
    # The same width for most labels, so that the graphs are one below the other.
    gutter = round(max(widest, 3.0 * small) + 0.4 * small)
    block = pixels[box.y : box.y + box.height, box.x + gutter : box.x + box.width]
    graphs.draw(block, list(meter.curves), list(meter.lines), (low, high), SECONDS, thick)
    for label, y in zip(labels, (box.y, box.y + box.height - small), strict=True):
        at = box.x + gutter - 0.4 * small - text.length(label, small)
        _say(pixels, label, at, y, small, style.MUTED)
    return [f"{labels[1]} to {labels[0]}"]


def _say(
    pixels: np.ndarray, words: str, x: float, y: float, height: int, color: text.Color
) -> None:
    """Write words onto pixels (h, w, 3) with the top of their letters at (x, y)."""
    text.write(pixels, words, (x, y), height, color)
