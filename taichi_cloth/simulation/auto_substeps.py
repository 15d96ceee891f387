"""The substeps of a run with `--dt auto`: as many a frame as its springs need at the moment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from taichi_cloth.kernels.forces import act_on_triangles as acts_by_speed
from taichi_cloth.kernels.methods.contract import Method
from taichi_cloth.limits.auto_step import SubstepController
from taichi_cloth.limits.network import Networks
from taichi_cloth.simulation.snapshot import Snapshot, same_but_own
from taichi_cloth.simulation.storage.storage import Storage


class AutoSubsteps:
    """Chooses the substeps of a frame: at the start, before a spawn, and after frames.

    method: name and contract of the method; dt: time of a frame.
    """

    def __init__(self, name: str, method: Method, dt: float) -> None:
        self._method = name, method, dt
        self._controller = SubstepController(name, method, dt)
        self._broken, self._breaking = 0, True
        self._networks = Networks()

    def at_start(self, start: Snapshot) -> int:
        """The substeps of a scene at its start; as `for_state`, but with nothing remembered."""
        self._controller.reset()
        return self.for_state(start)

    def for_state(self, state: Snapshot) -> int:
        """The substeps of a state, such as one with what is to be spawned.

        InputError where no number of substeps will do.
        """
        self._broken, self._breaking = int((~state.alive).sum()), True
        if acts_by_speed(state.scene):
            return self._controller.choose_in_motion(state.network())
        return self._controller.choose(Snapshot.at_start(state.scene, state.marks).network())

    def after_edit(self, now: Snapshot, edited: Snapshot) -> int:
        """The substeps of a state that is changed by hand from `now`; as `for_state`, but where
        it refuses nothing is changed.

        What is remembered serves only where particles' own numbers change and springs stay.
        """
        tried = AutoSubsteps(*self._method)
        if same_but_own(now, edited):
            tried.recall(self.memory())
            mine, theirs = now.scene.particles, edited.scene.particles
            if (mine.fixed & ~theirs.fixed).any() or (mine.mass > theirs.mass).any():
                tried._controller.expect_faster()
        chosen = tried.for_state(edited)
        vars(self).update(vars(tried))
        return chosen

    def memory(self) -> dict[str, Any]:
        """Its memory, numbers and arrays by name; `recall` takes it."""
        known = {"broken": self._broken, "breaking": self._breaking}
        return known | self._controller.memory()

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Go on from such a memory: what follows is chosen as it was then."""
        self._broken, self._breaking = memory["broken"], memory["breaking"]
        self._controller.recall(memory)

    def follows(self, storage: Storage) -> bool:
        """True if a frame can change how many substeps the next one needs.

        It can where springs break, and where the damping of forces on triangles grows with speed.
        """
        return storage.specialization.fracture or acts_by_speed(storage.scene)

    def after_frame(self, storage: Storage, substeps: int) -> int:
        """The substeps of the next frame, after one of `substeps`: fewer, where springs that broke
        leave slower ones.

        What breaks in a frame may pull in the next one, so the frame after is looked at, too.
        """
        if acts_by_speed(storage.scene):
            return self._controller.choose_in_motion(storage.snapshot().network(self._networks))
        broken = storage.count_broken()
        changed = broken != self._broken
        if not (changed or self._breaking):
            return substeps
        self._broken, self._breaking = broken, changed
        return self._controller.choose_after_breaks(
            Snapshot.at_start(storage.scene, storage.marks()).network()
        )
