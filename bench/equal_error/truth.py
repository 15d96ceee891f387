"""The one reference that all solvers of a scene are compared to (`trade.reference`)."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from bench.equal_error.problems import Problem
from taichi_cloth.console import Tell
from taichi_cloth.sweeps.journal import Journal, key_of
from taichi_cloth.trade.conditions import RunConditions
from taichi_cloth.trade.errors import Samples, distance
from taichi_cloth.trade.reference import coarsest, fine_method
from taichi_cloth.trade.runner import Study
from taichi_cloth.trade.settings import Setting

ANOTHER = "verlet"  # which confirms where there are contacts,
OTHER_FINER = 16  # at steps so many times finer than the coarsest of the reference's runs


@dataclass(frozen=True)
class Truth:
    """States at the ends of frames, and what they are worth.

    what: where they come from, and what confirms them. scale: the largest displacement of a
    particle, to which errors are relative. floor: the least error, in parts of it, that they can
    tell from none. speed: the largest of a particle at the end of a frame.
    """

    samples: Samples
    free: np.ndarray
    what: str
    scale: float
    floor: float
    speed: float

    @property
    def frames(self) -> int:
        return len(self.samples) - 1

    def error_of(self, run: Samples) -> float | None:
        """Root of the mean square distance of a particle over all frames, in parts of the scale.

        None where the run is not as long, or not finite.
        """
        if len(run) != len(self.samples) or not np.isfinite(run.x).all():
            return None
        with np.errstate(over="ignore"):
            error = distance(run, self.samples, self.free).trajectory / self.scale
        return error if np.isfinite(error) else None


TOLD = tuple(f.name for f in fields(Truth) if f.name not in ("samples", "free"))


def truth_of(problem: Problem, patience: float, tell: Tell, journal: Journal) -> Truth | str:
    """The reference of a problem, or why there is none: from the journal, where it has it."""
    key = key_of("truth", problem.digest)
    entry = journal.get(key)
    if entry is not None and entry.file is not None:
        free = ~problem.scene.particles.fixed
        return Truth(Samples.read(entry.file), free, **entry.result)
    truth = compute(problem, patience, tell, journal)
    if isinstance(truth, Truth):
        states = truth.samples
        with journal.written(".npz") as file:
            np.savez(file, x=states.x, v=states.v, alive=states.alive, contacts=states.contacts)
        journal.add(key, {name: getattr(truth, name) for name in TOLD}, file)
    return truth


def compute(problem: Problem, patience: float, tell: Tell, journal: Journal) -> Truth | str:
    """The reference of a problem, or why there is none.

    DOP853 at a tolerance of 1e-13, confirmed by ours of the highest order in f64 at fine steps, or
    that alone, confirmed by steps four times as long, where the former takes too long; both over as
    many of the frames as round-off leaves alone. Where there are contacts, no solution is smooth:
    there it is ours at fine steps, confirmed by steps four times as long and by ANOTHER method, and
    the floor is not below what that differs by. patience: seconds for each of them. journal: has
    the runs that are finished, and gets them.
    """
    scene = problem.scene
    # What a study compares is of no interest here: one run, beside its references.
    asked = [Setting(fine_method(), scene.world.dt, 1)]
    if problem.touching:
        asked = [Setting(ANOTHER, scene.world.dt, OTHER_FINER * coarsest(scene, scene.world.dt))]
    how = RunConditions("lanes", "serial", threads=1, budget=0.0, patience=patience, accounts=False)
    study = Study([scene], asked, problem.frames, how, journal=journal)
    study.tell = lambda text, done, total: tell(f"{problem.name}: reference: {text}", done, total)
    try:
        (result,) = study.run()
        if result.interrupted:
            raise result.interrupted
        found, horizon = result.reference, result.horizon
        if found is None or horizon is None:
            return "no reference could be computed"
        floor = found.floor(horizon) / horizon.scale
        apart = found.apart.trajectory / horizon.scale
        what = f"{found.what}, confirmed by {found.against} to {apart:.1e}"
        free = ~scene.particles.fixed
        if problem.touching:
            (other,) = result.outcomes
            if not other.ok:
                return f"its reference is not confirmed: {other.setting.describe()} {other.status}"
            beside = distance(other.samples(), found.samples, free).trajectory / horizon.scale
            floor = max(floor, beside)
            what += f", and by {ANOTHER} with {other.setting.substeps} substeps to {beside:.1e}"
        speed = float(np.linalg.norm(found.samples.v[:, free], axis=2).max())
        return Truth(found.samples.first(horizon.frames), free, what, horizon.scale, floor, speed)
    finally:
        study.close()
