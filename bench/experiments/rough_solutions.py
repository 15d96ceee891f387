"""Time and error of implicit steps by tolerance, beside explicit ones of the same cloth.

    python -m bench.experiments.rough_solutions [--threads N]

Warp's cloth of 64 x 64 particles without dashpots, f32, in lanes, 29 frames of 1/60 s from its
start, at so many times its stiffness. Each setting is timed by turns in one process, from the same
start; a line says the median of ROUNDS, in ms a frame, and the root of the mean square distance of
a particle from a run of `verlet` in f64 at fine steps, over all frames, in parts of the largest
displacement. Explicit steps are the fewest that are stable.
"""

import argparse
import time
from typing import Any

import numpy as np

from bench.equal_error.problems import warp
from taichi_cloth import runtime
from taichi_cloth.errors import SimulationFailure
from taichi_cloth.scene.model import Scene
from taichi_cloth.simulation.simulation import Simulation

SIDE, FRAMES, ROUNDS = 64, 29, 9
OF_WARP = 8  # dt * omega of a frame of Warp's own cloth
SIZES = (80, 110, 160, 253, 320, 480, 800)  # of dt * omega, a frame
IMPLICIT = "implicit_midpoint"
TOLERANCES = (1e-6, 1e-2, 0.3, 1.0)
FINER = 32  # times as many steps has the reference as the fewest that are stable
WAY: dict[str, Any] = {"topology": "lanes", "lanes": 8}


def run(sim: Simulation) -> np.ndarray:
    """Positions at the end of each frame from the scene's start, (FRAMES, n, 3)."""
    sim.reset()
    places = []
    for _ in range(FRAMES):
        sim.advance()
        places.append(sim.positions())
    return np.array(places)


def seconds(sim: Simulation) -> float:
    """Of a frame."""
    sim.reset()
    sim.advance(0)
    begun = time.perf_counter()
    sim.advance(FRAMES)
    sim.positions()
    return (time.perf_counter() - begun) / FRAMES


def fewest(scene: Scene, about: int) -> Simulation:
    """`verlet` with the fewest substeps that are stable, from so many on."""
    while True:
        sim = Simulation(scene, "verlet", substeps=about, **WAY)
        try:
            run(sim)
            return sim
        except SimulationFailure:
            about += 1


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--threads", type=int, default=1)
    given = parser.parse_args()
    WAY["execution"] = "serial" if given.threads == 1 else "parallel"
    for size in SIZES:
        scene = warp(SIDE, (size / OF_WARP) ** 2, damped=False)
        runtime.start("cpu", "f64", threads=given.threads)
        substeps = FINER * size // 3
        truth = run(Simulation(scene, "verlet", substeps=substeps, **WAY))
        away = np.linalg.norm(truth - scene.particles.position, axis=2).max()
        runtime.start("cpu", "f32", threads=given.threads)
        sims = {"verlet": fewest(scene, size // 3)}
        for tolerance in TOLERANCES:
            sims[f"{IMPLICIT}, {tolerance:g}"] = Simulation(
                scene, IMPLICIT, substeps=1, tolerance=tolerance, **WAY
            )
        apart = {}
        for name, sim in sims.items():
            free = ~scene.particles.fixed
            squares = ((run(sim) - truth)[:, free] ** 2).sum(axis=2)
            apart[name] = np.sqrt(squares.mean()) / away
        taken: dict[str, list[float]] = {name: [] for name in sims}
        for _ in range(ROUNDS):
            for name, sim in sims.items():
                taken[name].append(seconds(sim))
        for name, sim in sims.items():
            ms = 1e3 * float(np.median(taken[name]))
            steps = f"{sim.substeps} substeps" if sim.substeps > 1 else "1 substep"
            missed = sim.work().unconverged
            print(
                f"{size:4d}  {name:24s} {steps:12s} {ms:6.3f} ms  error {apart[name]:.1e}"
                f"  {missed} missed",
                flush=True,
            )


if __name__ == "__main__":
    main()
