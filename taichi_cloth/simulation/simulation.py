"""A scene in motion: scene + method -> advance, spawn, blow, read back, watchdog."""

from __future__ import annotations

import math
import time
import weakref
from dataclasses import replace

import numpy as np
import taichi as ti

from taichi_cloth.errors import InputError, SimulationFailure, nearest
from taichi_cloth.kernels import forces, fracture, methods, transfer, watchdog
from taichi_cloth.kernels.forces import blow as pointer
from taichi_cloth.kernels.solvers import newton_cg
from taichi_cloth.kernels.specialization import Specialization
from taichi_cloth.kernels.spring_numbers import NUMBERS
from taichi_cloth.kernels.state import (
    ALIVE,
    BREAKING,
    CELLS_PER_PARTICLE,
    GONE,
    WORK,
    Capacity,
    State,
    device_fields,
)
from taichi_cloth.limits.auto_step import SubstepController, substeps_needed
from taichi_cloth.limits.bounds import any_geometry, gershgorin, step_within
from taichi_cloth.limits.network import Network
from taichi_cloth.runtime import current_device, still_runs
from taichi_cloth.scene.checks import validate
from taichi_cloth.scene.model import Particles, Scene, Springs
from taichi_cloth.settings.options import SOLVER_SETTINGS, TOPOLOGIES
from taichi_cloth.simulation import adjacency, diagnostics, execution, layouts

BLOW_REACH = 50.0  # world units from the pointer at which its force ends
BLOW_STRENGTH = 0.002  # force per unit of displacement and of distance short of the reach
# A particle that would cross the world this many times in one frame is lost, not fast.
RUNAWAY_CROSSINGS = 100.0
# Particles and springs times steps in one launch: some tenths of a second, so that Ctrl-C is heard.
LAUNCH_WORK = 20_000_000
# Of a loop in a shader: Mesa's drivers leave one after 65535 iterations, and say nothing.
MOST_ITERATIONS = 65_000
SPAWN_CAPACITY = 256  # room for clicks before the fields must grow
# Particles in a cell on CPUs: 8 fill the widest vectors there are in f64, half of one in f32, where
# 16 are faster only on large cloths and take three times as long to compile; docs/speed.md.
LANES = 8


class Simulation:
    """One scene, integrated by one method on the device that `runtime.start` started.

    scene: validated here (InputError). method: a name out of `kernels.methods.METHODS`.
    dt: time of a frame, the scene's own when absent; substeps: steps a frame is cut into. With
    dt "auto" a frame is the scene's, cut into as many as its springs need (`following.py`).
    execution: "serial" (on one thread) or "parallel" (on all threads, or a GPU).
    topology: "lanes" (the regular grids among the springs without index lists, in cells of several
    particles; the rest on the graph), or "graph" (all springs by lists of neighbours).
    "auto" is, for both, what measured fastest on this machine for such a scene.
    lanes: particles in a cell of that topology; LANES on CPUs and 1 on GPUs where absent.
    tolerance: relative residual of a step's solution, of methods that solve for it; iterations:
    sweeps a step, of methods that iterate (`options.SOLVER_SETTINGS` where absent). InputError for
    a method that does not take it.

    Arrays are returned as float64 copies, one row per particle in the order of creation.
    """

    def __init__(
        self,
        scene: Scene,
        method: str = "symplectic_euler",
        dt: float | str | None = None,
        substeps: int = 1,
        execution: str = "auto",
        topology: str = "auto",
        lanes: int | None = None,
        tolerance: float | None = None,
        iterations: int | None = None,
    ):
        if method not in methods.METHODS:
            raise InputError(f"--method {method}: unknown; {nearest(method, methods.METHODS)}")
        follows = dt == "auto"
        if follows and substeps != 1:
            raise InputError("--substeps: --dt auto chooses them; give one of the two")
        dt, substeps = _checked_step(scene.world.dt if dt is None or follows else dt, substeps)
        self.scene = validate(scene)
        self.method, self.dt, self.substeps = method, dt, substeps
        device = current_device()
        self._module = methods.load(method)
        self._needs = self._module.needs
        self.claims = self._module.claims
        self.solver = _solver_settings(method, self.claims, tolerance, iterations)
        self._follower = SubstepController(method, self._module, dt) if follows else None
        self._real = getattr(ti, device.real)
        self._numpy_real = np.float64 if device.real == "f64" else np.float32
        self._requested = topology, execution
        most = min(LANES, self._module.lanes or LANES)
        self._lanes = lanes or (most if device.arch == "cpu" else 1)
        self._drawn = np.zeros((0, 0))
        self._layouts = {}  # by topology, until something is spawned or reset
        self.topology = self.execution = self._pace = None
        self.speed_limit = _runaway_speed(scene, dt)
        self.reset()

    def load_scene(self, scene: Scene, dt: float | None = None, substeps: int = 1) -> None:
        """Take another scene, from its start; method, settings, topology and execution stay.

        Nothing is compiled anew for a scene that fits: of the same dimension, walls, collisions and
        grids, without features, particles or springs beyond those there were. What it lacks of
        these features stays compiled, without effect.
        dt, substeps: as in the constructor, but chosen by the simulation with dt "auto".
        """
        if self.follows and not (dt is None and substeps == 1):
            raise InputError("--dt auto chooses the step; it cannot be set")
        dt, substeps = _checked_step(scene.world.dt if dt is None else dt, substeps)
        self.scene = validate(scene)
        self.dt, self.substeps = dt, substeps
        if self.follows:
            self._follower = SubstepController(self.method, self._module, dt)
        self.speed_limit = _runaway_speed(scene, dt)
        self.reset()

    # --- advancing -------------------------------------------------------------------------

    def reset(self) -> None:
        """Back to the scene's start; what was spawned is gone."""
        self.frame = 0
        self._work = np.zeros(len(WORK), np.int64)
        self._since = 0, 0.0, 0  # frame, time and steps when the step last changed
        self._blowing = False
        self._particles, self._springs = self.scene.particles, self.scene.springs
        self._fracture = np.tile(np.int32([ALIVE, 0]), (len(self._springs), 1))
        if self._follower:
            self._follower.reset()
            self._choose_substeps(self._particles, self._springs, self._fracture)
        self._load(self._particles.position, self._particles.velocity)

    def advance(self, frames: int = 1) -> None:
        """Advance by whole frames.

        Raises SimulationFailure when a particle is no longer finite or runs away; the state is
        then that of the last good frame, and can be read, drawn and saved.
        """
        while frames > 0:
            # A push lasts one frame; without one, frames can share a launch.
            following = self._follower and self._plan.fracture
            batch = 1 if self._blowing or following else min(frames, self._frames_per_launch())
            passed = self._run(batch)
            self.frame += passed
            if passed < batch:
                self._fail(watchdog.last_fault(self._state))
            if self._blowing:
                pointer.clear_push(self._state)
                self._blowing, self._changed = False, True
            if following:
                self._follow()
            frames -= batch

    def _frames_per_launch(self):
        work = self.substeps * max(self.particle_count + self.spring_count, 1)
        frames = LAUNCH_WORK // work
        if current_device().arch != "cpu":
            frames = min(frames, MOST_ITERATIONS // self.substeps)
        return max(1, frames)

    def _run(self, frames):
        begin = time.perf_counter()
        if self._changed:
            execution.run_begin(self._module, self._spread_plan, self._state)
        self._changed = False
        passed = execution.run_frames(
            self._module,
            self._plan,
            self._state,
            self.steps,
            frames,
            self.substeps,
        )
        if self.claims.forces == 0:
            work = np.zeros(len(WORK), np.int32)
            transfer.take_work(self._state, work)
            self._work += work
        if self._pace and self._pace.lost(time.perf_counter() - begin, frames * self.substeps):
            self.execution, self._pace = "serial", None
            self._plan = self._plan_for("serial")
        return passed

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
        """Whether it chooses its substeps by itself (dt "auto")."""
        return self._follower is not None

    def set_step(self, dt: float | None = None, substeps: int | None = None) -> None:
        """From now on take frames of `dt`, in `substeps` steps each; absent: as they are.

        InputError where one is not positive, or with dt "auto".
        """
        if self.follows:
            raise InputError("--dt auto chooses the step; it cannot be set")
        dt = self.dt if dt is None else dt
        substeps = self.substeps if substeps is None else substeps
        self._change_step(*_checked_step(dt, substeps))

    def _change_step(self, dt, substeps):
        self._since = self.frame, self.time, self.steps
        same = math.isclose(dt / substeps, self.dt / self.substeps, rel_tol=1e-12)
        # The same number of crossings in a frame.
        self.speed_limit *= self.dt / dt
        self.dt, self.substeps = dt, substeps
        if getattr(self, "_state", None) is not None:
            self._load_numbers()
            if not same:
                self._changed = True  # what a method keeps may depend on the step

    def network(self) -> Network:
        """The particles where they are, and the springs that pull."""
        holds = self._read_fracture()[:, 0] != GONE
        return Network.from_scene(self._present_scene(), self.positions(), holds)

    def work(self) -> diagnostics.Work:
        """What has been done since the start, or since `reset`."""
        forces, sweeps, unconverged = (int(count) for count in self._work)
        forces = self.steps * self.claims.forces or forces
        return diagnostics.Work(self.steps, forces, sweeps, unconverged)

    def solution(self) -> diagnostics.Solution:
        """How the last step was solved; InputError where the method has no tolerance to meet."""
        if "tolerance" not in self.claims.settings:
            raise InputError(f"{self.method} solves no equations to a tolerance")
        state = self._state
        numbers = {
            name: getattr(state, name)[None]
            for name in ("residual_max", "residual_rms", "scale", "directions", "sweeps")
        }
        outcome = state.outcome[None]
        converged = outcome in (newton_cg.CONVERGED, newton_cg.ROUNDED)
        return diagnostics.Solution(newton_cg.OUTCOMES[outcome], converged, **numbers)

    def describe_size(self) -> str:
        """What decides a step's cost besides the device: features, and sizes by powers of two."""
        sizes = self.particle_count.bit_length(), self.spring_count.bit_length()
        return f"{forces.describe(self._present_scene())}; 2^{sizes[0]} particles, 2^{sizes[1]} springs"

    def set_speed_limit(self, limit: float) -> None:
        """The speed above which the watchdog says that a particle runs away (world units/time)."""
        self.speed_limit = float(limit)
        self._load_numbers()

    # --- interaction -----------------------------------------------------------------------

    def blow(self, pointer, displacement) -> None:
        """Blow on particles near `pointer` (2-D, world units) through the next frame.

        displacement: how far the pointer moved since the last frame. A scene whose mouse does not
        blow refuses with InputError.
        """
        self._push(pointer, np.zeros(2), displacement)

    def blow_ray(self, origin, direction, displacement) -> None:
        """The same in 3-D, near the line through `origin` along `direction`, all (3,)."""
        direction = np.asarray(direction, np.float64)
        self._push(origin, direction / np.linalg.norm(direction), displacement)

    def spawn(self, position, velocity=None, *, fixed=False, color=None, tied_to=None) -> int:
        """Add one particle with the scene's particle defaults; return its index.

        tied_to: index of a particle to tie it to with the scene's spring defaults. Raises
        InputError where the particle is outside the world or tied to one that does not exist.
        """
        new = Particles.build(
            position,
            velocity,
            defaults=self.scene.particle_defaults,
            fixed=fixed,
            color=color,
        )
        if tied_to is not None and not 0 <= tied_to < self.particle_count:
            raise InputError(f"spawn: tied to particle {tied_to}, which does not exist")
        validate(replace(self.scene, particles=new, springs=Springs.none()))
        index = self.particle_count
        x = np.concatenate([self.positions(), new.position])
        v = np.concatenate([self.velocities(), new.velocity])
        particles, springs = self._particles.joined(new), self._springs
        marks = self._read_fracture()
        if tied_to is not None:
            tie = Springs.build([[tied_to, index]], x, defaults=self.scene.spring_defaults)
            springs = springs.joined(tie)
            marks = np.concatenate([marks, np.int32([[ALIVE, 0]])])
        if self._follower:  # before anything changes: it may refuse
            self._choose_substeps(particles, springs, marks)
        self._particles, self._springs, self._fracture = particles, springs, marks
        self._load(x, v)
        return index

    def hold(self, force) -> None:
        """Push every particle with a constant force of its own, (n, dim), until the next push.

        A scene whose mouse does not blow refuses with InputError, as it does for `blow`.
        """
        self._check_blows()
        rows = self._as_real("particle", force)
        pointer.hold_push(self._spread_plan, self._state, rows)
        self._changed = True

    # --- following the springs -------------------------------------------------------------

    def _choose_substeps(self, particles, springs, marks):
        """Substeps for these particles and springs, of which some may be gone."""
        holds = marks[:, 0] != GONE
        self._broken_before, self._breaking = int((marks[:, 0] != ALIVE).sum()), True
        chosen = self._follower.choose(
            Network.from_scene(
                replace(self.scene, particles=particles, springs=springs), holds=holds
            )
        )
        if chosen != self.substeps:
            self._change_step(self.dt, chosen)

    def _follow(self):
        """After a frame: fewer substeps, where springs that broke leave slower ones.

        What breaks in a frame may pull in the next one, so the frame after is looked at, too.
        """
        broken = transfer.count_broken(self._spread_plan, self._state)
        changed = broken != self._broken_before
        if changed or self._breaking:
            self._broken_before, self._breaking = broken, changed
            holds = self._read_fracture()[:, 0] != GONE
            network = Network.from_scene(self._present_scene(), holds=holds)
            chosen = self._follower.choose_after_breaks(network)
            if chosen != self.substeps:
                self._change_step(self.dt, chosen)

    # --- reading back ----------------------------------------------------------------------

    @property
    def particle_count(self) -> int:
        return len(self._particles)

    @property
    def spring_count(self) -> int:
        return len(self._springs)

    def positions(self) -> np.ndarray:
        """Positions, (n, dim)."""
        return self._read_with_low("x")

    def velocities(self) -> np.ndarray:
        """Velocities, (n, dim)."""
        return self._read_with_low("v")

    def radii(self) -> np.ndarray:
        """Radii, (n,)."""
        return self._particles.radius

    def colors(self) -> np.ndarray:
        """Colours, (n, 3) uint8."""
        return self._particles.color

    def springs(self) -> np.ndarray:
        """The particles each spring ties, (s, 2), broken springs included."""
        return self._springs.between

    def springs_alive(self) -> np.ndarray:
        """Which springs hold, (s,) bool: those whose force has not exceeded their break force."""
        return self._read_fracture()[:, 0] == ALIVE

    def drawn_positions(self) -> np.ndarray:
        """Positions for a window, (n, dim) in the device's precision.

        Without a copy: the next call fills the same array anew.
        """
        shape = self.particle_count, self.scene.world.dim
        if self._drawn.shape != shape:
            self._drawn = np.zeros(shape, self._numpy_real)
        if len(self._drawn):
            transfer.read_vectors(self._spread_plan, self._state, self._state.x, self._drawn)
        return self._drawn

    def drawn_springs(self) -> np.ndarray:
        """The particles that each spring that holds ties, (alive, 2).

        The same array until a spring breaks, comes or is whole again: all that the device is asked
        for at every frame is how many are broken.
        """
        broken = transfer.count_broken(self._spread_plan, self._state) if self._plan.fracture else 0
        if self._drawn_springs is None or broken != self._broken:
            self._broken, self._drawn_springs = broken, self.springs()[self.springs_alive()]
        return self._drawn_springs

    def energy(self) -> diagnostics.Energy:
        """Kinetic, gravitational and elastic energy."""
        x, v = self.positions(), self.velocities()
        particles, springs = self._particles, self._springs
        return diagnostics.energy(
            x,
            v,
            particles.mass,
            particles.fixed,
            self.scene.world.gravity,
            springs.between,
            springs.stiffness,
            springs.rest_length,
            self._read_fracture()[:, 0] != GONE,
        )

    def momentum(self) -> np.ndarray:
        """Total momentum of the free particles, (dim,)."""
        return diagnostics.momentum(self.velocities(), self._particles.mass, self._particles.fixed)

    # --- loading the device ----------------------------------------------------------------

    def _present_scene(self):
        return replace(self.scene, particles=self._particles, springs=self._springs)

    def _features(self):
        return replace(self.scene, particles=self._particles, springs=self._springs).features()

    def _load(self, x, v):
        """Put the whole state on the device: positions, velocities, and all else as it is here."""
        self._layouts.clear()
        if self.execution is None:
            choice = execution.choose(*self._requested, self, x, v)
            self.topology, self.execution = choice.topology, choice.execution
            self._pace = Pace(choice.alone) if choice.execution == "parallel" else None
        self.load_as(self.topology, self.execution, x, v)
        if self._plan.fracture:
            fracture.mark_new_springs(self._spread_plan, self._state)

    def topologies(self) -> list[str]:
        """The topologies that this scene can be stored in."""
        return [name for name in TOPOLOGIES if self._lay_out(name) is not None]

    def load_as(self, topology: str, path: str, x, v) -> None:
        """Store the state in a topology, to be run on a path; for `execution` to measure both."""
        self._layout = self._lay_out(topology)
        if self._layout is None:  # what was spawned may have undone the last grid
            self.topology = topology = "graph"
            self._layout = self._lay_out(topology)
        self._links = np.flatnonzero(self._layout.kind >= 0)  # the springs that are links of grids
        kind, owner = self._layout.kind[self._links], self._layout.owner[self._links]
        self._link_places = np.column_stack([kind, owner]).astype(np.int32)
        self._drawn_springs = None
        self._on_graph, self._colours = self._sorted_springs()
        self._make_room(topology)
        self._plan = self._plan_for(path)
        self._load_numbers()
        self._load_particles(x, v)
        if self._plan.springs:
            self._load_springs()
        if self._plan.links:
            self._load_links()
        if "blow" in self._plan.terms and not self._blowing:
            pointer.clear_push(self._state)
        self._changed = True  # from outside, so that forces must be computed anew

    def timed_frame(self):
        """Run one frame, for `execution` to time; the state must be loaded anew afterwards."""
        self._run(1)

    def _lay_out(self, topology):
        """The layout in a topology, None where there is none."""
        if topology not in self._layouts:
            self._layouts[topology] = self._find_layout(topology)
        return self._layouts[topology]

    def _find_layout(self, topology):
        if topology == "graph":
            # Collisions add up in the order of the particles, which is then that of memory too.
            position = None if self.scene.world.collisions else self._particles.position
            return layouts.on_graph(self._springs, position, self.particle_count)
        period = layouts.any_period
        if "spring_colours" in self._needs:
            period = layouts.spring_period
        elif "particle_colours" in self._needs:
            period = layouts.particle_period
        return layouts.on_grids(self._springs, self.particle_count, self._lanes, period)

    def _sorted_springs(self):
        """The springs that no grid holds, in the order in which the device has them: (numbers,
        colours); those of one colour together where the method wants it.
        """
        springs = np.flatnonzero(self._layout.kind < 0)
        if "spring_colours" not in self._needs:
            return springs, np.zeros(len(springs), np.int64)
        grids = self._lay_out("lanes")
        colour = layouts.spring_colours(self._springs, grids, self.particle_count)[springs]
        # In the order of memory within a colour.
        near = self._layout.slot[self._springs.between[springs]].min(axis=1)
        order = np.lexsort((near, colour))
        return springs[order], colour[order]

    def _plan_for(self, path):
        """What to compile for a path: its threads, or loops that Taichi spreads."""
        device, plan = current_device(), self._spread_plan
        return replace(
            plan,
            threads=1 if path == "serial" else device.threads,
            one_launch_per_step=path == "parallel" and (device.arch != "cpu" or plan.collisions),
        )

    def _make_room(self, topology):
        """See that there is a container that fits particles, springs and plan; empty if new.

        A new container compiles every kernel again, so it is made with room to spare.
        """
        features = dict(vars(self._features()))
        spawns = self.scene.world.mouse == "spawn"
        features["springs"] &= spawns or len(self._on_graph) > 0
        self._spread_plan = plan = Specialization(
            **features,
            terms=forces.present_in(
                replace(self.scene, particles=self._particles, springs=self._springs)
            ),
            lanes=self._layout.lanes,
            links=self._layout.links,
            rows_share_stiffness=self._layout.rows_share_stiffness and not features["fracture"],
            compensated=current_device().compensated,
            threads=current_device().threads,
            one_launch_per_step=True,
        )
        needed = Capacity(
            particles=self.particle_count,
            springs=len(self._on_graph),
            packs=self._layout.n_packs,
            grids=len(self._layout.grid),
            row=self._layout.row,
        )
        state = getattr(self, "_state", None)
        factor = 1
        if state is not None:
            stored, of = self._stored
            same = of == topology and stored.can_run(plan)
            if same and state.capacity.holds(needed):
                self._spread_plan = stored
                return
            factor = 2 if same else 1
            self._free()
        room = SPAWN_CAPACITY if self.scene.world.mouse == "spawn" else 0
        self._stored = plan, topology
        capacity = replace(
            needed,
            particles=factor * needed.particles + room,
            springs=factor * needed.springs + room,
            packs=factor * needed.packs + room,
        )
        self._state = State(plan, self._real, capacity, self._module)
        # Taichi has room for 512 trees of fields, of which each state takes two.
        self._free = weakref.finalize(self, _free, self._state, current_device())
        self._free.atexit = False

    def _load_numbers(self):
        """Put the numbers of the scene and the run on the device: by name, in its order."""
        world, particles, state = self.scene.world, self._particles, self._state
        grid_size, cell_size = self._grid(particles)
        values = {
            "n": self.particle_count,
            "iterations": self.solver.get("iterations", 0),
            "grid_size": grid_size,
            "dt": self.dt / self.substeps,
            "speed_limit": self.speed_limit,
            "tolerance": self.solver.get("tolerance", 0.0),
            "cell_size": cell_size,
            "one": 1.0,
            "low": world.low,
            "high": world.high,
        }
        for field in device_fields(self._spread_plan):
            if field.value and field.name in (*state.number_names, *state.count_names):
                values[field.name] = field.value(world, particles)
        counts, numbers = (
            np.concatenate([np.ravel(values[name]) for name in names])
            for names in (state.count_names, state.number_names)
        )
        transfer.load_numbers(state, counts.astype(np.int32), numbers.astype(self._numpy_real))

    def _grid(self, particles):
        """Cells per axis and their width, the largest diameter, for the collision grid.

        The grid wraps around, so where the world has more cells than the container holds, it is
        made smaller in proportion: far particles then share a cell, at the cost of comparisons.
        """
        size = np.array(self.scene.world.size)
        width = 2.0 * float(particles.radius.max(initial=0.0)) or float(size.max())
        cells = np.ceil(size / width) + 1
        capacity = CELLS_PER_PARTICLE * max(len(particles), 1) + 64
        while cells.prod() > capacity:
            cells = np.maximum(3, np.floor(cells * 0.97))
        return [int(max(3, c)) for c in cells], width

    def _load_particles(self, x, v):
        p, layout = self._particles, self._layout
        transfer.load_packs(
            self._spread_plan, self._state, layout.n_packs, layout.grid, layout.grid_of
        )
        if len(p) == 0:
            return  # a kernel takes no empty array
        with np.errstate(all="ignore"):
            w = np.where(p.fixed, 0.0, 1.0 / p.mass)
        v = np.where(p.fixed[:, None], 0.0, v)  # a fixed particle never moves
        values = {"x": x, "v": v, "w": w, "radius": p.radius, "restitution": p.restitution}
        if self._spread_plan.compensated:
            values |= {"x_low": self._low(x), "v_low": self._low(v)}
        state = self._state
        names = (*state.vector_names, *state.particle_names)
        for field in device_fields(self._spread_plan):
            if field.value and field.name in names:
                values[field.name] = field.value(self.scene.world, p)
        rows = self._as_real("particle", *(values[name] for name in names))
        vanished = (w > 0) & (rows[:, len(state.vector_names) * x.shape[1]] == 0)
        if vanished.any():
            self._refuse_size("particle", vanished.argmax())
        transfer.load_particles(self._spread_plan, self._state, layout.slot, rows)
        if "summed_springs" in self._needs:
            self._load_near()
        if self._plan.halo and "spring_colours" in self._needs:
            transfer.load_halo_numbers(self._spread_plan, self._state)

    def _load_near(self):
        """Sums of the stiffness and damping of each particle's springs."""
        springs = self._springs.select(self._fracture[:, 0] != GONE)
        rows = np.column_stack(
            [
                np.bincount(springs.between.ravel(), np.repeat(of, 2), self.particle_count)
                for of in (springs.stiffness, springs.damping)
            ]
        )
        rows = rows.astype(self._numpy_real)
        transfer.load_summed_springs(self._spread_plan, self._state, self._layout.slot, rows)

    def _low(self, values):
        """What the device's precision cannot hold of values."""
        with np.errstate(all="ignore"):
            low = values - values.astype(self._numpy_real)
        return np.where(np.isfinite(low), low, 0.0)  # `values` themselves are refused

    def _as_real(self, what, *columns):
        """Columns side by side in the device's precision; InputError where one does not fit."""
        with np.errstate(all="ignore"):
            rows = np.column_stack(columns).astype(self._numpy_real)
        if not np.isfinite(rows).all():
            self._refuse_size(what, np.isfinite(rows).all(axis=1).argmin())
        return rows

    def _refuse_size(self, what, index):
        wider = "; use --precision f64" if self._numpy_real is np.float32 else ""
        raise InputError(
            f"{what} {index} has a number too large or too small for "
            f"{self._numpy_real.__name__}{wider} or other units"
        )

    def _load_springs(self):
        """The springs that are on the graph, as rows of half-springs."""
        site = self._layout.slot
        springs, marks = self._springs.select(self._on_graph), self._fracture[self._on_graph]
        sites = self._layout.n_packs * self._layout.lanes
        half = adjacency.half_springs(site[springs.between], sites)
        near, row = np.arange(sites), half.row
        if self._plan.links:  # only those that have any
            near = np.flatnonzero(np.diff(half.row))
            row = np.append(half.row[near], len(half.far))
        far = np.where(marks[half.spring, 0] == GONE, half.near, half.far)
        numbers = self._as_real("spring", *(getattr(springs, n.column) for n in NUMBERS))
        break_length2 = layouts.break_length2(springs).astype(self._numpy_real)
        if self._plan.uniform_springs:
            numbers, break_length2 = numbers[:1], break_length2[:1]
        if "spring_colours" in self._needs:
            self._load_colours(site[springs.between], numbers)
        if not self._plan.uniform_springs:
            numbers = numbers[half.spring]
        transfer.load_half_springs(
            self._state,
            _not_empty(near.astype(np.int32)),
            row.astype(np.int32),
            _not_empty(far.astype(np.int32)),
            len(near),
            len(far),
        )
        if "particle_colours" in self._needs:
            self._load_particle_colours(near)
        if len(springs):
            transfer.load_spring_numbers(self._plan, self._state, numbers)
        if self._plan.fracture:
            ends = site[springs.between]
            indices = np.column_stack([ends, half.half, marks]).astype(np.int32)
            transfer.load_springs(
                self._spread_plan,
                self._state,
                len(springs),
                _not_empty(indices),
                _not_empty(break_length2),
            )

    def _load_colours(self, ends, numbers):
        """The same springs one by one, by colour."""
        start = _starts(self._colours)
        transfer.load_colours(
            self._spread_plan,
            self._state,
            len(start) - 1,
            start,
            _not_empty(ends),
            _not_empty(numbers),
        )

    def _load_particle_colours(self, near):
        """The particles at the sites `near`, which have springs on the graph, by colour."""
        grids = self._lay_out("lanes")
        colour = np.full(self._layout.n_packs * self._layout.lanes, -1)
        of_particles = layouts.particle_colours(self._springs, grids, self.particle_count)
        colour[self._layout.slot] = of_particles
        colour = colour[near]
        order = np.argsort(colour, kind="stable")
        order = order[colour[order] >= 0]
        start = _starts(colour[order])
        transfer.load_particle_colours(
            self._spread_plan,
            self._state,
            len(start) - 1,
            start,
            _not_empty(order.astype(np.int32)),
        )

    def _load_links(self):
        """The springs that are links of grids."""
        layout, springs = self._layout, self._springs
        shared = {"rest": layout.rest_length, "c": layout.damping}
        none = np.zeros_like(layout.rest_length)
        numbers = [shared.get(number.letter, none) for number in NUMBERS]
        numbers = np.stack([*numbers, layout.break_length2], axis=2)
        # The largest number instead of infinity, which f32 kernels may assume not to occur.
        numbers = np.minimum(numbers, np.finfo(self._numpy_real).max).astype(self._numpy_real)
        own = self._as_real("spring", *(getattr(springs, n.column) for n in NUMBERS))[self._links]
        links = np.column_stack([self._link_places, self._fracture[self._links]])
        transfer.load_links(self._spread_plan, self._state, numbers, links, own)

    def _check_blows(self):
        if self.scene.world.mouse != "blow":
            raise InputError(
                f"scene '{self.scene.name}': the mouse does not blow here "
                f"([world] mouse is '{self.scene.world.mouse}'; set it to 'blow')"
            )

    def _push(self, origin, direction, displacement):
        self._check_blows()
        numbers = np.concatenate([origin, direction, displacement, [BLOW_REACH, BLOW_STRENGTH]])
        pointer.compute_push(self._spread_plan, self._state, numbers.astype(self._numpy_real))
        self._blowing = self._changed = True

    # --- reading the device ----------------------------------------------------------------

    def _read(self, of):
        """The vectors of a field of cells, (n, dim) float64."""
        out = np.zeros((self.particle_count, self.scene.world.dim), self._numpy_real)
        if len(out):
            transfer.read_vectors(self._spread_plan, self._state, of, out)
        return out.astype(np.float64)

    def _read_with_low(self, name):
        """Positions or velocities, with their low parts where they have any."""
        value = self._read(getattr(self._state, name))
        if self._plan.compensated:
            value += self._read(getattr(self._state, f"{name}_low"))
        return value

    def _read_fracture(self):
        """Status and break step of every spring, (s, 2) int32."""
        if not self._plan.fracture or self.spring_count == 0:
            return self._fracture
        out = self._fracture.copy()
        if len(self._on_graph):
            part = np.zeros((len(self._on_graph), 2), np.int32)
            transfer.read_fracture(self._state, part)
            out[self._on_graph] = part
        if self._plan.links:
            part = np.zeros((len(self._links), 2), np.int32)
            transfer.read_link_fracture(self._spread_plan, self._state, self._link_places, part)
            out[self._links] = part
        return out

    # --- failure ---------------------------------------------------------------------------

    def _fail(self, particle):
        """Put the last good frame back, and say who failed, why, and what to change."""
        bad_x, bad_v = self.positions(), self.velocities()
        frame, good_step = self.frame + 1, self.steps
        watchdog.restore(self._spread_plan, self._state)
        self._changed = True
        if self._plan.fracture:
            status, step = self._read_fracture().T
            status[step > good_step] = ALIVE
            status[(step == good_step) & (status == GONE)] = BREAKING
            self._fracture = np.column_stack([status, np.where(status == ALIVE, 0, step)])
            self.load_as(self.topology, self.execution, self.positions(), self.velocities())
        finite = np.isfinite(bad_x[particle]).all() and np.isfinite(bad_v[particle]).all()
        if finite:
            speed = float(np.linalg.norm(bad_v[particle]))
            what = f"runs away at speed {speed:.3g} (limit {self.speed_limit:.3g})"
        else:
            what = "has a position or velocity that is not a finite number"
        raise SimulationFailure(particle, frame, what, *self._likely_cause())

    def _likely_cause(self):
        """(cause, remedy) of a failure: the step against the method's limit in any geometry."""
        network, method = self.network(), methods.load(self.method)
        bounds = gershgorin(network)
        dt, limit = self.dt / self.substeps, step_within(method, bounds)
        if limit == 0 and math.isfinite(bounds.omega2):
            which = "undamped springs"
            if bounds.damping > 0:
                which = "springs that dashpots damp along their axis alone"
            return (
                f"{self.method} is unstable on {which} at every dt",
                "use --method symplectic_euler",
            )
        if not math.isfinite(bounds.omega2):
            return f"springs too stiff for {self._numpy_real.__name__}", "use softer springs"
        if dt > limit > 0:  # by Gershgorin; look closer
            bounds = any_geometry(network)
            limit = step_within(method, bounds)
        if not dt > limit:
            return "forces or starting speeds too large for the step", "use more --substeps"
        needed = f"use --substeps {substeps_needed(self.dt, limit)}"
        drag = float((self._particles.viscous / self._particles.mass)[bounds.damped])
        # What the step has too much of: the springs' part in it, and that of damping.
        stiff, viscid = dt * dt * bounds.omega2, 2.0 * dt * bounds.damping
        if bounds.damping > drag and viscid > 0.1 * stiff:
            return (
                f"a step of {dt:.3g} is too long for the springs' dashpots at particle "
                f"{bounds.damped}",
                f"{needed}, a smaller --dt, or less damping",
            )
        if viscid > stiff:
            return (
                f"a step of {dt:.3g} is above {limit:.3g}, the stable limit of the "
                f"drag on particle {bounds.damped}",
                f"{needed} or a smaller --dt",
            )
        return (
            f"a step of {dt:.3g} is above {limit:.3g}, the stable limit of "
            f"{self.method} (set by the springs at particle {bounds.particle})",
            f"{needed}, a smaller --dt, or softer springs",
        )


def _checked_step(dt, substeps):
    """(dt, substeps), if there can be such steps; else InputError."""
    dt = float(dt)
    if not (math.isfinite(dt) and dt > 0):
        raise InputError(f"--dt {dt}: must be a positive number")
    if substeps < 1:
        raise InputError(f"--substeps {substeps}: must be at least 1")
    return dt, substeps


def _runaway_speed(scene, dt):
    return RUNAWAY_CROSSINGS * float(np.linalg.norm(scene.world.size)) / dt


def _solver_settings(method, claims, tolerance, iterations):
    """The settings that a method takes, by name; InputError for one that it does not."""
    given = {"tolerance": tolerance, "iterations": iterations}
    for name, value in given.items():
        if value is None:
            continue
        if name not in claims.settings:
            takers = [m for m in methods.METHODS if name in methods.load(m).claims.settings]
            raise InputError(f"--{name}: {method} does not take it; {', '.join(takers)} do")
        if not value > 0:
            raise InputError(f"--{name} {value}: must be positive")
    chosen = {name: value for name, value in given.items() if value is not None}
    return {name: chosen.get(name, SOLVER_SETTINGS[name]) for name in claims.settings}


class Pace:
    """Whether all threads together are slower than one alone would be.

    They wait for each other several times a step, so where other programs want the cores they may
    be. Both ways give the same bits, so a run may change over.

    alone: seconds a step takes on one thread; None: not known, and never lost.
    """

    PATIENCE = 0.3  # seconds that are looked at together
    SLOWER = 1.5  # times slower than alone

    def __init__(self, alone: float | None):
        self.alone = alone
        self._seconds = self._steps = None  # the first launch compiles, and does not count

    def lost(self, seconds: float, steps: int) -> bool:
        """Note a launch; True when it is time to change over."""
        if self.alone is None:
            return False
        if self._steps is None:
            self._seconds, self._steps = 0.0, 0
            return False
        self._seconds, self._steps = self._seconds + seconds, self._steps + steps
        if self._seconds < self.PATIENCE:
            return False
        slow = self._seconds > self.SLOWER * self.alone * self._steps
        self._seconds, self._steps = 0.0, 0
        return slow


def _free(state, device):
    """Give the memory of a state back, unless Taichi was started anew since, or cannot (OpenGL)."""
    if still_runs(device) and device.arch != "opengl":
        state.free()


def _starts(colours):
    """Where each colour begins in a sorted array, and its end; colours that nothing has are no
    colours.
    """
    start = np.flatnonzero(np.diff(colours, prepend=-1))
    return np.append(start, len(colours)).astype(np.int32)


def _not_empty(array):
    """The array, or one row of zeros where it is empty: a kernel takes no empty array."""
    return array if len(array) else np.zeros((1, *array.shape[1:]), array.dtype)
