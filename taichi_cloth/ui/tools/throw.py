"""Throw a heavy ball: in space at what is under the pointer, in a plane as that is dragged."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_cloth.files.events import number, numbers
from taichi_cloth.scene.model import Scene
from taichi_cloth.ui.inputs import Event
from taichi_cloth.ui.tools.contract import (
    OUTSIDE,
    Events,
    Hand,
    LoggedEvent,
    Marks,
    Tool,
    ToolEvent,
    usual,
)

if TYPE_CHECKING:
    from taichi_cloth.simulation.simulation import Simulation

COLOR = (236, 118, 52)
SIZE = 1 / 24  # of the picture's shorter side: the ball's radius
LARGER = 1.3  # times the radius of a particle that the scene has, at least
HEAVY = 50.0  # times the mass of such a particle
CROSSING = 45  # frames in which a ball in space goes as far as the eye is from what it looks at
DRAGGED = 12  # frames in which a ball in a plane goes as far as the pointer was dragged

LOOKS = 200  # along a line of sight that misses the box


@dataclass
class _Memory:
    """start: (2,) window pixels where the button went down; None: it is up. now: where it is."""

    start: np.ndarray | None = None


def _actions(scene: Scene) -> tuple[str, ...]:
    if scene.world.dim == 3:
        return ("left click\tthrow a ball at what is there",)
    return ("drag with left\tthrow a ball: the farther, the faster",)


def _press(hand: Hand, memory: _Memory, event: Event) -> Events:
    memory.start = None if event.pos is None else np.array(event.pos, np.float64)
    return None


def _release(hand: Hand, memory: _Memory, event: Event) -> Events:
    start, memory.start = memory.start, None
    if start is None or event.button != "left":
        return None
    hand.notice = None
    sim, world = hand.sim, hand.sim.scene.world
    radius, mass = _size(sim)
    if hand.camera:
        eye, along = hand.camera.ray(hand.window.to_world(start))
        box = world.low + radius, world.high - radius
        begin = _entry(eye, along, *box)
        if begin is None:  # what is aimed at has left the box, or hangs out of it
            begin, along = _from_beside(eye, along, hand.camera.distance, *box)
        way = max(float((hand.put(start, radius) - begin) @ along), 0.0)
        # Where the eye is near and what it is thrown at far it is faster: it never flies in a
        # higher arc than an eighth of its way, out of the picture and the world.
        flat = np.sqrt(way * np.linalg.norm(world.gravity))
        speed = max(hand.camera.distance / (CROSSING * sim.dt), flat)
        falls = way / speed  # for so long, and is thrown as much higher as it falls
        velocity = along * speed - 0.5 * falls * np.array(world.gravity)
    else:
        begin = hand.place(start)
        moved = hand.place(np.array(event.pos)) - begin
        velocity = moved / (DRAGGED * sim.dt)
        if not np.all((begin >= world.low) & (begin <= world.high)):
            hand.notice = OUTSIDE
            return None
    values = {"pos": begin.tolist(), "velocity": velocity.tolist()}
    return [ToolEvent("ball", {**values, "radius": radius, "mass": mass})]


def _size(sim: Simulation) -> tuple[float, float]:
    """Radius and mass of a ball: by the picture, and larger and heavier than a usual particle."""
    scene = sim.scene
    other = {**vars(scene.particle_defaults), **usual(sim)}
    radius = max(SIZE * min(scene.world.size[:2]), LARGER * other["radius"])
    return radius, HEAVY * other["mass"]


def _entry(
    eye: np.ndarray, along: np.ndarray, low: np.ndarray, high: np.ndarray
) -> np.ndarray | None:
    """The entry of a line of sight into a box, or the eye, if inside; None: it misses it."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.stack([(low - eye) / along, (high - eye) / along])
    ends[np.isnan(ends)] = 0.0
    first, last = float(ends.min(axis=0).max()), float(ends.max(axis=0).min())
    if last < max(first, 0.0):
        return None
    place: np.ndarray = np.clip(eye + max(first, 0.0) * along, low, high)
    return place


def _from_beside(
    eye: np.ndarray, along: np.ndarray, distance: float, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The begin of a ball in a box that the line of sight misses, and which way it goes: to what is
    seen at a distance, from the first of the places that are nearest to the way there.
    """
    way = eye + along * np.linspace(0.0, distance, LOOKS)[:, None]
    near = np.clip(way, low, high)
    off = np.linalg.norm(way - near, axis=1)
    begin: np.ndarray = near[int((off <= 1.01 * off.min()).argmax())]
    towards = way[-1] - begin
    return begin, towards / np.linalg.norm(towards)


def _draw(hand: Hand, memory: _Memory) -> Marks | None:
    """In a plane, the ball and the way of the drag."""
    if memory.start is None or hand.camera or hand.pointer is None:
        return None
    ends = np.stack([hand.place(memory.start), hand.place(hand.pointer)])
    radius = np.array([_size(hand.sim)[0], hand.dot()])
    return Marks(ends, radius, np.array([COLOR] * 2, np.uint8), np.array([[0, 1]]))


def _throw(sim: Simulation, values: Mapping[str, Any]) -> None:
    prepare = _prepare(sim)
    if prepare is not None:
        prepare()
    sim.spawn(
        values["pos"],
        values["velocity"],
        color=COLOR,
        radius=values["radius"],
        mass=values["mass"],
    )


def _prepare(sim: Simulation) -> Callable[[], None] | None:
    """Make the scene's particles collide with a ball."""
    if sim.scene.world.tools and sim.scene.world.collisions:
        return None
    return sim.prepare_balls


TOOL = Tool(
    name="throw",
    help="throw a heavy ball",
    key="t",
    actions=_actions,
    remember=lambda seed: _Memory(),
    buttons=("left",),
    press=_press,
    release=_release,
    prepare=_prepare,
    draw=_draw,
    events=(
        LoggedEvent(
            "ball",
            {"pos": numbers(), "velocity": numbers(), "radius": number, "mass": number},
            _throw,
        ),
    ),
)
