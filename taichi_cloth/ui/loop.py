"""The loop of a run: events, one frame, draw. The same for windows, pictures and plain runs."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack, closing, suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_cloth import runtime
from taichi_cloth.errors import InputError, RunFailure, SimulationFailure
from taichi_cloth.files.events import Recorder
from taichi_cloth.files.recordings import Recordings
from taichi_cloth.files.trajectory import Trajectory
from taichi_cloth.settings.options import PROGRAM
from taichi_cloth.ui import film as films
from taichi_cloth.ui import hud, style
from taichi_cloth.ui.chrome import messages
from taichi_cloth.ui.chrome.chrome import Chrome, Contents
from taichi_cloth.ui.chrome.contract import Part
from taichi_cloth.ui.chrome.errors import Errors
from taichi_cloth.ui.chrome.layout import Layout, Rect
from taichi_cloth.ui.chrome.meters import Meters
from taichi_cloth.ui.chrome.timeline_row import TimelineRow
from taichi_cloth.ui.chrome.toolbar import Button
from taichi_cloth.ui.controls import Controls
from taichi_cloth.ui.depiction import Depiction
from taichi_cloth.ui.inputs import COMMANDS, KEYS, WINDOW_KEYS, Event
from taichi_cloth.ui.interaction import Log, LogEvent
from taichi_cloth.ui.log_window import LogWindow
from taichi_cloth.ui.opening import offscreen
from taichi_cloth.ui.plane_moves import PANS, PlaneMoves
from taichi_cloth.ui.pointer import Pointer
from taichi_cloth.ui.scenes import OWNED, Scenes
from taichi_cloth.ui.schedule import Schedule
from taichi_cloth.ui.shutter import Shutter
from taichi_cloth.ui.status import Status
from taichi_cloth.ui.summary import Summary
from taichi_cloth.ui.takes import Takes
from taichi_cloth.ui.text import Panel, Word
from taichi_cloth.ui.timeline import SPEEDS, Pace
from taichi_cloth.ui.travel import Travel
from taichi_cloth.ui.views.contract import Picture, View

if TYPE_CHECKING:
    from taichi_cloth.simulation.running_costs import RunningCosts
    from taichi_cloth.simulation.simulation import Simulation
    from taichi_cloth.ui.chrome.settings_panel import SettingsPanel


class Loop:
    """The state of a run between turns."""

    def __init__(
        self,
        sim: Simulation,
        view: View,
        *,
        replay: Log | None,
        recorder: Recorder | None,
        trajectory: Trajectory | Recordings | None,
        on_frame: Callable[[Simulation], object] | None,
        film: films.Film | None,
        shutter: Shutter,
        paused: bool,
        status: bool,
        meters: bool,
        show: frozenset[str] | None,
        seed: int,
        device: str | None,
        about: Mapping[str, Any] | None = None,
        scenes: Scenes | None = None,
        errors: Errors | None = None,
    ):
        self.sim, self.view, self._about = sim, view, about
        self._scenes = scenes or Scenes(fixed=OWNED)
        self._opening = ""  # the name of the scene that is made ready
        self.left = False  # whether another scene goes on in the window
        self._recorder, self._trajectory = recorder, trajectory
        self._on_frame = on_frame
        self._takes, self._shutter = Takes(film, shutter), shutter
        if replay is not None:
            seed = int(replay.header.get("seed", seed))
        self._log = dict(replay.by_frame) if replay is not None else {}
        self._log_end = max(self._log, default=-1)
        self._window = LogWindow(sim, view, replay)
        self._controls = Controls(sim, view.camera, self._window.size, seed, self._note)
        self._travel: Travel | None = None
        if view.visible:
            self._travel = Travel(
                sim, self._controls, view.camera, recorder, trajectory, reruns=on_frame is None
            )
        # In space the camera moves, which logs know.
        self._looks = PlaneMoves(sim.scene.world) if view.camera is None else None
        self._pace = Pace()
        self._depiction = Depiction(sim, show)
        self._meters = Meters(sim, windowed=view.visible, errors=errors)
        self._schedule = Schedule()
        parts: list[Part] = [self._meters]
        self._costs: RunningCosts | None = None
        self._settings: SettingsPanel | None = None
        if self._travel:
            timeline = self._travel.timeline
            parts.append(TimelineRow(timeline, self._go_to, lambda: self._pace.slowness))
        if view.visible:
            from taichi_cloth.simulation.running_costs import RunningCosts  # which needs Taichi
            from taichi_cloth.ui.chrome.settings_panel import SettingsPanel

            self._costs = RunningCosts()
            self._settings = SettingsPanel(sim, self._controls, self._costs, self._scenes)
            parts.insert(0, self._settings)
        self._chrome = Chrome(
            windowed=view.visible,
            status=status,
            parts=parts,
            text=view.text_size,
            opened=self._scenes.beside,
        )
        if meters and not self._chrome.is_open("meters") and self._scenes.beside is None:
            self._chrome.toggle("meters")
        if self._scenes.said:
            self._controls.tell(self._scenes.said)
        self._buttons: tuple[Button, ...] = ()
        self._paused = paused and view.visible
        self._step = self._compiling = False
        self._show_help = False
        self.failure: SimulationFailure | None = None
        self._meter = hud.Meter()
        self._status = Status(sim, device or runtime.current_device().describe(), self._meter)
        self._started: float | None = None
        self._simulate, self._draw, self.frames, self.quit = 0.0, 0.0, 0, False

    # One turn

    def begin(self) -> None:
        """Show a window's first picture before the first frame, which may have to be compiled."""
        if self.view.visible:
            self._entitle()
            self.view.draw(self._picture())

    def turn(self) -> None:
        """Events, at most one frame, draw, and the wait until the next frame is due."""
        self._entitle()
        self._take_events()
        if self.quit or self.left or self.view.closed:
            return
        simulate = 0.0
        due = self._step or (not self._paused and self._pace.turn())
        if due and self.failure is None:
            begin = time.perf_counter()
            if self._started is None:
                self._started = begin
            if self._glides:
                self._depiction.between.leave(self.sim)
            self._advance()
            simulate = time.perf_counter() - begin
            if self.frames > 1:
                self._simulate += simulate
            advanced = self.failure is None and not self.quit
        else:
            advanced = False
        self._step = False
        if not self._glides:
            self._depiction.between.forget()
        begin = time.perf_counter()
        self._takes.turn(advanced)
        seen = self.view.visible
        if self._takes.due or (seen and self._schedule.draws(advanced, self.view.size)):
            self.view.draw(self._picture())
        if self._takes.due:
            self._take(self.view.grab() if not self.view.closed else self._last_picture())
        draw = time.perf_counter() - begin
        self._draw += draw
        if advanced:
            if self._pace.slowness == 1:  # else late, and on purpose
                self._meter.frame(simulate, draw)
            if self._chrome.is_open("meters"):
                self._meters.frame(simulate, draw, self._schedule.waited)
            if self._costs:
                self._costs.note(self.sim, simulate)
        if self.view.visible:
            self.sim.prepare_click()
            self._schedule.wait(self._stopped)

    def _take(self, pixels: np.ndarray) -> None:
        """Put the frame (h, w, 3) uint8 into the films and the picture that want it."""
        self._takes.take(pixels, self.view.room or Rect(0, 0, *self.view.size))

    def _entitle(self) -> None:
        """Have the window's title say the scene and what it is doing."""
        if self.view.visible:
            state = self._state_of_run().text.partition(":")[0]
            self.view.entitle(f"{self.sim.scene.name}, {state} - {PROGRAM}")

    def _advance(self) -> None:
        if self._on_frame is not None and self._on_frame(self.sim) is False:
            self.quit = True
            return
        if self._controls.waits and self.view.visible:
            self._say_that_it_compiles()
        if self._travel:
            # Events of a log that is being replayed belong to the frames that there were.
            if self._replaying and self._travel.away:
                self.frames = self._travel.go(self._travel.timeline.frames.stop - 1)
            self._travel.go_on()
        self._controls.before_frame(replayed=self._replaying)
        if self._chrome.is_open("meters"):
            self._meters.before_frame()
        try:
            self.sim.advance(1)
        except SimulationFailure as error:
            if not self.view.visible:
                raise
            self.failure = error
            self._status.hurry()
            self._meter.interrupt()
            return
        self.frames += 1
        if self._trajectory is not None:
            self._trajectory.record(self.sim)
        if self._travel:
            self._travel.note(self.frames)

    def _go_to(self, frame: int) -> None:
        """Go back, or on, to one of the frames of the last seconds, and pause there."""
        if self._travel is None or not self._travel.timeline.frames:
            return
        self.frames = self._travel.go(frame)
        self._paused, self.failure = True, None
        self._meter.interrupt()

    # Events

    @property
    def _replaying(self) -> bool:
        """Whether the log still has events for this frame or a later one."""
        return self.frames <= self._log_end

    def _take_events(self) -> None:
        for logged in self._log.pop(self.frames, ()):
            self._note(logged)
            # Pauses and steps only say when frames were made; a log says that itself.
            command = self._controls.apply(logged, replayed=True)
            if command in ("reset", "status", "show", "strain", "meters", "help", "quit"):
                self._obey(command)
        for given in self.view.poll():  # after which the window may have another size
            self._schedule.wake()
            # An event may have opened or closed what the next one would be for.
            event = self._chrome.take(given, self._arranged(), self._buttons)
            if event is None:
                continue
            if self._replaying:
                if event.key in WINDOW_KEYS and event.kind == "press":
                    self._obey(COMMANDS[event.key])
                continue
            logged = self._window.taken(event)
            if self._looks:
                taken = self._looks.take(event, self._window.here, free=self._moves_look(logged))
                self.view.look = self._looks.look
                if taken:
                    continue
            event = logged
            # What no log has a name for, nothing reacts to.
            if (event.key is None or event.key in KEYS - {"escape"}) and not self.quit:
                self._note(event)
            command = self._controls.apply(event)
            if self._travel:
                self._travel.settle()
            if command:
                self._obey(command)
        self._give_settings()
        self._open_scene()

    def _moves_look(self, event: Event) -> bool:
        """Whether a press, in the log's window, moves what is seen of a plane."""
        return event.button in PANS and not self._controls.takes(event)

    def _give_settings(self) -> None:
        """Have what was changed in the panel take effect; say so before that compiles."""
        if self._settings is None or not self._settings.given:
            return
        if self._replaying:
            self._settings.forget()
            return
        if self._settings.compiles:
            self._say_that_it_compiles()
        self._settings.flush()
        self._meter.interrupt()

    def _say_that_it_compiles(self) -> None:
        """Draw a window that stands still from now on, and says why."""
        self._compiling = True
        self._status.hurry()
        self._entitle()
        self.view.draw(self._picture())
        self._compiling = False

    def _note(self, event: LogEvent) -> None:
        if self._travel:
            self._travel.event(self.frames, event)
        elif self._recorder is not None:
            self._recorder.write(self.frames, event)

    def _obey(self, command: str) -> None:
        if command == "quit":
            self.quit = True
        elif command == "pause" and self.failure is None:
            self._paused = not self._paused
            self._meter.interrupt()
        elif command == "step" and self._travel and self._travel.away:
            self._go_to(self.frames + 1)
        elif command == "step":
            self._step = self._paused
        elif command == "back":
            self._go_to(self.frames - 1)
        elif command == "slow":
            self._pace.slower() if self._pace.slowness < SPEEDS[-1] else self._pace.full()
            self._meter.interrupt()
        elif command == "reset":
            if self._travel:
                self._travel.go_on()
            saved = self._trajectory.frames if self._trajectory is not None else 0
            self.sim.reset()
            self._controls.reset(hud.reset_notice(saved) if saved else None)
            self.failure = None
            self._meter.restart()
            self._meters.restart()
        elif command == "status":
            self._chrome.next_status()
        elif command == "show":
            self._depiction.show_next()
        elif command == "strain":
            self._depiction.strain = not self._depiction.strain
        elif command == "picture":
            self._shutter.press()
        elif command == "film":
            self._shutter.begin_or_end()
        elif command == "checkpoint":
            now = self.sim.checkpoint()
            self._shutter.keep(".checkpoint.npz", lambda path: now.save(path, self._about))
        elif command == "export" and self._travel:
            self._shutter.keep(".seconds.npz", self._travel.timeline.export)
        elif command == "error":
            self._controls.tell(self._meters.switch_error())
            if self._meters.measures and not self._chrome.is_open("meters"):
                self._obey("meters")
        elif self._chrome.toggle(command):
            if command == self._meters.name:
                self._meters.restart()
        elif command == "help":
            self._show_help = not self._show_help
        self._status.hurry()

    def _open_scene(self) -> None:
        """Make the scene that was chosen ready: the run ends for it, or goes on where it cannot."""
        name = self._settings.take_scene() if self._settings else None
        if name is None:
            return
        self._opening = name
        self._entitle()
        self.view.draw(self._picture())
        self._opening = ""
        try:
            self._scenes.open(name)
        except (InputError, RunFailure) as error:
            self._controls.tell(f"{name} was not opened: {error}")
            self._meter.interrupt()
            return
        self._scenes.beside = self._chrome.opened
        self.left, self.failure = True, None

    # Pictures

    @property
    def _glides(self) -> bool:
        """Whether pictures between frames are drawn: films take frames, and tools at rest, too."""
        return self._pace.slowness > 1 and not self._stopped and not self._takes.filming

    def _picture(self, *, now: bool = False) -> Picture:
        """What is drawn. now: the present frame, also in slow motion."""
        part = self._pace.part if self._glides and not now else 1.0
        picture = self._depiction.picture(self._controls.marks(), part)
        layout = self._arranged()
        return replace(
            picture,
            overlay=(*self._chrome.overlay(layout, self._contents()), *self._legend(layout)),
            pointer=self._pointer(),
        )

    def _legend(self, layout: Layout) -> tuple[Panel, ...]:
        """What the colours mean, where they mean anything."""
        if not self._depiction.strain:
            return ()
        meanings = self._depiction.strained.legend()
        return (messages.legend(meanings, layout.world, layout.text),)

    def _arranged(self) -> Layout:
        """Where everything is in the view as it is now; the view draws the world in its room."""
        layout = self._chrome.layout(self.view.size)
        self.view.room = layout.world
        return layout

    def _contents(self) -> Contents:
        """What is written around the world."""
        sim = self.sim
        banner: str | None = None
        keys: tuple[str, ...] = ()
        if self.failure is not None:
            banner = f"Stopped: {self.failure}\nr goes back to the start, escape quits"
        if self._show_help:
            saves = self._trajectory is not None
            keys = hud.help_lines(sim.scene, self.view.has_wheel, self._controls.tool, saves=saves)
        tool = self._controls.tool
        opens = self._chrome.buttons()
        self._buttons = hud.buttons(
            sim.scene, tool, opens, paused=self._paused, strain=self._depiction.strain
        )
        windowed = self.view.visible
        rows = self._status.rows(
            time.perf_counter() if windowed else self.frames / hud.FRAME_RATE,
            state=self._state_of_run() if windowed else None,
            moving=not self._stopped and self._pace.slowness == 1,
            tool=tool.name if tool else None,
            notice=self._controls.notice,
            urgent=self._shutter.notice,
        )
        return Contents(rows, self._buttons, keys, banner)

    def _pointer(self) -> Pointer | None:
        """The pointer, where a log or a film shows it, and a window's cursor does not.

        GGUI's is hidden while a button is held.
        """
        place, camera = self._controls.pointer, self.view.camera
        if place is None:
            return None
        place, ring = self._window.shown(place), self._controls.ring()
        if ring is not None:
            nearness = camera.focal_length / camera.distance if camera else 1.0
            ring *= self._window.here.scale * nearness
        cross = self._controls.pressed or self._replaying or not self.view.visible
        return Pointer(place, ring, cross) if cross or ring is not None else None

    @property
    def _stopped(self) -> bool:
        return self._paused or self.failure is not None

    def _state_of_run(self) -> Word:
        """What a window is doing, in a word."""
        if self._opening:
            return Word(f"opening {self._opening}: compiling takes a moment, once", style.WARN)
        if self.failure is not None:
            return Word("stopped", style.BAD)
        if self._shutter.state is not None:
            paused = ", paused" if self._paused else ""
            return Word(self._shutter.state + paused, style.RECORDING)
        if self._compiling:
            return Word("compiling, the window waits", style.WARN)
        if self._paused:
            return Word("paused", style.WARN)
        if self.frames == 0:
            return Word("starting: compiling takes a moment, once", style.WARN)
        state = "replaying" if self._replaying else "playing"
        return Word(", ".join(filter(None, (state, self._pace.words))), style.GOOD)

    def finish(self, image: films.Image | None) -> None:
        """Save the film, and the last frame as a picture."""
        with ExitStack() as files:  # each is tried, also where a disk is full
            self._takes.save(files)
            if image is not None:
                files.callback(lambda: image.save(self._last_picture()))
            if self._takes.missing:
                self._take(self._last_picture())

    def pixels(self) -> np.ndarray:
        """The present frame, (h, w, 3) uint8, drawn anew."""
        self.view.draw(self._picture(now=True))
        return self.view.grab()

    def _last_picture(self) -> np.ndarray:
        """The last frame, (h, w, 3) uint8; drawn off-screen where the user closed the window."""
        if not self.view.closed:
            # Anew: since the last frame the user may have done things.
            with suppress(RunFailure):  # the window goes at this very moment
                self.view.draw(self._picture(now=True))
        if self.view.closed:
            with closing(offscreen(self.view, self.sim.scene.world)) as view:
                view.draw(self._picture(now=True))
                return view.grab()
        return self.view.grab()

    def summary(self) -> Summary:
        """What the run did so far."""
        seconds = time.perf_counter() - self._started if self._started is not None else 0.0
        parts = self._simulate, self._draw, self._schedule.waited_in_all
        return Summary(self.frames, seconds, *parts, self.quit)
