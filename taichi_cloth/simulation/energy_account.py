"""An account of a run's energy: what forces took and gave, what was done by hand, and the rest.

What is left when all work is known is the error of the method: its numerical drift. It is kept from
reading to reading, each a state between two frames:

    change of energy = work of forces + changes by hand + drift

- Work of forces without a potential (drag, dashpots, air) and of fixed particles that are moved:
  their power at each reading, by the trapezoidal rule. The error is of second order in the time
  between readings, and belongs to the drift; what the rule with every second reading gives beside
  it says how large it is (`doubt`).
- Work of a push that is held: its force times the way of each particle, frame by frame, less what
  the method's positions are ahead of it, or behind (`Method.position_weight`).
- A spring that breaks takes its energy with it: what it has where it is gone a step later, if the
  reading came then, else what it had at its break force, F^2 / 2k, from which a long step differs.
- Contacts: by the account of contacts (`kernels/contact_account.py`), in a simulation that keeps
  one; else they are in the drift.
- By hand: all that is set, tied, cut, pinned, spawned, taken hold of or let go between two frames.
  A reading after that counts the whole change since the last one as this, and forces from there on.
  While the mouse's hold moves, what that does to the energy of its springs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.kernels import forces
from taichi_cloth.kernels.forces import bending, grab
from taichi_cloth.kernels.forces import springs as elastic
from taichi_cloth.kernels.forces.contract import ACCELERATION, FORCE, TENSION, has
from taichi_cloth.limits import tractions
from taichi_cloth.limits.network import Network
from taichi_cloth.scene.holding import Hold
from taichi_cloth.simulation.diagnostics import Energy, energy_of, spring_forces, stencil_forces

if TYPE_CHECKING:
    from taichi_cloth.simulation.moment import Moment


@dataclass(frozen=True)
class Booked:
    """An account of energy, in the scene's units, since its start.

    total: kinetic and potential energy now; change: of it since the start. work: of forces without
    a potential, of springs that broke and of pushes, negative where they take energy. by_hand: what
    changes between frames gave. doubt: by how much `work` may be off.
    """

    energy: Energy
    change: float
    work: float
    by_hand: float
    doubt: float

    @property
    def drift(self) -> float:
        """Energy that the method's step made of nothing; contacts', too, without an account."""
        return self.change - self.work - self.by_hand


class EnergyAccount:
    """Keeps the account; `push` before a frame and `read` at any later state, in order of time."""

    def __init__(self) -> None:
        self._work = self._by_hand = 0.0
        self._first: float | None = None
        self._last: tuple[Moment, float, float] | None = None  # with energy and power
        self._before_last: tuple[float, float] | None = None  # time and power
        self._coarse = self._fine = 0.0  # integrals of power with every second reading, with all
        self._since_coarse = 0.0

    def push(self, force: np.ndarray, way: np.ndarray, mass: np.ndarray, ahead: float) -> None:
        """Book a push (n, dim) on free particles that went some way, (n, dim), in a frame.

        ahead: by how much of the acceleration the method's positions are ahead of a constant one's.
        """
        self._work += float((force * (way - ahead * force / mass[:, None])).sum())

    def move(self, hold: Hold, before: np.ndarray, x: np.ndarray, fixed: np.ndarray) -> None:
        """Book that the mouse's hold moved from a place `before` (dim,), with particles at x."""
        now, then = (grab.energy_of(of, x, fixed) for of in (hold, replace(hold, place=before)))
        self._by_hand += now - then

    def read(self, now: Moment) -> Booked:
        """Book what happened since the last reading."""
        energy, power = energy_in(now.network), power_of(now.network, now.time)
        if self._first is None or self._last is None:
            self._first = energy.total
        else:
            last, energy_before, power_before = self._last
            if last.loads != now.loads or last.network.world is not now.network.world:
                self._by_hand += energy.total - energy_before
                self._before_last = None
                self._since_coarse = 0.0
            else:
                self._integrate(last.time, power_before, now.time, power)
                self._work += now.contacts - last.contacts - lost_in_breaks(last, now)
        self._last = now, energy.total, power
        return Booked(
            energy,
            energy.total - self._first,
            self._work,
            self._by_hand,
            abs(self._fine - self._coarse) / 3,
        )

    def _integrate(self, begin: float, before: float, end: float, power: float) -> None:
        """The trapezoidal rule, and beside it the one over every two parts at once."""
        part = (end - begin) * (before + power) / 2
        self._work += part
        self._since_coarse += part
        if self._before_last is None:
            self._before_last = begin, before
            return
        start, first = self._before_last
        self._fine += self._since_coarse
        self._coarse += (end - start) * (first + power) / 2
        self._before_last, self._since_coarse = None, 0.0


def energy_in(network: Network) -> Energy:
    """The kinetic and potential energy there is."""
    motion = network.position, network.velocity, network.world, network.particles
    return energy_of(*motion, network.springs, network.stencils)


def power_of(network: Network, time: float) -> float:
    """The energy a unit of time that forces without a potential give, and that moves what is held.

    Of a force that has a potential, too, only what depends on velocity counts.
    """
    x, v, particles = network.position, network.velocity, network.particles
    free = ~particles.fixed[:, None]
    power = _power_along_springs(network)
    for name in forces.TERMS:
        term = forces.load(name)
        counts = has(term.damping) or not has(term.energy)
        if term.adds in (ACCELERATION, FORCE) and has(term.twin) and counts:
            force = term.twin(x, v, network.world, particles)
            if has(term.energy):
                force = force - term.twin(x, 0.0 * v, network.world, particles)
            if term.adds == ACCELERATION:
                force = particles.mass[:, None] * force
            power += float((force * v).sum(where=free))
    if len(network.triangles):
        air = tractions.forces_on_particles(
            x, v, time, network.world, network.triangles, network.shares
        )
        power += float((air * v).sum(where=free))
    moved = particles.fixed & v.any(axis=1) if particles.fixed.any() else particles.fixed
    if moved.any():
        force = spring_forces(x, v, network.springs)
        force = force + stencil_forces(x, network.stencils, particles.fixed)
        power -= float((force * v)[moved].sum())
    return power


def _power_along_springs(network: Network) -> float:
    """Of tensions that depend on the rate at which springs lengthen."""
    springs = network.springs
    if not network.along_springs[1].any():
        return 0.0
    length, rate = lengths_and_rates(network)
    power = 0.0
    for term in map(forces.load, forces.TERMS):
        if term.adds != TENSION or not has(term.damping) or not has(term.twin):
            continue
        tension = term.twin(length, rate, springs)
        if has(term.energy):
            tension = tension - term.twin(length, 0.0 * rate, springs)
        power -= float((tension * rate).sum())
    return power


def lengths_and_rates(network: Network) -> tuple[np.ndarray, np.ndarray]:
    """The springs' lengths, and the rates at which they lengthen, (s,) both."""
    a, b = network.springs.between.T
    d = network.position.take(b, axis=0) - network.position.take(a, axis=0)
    dv = network.velocity.take(b, axis=0) - network.velocity.take(a, axis=0)
    length = np.sqrt(np.einsum("ij,ij->i", d, d))
    rate: np.ndarray = np.einsum("ij,ij->i", d, dv) / np.where(length > 0, length, 1.0)
    return length, rate


def lost_in_breaks(last: Moment, now: Moment) -> float:
    """The energy that springs and stencils took with them which pulled at the last reading.

    Both have the same scene.
    """
    gone = np.flatnonzero(last.pulling & ~now.pulling)
    if not len(gone):
        return 0.0
    network, springs = now.network, now.scene.springs.select(gone)
    energy = elastic.energies(network.position, springs)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        at_break = np.nan_to_num(0.5 * springs.break_force**2 / springs.stiffness, posinf=0.0)
    just_gone = now.marks[gone, 1] + 1 >= now.steps
    lost = float(np.where(just_gone, energy, at_break).sum())
    return lost + _lost_bending(last.network, network)


def _lost_bending(last: Network, now: Network) -> float:
    """The energy, where particles are now, of the stencils that were torn since."""
    if len(last.stencils) == len(now.stencils):
        return 0.0
    motion = now.position, now.velocity, now.world, now.particles
    before, after = (bending.energy(*motion, of) for of in (last.stencils, now.stencils))
    return float(before - after)
