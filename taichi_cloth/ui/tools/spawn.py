"""Put new particles where the user clicks: thrown, fixed, or tied into a chain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.palette import COLOR_CYCLE, FIXED_COLOR
from taichi_cloth.scene.scatter import VELOCITY_HIGH, VELOCITY_LOW
from taichi_cloth.ui.inputs import Event
from taichi_cloth.ui.tools.contract import OUTSIDE, Hand, Tool, prepared, usual, usual_radius


@dataclass
class _Memory:
    """random: where thrown particles get their velocities. thrown: how many were.
    newest: the index of the particle put last, which the next one of a chain is tied to.
    """

    random: np.random.Generator
    thrown: int = 0
    newest: int | None = None


def _actions(scene: Scene) -> tuple[str, ...]:
    chain = scene.spring_defaults
    tear = "" if chain.break_force is None else f", tears at force {chain.break_force:g}"
    return (
        "left click\ta new particle, thrown at random",
        "right click\ta new particle that stays where it is (grey)",
        f"hold space\ttie each new particle to the one before{tear}",
    )


def _remember(seed: int) -> _Memory:
    return _Memory(np.random.default_rng(seed))


def _aim(hand: Hand, event: Event) -> np.ndarray:
    assert event.pos is not None
    return hand.put(event.pos, usual_radius(hand.sim))


def _press(hand: Hand, memory: _Memory, event: Event) -> None:
    if event.button not in TOOL.buttons or event.pos is None:
        return
    world = hand.sim.scene.world
    # Logs of old do not say what was under the pointer.
    aimed = hand.camera is not None and event.about is not None
    place = np.array(event.about) if aimed else hand.place(event.pos)
    hand.notice = None
    if not np.all((place >= world.low) & (place <= world.high)):
        hand.notice = OUTSIDE
        return
    fixed = event.button == "right"
    velocity, color = None, FIXED_COLOR
    if not fixed:
        velocity = memory.random.uniform(VELOCITY_LOW[: world.dim], VELOCITY_HIGH[: world.dim])
        color = COLOR_CYCLE[memory.thrown % len(COLOR_CYCLE)]
        memory.thrown += 1
        if world.mouse != "spawn":  # in a scene that is not made for it, it is put there
            velocity = None
    tied_to = memory.newest if "space" in hand.held else None
    numbers = {} if world.mouse == "spawn" else usual(hand.sim)
    memory.newest = hand.sim.spawn(
        place, velocity, fixed=fixed, color=color, tied_to=tied_to, **numbers
    )


TOOL = Tool(
    name="spawn",
    help="put new particles where you click",
    mouse="spawn",
    key="n",
    modifiers=("space",),
    actions=_actions,
    remember=_remember,
    buttons=("left", "right"),
    aim=_aim,
    press=_press,
    prepare=lambda sim: None if sim.scene.world.mouse == "spawn" else prepared(sim),
    events=(),  # clicks, keys and the run's seed say it all
)
