"""The contents of a window: the world, and around it what is written of the run."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth import runtime
from taichi_cloth.errors import printable
from taichi_cloth.render.picture import Picture, Rect
from taichi_cloth.render.pointer import Pointer
from taichi_cloth.settings.options import PROGRAM
from taichi_cloth.ui import hud
from taichi_cloth.ui.chrome.chrome import Chrome, Contents, key_list
from taichi_cloth.ui.chrome.contract import Part
from taichi_cloth.ui.chrome.layout import NOTHING, ROWS, Layout, arrange
from taichi_cloth.ui.chrome.meters import Meters
from taichi_cloth.ui.chrome.timeline_row import TimelineRow
from taichi_cloth.ui.chrome.toolbar import Button
from taichi_cloth.ui.chrome.why import Finding, Why
from taichi_cloth.ui.controls import Controls
from taichi_cloth.ui.depiction import Depiction
from taichi_cloth.ui.halves import Pair, halves
from taichi_cloth.ui.inputs import COMMANDS, Event
from taichi_cloth.ui.log_window import LogWindow
from taichi_cloth.ui.request import Request
from taichi_cloth.ui.run_state import RunState
from taichi_cloth.ui.schedule import FRAME_RATE
from taichi_cloth.ui.status import Status
from taichi_cloth.ui.takes import Takes
from taichi_cloth.ui.text import Word
from taichi_cloth.ui.travel import Travel
from taichi_cloth.ui.view import View

if TYPE_CHECKING:
    from taichi_cloth.simulation.running_costs import RunningCosts
    from taichi_cloth.simulation.simulation import Simulation
    from taichi_cloth.ui.chrome.settings_panel import SettingsPanel

READ_SECONDS = 10.0  # how long the foot of the settings has what was told, in lines of its own
SAMPLE = 200  # particles of which one is nearly always in the picture


class Presentation:
    """Makes the pictures of a run, and knows what is open in them.

    sim, view: what is shown, and where. request: what was asked of the run. state: where it is.
    controls: the tool in hand and the pointer. window: the log's. takes: the films.
    travel: through the last seconds; None: without a window. go_to: shows one of their frames.

    depiction: of the world. pair: of a second run beside it; None: there is none. meter: of the
    rates. meters, chrome: around the world. settings: the panel, and costs: what it says frames
    take; both None without a window. why: why it stopped.
    """

    def __init__(
        self,
        sim: Simulation,
        view: View,
        request: Request,
        state: RunState,
        controls: Controls,
        window: LogWindow,
        takes: Takes,
        travel: Travel | None,
        go_to: Callable[[int], None],
    ) -> None:
        self._sim, self._view, self._state, self._takes = sim, view, state, takes
        self._controls, self._window = controls, window
        self._saves, self._budget = request.trajectory is not None, request.budget
        self._scenes = request.scenes
        self.depiction = Depiction(sim, request.show, request.errors)
        second = request.beside
        self.pair = Pair(second, self.depiction, windowed=view.visible) if second else None
        self.meter = hud.Meter()
        device = request.device or runtime.current_device().describe()
        self._status = Status(sim, device, self.meter)
        self.meters = Meters(sim, windowed=view.visible, errors=request.errors, beside=second)
        self.why = Why()
        parts: list[Part] = [self.meters]
        self.costs: RunningCosts | None = None
        self.settings: SettingsPanel | None = None
        if travel:
            parts.append(TimelineRow(travel.timeline, go_to, lambda: state.pace.slowness))
        if view.visible:
            from taichi_cloth.simulation.running_costs import RunningCosts  # which needs Taichi
            from taichi_cloth.ui.chrome.settings_panel import SettingsPanel

            self.costs = RunningCosts()
            self.settings = SettingsPanel(
                sim, controls, self.costs, request.scenes,
                lambda: self._status.told(READ_SECONDS), request.budget,
            )  # fmt: skip
            parts.insert(0, self.settings)
            parts.append(self.why)
        opened = request.scenes.opened
        self.chrome = Chrome(
            windowed=view.visible,
            status=request.status,
            parts=parts,
            text=view.text_size,
            opened=opened,
        )
        if request.meters and not self.chrome.is_open("meters") and opened is None:
            self.chrome.toggle("meters")
        self._buttons: tuple[Button, ...] = ()
        self._show_help = False

    def title(self) -> str:
        """A window's title: the scene, and what it is doing."""
        word = self._state.word(self._takes.shutter.state).text.partition(":")[0]
        return f"{printable(self._sim.scene.name)}, {word} - {PROGRAM}"

    def hurry(self) -> None:
        """Have the status say the next frame's rates."""
        self._status.hurry()

    def take(self, event: Event) -> Event | None:
        """Take an event that may be for what is around the world; None: nothing more."""
        if event.kind == "leave" or event.pos is not None:
            over = event.pos is not None and self.arranged().world.holds(event.pos)
            self._controls.hover(over or bool(self._controls.pressed))
        if event.kind == "leave":
            return None
        if self._lists_keys and event.kind == "press":
            if COMMANDS.get(event.key or "") == "quit":
                return event  # it closes the key list, which lies over all else
            if event.pos is not None and self._key_list(self.arranged()).holds(event.pos):
                self._show_help = False  # what is behind it was not meant
                return None
        return self.chrome.take(event, self.arranged(), self._buttons)

    def obey(self, command: str) -> bool:
        """Do a command that changes what is shown; whether it is one."""
        if command == "status":
            self.chrome.next_status()
        elif command == "show":
            self.depiction.show_next()
        elif command == "strain":
            # Without springs all would be calm, and no button or legend would say why.
            self.depiction.strain = not self.depiction.strain and self._sim.spring_count > 0
        elif command == "help":
            self._show_help = not self._show_help
            if self._show_help and self._takes.shutter.state and not self._state.stopped:
                self._controls.tell("films leave the key list out: it is seen while paused (p)")
        elif command in ("error", "ghost"):
            said = self.meters.switch(command)
            if self._budget and not self.meters.measures and self._budget.unmeasured():
                said += "; nothing is held any more"
            self._controls.tell(said)
            if self.meters.measures and not self.chrome.is_open("meters"):
                self.obey("meters")
        elif self.chrome.toggle(command):
            if command == self.meters.name:
                self.meters.restart()
            small = f"{command}: no room here, a larger window has it"
            if self.chrome.lacks_room(command, self.arranged()):
                self._controls.tell(small)
            elif self._controls.notice == small:
                self._controls.tell(None)
        else:
            return False
        return True

    @property
    def _lists_keys(self) -> bool:
        """True if the key list is seen; a film that is being made leaves it out."""
        filmed = self._takes.shutter.state is not None and not self._state.stopped
        return self._show_help and not filmed

    def _keys(self) -> tuple[str, ...]:
        """The lines of the key list."""
        tool, saves = self._controls.tool, self._saves
        scene, tied = self._sim.scene, self._sim.spring_count > 0
        file = bool(self._scenes.file) and not self._scenes.fixed
        wheel = self._view.has_wheel
        return hud.help_lines(scene, wheel, tool, saves=saves, tied=tied, file=file)

    def _key_list(self, layout: Layout) -> Rect:
        """The place of the key list."""
        panel = key_list(self._keys(), layout)
        tall, wide = panel.tile.pixels.shape[:2]
        return Rect(panel.x, panel.y, wide, tall)

    def close_last(self) -> bool:
        """Close the key list, or what was opened last around the world; whether any was open."""
        if self._lists_keys:
            self._show_help = False
            return True
        return self.chrome.close_last(self.arranged())

    def open_finding(self, finding: Finding | None) -> None:
        """Show why the run stopped, and the frames before, to go through."""
        self.why.finding = finding
        for name in (self.why.name, "timeline") if finding else ():
            if not self.chrome.is_open(name):
                self.chrome.toggle(name)

    def close_finding(self) -> None:
        """The run goes on: what was found out is over."""
        if self.why.finding is not None and self.chrome.is_open(self.why.name):
            self.chrome.toggle(self.why.name)
        self.why.finding = None

    @property
    def glides(self) -> bool:
        """True if pictures between frames are drawn: films take frames, and tools at rest, too."""
        state = self._state
        return state.pace.slowness > 1 and not state.stopped and not self._takes.filming

    def picture(self, *, now: bool = False, pointed: bool = True) -> Picture:
        """The picture to draw.

        now: the present frame, also in slow motion. pointed: with the pointer.
        """
        part = self._state.pace.part if self.glides and not now else 1.0
        picture = self.depiction.picture(self._controls.marks(), part)
        layout = self.arranged()
        around = self.chrome.overlay(layout, self._contents())
        pointer = self._pointer() if pointed else None
        picture = replace(picture, overlay=around, pointer=pointer)
        return self._with_second(picture, layout, part, pointed) if self.pair else picture

    def _with_second(self, picture: Picture, layout: Layout, part: float, pointed: bool) -> Picture:
        """A picture with the second run beside the first."""
        pair, cut = self.pair, halves(layout.world, layout.text)
        assert pair is not None
        first = second = picture.pointer
        if pointed and self._points is not None:  # it is seen in both, also where no cursor is
            at = first or Pointer(self._window.shown(self._points), None, False)
            first = replace(at, cross=at.cross or self._window.side == 1)
            second = replace(
                at,
                place=at.place + [self._window.apart, 0],
                cross=at.cross or self._window.side == 0,
            )
        marks = self._controls.marks(pair.sim)
        half = pair.half(cut.right, marks, part, second)
        overlay = (*pair.panels(cut, layout.text), *picture.overlay)
        return replace(picture, overlay=overlay, pointer=first, beside=half)

    def leave(self) -> None:
        """The frame that is seen is left for the next."""
        self.depiction.between.leave(self._sim)
        if self.pair:
            self.pair.leave()

    def forget(self) -> None:
        """There is no frame that was left."""
        self.depiction.between.forget()
        if self.pair:
            self.pair.forget()

    def arranged(self) -> Layout:
        """Arrange everything in the view as it is now; the view draws the world in its room."""
        # A picture that a key takes shows the world in all of the window, whatever is open.
        alone = self._takes.shutter.due and not self._takes.filming
        size = self._view.size
        layout = arrange(size, NOTHING) if alone else self.chrome.layout(size)
        self._view.room = layout.world
        if self.pair:
            cut = halves(layout.world, layout.text)
            self._view.room, self._window.right = cut.left, cut.right
        return layout

    def _contents(self) -> Contents:
        """The text around the world."""
        sim, state, tool = self._sim, self._state, self._controls.tool
        windowed, shutter = self._view.visible, self._takes.shutter
        banner: str | None = None
        keys: tuple[str, ...] = ()
        if state.failure is not None:
            finding = self.why.finding
            onward = "u goes on with what survives, " if finding and finding.settings else ""
            keys_said = f"{onward}r goes back to the start, escape quits"
            banner = f"Stopped: {state.failure}\n{keys_said}"
            if finding is not None and self.chrome.is_open(self.why.name):
                banner = f"Stopped: {finding.title}"
        if self._show_help:
            keys = self._keys()
        opens = self.chrome.buttons()
        self._buttons = hud.buttons(
            sim.scene, tool, opens, paused=state.paused, tied=sim.spring_count > 0,
            strain=self.depiction.strain, ghost=self.depiction.ghostly,
        )  # fmt: skip
        urgent, told = shutter.notice, self._controls.told
        if state.exporting or state.opening:  # nothing is told before that
            urgent, told = None, (None, 0)
        rows = self._status.rows(
            time.perf_counter() if windowed else state.frames / FRAME_RATE,
            state=state.word(shutter.state) if windowed else None,
            moving=not state.stopped and state.pace.slowness == 1,
            tool=tool.name if tool else None,
            told=told,
            urgent=urgent,
            budget=self._budget.status() if self._budget else None,
            in_view=self._in_view,
            found=self.pair.second.finding() if self.pair else None,
            faster=self._faster,
            whole=self.chrome.opened.strip == ROWS,
        )
        hints = self._controls.hints if windowed and not state.replaying else ()
        if self._takes.of_world:  # over which these lie
            keys, banner, hints = (), None, ()
        return Contents(rows, self._buttons, keys, banner, self.depiction.legends(), hints)

    def _faster(self) -> Word | None:
        """Advice that would make late frames shorter; a script has no flags, and no budget."""
        budget = self._budget
        return hud.faster(self.meter, shortens=lambda: budget is not None and budget.shortens)

    def _in_view(self) -> bool:
        """True if any particle or triangle is in the picture, or there is none at all."""
        place, radius, camera = self._sim.drawn_positions(), self._sim.radii(), self._view.camera
        few = slice(None, None, 1 + len(place) // SAMPLE)  # nearly always one of them is
        here, near = self._window.here, camera.nearest_drawn if camera else -np.inf
        for some in few, slice(None):
            points, reach, depth = place[some], radius[some], np.zeros(len(place[some]))
            if camera:
                points, reach, depth = camera.project(points, reach)
            if (here.shows(points, reach) & (depth > near)).any():
                return True
        triangles = self._sim.drawn_triangles()  # of which one may fill the picture
        corners = points[triangles]
        middle = corners.mean(axis=1)
        reach = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1, initial=0.0)
        before_us = (depth[triangles] > near).all(axis=1)
        return not len(place) or bool((here.shows(middle, reach) & before_us).any())

    @property
    def _points(self) -> np.ndarray | None:
        """The pointer's place, (2,), in the log's window; None: in a picture, which has none."""
        return None if self._takes.shutter.due else self._controls.pointer

    def _pointer(self) -> Pointer | None:
        """The pointer, where a log or a film shows it, and a window's cursor does not.

        GGUI's is hidden while a button is held.
        """
        place, camera = self._points, self._view.camera
        if place is None:
            return None
        place, ring = self._window.shown(place), self._controls.ring()
        if self._lists_keys and self._key_list(self.arranged()).holds((place[0], place[1])):
            ring = None  # it would lie over the words
        if ring is not None:
            nearness = camera.focal_length / camera.distance if camera else 1.0
            ring *= self._window.here.scale * nearness
        cross = bool(self._controls.pressed) or self._state.replaying or not self._view.visible
        return Pointer(place, ring, cross) if cross or ring is not None else None
