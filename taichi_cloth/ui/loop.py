"""The loop of a run: events, one frame, draw. The same for windows, pictures and plain runs."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack, closing, suppress
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth import signals
from taichi_cloth.errors import InputError, RunFailure, SimulationFailure
from taichi_cloth.ui import film as films
from taichi_cloth.ui import hud
from taichi_cloth.ui.chrome.budget import METHOD, OFF
from taichi_cloth.ui.controls import Controls
from taichi_cloth.ui.inputs import COMMANDS, KEYS, RESET_KEY, WINDOW_KEYS, Event
from taichi_cloth.ui.interaction import LogEvent
from taichi_cloth.ui.log_window import LogWindow
from taichi_cloth.ui.opening import offscreen
from taichi_cloth.ui.plane_moves import PANS, PlaneMoves
from taichi_cloth.ui.presentation import Presentation
from taichi_cloth.ui.request import Request
from taichi_cloth.ui.run_state import RunState
from taichi_cloth.ui.schedule import Schedule
from taichi_cloth.ui.shutter import Shutter
from taichi_cloth.ui.summary import Summary
from taichi_cloth.ui.takes import Takes
from taichi_cloth.ui.timeline import SPEEDS, Timeline
from taichi_cloth.ui.travel import Travel
from taichi_cloth.ui.view import View

if TYPE_CHECKING:
    from taichi_cloth.simulation.live import Value
    from taichi_cloth.simulation.simulation import Simulation

# Frames that nothing looks at are advanced together, as a launch each takes longer than frames of
# small scenes: as many as take so many seconds, in which a bar does not seem to stand still, and
# at most so many.
TOGETHER, MOST_TOGETHER = 0.02, 64


class Loop:
    """A run between turns; `state` says where it is.

    request: what is asked of it. film: that of the whole view; None: none is made.
    """

    def __init__(
        self,
        sim: Simulation,
        view: View,
        request: Request,
        film: films.Film | None = None,
    ):
        self.sim, self.view, self._request = sim, view, request
        replay = request.replay
        self._log = dict(replay.by_frame) if replay is not None else {}
        self.state = state = RunState(
            paused=(request.paused or request.scenes.paused) and view.visible,
            log_end=max(self._log, default=-1),
        )
        self._shutter = Shutter(sim.scene.name, request.pictures, quiet=request.quiet)
        self._takes = Takes(film, self._shutter)
        self._window = LogWindow(sim, view, replay)
        self._controls = Controls(
            sim, view.camera, self._window.size, request.tools_seed, self._note
        )
        recorder, trajectory = request.recorder, request.trajectory
        self._travel: Travel | None = None
        if view.visible:
            reruns = request.on_frame is None
            beside = request.beside.sim if request.beside else None
            self._travel = Travel(
                sim, self._controls, view.camera, recorder, trajectory, reruns, beside
            )
        # In space the camera moves, which logs know.
        self._looks = PlaneMoves(sim, view.look) if view.camera is None else None
        self._shown = Presentation(
            sim, view, request, state, self._controls, self._window, self._takes, self._travel,
            self._go_to,
        )  # fmt: skip
        self._schedule = Schedule()
        self._started: float | None = None
        self._simulate, self._draw = 0.0, 0.0
        self._a_frame = TOGETHER  # seconds that the last frames took to simulate, each
        # What ends the run once its present frame is in all files.
        self._stop: KeyboardInterrupt | InputError | None = None
        self._resume = 0  # the frame from which a run that failed may go on with what survives

    # One turn

    def begin(self) -> None:
        """Show a window's first picture before the first frame, which may have to be compiled."""
        scenes = self._request.scenes
        if scenes.tool:
            self._controls.choose(scenes.tool)
        if scenes.pose is not None:
            self._controls.look_from(scenes.pose)
        if scenes.said:
            self._controls.tell(scenes.said)
        if self.view.visible:
            self._say_that_it_compiles()
            self._prepare_clicks()

    @property
    def ended(self) -> bool:
        """True if the user ended the run, or went on to another scene."""
        return self.view.closed or self.state.quit or self.state.left

    def turn(self) -> None:
        """Events, at most one frame, draw, and the wait until the next frame is due.

        Of frames that nothing looks at there may be more. This is the place at which signals end a
        run: all that it writes has the same last frame here.
        """
        began, before = time.perf_counter(), self.state.frames
        self._entitle()
        self._take_events()
        if self.ended:
            return
        due = self.state.due()
        simulate = self._advance_timed() if due else 0.0
        advanced = due and self.state.failure is None and not self.state.quit
        if not self._shown.glides:
            self._shown.forget()
        begin = time.perf_counter()
        self._takes.turn(advanced)
        seen = self.view.visible
        if self._takes.due or (seen and self._schedule.draws(advanced, self.view.size)):
            self.view.draw(self._shown.picture())
        if self._takes.due:
            self._take(self.view.grab() if not self.view.closed else self._last_picture())
        draw = time.perf_counter() - begin
        self._draw += draw
        if advanced:
            self._a_frame = simulate / max(self.state.frames - before, 1)
            self._note_cost(self._a_frame, draw)
        if advanced and self._request.budget:  # whose frame is all of this but the wait
            rest = time.perf_counter() - began - simulate
            self._request.budget.after_frame(simulate, rest)
        if self._stop:
            raise self._stop
        signals.check()
        if seen:
            self._schedule.wait(self.state.stopped)

    def _note_cost(self, simulate: float, draw: float) -> None:
        """Have rates, meters and settings know what a frame took, in seconds."""
        shown = self._shown
        if self.state.pace.slowness == 1:  # else late, and on purpose
            shown.meter.frame(simulate, draw)
        if shown.chrome.is_open("meters"):
            shown.meters.frame(simulate, draw, self._schedule.waited)
        if shown.costs:
            beside = self._request.beside
            shown.costs.note(self.sim, simulate - (beside.took if beside else 0.0))

    def _take(self, pixels: np.ndarray) -> None:
        """Put the frame (h, w, 3) uint8 into the films and the picture that want it."""
        self._takes.take(pixels, self._shown.arranged().world)

    def _entitle(self) -> None:
        """Have the window's title say the scene and what it is doing."""
        if self.view.visible:
            self.view.entitle(self._shown.title())

    def _show_now(self) -> None:
        """Draw a window before something that takes long."""
        self._entitle()
        self.view.draw(self._shown.picture())

    def _advance_timed(self) -> float:
        """Advance a frame; the seconds that it took."""
        begin = time.perf_counter()
        if self._started is None:
            self._started = begin
        if self._shown.glides:
            self._shown.leave()
        self._advance()
        simulate = time.perf_counter() - begin
        if self.state.frames > 1:  # the first compiles, and is never one of several
            self._simulate += simulate
        return simulate

    def _advance(self) -> None:
        state, request = self.state, self._request
        if request.on_frame is not None and request.on_frame(self.sim) is False:
            state.quit = True
            return
        others = [request.beside.sim] if request.beside else []
        changes = any(sim.changes_over for sim in [self.sim, *others])
        if self.view.visible and (self._controls.waits or changes):
            self._say_that_it_compiles()
        if self._travel:
            # Events of a log that is being replayed belong to the frames that there were.
            if state.replaying and self._travel.away:
                state.frames = self._travel.go(self._travel.timeline.frames.stop - 1)
            self._travel.go_on()
        if request.budget:
            request.budget.before_frame(self._give)
        self._controls.before_frame(replayed=state.replaying)
        if self.view.visible:
            self._prepare_clicks()
        if self._shown.chrome.is_open("meters"):
            self._shown.meters.before_frame()
        begin, done = time.perf_counter(), self.sim.frame
        try:
            self.sim.advance(self._together())
        except SimulationFailure as error:
            if not self.view.visible:
                raise
            state.failure = error
            self._end_replay()
            self._shown.hurry()
            self._shown.meter.interrupt()
            self._examine()
            return
        except KeyboardInterrupt as stop:  # between two frames: this one is whole
            self._stop = stop
        finally:
            state.frames += self.sim.frame - done
        if self._shown.pair:
            self._shown.pair.note(time.perf_counter() - begin)
        if request.trajectory is not None:
            try:
                request.trajectory.record(self.sim)
            except InputError as full:  # a disk: the other files get this frame, too
                self._stop = full
        if self._travel:
            self._travel.note(state.frames)

    def _together(self) -> int:
        """The number of frames to advance at once: one where anything may look at each."""
        state, request = self.state, self._request
        looked_at = self.view.visible or self._takes.filming or self._shown.chrome.is_open("meters")
        held = request.budget is not None and request.budget.chosen != OFF
        by_frame = request.on_frame, request.trajectory, request.beside
        if looked_at or held or state.replaying or any(what is not None for what in by_frame):
            return 1
        left = (request.frames or state.frames + 1) - state.frames
        fit = int(TOGETHER / max(self._a_frame, TOGETHER / MOST_TOGETHER))
        return max(1, min(fit, left))

    def _give(self, name: str, value: Value) -> None:
        """Have what a budget chose take effect; say so before that compiles."""
        if self.view.visible and name == METHOD:
            self._say_that_it_compiles()
        self._controls.set(name, value)

    def _end_replay(self) -> None:
        """Give the mouse back: what a log has for later belongs to a run that did not fail here."""
        self._log.clear()
        self.state.log_end = -1

    def _asks_for_trials(self, event: Event) -> bool:
        """True if an event is the panel's key, of a failure of which no setting was tried yet."""
        finding, key = self._shown.why.finding, self._shown.why.key
        untried = finding is not None and not finding.tried and self.state.failure is not None
        return untried and event.kind == "press" and event.key == key

    def _examine(self, tries: bool = False) -> None:
        """Find out why the run failed, which takes a moment, and open what says so.

        tries: whether a setting that survives is looked for, which takes longer.
        """
        examiner = self._request.examiner
        if examiner is None:
            return

        def tell(words: str) -> None:
            self.state.examining = words
            self._shown.hurry()
            self._show_now()

        tell("looking for the cause")
        finding = examiner.examine(tell, tries)
        self._resume = self.state.frames - (finding.back if finding else 0)
        self._shown.open_finding(finding)
        self.state.examining = ""
        self._shown.hurry()

    def _survive(self) -> None:
        """Go back some frames, and on with the setting that survived."""
        finding, settings = self._shown.why.finding, self._shown.settings
        if finding is None or not finding.settings or settings is None:
            first = "k looks for one first" if finding and not finding.tried else "there is none"
            self._controls.tell(f"u goes on with a setting that survives a failure; {first}")
            return
        if finding.whole:  # which the timeline does not reach
            self._take_event(Event("press", key="r"))
        else:
            self._go_to(self._resume)
        settings.given.update(finding.settings)
        self._give_settings()
        self.state.paused = False
        self._shown.close_finding()

    def _go_to(self, frame: int) -> None:
        """Go back, or on, to one of the frames of the last seconds, and pause there."""
        if self._travel is None or not self._travel.timeline.frames:
            return
        self.state.frames = self._travel.go(frame)
        if self.state.failure is not None:
            self._controls.tell(None)
        self.state.paused, self.state.failure = True, None
        self._shown.meter.interrupt()
        self._shown.meters.went()

    # Events

    def _take_events(self) -> None:
        state = self.state
        for logged in self._log.pop(state.frames, ()):
            self._note(logged)
            # Pauses and steps only say when frames were made; a log says that itself.
            command = self._controls.apply(logged, replayed=True)
            if self._controls.refusal:
                said = f"'{logged.kind}' in frame {state.frames}: {self._controls.refusal}"
                state.refused = state.refused.with_one(said)
            if command == "quit":
                state.quit = True  # whatever is open here
            elif command in ("reset", "status", "show", "strain", "meters", "help"):
                self._obey(command)
        for given in self.view.poll():  # after which the window may have another size
            self._schedule.wake()
            if self._asks_for_trials(given):
                self._examine(tries=True)
                continue
            # An event may have opened or closed what the next one would be for.
            event = self._shown.take(given)
            if event is None:
                continue
            if state.replaying:
                if event.key in WINDOW_KEYS and event.kind == "press":
                    self._obey(COMMANDS[event.key])
                continue
            refused = self._reread() if event.kind == "press" and event.key == RESET_KEY else None
            if state.left:
                return
            self._take_event(event)
            if refused:
                self._controls.tell(refused)
        self._give_settings()
        self._open_scene()

    def _take_event(self, event: Event) -> None:
        """Apply and record what the user did to the world, and obey what follows."""
        event = self._window.on_first(event)
        if self._request.beside:
            self._controls.look_at(self._request.beside.sim if self._window.side else None)
        logged = self._window.taken(event)
        if self._looks:
            taken = self._looks.take(event, self._window.here, free=self._moves_look(logged))
            self.view.look = self._looks.look
            if taken:
                return
        logged = self._controls.aimed(logged)
        # What no log has a name for, nothing reacts to.
        if (logged.key is None or logged.key in KEYS - {"escape"}) and not self.state.quit:
            self._note(logged)
        command = self._controls.apply(logged)
        if self._travel:
            self._travel.settle()
        if command:
            self._obey(command)

    def _moves_look(self, event: Event) -> bool:
        """True if a press, in the log's window, moves what is seen of a plane."""
        return event.button in PANS and not self._controls.takes(event)

    def _give_settings(self) -> None:
        """Have what was changed in the panel take effect; say so before that compiles."""
        settings = self._shown.settings
        if settings is None or not settings.given:
            return
        if self.state.replaying:
            settings.forget()
            return
        if settings.compiles:
            self._say_that_it_compiles()
        settings.flush()
        self._shown.meter.interrupt()

    def _say_that_it_compiles(self) -> None:
        """Draw a window that stands still from now on, and says why."""
        self.state.compiling = True
        self._shown.hurry()
        self._show_now()
        self.state.compiling = False
        self._shown.meter.compiles()

    def _prepare_clicks(self) -> None:
        """Compile what the pointer's first motion needs, while the window says why it waits."""
        for sim in [self.sim, *([self._request.beside.sim] if self._request.beside else [])]:
            sim.prepare_clicks()

    def _note(self, event: LogEvent) -> None:
        if self._travel:
            self._travel.event(self.state.frames, event)
        elif self._request.recorder is not None:
            self._request.recorder.write(self.state.frames, event)

    def _obey(self, command: str) -> None:
        state = self.state
        if command == "quit":
            state.quit = not (self._shown.close_last() or self._controls.put_away())
        elif command == "pause" and state.failure is None:
            state.paused = not state.paused
            self._shown.meter.interrupt()
        elif command in ("pause", "step") and state.failure is not None:
            self._controls.tell(hud.STOPPED)
        elif command == "step" and self._travel and self._travel.away:
            self._go_to(state.frames + 1)
        elif command == "step":
            state.step = state.paused
        elif command == "back":
            self._go_to(state.frames - 1)
        elif command == "slow":
            state.pace.slower() if state.pace.slowness < SPEEDS[-1] else state.pace.full()
            self._shown.meter.interrupt()
        elif command == "reset":
            self._reset()
        elif command == "survive":
            self._survive()
        elif command == "picture":
            self._shutter.press()
        elif command == "film":
            self._shutter.begin_or_end()
        elif command == "checkpoint":
            now = self.sim.checkpoint()
            self._shutter.keep(".checkpoint.npz", lambda path: now.save(path, self._request.about))
        elif command == "export" and self._travel:
            self._export(self._travel.timeline)
        else:
            self._shown.obey(command)
        self._shown.hurry()

    def _export(self, timeline: Timeline) -> None:
        """Save the last seconds, of which frames may have to be run again; say so before that."""
        self.state.exporting = True
        self._shown.hurry()
        self._show_now()
        self.state.exporting = False
        self._shutter.keep(".seconds.npz", timeline.export)
        self._shown.meter.interrupt()

    def _reset(self) -> None:
        """Go back to the scene's start."""
        if self._travel:
            self._travel.go_on()
        trajectory = self._request.trajectory
        saved = trajectory.frames if trajectory is not None else 0
        self.sim.reset()
        self._controls.reset(hud.reset_notice(saved) if saved else None)
        self.state.failure = None
        self._shown.close_finding()
        self._shown.meter.restart()
        self._shown.meters.restart()

    def _open_scene(self) -> None:
        """Make the scene that was chosen ready: the run ends for it, or goes on where it cannot."""
        settings = self._shown.settings
        name = settings.take_scene() if settings else None
        if name is None:
            return
        said = self._leave_for(name, partial(self._request.scenes.open, name))
        if said:
            self._controls.tell(said)

    def _reread(self) -> str | None:
        """Go on with the scene as its file says by now, if that is another one.

        What to tell of it where it cannot be read.
        """
        scenes = self._request.scenes
        if scenes.fixed:
            return None
        try:
            ready = scenes.edited()
        except InputError as error:
            return f"not read anew: {error}"
        return self._leave_for(scenes.file, ready) if ready else None

    def _leave_for(self, name: str, ready: Callable[[], None]) -> str | None:
        """Make another scene ready, and leave the run for it; what to tell where it cannot be."""
        scenes = self._request.scenes
        self.state.opening = name
        self._show_now()
        self.state.opening = ""
        try:
            ready()
        except (InputError, RunFailure) as error:
            self._shown.meter.interrupt()
            return f"{name} was not opened: {error}"
        scenes.opened, scenes.paused = self._shown.chrome.opened, self.state.paused
        scenes.tool = self._controls.chosen
        self.state.left, self.state.failure = True, None
        return None

    # Pictures, and the end

    def finish(self, image: films.Image | None) -> None:
        """Save the film, and the last frame as a picture."""
        with ExitStack() as files:  # each is tried, also where a disk is full
            self._takes.save(files)
            if image is not None:
                files.callback(lambda: image.save(self._last_picture(pointed=False)))
            if self._takes.missing:
                self._take(self._last_picture())

    def pixels(self) -> np.ndarray:
        """The present frame, (h, w, 3) uint8, drawn anew."""
        self.view.draw(self._shown.picture(now=True))
        return self.view.grab()

    def _last_picture(self, *, pointed: bool = True) -> np.ndarray:
        """The last frame, (h, w, 3) uint8; drawn off-screen where the user closed the window.

        pointed: with the pointer, as films have it.
        """
        if not self.view.closed:
            # Anew: since the last frame the user may have done things.
            with suppress(RunFailure):  # the window goes at this very moment
                self.view.draw(self._shown.picture(now=True, pointed=pointed))
        if self.view.closed:
            with closing(offscreen(self.view, self.sim.scene.world)) as view:
                view.draw(self._shown.picture(now=True, pointed=pointed))
                return view.grab()
        return self.view.grab()

    def summary(self) -> Summary:
        """A summary of the run so far."""
        seconds = time.perf_counter() - self._started if self._started is not None else 0.0
        parts = self._simulate, self._draw, self._schedule.waited_in_all
        return Summary(self.state.frames, seconds, *parts, self.state.quit, self.state.refused)
