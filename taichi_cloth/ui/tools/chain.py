"""Tie a chain: each click puts a particle that is tied to the one before, or takes one there is.

A link is as long as it was clicked, and never breaks; it can be cut.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_cloth.files.events import flag, numbers, so_many_indices
from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.palette import COLOR_CYCLE, FIXED_COLOR
from taichi_cloth.ui.inputs import Event
from taichi_cloth.ui.tools.contract import (
    OUTSIDE,
    Events,
    Hand,
    LoggedEvent,
    Marks,
    Tool,
    ToolEvent,
    prepared,
    usual,
    usual_radius,
)

if TYPE_CHECKING:
    from taichi_cloth.simulation.simulation import Simulation

COLOR = (255, 203, 107)


@dataclass
class _Memory:
    """newest: the particle that the next click is tied to; None: the next one begins a chain."""

    newest: int | None = None


def _actions(scene: Scene) -> tuple[str, ...]:
    return (
        "left click\ta particle tied to the last one; on a particle: to that one",
        "right click\tthe same, with one that stays where it is (grey)",
        "shift + click\tbegin another chain",
    )


def _press(hand: Hand, memory: _Memory, event: Event) -> Events:
    if event.pos is None:
        return None
    sim, world = hand.sim, hand.sim.scene.world
    before = memory.newest if memory.newest is not None else sim.particle_count
    begins = "shift" in hand.held or before >= sim.particle_count
    hit = hand.particle_at(event.pos)
    hand.notice = None
    if hit is not None:
        memory.newest = hit
        if begins or hit == before:
            hand.notice = f"the chain goes on from particle {hit}"
            return None
        return [_chained(before, hit)]
    through = None if begins else hand.seen.positions()[before]
    place = hand.put(event.pos, usual_radius(sim), through)
    if not np.all((place >= world.low) & (place <= world.high)):
        hand.notice = OUTSIDE
        return None
    memory.newest = sim.particle_count
    fixed = event.button == "right"
    put = ToolEvent("link", {"pos": place.tolist(), "fixed": fixed, "tied_to": []})
    return [put] if begins else [put, _chained(before, memory.newest)]


def _chained(i: int, j: int) -> ToolEvent:
    return ToolEvent("chain", {"particles": [i, j]})


def _draw(hand: Hand, memory: _Memory) -> Marks | None:
    """A dot at the particle that the next click is tied to."""
    if memory.newest is None or memory.newest >= hand.sim.particle_count:
        return None
    place = hand.sim.positions()[memory.newest]
    radius = max(hand.dot(), 1.2 * float(hand.sim.radii()[memory.newest]))
    none = np.zeros((0, 2), np.int64)
    return Marks(place[None], np.array([radius]), np.array([COLOR], np.uint8), none)


def _link(sim: Simulation, values: Mapping[str, Any]) -> None:
    fixed, tied = values["fixed"], values["tied_to"]
    color = FIXED_COLOR if fixed else COLOR_CYCLE[sim.particle_count % len(COLOR_CYCLE)]
    tied_to = tied[0] if tied else None
    sim.spawn(values["pos"], fixed=fixed, color=color, tied_to=tied_to, **usual(sim))


def _chain(sim: Simulation, values: Mapping[str, Any]) -> None:
    sim.add_spring(*values["particles"], break_force=math.inf)


def _tie(sim: Simulation, values: Mapping[str, Any]) -> None:
    sim.add_spring(*values["particles"])


TOOL = Tool(
    name="chain",
    help="tie a chain, click by click",
    key="j",
    modifiers=("shift",),
    actions=_actions,
    remember=lambda seed: _Memory(),
    buttons=("left", "right"),
    press=_press,
    prepare=prepared,
    draw=_draw,
    events=(
        LoggedEvent(
            "link", {"pos": numbers(), "fixed": flag, "tied_to": so_many_indices(0, 1)}, _link
        ),
        LoggedEvent("chain", {"particles": so_many_indices(2, 2)}, _chain),
        # Logs of old have links that break as the scene's own, and `tied_to` in a link.
        LoggedEvent("tie", {"particles": so_many_indices(2, 2)}, _tie),
    ),
)
