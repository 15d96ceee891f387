"""A scene in motion: its clock, and the front door to all that can be done with it."""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import NoReturn

import numpy as np
from numpy.typing import ArrayLike

from taichi_cloth.errors import InputError, SimulationFailure, counted
from taichi_cloth.kernels import methods
from taichi_cloth.kernels.methods.contract import Method
from taichi_cloth.kernels.state import WORK
from taichi_cloth.limits.precision import refuse_unholdable
from taichi_cloth.runtime import current_device, still_runs
from taichi_cloth.scene.checks import validate
from taichi_cloth.scene.model import Particles, Scene, Springs
from taichi_cloth.scene.properties import PARTICLE_PROPERTIES
from taichi_cloth.scene.stencils import Stencils
from taichi_cloth.settings import accepted
from taichi_cloth.settings.options import PATHS, TOPOLOGIES
from taichi_cloth.simulation import autotune, diagnosis, sixteen
from taichi_cloth.simulation.accounts import Accounts
from taichi_cloth.simulation.acts import act
from taichi_cloth.simulation.auto_substeps import AutoSubsteps
from taichi_cloth.simulation.changes import Changes
from taichi_cloth.simulation.checkpoint import Checkpoints
from taichi_cloth.simulation.editing import same
from taichi_cloth.simulation.engine import Engine
from taichi_cloth.simulation.interrupts import HeldBack
from taichi_cloth.simulation.launch import Launcher
from taichi_cloth.simulation.numbers import (
    Numbers,
    asked_step,
    checked_step,
    runaway_speed,
    solver_settings,
)
from taichi_cloth.simulation.past import Past
from taichi_cloth.simulation.prediction import Prediction
from taichi_cloth.simulation.pushes import Pushes
from taichi_cloth.simulation.readings import Readings
from taichi_cloth.simulation.showing import Showing
from taichi_cloth.simulation.snapshot import Snapshot
from taichi_cloth.simulation.start import Starts
from taichi_cloth.simulation.storage.storage import Storage

# Particles in a pack on CPUs: 8 fill the widest vectors there are in f64, half of one in f32, where
# 16 are faster and take half as long again to compile; `sixteen.py`.
LANES = 8
MOST_LANES = 64  # more fill no vector, and take minutes to compile
CHOSEN = "--dt auto chooses the step; it cannot be set: begin with substeps of your own"


class Simulation(Readings, Accounts, Pushes, Changes, Checkpoints, Starts, Engine, Showing):
    """One scene, integrated by one method on the device that `runtime.start` started.

    scene: validated here (InputError), against the device's precision, too. Its arrays are not
    copied, and from here on read-only (NumPy raises ValueError): make other scenes of it by
    `with_parts`, `with_world` or `dataclasses.replace`, and change a run by `set`.
    method: a name out of `kernels.methods.METHODS`.
    dt: time of a frame; substeps: steps a frame is cut into; both the scene's own when absent. With
    dt "auto" a frame is the scene's, cut into as many as its springs need (`auto_substeps.py`); so
    it is where both are absent, and the scene's substeps are "auto".
    execution: "serial" (on one thread) or "parallel" (on all threads, or a GPU).
    topology: "lanes" (the regular grids among the springs without index lists, in packs of several
    particles; the rest on the graph), or "graph" (all springs by lists of neighbours).
    "auto" is, for both, what is predicted to be fastest for such a scene, or was measured to be in
    earlier runs on this machine.
    lanes: particles in a pack of that topology; LANES on CPUs and 1 on GPUs where absent. "auto":
    16 where they pay and earlier runs have compiled their kernels, else as where absent.
    tolerance: relative residual of a step's solution, of methods that solve for it; iterations:
    sweeps a step, of methods that iterate (`options.SOLVER_SETTINGS` where absent). InputError for
    a method that does not take it.
    compiling: called before kernels are compiled that no earlier run has left, once.
    accounts_contacts: whether `account_contacts` may be called, which takes more to compile.
    soon: whether kernels of the graph that no earlier run has left are compiled in about half the
    time. Steps then take up to 1.1 times as long (1.2 with thousands of particles, or a few).

    aside: what goes on beside the run, in words, for whoever shows its state; "": nothing.
    held_up: seconds a frame on one thread, as estimated, and on all of them, where the execution
    "parallel" was asked for and threads only wait, because other programs want the cores.
    changes_over: whether the next frame is the first on one thread, as threads only waited, which
    may take long: its kernels may have to be compiled.
    storage: the state on the device, to look at. speed_limit: above it a particle runs away.
    It is neither copied nor pickled (TypeError): its scene and its checkpoints are. Taichi keeps
    what it compiled for each; for many runs in a row make one, and have it `load_scene`.
    Arrays are returned as float64 copies, one row per particle in the order of creation.
    """

    def __init__(
        self,
        scene: Scene,
        method: str = "symplectic_euler",
        dt: float | str | None = None,
        substeps: int | None = None,
        execution: str = "auto",
        topology: str = "auto",
        lanes: int | str | None = None,
        tolerance: float | None = None,
        iterations: int | None = None,
        compiling: Callable[[], None] | None = None,
        accounts_contacts: bool = False,
        soon: bool = False,
    ) -> None:
        accepted.word("--method", method, methods.METHODS)
        accounts_contacts = accepted.flag("accounts_contacts", accounts_contacts)
        soon = accepted.flag("soon", soon)
        if not (compiling is None or callable(compiling)):
            raise InputError(f"compiling must be a function, is {accepted.shown(compiling)}")
        self._widens = isinstance(lanes, str) and lanes == "auto"
        if self._widens:
            lanes = None
        if lanes is not None:
            lanes = accepted.power_of_two("lanes", lanes, MOST_LANES)
        self.scene = self._given = validate(scene)
        self.method = method
        refuse_unholdable(scene, current_device().precision)
        follows, step = asked_step(scene.world, dt, substeps)
        self.dt, self.substeps = checked_step(*step)
        device = current_device()
        self._module = methods.load(method)
        self.claims = self._module.claims
        self.solver = solver_settings(method, self.claims, tolerance, iterations)
        self.speed_limit = runaway_speed(scene, self.dt)
        self._lanes = lanes
        self._engines = {}
        self._launcher = Launcher(self._module, device, compiling, soon)
        start = Snapshot.at_start(self.scene.seal())
        lanes = self._lanes_for(self._module)
        self._storage = Storage(self._module, lanes, self._launcher, start, accounts_contacts)
        self._auto = AutoSubsteps(method, self._module, self.dt) if follows else None
        self._requested = (
            accepted.word("--topology", topology, (*TOPOLOGIES, "auto")),
            accepted.word("--execution", execution, (*PATHS, "auto")),
        )
        self.topology = self.execution = self._preferred = ""  # until the first `reset` has chosen
        self._watch = None
        self.held_up, self.changes_over, self.aside = None, False, ""
        self._ready = False  # for clicks, until a window asks
        self._note_settings()
        self.frame, self._counted, self._first = 0, (0, 0), 0
        self._since = 0, 0.0, 0
        self._work, self._unsettled = np.zeros(len(WORK), np.int64), np.zeros(2, np.int64)
        self.past = Past()
        self.reset()

    def __repr__(self) -> str:
        """Its line at a prompt: how far it is, of how much, and how it is run; that it is gone
        with its start of Taichi, where reading it would raise: no debugger or log expects that.
        """
        if not still_runs(self._launcher.device):
            return f"<Simulation: {self.scene.name!r}, gone with the start of Taichi>"
        much = f"{counted(self.particle_count, 'particle')}, {counted(self.spring_count, 'spring')}"
        run = f"{self.method} in {self._launcher.device.precision}, {self.way}"
        step = f"dt {self.dt:g} in {counted(self.substeps, 'substep')}"
        after = counted(self.frame, "frame")
        return f"<Simulation: {self.scene.name!r} after {after}, {much}; {run}; {step}>"

    def __reduce__(self) -> NoReturn:
        raise TypeError(
            f"the simulation of '{self.scene.name}' is on the device, and cannot be copied or "
            "pickled; its `scene` can, and where it stands, `checkpoint()`"
        )

    def _lanes_for(self, module: Method) -> int:
        """The number of particles that a pack has under a method."""
        if self._launcher.device.arch != "cpu":
            return self._lanes or 1
        most = module.most_lanes(self.scene.world.dim)
        return self._lanes or min(LANES, most or LANES)

    @act
    def load_scene(
        self, scene: Scene, dt: float | None = None, substeps: int | None = None
    ) -> None:
        """Take another scene, from its start; method, settings, topology and execution stay.

        Nothing is compiled anew for a scene that fits: of the same dimension, walls, collisions and
        grids, without features, particles or springs beyond those there were. What it lacks of
        these features stays compiled, without effect.
        dt, substeps: as in the constructor; one that chooses its substeps goes on choosing them.
        InputError where the constructor raises it; all is then as it was.
        """
        if self.follows and not (dt is None and substeps in (None, 1)):
            raise InputError(CHOSEN)
        validate(scene)
        follows, asked = asked_step(scene.world, "auto" if self.follows else dt, substeps)
        step = checked_step(*asked)
        refuse_unholdable(scene, current_device().precision)
        names = ("scene", "_given", "began", "frame", "_work", "_counted", "_first", "_engines")
        before = {name: getattr(self, name) for name in names}
        with self._undone_if_refused(self.storage.snapshot()):
            try:
                self._begin_anew(scene, step, follows)
            except InputError:
                for name, value in before.items():
                    setattr(self, name, value)
                raise

    def _begin_anew(self, scene: Scene, step: tuple[float, int], follows: bool) -> None:
        """Take a scene that was checked, with frames and steps of `step`, from its start.

        follows: whether the substeps are chosen.
        """
        self.scene = self._given = scene.seal()
        self._engines = {}
        self.dt, self.substeps = step
        self._auto = AutoSubsteps(self.method, self._module, self.dt) if follows else None
        self.speed_limit = runaway_speed(scene, self.dt)
        self._note_settings()
        self.reset()

    # --- the clock -------------------------------------------------------------------------

    @act
    def reset(self) -> None:
        """Back to the start of the scene as it was given.

        What was spawned since is gone, and all that was set, tied, cut, pinned or removed is as it
        was: `set` it again, or `load_scene` a changed one.
        """
        self.frame, self._since = 0, (0, 0.0, 0)
        self._work, self._counted, self._first = np.zeros(len(WORK), np.int64), (0, 0), 0
        start = Snapshot.at_start(self.scene)
        if self._auto:
            self._change_step(self.dt, self._auto.at_start(start))
        self._store(start)
        self._unsettled[:] = 0

    def advance(self, frames: int = 1) -> None:
        """Advance by whole frames, at least 0.

        Raises SimulationFailure when a particle is no longer finite or runs away; the state is
        then that of the last good frame, and can be read, drawn and saved. What a signal's handler
        raises, as KeyboardInterrupt, comes between two frames, from which the run can go on; what a
        second one raises, at once.
        """
        frames = accepted.whole_number("advance: frames", frames)
        while frames > 0:
            with HeldBack():
                frames -= self._advance_batch(frames)
            for listener in self.listeners:
                listener.between_frames()

    def _advance_batch(self, frames: int) -> int:
        """Advance by those of some frames that share a launch; return how many they are."""
        storage = self.storage
        # A push lasts one frame, and what breaks may change the next; else they share a launch.
        follows = self._auto is not None and self._auto.follows(storage)
        single = storage.pushed or follows or bool(self.listeners)
        batch = 1
        if not single and frames > 1:
            batch = min(frames, self._frames_per_launch(storage.scene))
        passed = self._advance_together(storage, batch)
        self.frame += passed
        if passed < batch:
            self._fail()
        storage.end_push()
        if self.past is not None:
            self.past.after_frames(self)
        for listener in self.listeners:
            listener.after_frame()
        if self._auto and follows:
            chosen = self._auto.after_frame(storage, self.substeps)
            if self._take_substeps(chosen):
                storage.set_numbers(self._numbers())
        return batch

    def _advance_together(self, storage: Storage, frames: int) -> int:
        """Advance frames that share a launch, and return how many passed the watchdog."""
        self.changes_over = False
        watch = self._watch
        # One thread waits for nobody, and what was asked for teaches nothing.
        if watch is None or ("auto" not in self._requested and storage.specialization.threads == 1):
            return self._launch_frames(storage, frames)
        begin, of_threads = time.perf_counter(), time.process_time()
        passed = self._launch_frames(storage, frames)
        seconds = time.perf_counter() - begin
        wanted = seconds * storage.specialization.threads
        had = (time.process_time() - of_threads) / wanted
        self._heed(watch, seconds, frames * self.substeps, had)
        return passed

    def _launch_frames(self, storage: Storage, frames: int) -> int:
        steps = self.steps
        spec, state = storage.begin(steps)
        passed = self._launcher.advance(spec, state, steps, frames, self.substeps)
        if self._module.claims.forces == 0:  # the work of a step is not known beforehand
            self._work += storage.take_work()
        return passed

    def _heed(self, watch: autotune.Watch, seconds: float, steps: int, had: float) -> None:
        """Note a launch; remember what it costs, and change over where threads only wait.

        had: the part of the processor's time on their cores that threads had meanwhile.
        A path that was asked for is kept, and `held_up` says so.
        """
        if watch.enough(seconds, steps) and "auto" in self._requested:
            cost = watch.cost(min(self._time_launch() for _ in range(watch.ENOUGH)))
            if cost and not self.wide:  # what is remembered is of eight lanes
                way = f"{self.topology} {self.execution}"
                autotune.remember(self.kind_of_run(), way, cost)
        if not watch.lost(seconds, steps, had):
            return
        if watch.choice.forced:
            self.held_up = watch.alone * self.substeps, watch.together * self.substeps
        else:
            self.execution, self._watch, self.changes_over = "serial", None, True
            self.storage.set_path(self.execution)

    def _time_launch(self) -> float:
        """Seconds that a launch without frames takes."""
        begin = time.perf_counter()
        self._launch_frames(self.storage, 0)
        return time.perf_counter() - begin

    def kind_of_run(self) -> str:
        """In words: device, method, features and size, by which is kept what runs have learned."""
        return self._prediction().key

    def _prediction(self) -> Prediction:
        return Prediction(self.storage, self._launcher, self.substeps, self.method, self._module)

    def _frames_per_launch(self, scene: Scene) -> int:
        size = len(scene.particles) + len(scene.springs)
        return self._launcher.frames_per_launch(self.substeps, size)

    def _fail(self) -> None:
        """Put the last good frame back, and say who failed, why, and what to change."""
        particle = self.storage.faulty_particle()
        x, v = self.positions()[particle], self.velocities()[particle]
        with np.errstate(all="ignore"):  # of numbers that overflow, which is what it reports
            what = diagnosis.describe_fault(self.scene.world, x, v, self.speed_limit)
            self._take_unsettled()
            self.storage.restore(self.steps)
            cause, remedy = diagnosis.likely_cause(
                self.scene, self.network(), self.method, self.dt, self.substeps,
                self.storage.real.__name__, self.speed_limit, self.solver.get("tolerance", 0.0),
            )  # fmt: skip
        failure = SimulationFailure(particle, self.frame + 1, what, cause, remedy)
        if self.past is not None:
            self.past.failure = failure
        raise failure

    @property
    def time(self) -> float:
        """Simulated time, in the scene's units."""
        frame, time, _ = self._since
        return time + (self.frame - frame) * self.dt

    @property
    def steps(self) -> int:
        """Steps done since the start."""
        frame, _, steps = self._since
        return steps + (self.frame - frame) * self.substeps

    @property
    def follows(self) -> bool:
        """True if it chooses its substeps by itself (dt "auto")."""
        return self._auto is not None

    @act
    def set_step(self, dt: float | None = None, substeps: int | None = None) -> None:
        """From now on take frames of `dt`, in `substeps` steps each; absent: as they are.

        InputError where one is not positive, or with dt "auto".
        """
        if self.follows:
            raise InputError(CHOSEN)
        dt = self.dt if dt is None else dt
        substeps = self.substeps if substeps is None else substeps
        self._change_step(*checked_step(dt, substeps))
        self.storage.set_numbers(self._numbers())

    def _change_step(self, dt: float, substeps: int) -> None:
        """Go on counting with another step; the device learns of it by `_numbers`."""
        self._since = self.frame, self.time, self.steps
        self.speed_limit *= self.dt / dt  # the same number of crossings in a frame
        self.dt, self.substeps = dt, substeps

    def _take_substeps(self, chosen: int) -> bool:
        changes = chosen != self.substeps
        if changes:
            self._change_step(self.dt, chosen)
        return changes

    def _numbers(self) -> Numbers:
        _, first_time, first_step = self._since
        return Numbers(
            dt=self.dt / self.substeps,
            speed_limit=self.speed_limit,
            tolerance=self.solver.get("tolerance", 0.0),
            iterations=int(self.solver.get("iterations", 0)),
            first_time=first_time,
            first_step=first_step,
        )

    # --- the state on the device -----------------------------------------------------------

    def _store(self, snapshot: Snapshot) -> None:
        """Put a state on the device; the first time, choose how it is run."""
        before = self.storage.state if self.storage.topology else None
        self._take_unsettled()
        self.storage.take(snapshot)
        if not self.execution:  # at the start, and under another method
            choice = autotune.choose(*self._requested, self._prediction())
            self._preferred, self.execution = choice.topology, choice.execution
            if self._widens and self._preferred == "lanes":
                self._widen(snapshot)
            self._watch = autotune.Watch(choice, self.substeps)
        self.storage.judge(self.time)
        self.storage.load(self._preferred, self.execution, self._numbers())
        self.topology = self.storage.topology  # the graph, while there is no regular grid
        self.storage.mark_new_springs(self.steps)
        if self._watch and before not in (None, self.storage.state):
            # The next launch compiles: what it takes is no loss by threads that wait.
            choice = autotune.choose(self.topology, self.execution, self._prediction())
            choice = replace(choice, forced=self._watch.choice.forced)
            self._watch = autotune.Watch(choice, self.substeps)

    def _take_unsettled(self) -> None:
        """Take over what the device has counted of unsettled steps: a load begins at 0."""
        if self.storage.topology:  # something was loaded
            self._unsettled += self.storage.take_unsettled()

    def _widen(self, start: Snapshot) -> None:
        """At the start: take sixteen lanes where they pay and earlier runs have compiled them."""
        self._widens = False
        accounts, what = self.storage.accounts_contacts, self.kind_of_run()
        wide = Storage(self._module, sixteen.LANES, self._launcher, start, accounts)
        pays = sixteen.pays(wide, self.method)
        if pays and sixteen.are_compiled(wide, what, self.execution):
            self._lanes, self._storage = sixteen.LANES, wide

    @act
    def load_as(self, topology: str, path: str, x: np.ndarray, v: np.ndarray) -> None:
        """Put all particles at x with v, (n, dim), stored in a topology, to be run on a path.

        The clock goes on, and springs stay as they were when last loaded.
        """
        accepted.word("topology", topology, TOPOLOGIES)
        accepted.word("path", path, PATHS)
        shape = self.particle_count, self.scene.world.dim
        x = accepted.array("load_as: x", x, shape, "particles, dimensions")
        v = accepted.array("load_as: v", v, shape, "particles, dimensions")
        pushed, held = self.storage.pushed, self.storage.held()
        self.storage.move(self.positions(), x, v)
        self.storage.judge(self.time)
        self._take_unsettled()
        self.storage.load(topology, path, self._numbers())
        self.storage.hold_again(held, pushed)
        self.topology, self.execution = self.storage.topology, path
        self._preferred = topology

    # --- clicks ----------------------------------------------------------------------------

    @act
    def spawn(
        self,
        position: ArrayLike,
        velocity: ArrayLike | None = None,
        *,
        fixed: bool = False,
        color: ArrayLike | None = None,
        tied_to: int | None = None,
        **numbers: float,
    ) -> int:
        """Add one particle with the scene's particle defaults; return its index.

        tied_to: index of a particle to tie it to with the scene's spring defaults. numbers: mass,
        radius and the others of `ParticleProperties`, where it has others than those. Raises
        InputError where the particle is outside the world or tied to one that does not exist, and
        for a number that particles do not have.
        """
        dim, defaults = (self.scene.world.dim,), self.scene.particle_defaults
        accepted.names("spawn", numbers, PARTICLE_PROPERTIES)
        position = accepted.array("spawn: position", position, dim, "one a dimension")
        if velocity is not None:
            velocity = accepted.array("spawn: velocity", velocity, dim, "one a dimension")
        fixed = accepted.flag("spawn: fixed", fixed)
        new = Particles.build(
            position, velocity, defaults=defaults, fixed=fixed, color=color, **numbers
        )
        if tied_to is not None:
            tied_to = accepted.whole_number("spawn: tied_to", tied_to)
            if tied_to >= self.particle_count:
                raise InputError(f"spawn: tied to particle {tied_to}, which does not exist")
        none = np.zeros((0, 3), np.int64)
        alone = replace(self.scene, particles=new, springs=Springs.none(), triangles=none)
        # It is the first of its scene, but not of the run.
        validate(replace(alone, stencils=Stencils.none()), place=lambda *_: "spawn")
        now = self.storage.snapshot()
        grown = now.with_particle(new, tied_to)
        with self._all_or_nothing(now):
            refuse_unholdable(grown.scene, self._launcher.device.precision, now.scene)
            if self._auto:
                self._take_substeps(self._auto.for_state(grown))
            self._store(grown)
        return self.particle_count - 1

    def prepare_clicks(self) -> None:
        """Compile what the pointer's first motion, click or step back needs, if that is not done.

        A window calls it before a frame that compiles. It changes nothing of the state.
        """
        if not self._ready:
            self._ready = True
            self.storage.prepare_clicks()

    # --- changes while it runs: see `Changes` ------------------------------------------------

    def _edit(
        self,
        now: Snapshot,
        edited: Snapshot,
        left: np.ndarray | None = None,
        topology: str | None = None,
    ) -> None:
        """Go on from an edited state; left: which of the particles are left, all where absent.

        topology: in which it is stored from now on; absent: as it is.
        InputError where the device or dt "auto" refuses it; all is then as it was.
        """
        if left is None and same(now, edited):
            return
        with self._all_or_nothing(now, left):
            self._preferred = topology or self._preferred
            refuse_unholdable(edited.scene, self._launcher.device.precision, now.scene)
            if self._auto:
                self._take_substeps(self._auto.after_edit(now, edited))
            if self.storage.change_particles(now, edited, self._numbers(), self.time):
                self.storage.mark_new_springs(self.steps)
            else:
                self._store(edited)

    @contextmanager
    def _all_or_nothing(self, now: Snapshot, left: np.ndarray | None = None) -> Iterator[None]:
        """All is as it was, with the state `now`, where what is done within raises InputError.

        A push that acts goes on; left: on which of the particles, all where absent.
        """
        pushed, held = self.storage.pushed, self.storage.held()
        with self._undone_if_refused(now):
            yield
        self.storage.hold_again(held if held is None or left is None else held[left], pushed)

    @contextmanager
    def _undone_if_refused(self, now: Snapshot) -> Iterator[None]:
        """All is as it was, with the state `now`, where what is done within raises InputError."""
        clock = self._since, self.dt, self.substeps, self.speed_limit
        auto, preferred = copy.copy(self._auto), self._preferred
        pushed, held = self.storage.pushed, self.storage.held()
        try:
            yield
        except InputError:
            self._since, self.dt, self.substeps, self.speed_limit = clock
            self._auto, self._preferred = auto, preferred
            self._store(now)
            self.storage.hold_again(held, pushed)
            raise
