"""Breaks in a run that goes on, and whether a step was too long then: it is made again.

The frames that `trace` reads are the last ones, and what tore may have torn long before.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from taichi_cloth.kernels import methods
from taichi_cloth.limits.modes import growth
from taichi_cloth.post_mortem.done import SETTING, act_of, cut_by
from taichi_cloth.post_mortem.sample import Sample
from taichi_cloth.simulation.acts import do_again
from taichi_cloth.simulation.past import Past, go_to

if TYPE_CHECKING:
    from taichi_cloth.simulation.simulation import Simulation

BATCH = 50  # frames that are made at once where nothing breaks
MUCH = 4.0  # times: a vibration that grew by that since the start is what springs break of


@dataclass(frozen=True)
class Torn:
    """Springs that broke and were not cut, in the whole run, or as far back as it is known.

    count: how many. before: of them, as many as broke while no step was too long, as far as there
    was time to look. first: the frame in which the first one broke, and its number; None: it was
    not found. sample: how the run stood before the first frame in which springs broke as a step
    was too long; None: there was none. since: when that began, in words.
    """

    count: int
    before: int = 0
    first: tuple[int, int] | None = None
    sample: Sample | None = None
    since: str = ""


def torn(sim: Simulation, past: Past, until: float, read: Callable[[], Sample | None]) -> Torn:
    """Find what broke up to the present frame; the simulation is in its past afterwards.

    until: when there is no more time, by the clock. read: how the simulation stands.
    """
    places = past.places()
    if not places:
        return Torn(0)
    end, broken = sim.frame, sim.storage.count_broken()
    cut = {
        spring for acts in past.acts_since(places[0]).values() for a in acts for spring in cut_by(a)
    }
    go_to(sim, places[0])
    count = broken - sim.storage.count_broken() - len(cut)
    if count <= 0:
        return Torn(0)
    again = _Again(sim, past.acts_since(places[0]), count, read)
    again.whole = places[0].checkpoint is None
    found = None
    while found is None and sim.frame < end and time.perf_counter() < until:
        found = again.advance(end)
    return found or Torn(count, again.before, again.first)


class _Again:
    """Makes a run again, frame by frame where something breaks.

    acts: what is done, by frames. count: of what broke. whole: whether it begins at the start.
    before: how many springs broke so far, none of them by a step that was too long. first: of the
    first one the frame and its number.
    """

    def __init__(
        self,
        sim: Simulation,
        acts: dict[int, list[bytes]],
        count: int,
        read: Callable[[], Sample | None],
    ) -> None:
        self._sim, self._acts, self._count, self._read = sim, acts, count, read
        self.whole, self.before = False, 0
        self.first: tuple[int, int] | None = None
        self._since, self._began = "", False

    def advance(self, end: int) -> Torn | None:
        """Make frames up to the next act; what broke, where a step was too long for it."""
        sim = self._sim
        self._act()
        stops = [frame - sim.frame for frame in self._acts if frame > sim.frame]
        here, had = sim.checkpoint(), sim.storage.count_broken()
        frames = min([end - sim.frame, BATCH, *stops])
        sim.advance(frames)
        if sim.storage.count_broken() == had:
            return None
        sim.restore(here)
        for _ in range(frames):
            sample, had, held = self._read(), sim.storage.count_broken(), sim.springs_alive()
            long = sample is not None and _too_long(sample, sim.steps)
            sim.advance()
            broke = sim.storage.count_broken() - had
            if broke and self.first is None:
                self.first = sim.frame, int((held & ~sim.springs_alive()).argmax())
            if broke and long and sample is not None:
                since = self._since or f"at frame {sample.frame}, in which springs broke"
                return Torn(self._count, self.before, self.first, sample, since)
            self.before += broke
        return None

    def _act(self) -> None:
        """Do what was done before the next frame, and see whether the step is too long since."""
        sim, done = self._sim, self._acts.get(self._sim.frame, ())
        for act in done:
            do_again(sim, act)
        told = [act for act in (act_of(sim.frame, a) for a in done) if act.name in SETTING]
        if self._began and not told:
            return
        sample = self._read()
        if sample is None or not sample.limit.dt < sample.h:
            self._since = ""
        elif not self._since and told:
            last = f"{told[-1].words} at frame {sim.frame}"
            self._since = f"from frame {sim.frame + 1} on, since {last}"
        elif not self._since and self.whole:
            self._since = "from the start"
        self._began = True


def _too_long(sample: Sample, steps: int) -> bool:
    """True if a step is beyond its limit; of a method that makes every vibration grow, whether in
    so many steps that has become much.
    """
    limit, method = sample.limit, methods.load(sample.method)
    if method.claims.stability_limit > 0 or not limit.dt < sample.h:
        return limit.dt < sample.h
    grows = growth(method, sample.h, limit.omega2, limit.damping)
    return steps * math.log(max(grows, 1.0)) > math.log(MUCH)
