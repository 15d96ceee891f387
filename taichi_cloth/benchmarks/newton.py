"""Newton's semi-implicit and XPBD solvers, with springs only, on Warp's cloth.

The semi-implicit solver integrates the same equations as ours; XPBD solves each spring as a
constraint with its stiffness as compliance, twice a step (its default), so its error is its own.
Both are the installed `newton`, with its contacts off; on the CPU it has one thread.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from taichi_cloth.benchmarks import ours
from taichi_cloth.benchmarks.cloths import WARP, WARP_FRAME, WARP_SUBSTEPS
from taichi_cloth.benchmarks.contest import Bench, Contestant, compare, separation
from taichi_cloth.benchmarks.report import Measurement
from taichi_cloth.benchmarks.warp import SECOND, enter_ours, their_cloth
from taichi_cloth.measuring import machine

PART = "newton"
SIZES = {32: 15, 128: 6}  # side of the cloth: frames in a round
SOLVERS = {"Newton, semi-implicit": "SolverSemiImplicit", "Newton, XPBD": "SolverXPBD"}


def measure(bench: Bench) -> Iterator[Measurement]:
    """One contest a size."""
    if not machine.installed("newton"):
        for name in SOLVERS:
            why = 'pip install "taichi-cloth[bench]" (or newton)'
            bench.leave_out(PART, name, "all sizes", why)
        return
    for side, frames in SIZES.items():
        if side > 32 and bench.quick:
            continue
        yield from _measure_size(bench, side, frames)


def _measure_size(bench: Bench, side: int, frames: int) -> Iterator[Measurement]:
    size = f"{side} x {side}"
    scene = (WARP, {"side": side})
    lanes = enter_ours(bench, PART, "ours, lanes", side, frames, "lanes", "f32")
    peers = [_enter(bench, name, side, size, frames) for name in SOLVERS]
    checked = 2 * frames
    reference = ours.reference(bench, PART, scene, side * side, WARP_SUBSTEPS, [checked])
    finished = bench.race(PART, [lanes, *peers], marks={checked})
    against = f"{ours.AGAINST}, {checked / SECOND:g} s after the start"
    yield from bench.rows(PART, finished, reference, against)
    for peer in filter(None, peers):
        yield from compare(PART, size, f"ours, lanes, f32, to {peer.name}", lanes, peer)
    yield from separation(PART, lanes, peers[0], checked, "m")
    for contestant in finished:
        contestant.drop()


def _enter(bench: Bench, name: str, side: int, size: str, frames: int) -> Contestant | None:
    return bench.enter(
        PART,
        name,
        f"{__name__}:Solver",
        {"solver": SOLVERS[name], "side": side, "folder": str(bench.folder)},
        library="newton",
        precision="f32",
        threads=1,
        size=size,
        particles=side * side,
        steps=WARP_SUBSTEPS,
        units=frames,
        packages=("newton", "warp-lang"),
    )


class Solver:
    """A solver of Newton's on Warp's cloth, in the contestants' process; a unit is a frame."""

    def __init__(self, solver: str, side: int, folder: str):
        import newton

        cloth = their_cloth(side, Path(folder))
        builder = newton.ModelBuilder(up_axis=newton.Axis.Y)  # its gravity is 9.81, like Warp's
        mass = np.where(cloth.inv_masses > 0, 1 / np.maximum(cloth.inv_masses, 1e-9), 0.0)
        builder.add_particles(
            pos=cloth.positions.tolist(),
            vel=cloth.velocities.tolist(),
            mass=mass.tolist(),
            radius=[0.0] * cloth.num_particles,  # no contacts
        )
        for (i, j), k, c in zip(
            cloth.spring_indices.reshape(-1, 2).tolist(),
            cloth.spring_stiffness.tolist(),
            cloth.spring_damping.tolist(),
            strict=True,
        ):
            builder.add_spring(i, j, k, c, 0.0)
        model = builder.finalize(device="cpu")
        model.particle_grid = None  # which contacts would need
        self.solver = getattr(newton.solvers, solver)(model)
        self.control = model.control()
        self.now, self.next = model.state(), model.state()

    def advance(self, units: int) -> None:
        for _ in range(units * WARP_SUBSTEPS):
            self.now.clear_forces()
            self.solver.step(self.now, self.next, self.control, None, WARP_FRAME / WARP_SUBSTEPS)
            self.now, self.next = self.next, self.now

    def positions(self) -> np.ndarray:
        x: np.ndarray = self.now.particle_q.numpy()
        return x
