"""The declaration of a mouse tool, and all that it works with."""

from __future__ import annotations

import string
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np

from taichi_cloth.files.events import Reader
from taichi_cloth.render.camera import Camera
from taichi_cloth.render.window_map import WindowMap
from taichi_cloth.scene.model import MOUSE_MODES, Scene
from taichi_cloth.ui import picking
from taichi_cloth.ui.inputs import BACK_KEY, BUTTONS, COMMANDS, FRAME_KEY, KEYS, KINDS, Event

if TYPE_CHECKING:
    from taichi_cloth.simulation.simulation import Simulation


@dataclass(frozen=True)
class ToolEvent:
    """An act of a tool, as it stands in the interaction log.

    kind: the name of one of its `LoggedEvent`s. values: the fields that this declares, as JSON
    has them (numbers, words, lists).
    """

    kind: str
    values: Mapping[str, Any]

    def fields(self) -> dict[str, Any]:
        """Its fields in a log's line."""
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
    """Marks of a tool beside the scene: particles and springs that are only seen.

    position: (m, dim) world units. radius: (m,) world units. color: (m, 3) uint8.
    segments: (s, 2) int, pairs of these particles.
    on: (k,) int, particles of the scene that the first k of these are drawn at, wherever the
    picture has them; None: none is.
    """

    position: np.ndarray
    radius: np.ndarray
    color: np.ndarray
    segments: np.ndarray
    on: np.ndarray | None = None

    def joined(self, other: Marks) -> Marks:
        """Both, where all that this one has is drawn at particles of the scene."""
        first, second = (np.zeros(0, int) if m.on is None else m.on for m in (self, other))
        return Marks(
            position=np.concatenate([self.position, other.position]),
            radius=np.concatenate([self.radius, other.radius]),
            color=np.concatenate([self.color, other.color]),
            segments=np.concatenate([self.segments, len(self.position) + other.segments]),
            on=np.concatenate([first, second]),
        )


@dataclass
class Hand:
    """The surroundings that a tool works with.

    sim: the simulation. camera: of a 3-D scene, else None.
    window: the map between the world and the window whose pixels events refer to.
    pointer: (2,) window pixels, where the pointer is; None before it moved.
    held: the names of the keys that are down, out of "ctrl" and the tool's modifiers.
    other: another run of the scene, beside the first, that the pointer is over; None: it is not.
    over: whether the pointer is over the world. told: what to tell the user, and how many such
        words there were: the same again is told again.
    """

    sim: Simulation
    camera: Camera | None
    window: WindowMap
    pointer: np.ndarray | None = None
    held: set[str] = field(default_factory=set)
    other: Simulation | None = None
    over: bool = True
    told: tuple[str | None, int] = None, 0

    @property
    def notice(self) -> str | None:
        """A note for the user on what was done last; None: none."""
        return self.told[0]

    @notice.setter
    def notice(self, words: str | None) -> None:
        self.told = words, self.told[1] + (words is not None)

    @property
    def seen(self) -> Simulation:
        """The run that the pointer is over, in which it finds particles and springs."""
        return self.other or self.sim

    def place(
        self, pixel: tuple[float, float] | np.ndarray, through: np.ndarray | None = None
    ) -> np.ndarray:
        """The point (dim,) of the world under a pixel of the window.

        In 3-D it lies on the plane that faces the user and goes through a point (3,); None:
        through what the camera looks at.
        """
        point = self.window.to_world(pixel)
        if self.camera is None:
            return point
        flat = self.camera.unproject(point)
        if through is None:
            return flat
        eye, along = self.camera.ray(point)
        ahead = self.camera.rotation()[2]
        return eye + along * (float((through - eye) @ ahead) / float(along @ ahead))

    def put(
        self,
        pixel: tuple[float, float] | np.ndarray,
        radius: float,
        through: np.ndarray | None = None,
    ) -> np.ndarray:
        """The place of a new sphere, (dim,): in space it lies before what is seen at the pixel.

        Where nothing is, or nothing before a point (3,) that is given, it is `place`; and where
        only what is outside the world is seen, as the floor is up to the horizon.
        """
        place = self.place(pixel, through)
        if self.camera is None:
            return place
        at = picking.Front(self.seen, self.camera, self.window).at(np.array(pixel, np.float64))
        if at is None:
            return place
        before: np.ndarray = at[0] + radius * at[1]
        eye, world = self.camera.eye, self.sim.scene.world
        if not np.all((before >= world.low) & (before <= world.high)):
            return place
        if through is not None and np.linalg.norm(place - eye) < np.linalg.norm(before - eye):
            return place
        return before

    def particle_at(
        self, pixel: tuple[float, float], among: np.ndarray | None = None
    ) -> int | None:
        """The particle that a click means (`picking.particle_at`); None: empty space."""
        return self._particle_at(pixel, among, picking.NEAR)

    def particle_near(
        self, pixel: tuple[float, float], among: np.ndarray | None = None
    ) -> int | None:
        """The same for tools that need one: in a plane, where nothing else is meant, from afar."""
        return self._particle_at(
            pixel, among, picking.NEAR if self.camera else picking.NEAR_IN_PLANE
        )

    def _particle_at(
        self, pixel: tuple[float, float], among: np.ndarray | None, near: float
    ) -> int | None:
        at = np.array(pixel, np.float64)
        return picking.particle_at(self.seen, self.camera, self.window, at, among, near)

    def pointed(self, among: np.ndarray | None = None) -> int | None:
        """The particle that a click here and now would mean (`particle_near`); None: none."""
        if self.pointer is None or not self.over:
            return None
        return self.particle_near((float(self.pointer[0]), float(self.pointer[1])), among)

    @property
    def in_pixels(self) -> bool:
        """True if the world is measured in pixels, as the original's."""
        world = self.sim.scene.world
        return world.up != "y" and min(world.size[:2]) >= FEWEST_PIXELS

    def mark(self, particle: int | None) -> Marks | None:
        """A mark in the picture that a click would take a particle; None: it takes none."""
        if particle is None:
            return None
        place, none = self.sim.positions()[[particle]], np.zeros((0, 2), np.int64)
        radius = np.array([max(1.5 * self.dot(), 1.2 * float(self.sim.radii()[particle]))])
        return Marks(place, radius, np.array([MARK], np.uint8), none, on=np.array([particle]))

    def dot(self) -> float:
        """The radius of what a tool marks, world units: in 3-D of what the camera looks at."""
        length = DOT / self.window.scale
        return length * self.camera.distance / self.camera.focal_length if self.camera else length

    def reach(self) -> float | None:
        """The reach of a tool from the pointer, world units: an eighth of what is seen.

        That is of the shorter side of the picture, in 3-D at what the camera looks at. None: the
        world is measured in pixels, as the original's, and so is what its pointer reaches.
        """
        side = min(self.sim.scene.world.size[:2])
        if self.in_pixels:
            return None
        if self.camera:
            side *= self.camera.distance / self.camera.focal_length
        return REACH * side


LONGEST_NAME = 8
OUTSIDE = "that is outside the world: click inside it"
REACH = 1 / 8  # of the picture's shorter side
DOT = 4.0  # pixels: the radius of what a tool marks
MARK = (255, 168, 48)  # of what a click would take
FEWEST_PIXELS = 100.0  # a shorter side, where y points down, is not in pixels

M = TypeVar("M")  # what a tool remembers

# What the slots below return: the events that follow, to be logged and replayed; None: none.
Events = Iterable[ToolEvent] | None


@dataclass(frozen=True, kw_only=True)
class Tool(Generic[M]):
    """A mouse tool: what it is called and does, what it writes to the log, and the slots it fills.

    Everything that a tool does follows from the log: either from the mouse's and the keyboard's
    events, which every log holds, as `motion`, `press` and `release` act on the simulation
    themselves; or, where that would depend on more (such as what was nearest to the pointer), from
    events of the tool's own, which these return. Such an event is written to the log, then handed
    to its `replay`. While a log is replayed, what they return is left out: the log holds it.

    A slot that raises InputError has it shown to the user. Slots that a tool does not fill are left
    out; what nothing else would tell to be forgotten (buttons, prepare, events) is always said.

    name: the file's name, and the word for it in the tool bar: a short one.
    help: what it does, in one line of the key list.
    mouse: the scenes' word `[world] mouse` for which it is what the pointer does from the start.
    key: the letter or digit that takes it up, and puts it away again.
    modifiers: keys that mean something to it while they are held, and nothing else meanwhile.
    actions: a scene's lines of the key list, "mouse or key<tab>what it does".
    remember: makes what the tool remembers from its first use to a reset, from the run's seed.
    motion: called before a frame if the pointer moved since the last one, but not while ctrl is
        held, with the pixels (2,) where the pointer was then and is now.
    buttons: the mouse's buttons that it uses; dragging others moves a 3-D scene's camera.
    hits: whether a press of one of these, at a place in the window, is meant for it, too; else the
        camera takes it. None: each is.
    aim: in space, the point (3,) that a press means, which its event then says (`about`), so that
        replays need not look for it.
    press, release: called when a mouse button goes down (but not while ctrl is held) and up.
    prepare: called when it is taken up: what has to be compiled before it can be used, as a
        function to call; None: nothing. It raises InputError where the scene cannot have it.
    ring: how far it reaches around the pointer, for a ring that is drawn there, world units; None:
        it has none.
    draw: what is drawn beside the scene while the tool is in hand.
    events: the kinds of events that it writes to the log.
    """

    name: str
    help: str
    mouse: str | None = None
    key: str | None = None
    modifiers: tuple[str, ...] = ()
    actions: Callable[[Scene], tuple[str, ...]]
    remember: Callable[[int], M]
    motion: Callable[[Hand, M, np.ndarray, np.ndarray], Events] | None = None
    buttons: tuple[str, ...]
    hits: Callable[[Hand, Event], bool] | None = None
    aim: Callable[[Hand, Event], np.ndarray] | None = None
    press: Callable[[Hand, M, Event], Events] | None = None
    release: Callable[[Hand, M, Event], Events] | None = None
    prepare: Callable[[Simulation], Callable[[], None] | None] | None
    ring: Callable[[Hand], float | None] | None = None
    draw: Callable[[Hand, M], Marks | None] | None = None
    events: tuple[LoggedEvent, ...]

    def __post_init__(self) -> None:
        if not self.help or "\n" in self.help:
            raise ValueError("help must be one line")
        if len(self.name) > LONGEST_NAME:
            raise ValueError(f"name must be a word of at most {LONGEST_NAME} letters")
        if not set(self.buttons) <= set(BUTTONS):
            raise ValueError(f"buttons must be out of {BUTTONS}, are {self.buttons!r}")
        if self.mouse is None and self.key is None:
            raise ValueError("it has neither mouse nor key: the tool could never be used")
        if self.press is None and (self.motion is None or self.buttons):
            raise ValueError("press is missing: what it does with the mouse's buttons")
        if self.press is not None and not self.buttons:
            raise ValueError("press is never called: it has no buttons")
        if self.mouse is not None and self.mouse not in MOUSE_MODES[1:]:
            raise ValueError(
                f"mouse: scenes know no '{self.mouse}' (MOUSE_MODES in scene/model.py)"
            )
        if self.key is not None and (
            len(self.key) != 1
            or self.key not in string.ascii_lowercase + string.digits
            or self.key in (*COMMANDS, FRAME_KEY, BACK_KEY)
        ):
            raise ValueError(
                f"key must be a letter or digit that has no other meaning, is {self.key!r}"
            )
        for key in self.modifiers:
            if key not in KEYS - {"ctrl"} or COMMANDS.get(key, "pause") != "pause":
                raise ValueError(f"modifiers: {key!r} is no key, or has another meaning")
        slots = ("motion", "hits", "aim", "press", "release", "prepare", "ring", "draw")
        for part in ("actions", "remember", *slots):
            slot = getattr(self, part)
            if not callable(slot) and (slot is not None or part in ("actions", "remember")):
                raise ValueError(f"{part} must be a function, is {slot!r}")


def prepared(sim: Simulation) -> Callable[[], None] | None:
    """Make a simulation ready for tools that hold, cut and add: compiling, where needed."""
    return None if sim.scene.world.tools else sim.prepare_tools


def usual_radius(sim: Simulation) -> float:
    """The radius of such a particle."""
    return usual(sim).get("radius", sim.scene.particle_defaults.radius)


def usual(sim: Simulation) -> dict[str, float]:
    """Mass and radius of a particle that fits in with those that a scene has, for `spawn`.

    They are the medians, of the scene as it is given; without particles, the scene's defaults.
    """
    particles = sim.scene.particles
    if len(particles) == 0 or sim.scene.world.mouse == "spawn":
        return {}
    return {name: float(np.median(getattr(particles, name))) for name in ("mass", "radius")}
