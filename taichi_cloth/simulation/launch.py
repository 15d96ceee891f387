"""Compiles and launches kernels: under which settings, on how many threads, how much at once.

Nothing else launches a kernel on the fields of a simulation: those that touch packs must be
compiled with vectors kept whole, and whoever launched one by itself would forget it.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

from taichi_cloth.kernels import loops, phases, resting_pairs, settling, stepping, watchdog
from taichi_cloth.kernels.fields import Capacity
from taichi_cloth.kernels.forces import has_tractions
from taichi_cloth.kernels.methods.contract import Method
from taichi_cloth.kernels.parts import has_parts
from taichi_cloth.kernels.specialization import Specialization
from taichi_cloth.kernels.transfer import Transfer
from taichi_cloth.runtime import (
    Device,
    compilation_time,
    compiled_soon,
    in_its_thread,
    nothing_kept_over_calls,
    refuse_other_threads,
    sums_in_order,
    whole_vectors,
)
from taichi_cloth.simulation import compiled
from taichi_cloth.simulation.prepared import PreparedLaunch, PreparedLaunches, was_launched

# Particles and springs times steps in one launch: some tenths of a second, so that Ctrl-C is heard,
# after a frame, or if it comes twice.
LAUNCH_WORK = 20_000_000
# Iterations of a loop in a shader: Mesa's drivers leave one after 65535, and say nothing.
MOST_ITERATIONS = 65_000
# Where threads that stay would take more turns at a loop over all packs, each step is a launch: it
# has more threads, which wait less for memory.
MOST_TURNS = 8
# Steps in one launch of blocks that stay, of methods without and with phases: some tenths of a
# second, as above, however small the scene is, since many systems end one of some seconds. Where a
# frame has more, or is of more work, each step is a launch.
STAYING_STEPS = 16_000, 256
# Seconds of compiling in a process, above which kernels are not only read from Taichi's cache.
COMPILED = 0.4


class Launcher:
    """Launches kernels on one device for one method.

    method: out of `kernels.methods`. compiling: called before kernels are compiled that no earlier
    run has left, once. soon: whether those of frames on the graph are then compiled soon
    (`runtime.compiled_soon`).
    """

    def __init__(
        self,
        method: Method,
        device: Device,
        compiling: Callable[[], None] | None = None,
        soon: bool = False,
    ) -> None:
        self.device = device
        self.soon = soon
        self.hurries = False  # whether frames of what was loaded last are compiled soon
        self._compiling = compiling
        self._kind: str | None = None  # what is compiled, until its first frames are done
        self._chosen: dict[tuple[Specialization, Capacity], bool] = {}  # `_hurries`
        self._prepared = PreparedLaunches()
        # By what the last frames were launched, and what comes before a method's first step.
        self._again: PreparedLaunch | None = None
        self._begun: tuple[Specialization, Specialization, PreparedLaunch] | None = None
        self._method = method
        self._step = phases.stepping(method.phases) if method.phases else method.step

    def specialize(self, spec: Specialization, path: str, packs: int) -> Specialization:
        """The specialization of frames on a path, "serial" or "parallel", of what `spec` stores.

        packs: for how many there is room, so that what is spawned there compiles nothing anew.
        """
        if path == "serial" or self.device.arch == "cpu":
            return _on_threads(spec, 1 if path == "serial" else self.device.threads)
        return self._staying(spec, packs) if self._frames_stay(spec, packs) else _by_steps(spec)

    def _frames_stay(self, spec: Specialization, packs: int) -> bool:
        """True if the blocks that run so many packs on a GPU may stay for whole frames.

        Not where cloths rest on each other: by colours, of which each would be a few pairs for all
        threads, that takes a GPU too long.
        """
        most = self.device.multiprocessors
        few = packs <= MOST_TURNS * _power_of_two_below(most) * loops.BLOCK
        return most > 0 and not spec.thick and (few or bool(self._method.phases))

    def _staying(self, spec: Specialization, packs: int) -> Specialization:
        """The specialization of blocks that stay on a GPU, as many as it holds at most.

        That is a power of two, so that scenes of like sizes share kernels.
        """
        wanted = 1 << (-(-packs // loops.BLOCK) - 1).bit_length()
        blocks = min(wanted, _power_of_two_below(self.device.multiprocessors))
        return _in_blocks(spec, blocks)

    def kind(self, spec: Specialization, capacity: Capacity) -> str:
        """Which kernels frames of what is specialized so are launched with (`compiled.kind`)."""
        return compiled.kind(self.device, self._method, spec, capacity)

    def expect(self, spec: Specialization, capacity: Capacity) -> None:
        """Choose how frames of this are compiled, where they are not yet there.

        Where someone wants to hear it, it says that some are to be compiled.
        """
        self.hurries = self._hurries(spec, capacity)
        if self._compiling is None:
            return
        kind = self.kind(spec, capacity)
        if self.hurries:
            kind = compiled.soon(kind)
        if not compiled.was_before(kind):
            self._tell()
        self._kind = kind

    def _hurries(self, spec: Specialization, capacity: Capacity) -> bool:
        """True if frames of this are compiled soon: on CPUs those on the graph, whose steps take
        little longer then, where no earlier run has left faster ones.

        What is chosen in a process stays, though others may have compiled some meanwhile.
        """
        if not self.soon or self.device.arch != "cpu" or spec.lanes > 1:
            return False
        if (spec, capacity) not in self._chosen:
            faster = compiled.was_before(self.kind(spec, capacity))
            self._chosen[spec, capacity] = not faster
        return self._chosen[spec, capacity]

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

    def _launch(self, kernel: Callable[..., Any], *arguments: Any, soon: bool = False) -> Any:
        """Launch a kernel as `launch` does; the specialization may be any of its arguments.

        soon: whether it is compiled soon, if it is not there.
        """
        prepared = self._prepared.find(kernel, arguments)
        if prepared is not None:
            return prepared(arguments)
        if not (in_its_thread() or was_launched(kernel, arguments)):
            refuse_other_threads()
        spec = next((one for one in arguments if isinstance(one, Specialization)), None)
        with self._settings(spec), compiled_soon() if soon else contextlib.nullcontext():
            result = kernel(*arguments)
            self._prepared.note(kernel, arguments)
        return result

    def begin(self, spec: Specialization, state: Any, done: int) -> None:
        """Compute what a method keeps from step to step: before its first step, and after the
        state was changed from outside.

        spec: of the fields. done: steps so far. It is compiled by itself, because compile time
        grows with the square of what is in a kernel, and once for both paths.
        """
        begin = self._method.begin
        if begin and self.device.arch == "cpu":
            Transfer(state).put(state.step, done)
            if self._begun is not None:
                of, on, again = self._begun
                if of is spec and again.repeats_with(state, begin, on):
                    again.launch()
                    return
            on = _for_one_pass(self.specialize(spec, "parallel", state.packs), state)
            self._once(begin, on, state, soon=True)
            last = self._prepared.last(kernels_of(state).once)
            self._begun = None if last is None else (spec, on, last)
        elif begin:
            self._launch(stepping.begin_launch, begin, _by_steps(spec), state, done)

    def frames_per_launch(self, substeps: int, size: int) -> int:
        """Frames that may share a launch. size: particles and springs."""
        frames = LAUNCH_WORK // (substeps * max(size, 1))
        if self.device.multiprocessors > 0:
            frames = min(frames, self._staying_steps() // substeps)
        elif self.device.arch != "cpu":
            frames = min(frames, MOST_ITERATIONS // substeps)
        return max(1, frames)

    def advance(
        self, spec: Specialization, state: Any, done: int, frames: int, substeps: int
    ) -> int:
        """Advance frames, after `done` steps, and return how many passed the watchdog."""
        if self._again is not None and self._again.repeats_with(state, self._step, spec):
            again: int = self._again.launch(done, frames, substeps)
            return again
        passed = self._advance(spec, state, done, frames, substeps)
        if self._kind:
            compiled.note(self._kind)
            self._kind = None
        return passed

    def _staying_steps(self) -> int:
        return STAYING_STEPS[bool(self._method.phases)]

    def _is_long(self, state: Any, substeps: int) -> bool:
        """True if a frame is more than one launch of blocks that stay should hold."""
        return substeps > self._staying_steps() or substeps * state.packs > LAUNCH_WORK

    def _advance(
        self, spec: Specialization, state: Any, done: int, frames: int, substeps: int
    ) -> int:
        if spec.blocks > 0 and self._is_long(state, substeps):
            spec = _by_steps(spec)
        if not spec.one_launch_per_step and not self._by_phases(spec):
            of = self._step, spec, state, state.lane_memory
            run_frames, how_long = kernels_of(state).frames, (done, frames, substeps)
            passed: int = self._launch(run_frames, *of, *how_long, soon=self.hurries)
            self._again = self._prepared.last(run_frames)
            return passed
        for frame in range(frames):
            self._launch_steps(spec, state, done + frame * substeps, substeps)
            if self._launch(watchdog.last_fault, state) != watchdog.NO_FAULT:
                return frame
        return frames

    def _by_phases(self, spec: Specialization) -> bool:
        """True if each step takes several launches."""
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
            self._before_pairs(spec, state)
            if spec.resting:
                self._launch(stepping.find_pairs_launch, spec, state)
                for done in range(resting_pairs.LAUNCHED):
                    self._launch(stepping.iterate_launch, spec, state, done)
        if settling.repeats(spec) and not spec.one_launch_per_step:
            self._once(stepping.end_step, spec, state)
        else:
            by_loops = replace(spec, one_launch_per_step=True)
            self._launch(stepping.end_step_launch, by_loops, state)

    def _before_pairs(self, spec: Specialization, state: Any) -> None:
        """Launch what comes before resting pairs: at once where blocks may stay for it."""
        if self.device.multiprocessors > 0:
            self._once(settling.before_pairs, self._staying(spec, state.packs), state)
            return
        for act in settling.launches_before_pairs(spec):
            if isinstance(act, tuple):
                self._launch_each(act, spec, state)
            else:
                self._launch(stepping.act_launch, act, spec, state)

    def _launch_phases(self, spec: Specialization, state: Any, step: int) -> None:
        """Launch the phases of a step: at once where blocks may stay for it."""
        self._launch(stepping.begin_step_launch, state, step)
        of = self._method.phases
        if self.device.multiprocessors > 0:
            every = phases.together(of, tuple(range(len(of))))
            self._once(every, self._staying(spec, state.packs), state)
        elif spec.one_launch_per_step:
            self._launch_each(of, spec, state)
        else:
            phase = 0
            while phase != phases.DONE:
                these = next(these for these in self._method.launches if phase in these)
                on = _for_one_pass(spec, state) if these == self._method.launches[0] else spec
                phase = self._once(phases.together(of, these), on, state)

    def _launch_each(
        self, of: Sequence[Callable[..., Any]], spec: Specialization, state: Any
    ) -> None:
        """Launch phases each by itself; the device says after each which one is next."""
        phase = 0
        while phase != phases.DONE:
            phase = self._launch(stepping.phase_launch, of[phase], spec, state)

    def _once(
        self, body: Callable[..., Any], spec: Specialization, state: Any, soon: bool = False
    ) -> int:
        """Run a part of a step on the threads of `spec`, and return the phase that is next."""
        of = body, spec, state, state.lane_memory
        phase: int = self._launch(kernels_of(state).once, *of, soon=soon)
        return phase

    @contextlib.contextmanager
    def _settings(self, spec: Specialization | None) -> Iterator[None]:
        """The way kernels on the packs of a specialization are compiled; None: they touch none."""
        with contextlib.ExitStack() as settings:
            if spec is not None and spec.lanes > 1:
                settings.enter_context(whole_vectors())
            if self._method.sums or spec is not None and _has_long_sums(spec):
                settings.enter_context(sums_in_order())
            if spec is not None and has_parts(spec):
                settings.enter_context(nothing_kept_over_calls())
            yield


def _power_of_two_below(count: int) -> int:
    """The largest power of two that is at most `count`; 0 of 0."""
    return 1 << (count.bit_length() - 1) if count else 0


def _for_one_pass(spec: Specialization, state: Any) -> Specialization:
    """The specialization of a launch that goes over all packs but once: one thread where they are
    few, as to wake the others takes longer.
    """
    short = spec.threads > 1 and loops.is_short(state.packs * spec.lanes)
    return _on_threads(spec, 1) if short else spec


@functools.lru_cache
def _in_blocks(spec: Specialization, blocks: int) -> Specialization:
    """The same by so many blocks that stay; kept, as to make it takes as long as a launch."""
    threads = blocks * loops.BLOCK
    return replace(spec, threads=threads, blocks=blocks, one_launch_per_step=False)


@functools.lru_cache
def _by_steps(spec: Specialization) -> Specialization:
    """The same with a launch for each step."""
    return replace(spec, threads=1, blocks=0, one_launch_per_step=True)


@functools.lru_cache
def _on_threads(spec: Specialization, threads: int) -> Specialization:
    """The same on so many threads; kept, so that launches know it again by what it is."""
    return replace(spec, threads=threads, one_launch_per_step=False)


def kernels_of(state: Any) -> stepping.Kernels:
    """The kernels that fit the packs of a state."""
    lanes = 1 if state.lane_memory is None else state.lane_memory.shape[1]
    kernels: stepping.Kernels = stepping.kernels_of(lanes, state.real)
    return kernels


def _has_long_sums(spec: Specialization) -> bool:
    """True if particles get so many terms that compilers add them in an order of their own."""
    return bool(settling.ends_step(spec) or has_tractions(spec))
