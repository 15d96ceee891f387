"""Gauges: what meters read of a simulation, in a small part of its time.

A gauge is read at most so often that it takes its share of the time (`SHARES`); `History.rate` says
how often that is. Nothing of the run is changed: all that is read are copies.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.kernels import methods
from taichi_cloth.limits.eigenmodes import Limit
from taichi_cloth.limits.network import Network
from taichi_cloth.limits.tracking import FastestMode
from taichi_cloth.scene.holding import Hold
from taichi_cloth.simulation import diagnostics, strain
from taichi_cloth.simulation.energy_account import Booked, EnergyAccount, energy_in
from taichi_cloth.simulation.history import ROWS, SECONDS, History
from taichi_cloth.simulation.moment import Moment, Moments

if TYPE_CHECKING:
    from taichi_cloth.simulation.simulation import Simulation

# Of the time that goes by, what reading may take: 3 % in all.
SHARES = {"state": 0.015, "margin": 0.01, "depth": 0.005}
# Without a window, which has no time to save: in every so manieth frame, so that each run of the
# same has the same numbers.
EVERY = {"state": 1, "margin": 10, "depth": 6}
AT_FIRST, IMPROVEMENTS = 30, 3  # products for the fastest mode: at first, and at later readings


@dataclass(frozen=True)
class State:
    """Readings of a state. booked: its energy, and where that came from and went.

    momentum: (dim,). strain: the largest in magnitude, pulled positive, of the spring of number
    `spring` between the particles `ends` (-1: there is none). breaks: whether that one may break
    of it. bears: the part that it bears of what it can (`strain.borne`), by `full`, the strain that
    counts as full; borne: the largest part that any bears. broken: springs that are.
    """

    booked: Booked
    momentum: np.ndarray
    strain: float
    spring: int
    ends: tuple[int, int]
    breaks: bool
    bears: float
    borne: float
    full: float
    broken: int


@dataclass(frozen=True)
class Margin:
    """A step beside the stable limit. step: h; limit: the largest one, and what sets it.

    error: the part by which omega may be larger, by what is left to improve. always: whether the
    method is stable at every step. never: whether at none.
    """

    step: float
    limit: Limit
    error: float
    always: bool
    never: bool

    @property
    def reach(self) -> float:
        """h omega, of the mode that is the first to grow; h times its damping where it has none."""
        return self.step * (math.sqrt(self.limit.omega2) or self.limit.damping)

    @property
    def used(self) -> float:
        """The part of the stable step that is used; of a method without a limit `reach`."""
        if self.always:
            return self.reach
        return math.inf if self.limit.dt == 0 else self.step / self.limit.dt


class Gauges:
    """Reads a simulation after its frames; keeps the last `SECONDS` of what it read.

    paced: whether reading keeps to its share of the time, as in a window; else it follows from the
    frames alone, each gauge being read in `every` so manieth one. clock: what time is told by.

    states: rows of (total, change, work, by hand, doubt, scale of energy, |momentum|, each part of
    it, strain, borne, broken). margins: rows of (reach, used). depths: of (deepest penetration,).
    mode: the one that sets the margin.
    """

    def __init__(
        self,
        sim: Simulation,
        *,
        paced: bool = True,
        every: Mapping[str, int] = MappingProxyType(EVERY),
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._sim, self._paced, self._every, self._clock = sim, paced, every, clock
        dim = sim.scene.world.dim
        self.states = History(SECONDS, ROWS, 10 + dim)
        self.margins, self.depths = (History(SECONDS, ROWS, k) for k in (2, 1))
        self._cost = dict.fromkeys(SHARES, 0.0)
        self.restart()

    def restart(self) -> None:
        """Begin anew, after a reset."""
        for history in (self.states, self.margins, self.depths):
            history.clear()
        self.state: State | None = None
        self.margin: Margin | None = None
        self.depth: float | None = None
        self._touched = False
        self._moments, self._account = Moments(self._sim), EnergyAccount()
        start = self._sim.scene
        self._full = strain.allowed(start.particles.position, start.springs)
        self._take_method()
        self._moment: tuple[int, Moment] | None = None
        self._pushed: tuple[np.ndarray, np.ndarray] | None = None
        self._hold: tuple[Hold, np.ndarray] | None = None  # with its place at the last frame
        self._due = dict.fromkeys(SHARES, -math.inf)
        self._frames = 0

    @property
    def network(self) -> Network:
        """The network that was read last; one there is after the first reading."""
        assert self._moment is not None  # the present one is not read here: frames would lag
        return self._moment[1].network

    def _take_method(self) -> None:
        """Weigh by the method that the simulation has now, which may be changed as it goes on."""
        self._method = methods.load(self._sim.method)
        self.mode = FastestMode(self._method)

    @property
    def knows_contacts(self) -> bool:
        """True if what contacts gave and took is counted as work, or there surely were none."""
        sim = self._sim
        if not sim.can_touch() or sim.contact_account() is not None:
            return True
        beside_walls = bool(sim.storage.solids) or sim.scene.features().collisions
        return not (self._touched or beside_walls)

    # The frames

    def before_frame(self) -> None:
        """Note what was done by hand since the last frame, and where a push begins."""
        self._book_push()
        if methods.load(self._sim.method) is not self._method:
            self._take_method()
        hold = self._sim.held()
        if hold is not None:
            if self._hold is not None and self._hold[0] is hold:
                before = self._hold[1]
                if (before != hold.place).any():
                    self._account.move(hold, before, self._sim.positions(), self._sim.fixed())
            self._hold = hold, hold.place.copy()
        held = self._sim.storage.held()
        if held is not None:
            if self.state is None:  # its work counts from a state on
                self._read_state(0.0)
                self._frames += 1
            held = np.where(self._sim.fixed()[:, None], 0.0, held)
            self._pushed = held, self._sim.positions()

    def after_frame(self, now: float) -> None:
        """Read what is due, at the second `now` of what is kept."""
        self._book_push()
        if self._is_due("state"):
            with self._timed("state"):
                self._read_state(now)
        if self._is_due("margin"):
            with self._timed("margin"):
                self._read_margin(now)
        if self._sim.can_touch() and self._is_due("depth"):
            with self._timed("depth"):
                self.depth = self._sim.penetration()
                self._touched |= self.depth > 0  # past a wall, for at least a step
                self.depths.note(now, self.depth)
        self._frames += 1

    def _book_push(self) -> None:
        if self._pushed is not None:
            force, begin = self._pushed
            sim, weight = self._sim, self._method.position_weight
            ahead = (weight - 0.5) * sim.dt * sim.dt / sim.substeps
            way = sim.positions() - begin
            self._account.push(force, way, sim.storage.scene.particles.mass, ahead)
            self._pushed = None

    def _is_due(self, name: str) -> bool:
        if not self._paced:
            return self._frames % self._every[name] == 0
        return self._clock() >= self._due[name]

    @contextmanager
    def _timed(self, name: str) -> Iterator[None]:
        """Have the next reading of a gauge wait as long as its share asks for."""
        begin = time.thread_time()  # other programs that want the processor are not counted
        yield
        # A lone long one, as when something is loaded, counts half.
        self._cost[name] = (self._cost[name] + time.thread_time() - begin) / 2
        self._due[name] = self._clock() + self._cost[name] / SHARES[name]

    # The readings

    def _present(self) -> Moment:
        """The present state, read once a frame."""
        if self._moment is None or self._moment[0] != self._frames:
            self._moment = self._frames, self._moments.now()
        return self._moment[1]

    def look(self) -> None:
        """Read a state that the run went back to, or on, without noting it: what was noted before
        stays, and where its energy came from.
        """
        if self.state is None or self.margin is None:
            return
        if methods.load(self._sim.method) is not self._method:
            self._take_method()
        moment = Moments(self._sim, accounts=False).now()
        booked = replace(self.state.booked, energy=energy_in(moment.network))
        self.state = _state(moment, booked, self._full)
        self.margin = self._margin(moment.network, IMPROVEMENTS)
        if self.depth is not None:
            self.depth = self._sim.penetration()

    def _read_state(self, now: float) -> None:
        moment = self._present()
        booked = self._account.read(moment)
        self.state = state = _state(moment, booked, self._full)
        energy = booked.energy
        self.states.note(
            now, energy.total, booked.change, booked.work, booked.by_hand, booked.doubt,
            energy.kinetic + energy.elastic, float(np.linalg.norm(state.momentum)),
            *state.momentum, state.strain, state.borne, state.broken,
        )  # fmt: skip

    def _read_margin(self, now: float) -> None:
        more = AT_FIRST if self.margin is None else IMPROVEMENTS
        self.margin = self._margin(self._present().network, more)
        self.margins.note(now, self.margin.reach, self.margin.used)

    def _margin(self, network: Network, more: int) -> Margin:
        """The step beside the limit after so many more products for the fastest mode."""
        sim = self._sim
        step, stable = sim.dt / sim.substeps, sim.claims.stability_limit
        found = self.mode.follow(network, step, more)
        limit = Limit(math.inf) if found is None else found.limit
        error = 0.0 if found is None else found.error
        return Margin(step, limit, error, math.isinf(stable), limit.dt == 0)


def _state(moment: Moment, booked: Booked, full: float) -> State:
    """Readings of a moment. full: the strain that counts as full."""
    network = moment.network
    particles = network.particles
    momentum = diagnostics.momentum(network.velocity, particles.mass, particles.fixed)
    length = strain.lengths(network.position, network.springs.between)
    strained = strain.strains(length, network.springs)
    most, spring, ends, breaks, bears, borne = 0.0, -1, (-1, -1), False, 0.0, 0.0
    if len(strained):
        at = int(np.abs(strained).argmax())
        most, spring = float(strained[at]), int(network.number[at])
        ends = int(network.springs.between[at, 0]), int(network.springs.between[at, 1])
        breaks = bool(strain.may_break(length, network.springs)[at])
        parts = np.abs(strain.borne(length, network.springs, full))
        bears, borne = float(parts[at]), float(parts.max())
    return State(booked, momentum, most, spring, ends, breaks, bears, borne, full, moment.broken)
