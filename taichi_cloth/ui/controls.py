"""Mouse and keys: the tool in hand, the camera, and the program's own keys."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_cloth.errors import InputError, nearest
from taichi_cloth.render.camera import Camera
from taichi_cloth.render.window_map import WindowMap
from taichi_cloth.ui import interaction, tools
from taichi_cloth.ui.camera_moves import CameraMoves
from taichi_cloth.ui.inputs import (
    BACK_KEY,
    COMMANDS,
    DRAGS,
    FARTHER_KEYS,
    FRAME_KEY,
    HOME_KEY,
    NEARER_KEYS,
    Event,
)
from taichi_cloth.ui.interaction import LogEvent
from taichi_cloth.ui.picking import particle_at
from taichi_cloth.ui.tools.contract import Events, Hand, Marks, Tool, ToolEvent

if TYPE_CHECKING:
    from taichi_cloth.simulation import live
    from taichi_cloth.simulation.simulation import Simulation


class Controls:
    """Turns events into actions on the simulation and the camera.

    Everything it does follows from its seed, the size of the window and the events, so that the
    same events at the same frames give the same run. What would depend on more, such as which tool
    a key takes up or whether a drag found a particle, is noted as an event of its own, and a replay
    does what these say.

    sim: what is acted on. camera: of a 3-D scene, else None.
    window: (width, height) in pixels that the events' positions refer to.
    seed: of the tools' random numbers.
    note: called with every event that follows from another one, before it is applied.
    """

    def __init__(
        self,
        sim: Simulation,
        camera: Camera | None,
        window: tuple[int, int],
        seed: int = 0,
        note: Callable[[LogEvent], None] | None = None,
    ):
        world = sim.scene.world
        self._seed, self._note = seed, note
        self._hand = Hand(sim, camera, WindowMap.of(world, window))
        self._moves = CameraMoves(camera) if camera else None
        self._aim: tuple[tuple[float, float], np.ndarray] | None = None  # of the wheel that turns
        self._before: np.ndarray | None = None  # [window pixels] when the last frame began
        self._memory: dict[str, Any] = {}  # what each tool remembers, by name
        self._first = self.tool = tools.for_mouse(world.mouse)
        self._by_key = {tool.key: tool for tool in tools.load_all().values() if tool.key}
        self._waiting: Callable[[], None] | None = None
        self.pressed = ""  # the button of the mouse that is down
        self._clicked = False  # whether a tool was ever used
        self.refusal = ""  # why what the last event asked of the simulation was refused; "": done

    @property
    def notice(self) -> str | None:
        """A note for the user on what was done last."""
        return self._hand.notice

    @property
    def told(self) -> tuple[str | None, int]:
        """The notice, and how many there were: what is told again has the same words."""
        return self._hand.told

    @property
    def held(self) -> frozenset[str]:
        """The keys that are down, out of "ctrl" and the tool's modifiers."""
        return frozenset(self._hand.held)

    @property
    def pointer(self) -> np.ndarray | None:
        """The pointer's place, (2,) pixels of the window that events refer to; None: unknown."""
        return self._hand.pointer

    @property
    def chosen(self) -> str:
        """The name of the tool that is in hand in the place of the scene's own; "": none is."""
        return self.tool.name if self.tool and self.tool is not self._first else ""

    @property
    def hints(self) -> tuple[str, ...]:
        """Lines of the key list on clicks with the scene's own tool, until the first one."""
        tool = self.tool
        if self._clicked or tool is None or tool is not self._first or not tool.buttons:
            return ()
        return tool.actions(self._hand.sim.scene)

    @property
    def waits(self) -> bool:
        """True if the next `before_frame` compiles for seconds, of which `notice` tells."""
        return self._waiting is not None

    def ring(self) -> float | None:
        """The reach of the tool in hand, world units; None: it has no ring."""
        if self.tool is None or self.tool.ring is None or not self._hand.over:
            return None
        return self.tool.ring(self._hand)

    def hover(self, over: bool) -> None:
        """Know whether the pointer is over the world: else no tool points at anything."""
        self._hand.over = over

    def tell(self, notice: str | None) -> None:
        """Tell the user something; None: what was told is no longer so."""
        self._hand.notice = notice

    def tell_as_before(self, told: tuple[str | None, int]) -> None:
        """Have told what was: nothing of what came meanwhile."""
        self._hand.told = told

    def aimed(self, event: Event) -> Event:
        """The event that is to be applied and noted, which says what point of space it is about.

        A press of a button is about the one that the tool in hand aims at. The wheel is about what
        is under the pointer, at the depth of the particle that a click would mean, else of an
        obstacle or of a floor, else of what the camera looks at; and about the same one while it
        turns on there. A key that zooms is about what the camera looks at.
        """
        hand, tool, point = self._hand, self.tool, None
        if hand.camera is None:
            return event
        if event.kind == "press" and event.key in (*NEARER_KEYS, *FARTHER_KEYS):
            point, self._aim = hand.camera.centre, None
        elif event.pos is None:
            return event
        elif event.kind == "wheel":
            point = self._under(event.pos)
        elif tool is not None and tool.aim is not None and self._presses(event):
            point = tool.aim(hand, event)
        return event if point is None else replace(event, about=tuple(map(float, point)))

    def _presses(self, event: Event) -> bool:
        """True if it is a press that the tool in hand takes: with ctrl it turns the scene."""
        return event.kind == "press" and self.takes(event) and "ctrl" not in self._hand.held

    def _under(self, pos: tuple[float, float]) -> np.ndarray:
        """The point (3,) that the wheel comes nearer to with the pointer at a pixel."""
        hand, moves = self._hand, self._moves
        if self._aim is None or self._aim[0] != pos or moves is None or not moves.zooms:
            pixel, seen = np.array(pos, np.float64), hand.seen
            meant = particle_at(seen, hand.camera, hand.window, pixel)
            through = hand.put(pixel, 0.0) if meant is None else seen.positions()[meant]
            self._aim = pos, hand.place(pixel, through)
        return self._aim[1]

    def apply(self, event: LogEvent, *, replayed: bool = False) -> str | None:
        """Do what `event` asks for.

        replayed: whether it comes from a log, which also holds what came of it.

        What is not the simulation's or the camera's is returned for the app to do: "pause",
        "step", "reset", "status", "show", "picture", "film", "help" or "quit".
        """
        self.refusal = ""
        if not isinstance(event, Event):
            self._replay(event)
        elif event.kind == "move":
            self._move(np.array(event.pos, np.float64))
        elif event.kind == "wheel":
            if self._moves:
                self._moves.zoom(event.delta, event.about)
        elif event.kind == "tool":
            self._take_up(event.name or "")
        elif event.kind == "view":
            self._view(event)
        elif event.button is not None:
            self._click(event, replayed)
        elif event.key is not None:
            return self._key(event, event.key, replayed)
        return None

    def choose(self, name: str) -> None:
        """Take up the tool of this name; "": put away the one in hand, for the scene's own.

        It is noted, as all that follows from what the user does. InputError for an unknown name.
        """
        known = tools.load_all()
        if name and name not in known:
            raise InputError(f"unknown tool '{name}'; {nearest(name, known)}")
        self._follow(Event("tool", name=name))

    def put_away(self) -> bool:
        """Put away the tool in hand, for the scene's own; whether there was one."""
        chosen = bool(self.chosen)
        if chosen:
            self.choose("")
        return chosen

    def set(self, name: str, value: live.Value) -> None:
        """Give a setting of `simulation.live` a value, or tell the user why it is refused.

        It is noted, as `choose` is.
        """
        self._follow(interaction.set_event(name, value))

    def _follow(self, event: LogEvent) -> None:
        """Note an event that follows from what the user did, and apply it."""
        if self._note is not None:
            self._note(event)
        self.apply(event)

    def _key(self, event: Event, key: str, replayed: bool) -> str | None:
        held, moves = self._hand.held, self._moves
        if event.kind == "release":
            held.discard(key)
        elif key == "ctrl" or (self.tool and key in self.tool.modifiers):
            held.add(key)
        elif key in (*NEARER_KEYS, *FARTHER_KEYS) and moves:
            moves.zoom(1 if key in NEARER_KEYS else -1, event.about)
        elif key == BACK_KEY and moves:
            moves.back()
        elif key == HOME_KEY and moves:
            moves.to(moves.home)
        elif key == FRAME_KEY and moves:
            pose = None if replayed else moves.framing(self._hand.sim)
            if pose is not None:
                self.look_from(pose)
        elif key in self._by_key:
            chosen = self._by_key[key]
            if not replayed:
                self.choose("" if self.tool is chosen else chosen.name)
        else:
            command = COMMANDS.get(key)
            if command in ("pause", "step"):
                self._before = None  # where the pointer went meanwhile is no gust
            return command
        return None

    def look_from(self, pose: tuple[float, ...]) -> None:
        """Have the camera of a scene in space take a pose."""
        self._follow(Event("view", pose=pose))

    def _take_up(self, name: str) -> None:
        """Take a tool in hand, or ("") put it away for what the pointer did from the start."""
        hand, before = self._hand, self.tool
        chosen = tools.load_all().get(name, self._first)
        self._before = None
        hand.held.difference_update(before.modifiers if before else ())
        hand.sim.let_go()
        try:
            prepare = chosen.prepare(hand.sim) if chosen and chosen.prepare else None
        except InputError as error:
            hand.notice = str(error)
            return
        self.tool = chosen
        hand.notice = f"{chosen.name}: {chosen.help}" if chosen else None
        if chosen and prepare is not None:
            self._waiting = prepare
            takes = "some seconds, up to half a minute where bodies touch"
            hand.notice = f"{chosen.name}: compiling for it, {takes}"

    def _view(self, event: Event) -> None:
        """Move the camera to a pose, or let the button that is down drag it."""
        if self._moves is None:
            return
        if event.pose is not None:
            self._moves.to(event.pose)
        elif event.drag is not None:
            self._moves.begin(event.drag)
            self._before = None

    def _move(self, pixel: np.ndarray) -> None:
        hand, moves = self._hand, self._moves
        if moves and hand.pointer is not None:
            moved = pixel - hand.pointer
            if "ctrl" in hand.held:
                moves.turn(moved)
                self._before = None
            elif moves.drags:
                moves.drag(moved, hand.window.scale)
                self._before = None
        hand.pointer = pixel

    def _click(self, event: Event, replayed: bool) -> None:
        tool, button = self.tool, event.button
        self.pressed = (button or "") if event.kind == "press" else ""
        if event.kind == "release":
            if self._moves and self._moves.drags == DRAGS.get(button or ""):
                self._moves.end()
                self._before = None
            elif tool is not None:
                self._use(tool.release, event, replayed=replayed)
        elif "ctrl" not in self._hand.held:
            if tool and self.takes(event):
                self._clicked = True
                self._use(tool.press, event, replayed=replayed)
            elif self._moves and button in DRAGS and not replayed:
                self._follow(Event("view", drag=DRAGS[button]))

    def takes(self, event: Event) -> bool:
        """True if the press of a button is for the tool in hand; else it may move what is seen."""
        tool = self.tool
        if tool is None or event.button not in tool.buttons:
            return False
        return not tool.hits or tool.hits(self._hand, event)

    def before_frame(self, *, replayed: bool = False) -> None:
        """Let the tool follow the pointer's motion since the last frame; call before `advance`.

        The first position that is ever seen comes with no motion. replayed: as for `apply`.
        What waits to be compiled is compiled first.
        """
        if self._waiting is not None:
            waiting, self._waiting = self._waiting, None
            if self._try(waiting) and self.tool is not None:
                self._hand.notice = f"{self.tool.name}: {self.tool.help}"
        now, before = self._hand.pointer, self._before
        self._before = now
        if now is None or before is None or (now == before).all() or "ctrl" in self._hand.held:
            return
        if self.tool is not None and not (self._moves and self._moves.drags):
            self._use(self.tool.motion, before, now, replayed=replayed)

    def look_at(self, sim: Simulation | None) -> None:
        """Have the pointer find what it is over in another run of the scene; None: in its own."""
        self._hand.other = sim

    def marks(self, sim: Simulation | None = None) -> Marks | None:
        """Marks of the tool in hand, drawn beside the scene; sim: of another run of it."""
        if self.tool is None or self.tool.draw is None:
            return None
        hand = self._hand if sim is None else replace(self._hand, sim=sim)
        return self.tool.draw(hand, self._remembered(self.tool))

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
            self._follow(interaction.as_logged(event))

    def _replay(self, event: ToolEvent) -> None:
        self._try(lambda: interaction.replay(self._hand.sim, event))

    def _try(self, action: Callable[[], None]) -> bool:
        """Do something, or tell the user why it cannot be done; whether it was."""
        try:
            action()
        except InputError as error:
            self._hand.notice = self.refusal = str(error)
            return False
        return True

    def _remembered(self, tool: Tool[Any]) -> Any:
        if tool.name not in self._memory:
            self._memory[tool.name] = tool.remember(self._seed)
        return self._memory[tool.name]

    def memory(self) -> dict[str, Any]:
        """All that later events depend on, beside the simulation; `recall` takes it."""
        hand = self._hand
        return {
            "tool": self.tool,
            "tools": copy.deepcopy(self._memory),
            "pointer": (hand.pointer, self._before, self.pressed),
            "keys": frozenset(hand.held),
            "camera": self._moves.memory() if self._moves else None,
        }

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Go back to such a memory."""
        hand, self.tool = self._hand, memory["tool"]
        self._memory = copy.deepcopy(memory["tools"])
        hand.pointer, self._before, self.pressed = memory["pointer"]
        hand.held = set(memory["keys"])
        self._waiting = self._aim = None
        if self._moves:
            self._moves.recall(memory["camera"])

    def reset(self, notice: str | None = None) -> None:
        """The scene is at its start again: let the tools forget what they did.

        notice: what to tell the user about it.
        """
        self._before = None
        self._hand.notice = notice
        self._memory.clear()
