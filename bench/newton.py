"""Newton's semi-implicit and XPBD solvers, with springs only, on Warp's cloth.

The semi-implicit solver integrates the same equations as ours; XPBD solves each spring as a
constraint with its stiffness as compliance, twice a step (its default), so its error is its own.
Both are the installed `newton`, with its contacts off; on the CPU it has one thread. Steps are
launched from Python, and recorded once and replayed, as its own examples do; ratios are to those.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bench import newton_model, ours
from bench.cloths import WARP, WARP_FRAME, WARP_SUBSTEPS
from bench.contest import Bench, Contestant, compare, separation
from bench.newton_model import Stepper, model_of
from bench.report import Measurement
from bench.warp import SECOND, enter_ours
from taichi_cloth.measuring import machine
from taichi_cloth.scene import library

PART = "newton"
SIZES = {32: 15, 128: 6}  # side of the cloth: frames in a round
SOLVERS = ("Newton, semi-implicit", "Newton, XPBD")


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
    peers = [_enter(bench, name, side, size, frames, recorded=True) for name in SOLVERS]
    launched = [_enter(bench, name, side, size, frames, recorded=False) for name in SOLVERS]
    checked = 2 * frames
    reference = ours.reference(bench, PART, scene, side * side, WARP_SUBSTEPS, [checked])
    finished = bench.race(PART, [lanes, *peers, *launched], marks={checked})
    against = f"{ours.AGAINST}, {checked / SECOND:g} s after the start"
    yield from bench.rows(PART, finished, reference, against)
    for peer in filter(None, peers):
        yield from compare(PART, size, f"ours, lanes, f32, to {peer.name}", lanes, peer)
    yield from separation(PART, lanes, peers[0], checked, "m")
    for contestant in finished:
        contestant.drop()


def _enter(
    bench: Bench, name: str, side: int, size: str, frames: int, recorded: bool
) -> Contestant | None:
    return bench.enter(
        PART,
        f"{name}, {'recorded' if recorded else 'launched'}",
        f"{__name__}:Solver",
        {"solver": newton_model.SOLVERS[name][0], "side": side, "recorded": recorded},
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

    def __init__(self, solver: str, side: int, recorded: bool):
        self._stepper = Stepper(model_of(library.build("warp", side=side)), solver, recorded)
        self.about = {"note": newton_model.material_of(solver)}

    def advance(self, units: int) -> None:
        self._stepper.advance(WARP_FRAME / WARP_SUBSTEPS, units * WARP_SUBSTEPS)

    def positions(self) -> np.ndarray:
        return self._stepper.positions()
