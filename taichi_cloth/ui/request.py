"""The request for a run in a view, beside its simulation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from taichi_cloth.files.events import Recorder
from taichi_cloth.files.recordings import Recordings
from taichi_cloth.files.trajectory import Trajectory
from taichi_cloth.ui.chrome.beside import Second
from taichi_cloth.ui.chrome.budget import Budget
from taichi_cloth.ui.chrome.errors import Errors
from taichi_cloth.ui.chrome.why import Examiner
from taichi_cloth.ui.interaction import Log
from taichi_cloth.ui.scenes import OWNED, Scenes

if TYPE_CHECKING:
    from taichi_cloth.simulation.simulation import Simulation


@dataclass(frozen=True)
class Request:
    """A request for a run.

    frames: after how many it ends; None: only where the user or `on_frame` ends it.
    replay: a log; its events of frame f (0-based, counted over resets) are applied
        before that frame is advanced. Until its last event the user's mouse is ignored.
    recorder: made with `app.log_header`; every applied event is written.
    trajectory: is shown every frame; recordings: it and an export. Saving them is the caller's.
    on_frame: called before each frame; the run ends where it returns False.
    film, image: paths of a film of the run and of a picture of its last frame; the view must
        draw pictures for them. Refused paths raise InputError before anything is run.
    pictures: the folder of what the keys s, v, w and x save; None: the current one.
    about: what the key w notes in a checkpoint beside the state, as `Checkpoint.save` takes it.
    paused: start paused (a window only). quiet: no progress bar, and no word of pictures.
    status: whether the status is shown from the start (`h` shows more of it, or none).
    meters: whether they are shown from the start (`m` shows and hides them).
    show: what is drawn of cloths from the start, words of `settings.options.SHOWN` (`d` goes on to
        the next choice); None: what suits the scene.
    seed: of the tools' random numbers; a log's header overrides it.
    device: from `Device.describe()`, for the status; None: of the device that was started.
    errors: what measures the error of what is seen (`a`), shown by the meters; None: nothing.
    budget: what keeps the run to a frame's time or an error, as it is chosen; None: nothing.
    examiner: what finds out why a window's run failed (`k`, `u`); None: nothing does.
    beside: a second run of the scene, which goes along and is shown beside it; None: there is none.
    scenes: what a window may go on with: the run ends once the user opened one of them.
    """

    frames: int | None = None
    replay: Log | None = None
    recorder: Recorder | None = None
    trajectory: Trajectory | Recordings | None = None
    on_frame: Callable[[Simulation], object] | None = None
    film: str | None = None
    image: str | None = None
    pictures: str | None = None
    about: Mapping[str, Any] | None = None
    paused: bool = False
    quiet: bool = False
    status: bool = True
    meters: bool = False
    show: frozenset[str] | None = None
    seed: int = 0
    device: str | None = None
    errors: Errors | None = None
    budget: Budget | None = None
    beside: Second | None = None
    examiner: Examiner | None = None
    scenes: Scenes = field(default_factory=lambda: Scenes(fixed=OWNED))

    @property
    def tools_seed(self) -> int:
        """The seed of the tools' random numbers: that of the log, where one is replayed."""
        return int(self.replay.header.get("seed", self.seed)) if self.replay else self.seed
