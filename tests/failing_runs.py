"""Runs that fail, and runs that do not: whether a post-mortem names the cause, and what survives.

    python tests/failing_runs.py [f32|f64] [NAME ...]

The cause is known by how each is made. Prints one result a line, as JSON, and at the end how many
were right; `docs/post-mortem.md` has its table.
"""

import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import extreme_cases as extremes
import numpy as np
from extreme_contacts import CASES as CONTACT_CASES
from extreme_runs import FRAME

from taichi_cloth import runtime
from taichi_cloth.errors import SimulationFailure
from taichi_cloth.kernels import methods
from taichi_cloth.post_mortem.causes import (
    AIR,
    BUCKLING,
    CONTACT,
    DAMPING,
    ENERGY,
    NEVER,
    NOTHING,
    PUSH,
    RANGE,
    SOLVER,
    SPEED,
    STEP,
    TEARING,
)
from taichi_cloth.post_mortem.examine import examine
from taichi_cloth.simulation.simulation import Simulation

EXPLICIT = ("symplectic_euler", "verlet", "rk4")


@dataclass(frozen=True)
class Failing:
    """A run whose end is known by how it is made.

    scene() -> Scene; frame, substeps, frames: its steps. kind: the cause. acts: what is done before
    the frame of a number, act(sim). fails: whether it does. survivable: whether some setting can
    survive at all. spring: the one that is to be named; None: any. solver: of its method.
    """

    name: str
    method: str
    scene: Callable
    frame: float
    substeps: int
    frames: int
    kind: str
    acts: dict = None
    fails: bool = True
    survivable: bool = True
    spring: int | None = None
    solver: dict = None
    room: str = "springs"


def of_extremes(name, kind, wanted, survivable=True):
    """An extreme case under some methods."""
    cases = extremes.CASES | {case.name: case for case in CONTACT_CASES}
    case = cases[name]
    for method in wanted:
        steps = case.steps(methods.load(method), case.scene())
        if steps is not None:
            yield Failing(
                f"{name}/{method}", method, case.scene, steps.frame, steps.substeps,
                steps.frames, kind, survivable=survivable, room=case.kind,
            )  # fmt: skip


def stiff_spring(at=17, stiffness=1e6):
    made = extremes.net()
    k = made.springs.stiffness.copy()
    k[at] = stiffness
    x = extremes.noisy(1e-3)(made.particles.position)
    return extremes.placed(replace(made, springs=replace(made.springs, stiffness=k)), x)


def light_particle(at=12, mass=1e-5):
    made = extremes.net()
    m = made.particles.mass.copy()
    m[at] = mass
    x = extremes.noisy(1e-3)(made.particles.position)
    return extremes.placed(replace(made, particles=replace(made.particles, mass=m)), x)


def shaken(**of):
    return extremes.moved(extremes.noisy(1e-3), **of)


def thrown(speed):
    def build():
        made = extremes.net()
        v = np.zeros_like(made.particles.position)
        v[3, 2] = speed
        return extremes.placed(made, made.particles.position, v)

    return build


def with_gravity(g):
    return lambda: extremes.net(gravity=(0.0, g, 0.0))


def pinned(stiffness):
    """A net with a fixed corner, hanging at rest."""
    fixed = np.zeros(25, bool)
    fixed[[0, 4]] = True
    return lambda: extremes.net(k=stiffness, fixed=fixed)


def crowd():
    """Balls that overlap many times over, in a world so small that their energy loses them."""
    random = np.random.default_rng(5)
    x = 1.0 + 0.003 * random.uniform(-1, 1, (60, 2))
    v = 1e3 * random.standard_normal((60, 2))
    return extremes.contact_scene(x, v, restitution=1.0, size=(2.0, 2.0), radius=0.05)


def torn():
    """A net that hangs by two corners from springs too weak for its weight."""
    made = extremes.hung_net()
    weak = np.full(len(made.springs), 6.0)
    return replace(made, springs=replace(made.springs, break_force=weak))


def column():
    """A column of particles squeezed from above, which gives way sideways."""
    n = 12
    x = np.ones((n, 3)) * [2, 1, 0]
    x[:, 1] = 1 + 0.22 * np.arange(n)
    x[1:-1, 0] += 1e-4 * np.random.default_rng(1).standard_normal(n - 2)
    between = np.column_stack([np.arange(n - 1), np.arange(1, n)])
    fixed = [True, *[False] * (n - 2), True]
    return extremes.scene(x, between, k=100.0, rest=0.25, mass=0.1, fixed=fixed)


def at_rest():
    return extremes.hanging(3, 100.0, 0.1, at_rest=True)


def lighter(sim):
    sim.set(particles=[7], mass=1e-6)


CASES = [
    *of_extremes("limit_1.005", STEP, EXPLICIT),
    *of_extremes("limit_1.005_line", STEP, EXPLICIT),
    *of_extremes("overflowing_speed", SPEED, methods.METHODS, survivable=False),
    *of_extremes("above_the_speed_limit", SPEED, methods.METHODS),
    *of_extremes("overflowing_stiffness", RANGE, (*EXPLICIT, "explicit_euler", "tr_bdf2")),
    *of_extremes("dashpot_too_strong_for_the_step", DAMPING, (*EXPLICIT, "explicit_euler")),
    *of_extremes("implicit_1000s", SOLVER, ("xpbd", "vbd")),
    *of_extremes("wind_of_1e3_m_per_s", AIR, ("symplectic_euler", "verlet")),
    *(
        made
        for method in EXPLICIT
        for made in (
            Failing(f"stiff_spring/{method}", method, stiff_spring, FRAME, 4, 200, STEP, spring=17),
            Failing(f"light_particle/{method}", method, light_particle, FRAME, 8, 200, STEP),
            Failing(f"drag/{method}", method, extremes.dragged, 0.01, 1, 100, DAMPING),
            Failing(
                f"set_stiffness/{method}", method, shaken(), FRAME, 4, 200, STEP,
                acts={20: lambda sim: sim.set(springs=[5], stiffness=1e7)}, spring=5,
            ),
            Failing(
                f"long_steps/{method}", method, shaken(k=1e4), FRAME, 1, 300, STEP
            ),
        )
    ),
    Failing("dashpots_of_a_net", "symplectic_euler", shaken(damping=20.0), FRAME, 2, 300, DAMPING),
    Failing("dashpots_of_a_net/verlet", "verlet", shaken(damping=20.0), FRAME, 2, 300, DAMPING),
    Failing("mass_ratio", "symplectic_euler", lambda: extremes.heavy_below(1e4), FRAME, 8, 9, STEP),
    Failing("explicit_net", "explicit_euler", shaken(), FRAME, 4, 3000, NEVER),
    Failing("explicit_oscillator", "explicit_euler", extremes.oscillator, 0.1, 1, 5000, NEVER),
    Failing("thrown", "symplectic_euler", thrown(1e8), FRAME, 8, 20, SPEED),
    Failing(
        "set_velocity", "symplectic_euler", shaken(), FRAME, 8, 60, SPEED,
        acts={10: lambda sim: sim.set(particles=[4], velocities=[[1e9, 0, 0]])},
    ),
    Failing(
        "blown", "symplectic_euler", shaken(), FRAME, 8, 60, PUSH,
        acts={15: lambda sim: sim.blow_ray([2, 2, 0], [0, 1, 0], [1e12, 0, 0])},
    ),
    Failing(
        "held_force", "verlet", shaken(), FRAME, 8, 60, PUSH,
        acts={5: lambda sim: sim.hold(np.full((25, 3), 1e9))},
    ),
    Failing("gravity_of_1e10", "symplectic_euler", with_gravity(1e10), FRAME, 8, 60, PUSH),
    Failing(
        "pin_moved_far", "symplectic_euler", pinned(1e8), FRAME, 2048, 30, ENERGY,
        acts={5: lambda sim: sim.set(particles=[0], positions=[[999.0, 999.0, 499.0]])},
    ),
    Failing(
        "set_mass", "symplectic_euler", shaken(), FRAME, 8, 100, STEP, acts={30: lighter},
    ),
    Failing(
        "spring_added", "symplectic_euler", shaken(), FRAME, 8, 100, STEP,
        acts={10: lambda sim: sim.add_spring(0, 24, stiffness=1e7)},
    ),
    Failing(
        "one_sweep", "xpbd", extremes.hung_net, 100.0, 1, 100, SOLVER, solver={"iterations": 1}
    ),
    Failing("overlapping_crowd", "symplectic_euler", crowd, FRAME, 2, 200, CONTACT, room="contact"),
    Failing("tearing", "symplectic_euler", torn, FRAME, 16, 120, TEARING, fails=False),
    Failing("tearing/verlet", "verlet", torn, FRAME, 16, 120, TEARING, fails=False),
    Failing("buckling", "symplectic_euler", column, FRAME, 16, 120, BUCKLING, fails=False),
    Failing("buckling/rk4", "rk4", column, FRAME, 16, 120, BUCKLING, fails=False),
    Failing("squeezed_net", "symplectic_euler", extremes.moved(lambda x: 0.9 * x), FRAME, 16, 3,
            BUCKLING, fails=False),
    Failing("calm", "symplectic_euler", at_rest, FRAME, 16, 60, NOTHING, fails=False),
]  # fmt: skip


class Runner:
    """Runs them, those of one method and kind in one simulation."""

    def __init__(self, seconds):
        self._sims, self._seconds = {}, seconds

    def _started(self, case):
        key = case.method, case.room
        if key not in self._sims:
            self._sims.clear()  # fields of many simulations take room
            self._sims[key] = Simulation(
                extremes.KINDS[case.room](), case.method, topology="graph", execution="serial"
            )
        sim = self._sims[key]
        if sim.method != case.method:
            sim.set_method(case.method)
        sim.load_scene(case.scene(), case.frame, case.substeps)
        if case.solver:
            sim.set_solver(**case.solver)
        return sim

    def run(self, case):
        """What came of a case, as a dict."""
        sim, failure, began = self._started(case), None, time.perf_counter()
        try:
            while sim.frame < case.frames:
                if case.acts and sim.frame in case.acts:
                    case.acts[sim.frame](sim)
                stops = [f for f in case.acts or () if f > sim.frame]
                sim.advance(min([case.frames, *stops]) - sim.frame)
        except SimulationFailure as error:
            failure = error
        x = sim.positions()
        found = examine(sim, seconds=self._seconds)
        same = np.array_equal(x, sim.positions(), equal_nan=True)
        best = found.search.best
        right = found.cause.kind == case.kind and (failure is not None) == case.fails
        if case.spring is not None:
            right &= found.cause.spring == case.spring
        survives = (best is not None) == (case.survivable and case.fails)
        return {
            "case": case.name, "failed": str(failure)[:200] if failure else "", "kind": case.kind,
            "found": found.cause.kind, "right": bool(right), "survives": bool(survives),
            "remedy": found.remedy, "says": found.cause.says, "proof": found.cause.proof,
            "trials": len(found.search.trials), "search": found.search.says, "same": bool(same),
            "seconds": round(time.perf_counter() - began, 1),
        }  # fmt: skip


def main(words):
    precision = words.pop(0) if words and words[0] in ("f32", "f64") else "f32"
    np.seterr(all="ignore")
    runtime.start("cpu", precision, threads=1)
    runner, results = Runner(seconds=15.0), []
    for case in sorted(CASES, key=lambda case: (case.room != "springs", case.room, case.method)):
        if not words or any(word in case.name for word in words):
            results.append(runner.run(case))
            print(json.dumps(results[-1]), flush=True)
    print(table(results))


def table(results):
    """How many were right, by cause, for a document."""
    head = "| cause | runs | cause right | setting survives |\n|---|---|---|---|\n"
    rows = []
    for group in (True, False):
        chosen = [r for r in results if bool(r["failed"]) == group]
        for kind in dict.fromkeys(r["kind"] for r in chosen):
            rows.append(_row(kind, [r for r in chosen if r["kind"] == kind], group))
        if chosen:
            rows.append(_row("**all that fail**" if group else "**go on**", chosen, group))
    return head + "\n".join(rows)


def _row(name, of, failing):
    survive = sum(r["survives"] for r in of) if failing else ""
    return f"| {name} | {len(of)} | {sum(r['right'] for r in of)} | {survive} |"


if __name__ == "__main__":
    main(sys.argv[1:])
