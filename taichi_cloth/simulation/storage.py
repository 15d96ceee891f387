"""The state on the device: fields with room to grow, what is put there, and what is read back."""

from __future__ import annotations

import math
import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import taichi as ti

from taichi_cloth.errors import InputError
from taichi_cloth.kernels import (
    contact_account,
    forces,
    fracture,
    grips,
    kept_pairs,
    readback,
    total_forces,
    transfer,
    watchdog,
)
from taichi_cloth.kernels.forces import blow, grab
from taichi_cloth.kernels.methods.contract import Method
from taichi_cloth.kernels.solvers import stages
from taichi_cloth.kernels.specialization import Specialization
from taichi_cloth.kernels.spring_numbers import NUMBERS, SpringNumber
from taichi_cloth.kernels.state import ALIVE, BREAKING, GONE, WORK, State
from taichi_cloth.scene.holding import Hold
from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.solids import Solid, solids
from taichi_cloth.simulation import adjacency, diagnostics, requirements
from taichi_cloth.simulation.kept import Kept, KeptFields
from taichi_cloth.simulation.launch import Launcher
from taichi_cloth.simulation.layouts import Layout
from taichi_cloth.simulation.numbers import Numbers
from taichi_cloth.simulation.placement import Placement, Placements
from taichi_cloth.simulation.snapshot import Snapshot
from taichi_cloth.simulation.surfaces import Surfaces, free_with
from taichi_cloth.simulation.upload import Real, Upload, as_real

SPAWN_CAPACITY = 16384  # room for clicks before the fields must grow: some 10 MB


@dataclass(frozen=True)
class _Container:
    """Fields, and what they were made for.

    spec: with parallel loops in one launch per step, for kernels beside the frames. kept: copies
    what steps keep.

    Their memory is given back when nobody holds it any more, the storage or a checkpoint.
    """

    state: Any
    spec: Specialization
    topology: str
    kept: KeptFields

    def fits(self, spec: Specialization, topology: str) -> bool:
        """Whether the fields are those of `spec` in a topology, and more."""
        return self.topology == topology and self.spec.can_run(spec)


@dataclass(frozen=True)
class _Loaded:
    """What the last load made.

    number: which load of the storage it was. placements, solids: those of the scene loaded.
    """

    number: int
    storage: weakref.ref[Storage]
    container: _Container
    placement: Placement
    specialization: Specialization
    numbers: Numbers
    placements: Placements
    solids: Sequence[Solid]


class Storage:
    """A state on the device. `take` says which, and `load` puts it there; all else comes after.

    solids: what is in the way of the scene that was taken last (`scene.solids`).
    method: the one that runs on it. lanes: particles in a pack of the grids.
    real: type of the device's numbers. topology, path: how it was loaded. loads: how often anything
    was. pushed: whether a push lasts until the frame's end. accounts_contacts: whether
    `account_contacts` may be called.
    """

    def __init__(
        self,
        method: Method,
        lanes: int,
        launcher: Launcher,
        snapshot: Snapshot,
        accounts_contacts: bool = False,
    ) -> None:
        self._method, self._lanes, self._launcher = method, lanes, launcher
        self._needs = method.needs
        self.accounts_contacts = accounts_contacts
        self.real: Real = np.float64 if launcher.device.real == "f64" else np.float32
        self._taken = snapshot
        self.solids = solids(snapshot.scene)
        self._placements = Placements(snapshot.scene, self._needs, lanes)
        self.topology = self.path = ""
        self.loads = 0
        self.pushed = self._held = False
        self._loaded: _Loaded | None = None
        self._altered = True  # from outside, so that what the method keeps must be computed anew
        self._drawn_positions = np.zeros((0, 0))
        self._drawn_springs: np.ndarray | None = None
        self._drawn_triangles: np.ndarray | None = None
        self._drawn_broken = 0
        self._surfaces = Surfaces()

    @property
    def altered(self) -> bool:
        """Whether the state was changed from outside since the last step."""
        return self._altered

    @property
    def scene(self) -> Scene:
        """The scene with all that was spawned, every particle where it began."""
        return self._taken.scene

    @property
    def state(self) -> Any:
        """The fields, a `kernels.state.State`."""
        return self._now.container.state

    @property
    def layout(self) -> Layout:
        """Where particles and springs are."""
        return self._now.placement.layout

    @property
    def specialization(self) -> Specialization:
        """What is compiled to advance frames."""
        return self._now.specialization

    @property
    def _now(self) -> _Loaded:
        if self._loaded is None:
            raise RuntimeError("nothing is on the device before `load`")
        return self._loaded

    def _launch(self, kernel: Any, *arguments: Any) -> Any:
        container = self._now.container
        return self._launcher.launch(kernel, container.spec, container.state, *arguments)

    # --- putting a scene on the device -----------------------------------------------------

    def take(self, snapshot: Snapshot) -> None:
        """Hold another state from the next load on, without a push."""
        if not _same_solids(self._taken.scene, snapshot.scene):
            self.solids = solids(snapshot.scene)
        if not _same_places(self._taken.scene, snapshot.scene):
            self._placements = Placements(snapshot.scene, self._needs, self._lanes)
        self._taken = snapshot
        self.pushed = False

    def move(self, x: np.ndarray, v: np.ndarray) -> None:
        """From the next load on, have the particles at x with v, (n, dim)."""
        self._taken = replace(self._taken, x=x, v=v)

    def topologies(self) -> list[str]:
        """The topologies that the scene can be stored in."""
        return self._placements.topologies()

    def load(self, topology: str, path: str, numbers: Numbers) -> None:
        """Put the state that was taken on the device.

        topology: "lanes" or "graph"; the graph where there is no regular grid any more. path:
        "serial" or "parallel". InputError where a number does not fit the device's precision.
        """
        placement, topology = self._find_placement(topology)
        self._fill(self._make_room(placement, topology), placement, path, numbers)

    def _find_placement(self, topology: str) -> tuple[Placement, str]:
        """The placement of the scene in a topology, or else on the graph, and which it is in."""
        placement = self._placements.find(topology)
        if placement is None:  # what was spawned may have undone the last grid
            topology = "graph"
            placement = self._placements.find(topology)
            assert placement is not None  # it takes any springs
        return placement, topology

    def _fill(
        self, container: _Container, placement: Placement, path: str, numbers: Numbers
    ) -> None:
        """Put the state that was taken into a container."""
        self.topology, self.path, self.loads = container.topology, path, self.loads + 1
        specialization = self._launcher.specialize(container.spec, path)
        self._launcher.expect(specialization, container.state.capacity)
        self._loaded = _Loaded(
            number=self.loads,
            storage=weakref.ref(self),
            container=container,
            placement=placement,
            specialization=specialization,
            numbers=numbers,
            placements=self._placements,
            solids=self.solids,
        )
        self._drawn_springs = self._drawn_triangles = None
        upload = self._upload()
        upload.numbers(numbers)
        upload.all()
        if container.spec.accounts_contacts:
            container.state.accounting[None] = 0
        if "blow" in container.spec.terms and not self.pushed:
            self._launcher.launch(blow.clear_push, container.state)
            self._held = False
        self._altered = True

    def fits(self, snapshot: Snapshot) -> bool:
        """Whether a state could be loaded without compiling anything anew."""
        taken, placements, loaded = self._taken, self._placements, self.solids
        container = self._now.container
        try:
            self.take(snapshot)
            placement, topology = self._find_placement(self.topology)
            needed = requirements.capacity(snapshot.scene, self.solids, placement)
            spec = self._needed(placement)
            room = container.state.capacity.holds(needed)
            return bool(room and container.fits(spec, topology))
        finally:
            self._taken, self._placements, self.solids = taken, placements, loaded

    def mark_new_springs(self, steps: int) -> None:
        """Mark the springs that are over their limit after `steps` steps, outside of any."""
        if self.specialization.fracture:
            self._launch(fracture.mark_new_springs, steps)

    def set_path(self, path: str) -> None:
        """From now on run on a path, "serial" or "parallel"."""
        self.path = path
        specialization = self._launcher.specialize(self._now.container.spec, path)
        self._loaded = replace(self._now, specialization=specialization)

    def set_numbers(self, numbers: Numbers) -> None:
        """Change the numbers that a run may change."""
        if not math.isclose(numbers.dt, self._now.numbers.dt, rel_tol=1e-12):
            self._altered = True  # what a method keeps may depend on the step
        self._loaded = replace(self._now, numbers=numbers)
        self._upload().numbers(numbers)

    def begin(self, done: int) -> None:
        """Before frames, after `done` steps: compute what the method keeps, if that is outdated."""
        if self._altered:
            if self._now.container.spec.held:
                self._launch(grips.begin_launch, done)
            self._launcher.begin(self._now.container.spec, self.state, done)
        self._altered = False

    def restore(self, steps: int) -> None:
        """Undo a frame that failed: the state is again that of the last good one, after `steps`."""
        self._launch(watchdog.restore)
        self._altered = True
        if not self.specialization.fracture:
            return
        status, step = self.marks().T
        status[step > steps] = ALIVE
        status[(step == steps) & (status == GONE)] = BREAKING
        marks = np.column_stack([status, np.where(status == ALIVE, 0, step)])
        self._taken = replace(self.snapshot(), marks=marks)
        self.load(self.topology, self.path, self._now.numbers)

    # --- checkpoints -----------------------------------------------------------------------

    def keep(self) -> Kept:
        """All that later steps depend on, as it is now."""
        now = self._now
        return Kept(
            taken=_with_own_hold(self._taken),
            fields=now.container.kept.read(self._launcher, now.placement, self._patches()),
            topology=self.topology,
            spec=now.container.spec,
            pushed=self.pushed,
            held=self._held,
            altered=self._altered,
            loaded=now,
        )

    def put_back(self, kept: Kept, path: str, numbers: Numbers) -> None:
        """Go on from what was kept: the same bits follow as then.

        Where nothing was loaded since, nothing is loaded, and nothing compiled where the fields of
        then are still there. InputError where they were stored in a way that is none here.
        """
        loaded = kept.loaded
        mine = loaded is not None and loaded.storage() is self
        if mine and self._loaded is not None and loaded.number == self._now.number:
            self._taken = _with_own_hold(kept.taken)
            self.set_numbers(numbers)
            self.loads += 1  # for who compares two moments
        else:
            if mine:
                self._taken = _with_own_hold(kept.taken)
                self._placements, self.solids = loaded.placements, loaded.solids
                self._fill(loaded.container, loaded.placement, path, numbers)
            else:
                self._load_like(kept, path, numbers)
            if kept.spec.thick:
                self._launch(kept_pairs.take_places)
        where = self._now.placement, self._patches()
        self._now.container.kept.write(self._launcher, *where, kept.fields)
        self.pushed, self._held, self._altered = kept.pushed, kept.held, kept.altered
        self._drawn_springs = self._drawn_triangles = None

    def _prepare_return(self) -> None:
        """Compile what goes back to a checkpoint, by going back to the present."""
        where = self._now.placement, self._patches()
        kept = self._now.container.kept
        kept.write(self._launcher, *where, kept.read(self._launcher, *where))

    def _patches(self) -> int:
        """How many patches of particles are compared as one."""
        thick = self._now.container.spec.thick
        return len(self.scene.spheres.patch_start) - 1 if thick else 0

    def _load_like(self, kept: Kept, path: str, numbers: Numbers) -> None:
        """Load what was kept of another storage, stored as it was there."""
        self.take(_with_own_hold(kept.taken))
        placement, topology = self._find_placement(kept.topology)
        threads = self._launcher.device.threads
        like = replace(kept.spec, threads=threads)
        container = self._make_room(placement, topology, like)
        if container.spec != like:
            raise InputError(
                f"restore: it was stored otherwise ({_difference(container.spec, like)})"
            )
        self._fill(container, placement, path, numbers)

    def _upload(self) -> Upload:
        now = self._now
        return Upload(
            launcher=self._launcher,
            spec=now.container.spec,
            state=now.container.state,
            snapshot=self._taken,
            placements=self._placements,
            placement=now.placement,
            solids=self.solids,
            needs=self._needs,
            real=self.real,
        )

    # --- room on the device ----------------------------------------------------------------

    def _make_room(
        self, placement: Placement, topology: str, like: Specialization | None = None
    ) -> _Container:
        """A container that fits particles, springs and spec: the one there is, or an empty one.

        A new container compiles every kernel again, so it is made with room to spare.
        like: a specialization that it is to have, if that can run what is needed.
        """
        scene, device = self.scene, self._launcher.device
        needed = requirements.capacity(scene, self.solids, placement)
        spec = self._needed(placement)
        if like is not None and like.can_run(spec):
            spec = like
        factor = 1
        if self._loaded is not None:
            old = self._loaded.container
            fits = old.fits(spec, topology) and (like is None or old.spec == spec)
            if fits and old.state.capacity.holds(needed):
                return old
            factor = 2 if fits else 1
            self._loaded = None  # its memory goes with `old`, unless a checkpoint holds it
            del old
        room = SPAWN_CAPACITY if scene.world.takes_clicks else 0
        capacity = replace(
            needed,
            particles=factor * needed.particles + room,
            springs=factor * needed.springs + room,
            packs=factor * needed.packs + room,
            closer=max(needed.closer, 16 * factor * needed.particles) if spec.thick else 0,
            patches=factor * needed.patches,
        )
        state: Any = State(spec, getattr(ti, device.real), capacity, self._method)
        kept = KeptFields(spec, state, self._method, self.real)
        container = _Container(state, spec, topology, kept)
        # Taichi has room for 512 trees of fields, of which each state takes two.
        free_with(container, state, device)
        return container

    def _needed(self, placement: Placement) -> Specialization:
        """What the state that was taken needs, in a placement."""
        return requirements.specialization(
            self._taken,
            self.solids,
            placement,
            self._launcher.device,
            topologies=self.topologies,
            accounts_contacts=self.accounts_contacts,
        )

    def unprepared(self) -> list[Callable[[], None]]:
        """What compiles the kernels that only a first step back, or a first click, needs.

        Called between frames, they change nothing of the state.
        """
        if not self.scene.world.takes_clicks:
            return [self._prepare_return]
        n, dim, state = len(self.scene.particles), self.scene.world.dim, self.state
        row = np.zeros((1, dim), self.real)
        found: list[Callable[[], None]] = [self._prepare_return]
        for field in (state.x, state.v):
            found.append(partial(self._launch, readback.read_vectors, field, row))
        if n == 0:  # a particle of infinite mass that nobody counts; the first load clears it
            columns = len(state.vector_names) * dim + len(state.particle_names)
            nothing = np.zeros(1, np.int32), np.zeros((1, columns), self.real)
            found.append(partial(self._launch, transfer.load_particles, *nothing))
        if self.scene.world.tools:
            nobody = np.zeros(0, np.int32), np.zeros((0, 2), np.int32)
            found.append(partial(self._launch_cut, *nobody, 0))
            if self.scene.world.held is None:
                found += [partial(self._launch_hold, Hold.nobody(dim), np.ones(n), 0)]
                found += [partial(self._launch, grab.move_hold, np.zeros(dim, self.real))]
        if self.specialization.fracture and len(self._now.placement.graph_springs) == 0:
            none = np.zeros((1, 2), np.int32)
            found.append(partial(self._launcher.launch, readback.read_fracture, state, none))
            rows = np.zeros((1, len(NUMBERS)), self.real)  # of no spring, until the next load
            found.append(partial(self._launch, transfer.load_spring_numbers, rows))
        return found

    # --- surfaces --------------------------------------------------------------------------

    def drawn_normals(self) -> np.ndarray:
        """Unit normals of the particles, (n, 3) in the device's precision.

        Without a copy: the next call fills the same array anew.
        """
        return self._surfaces.normals(self._upload())

    def triangles_alive(self) -> np.ndarray:
        """Which triangles are whole, (m,) bool: no spring along a side was over its limit."""
        return self._surfaces.whole(self.scene, self.springs_alive())

    # --- pushes ----------------------------------------------------------------------------

    def push(self, numbers: np.ndarray) -> None:
        """Push the particles near a line until the frame's end (`blow.compute_push`)."""
        self._launch(blow.compute_push, numbers.astype(self.real))
        self.pushed = self._held = self._altered = True

    def hold(self, force: np.ndarray) -> None:
        """Push every particle with a force of its own, (n, dim), until the next push."""
        self._launch(blow.hold_push, as_real(self.real, "particle", force))
        self._held = self._altered = True

    def held(self) -> np.ndarray | None:
        """The force on each particle that is pushed or held now, (n, dim); None: there is none."""
        return self._read_field(self.state.push) if self._held else None

    def hold_again(self, force: np.ndarray, pushed: bool) -> None:
        """Go on with a push that was there before the last load; pushed: until the frame's end."""
        if len(force):
            self.hold(force)
        self.pushed = pushed

    def end_push(self) -> None:
        """At a frame's end: no pointer any more."""
        if self.pushed:
            self._launcher.launch(blow.clear_push, self.state)
            self.pushed, self._held, self._altered = False, False, True

    # --- cuts ------------------------------------------------------------------------------

    def cut(self, springs: np.ndarray, steps: int) -> bool:
        """Let springs be gone, by number, after `steps` steps, without a load.

        False, with nothing done, where what is compiled knows no springs that break, or where what
        the method keeps of each particle's springs is only summed by a load.
        """
        if not self.specialization.fracture or "summed_springs" in self._needs:
            return False
        placement = self._now.placement
        graph = np.flatnonzero(np.isin(placement.graph_springs, springs))
        links = placement.link_places[np.isin(placement.links, springs)]
        self._launch_cut(graph.astype(np.int32), links, steps - 1)
        self._drawn_springs, self._altered = None, True
        return True

    def _launch_cut(self, graph: np.ndarray, links: np.ndarray, step: int) -> None:
        some = np.zeros(1, np.int32), np.zeros((1, 2), np.int32)  # a kernel takes no empty array
        arrays = (graph if len(graph) else some[0], links if len(links) else some[1])
        self._launch(fracture.cut_springs, *arrays, len(graph), len(links), step)

    # --- what the mouse holds --------------------------------------------------------------

    def grab(self, hold: Hold | None, mass: np.ndarray | None = None) -> None:
        """Hold particles from now on, which weigh `mass` (m,) meanwhile; None: let all go."""
        scene, before = self.scene, self.scene.world.held
        weights = scene.particles.mass.copy()
        if before is not None:
            weights[before.particles] = before.mass
            self._launch_hold(before, weights, 0)
        if hold is not None:
            weights[hold.particles] = mass
            self._launch_hold(hold, weights, 1)
            self.drag(hold.place)
        particles = replace(scene.particles, mass=weights)
        changed = replace(scene, world=replace(scene.world, held=hold), particles=particles)
        self._taken = replace(self._taken, scene=changed)
        self._altered = True

    def _launch_hold(self, hold: Hold, weights: np.ndarray, grabbing: int) -> None:
        """Hold particles, or let them go (grabbing 0), with these masses of all, (n,)."""
        mine = hold.particles
        w = np.where(self.scene.particles.fixed[mine], 0.0, 1.0 / weights[mine])
        pull = grabbing * np.column_stack([hold.offset, hold.stiffness, hold.damping])
        rows = as_real(self.real, "particle", pull, w)
        arrays = mine.astype(np.int32), rows
        if len(mine) == 0:  # a kernel takes no empty array
            arrays = np.zeros(1, np.int32), np.zeros((1, rows.shape[1]), self.real)
        self._launch(grab.hold, *arrays, len(mine), grabbing)
        if self._now.container.spec.halo and "spring_colours" in self._needs:
            self._launch(transfer.load_halo_numbers)

    def drag(self, place: np.ndarray) -> None:
        """Take what is held to another place of the pointer, (dim,)."""
        self._launch(grab.move_hold, as_real(self.real, "pointer", place[None])[0])
        self._altered = True

    # --- reading back ----------------------------------------------------------------------

    def snapshot(self) -> Snapshot:
        """The state as it is now."""
        return Snapshot(self._scene_now(), self.positions(), self.velocities(), self.marks())

    @property
    def changed_numbers(self) -> list[SpringNumber]:
        """Those numbers of springs that forces change."""
        spec = self.specialization
        return [n for n in NUMBERS if n.changes(spec.terms) and n.stored(spec)]

    def _scene_now(self) -> Scene:
        """The scene with those numbers of springs that forces have changed since."""
        springs, changed = self.scene.springs, self.changed_numbers
        if not changed or len(springs) == 0:
            return self.scene
        columns = {n.column: self._read_springs(n.letter, len(springs)) for n in changed}
        return replace(self.scene, springs=replace(springs, **columns))

    def _read_springs(self, letter: str, count: int) -> np.ndarray:
        """A number that each spring has of its own, (s,) float64."""
        placement, out = self._now.placement, np.zeros(count, self.real)
        mine = placement.graph_springs
        if len(mine):
            ends = placement.layout.slot[self.scene.springs.between[mine]]
            half = adjacency.half_springs(ends, placement.layout.n_packs * placement.layout.lanes)
            part, field = np.zeros(len(mine), self.real), getattr(self.state, f"csr_{letter}")
            self._launcher.launch(readback.read_numbers, field, half.half[:, 0].copy(), part)
            out[mine] = part
        if len(placement.links):
            part, field = np.zeros(len(placement.links), self.real), f"link_{letter}"
            places = placement.link_places
            self._launch(readback.read_link_numbers, getattr(self.state, field), places, part)
            out[placement.links] = part
        values: np.ndarray = out.astype(np.float64)
        return values

    def positions(self) -> np.ndarray:
        """Positions, (n, dim) float64."""
        return self._read("x")

    def velocities(self) -> np.ndarray:
        """Velocities, (n, dim) float64."""
        return self._read("v")

    def forces(self, done: int) -> np.ndarray:
        """The total force on each particle in the present state, after `done` steps, (n, dim)."""
        mass = self.scene.particles.mass[:, None]
        if len(mass) == 0:
            return np.zeros((0, self.scene.world.dim))
        self._launch(total_forces.compute_forces, done)
        force: np.ndarray = self._read_field(self.state.saved_x)
        force += mass * self._read_field(self.state.saved_v)
        return force

    def marks(self) -> np.ndarray:
        """Status and break step of every spring, (s, 2) int32."""
        placement, taken = self._now.placement, self._taken.marks
        if not self.specialization.fracture or len(taken) == 0:
            return taken
        out: np.ndarray = taken.copy()
        if len(placement.graph_springs):
            part = np.zeros((len(placement.graph_springs), 2), np.int32)
            self._launcher.launch(readback.read_fracture, self.state, part)
            out[placement.graph_springs] = part
        if self.specialization.links:
            part = np.zeros((len(placement.links), 2), np.int32)
            self._launch(readback.read_link_fracture, placement.link_places, part)
            out[placement.links] = part
        return out

    def springs_alive(self) -> np.ndarray:
        """Which springs have not been over their limit, (s,) bool."""
        alive: np.ndarray = self.marks()[:, 0] == ALIVE
        return alive

    def count_broken(self) -> int:
        """How many springs are not whole; the device counts them."""
        return int(self._launch(readback.count_broken)) if self.specialization.fracture else 0

    def faulty_particle(self) -> int:
        """The particle that the watchdog found in the last frame: the lowest index at fault."""
        return int(self._launcher.launch(watchdog.last_fault, self.state))

    def take_work(self) -> np.ndarray:
        """Counts of the solver's work since the last call, (3,): `kernels.state.WORK`.

        They are 0 where a step's work is known beforehand.
        """
        work = np.zeros(len(WORK), np.int32)
        if self._method.claims.forces == 0:
            self._launcher.launch(readback.take_work, self.state, work)
        return work

    def unsettled(self) -> int:
        """How many steps ended with pairs that overlap, since the fields were made."""
        return int(self.state.unsettled[None]) if self.specialization.resting else 0

    def account_contacts(self) -> None:
        """Begin an account of what contacts do, which the next load ends."""
        if self.specialization.accounts_contacts:
            self._launch(contact_account.begin_account)

    def contact_account(self) -> tuple[float, float, int | None] | None:
        """The energy that contacts gave, that with what they took, and the number of the first step
        with one, if any.

        None where no account is kept.
        """
        if not self.specialization.accounts_contacts or self.state.accounting[None] == 0:
            return None
        energy, first = float(self.state.contact_energy[None]), int(self.state.first_touch[None])
        balance = float(self.state.contact_balance[None])
        return energy, balance, None if first == contact_account.NEVER else first

    def unsettled_faces(self) -> int:
        """How many steps ended with faces inside obstacles, since the fields were made."""
        return int(self.state.faces_unsettled[None]) if self.specialization.faces else 0

    def solution(self) -> diagnostics.Solution:
        """How the last step was solved, by a method that solves to a tolerance."""
        names = "residual_max", "residual_rms", "scale", "directions", "sweeps"
        numbers = {name: getattr(self.state, name)[None] for name in names}
        outcome = int(self.state.outcome[None])
        converged = outcome in (stages.CONVERGED, stages.ROUNDED)
        return diagnostics.Solution(stages.OUTCOMES[outcome], converged, **numbers)

    def drawn_positions(self) -> np.ndarray:
        """Positions for a window, (n, dim) in the device's precision.

        Without a copy: the next call fills the same array anew.
        """
        shape = len(self.scene.particles), self.scene.world.dim
        if self._drawn_positions.shape != shape:
            self._drawn_positions = np.zeros(shape, self.real)
        if len(self._drawn_positions):
            self._launch(readback.read_vectors, self.state.x, self._drawn_positions)
        return self._drawn_positions

    def drawn_springs(self) -> np.ndarray:
        """The particles that each spring that holds ties, (alive, 2).

        The same array until a spring breaks, comes or is whole again: all that the device is asked
        for at every frame is how many are broken.
        """
        broken = self.count_broken()
        if self._drawn_springs is None or broken != self._drawn_broken:
            self._drawn_broken, self._drawn_triangles = broken, None
            self._drawn_springs = self.scene.springs.between[self.springs_alive()]
        return self._drawn_springs

    def drawn_triangles(self) -> np.ndarray:
        """The particles at the corners of each triangle that is whole, (whole, 3).

        The same array as long as that of `drawn_springs`.
        """
        self.drawn_springs()
        if self._drawn_triangles is None:
            triangles = self.scene.triangles
            if self._drawn_broken:
                triangles = triangles[self.triangles_alive()]
            self._drawn_triangles = triangles
        return self._drawn_triangles

    def _read(self, name: str) -> np.ndarray:
        """The vectors of a field of packs, with their low parts where they have any."""
        value = self._read_field(getattr(self.state, name))
        if self.specialization.compensated:
            value += self._read_field(getattr(self.state, f"{name}_low"))
        return value

    def _read_field(self, of: Any) -> np.ndarray:
        out = np.zeros((len(self.scene.particles), self.scene.world.dim), self.real)
        if len(out):
            self._launch(readback.read_vectors, of, out)
        values: np.ndarray = out.astype(np.float64)
        return values


def _with_own_hold(taken: Snapshot) -> Snapshot:
    """The same state, with a copy of where the mouse holds it: that follows the pointer."""
    held = taken.scene.world.held
    if held is None:
        return taken
    own = replace(held, place=held.place.copy())
    return replace(taken, scene=taken.scene.with_world(held=own))


def _difference(here: Specialization, there: Specialization) -> str:
    """What differs between two specializations, in words."""
    words = [
        f"{name} {value}, here {getattr(here, name)}"
        for name, value in vars(there).items()
        if value != getattr(here, name)
    ]
    return "; ".join(words)


def _same_solids(one: Scene, other: Scene) -> bool:
    """Whether the same is in the way in two scenes."""
    radius = [scene.particles.radius.max(initial=0.0) for scene in (one, other)]
    return one.obstacles is other.obstacles and one.world is other.world and radius[0] == radius[1]


def _same_places(one: Scene, other: Scene) -> bool:
    """Whether the particles and springs of two scenes are placed alike, whatever else differs."""
    return (
        one.springs is other.springs
        and one.stencils is other.stencils
        and one.particles.position is other.particles.position
        and one.triangles is other.triangles
        and one.features().collisions == other.features().collisions
        and forces.present_in(one) == forces.present_in(other)
    )
