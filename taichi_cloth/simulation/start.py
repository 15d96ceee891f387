"""A start: the state of a run, from which one of any method, step and precision begins."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from taichi_cloth.errors import InputError
from taichi_cloth.limits.precision import refuse_unholdable
from taichi_cloth.runtime import current_device
from taichi_cloth.settings import accepted
from taichi_cloth.simulation.checkpoint import Checkpoints
from taichi_cloth.simulation.numbers import checked_step, runaway_speed
from taichi_cloth.simulation.part import Part
from taichi_cloth.simulation.snapshot import Snapshot
from taichi_cloth.simulation.storage.kept import with_own_hold


@dataclass(frozen=True)
class Start:
    """A state between two frames, in float64, without what the method keeps from step to step.

    snapshot: scene, positions, velocities and marks of springs. time, steps: of the clock. force:
    what pushes each particle until the next push, (n, dim); None: nothing does.
    """

    snapshot: Snapshot
    time: float
    steps: int
    force: np.ndarray | None


class Starts(Part):
    """The part of a `Simulation` that says where it stands, and begins where another one stood.

    Unlike a checkpoint it goes on with other bits: methods compute what they keep anew, and other
    settings are what it is for.
    """

    def start(self) -> Start:
        """The state as it stands now."""
        snapshot = with_own_hold(self.storage.snapshot())
        return Start(snapshot, self.time, self.steps, self.storage.held())

    def begin_from(self, start: Start, dt: float, substeps: int) -> None:
        """Go on from there with a step of one's own; `reset` then goes to the start of its scene.

        InputError where the device's precision cannot hold its numbers.
        """
        given: Any = start
        if not isinstance(given, Start):
            says = f"begin_from: takes what `start` returned, not {accepted.shown(given)}"
            raise InputError(says)
        scene = start.snapshot.scene
        step = checked_step(dt, substeps)
        refuse_unholdable(scene, current_device().precision)
        self.scene = self._given = scene
        self._engines.clear()
        self.dt, self.substeps = step
        self._note_settings()
        self._stand_at(start, 0)

    def go_on_from(self, other: Starts) -> None:
        """Go on from where another run of the same scene stands, with this one's step and method.

        `reset` then goes to where this one began, with what tools have switched on in the other's
        world for good. InputError for a run of a scene of another name or dimension, and where dt
        "auto" finds no step.
        """
        if not isinstance(other, Starts):
            raise InputError(f"go_on_from: takes a Simulation, not {accepted.shown(other)}")
        there, here = ((of.scene.name, of.scene.world.dim) for of in (other, self))
        if there != here:
            (name, dim), (own, mine) = there, here
            raise InputError(
                f"go_on_from: that run is of '{name}' in {dim}-D, this one of '{own}' in {mine}-D; "
                "give it one of the same scene"
            )
        start, world = other.start(), other.scene.world
        if self._auto:
            self.substeps = self._auto.at_start(start.snapshot)
        prepared = {name: getattr(world, name) for name in Checkpoints.PREPARED}
        self.scene = self.scene.with_world(**prepared)
        self._stand_at(start, other.frame)

    def _note_settings(self) -> None:
        """Note what the run begins with, for who changes it and wants it back."""
        step = {"dt": self.dt, "substeps": self.substeps}
        self.began = {"method": self.method, **step, **self.solver}

    def _stand_at(self, start: Start, frame: int) -> None:
        self.frame, self._since = frame, (frame, start.time, start.steps)
        self._work[:], self._counted, self._first = 0, (0, start.steps), start.steps
        self.speed_limit = runaway_speed(start.snapshot.scene, self.dt)
        self._store(with_own_hold(start.snapshot))  # it may begin from there once more
        self._unsettled[:] = 0
        if self.past is not None:
            self.past.forget()
        if start.force is not None:
            self.storage.hold(start.force)
