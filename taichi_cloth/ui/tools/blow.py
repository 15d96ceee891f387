"""Blow at the particles near the pointer, with its motion."""

from __future__ import annotations

import numpy as np

from taichi_cloth.scene.model import Scene
from taichi_cloth.simulation.pushes import ORIGINAL_REACH
from taichi_cloth.ui.tools.contract import Hand, Tool, prepared


def _actions(scene: Scene) -> tuple[str, ...]:
    return (f"move the mouse\t{TOOL.help}",)


def _remember(seed: int) -> None:
    """Nothing: a blow follows from the pointer's motion alone."""


def _motion(hand: Hand, memory: None, before: np.ndarray, now: np.ndarray) -> None:
    """Blow by what the pointer moved since the last frame."""
    displacement = hand.place(now) - hand.place(before)
    there = hand.window.to_world(now)
    if hand.camera:
        origin, direction = hand.camera.ray(there)
        hand.sim.blow_ray(origin, direction, displacement, hand.reach())
    else:
        hand.sim.blow(there, displacement, hand.reach())


def _ring(hand: Hand) -> float:
    return hand.reach() or ORIGINAL_REACH


TOOL = Tool(
    name="blow",
    help="blow at the particles near the pointer",
    mouse="blow",
    key="b",
    actions=_actions,
    remember=_remember,
    motion=_motion,
    buttons=(),
    prepare=lambda sim: None if sim.scene.world.mouse == "blow" else prepared(sim),
    ring=_ring,
    events=(),  # the pointer's moves say it all
)
