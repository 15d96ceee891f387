"""A window of a run: where it began, what was done in it, and what was shown, frame by frame."""

from __future__ import annotations

import pickle
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_cloth.runtime import current_device
from taichi_cloth.scene.model import Scene
from taichi_cloth.simulation.acts import noted
from taichi_cloth.simulation.start import Start
from taichi_cloth.trade.seconds import SECOND

if TYPE_CHECKING:
    from taichi_cloth.simulation.simulation import Simulation

FRAMES = SECOND
LEAST = FRAMES // 4  # frames of which an error says something
WAITING = 60.0  # seconds that its references may take where the run waits for them
FEW = 5000  # particles of which each frame is kept; of more each `STRIDE`th, which costs less
STRIDE = 5
# What ends a window, as what follows is another run: its clock, its settings, or who is who in it.
ENDS = frozenset(
    ("reset", "restore", "load_scene", "load_as", "remove", "set_step", "set_solver", "set_method")
)
# Those after which nothing is left of the run that was shown; one that is restored may come the
# same way again.
LEAVES = frozenset(("reset", "load_scene", "load_as"))

# In the folder that meter and judge share: a window, its ghost, what the judge is doing; and the
# scene that is surveyed.
WINDOW, GHOST, STAGE, SCENE = "window.pickle", "ghost.npz", "stage.txt", "scene.pickle"


@dataclass
class Window:
    """A window: all that it takes to make some frames again, and to judge them.

    start: where they began. first: how many frames the run had made then. method, dt, solver,
    precision: of all of them; substeps: of each. acts: what was done before each, by its number
    from 0: names and arguments of methods of the simulation. shown: positions of the particles that
    there were at the start, (n, dim), there and at the end of each frame, or each `stride`th.
    """

    start: Start
    first: int
    method: str
    dt: float
    solver: dict[str, float]
    precision: str
    stride: int = 1
    substeps: list[int] = field(default_factory=list)
    acts: dict[int, list[bytes]] = field(default_factory=dict)
    shown: list[np.ndarray] = field(default_factory=list)

    @classmethod
    def opened(cls, sim: Simulation) -> Window:
        """A window that begins at the present frame of a simulation."""
        precision = current_device().precision
        stride = 1 if sim.particle_count <= FEW else STRIDE
        settings = sim.method, sim.dt, dict(sim.solver), precision
        window = cls(sim.start(), sim.frame, *settings, stride)
        window.shown.append(window.start.snapshot.x.astype(window.real))
        return window

    @property
    def real(self) -> type:
        """The numbers that hold what is shown without loss."""
        return np.float32 if self.precision == "f32" else np.float64

    @property
    def frames(self) -> int:
        """The number of frames made in it."""
        return len(self.substeps)

    @property
    def end(self) -> int:
        """The frame that it ends at."""
        return self.first + self.frames

    def note_act(self, name: str, args: tuple[Any, ...], given: Mapping[str, Any]) -> None:
        """Take note of an act that was done: as bytes, since arguments may be written to later."""
        act = noted(name, args, given)
        if act is not None:
            self.acts.setdefault(self.frames, []).append(act)

    def note_frame(self, sim: Simulation) -> None:
        """Take note of a frame that was made."""
        self.substeps.append(sim.substeps)
        if self.frames % self.stride:
            return
        count = len(self.shown[0])
        drawn = sim.drawn_positions() if self.precision == "f32" else sim.positions()
        self.shown.append(drawn[:count].astype(self.real))

    def write(self, path: Path, known: Scene | None) -> None:
        """Put it into a file; known: a scene that the reader has already, which is left out there.

        It is no file to keep: the reader is a process of the same program.
        """
        snapshot = self.start.snapshot
        scene = None if snapshot.scene is known else snapshot.scene
        start = {**vars(self.start), "snapshot": {**vars(snapshot), "scene": scene}}
        parts = {**vars(self), "start": start, "shown": np.stack(self.shown)}
        with path.open("wb") as file:
            pickle.dump(parts, file, pickle.HIGHEST_PROTOCOL)
