"""Compiles and launches kernels: under which settings, on how many threads, how much at once.

Nothing else launches a kernel on the fields of a simulation: those that touch packs must be
compiled with vectors kept whole, and whoever launched one by itself would forget it.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

from taichi_cloth.kernels import loops, resting_pairs, settling, stepping, watchdog
from taichi_cloth.kernels.fields import Capacity
from taichi_cloth.kernels.forces import has_tractions
from taichi_cloth.kernels.methods.contract import Method
from taichi_cloth.kernels.parts import has_parts
from taichi_cloth.kernels.solvers import phases
from taichi_cloth.kernels.specialization import Specialization
from taichi_cloth.runtime import (
    Device,
    compilation_time,
    compiled_soon,
    nothing_kept_over_calls,
    sums_in_order,
    whole_vectors,
)
from taichi_cloth.simulation import compiled
from taichi_cloth.simulation.prepared import PreparedLaunches

# Particles and springs times steps in one launch: some tenths of a second, so that Ctrl-C is heard.
LAUNCH_WORK = 20_000_000
# Iterations of a loop in a shader: Mesa's drivers leave one after 65535, and say nothing.
MOST_ITERATIONS = 65_000
# Seconds of compiling in a process, above which kernels are not only read from Taichi's cache.
COMPILED = 0.4


class Launcher:
    """Launches kernels on one device for one method.

    method: out of `kernels.methods`. compiling: called before kernels are compiled that no earlier
    run has left, once.
    """

    def __init__(
        self, method: Method, device: Device, compiling: Callable[[], None] | None = None
    ) -> None:
        self.device = device
        self._compiling = compiling
        self._kind: str | None = None  # what is compiled, until its first frames are done
        self._prepared = PreparedLaunches() if device.arch == "cpu" else None
        self._method = method
        self._step = phases.stepping(method.phases) if method.phases else method.step

    def specialize(self, spec: Specialization, path: str) -> Specialization:
        """What is compiled for frames on a path, "serial" or "parallel", of what `spec` stores."""
        per_step = path == "parallel" and self.device.arch != "cpu"
        threads = 1 if path == "serial" else self.device.threads
        return replace(spec, threads=threads, one_launch_per_step=per_step)

    def kind(self, spec: Specialization, capacity: Capacity) -> str:
        """Which kernels frames of what is specialized so are launched with (`compiled.kind`)."""
        return compiled.kind(self.device, self._method, spec, capacity)

    def expect(self, spec: Specialization, capacity: Capacity) -> None:
        """Say, where someone wants to hear it, if kernels for this are yet to be compiled."""
        if self._compiling is None:
            return
        kind = self.kind(spec, capacity)
        if not compiled.was_before(kind):
            self._tell()
        self._kind = kind

    def _tell(self) -> None:
        if self._compiling:
            self._compiling()
        self._compiling = None

    def launch(self, kernel: Callable[..., Any], *arguments: Any) -> Any:
        """Launch a kernel under the settings of its specialization, and return what it returns.

        arguments: the kernel's own: a specialization first, unless it touches no packs.
        """
        result = self._launch(kernel, *arguments)
        # The first kernels of a start are short, and tell whether those of earlier runs are there.
        if self._compiling and compilation_time() > COMPILED:
            self._tell()
        return result

    def _launch(self, kernel: Callable[..., Any], *arguments: Any) -> Any:
        """Launch a kernel as `launch` does; the specialization may be any of its arguments."""
        prepared = self._prepared.find(kernel, arguments) if self._prepared is not None else None
        if prepared is not None:
            return prepared(arguments)
        spec = next((one for one in arguments if isinstance(one, Specialization)), None)
        with self._settings(spec):
            result = kernel(*arguments)
            if self._prepared is not None:
                self._prepared.note(kernel, arguments)
        return result

    def begin(self, spec: Specialization, state: Any, done: int) -> None:
        """Compute what a method keeps from step to step: before its first step, and after the
        state was changed from outside.

        spec: one with parallel loops, one launch per step. done: steps so far.
        """
        if self._method.begin:
            soon = compiled_soon if self.device.arch == "cpu" else contextlib.nullcontext
            with soon():
                kernel = kernels_of(state).begin
                self._launch(kernel, self._method.begin, spec, state, state.lane_memory, done)

    def renew_halos(self, spec: Specialization, state: Any) -> None:
        """Fill the halos of all rows of packs anew, after their particles were loaded."""
        if spec.halo > 0:
            self._once(loops.renew_all_halos, self.specialize(spec, "serial"), state)

    def frames_per_launch(self, substeps: int, size: int) -> int:
        """Frames that may share a launch. size: particles and springs."""
        frames = LAUNCH_WORK // (substeps * max(size, 1))
        if self.device.arch != "cpu":
            frames = min(frames, MOST_ITERATIONS // substeps)
        return max(1, frames)

    def advance(
        self, spec: Specialization, state: Any, done: int, frames: int, substeps: int
    ) -> int:
        """Advance frames, after `done` steps, and return how many passed the watchdog."""
        passed = self._advance(spec, state, done, frames, substeps)
        if self._kind:
            compiled.note(self._kind)
            self._kind = None
        return passed

    def _advance(
        self, spec: Specialization, state: Any, done: int, frames: int, substeps: int
    ) -> int:
        if not spec.one_launch_per_step and not self._by_phases(spec):
            of = self._step, spec, state, state.lane_memory
            passed: int = self._launch(kernels_of(state).frames, *of, done, frames, substeps)
            return passed
        for frame in range(frames):
            self._launch_steps(spec, state, done + frame * substeps, substeps)
            if self._launch(watchdog.last_fault, state) != watchdog.NO_FAULT:
                return frame
        return frames

    def _by_phases(self, spec: Specialization) -> bool:
        """Whether each step takes several launches."""
        split = spec.one_launch_per_step or (spec.lanes > 1 and self._method.launches)
        return bool(self._method.phases and split)

    def _launch_steps(self, spec: Specialization, state: Any, done: int, substeps: int) -> None:
        """Advance a frame after `done` steps, with a launch or more for each step."""
        by_phases = self._by_phases(spec)
        if spec.one_launch_per_step:
            self._launch(watchdog.checkpoint_launch, spec, state)
        else:
            self._once(watchdog.checkpoint, _for_one_pass(spec, state), state)
        for step in range(done + 1, done + substeps + 1):
            if by_phases:
                self._launch_phases(spec, state, step)
                if stepping.has_end(spec):
                    self._end_step(spec, state)
            elif settling.in_launches(spec):
                self._launch(stepping.method_launch, self._step, spec, state, step)
                self._end_step(spec, state)
            else:
                self._launch(stepping.substep_launch, self._step, spec, state, step)

    def _end_step(self, spec: Specialization, state: Any) -> None:
        """Launch what ends a step by itself."""
        if settling.in_launches(spec):
            self._launch(stepping.settle_launch, spec, state)
            for done in range(resting_pairs.LAUNCHED):
                self._launch(stepping.iterate_launch, spec, state, done)
        if spec.resting and not spec.one_launch_per_step:
            self._once(stepping.end_step, spec, state)
        else:
            by_loops = replace(spec, one_launch_per_step=True)
            self._launch(stepping.end_step_launch, by_loops, state)

    def _launch_phases(self, spec: Specialization, state: Any, step: int) -> None:
        """Launch the phases of a step; the device says after each launch which one is next."""
        self._launch(stepping.begin_step_launch, state, step)
        phase = 0
        while phase != phases.DONE:
            if spec.one_launch_per_step:
                of = self._method.phases[phase]
                phase = self._launch(stepping.phase_launch, of, spec, state)
            else:
                these = next(these for these in self._method.launches if phase in these)
                on = _for_one_pass(spec, state) if these == self._method.launches[0] else spec
                phase = self._once(phases.together(self._method.phases, these), on, state)

    def _once(self, body: Callable[..., Any], spec: Specialization, state: Any) -> int:
        """Run a part of a step on the threads of `spec`, and return the phase that is next."""
        phase: int = self._launch(kernels_of(state).once, body, spec, state, state.lane_memory)
        return phase

    @contextlib.contextmanager
    def _settings(self, spec: Specialization | None) -> Iterator[None]:
        """How kernels on the packs of a specialization are compiled; None: they touch no packs."""
        with contextlib.ExitStack() as settings:
            if spec is not None and spec.lanes > 1:
                settings.enter_context(whole_vectors())
            if self._method.sums or spec is not None and _has_long_sums(spec):
                settings.enter_context(sums_in_order())
            if spec is not None and has_parts(spec):
                settings.enter_context(nothing_kept_over_calls())
            yield


def _for_one_pass(spec: Specialization, state: Any) -> Specialization:
    """What is compiled for a launch that goes over all packs but once: one thread where they are
    few, as to wake the others takes longer.
    """
    short = spec.threads > 1 and loops.is_short(state.packs * spec.lanes)
    return _on_one_thread(spec) if short else spec


@functools.lru_cache
def _on_one_thread(spec: Specialization) -> Specialization:
    """The same on one thread; kept, as to make it takes as long as a launch."""
    return replace(spec, threads=1)


def kernels_of(state: Any) -> stepping.Kernels:
    """The kernels that fit the packs of a state."""
    lanes = 1 if state.lane_memory is None else state.lane_memory.shape[1]
    kernels: stepping.Kernels = stepping.kernels_of(lanes, state.real)
    return kernels


def _has_long_sums(spec: Specialization) -> bool:
    """Whether particles get so many terms that compilers add them in an order of their own."""
    return bool(settling.ends_step(spec) or has_tractions(spec))
