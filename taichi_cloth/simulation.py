"""A scene in motion: scene + method -> advance, spawn, blow, read back, watchdog."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import taichi as ti

from taichi_cloth import execution, measure, topology
from taichi_cloth.errors import InputError, SimulationFailure, nearest
from taichi_cloth.kernels import interaction, methods, transfer, watch
from taichi_cloth.kernels.fracture import mark_overstretched
from taichi_cloth.kernels.state import ALIVE, GONE, State
from taichi_cloth.runtime import current_device
from taichi_cloth.scene import Particles, Scene, Springs, validate

BLOW_REACH = 50.0  # world units from the pointer at which its force ends
BLOW_STRENGTH = 0.002  # force per unit of displacement and of distance short of the reach
# A particle that would cross the world this many times in one frame is lost, not fast.
RUNAWAY_CROSSINGS = 100.0
# Particles and springs times steps in one launch: some tenths of a second, so that Ctrl-C is heard.
LAUNCH_WORK = 20_000_000
SPAWN_CAPACITY = 256  # room for clicks before the fields must grow


class Simulation:
    """One scene, integrated by one method on the device that `runtime.start` started.

    scene: validated here (InputError). method: a name out of `kernels.methods.METHODS`.
    dt: time of a frame, the scene's own when absent; substeps: steps a frame is cut into.
    execution: "serial" (a frame is one launch on one thread), "parallel" (a launch per step, its
    loops parallel), or "auto": the one that measured faster on this machine for such a scene.

    Arrays are returned as float64 copies, one row per particle in the order of creation.
    """

    def __init__(
        self,
        scene: Scene,
        method: str = "symplectic_euler",
        dt: float | None = None,
        substeps: int = 1,
        execution: str = "auto",
    ):
        if method not in methods.METHODS:
            raise InputError(f"--method {method}: unknown; {nearest(method, methods.METHODS)}")
        if substeps < 1:
            raise InputError(f"--substeps {substeps}: must be at least 1")
        dt = scene.world.dt if dt is None else float(dt)
        if not (math.isfinite(dt) and dt > 0):
            raise InputError(f"--dt {dt}: must be a positive number")
        self.scene = validate(scene)
        self.method, self.dt, self.substeps = method, dt, substeps
        device = current_device()
        module = methods.load(method)
        self.claims, self._step = module.CLAIMS, module.step
        self._real = getattr(ti, device.precision)
        self._numpy_real = np.float64 if device.precision == "f64" else np.float32
        self._requested_execution = execution
        self.reset()

    # --- advancing -------------------------------------------------------------------------

    def reset(self) -> None:
        """Back to the scene's start; what was spawned is gone."""
        self.frame = 0
        self._particles, self._springs = self.scene.particles, self.scene.springs
        self._status = np.full((len(self._springs), 2), (ALIVE, 0), np.int32)
        self._blowing = False
        self._load(self._particles.position, self._particles.velocity)
        self._mark_overstretched()

    def advance(self, frames: int = 1) -> None:
        """Advance by whole frames.

        Raises SimulationFailure when a particle is no longer finite or runs away; the state is
        then that of the last good frame, and can be read, drawn and saved.
        """
        while frames > 0:
            # A push lasts one frame; without one, frames can share a launch.
            batch = 1 if self._blowing else min(frames, self._frames_per_launch())
            passed = self._run(self.execution, self.frame + 1, batch)
            self.frame += passed
            if passed < batch:
                self._fail(watch.last_fault(self._state))
            if self._blowing:
                interaction.clear_push(self._state)
                self._blowing = False
            frames -= batch

    def _frames_per_launch(self):
        work = self.substeps * max(self.particle_count + self.spring_count, 1)
        return max(1, LAUNCH_WORK // work)

    def _run(self, path, first, frames):
        return execution.run_frames(
            path, self._step, self._features, self._state, first, frames, self.substeps
        )

    @property
    def time(self) -> float:
        """Simulated time, in the scene's units."""
        return self.frame * self.dt

    def timed_frame(self, path: str):
        """A function that runs one frame on a path, for `execution` to time; the caller reloads."""
        return lambda: self._run(path, first=0, frames=1)

    def describe_size(self) -> str:
        """What decides a step's cost besides the device: features, and sizes by powers of two."""
        sizes = self.particle_count.bit_length(), self.spring_count.bit_length()
        return f"{self._features}, 2^{sizes[0]} particles, 2^{sizes[1]} springs"

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
        x, v = self.positions(), self.velocities()
        self._particles = self._particles.joined(new)
        x, v = np.concatenate([x, new.position]), np.concatenate([v, new.velocity])
        if tied_to is not None:
            tie = Springs.build([[tied_to, index]], x, defaults=self.scene.spring_defaults)
            self._status = np.concatenate([self._fracture(), [[ALIVE, 0]]]).astype(np.int32)
            self._springs = self._springs.joined(tie)
        fits = (
            self.particle_count <= self._state.particle_capacity
            and self.spring_count <= self._state.spring_capacity
        )
        if not fits or self._features != self._needed_features():
            self._status = self._fracture() if tied_to is None else self._status
            self._load(x, v)
        else:
            self._load_numbers()
            self._load_particles(new.position, new.velocity, first=index)
            if self._features.springs:
                self._status = self._fracture() if tied_to is None else self._status
                self._load_springs()
        self._mark_overstretched()
        return index

    # --- reading back ----------------------------------------------------------------------

    @property
    def particle_count(self) -> int:
        return len(self._particles)

    @property
    def spring_count(self) -> int:
        return len(self._springs)

    def positions(self) -> np.ndarray:
        """Positions, (n, dim)."""
        return self._motion()[0]

    def velocities(self) -> np.ndarray:
        """Velocities, (n, dim)."""
        return self._motion()[1]

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
        return self._fracture()[:, 0] == ALIVE

    def energy(self) -> measure.Energy:
        """Kinetic, gravitational and elastic energy."""
        x, v = self._motion()
        particles, springs = self._particles, self._springs
        return measure.energy(
            x,
            v,
            particles.mass,
            particles.fixed,
            self.scene.world.gravity,
            springs.between,
            springs.stiffness,
            springs.rest_length,
            self._fracture()[:, 0] != GONE,
        )

    def momentum(self) -> np.ndarray:
        """Total momentum of the free particles, (dim,)."""
        return measure.momentum(self.velocities(), self._particles.mass, self._particles.fixed)

    # --- loading the device ----------------------------------------------------------------

    def _needed_features(self):
        return replace(self.scene, particles=self._particles, springs=self._springs).features()

    def _load(self, x, v):
        """Put a whole state on the device, in a new container where the present is too small."""
        features = self._needed_features()
        n, s = self.particle_count, self.spring_count
        state = getattr(self, "_state", None)
        if (
            state is None
            or features != self._features
            or n > state.particle_capacity
            or s > state.spring_capacity
        ):
            room = SPAWN_CAPACITY if self.scene.world.mouse == "spawn" else 0
            grown = 0 if state is None else 2
            if state is not None:
                state.free()
            self._features = features
            self._state = State(
                features, self._real, max(n + room, grown * n), max(s + room, grown * s)
            )
            self._load_everything(x, v)
            self.execution = execution.choose(self._requested_execution, self)
        self._load_everything(x, v)

    def _load_everything(self, x, v):
        self._load_numbers()
        self._load_particles(x, v, first=0)
        if self._features.springs:
            self._load_springs()
        if self._features.blow:
            interaction.clear_push(self._state)

    def _load_numbers(self):
        world, particles = self.scene.world, self._particles
        grid_size, cell_size = self._grid(particles)
        counts = [self.particle_count, self.spring_count, *grid_size]
        diagonal = float(np.linalg.norm(world.size))
        self.speed_limit = RUNAWAY_CROSSINGS * diagonal / self.dt
        numbers = [self.dt / self.substeps, self.speed_limit, cell_size]
        numbers += [*world.gravity, *world.low, *world.high]
        transfer.load_numbers(
            self._features,
            self._state,
            np.array(counts, np.int32),
            np.array(numbers, self._numpy_real),
        )

    def _grid(self, particles):
        """Cells per axis and their width for the collision grid.

        A cell must be as wide as the largest diameter; it is wider where that would make more
        cells than particles, so that clearing and scanning cells stays cheap.
        """
        size = np.array(self.scene.world.size)
        n = max(len(particles), 1)
        width = max(
            2.0 * float(particles.radius.max(initial=0.0)), (size.prod() / n) ** (1 / len(size))
        )
        limit = (4 * n + 64) ** (1 / len(size))
        return [int(max(3, min(math.ceil(a / width) + 1, limit))) for a in size], width

    def _load_particles(self, x, v, first):
        """Copy particles first.. to the device; the rest of their row from self._particles."""
        p = self._particles
        part = slice(first, first + len(x))
        w = np.where(p.fixed, 0.0, 1.0 / p.mass)
        v = np.where(p.fixed[part, None], 0.0, v)  # a fixed particle never moves
        columns = [w, p.radius, p.restitution, p.viscous]
        rows = np.column_stack([x, v, *(c[part] for c in columns)])
        if len(rows):
            transfer.load_particles(
                self._features, self._state, rows.astype(self._numpy_real), first
            )

    def _load_springs(self):
        springs, status = self._springs, self._status
        half = topology.half_springs(springs.between, self.particle_count)
        gone = status[:, 0] == GONE
        numbers = np.column_stack([springs.stiffness, springs.rest_length, springs.damping])
        numbers[gone, 0] = numbers[gone, 2] = 0.0
        if len(springs) == 0:  # a kernel takes no empty array; row 0..0 says there are none
            half = replace(half, far=np.zeros(1, np.int32), spring=np.zeros(1, np.int64))
            numbers = np.zeros((1, 3))
        transfer.load_half_springs(
            self._features,
            self._state,
            half.row,
            half.far,
            numbers[half.spring].astype(self._numpy_real),
        )
        if self._features.fracture and len(springs):
            with np.errstate(divide="ignore"):
                break_length = springs.rest_length + springs.break_force / springs.stiffness
            transfer.load_springs(
                self._state,
                np.column_stack([springs.between, half.half, status]).astype(np.int32),
                (break_length**2).astype(self._numpy_real),
            )

    def _mark_overstretched(self):
        if self._features.fracture:
            mark_overstretched(self._features, self._state, self.frame)

    def _push(self, origin, direction, displacement):
        if not self._features.blow:
            raise InputError(
                f"scene '{self.scene.name}': the mouse does not blow here "
                f"([world] mouse is '{self.scene.world.mouse}'; set it to 'blow')"
            )
        numbers = np.concatenate([origin, direction, displacement, [BLOW_REACH, BLOW_STRENGTH]])
        interaction.compute_push(self._state, numbers.astype(self._numpy_real))
        self._blowing = True

    # --- reading the device ----------------------------------------------------------------

    def _motion(self):
        shape = (self.particle_count, self.scene.world.dim)
        x, v = np.zeros(shape, self._numpy_real), np.zeros(shape, self._numpy_real)
        if len(x):
            transfer.read_motion(self._state, x, v)
        return x.astype(np.float64), v.astype(np.float64)

    def _fracture(self):
        """Status and break frame of every spring, (s, 2) int32."""
        if not self._features.fracture or self.spring_count == 0:
            return self._status
        out = np.zeros((len(self._status), 2), np.int32)
        transfer.read_fracture(self._state, out)
        return out

    # --- failure ---------------------------------------------------------------------------

    def _fail(self, particle):
        """Put the last good frame back, and say who failed, why, and what to change."""
        bad_x, bad_v = self._motion()
        frame = self.frame + 1
        watch.put_back(self._state)
        status = self._fracture()
        status[(status[:, 0] != ALIVE) & (status[:, 1] == frame)] = (ALIVE, 0)
        self._status = status
        if self._features.fracture:
            self._load_springs()
        finite = np.isfinite(bad_x[particle]).all() and np.isfinite(bad_v[particle]).all()
        if finite:
            speed = float(np.linalg.norm(bad_v[particle]))
            what = f"runs away at speed {speed:.3g} (limit {self.speed_limit:.3g})"
        else:
            what = "has a position or velocity that is not a finite number"
        raise SimulationFailure(particle, frame, what, *self._likely_cause())

    def _likely_cause(self):
        """(cause, remedy) of a failure, from the method's limit and the stiffest particle."""
        omega, stiffest = topology.largest_angular_frequency(
            self._springs, self._particles.mass, self._particles.fixed
        )
        dt = self.dt / self.substeps
        limit = self.claims.stability_limit
        if omega > 0 and limit == 0:
            return (
                f"{self.method} is unstable on undamped springs at every dt",
                "use --method symplectic_euler",
            )
        if not math.isfinite(omega):
            return f"springs too stiff for {self._numpy_real.__name__}", "use softer springs"
        if omega > 0 and dt * omega > limit:
            needed = math.ceil(self.dt * omega / limit / 0.9)
            return (
                f"a step of {dt:.3g} is above {limit / omega:.3g}, the stable limit of "
                f"{self.method} (set by the springs at particle {stiffest})",
                f"use --substeps {needed}, a smaller --dt, or softer springs",
            )
        viscous = self._particles.viscous / self._particles.mass
        if self._features.drag and dt * viscous.max() > 2.0:
            return (
                f"a step of {dt:.3g} is above {2.0 / viscous.max():.3g}, the stable limit of the "
                f"drag on particle {viscous.argmax()}",
                f"use --substeps {math.ceil(self.dt * viscous.max() / 1.8)} or a smaller --dt",
            )
        return "forces or starting speeds too large for the step", "use more --substeps"
