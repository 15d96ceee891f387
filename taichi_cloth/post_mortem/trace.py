"""The last frames of a run, made again from its past: what was so in each of them.

The frame that failed is made again step by step, as far as it goes. What is read is what the meters
of a window read (`simulation.gauges`).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.errors import SimulationFailure
from taichi_cloth.limits.network import Network
from taichi_cloth.post_mortem.breaks import BATCH, Torn, torn
from taichi_cloth.post_mortem.done import Act, act_of
from taichi_cloth.post_mortem.sample import Sample
from taichi_cloth.runtime import current_device
from taichi_cloth.scene.model import Particles
from taichi_cloth.simulation.acts import do_again
from taichi_cloth.simulation.gauges import Gauges
from taichi_cloth.simulation.past import SPAN, Past, Place, Settings, go_to

if TYPE_CHECKING:
    from taichi_cloth.simulation.simulation import Simulation

LARGE = 20_000  # particles above which fewer frames are read
MOST_STEPS = 128  # parts of the failed frame that are looked at
FEW = 10  # frames of which one is read where time is up, but for the last ones
NOBODY = "", -1, 0.0


@dataclass(frozen=True)
class Trace:
    """The last frames of a run.

    settings: that it had at the end. samples: in order of time. failure: with which it ended; None:
    it did not. before: the network where the trace begins; last: where it ends, of the last good
    frame, with what was done since. push: what pushes particles then, (n, dim); None: nothing does.
    met: the obstacle that is fastest where it meets, or carries, a particle in the next frame, the
    particle, and the speed; ("", -1, 0.0): there is none.
    acts: what was done in it. whole: whether it begins at the scene's start. depth: the deepest
    penetration there; None: nothing can touch. unconverged: of the steps of the run, how many
    missed their tolerance; steps: how many it did. outcome: of the last solution, "" without one.
    torn: what broke and was not cut, of a run that goes on.
    pictures: of some of its frames, (frame, (h, w, 3) uint8).
    """

    scene: str
    settings: Settings
    follows: bool
    precision: str
    speed_limit: float
    failure: SimulationFailure | None
    samples: list[Sample]
    before: Network
    last: Network
    push: np.ndarray | None
    met: tuple[str, int, float]
    acts: list[Act]
    whole: bool
    depth: float | None
    unconverged: int
    steps: int
    outcome: str
    torn: Torn
    pictures: list[tuple[int, np.ndarray]] = field(default_factory=list)

    @property
    def h(self) -> float:
        """The step."""
        return self.settings.dt / self.settings.substeps


def traced(
    sim: Simulation,
    seconds: float,
    draw: Callable[[], np.ndarray] | None = None,
    pictures: int = 6,
) -> Trace:
    """The last frames of a simulation, which is as it was afterwards.

    seconds: that going back may take; where there is no way in that time, the trace is of the
    present state alone. draw: makes a picture of the simulation as it is; None: there are none.
    """
    past, end = sim.past, sim.frame
    failure = past.failure if past is not None else None
    if failure is not None and failure.frame != end + 1:
        failure = None
    reader = _Reader(sim, failure, draw, seconds)
    if past is None:
        past = Past()
    with np.errstate(all="ignore"), past.resting(sim):
        return reader.read(past, end, pictures)


class _Reader:
    """Reads a simulation on its way from a place of its past."""

    def __init__(
        self,
        sim: Simulation,
        failure: SimulationFailure | None,
        draw: Callable[[], np.ndarray] | None,
        seconds: float,
    ) -> None:
        self._sim, self._failure, self._draw = sim, failure, draw
        self._until = time.perf_counter() + seconds
        self._settings = Settings.of(sim)
        self._speed_limit = sim.speed_limit
        self._work, self._outcome = sim.work(), ""
        if "tolerance" in sim.claims.settings:
            self._outcome = sim.solution().outcome
        self._samples: list[Sample] = []
        self._pictures: list[tuple[int, np.ndarray]] = []

    def read(self, past: Past, end: int, pictures: int) -> Trace:
        """The trace up to the frame `end`, and what is left of the one after it."""
        sim, here = self._sim, self._sim.checkpoint()
        span = SPAN if sim.particle_count <= LARGE else SPAN // 4
        broke = Torn(0)
        if self._failure is None:
            broke = torn(sim, past, self._until, self._present)
        place = self._start(past, end, span)
        if place is None:
            sim.restore(here)
            first, acts = end, {}
        else:
            first, acts = sim.frame, past.acts_since(place)
        self._gauges = Gauges(sim, paced=False, every={"state": 1, "margin": 1, "depth": 1})
        before = sim.network()
        wanted = {first + round(k * (end - first) / max(pictures - 1, 1)) for k in range(pictures)}
        self._look(0.0, pictured=first in wanted)
        for frame in range(first, end):
            for act in acts.get(frame, ()):
                do_again(sim, act)
            self._gauges.before_frame()
            sim.advance()
            pictured = frame + 1 in wanted
            late = time.perf_counter() > self._until and frame < end - FEW
            if pictured or not late or frame % FEW == 0:
                self._look(0.0, pictured=pictured)
        depth, push, met = self._gauges.depth, None, NOBODY
        if self._failure is not None:
            if place is not None:
                for act in acts.get(end, ()):
                    do_again(sim, act)
            push = _pushed(sim)
            last, met = sim.network(), _met(sim, self._settings.dt)
            self._steps()
        else:
            last = sim.network()
        told = [act_of(frame, act) for frame, of in acts.items() for act in of]
        return Trace(
            sim.scene.name, self._settings, sim.follows, current_device().precision,
            self._speed_limit, self._failure, self._samples, before, last, push, met,
            [act for act in told if act.frame >= first],
            place is not None and place.checkpoint is None and first == place.frame,
            depth, self._work.unconverged, self._work.steps, self._outcome, broke,
            self._pictures,
        )  # fmt: skip

    def _start(self, past: Past, end: int, span: int) -> Place | None:
        """Go to where the trace begins: the place it is reached from; None: there is none."""
        places = past.places()
        early = [place for place in places if place.frame <= end - span]
        place = early[-1] if early else (places[0] if places else None)
        if place is None:
            return None
        sim, acts = self._sim, past.acts_since(place)
        go_to(sim, place)
        while sim.frame < end - span:
            for act in acts.pop(sim.frame, ()):
                do_again(sim, act)
            stops = [frame for frame in acts if frame > sim.frame]
            sim.advance(min([end - span - sim.frame, BATCH, *(s - sim.frame for s in stops)]))
            if time.perf_counter() > self._until and sim.frame < end - span:
                return None
        return place

    def _present(self) -> Sample | None:
        """The simulation's state, as if it began here."""
        self._gauges = Gauges(self._sim, paced=False, every={"state": 1, "margin": 1, "depth": 1})
        self._look(0.0)
        return self._samples.pop() if self._samples else None

    def _steps(self) -> None:
        """The frame that failed, step by step as far as it goes."""
        sim, n = self._sim, self._settings.substeps
        self._gauges.before_frame()
        self._look(1e-9)
        if sim.follows:
            return
        parts = min(n, MOST_STEPS)
        with suppress(SimulationFailure):
            for k in range(parts):
                steps = (k + 1) * n // parts - k * n // parts
                sim.set_step(self._settings.dt * steps / n, steps)
                sim.advance()
                self._look((k + 1) / parts)
                if not self._samples[-1].speed <= self._speed_limit:
                    break

    def _look(self, part: float, pictured: bool = False) -> None:
        """Read the present state. part: of the frame that failed."""
        sim = self._sim
        with suppress(np.linalg.LinAlgError, ValueError):  # of numbers that overflow
            self._gauges.after_frame(sim.time)
        state, margin, v = self._gauges.state, self._gauges.margin, sim.velocities()
        if state is None or margin is None:
            return
        speed = np.sqrt((v * v).sum(axis=1))
        fastest = int(np.where(np.isnan(speed), np.inf, speed).argmax()) if len(speed) else -1
        energy, frame = state.booked.energy, self._samples[-1].frame if part else sim.frame
        limit = margin.limit
        self._samples.append(
            Sample(
                sim.time, frame, part, energy.total, energy.kinetic + energy.elastic,
                state.booked.drift, state.booked.work, state.booked.by_hand,
                margin.reach, margin.used, sim.method, margin.step, limit,
                self._gauges.mode.shares, *_numbers(self._gauges.network, limit.spring),
                state.strain, state.spring, state.ends,
                float(speed[fastest]) if fastest >= 0 else 0.0, fastest, state.broken,
            )
        )  # fmt: skip
        if pictured and self._draw is not None:
            self._pictures.append((sim.frame, self._draw()))


def _pushed(sim: Simulation) -> np.ndarray | None:
    """Pushes on each particle from outside, a blow or a hold, (n, dim); None: none."""
    push, hold = sim.storage.held(), sim.held()
    if hold is None or not len(hold.particles):
        return push
    x = sim.positions().astype(np.float64)
    force = np.zeros_like(x) if push is None else push.astype(np.float64)
    force[hold.particles] += hold.stiffness[:, None] * (hold.targets - x[hold.particles])
    return force


def _met(sim: Simulation, dt: float) -> tuple[str, int, float]:
    """The fastest obstacle that particles meet in the next frame, as `Trace.met` has it."""
    found, x = NOBODY, sim.positions().astype(np.float64)
    if not len(x):
        return found
    solids, carried, begin = sim.storage.solids, sim.storage.carried(), sim.time
    for index, solid in enumerate(solids):
        if not solid.moving:
            continue
        for now in (begin, begin + 0.999 * dt):
            speed = np.linalg.norm(solid.velocities(x - solid.pose(now)[0], now), axis=1)
            near = solid.distances(x, now)[0] <= speed * dt + sim.storage.scene.particles.radius
            there = np.where(near & ~sim.fixed() | (carried == index), speed, 0.0)
            if there.max() > found[2]:
                found = solid.name, int(there.argmax()), float(there.max())
    return found


def _numbers(network: Network, spring: int) -> tuple[float, tuple[float, ...]]:
    """Stiffness and inverse masses of a spring by its number; 0.0 and () where there is none."""
    at = np.flatnonzero(network.number == spring)
    if not len(at):
        return 0.0, ()
    inverse = inverse_masses(network.particles, network.springs.between[at[0]])
    return float(network.springs.stiffness[at[0]]), tuple(inverse.tolist())


def inverse_masses(particles: Particles, of: np.ndarray) -> np.ndarray:
    """The inverse masses of some particles; 0 of fixed ones."""
    fixed, mass = particles.fixed[of], particles.mass[of]
    inverse: np.ndarray = np.where(fixed, 0.0, 1.0 / mass)
    return inverse
