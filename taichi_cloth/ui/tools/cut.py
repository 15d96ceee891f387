"""Cut the springs that the pointer's path crosses while the left button is held."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taichi_cloth.files.events import indices
from taichi_cloth.scene.model import Scene
from taichi_cloth.ui import picking
from taichi_cloth.ui.inputs import Event
from taichi_cloth.ui.tools.contract import (
    MARK,
    Events,
    Hand,
    LoggedEvent,
    Marks,
    Tool,
    ToolEvent,
    prepared,
)

NEAR = 5.0  # pixels: half of the way of which it is drawn what it would cut


@dataclass
class _Memory:
    """last: (2,) window pixels, up to where the path has cut; None: the button is up."""

    last: np.ndarray | None = None


def _actions(scene: Scene) -> tuple[str, ...]:
    return ("drag with left\tcut the springs that the pointer crosses",)


def _press(hand: Hand, memory: _Memory, event: Event) -> Events:
    memory.last = np.array(event.pos, np.float64)
    return None


def _motion(hand: Hand, memory: _Memory, before: np.ndarray, now: np.ndarray) -> Events:
    if memory.last is None:
        return None
    start, memory.last = memory.last, now
    crossed = picking.springs_across(hand.seen, hand.camera, hand.window, start, now)
    if len(crossed) == 0:
        return None
    return [ToolEvent("cut", {"springs": crossed.tolist()})]


def _release(hand: Hand, memory: _Memory, event: Event) -> Events:
    if memory.last is None or event.button != "left":
        return None
    made = _motion(hand, memory, memory.last, np.array(event.pos, np.float64))
    memory.last = None
    return made


def _draw(hand: Hand, memory: _Memory) -> Marks | None:
    """The springs that a short way from here would cross."""
    if hand.pointer is None or not hand.over:
        return None
    here = hand.pointer
    ways = (np.array([NEAR, NEAR]), np.array([NEAR, -NEAR]))
    crossed = [
        picking.springs_across(hand.seen, hand.camera, hand.window, here - way, here + way)
        for way in ways
    ]
    near = np.unique(np.concatenate(crossed))
    if len(near) == 0:
        return None
    ends = hand.sim.springs()[near].reshape(-1)
    segments = np.arange(len(ends)).reshape(-1, 2)
    color = np.tile(np.array(MARK, np.uint8), (len(ends), 1))
    radius = np.full(len(ends), 0.5 * hand.dot())
    return Marks(hand.sim.positions()[ends], radius, color, segments, on=ends)


TOOL = Tool(
    name="cut",
    help="cut springs",
    key="c",
    actions=_actions,
    remember=lambda seed: _Memory(),
    motion=_motion,
    buttons=("left",),
    press=_press,
    release=_release,
    prepare=prepared,
    draw=_draw,
    events=(
        LoggedEvent(
            "cut", {"springs": indices}, lambda sim, values: sim.cut(list(values["springs"]))
        ),
    ),
)
