"""A simulation at one moment, whole: a run that goes on from it has the bits it would have had."""

from __future__ import annotations

import copy
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from taichi_cloth.errors import InputError, counted
from taichi_cloth.files import archives
from taichi_cloth.runtime import current_device
from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.rules import NOTED, refuse_changed
from taichi_cloth.settings import accepted
from taichi_cloth.simulation import saved
from taichi_cloth.simulation.acts import act
from taichi_cloth.simulation.auto_substeps import AutoSubsteps
from taichi_cloth.simulation.engine import Engine
from taichi_cloth.simulation.part import Part
from taichi_cloth.simulation.storage.kept import Kept


@dataclass(frozen=True, eq=False, repr=False)
class Checkpoint:
    """All that later frames of a run depend on, on the host; `Simulation.restore` takes it.

    frame: frames done. time: the scene's time then. name: of the scene. method, precision: of the
    run. settings: the host's own, by name: those of `Checkpoints.SETTINGS`. auto: what dt "auto"
    remembers; None: the step was set. kept: the state on the device.
    scene: as it was given; None, of a checkpoint from a file: digest is that of all its numbers.
    prepared: what tools had switched on in its world by then (`Checkpoints.PREPARED`).
    noted: under which model it was made, and by which version (`scene.rules`).
    engine: what ran it then, for the simulation that it is of: that may have another method since.

    The arrays are nobody's to change: checkpoints share those that are equal. So it is its own
    copy, and equal to itself alone. Pickled it is as one from a file: for a run of its own method.
    """

    frame: int
    time: float
    name: str
    method: str
    precision: str
    settings: Mapping[str, Any]
    auto: Mapping[str, Any] | None
    kept: Kept
    scene: Scene | None = None
    digest: str = ""
    prepared: Mapping[str, Any] = field(default_factory=dict)
    noted: Mapping[str, Any] = field(default_factory=lambda: NOTED)
    engine: Mapping[str, Any] | None = None

    def __repr__(self) -> str:
        """Its line at a prompt or in a notebook's cell: not the state."""
        run = f"{self.method} in {self.precision}"
        return f"<Checkpoint: {self.name!r} after {counted(self.frame, 'frame')} of {run}>"

    def __copy__(self) -> Checkpoint:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> Checkpoint:
        return self

    def __getstate__(self) -> dict[str, Any]:
        return vars(self) | {"engine": None}

    def save(self, path: str | Path, about: Mapping[str, Any] | None = None) -> None:
        """Write it to a file ``.npz``, which appears whole or not at all.

        about: what else to note, such as the command's words. InputError where it cannot be
        written, in JSON.
        """
        noted = json.loads(archives.noted("Checkpoint.save: about", about))
        saved.write(accepted.path("Checkpoint.save: path", path), vars(self), noted)

    @classmethod
    def load(cls, path: str | Path) -> Checkpoint:
        """The checkpoint saved at `path`. InputError where there is none that can be read."""
        return cls(**saved.read(accepted.path("Checkpoint.load: path", path)).parts)

    def is_of(self, sim: object) -> bool:
        """True if this very simulation made it, which may have another method since."""
        return self.engine is not None and self.engine["_owner"] is sim

    def arrays(self) -> list[np.ndarray]:
        """The arrays of its state on the device, some of which others share."""
        return list(self.kept.fields.values())


class Checkpoints(Part):
    """The part of a `Simulation` that notes where it is, and goes back there."""

    # What the host keeps of a run beside the state on the device; the solver's settings,
    # the work done and what is counted are copied.
    SETTINGS = (
        *("frame", "dt", "substeps", "speed_limit", "solver"),
        *("_since", "_work", "_counted", "_first", "_unsettled", "_preferred"),
    )
    # What mouse tools switch on in the scene's world, for good.
    PREPARED = ("tools", "collisions", "contact")

    def checkpoint(self) -> Checkpoint:
        """All that the frames to come depend on, as it is now.

        It takes a fraction of a millisecond, and changes nothing. What is pushed or held goes with
        it; what a window or its tools remember does not.
        """
        made = Checkpoint(
            frame=self.frame,
            time=self.time,
            name=self.scene.name,
            scene=self._given,
            prepared={name: getattr(self.scene.world, name) for name in self.PREPARED},
            method=self.method,
            precision=current_device().precision,
            settings={name: copy.copy(getattr(self, name)) for name in self.SETTINGS},
            auto=self._auto.memory() if self._auto else None,
            kept=self.storage.keep(),
            engine={"_owner": self} | {name: getattr(self, name) for name in Engine.ENGINE},
        )
        if self.past is not None:
            self.past.offer(self, made)
        return made

    @act
    def restore(self, checkpoint: Checkpoint) -> None:
        """Go back, or on, to a checkpoint: what follows has the same bits as it had from there.

        Springs that broke since are whole, and what was spawned, set, cut or tied since is gone;
        what was set before is set again. The way that loops run stays.
        InputError where it is of another scene, method or precision, or stored in another topology;
        all is then as it was.
        """
        self._refuse_others(checkpoint)
        kept = checkpoint.kept
        if kept.loaded is None:
            taken = replace(kept.taken, scene=saved.joined(self.scene, kept.taken.scene))
            kept = replace(kept, taken=taken)
        self._take_unsettled()  # the fields that are left may serve again
        names = ("scene", "_auto", *self.SETTINGS, *Engine.ENGINE)
        before = {name: getattr(self, name) for name in names}
        engine = checkpoint.engine if checkpoint.is_of(self) else None
        if engine and engine["_storage"] is not self._storage:
            for name in Engine.ENGINE:
                setattr(self, name, engine[name])
        for name in self.SETTINGS:
            setattr(self, name, copy.copy(checkpoint.settings[name]))
        self.scene = self._given.with_world(**checkpoint.prepared)
        self._auto = None
        if checkpoint.auto is not None:
            self._auto = AutoSubsteps(self.method, self._module, self.dt)
            self._auto.recall(checkpoint.auto)
        try:
            self.storage.put_back(kept, self.execution, self._numbers())
        except InputError:
            for name, value in before.items():
                setattr(self, name, value)
            raise
        self.topology = self.storage.topology

    def _refuse_others(self, checkpoint: Any) -> None:
        if not isinstance(checkpoint, Checkpoint):
            what = accepted.shown(checkpoint)
            raise InputError(f"restore: takes a Checkpoint, not {what}")
        method = checkpoint.method if checkpoint.is_of(self) else self.method
        pairs = (
            ("method", checkpoint.method, method),
            ("precision", checkpoint.precision, current_device().precision),
            ("scene", checkpoint.name, self.scene.name),
        )
        for what, there, here in pairs:
            if there != here:
                raise InputError(f"restore: the checkpoint has {what} {there}, the run has {here}")
        if checkpoint.scene is self._given:
            return
        refuse_changed(self._given, {"dt": None, **checkpoint.noted}, "restore: the checkpoint")
        there = checkpoint.digest or saved.digest(checkpoint.scene or self._given)
        if there != saved.digest(self._given):
            raise InputError(
                f"restore: the checkpoint is of another '{self.scene.name}': with other parameters;"
                " give this run those that it was made with"
            )
