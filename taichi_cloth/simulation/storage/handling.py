"""The part of a storage that acts on a state where it is: pushes, cuts, what the mouse holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from taichi_cloth.kernels import fracture
from taichi_cloth.kernels.forces import blow, grab
from taichi_cloth.scene.holding import Hold
from taichi_cloth.simulation.storage.device_state import DeviceState
from taichi_cloth.simulation.storage.filling import as_real


class Handling(DeviceState):
    """Changes a state on the device without a load."""

    # --- pushes ----------------------------------------------------------------------------

    def push(self, numbers: np.ndarray) -> None:
        """Push the particles near a line until the frame's end (`blow.compute_push`)."""
        self._launch(blow.compute_push, as_real(self.real, "pointer", numbers[None])[0])
        self.pushed = self._held = self._altered = True

    def hold(self, force: np.ndarray) -> None:
        """Push every particle with a force of its own, (n, dim), until the next push."""
        self._launch(blow.hold_push, as_real(self.real, "particle", force))
        self._held = self._altered = True
        self.pushed = False

    def held(self) -> np.ndarray | None:
        """The force on each particle that is pushed or held now, (n, dim); None: there is none."""
        return self._read_field(self.state.push) if self._held else None

    def hold_again(self, force: np.ndarray | None, pushed: bool) -> None:
        """Go on with a push that was there before the last load; pushed: until the frame's end.

        force: `held` of then; particles that came with the load are not pushed.
        """
        if force is None:
            return
        if len(force):
            rows = np.zeros((len(self.scene.particles), force.shape[1]))
            rows[: len(force)] = force
            self.hold(rows)
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
        self.loads += 1  # for who compares two moments
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
        changed = scene.with_parts(world=replace(scene.world, held=hold), particles=particles)
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
        self._upload().halo_numbers()

    def drag(self, place: np.ndarray) -> None:
        """Take what is held to another place of the pointer, (dim,)."""
        self._launch(grab.move_hold, as_real(self.real, "pointer", place[None])[0])
        self._altered = True
