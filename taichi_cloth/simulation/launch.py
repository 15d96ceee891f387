"""Compiles and launches kernels: under which settings, on how many threads, how much at once.

Nothing else launches a kernel on the fields of a simulation: those that touch packs must be
compiled with vectors kept whole, and whoever launched one by itself would forget it.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from types import ModuleType
from typing import Any

from taichi_cloth.kernels import stepping, watchdog
from taichi_cloth.kernels.solvers import phases
from taichi_cloth.kernels.specialization import Plan
from taichi_cloth.runtime import Device, sums_in_order, whole_vectors

# Particles and springs times steps in one launch: some tenths of a second, so that Ctrl-C is heard.
LAUNCH_WORK = 20_000_000
# Iterations of a loop in a shader: Mesa's drivers leave one after 65535, and say nothing.
MOST_ITERATIONS = 65_000


class Launcher:
    """Launches kernels on one device for one method.

    method: its module, out of `kernels.methods`.
    """

    def __init__(self, method: ModuleType, device: Device) -> None:
        self.device = device
        self._begin = getattr(method, "begin", None)
        self._phases: tuple[Any, ...] = getattr(method, "PHASES", ())
        self._launches: tuple[tuple[int, ...], ...] = getattr(method, "LAUNCHES", ())
        self._sums = bool(getattr(method, "SUMS", 0))
        self._step = phases.stepping(self._phases) if self._phases else method.step

    def specialize(self, plan: Plan, path: str) -> Plan:
        """What is compiled for frames on a path, "serial" or "parallel", of what `plan` stores."""
        spread = path == "parallel" and (self.device.arch != "cpu" or plan.collisions)
        threads = 1 if path == "serial" else self.device.threads
        return replace(plan, threads=threads, spread=spread)

    def launch(self, kernel: Callable[..., Any], *arguments: Any) -> Any:
        """Launch a kernel under the settings of its plan, and return what it returns.

        arguments: the kernel's own: a plan first, unless it touches no packs.
        """
        with self._settings(arguments[0]):
            return kernel(*arguments)

    def begin(self, plan: Plan, state: Any) -> None:
        """Compute what a method keeps from step to step: before its first step, and after the
        state was changed from outside.

        plan: one whose loops are spread.
        """
        if self._begin is not None:
            with self._settings(plan):
                stepping.begin_spread(self._begin, plan, state)

    def frames_per_launch(self, substeps: int, size: int) -> int:
        """Frames that may share a launch. size: particles and springs."""
        frames = LAUNCH_WORK // (substeps * max(size, 1))
        if self.device.arch != "cpu":
            frames = min(frames, MOST_ITERATIONS // substeps)
        return max(1, frames)

    def run_frames(self, plan: Plan, state: Any, done: int, frames: int, substeps: int) -> int:
        """Advance frames, after `done` steps, and return how many passed the watchdog."""
        with self._settings(plan):
            if not plan.spread and not self._by_phases(plan):
                passed: int = stepping.frames_in_one_launch(
                    self._step, plan, state, done, frames, substeps
                )
                return passed
            for frame in range(frames):
                self._launch_steps(plan, state, done + frame * substeps, substeps)
                if watchdog.last_fault(state) != watchdog.NO_FAULT:
                    return frame
            return frames

    def _by_phases(self, plan: Plan) -> bool:
        """Whether each step takes several launches."""
        split = plan.spread or (plan.lanes > 1 and self._launches)
        return bool(self._phases and split)

    def _launch_steps(self, plan: Plan, state: Any, done: int, substeps: int) -> None:
        """Advance a frame after `done` steps, with a launch or more for each step."""
        spread, by_phases = replace(plan, spread=True), self._by_phases(plan)
        watchdog.keep_spread(spread, state)
        for step in range(done + 1, done + substeps + 1):
            if by_phases:
                self._launch_phases(plan, state, step)
                if plan.fracture:
                    stepping.end_step_spread(spread, state)
            else:
                stepping.substep_spread(self._step, plan, state, step)

    def _launch_phases(self, plan: Plan, state: Any, step: int) -> None:
        """Launch the phases of a step; the device says after each launch which one is next."""
        stepping.begin_step_spread(state, step)
        phase = 0
        while phase != phases.DONE:
            if plan.spread:
                phase = stepping.phase_spread(self._phases[phase], plan, state)
            else:
                these = next(these for these in self._launches if phase in these)
                phase = stepping.phases_in_one_launch(self._phases, these, plan, state)

    @contextlib.contextmanager
    def _settings(self, plan: object) -> Iterator[None]:
        """How kernels on a plan's packs are compiled."""
        with contextlib.ExitStack() as settings:
            if isinstance(plan, Plan) and plan.lanes > 1:
                settings.enter_context(whole_vectors())
            if self._sums:
                settings.enter_context(sums_in_order())
            yield
