"""The part of a storage that reads the state back from the device."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from taichi_cloth.kernels import contact_account, readback, rest, total_forces, watchdog
from taichi_cloth.kernels.solvers import stages
from taichi_cloth.kernels.spring_numbers import NUMBERS, SpringNumber
from taichi_cloth.kernels.state import ALIVE, WORK
from taichi_cloth.scene.model import Scene
from taichi_cloth.simulation import diagnostics
from taichi_cloth.simulation.snapshot import Snapshot
from taichi_cloth.simulation.storage import adjacency
from taichi_cloth.simulation.storage.device_state import DeviceState


class Download(DeviceState):
    """Reading of a state on the device, all in the order of particles and springs."""

    def snapshot(self) -> Snapshot:
        """The state as it is now."""
        x, v, marks = self.positions(), self.velocities(), self.marks()
        return replace(self._taken, scene=self._scene_now(), x=x, v=v, marks=marks)

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
        if count := len(placement.graph_springs):
            out[placement.graph_springs] = self._marks_on_graph(count)
        if self.specialization.links:
            part = np.zeros((len(placement.links), 2), np.int32)
            self._launch(readback.read_link_fracture, placement.link_places, part)
            out[placement.links] = part
        return out

    def _marks_on_graph(self, count: int) -> np.ndarray:
        """Status and break step of the springs on the graph, (count, 2), of which there are any."""
        if readback.are_marks_by_host(self.state, count):
            found: np.ndarray = readback.fracture_in_memory(self.state, count)
            return found
        part = np.zeros((count, 2), np.int32)
        self._launcher.launch(readback.read_fracture, self.state, part)
        return part

    def springs_alive(self) -> np.ndarray:
        """Which springs have not been over their limit, (s,) bool."""
        alive: np.ndarray = self.marks()[:, 0] == ALIVE
        return alive

    def triangles_alive(self) -> np.ndarray:
        """Which triangles are whole, (m,) bool: no spring along a side was over its limit."""
        return self._surfaces.whole(self.scene, self.springs_alive())

    def count_broken(self) -> int:
        """The number of springs that are not whole; the device counts them where they are many."""
        if not self.specialization.fracture:
            return 0
        count = len(self._now.placement.graph_springs)
        by_host = readback.are_marks_by_host(self.state, count)
        if count and by_host and not self.specialization.links:
            return int(readback.broken_in_memory(self.state, count))
        return int(self._launch(readback.count_broken))

    def faulty_particle(self) -> int:
        """The particle that the watchdog found in the last frame: the lowest index at fault."""
        return int(self._launcher.launch(watchdog.last_fault, self.state))

    def take_work(self) -> np.ndarray:
        """Counts of the solver's work since the last call, (3,): `kernels.state.WORK`."""
        work = np.zeros(len(WORK), np.int32)
        if self.state.memory is not None:
            work[:] = readback.work_in_memory(self.state)
        else:
            self._launcher.launch(readback.take_work, self.state, work)
        return work

    def take_unsettled(self) -> np.ndarray:
        """Take the counts of `unsettled` and `unsettled_faces`, (2,), which are 0 from then on."""
        counts = np.array([self.unsettled(), self.unsettled_faces()])
        if counts[0]:
            self.state.unsettled[None] = 0
        if counts[1]:
            self.state.faces_unsettled[None] = 0
        return counts

    def unsettled(self) -> int:
        """The steps that ended with pairs that overlap, since the last load or `take_unsettled`."""
        return int(self.state.unsettled[None]) if self.specialization.resting else 0

    def unsettled_faces(self) -> int:
        """The steps that ended with faces inside obstacles, since the last load or
        `take_unsettled`."""
        return int(self.state.faces_unsettled[None]) if self.specialization.faces else 0

    def at_rest(self) -> bool:
        """Tell if the last step put all particles back to where it began (`kernels/rest.py`)."""
        if not rest.needed(self.specialization):
            return False
        return bool(self.state.rest_phase[None] != rest.MOVES)

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

    def solution(self) -> diagnostics.Solution:
        """The solution of the last step, by a method that solves to a tolerance."""
        names = "residual_max", "residual_rms", "scale", "directions", "sweeps"
        numbers = {name: getattr(self.state, name)[None] for name in names}
        outcome = int(self.state.outcome[None])
        converged = outcome in (stages.CONVERGED, stages.ROUNDED)
        return diagnostics.Solution(stages.OUTCOMES[outcome], converged, **numbers)

    def _read(self, name: str) -> np.ndarray:
        """The vectors of a field of packs, with their low parts where they have any."""
        value = self._read_field(getattr(self.state, name))
        if self.specialization.compensated:
            value += self._read_field(getattr(self.state, f"{name}_low"))
        return value

    # --- for a window ----------------------------------------------------------------------

    def drawn_positions(self) -> np.ndarray:
        """Positions for a window, (n, dim) in the device's precision.

        Without a copy: the next call fills the same array anew.
        """
        shape = len(self.scene.particles), self.scene.world.dim
        if self._drawn_positions.shape != shape:
            self._drawn_positions = np.zeros(shape, self.real)
        self._read_vectors(self.state.x, self._drawn_positions)
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

    def drawn_normals(self) -> np.ndarray:
        """Unit normals of the particles, (n, 3) in the device's precision.

        Without a copy: the next call fills the same array anew.
        """
        return self._surfaces.normals(self._upload())
