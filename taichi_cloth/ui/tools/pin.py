"""Pin a particle where it is, or let a pinned one go."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_cloth.files.events import indices
from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.palette import FIXED_COLOR, PARTICLE_COLOR
from taichi_cloth.ui.inputs import Event
from taichi_cloth.ui.tools.contract import Events, Hand, LoggedEvent, Marks, Tool, ToolEvent

if TYPE_CHECKING:
    from taichi_cloth.simulation.simulation import Simulation

COLOR = (255, 203, 107)


def _actions(scene: Scene) -> tuple[str, ...]:
    return ("left click\tpin a particle (grey), or let a pinned one go",)


def _hits(hand: Hand, event: Event) -> bool:
    return event.pos is not None and hand.particle_near(event.pos) is not None


def _press(hand: Hand, memory: None, event: Event) -> Events:
    particle = hand.particle_near(event.pos) if event.pos is not None else None
    if particle is None:
        return None
    return [ToolEvent("unpin" if hand.sim.fixed()[particle] else "pin", {"particle": particle})]


def _draw(hand: Hand, memory: None) -> Marks | None:
    """A dot at each particle that is pinned: where a surface is drawn, nothing else is grey.

    A larger one is at the particle that a click would take.
    """
    pinned, chosen = np.flatnonzero(hand.sim.fixed()), hand.mark(hand.pointed())
    if len(pinned) == 0:
        return chosen
    radius, none = np.full(len(pinned), hand.dot()), np.zeros((0, 2), np.int64)
    color = np.tile(np.array(COLOR, np.uint8), (len(pinned), 1))
    marks = Marks(hand.sim.positions()[pinned], radius, color, none, on=pinned)
    return marks if chosen is None else marks.joined(chosen)


def _pin(sim: Simulation, values: Mapping[str, Any]) -> None:
    sim.set(particles=list(values["particle"]), fixed=True, color=FIXED_COLOR)


def _unpin(sim: Simulation, values: Mapping[str, Any]) -> None:
    chosen = np.array(values["particle"])
    sim.set(particles=chosen, fixed=False, color=_free_color(sim))


def _free_color(sim: Simulation) -> np.ndarray:
    """The colour that most free particles have."""
    colors = sim.colors()[~sim.fixed()]
    codes = colors.astype(np.int64) @ (256**2, 256, 1)  # a number each, which sorts quickly
    _, first, counts = np.unique(codes, return_index=True, return_counts=True)
    found: np.ndarray = colors[first[counts.argmax()]] if len(colors) else np.array(PARTICLE_COLOR)
    return found


TOOL = Tool(
    name="pin",
    help="pin particles, let pinned ones go",
    key="i",
    actions=_actions,
    remember=lambda seed: None,
    buttons=("left",),
    hits=_hits,
    press=_press,
    prepare=None,
    draw=_draw,
    events=(
        LoggedEvent("pin", {"particle": indices}, _pin),
        LoggedEvent("unpin", {"particle": indices}, _unpin),
    ),
)
