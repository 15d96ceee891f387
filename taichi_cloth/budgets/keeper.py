"""Keeps a simulation to a goal: what it measures, the limits of its steps, and what it chooses."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.budgets.choice import RUNGS, Choice, Limits
from taichi_cloth.budgets.drawing import Drawing
from taichi_cloth.budgets.frames import Frame, FrameTimes
from taichi_cloth.budgets.goal import Goal
from taichi_cloth.budgets.seconds import MARGIN, Second, SecondErrors
from taichi_cloth.budgets.solver import SolverErrors
from taichi_cloth.errors import InputError
from taichi_cloth.kernels import methods
from taichi_cloth.kernels.forces import act_on_triangles as acts_by_speed
from taichi_cloth.limits.auto_step import SubstepController
from taichi_cloth.limits.precision import most_substeps
from taichi_cloth.runtime import current_device
from taichi_cloth.simulation.diagnostics import acceleration_at_start

if TYPE_CHECKING:
    from taichi_cloth.error_meter.verdict import Verdict
    from taichi_cloth.simulation.simulation import Simulation

LOOK = 15  # frames between looks at what is broken
OFTEN = 10  # frames between choices by time
MOVED = 60  # frames after which a limit that depends on speeds is found anew
ANEW = 2.0  # times: by how much what is measured differs from what is known, to be taken for it
UNMEASURED = 64  # times as many as the fewest at most, until a second is: they may be of no use
LONGEST = 0.1  # seconds of a frame: no error is worth slower ones


class Keeper:
    """Chooses a simulation's substeps, and how far its solver goes, for a goal, before each frame.

    It is told what frames took, and which seconds were measured; what it chooses follows from that.
    layered: whether pictures can be drawn more plainly, which is the last that it chooses for a
    frame's time; drawing: whether they are.
    """

    def __init__(self, sim: Simulation, goal: Goal, *, layered: bool = False) -> None:
        self.goal, self._sim = goal, sim
        self._stable = StableSteps(sim)
        self._verdicts = 0  # that were looked at
        self._broken: list[tuple[int, int]] = []  # (frame, springs broken), at some of the last
        self.choice: Choice | None = None
        self._layered, self.drawing = layered, Drawing()
        self._begin()

    def _begin(self) -> None:
        """Begin to measure: at the start, and where method or frame time are others."""
        self._of, self._due = self._run(), True
        self._times = FrameTimes(self.goal.seconds or LONGEST)
        self._errors = SecondErrors(self.goal.error or 1.0, self._sim.claims.order)
        self._useful: int | None = None  # the most substeps that are, once that is measured
        # A method takes one setting of its solver, or none.
        self._solvers = [
            SolverErrors(name, current_device().precision) for name in self._sim.claims.settings
        ]
        self._solved_so = self._sim.frame  # since which frame

    def _run(self) -> tuple[str, float]:
        """What the measured is of: with others it says nothing."""
        return self._sim.method, self._sim.dt

    def frame(self, simulate: float, rest: float) -> None:
        """A frame was made: seconds to simulate it, and for all else but waiting."""
        self._times.note(Frame(self._sim.substeps, simulate, rest))

    def choose(self, verdicts: Sequence[Verdict]) -> Choice:
        """The substeps of the next frame; verdicts: all of the error meter's, if there is one."""
        if self._run() != self._of:
            self._begin()
        self._solved_so = min(self._solved_so, self._sim.frame)  # a run that goes back counts anew
        self._look()
        for verdict in verdicts[self._verdicts :]:
            self._note(verdict)
        self._verdicts = len(verdicts)
        now = self._sim.substeps
        known = self.choice is not None and self.choice.substeps == now
        changed = self._stable.changed()
        by_time = self.goal.seconds is not None
        due = self._due or changed or (by_time and self._sim.frame % OFTEN == 0)
        if self.choice is not None and known and not due:
            return self.choice
        self._due = False
        limits = self._limits()
        if by_time and self._layered:
            self.drawing.look(self._times, now, limits.least)
        choice = (self._times if by_time else self._errors).choose(now, limits)
        for solver in self._solvers:
            choice = self._solved(solver, choice, now, limits)
        if self.drawing.plain:
            choice = replace(choice, why=f"{choice.why}; drawn plain, for the time")
        self.choice = choice
        return choice

    def _solved(self, solver: SolverErrors, choice: Choice, now: int, limits: Limits) -> Choice:
        """A choice with how far the solver goes: the larger part of the error comes first."""
        name, was = solver.name, self._sim.solver[solver.name]
        chosen = solver.choose(was)
        if self.goal.seconds is not None:
            if now == choice.substeps == limits.least and self._times.too_slow(now):
                chosen = solver.looser(was)  # all that could make frames shorter
            elif (work := solver.work(was, chosen)) > 1:  # the same time for fewer substeps
                fewer = [n for n in limits.rungs() if n * work <= choice.substeps]
                chosen = chosen if fewer else was
                choice = replace(choice, substeps=fewer[-1]) if fewer else choice
        if chosen != was:
            solver.changed(was, chosen)
            self._errors.solve_otherwise()
            self._times = FrameTimes(self.goal.seconds or LONGEST)
            self._solved_so = self._sim.frame
            if self.goal.seconds is not None:  # what was said is of the other setting
                choice = self._times.said(choice.substeps, limits)
        return replace(choice, solver={**choice.solver, name: chosen})

    @property
    def has_room(self) -> bool:
        """Whether more substeps than the fewest were chosen."""
        return self.choice is not None and self.choice.substeps > self._stable.least()

    def _look(self) -> None:
        """See whether springs broke."""
        frame = self._sim.frame
        if frame % LOOK == 0:
            broken = self._sim.storage.count_broken()
            # What was seen in later frames is of a run that went back.
            before = [seen for seen in self._broken[-200:] if seen[0] < frame]
            if before and broken > before[-1][1]:
                self._errors.tear()
                self._due = True
            self._broken = [*before, (frame, broken)]

    def _note(self, verdict: Verdict) -> None:
        """Take a verdict for what it says of the present method."""
        if verdict.resting or verdict.method != self._sim.method:
            return
        first, end = verdict.first, verdict.first + verdict.frames
        within = [count for frame, count in self._broken if first - LOOK <= frame <= end + LOOK]
        scale = verdict.scale if verdict.known else 1.0
        error = verdict.relative if verdict.known else 0.0
        left = (verdict.solver or 0.0) / scale
        if first < self._solved_so:  # what another setting left is none of the steps'
            error, left = max(error - left, 0.0), 0.0
        whole = MARGIN * self.goal.error if self.goal.error else error
        sure = verdict.known and not verdict.trouble and verdict.solver is not None
        for solver in self._solvers:
            if sure and first >= self._solved_so and whole > 0:
                solver.note(left / whole)
        self._errors.note(
            Second(
                verdict.own_substeps,
                error,
                (verdict.rounding or 0.0) / scale,
                verdict.order,
                verdict.trouble or ("" if verdict.known else "nothing was measured"),
                left,
            ),
            torn=bool(within) and max(within) > min(within),
        )
        self._due = True

    def _best(self) -> int | None:
        """The most substeps that are of use, as measured; it stays where it differs by little."""
        found, known = self._errors.best(), self._useful
        if found is not None and not (known and known / ANEW <= found <= known * ANEW):
            self._useful = Limits(most=max(1, int(found))).rungs()[-1]
        return self._useful

    def _limits(self) -> Limits:
        least, most, why = self._stable.least(), RUNGS[-1], "there are no more"
        resolved = self._stable.resolved()
        if resolved is None:
            return Limits(least, least, "there is no particle yet")
        if resolved < most:
            most, why = resolved, f"{current_device().precision} does not follow smaller steps"
        if self.goal.seconds is not None:
            best = self._best()
            if best is not None and best < most:
                most, why = best, "with more, rounding would outweigh the error of the steps"
            elif not self._errors.sure and current_device().precision != "f64":
                first = UNMEASURED * least
                most, why = min((most, why), (first, "no second has been measured yet"))
        else:
            fits = self._times.most_within()
            if fits is not None and fits < most:
                most, why = fits, f"frames would take more than {1e3 * LONGEST:g} ms to simulate"
        return Limits(least, max(most, least), why)


class StableSteps:
    """Between which substeps a simulation's steps are stable, and followed by its precision."""

    def __init__(self, sim: Simulation) -> None:
        self._sim = sim
        self._of: tuple[tuple[object, ...], tuple[object, ...]] | None = None
        self._mass, self._fixed = np.zeros(0), np.zeros(0, bool)
        self._least, self._frame = 1, 0
        self._resolved: tuple[tuple[int, float], int] | None = None  # of what, and that

    def _now(self) -> tuple[tuple[object, ...], tuple[object, ...]]:
        """What the limit depends on, beside masses and what is fixed: values, and tables, which are
        others where they are changed. What breaks widens it.
        """
        sim, scene = self._sim, self._sim.storage.scene
        return (sim.method, sim.dt, str(scene.world.more)), (scene.springs, scene.stencils)

    def changed(self) -> bool:
        """Whether the limit may be tighter than it was.

        What is held weighs as much more as its step needs, and is as it was when it is let go.
        """
        sim, (values, tables) = self._sim, self._now()
        if self._of is None or values != self._of[0]:
            return True
        if not all(map(operator.is_, tables, self._of[1])):
            return True
        if acts_by_speed(sim.storage.scene) and sim.frame >= self._frame + MOVED:
            return True
        particles = sim.storage.scene.particles
        same = particles.mass is self._mass and particles.fixed is self._fixed
        if same or sim.held() is not None:
            return False
        lighter = len(particles) != len(self._mass) or (particles.mass < self._mass).any()
        return bool(lighter or (self._fixed & ~particles.fixed).any())

    def least(self) -> int:
        """The fewest substeps that are stable, as `--dt auto` finds them."""
        if self.changed():
            sim, scene = self._sim, self._sim.storage.scene
            self._of, self._frame = self._now(), sim.frame
            self._mass, self._fixed = scene.particles.mass, scene.particles.fixed
            controller = SubstepController(sim.method, methods.load(sim.method), sim.dt)
            moving = acts_by_speed(scene)
            try:
                choose = controller.choose_in_motion if moving else controller.choose
                self._least = choose(sim.network())
            except InputError:  # no step is stable: what there is is kept
                self._least = sim.substeps
        return self._least

    def resolved(self) -> int | None:
        """The most substeps whose motion the precision follows; None: there is no particle."""
        scene, dt = self._sim.storage.scene, self._sim.dt
        of = len(scene.particles), dt
        if not of[0]:
            return None
        if self._resolved is None or self._resolved[0] != of:
            precision = current_device().precision
            self._resolved = of, most_substeps(scene, acceleration_at_start(scene), dt, precision)
        return self._resolved[1]
