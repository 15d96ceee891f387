"""What a mouse tool declares, and what it is given to work with."""

from __future__ import annotations

import string
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np

from taichi_cloth.files.events import Reader
from taichi_cloth.scene.model import MOUSE_MODES, Scene
from taichi_cloth.ui.camera import Camera
from taichi_cloth.ui.inputs import COMMANDS, KEYS, KINDS, Event
from taichi_cloth.ui.window_map import WindowMap

if TYPE_CHECKING:
    from taichi_cloth.simulation.simulation import Simulation


@dataclass(frozen=True)
class ToolEvent:
    """What a tool did, as it stands in the interaction log.

    kind: the name of one of its `LoggedEvent`s. values: the fields that this declares, as JSON
    has them (numbers, words, lists).
    """

    kind: str
    values: Mapping[str, Any]

    def fields(self) -> dict[str, Any]:
        """What a log's line says of it."""
        return dict(self.values)


@dataclass(frozen=True)
class LoggedEvent:
    """A kind of event that a tool writes to the interaction log.

    name: the word in a line's "event", unlike that of any other event.
    fields: readers of its fields, by name: `number`, `whole_number`, `pair` of `files/events.py`,
        or one of the tool's own, which returns what JSON can hold.
    replay: does to a simulation what such an event says, from the fields' values as they were read.
    """

    name: str
    fields: Mapping[str, Reader]
    replay: Callable[[Simulation, Mapping[str, Any]], None]

    def __post_init__(self) -> None:
        if self.name in (kind.name for kind in KINDS):
            raise ValueError(f"events: '{self.name}' is the mouse's or the keyboard's")
        if not {"frame", "event"}.isdisjoint(self.fields):
            raise ValueError(f"events: '{self.name}' has a field called frame or event")


@dataclass(frozen=True)
class Marks:
    """What a tool draws beside the scene: particles and springs that are only seen.

    position: (m, dim) world units. radius: (m,) world units. color: (m, 3) uint8.
    segments: (s, 2) int, pairs of these particles.
    """

    position: np.ndarray
    radius: np.ndarray
    color: np.ndarray
    segments: np.ndarray


@dataclass
class Hand:
    """What a tool works with.

    sim: the simulation. camera: of a 3-D scene, else None.
    window: the map between the world and the window whose pixels events refer to.
    pointer: (2,) window pixels, where the pointer is; None before it moved.
    held: the names of the keys that are down, out of "ctrl" and the tool's modifiers.
    notice: what to tell the user about what was done last; None: nothing.
    """

    sim: Simulation
    camera: Camera | None
    window: WindowMap
    pointer: np.ndarray | None = None
    held: set[str] = field(default_factory=set)
    notice: str | None = None

    def place(self, pixel: tuple[float, float] | np.ndarray) -> np.ndarray:
        """The point (dim,) of the world under a pixel of the window.

        In 3-D it lies on the plane through the world's centre that faces the user.
        """
        point = self.window.to_world(pixel)
        return self.camera.unproject(point) if self.camera else point

    def reach(self) -> float | None:
        """How far from the pointer a tool acts, world units: an eighth of what is seen.

        That is of the shorter side of the picture, in 3-D at what the camera looks at. None: the
        world is measured in pixels, as the original's, and so is what its pointer reaches.
        """
        world = self.sim.scene.world
        side = min(world.size[:2])
        if world.up != "y" and side >= FEWEST_PIXELS:
            return None
        if self.camera:
            side *= self.camera.distance / self.camera.focal_length
        return REACH * side


REACH = 1 / 8  # of the picture's shorter side
FEWEST_PIXELS = 100.0  # a shorter side, where y points down, is not in pixels

M = TypeVar("M")  # what a tool remembers

# What the slots below return: the events that follow, to be logged and replayed; None: none.
Events = Iterable[ToolEvent] | None


@dataclass(frozen=True, kw_only=True)
class Tool(Generic[M]):
    """A mouse tool. Every part is given; one that the tool does not have is None or empty.

    Everything that a tool does follows from the log: either from the mouse's and the keyboard's
    events, which every log holds, as `motion`, `press` and `release` act on the simulation
    themselves; or, where that would depend on more (such as what was nearest to the pointer), from
    events of the tool's own, which these return. Such an event is written to the log, then handed
    to its `replay`. While a log is replayed, what they return is left out: the log holds it.

    A slot that raises InputError has it shown to the user.

    name: the file's name.
    help: what it does, in one line of the key list.
    mouse: the scenes' word `[world] mouse` for which it is what the pointer does from the start.
    key: the letter that takes it up, and puts it away again.
    modifiers: keys that mean something to it while they are held, and nothing else meanwhile.
    actions: a scene's lines of the key list, "mouse or key<tab>what it does".
    remember: makes what the tool remembers from its first use to a reset, from the run's seed.
    motion: called before a frame if the pointer moved since the last one, but not while ctrl is
        held, with the pixels (2,) where the pointer was then and is now.
    press, release: called when a mouse button goes down (but not while ctrl is held) and up.
    draw: what is drawn beside the scene while the tool is in hand.
    events: the kinds of events that it writes to the log.
    """

    name: str
    help: str
    mouse: str | None
    key: str | None
    modifiers: tuple[str, ...]
    actions: Callable[[Scene], tuple[str, ...]]
    remember: Callable[[int], M]
    motion: Callable[[Hand, M, np.ndarray, np.ndarray], Events] | None
    press: Callable[[Hand, M, Event], Events] | None
    release: Callable[[Hand, M, Event], Events] | None
    draw: Callable[[Hand, M], Marks | None] | None
    events: tuple[LoggedEvent, ...]

    def __post_init__(self) -> None:
        if not self.help or "\n" in self.help:
            raise ValueError("help must be one line")
        if self.mouse is None and self.key is None:
            raise ValueError("mouse and key are both None: the tool could never be used")
        if self.mouse is not None and self.mouse not in MOUSE_MODES[1:]:
            raise ValueError(
                f"mouse: scenes know no '{self.mouse}' (MOUSE_MODES in scene/model.py)"
            )
        if self.key is not None and (
            len(self.key) != 1 or self.key not in string.ascii_lowercase or self.key in COMMANDS
        ):
            raise ValueError(f"key must be a letter that has no other meaning, is {self.key!r}")
        for key in self.modifiers:
            if key not in KEYS - {"ctrl"} or COMMANDS.get(key, "pause") != "pause":
                raise ValueError(f"modifiers: {key!r} is no key, or has another meaning")
        for part in ("actions", "remember", "motion", "press", "release", "draw"):
            slot = getattr(self, part)
            if not callable(slot) and (slot is not None or part in ("actions", "remember")):
                raise ValueError(f"{part} must be a function, is {slot!r}")
