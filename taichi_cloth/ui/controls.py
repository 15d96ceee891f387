"""What the mouse and the keys do: the tool in hand, the camera, and the program's own keys."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_cloth.errors import InputError
from taichi_cloth.ui import interaction, tools
from taichi_cloth.ui.camera import Camera
from taichi_cloth.ui.inputs import COMMANDS, FARTHER_KEYS, NEARER_KEYS, Event
from taichi_cloth.ui.interaction import LogEvent
from taichi_cloth.ui.tools.contract import Events, Hand, Marks, Tool, ToolEvent
from taichi_cloth.ui.window_map import WindowMap

if TYPE_CHECKING:
    from taichi_cloth.simulation.simulation import Simulation

DEGREES_A_PIXEL = 0.1
ZOOM_STEP = 1.1  # factor a wheel notch or key press


class Controls:
    """Turns events into actions on the simulation and the camera.

    Everything it does follows from its seed, the size of the window and the events, so that the
    same events at the same frames give the same run.

    sim: what is acted on. camera: of a 3-D scene, else None.
    window: (width, height) in pixels that the events' positions refer to.
    seed: of the tools' random numbers.
    note: called with every event that a tool makes, before it is applied.
    """

    def __init__(
        self,
        sim: Simulation,
        camera: Camera | None,
        window: tuple[int, int],
        seed: int = 0,
        note: Callable[[ToolEvent], None] | None = None,
    ):
        world = sim.scene.world
        self._seed, self._note = seed, note
        self._hand = Hand(sim, camera, WindowMap.of(world, window))
        self._before: np.ndarray | None = None  # [window pixels] when the last frame began
        self._memory: dict[str, Any] = {}  # what each tool remembers, by name
        self._first = self.tool = tools.for_mouse(world.mouse)
        self._by_key = {tool.key: tool for tool in tools.load_all().values() if tool.key}

    @property
    def notice(self) -> str | None:
        """What to tell the user about what was done last."""
        return self._hand.notice

    def apply(self, event: LogEvent, *, replayed: bool = False) -> str | None:
        """Do what `event` asks for.

        replayed: whether it comes from a log, which also holds what tools made of it.

        What is not the simulation's or the camera's is returned for the app to do: "pause",
        "step", "reset", "status", "show", "picture", "film", "help" or "quit".
        """
        if isinstance(event, ToolEvent):
            self._replay(event)
        elif event.kind == "move":
            self._move(np.array(event.pos, np.float64))
        elif event.kind == "wheel":
            self._zoom(event.delta)
        elif event.button is not None:
            self._click(event, replayed)
        elif event.key is not None:
            return self._key(event.kind, event.key)
        return None

    def _key(self, kind: str, key: str) -> str | None:
        held = self._hand.held
        if kind == "release":
            held.discard(key)
        elif key == "ctrl" or (self.tool and key in self.tool.modifiers):
            held.add(key)
        elif key in NEARER_KEYS:
            self._zoom(1)
        elif key in FARTHER_KEYS:
            self._zoom(-1)
        elif key in self._by_key:
            self._take_up(self._by_key[key])
        else:
            command = COMMANDS.get(key)
            if command in ("pause", "step"):
                self._before = None  # where the pointer went meanwhile is no gust
            return command
        return None

    def _take_up(self, tool: Tool[Any]) -> None:
        """Take `tool` in hand, or put it away for what the pointer did from the start."""
        self.tool = self._first if self.tool is tool else tool
        self._before = None
        self._hand.notice = f"{self.tool.name}: {self.tool.help}" if self.tool else None

    def _move(self, pixel: np.ndarray) -> None:
        hand = self._hand
        if "ctrl" in hand.held and hand.camera and hand.pointer is not None:
            # The side that faces us follows the pointer.
            dx, dy = (pixel - hand.pointer) * DEGREES_A_PIXEL
            hand.camera.rotate(-dx, dy)
            self._before = None
        hand.pointer = pixel

    def _zoom(self, notches: float) -> None:
        if self._hand.camera:
            self._hand.camera.zoom(ZOOM_STEP ** float(np.clip(notches, -100, 100)))

    def _click(self, event: Event, replayed: bool) -> None:
        if self.tool is None:
            return
        if event.kind == "release":
            self._use(self.tool.release, event, replayed=replayed)
        elif "ctrl" not in self._hand.held:
            self._use(self.tool.press, event, replayed=replayed)

    def before_frame(self, *, replayed: bool = False) -> None:
        """Let the tool follow the pointer's motion since the last frame; call before `advance`.

        The first position that is ever seen comes with no motion. replayed: as for `apply`.
        """
        now, before = self._hand.pointer, self._before
        self._before = now
        if now is None or before is None or (now == before).all() or "ctrl" in self._hand.held:
            return
        if self.tool is not None:
            self._use(self.tool.motion, before, now, replayed=replayed)

    def marks(self) -> Marks | None:
        """What the tool in hand draws beside the scene."""
        if self.tool is None or self.tool.draw is None:
            return None
        return self.tool.draw(self._hand, self._remembered(self.tool))

    def _use(self, slot: Callable[..., Events] | None, *what: object, replayed: bool) -> None:
        """Call a slot of the tool in hand; log and apply the events that it makes."""
        if slot is None or self.tool is None:
            return
        try:
            made = slot(self._hand, self._remembered(self.tool), *what)
        except InputError as error:
            self._hand.notice = str(error)
            return
        for event in () if replayed or made is None else made:
            # As a log holds it, so that a replay does the same to the bit.
            event = interaction.as_logged(event)
            if self._note is not None:
                self._note(event)
            self._replay(event)

    def _replay(self, event: ToolEvent) -> None:
        try:
            interaction.replay(self._hand.sim, event)
        except InputError as error:
            self._hand.notice = str(error)

    def _remembered(self, tool: Tool[Any]) -> Any:
        if tool.name not in self._memory:
            self._memory[tool.name] = tool.remember(self._seed)
        return self._memory[tool.name]

    def reset(self, notice: str | None = None) -> None:
        """The scene is at its start again: let the tools forget what they did.

        notice: what to tell the user about it.
        """
        self._before = None
        self._hand.notice = notice
        self._memory.clear()
