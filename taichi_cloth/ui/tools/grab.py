"""Take hold of a particle, or with shift of all near it, pull it about, and let it go."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_cloth.files.events import indices, numbers
from taichi_cloth.scene.model import Scene
from taichi_cloth.ui import picking
from taichi_cloth.ui.inputs import Event
from taichi_cloth.ui.tools.contract import (
    Events,
    Hand,
    LoggedEvent,
    Marks,
    Tool,
    ToolEvent,
    prepared,
)

if TYPE_CHECKING:
    from taichi_cloth.simulation.simulation import Simulation

COLOR = (255, 203, 107)
PATCH = 0.5  # of a tool's reach: how far from the particle others are taken along
ORIGINAL_PATCH = 25.0  # world units, likewise, where the world is measured in pixels


@dataclass
class _Memory:
    """through: (dim,), where what is held was taken; None: nothing is held."""

    through: np.ndarray | None = None


def _actions(scene: Scene) -> tuple[str, ...]:
    return (
        "drag with left\ttake hold of a particle, and let it go",
        "shift + drag\ttake a whole patch",
    )


def _hits(hand: Hand, event: Event) -> bool:
    if event.pos is None:
        return False
    if hand.particle_near(event.pos, ~hand.sim.fixed()) is not None:
        return True
    if hand.particle_near(event.pos) is not None:
        hand.notice = "that particle is pinned: i takes up the tool that lets it go"
    return False


def _press(hand: Hand, memory: _Memory, event: Event) -> Events:
    if event.pos is None:
        return None
    particle = hand.particle_near(event.pos, ~hand.sim.fixed())
    if particle is None:
        return None
    memory.through = hand.seen.positions()[particle]
    held = [particle]
    if "shift" in hand.held:
        reach = hand.reach()
        radius = ORIGINAL_PATCH if reach is None else PATCH * reach
        patch = picking.particles_within(hand.seen, hand.camera, memory.through, radius)
        held = [particle, *(int(other) for other in patch if other != particle)]
    k, c = hand.sim.hold_strength(held)
    place = hand.place(event.pos, memory.through)
    values = {"particle": held[0] if len(held) == 1 else held, "pos": place.tolist()}
    return [ToolEvent("grab", {**values, "stiffness": k.tolist(), "damping": c.tolist()})]


def _motion(hand: Hand, memory: _Memory, before: np.ndarray, now: np.ndarray) -> Events:
    if memory.through is None or hand.sim.held() is None:
        return None
    return [ToolEvent("drag", {"pos": hand.place(now, memory.through).tolist()})]


def _release(hand: Hand, memory: _Memory, event: Event) -> Events:
    if memory.through is None or event.button != "left":
        return None
    memory.through = None
    return [ToolEvent("let_go", {})]


def _draw(hand: Hand, memory: _Memory) -> Marks | None:
    """A line from each particle that is held to where it is held, and the pointer's place.

    While none is, the one that a press would take.
    """
    held = hand.sim.held()
    if held is None:
        return hand.mark(hand.pointed(~hand.sim.fixed()))
    count = len(held.particles)
    position = np.concatenate([held.targets, held.targets])  # the first of them `on` particles
    radius = np.append(np.zeros(count), np.full(count, hand.dot()))
    segments = np.column_stack([np.arange(count), count + np.arange(count)])
    color = np.tile(np.array(COLOR, np.uint8), (2 * count, 1))
    return Marks(position, radius, color, segments, on=held.particles)


def _grab(sim: Simulation, values: Mapping[str, Any]) -> None:
    k, c = (np.array(values[name]) for name in ("stiffness", "damping"))
    sim.grab(list(values["particle"]), values["pos"], k, c)


TOOL = Tool(
    name="grab",
    help="take hold of a particle",
    key="g",
    modifiers=("shift",),
    actions=_actions,
    remember=lambda seed: _Memory(),
    motion=_motion,
    buttons=("left",),
    hits=_hits,
    press=_press,
    release=_release,
    prepare=prepared,
    draw=_draw,
    events=(
        LoggedEvent(
            "grab",
            {"particle": indices, "pos": numbers(), "stiffness": numbers(), "damping": numbers()},
            _grab,
        ),
        LoggedEvent(
            "drag", {"pos": numbers()}, lambda sim, values: sim.drag(np.array(values["pos"]))
        ),
        LoggedEvent("let_go", {}, lambda sim, values: sim.let_go()),
    ),
)
