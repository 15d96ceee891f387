"""The state on the device: what is put there, read back, acted on, and gone back to."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from taichi_cloth.errors import InputError
from taichi_cloth.kernels import (
    contact_account,
    fracture,
    grips,
    kept_pairs,
    readback,
    watchdog,
)
from taichi_cloth.kernels.forces import blow, grab
from taichi_cloth.kernels.specialization import Specialization
from taichi_cloth.kernels.state import ALIVE, BREAKING, GONE
from taichi_cloth.scene.holding import Hold
from taichi_cloth.simulation.numbers import Numbers
from taichi_cloth.simulation.storage.download import Download
from taichi_cloth.simulation.storage.handling import Handling
from taichi_cloth.simulation.storage.kept import Kept, with_own_hold
from taichi_cloth.simulation.storage.loading import Loading
from taichi_cloth.simulation.strain import lengths

NEAR = 1e-3  # within this part of its length a spring may be over its limit on the device


class Storage(Loading, Download, Handling):
    """A state on the device. `take` says which, and `load` puts it there; all else comes after.

    Its parts: `Loading`, `Download` (what is read back), `Handling` (what is done to it where it
    is). Here: how it is run, and where it goes back to. `DeviceState` says what it has.
    """

    # --- how it is run ---------------------------------------------------------------------

    def set_path(self, path: str) -> None:
        """From now on run on a path, "serial" or "parallel"."""
        self.path = path
        container = self._now.container
        specialization = self._launcher.specialize(container.spec, path, container.state.packs)
        self._loaded = replace(self._now, specialization=specialization)

    def set_numbers(self, numbers: Numbers) -> None:
        """Change the numbers that a run may change."""
        if not math.isclose(numbers.dt, self._now.numbers.dt, rel_tol=1e-12):
            self._altered = True  # what a method keeps may depend on the step
        self._loaded = replace(self._now, numbers=numbers)
        self._upload().numbers(numbers)

    def begin(self, done: int) -> tuple[Specialization, Any]:
        """Before frames, after `done` steps: compute what the method keeps, if that is outdated.

        Returns what is compiled to advance them, and the fields.
        """
        now = self._now
        if self._altered:
            if now.container.spec.held:
                self._launch(grips.begin_launch, done)
            self._launcher.begin(now.container.spec, now.container.state, done)
            self._altered = False
        return now.specialization, now.container.state

    def mark_new_springs(self, steps: int) -> None:
        """Mark the springs that are over their limit after `steps` steps, outside of any.

        It comes right after a load.
        """
        if self.specialization.fracture and self._may_break():
            self._launch(fracture.mark_new_springs, steps)

    def _may_break(self) -> bool:
        """True if any spring may be over its limit, however lengths are rounded on the device.

        Where none may, as in nearly all scenes, there is no kernel to compile.
        """
        springs, x = self.scene.springs, self._taken.x
        shortest, longest = springs.lengths_held()
        rounding = 8.0 * float(np.finfo(self.real).eps) * np.abs(x).max(initial=0.0)
        length = lengths(x, springs.between)
        short, long = length * (1 - NEAR) - rounding, length * (1 + NEAR) + rounding
        return not bool(((short > shortest) & (long < longest)).all())

    def account_contacts(self) -> None:
        """Begin an account of what contacts do, which the next load ends."""
        if self.specialization.accounts_contacts:
            self._launch(contact_account.begin_account)

    def restore(self, steps: int) -> None:
        """Undo a frame that failed: the state is again that of the last good one, after `steps`."""
        self._launch(watchdog.restore)
        self._altered = True
        self._look_at_all()
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
            taken=with_own_hold(self._taken),
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
        mine = loaded is not None and loaded.of() is self
        if mine and self._loaded is not None and loaded.number == self._now.number:
            self._taken = with_own_hold(kept.taken)
            self.set_numbers(numbers)
            self.loads += 1  # for who compares two moments
        else:
            if mine:
                self._taken = with_own_hold(kept.taken)
                self._placements, self.solids = loaded.placements, loaded.solids
                self._fill(loaded.container, loaded.placement, path, numbers)
            else:
                self._load_like(kept, path, numbers)
            if kept.spec.thick:
                self._launch(kept_pairs.take_places)
        where = self._now.placement, self._patches()
        self._now.container.kept.write(self._launcher, *where, kept.fields)
        self._look_at_all()
        self.pushed, self._held, self._altered = kept.pushed, kept.held, kept.altered
        self._drawn_springs = None

    def _look_at_all(self) -> None:
        """Let the next step look at all faces again (`kernels/face_clearance.py`)."""
        if self.specialization.faces:
            self.state.face_unseen[None] = 1

    def _load_like(self, kept: Kept, path: str, numbers: Numbers) -> None:
        """Load what was kept of another storage, stored as it was there.

        InputError where that is none here; all is then as it was.
        """
        names = "_taken", "_placements", "solids", "pushed", "_loaded"
        before = {name: getattr(self, name) for name in names}
        like = replace(kept.spec, threads=self._launcher.device.threads)
        try:
            self.take(with_own_hold(kept.taken))
            self.judge(0.0)  # what an older file says nothing of began where it is
            placement, topology = self._find_placement(kept.topology)
            container = self._make_room(placement, topology, like)
            if container.spec != like:
                difference = _difference(container.spec, like)
                raise InputError(f"restore: it was stored otherwise ({difference})")
            container.kept.check(kept.fields)
        except InputError:
            vars(self).update(before)
            raise
        self._fill(container, placement, path, numbers)

    def _patches(self) -> int:
        """The number of patches of particles that are compared as one."""
        thick = self._now.container.spec.thick
        return len(self.scene.spheres.patch_start) - 1 if thick else 0

    # --- what only the first click needs ---------------------------------------------------

    def prepare_clicks(self) -> None:
        """Compile the kernels that only the pointer's first motion, click or step back needs.

        Called between frames, it changes nothing of the state.
        """
        n, dim, state = len(self.scene.particles), self.scene.world.dim, self.state
        self._prepare_return()
        if "blow" in self.specialization.terms and not self._held:
            self._launch(blow.compute_push, np.zeros(3 * dim + 2, self.real))
            self._launcher.launch(blow.clear_push, state)
        if not self.scene.world.takes_clicks:
            return
        if not readback.is_by_host(state, n):
            for field in (state.x, state.v):
                self._launch(readback.read_vectors, field, np.zeros((1, dim), self.real))
        if self.scene.world.tools:
            self.snapshot()
            self._launch_cut(np.zeros(0, np.int32), np.zeros((0, 2), np.int32), 0)
            if self.scene.world.held is None:
                self._launch_hold(Hold.nobody(dim), np.ones(n), 0)
                self._launch(grab.move_hold, np.zeros(dim, self.real))
        ties = self._now.placement.graph_springs
        if (
            self.specialization.fracture
            and len(ties) == 0
            and not readback.are_marks_by_host(state, 1)
        ):
            self._launcher.launch(readback.read_fracture, state, np.zeros((1, 2), np.int32))

    def _prepare_return(self) -> None:
        """Compile what goes back to a checkpoint, by going back to the present."""
        where = self._now.placement, self._patches()
        kept = self._now.container.kept
        kept.write(self._launcher, *where, kept.read(self._launcher, *where))


def _difference(here: Specialization, there: Specialization) -> str:
    """The difference of two specializations, in words."""
    words = [
        f"{name} {value}, here {getattr(here, name)}"
        for name, value in vars(there).items()
        if value != getattr(here, name)
    ]
    return "; ".join(words)
