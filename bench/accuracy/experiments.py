"""Experiments of `docs/accuracy.md` on each method: orders, damping, costs, long runs, events.

Nothing here knows a method by its name, but the one that others are compared to: the program's own
default. Errors are measured in f64, in the process of the caller; times in workers of their own.
"""

from __future__ import annotations

import json
import statistics
import tempfile
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from taichi_cloth import runtime
from taichi_cloth.kernels import methods
from taichi_cloth.kernels.methods.contract import Method
from taichi_cloth.measuring.timing import quartiles, turns
from taichi_cloth.measuring.worker import Worker
from taichi_cloth.scene import library
from taichi_cloth.scene.model import (
    ParticleDefaults,
    Particles,
    Scene,
    SpringDefaults,
    Springs,
    World,
)
from taichi_cloth.settings.options import RunOptions, parameters_of
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.trade.reference import coarsest, fine_method
from taichi_cloth.trade.settings import CONVERGED_TOLERANCE

DEFAULT = parameters_of(RunOptions)["method"].default
RATE = 60  # steps a second, of the damping
FREQUENCIES = (1.0, 2.0, 5.0, 10.0)  # Hz
SWEEPS = 64  # enough for what is not stiff to converge
ON_GRAPH: dict[str, Any] = {"topology": "graph", "execution": "serial"}


def solved(method: str) -> dict[str, Any]:
    """Settings with which a method's solver leaves nothing but rounding, on scenes not stiff."""
    exact = {"tolerance": CONVERGED_TOLERANCE, "iterations": SWEEPS}
    return {name: exact[name] for name in methods.load(method).claims.settings}


# ------------------------------------------------------------------------------------------
# Orders

ORDER_FRAMES = 16
MOST_HALVINGS = 7
LEAST_ERROR = 1e-10  # of the largest one: rounding spoils what is smaller


def orders(names: Sequence[str] = methods.METHODS) -> dict[str, dict[str, float]]:
    """The order by which the error falls, of each method: on a linear chain, against the closed
    form, and on the nonlinear cloth of 8 x 8, against the reference method at a fine step.
    """
    chain = library.build("chain", particles=8)
    cloth = library.build("cloth", columns=8, rows=8).with_world(mouse="none", walls=())
    times = np.arange(ORDER_FRAMES + 1) * chain.world.dt
    closed = library.solution("chain")
    assert closed
    exact = {
        "chain": (chain, closed(chain, times)[0][1:]),
        "cloth": (cloth, _fine(cloth, ORDER_FRAMES)),
    }
    found: dict[str, dict[str, float]] = {name: {} for name in names}
    for of, (scene, x) in exact.items():
        for name in names:
            found[name][of] = _order(scene, name, x)
    return found


def _order(scene: Scene, method: str, exact: np.ndarray) -> float:
    """The order by the finest two of steps that halve, whose errors are no rounding."""
    sim = Simulation(scene, method, **ON_GRAPH, **solved(method))
    errors: list[float] = []
    for halvings in range(2, MOST_HALVINGS + 1):
        x = trajectory(sim, len(exact), 2**halvings)
        errors.append(_rms(x, exact))
        if errors[-1] < LEAST_ERROR * _rms(exact, exact[:1]):
            errors.pop()
            break
    return float(np.log2(errors[-2] / errors[-1]))


def trajectory(sim: Simulation, frames: int, substeps: int) -> np.ndarray:
    """Positions at the ends of frames, (frames, n, dim), from the scene's start."""
    sim.set_step(substeps=substeps)
    sim.reset()
    found = []
    for _ in range(frames):
        sim.advance()
        found.append(sim.positions())
    return np.array(found)


def _fine(scene: Scene, frames: int, finer: int = 8) -> np.ndarray:
    """Positions at the ends of frames by the method of the references at a fine step."""
    sim = Simulation(scene, fine_method(), **ON_GRAPH)
    return trajectory(sim, frames, finer * coarsest(scene, scene.world.dt))


def _rms(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.sqrt(((a - b) ** 2).sum(axis=-1).mean()))


# ------------------------------------------------------------------------------------------
# Damping

SMALL, LARGE = 0.01, 50.0  # displacements, of a spring of length 150


@dataclass(frozen=True)
class Swing:
    """The damping of a vibration in a second: the part of its amplitude left, and by which part
    its frequency is too high.
    """

    kept: float
    pitch: float


def swing(module: Method, frequency: float, rate: float = RATE) -> Swing:
    """The swing by the method's own theory, on x'' = -omega^2 x at `rate` steps a second.

    module: of `kernels.methods`, with `stability_function` or `amplification`.
    """
    h, omega = 1 / rate, 2 * np.pi * frequency
    if module.stability_function:
        factor = complex(module.stability_function(1j * h * omega))
    else:
        assert module.amplification  # one of the two, by the contract
        eigenvalues = np.linalg.eigvals(module.amplification(h, omega**2, 0.0))
        factor = complex(max(eigenvalues, key=lambda z: (round(abs(z), 12), z.imag)))
    return Swing(abs(factor) ** rate, float(abs(np.angle(factor))) / (h * omega) - 1)


def measured_swings(method: str, frequencies: Sequence[float], rate: int = RATE) -> list[Swing]:
    """The swings by runs of one second of the scene `oscillator`, with these frequencies [Hz].

    A step is a linear map of (x, v), so positions follow x[n+1] = trace x[n] - det x[n-1]; both are
    fitted to a run, and the map's eigenvalues, a step's decay and angle, are theirs.
    """
    sim = None
    swings = []
    for frequency in frequencies:
        omega = 2 * np.pi * frequency
        scene = library.build("oscillator", stiffness=omega**2, amplitude=SMALL)
        if sim is None:
            sim = Simulation(scene, method, dt=1 / rate, **ON_GRAPH, **solved(method))
        sim.load_scene(scene, dt=1 / rate)
        run = [SMALL]
        # What grows without limit ends where the spring would pass its other end.
        while sim.frame < rate and abs(run[-1]) < LARGE:
            sim.advance()
            run.append(sim.positions()[1, 0] - _at_rest(scene))
        x = np.array(run)
        terms = np.stack([x[1:-1], -x[:-2]], axis=1)
        (trace, det), *_ = np.linalg.lstsq(terms, x[2:], rcond=None)
        angle = np.angle(trace / 2 + np.sqrt(complex(trace * trace / 4 - det)))
        swings.append(Swing(float(det ** (rate / 2)), float(abs(angle) * rate / omega - 1)))
    return swings


def _at_rest(oscillator: Scene) -> float:
    """The place where the mass of the scene `oscillator` rests."""
    return float(oscillator.particles.position[0, 0] + oscillator.springs.rest_length[0])


def damping(names: Sequence[str] = methods.METHODS) -> dict[str, dict[str, dict[str, float]]]:
    """The measured swing of each method at some frequencies [Hz]."""
    found = {}
    for name in names:
        swings = zip(FREQUENCIES, measured_swings(name, FREQUENCIES), strict=True)
        found[name] = {f"{frequency:g}": vars(of) for frequency, of in swings}
    return found


# ------------------------------------------------------------------------------------------
# Long runs

PERIODS = 100
AFTER = sorted({round(k) for k in np.geomspace(1, PERIODS - 1, 40)})  # of these


def long_runs(names: Sequence[str] = methods.METHODS) -> dict[str, Any]:
    """The scene `oscillator` at its own step for many periods: by period the largest error of its
    energy until then, in parts of it, and by how many degrees it is behind or ahead. Those that
    grow too large for it end before.
    """
    scene = library.build("oscillator")
    omega = float(np.sqrt(scene.springs.stiffness[0] / scene.particles.mass[1]))
    at_rest = _at_rest(scene)
    amplitude = scene.particles.position[1, 0] - at_rest
    period = 2 * np.pi / omega
    found: dict[str, Any] = {"step_times_omega": omega * scene.world.dt, "methods": {}, "ended": []}
    for name in names:
        sim = Simulation(scene, name, **ON_GRAPH, **solved(name))
        run = [complex(amplitude)]
        # Beyond its rest length the spring would turn over.
        while sim.time < PERIODS * period and abs(run[-1]) < scene.springs.rest_length[0]:
            sim.advance()
            x, v = sim.positions()[1, 0] - at_rest, sim.velocities()[1, 0]
            run.append(complex(x, -v / omega))
        if sim.time < PERIODS * period:
            found["ended"].append(name)
        z = np.array(run)
        times = np.arange(len(z)) * scene.world.dt
        energy = np.maximum.accumulate(np.abs(np.abs(z / amplitude) ** 2 - 1))
        # Behind or ahead: the mean over a period, in which the speed of turning varies.
        phase = np.degrees(np.unwrap(np.angle(z)) - omega * times)
        of_period = np.floor(times / period).astype(int)
        whole = [k for k in AFTER if k < of_period[-1]]
        found["methods"][name] = {
            "period": whole,
            "energy": [float(energy[of_period == k].max()) for k in whole],
            "phase": [
                float(phase[of_period == k].mean() - phase[of_period == 0].mean()) for k in whole
            ],
        }
    return found


# ------------------------------------------------------------------------------------------
# Events

EVENT_FRAMES = 24
EVENT_SUBSTEPS = tuple(2**k for k in range(1, 8))
MANY = 24  # of everything, so that the moment of an event within its step is averaged


def _apart(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Places far from each other, and a number in 0..1 for each, spread evenly."""
    column = np.arange(count)
    return 40.0 * (column + 1), ((column + 1) * 0.6180339887) % 1


def events() -> dict[str, Scene]:
    """Scenes of many that do not know of each other: nothing happens to them, they hit the floor,
    they collide in pairs, their springs break.
    """
    place, part = _apart(MANY)
    width = float(place[-1] + 40)
    high = np.full(MANY, 100.0)
    world = World(size=(width, 400.0), gravity=(0.0, 0.1), dt=1.0)
    top, hanging = np.stack([place, high], axis=1), np.stack([place, high + 30 + 10 * part], axis=1)
    spring = SpringDefaults(stiffness=0.05, rest_length=25.0)
    pairs = np.stack([np.arange(MANY), MANY + np.arange(MANY)], axis=1)
    fixed = np.arange(2 * MANY) < MANY

    def swinging(**of_springs: Any) -> Scene:
        x = np.concatenate([top, hanging])
        v = np.concatenate([0 * top, np.stack([0.6 * part + 0.4, 1 + part], axis=1)])
        springs = Springs.build(pairs, x, defaults=spring, **of_springs)
        particles = Particles.build(x, v, fixed=fixed)
        return Scene("swinging", world, particles, springs)

    def falling(**of_world: Any) -> Scene:
        floor = np.stack([place, 350.0 - 20 * part], axis=1)
        v = np.stack([0 * part, 2 + part], axis=1)
        particle = ParticleDefaults(radius=5.0, restitution=0.9, viscous=0.02)
        return Scene(
            "falling", replace(world, **of_world), Particles.build(floor, v, defaults=particle)
        )

    def meeting(**of_world: Any) -> Scene:
        rows = 100 + 12.0 * np.arange(MANY)
        left, right = (
            np.stack([0 * part + 100, rows], axis=1),
            np.stack([part * 20 + 130, rows], axis=1),
        )
        v = np.concatenate([np.stack([2 + part, 0 * part], axis=1), 0 * right])
        x = np.concatenate([left, right])
        particle = ParticleDefaults(radius=5.0, restitution=0.9, viscous=0.02)
        here = replace(world, gravity=(0.0, 0.0), size=(width, 500.0), **of_world)
        return Scene("meeting", here, Particles.build(x, v, defaults=particle))

    return {
        "nothing": swinging(),
        "floor": falling(walls=("bottom",)),
        "pairs": meeting(collisions=True),
        "breaks": swinging(break_force=0.05 * (6.0 + 8.0 * part)),
    }


def orders_with_events(names: Sequence[str] = methods.METHODS) -> dict[str, dict[str, float]]:
    """The order of each method that is left where something happens within the run: the slope of a
    line through the errors at the last frame.
    """
    found: dict[str, dict[str, float]] = {name: {} for name in names}
    for event, scene in events().items():
        fine = Simulation(scene, fine_method(), **ON_GRAPH)
        exact = trajectory(fine, EVENT_FRAMES, 64 * EVENT_SUBSTEPS[-1])[-1]
        for name in names:
            sim = Simulation(scene, name, **ON_GRAPH, **solved(name))
            points = []
            for substeps in EVENT_SUBSTEPS:
                error = _rms(trajectory(sim, EVENT_FRAMES, substeps)[-1], exact)
                if error > 1e-9:
                    points.append((np.log2(substeps), np.log2(error)))
            halvings, errors = np.array(points).T
            found[name][event] = float(-np.polyfit(halvings, errors, 1)[0])
    return found


# ------------------------------------------------------------------------------------------
# Costs

ROUNDS = 9
COST_FRAMES = 60
LEAST_SECONDS = 0.03  # of a timed run, so that the clock and the launch do not count


class Turns:
    """All methods on one scene, in a worker, which run in turns.

    scene: parameters of the scene `cloth`.
    """

    def __init__(
        self,
        scene: dict[str, Any],
        names: Iterable[str],
        topology: str,
        execution: str,
        precision: str,
    ):
        device = runtime.start("cpu", precision)
        built = library.build("cloth", **scene).with_world(mouse="none")
        self._sims = {
            name: Simulation(built, name, topology=topology, execution=execution) for name in names
        }
        self.about = {"device": device.describe(), "threads": device.threads}

    def race(self, rounds: int) -> dict[str, list[float]]:
        """Seconds a step of each method by round, each from the scene's start."""
        found: dict[str, list[float]] = {name: [] for name in self._sims}
        for number, (name, sim) in turns(list(self._sims.items()), rounds):
            seconds = _seconds_a_step(sim)
            if number > 0:
                found[name].append(seconds)
        return found


def _seconds_a_step(sim: Simulation) -> float:
    """The mean over runs from the scene's start that take LEAST_SECONDS together."""
    spent, steps = 0.0, 0
    while spent < LEAST_SECONDS:
        sim.reset()
        begin = time.perf_counter()
        sim.advance(COST_FRAMES)
        spent += time.perf_counter() - begin
        steps += COST_FRAMES
    return spent / steps


COSTS: dict[str, dict[str, Any]] = {
    "small": {
        "scene": {},
        "topology": "graph",
        "execution": "serial",
    },
    "large": {
        "scene": {"columns": 64, "rows": 64},
        "topology": "lanes",
        "execution": "serial",
    },
}


def costs(names: Sequence[str] = methods.METHODS, rounds: int = ROUNDS) -> dict[str, Any]:
    """A step's seconds of each method, also in parts of the default's of the same round."""
    found: dict[str, Any] = {}
    for which, how in COSTS.items():
        with tempfile.TemporaryDirectory() as folder:
            worker = Worker(Path(folder), {})
            try:
                wanted = {"names": list(names), "precision": "f32", **how}
                about = worker.ask(make=f"{__name__}:Turns", **{"as": which, "with": wanted})
                times = worker.ask(of=which, do="race", **{"with": {"rounds": rounds}})["result"]
            finally:
                worker.close()
        ratios = {
            name: [a / b for a, b in zip(of, times[DEFAULT], strict=True)]
            for name, of in times.items()
        }
        found[which] = {
            "about": about["result"] | how,
            "methods": {
                name: {"seconds": statistics.median(of), "ratio": quartiles(ratios[name])}
                for name, of in times.items()
            },
        }
    as_kept: dict[str, Any] = json.loads(json.dumps(found))
    return as_kept
