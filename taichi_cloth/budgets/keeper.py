"""Keeps a simulation to a goal: what it measures, the limits of its steps, and what it chooses."""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.budgets.choice import RUNGS, Choice, Limits
from taichi_cloth.budgets.frames import Frame, FrameTimes
from taichi_cloth.budgets.goal import Goal
from taichi_cloth.budgets.methods import Found, Rival, Rivals, explicit
from taichi_cloth.budgets.seconds import MARGIN, RECENT, Second, SecondErrors
from taichi_cloth.budgets.solver import SolverErrors
from taichi_cloth.console import percent
from taichi_cloth.errors import InputError
from taichi_cloth.kernels import methods
from taichi_cloth.kernels.forces import act_on_triangles as acts_by_speed
from taichi_cloth.limits.auto_step import SubstepController
from taichi_cloth.limits.precision import most_substeps
from taichi_cloth.runtime import current_device
from taichi_cloth.simulation.diagnostics import acceleration_at_start
from taichi_cloth.simulation.prediction import predict

if TYPE_CHECKING:
    from taichi_cloth.error_meter.others import Trial
    from taichi_cloth.error_meter.verdict import Verdict
    from taichi_cloth.simulation.simulation import Simulation

LOOK = 15  # frames between looks at what is broken
OFTEN = 10  # frames between choices by time
MOVED = 60  # frames after which a limit that depends on speeds is found anew
ANEW = 2.0  # times: by how much what is measured differs from what is known, to be taken for it
UNMEASURED = 64  # times as many as the fewest at most, until a second is: they may be of no use
LONGEST = 0.1  # seconds of a frame: no error is worth slower ones
# Times as large as a small disturbance gets in a second of what swings far and folds undamped. It
# swings calmly at first, which says nothing of the seconds to come: so for the first RECENT ones.
FOLDS, FAR = 1e6, 0.2  # and what is far, in parts of the scene's extent


class Keeper:
    """Chooses a simulation's method, substeps, and how far its solver goes, before each frame.

    It is told what frames took, and which seconds were measured; what it chooses follows from that.
    kept: why the method stays as it is; "": it does not.
    """

    def __init__(self, sim: Simulation, goal: Goal, *, kept: str = "") -> None:
        self.goal, self._sim, self.kept = goal, sim, kept
        self._stable = StableSteps(sim)
        self._explicit = {name: StableSteps(sim, name) for name in explicit()}
        self._found: Found | None = None  # the method that was chosen last
        self._rivals, self._changes = Rivals(sim.method, goal.error), 0
        self._judged = False  # whether a second was measured since methods were compared
        self._of_methods = ""  # what there is to say of them
        self._known: dict[tuple[str, float], SecondErrors] = {}  # of what: the errors of seconds
        self._verdicts = 0  # that were looked at
        self._broken: list[tuple[int, int]] = []  # (frame, springs broken), at some of the last
        self.choice: Choice | None = None
        self._begin()

    def _begin(self) -> None:
        """Begin to measure: at the start, and where method or frame time are others."""
        self._of, self._due = self._run(), True
        self._times = FrameTimes(self.goal.seconds or LONGEST)
        fresh = SecondErrors(self.goal.error or 1.0, self._sim.claims.order)
        self._errors = self._known.setdefault(self._of, fresh)  # a run may go back, or a user
        found = self._found
        if found is not None and found.method == self._sim.method != self._rivals.present:
            self._changes += 1
            self._errors = self._known[self._of] = found.errors
        else:
            self._found, self._of_methods = None, ""
        self._rivals, self._judged = Rivals(self._sim.method, self.goal.error, self._changes), False
        self._useful: int | None = None  # the most substeps that are, once that is measured
        # A method takes one setting of its solver, or none.
        self._solvers = [
            SolverErrors(name, current_device().precision) for name in self._sim.claims.settings
        ]
        self._solved_so = self._sim.frame  # since which frame

    def _run(self) -> tuple[str, float]:
        """A key of the measured: with another one it says nothing."""
        return self._sim.method, self._sim.dt

    def frame(self, simulate: float, rest: float) -> None:
        """A frame was made: seconds to simulate it, and for all else but waiting."""
        self._times.note(Frame(self._sim.substeps, simulate, rest))

    def choose(self, verdicts: Sequence[Verdict]) -> Choice:
        """The substeps of the next frame; verdicts: all of the error meter's, if there is one."""
        if self._run() != self._of:
            self._begin()
        elif self._found is not None and self._found.method != self._sim.method:
            self._rivals.refuse(self._found.method)  # the run went on without it
            self._found, self._due = None, True
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
        choice = (self._times if by_time else self._errors).choose(now, limits)
        for solver in self._solvers:
            choice = self._solved(solver, choice, now, limits)
        choice = self._with_method(choice, now, limits)
        self.choice = choice
        return choice

    def trials(self) -> list[Trial]:
        """By which other methods the window that ends now is to be made again."""
        if self._run() != self._of:
            return []
        others = [] if self._why_kept() else self._others()
        now, missed = self._sim.substeps, self._errors.missed
        return self._rivals.trials(now, self._limits(), others, missed=missed)

    @property
    def chooses_method(self) -> bool:
        """True if another method may be chosen."""
        return not self._why_kept()

    def _why_kept(self) -> str:
        """Why the method is not chosen; "": it is."""
        if not self.kept and self._sim.method not in self._explicit:
            return "it is compared with no other one: only explicit methods are"
        return self.kept

    def _others(self) -> list[Rival]:
        """The other methods that have a stable step, and what that costs."""
        sim, found = self._sim, []
        here, fits = self._cost(sim.method), self._fits()
        for name, stable in self._explicit.items():
            least = stable.found() if name != sim.method else None
            if least is not None:
                cost = self._cost(name) / here
                most = min(stable.resolved() or RUNGS[-1], int(fits / cost))
                found.append(Rival(name, cost, least, most))
        return found

    def _cost(self, method: str) -> float:
        """Seconds that a step of a method takes here, as predicted: only ratios count."""
        sim, module = self._sim, methods.load(method)
        ways = sim.topology_of(method), sim.execution
        return predict(sim.storage.scene, module, current_device(), *ways).step

    def _with_method(self, choice: Choice, now: int, limits: Limits) -> Choice:
        """A choice with the method: another one, where that is clearly better."""
        kept = self._why_kept()
        if kept:
            self._of_methods = f"{self._sim.method} stays, as {kept}"
        elif self._judged:
            self._judged, others = False, self._others()
            better = self._rivals.better(self._errors, now, limits, others)
            if better is not None:
                self._found = better
                return self._changed(better, limits)
            self._of_methods = self._found.why if self._found else self._rivals.said(others)
        words = f"; {self._of_methods}" if self._of_methods else ""
        return replace(choice, why=f"{choice.why}{words}")

    def _changed(self, found: Found, limits: Limits) -> Choice:
        """The choice of another method; what frames take with it is not known yet."""
        self._of_methods = found.why
        if self.goal.seconds is not None:
            first = FrameTimes(self.goal.seconds).said(found.substeps, limits)
        else:
            there = next(rival for rival in self._others() if rival.name == found.method)
            first = found.errors.choose(found.substeps, there.limits)
        return replace(first, why=f"{first.why}; {found.why}", method=found.method)

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
        """True if more substeps than the fewest were chosen."""
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
        if verdict.method != self._sim.method:
            return
        if verdict.resting:
            self._errors.rest(verdict.own_substeps)
            self._due = True
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
        others = {name: [(n, e) for n, e in tries] for name, tries in verdict.others.items()}
        trouble = verdict.trouble or ("" if verdict.known else "nothing was measured")
        parted = (verdict.parted or 0.0) / scale
        if trouble and self.goal.error and parted > self.goal.error:
            part = percent(parted, 2)
            trouble += f"; chance decides: runs that differ by a millionth part by {part}"
        second = Second(
            verdict.own_substeps,
            error,
            (verdict.rounding or 0.0) / scale,
            others.get(verdict.method, ()),
            trouble,
            left,
            self._growth(verdict),
            verdict.acted,
        )
        torn = bool(within) and max(within) > min(within)
        self._errors.note(second, torn)
        self._rivals.note(second, others, torn)
        self._due = self._judged = True

    def _growth(self, verdict: Verdict) -> float:
        """The growth of a small disturbance in a second, or at most in the next."""
        seen = math.exp((verdict.growth or 0.0) * verdict.judged)
        scene = self._sim.scene
        extent = float(np.linalg.norm(np.ptp(scene.particles.position, axis=0)))
        drag, dashpots = scene.particles.viscous > 0, scene.springs.damping > 0
        damped = drag.any() or dashpots.any() or "air" in scene.world.more
        far = verdict.known and verdict.scale > FAR * extent
        early = self._verdicts < RECENT
        return max(seen, FOLDS) if early and far and not damped else seen

    def _best(self) -> int | None:
        """The most substeps that are of use, as measured; it stays where it differs by little."""
        found, known = self._errors.best(), self._useful
        if found is not None and not (known and known / ANEW <= found <= known * ANEW):
            self._useful = Limits(most=max(1, int(found))).rungs()[-1]
        return self._useful

    def _fits(self) -> int:
        """The most substeps that frames have time for, where an error is held."""
        fits = None if self.goal.seconds is not None else self._times.most_within()
        return RUNGS[-1] if fits is None else fits

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
            fits = self._fits()
            if fits < most:
                most, why = fits, f"frames would take more than {1e3 * LONGEST:g} ms to simulate"
        return Limits(least, max(most, least), why)


class StableSteps:
    """Between which substeps a simulation's steps are stable, and followed by its precision.

    method: by which; "": by the one that it has.
    """

    def __init__(self, sim: Simulation, method: str = "") -> None:
        self._sim, self._method = sim, method
        self._of: tuple[tuple[object, ...], tuple[object, ...]] | None = None
        self._mass, self._fixed = np.zeros(0), np.zeros(0, bool)
        self._least: int | None = 1
        self._frame = 0
        self._resolved: tuple[tuple[int, float], int] | None = None  # of what, and that

    def _now(self) -> tuple[tuple[object, ...], tuple[object, ...]]:
        """Inputs of the limit, beside masses and what is fixed: values, and tables, which are
        others where they are changed. What breaks widens it.
        """
        sim, scene = self._sim, self._sim.storage.scene
        method = self._method or sim.method
        return (method, sim.dt, str(scene.world.more)), (scene.springs, scene.stencils)

    def changed(self) -> bool:
        """True if the limit may be tighter than it was.

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
        """The fewest substeps that are stable; where none are, what there is is kept."""
        return self.found() or self._sim.substeps

    def found(self) -> int | None:
        """The fewest substeps that are stable, as `--dt auto` finds them; None: no step is."""
        if self.changed():
            sim, scene = self._sim, self._sim.storage.scene
            self._of, self._frame = self._now(), sim.frame
            self._mass, self._fixed = scene.particles.mass, scene.particles.fixed
            name = self._method or sim.method
            controller = SubstepController(name, methods.load(name), sim.dt)
            moving = acts_by_speed(scene)
            try:
                choose = controller.choose_in_motion if moving else controller.choose
                self._least = choose(sim.network())
            except InputError:
                self._least = None
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
