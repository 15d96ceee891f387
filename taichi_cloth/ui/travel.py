"""Back and on in a run's last seconds, with all that has to follow: controls, log, recordings."""

from __future__ import annotations

from typing import TYPE_CHECKING

from taichi_cloth.ui.inputs import Event
from taichi_cloth.ui.timeline import Timeline

if TYPE_CHECKING:
    from taichi_cloth.files.events import Recorder
    from taichi_cloth.files.recordings import Recordings
    from taichi_cloth.files.trajectory import Trajectory
    from taichi_cloth.render.camera import Camera
    from taichi_cloth.simulation.simulation import Simulation
    from taichi_cloth.ui.controls import Controls
    from taichi_cloth.ui.interaction import LogEvent

# Seconds of a run between its checkpoints, about: each fourth frame of a window at full speed has
# one, each of a scene that is slow; a frame without one is run again in no more than this.
CHECKPOINT_SPACING = 1 / 16


class Travel:
    """Goes to frames of a `Timeline`, and lets the run go on from there.

    While one looks around in the past nothing is dropped. What comes after the frame that was gone
    to is dropped, from log and recordings too, when the run goes on from it, or something is done
    to the simulation there: a log never goes back in time, it is that of the run one kept.

    sim, controls: what goes back, but for the tool in hand and the keys that are down.
    camera: of a 3-D scene; it stays where the user has it.
    recorder, trajectory: what forgets. reruns: whether events alone make the frames, so that a
    frame without a checkpoint can be run again. beside: another run, which goes along.
    """

    def __init__(
        self,
        sim: Simulation,
        controls: Controls,
        camera: Camera | None,
        recorder: Recorder | None,
        trajectory: Trajectory | Recordings | None,
        reruns: bool = True,
        beside: Simulation | None = None,
    ) -> None:
        self._sim, self._controls, self._camera = sim, controls, camera
        self._recorder, self._trajectory = recorder, trajectory
        self.timeline = Timeline(
            sim,
            controls,
            self._rerun if reruns else None,
            spacing=CHECKPOINT_SPACING,
            beside=beside,
        )
        self._looked: list[LogEvent] = []  # events in the past that may not have to be kept
        self._quiet = False
        self._noted: int | None = None  # at which frame the run began that was noted last

    @property
    def away(self) -> bool:
        """True if the run is at a frame that was gone back to."""
        return self.timeline.at is not None

    def event(self, frame: int, event: LogEvent) -> None:
        """Log an event that comes before `frame` is advanced; in the past, if anything is done."""
        if self._quiet:
            return
        if self.away and event.kind == "set":  # what it changes need not be seen in the state
            self.go_on()
        if self.away:
            self._looked.append(event)
            return
        self.timeline.event(frame, event)
        if self._recorder is not None:
            self._recorder.write(frame, event)

    def note(self, frame: int) -> None:
        """Take note of the present frame, after it was advanced."""
        self.timeline.note(frame)
        self._noted = frame - self._sim.frame

    def go(self, frame: int) -> int:
        """Go to a frame, or to the nearest that there is; return which."""
        timeline, pose = self.timeline, self._camera.pose if self._camera else None
        tool, held, pressed = self._controls.tool, self._controls.held, self._controls.pressed
        if timeline.touched:
            self.go_on()
        before = timeline.frame
        frame = timeline.go(frame)
        if frame == before:
            return frame
        self._looked = []
        if self._camera and pose is not None and pose != self._camera.pose:
            self._keep(frame, Event("view", pose=pose))
        button, place = self._controls.pressed, self._controls.pointer
        let_go = bool(button) and not pressed
        if let_go:
            at = (0.0, 0.0) if place is None else (float(place[0]), float(place[1]))
            self._keep(frame, Event("release", pos=at, button=button))
        if let_go or tool is not self._controls.tool:
            told = self._controls.told
            self._keep(frame, Event("tool", name=tool.name if tool else ""))
            if tool is self._controls.tool:  # else it is told why it cannot be in hand
                self._controls.tell_as_before(told)
            timeline.untouch()  # what the tool of then held is let go
        for key in sorted(held ^ self._controls.held):
            self._keep(frame, Event("press" if key in held else "release", key=key))
        return frame

    def _keep(self, frame: int, event: Event) -> None:
        """Have what is the user's stay as it is at the frame that was gone to, and in the log."""
        self.event(frame, event)
        self._controls.apply(event, replayed=True)

    def go_on(self) -> None:
        """Let the run go on from the frame that was gone back to: what came after is dropped."""
        frame = self.timeline.branch()
        if frame is None:
            return
        looked, self._looked = self._looked, []
        if self._recorder is not None:
            self._recorder.rewind(frame)
        if self._trajectory is not None:
            # Before a reset it is another run, whose frames were forgotten since.
            same = frame - self._sim.frame == self._noted
            self._trajectory.rewind(self._sim.frame if same else -1)
        for event in looked:
            self.event(frame, event)

    def settle(self) -> None:
        """After an event: where it did something to the past, let the run go on from there."""
        if self.timeline.touched:
            self.go_on()

    def _rerun(self, frame: int, events: list[LogEvent]) -> None:
        """Do the events of a frame again, and advance it."""
        self._quiet, told = True, self._controls.told
        try:
            for event in events:
                if self._controls.apply(event, replayed=True) == "reset":
                    self._sim.reset()
                    self._controls.reset()
            self._controls.before_frame(replayed=True)
            self._sim.advance(1)
        finally:
            self._quiet = False
            self._controls.tell_as_before(told)  # not what was told then
