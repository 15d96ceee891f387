"""A state between two frames as meters read it, with what does not change kept from the last."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.kernels.state import GONE
from taichi_cloth.limits.network import Network
from taichi_cloth.scene.model import Scene

if TYPE_CHECKING:
    from taichi_cloth.simulation.simulation import Simulation


@dataclass(frozen=True)
class Moment:
    """A state, as the host has it.

    time: the scene's; steps: done since its start; loads: how often a state was put onto the
    device until then (`Storage.loads`). network: particles, and the springs that pull. pulling:
    which of all springs do, (s,) bool; marks: (s, 2), status and break step. broken: how many are,
    those that pull for one more step included. contacts: what contacts gave less what they
    took, an energy, since an account of them began.
    """

    time: float
    steps: int
    loads: int
    scene: Scene
    network: Network
    pulling: np.ndarray
    marks: np.ndarray
    broken: int
    contacts: float


class Moments:
    """Reads moments of a simulation; what does not change from one to the next is not read again.

    Nothing of the run is changed, but that an account of contacts begins, where it keeps one.

    accounts: whether it does; else nothing is changed at all, and moments know of no contacts.
    """

    def __init__(self, sim: Simulation, *, accounts: bool = True) -> None:
        self._sim, self._accounts = sim, accounts
        self._last: Moment | None = None
        self._alive: np.ndarray | None = None
        self._taken: Scene | None = None  # what the storage had then

    def now(self) -> Moment:
        """The present one."""
        sim, storage, last = self._sim, self._sim.storage, self._last
        alive = sim.drawn_springs()
        unchanged = alive is self._alive and storage.scene is self._taken
        # What is breaking is gone a step later, which no count says.
        settled = last is not None and int(last.pulling.sum()) == len(alive)
        if last is not None and last.loads == storage.loads and unchanged and settled:
            network = replace(last.network, position=sim.positions(), velocity=sim.velocities())
            if storage.changed_numbers:
                network = sim.network()
            now = replace(last, network=network, time=sim.time, steps=sim.steps)
        else:
            # A load ends the account.
            if self._accounts and (last is None or last.loads != storage.loads):
                sim.account_contacts()
            snapshot, self._alive, self._taken = storage.snapshot(), alive, storage.scene
            pulling = snapshot.marks[:, 0] != GONE
            now = Moment(
                time=sim.time,
                steps=sim.steps,
                loads=storage.loads,
                scene=snapshot.scene,
                network=snapshot.network(),
                pulling=pulling,
                marks=snapshot.marks,
                broken=len(pulling) - len(alive),
                contacts=0.0,
            )
        self._last = replace(now, contacts=_balance_of_contacts(sim) if self._accounts else 0.0)
        return self._last


def _balance_of_contacts(sim: Simulation) -> float:
    account = sim.contact_account()
    return 0.0 if account is None else account.balance
