"""Why a run stopped, beside the world: the cause, h omega, the energy, and what survives.

Who finds that out is said from above: nothing here knows a post-mortem.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from taichi_cloth.render import style
from taichi_cloth.render.picture import Rect
from taichi_cloth.render.tiles import Panel, Tile
from taichi_cloth.ui import text
from taichi_cloth.ui.chrome import graphs
from taichi_cloth.ui.chrome.contract import COLUMN
from taichi_cloth.ui.chrome.graphs import Curve, Line
from taichi_cloth.ui.inputs import Event
from taichi_cloth.ui.text import Color

APPLY_KEY = "u"
NOTHING = "nothing has failed: here stands why a run stopped, and with which setting it survives"
TALL = 5.0  # of a graph, in heights of text
TOP, PAD, STEP, GAP = 0.6, 0.7, 1.25, 0.35  # around lines, from one to the next, below a paragraph


@dataclass(frozen=True)
class Finding:
    """The words on a run that failed.

    title: when and how it stopped. cause, proof: why. numerical: whether another setting would not
    have it. remedy: what survives, or why nothing does. settings: what that is, by the names of
    `simulation.live`; empty: there is none. back: how many frames before the last one to go on
    from; whole: whether that is the start. time: of each reading, (k,), the scene's; reach, energy,
    created: h omega, the energy of motion and springs, and what of it came from nothing, (k,).
    limit: of h omega; None: there is none. reads: what `reach` is called. tried: whether settings
    were tried; else the panel's key has that done.
    """

    title: str
    cause: str
    proof: str
    numerical: bool
    remedy: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    back: int = 0
    whole: bool = False
    time: np.ndarray = field(default_factory=lambda: np.zeros(0))
    reach: np.ndarray = field(default_factory=lambda: np.zeros(0))
    energy: np.ndarray = field(default_factory=lambda: np.zeros(0))
    created: np.ndarray = field(default_factory=lambda: np.zeros(0))
    limit: float | None = None
    reads: str = "h omega"
    tried: bool = True


class Examiner(Protocol):
    """Finds out why a run failed."""

    def examine(self, tell: Callable[[str], None], tries: bool) -> Finding | None:
        """Its words; None: none.

        tell: called with what is being tried; tries: whether settings are.
        """


class Why:
    """The panel that says it. finding: of the last failure; None: there was none."""

    name, label, key, place, focused = "why", "why", "k", COLUMN, False

    def __init__(self) -> None:
        self.finding: Finding | None = None
        self._drawn: tuple[object, Panel] | None = None

    def panel(self, rect: Rect, height: int) -> Panel:
        """It in a rectangle of the window; height: of the text, pixels."""
        state = rect, height, id(self.finding)
        if self._drawn is None or self._drawn[0] != state:
            self._drawn = state, _panel(self.finding, rect, height)
        return self._drawn[1]

    def take(self, event: Event, rect: Rect, height: int) -> bool:
        """Nothing in it reacts to the pointer."""
        return False


def _panel(finding: Finding | None, rect: Rect, height: int) -> Panel:
    pixels = np.empty((rect.height, rect.width, 3), np.uint8)
    pixels[:] = style.PAPER
    pixels[:, :1] = style.WALL
    said: list[str] = []
    y = _write(pixels, _fitting(finding, rect, height), TOP * height, height, said)
    if finding is not None and len(np.unique(finding.time)) > 1:
        limit = [] if finding.limit is None else [Line(finding.limit, style.BAD)]
        beside = "" if finding.limit is None else f", stable up to {finding.limit:.3g}"
        title = f"{finding.reads}{beside}"
        y = _graph(pixels, y, height, title, finding.time, [(finding.reach, style.INK)], limit)
        curves = [(_powers(finding.energy), style.INK), (_powers(finding.created), style.BAD)]
        title = "energy, in powers of ten; red: from nothing"
        _graph(pixels, y, height, title, finding.time, curves, [])
        said += [finding.reads, "energy"]
    return Panel(rect.x, rect.y, Tile(pixels), "\n".join(said))


def _lines(finding: Finding | None) -> list[tuple[str, Color]]:
    if finding is None:
        return [(NOTHING, style.MUTED)]
    kind = "Numerics: " if finding.numerical else "Not numerics: "
    color = style.BAD if finding.numerical else style.WARN
    lines = [
        (finding.title, style.INK),
        (kind + finding.cause, color),
        (finding.proof, style.MUTED),
        (finding.remedy, style.GOOD if finding.settings else style.WARN),
    ]
    if finding.settings:
        where = "the start" if finding.whole else f"{finding.back} frames before"
        lines.append((f"{APPLY_KEY}: go on with it from {where}", style.KEY_INK))
    return [*lines, ("left, right: the frames before", style.MUTED), ("r: begin anew", style.MUTED)]


def _fitting(finding: Finding | None, rect: Rect, height: int) -> list[tuple[str, Color]]:
    """The lines; where not all fit, what to do goes before the proof, and before the title, which
    stands in the banner, too.
    """
    lines = _lines(finding)
    for least in () if finding is None else (finding.proof, finding.title):
        tall = sum(STEP * len(_wrapped(words, rect.width, height)) + GAP for words, _ in lines)
        if (TOP + tall) * height <= rect.height:
            break
        lines = [line for line in lines if line[0] != least]
    return lines


def _wrapped(words: str, width: int, height: int) -> list[str]:
    return text.wrapped(words, round(width - 2 * PAD * height), height)


def _write(
    pixels: np.ndarray, lines: list[tuple[str, Color]], y: float, height: int, said: list[str]
) -> float:
    """Write paragraphs from y on, as far as there is room; returns where they end."""
    for words, color in lines:
        for part in _wrapped(words, pixels.shape[1], height):
            if y + height < pixels.shape[0]:
                text.write(pixels, part, (PAD * height, y), height, color)
                said.append(part)
            y += STEP * height
        y += GAP * height
    return y


def _graph(
    pixels: np.ndarray,
    y: float,
    height: int,
    title: str,
    time: np.ndarray,
    curves: list[tuple[np.ndarray, Color]],
    lines: list[Line],
) -> float:
    """Draw a graph over the whole of `time` with its title; returns where it ends."""
    pad, tall = round(0.7 * height), round(TALL * height)
    written = text.wrapped(title, round(pixels.shape[1] - 2 * pad), height)
    top = round(y + 1.3 * height * len(written))
    if top + tall + pad > pixels.shape[0]:
        return y
    for k, part in enumerate(written):
        text.write(pixels, part, (pad, y + 1.3 * height * k), height, style.MUTED)
    values = np.concatenate([*(v for v, _ in curves), [line.value for line in lines]])
    values = values[np.isfinite(values)]
    ends = graphs.scale(float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)
    labels = [f"{value:.3g}" for value in reversed(ends)]
    gutter = round(max(text.length(label, height) for label in labels) + 0.4 * height)
    block = pixels[top : top + tall, pad + gutter : pixels.shape[1] - pad]
    age, span = time[-1] - time, max(float(time[-1] - time[0]), 1e-300)
    made = [Curve(age / span, value, color) for value, color in curves]
    graphs.draw(block, made, lines, ends, 1.0, max(2, round(height / 8)))
    for label, at in zip(labels, (top, top + tall - height), strict=True):
        text.write(pixels, label, (pad, at), height, style.MUTED)
    return top + tall + 0.8 * height


def _powers(values: np.ndarray) -> np.ndarray:
    """Their powers of ten; NaN where they are none."""
    with np.errstate(all="ignore"):
        powers: np.ndarray = np.where(values > 0, np.log10(values), math.nan)
    return np.where(np.isfinite(powers), powers, math.nan)
