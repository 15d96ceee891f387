"""Warp's cloth benchmark, by ours and by Warp's own versions of it.

Structural, shear and bend springs with k 1000 and axial dashpots 10, mass 0.1, spacing 0.1, two
pinned corners, 16 steps a frame, 60 frames a second. The others are the files of the installed
`warp-lang` (warp/examples/benchmarks/benchmark_cloth_*.py), unchanged. Warp on the CPU has one
thread. Its steps are launched from Python, as in that file, and recorded once and replayed, a frame
at a time; ratios are to the faster. The Taichi version copies the positions out after each frame,
as written there. The C++, compiled here, goes over compressed rows, as our graph does.
"""

from __future__ import annotations

import ast
import importlib.util
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np

from bench import ours
from bench.cloths import WARP, WARP_FRAME, WARP_SUBSTEPS
from bench.compiled import Compiled, compiled, enter_compiled
from bench.contest import Bench, Contestant, compare, separation
from bench.report import Measurement
from taichi_cloth.measuring import machine
from taichi_cloth.scene.library import build
from taichi_cloth.simulation.storage import adjacency

PART = "warp"
SECOND = 60  # frames: when trajectories are compared
# Side of the cloth: frames in a round, and the frame at which the error is measured.
SIZES = {32: (30, 60), 128: (12, 60), 512: (6, 12)}
WARP_WAYS = ("Warp, recorded", "Warp, launched")  # the same bits
PEERS = {  # name: file, class, argument besides the cloth, largest size
    **{name: ("warp", "WpIntegrator", ("cpu",), 512) for name in WARP_WAYS},
    "Warp's Taichi version": ("taichi", "TiIntegrator", ("cpu",), 512),
    "Warp's NumPy version": ("numpy", "NpIntegrator", (), 32),
}
NUMPY_GRAVITY = 9.8  # theirs has 9.8 where the others have 9.81


def measure(bench: Bench) -> Iterator[Measurement]:
    """One contest a size."""
    for side, (frames, checked) in SIZES.items():
        if side == 512 and bench.quick:
            continue
        yield from _measure_size(bench, side, frames, checked)
    if not machine.installed("warp-lang"):
        for name in PEERS:
            why = 'pip install "taichi-cloth[bench]" (or warp-lang)'
            bench.leave_out(PART, name, "all sizes", why)


def _measure_size(bench: Bench, side: int, frames: int, checked: int) -> Iterator[Measurement]:
    size = f"{side} x {side}"
    scene = (WARP, {"side": side})
    entered = {
        (layout, precision): enter_ours(
            bench, PART, f"ours, {layout}", side, frames, layout, precision
        )
        for precision in ("f32", "f64")
        for layout in ours.TOPOLOGIES
    }
    name = "ours, lanes, a round's frames in one call"
    shared = enter_ours(bench, PART, name, side, frames, "lanes", "f32", batch=None)
    peers = {name: _enter_peer(bench, name, side, size, frames) for name in PEERS}
    cpp = enter_compiled(
        bench,
        "C++, csr",
        f"{__name__}:CompiledCloth",
        {"side": side},
        part=PART,
        steps=WARP_SUBSTEPS,
        size=size,
        particles=side * side,
        units=frames,
    )
    reference = ours.reference(bench, PART, scene, side * side, WARP_SUBSTEPS, [checked])
    rounds = max(bench.rounds, -(-SECOND // frames) - 1)
    everyone = [*entered.values(), shared, *peers.values(), cpp]
    finished = bench.race(PART, everyone, marks={checked, SECOND}, rounds=rounds)
    against = f"{ours.AGAINST}, {checked / SECOND:g} s after the start"
    numpy_version = peers["Warp's NumPy version"]
    rows = bench.rows(PART, finished, reference, against)
    if numpy_version in finished:
        lighter = (WARP, {"side": side, "gravity": NUMPY_GRAVITY})
        reference = ours.reference(bench, PART, lighter, side * side, WARP_SUBSTEPS, [checked])
        (row,) = bench.rows(PART, [numpy_version], reference, against)
        row.note = f"its gravity is {NUMPY_GRAVITY}, and so is that of what it is compared to"
        rows[finished.index(numpy_version)] = row
    yield from rows

    lanes, graph = entered["lanes", "f32"], entered["graph", "f32"]
    ways = [peers[name] for name in WARP_WAYS if peers[name] in finished]
    warp = min(filter(None, ways), key=lambda way: way.step_seconds, default=None)
    taichi = peers["Warp's Taichi version"]
    yield from compare(PART, size, "ours, lanes, f32, to Warp", lanes, warp, ">= 6")
    yield from compare(PART, size, "ours, lanes, f32, in one call, to Warp", shared, warp)
    yield from compare(PART, size, "ours, graph, f32, to Warp", graph, warp)
    yield from compare(PART, size, "ours, graph, f32, to C++ csr", graph, cpp, ">= 1.0")
    name = "ours, lanes, f32, to Warp's Taichi version"
    yield from compare(PART, size, name, lanes, taichi, ">= 12")
    if numpy_version:
        name = "ours, lanes, f32, to Warp's NumPy version"
        yield from compare(PART, size, name, lanes, numpy_version)
    yield from separation(PART, lanes, warp, SECOND, "m", "<= 1e-4")
    yield from separation(PART, graph, warp, SECOND, "m", "<= 1e-4")
    yield from separation(PART, lanes, taichi, SECOND, "m")
    yield from separation(PART, graph, cpp, SECOND, "m")
    for contestant in filter(None, everyone):
        contestant.drop()


def enter_ours(
    bench: Bench,
    part: str,
    name: str,
    side: int,
    frames: int,
    topology: str,
    precision: str,
    batch: int | None = 1,
) -> Contestant | None:
    """Enter ours on Warp's cloth, `frames` a round, `batch` in a call (None: all of them)."""
    return ours.enter(
        bench,
        part,
        name,
        (WARP, {"side": side}),
        precision=precision,
        substeps=WARP_SUBSTEPS,
        topology=topology,
        size=f"{side} x {side}",
        particles=side * side,
        units=frames,
        batch=batch,
    )


def _enter_peer(bench: Bench, name: str, side: int, size: str, frames: int) -> Contestant | None:
    file, class_name, arguments, largest = PEERS[name]
    if side > largest or not machine.installed("warp-lang"):
        return None
    return bench.enter(
        PART,
        name,
        f"{__name__}:Theirs",
        {
            "file": file,
            "class_name": class_name,
            "arguments": arguments,
            "side": side,
            "folder": str(bench.folder),
            "recorded": name == WARP_WAYS[0],
        },
        library=file,
        precision="f32",
        threads=bench.threads if file == "taichi" else 1,
        size=size,
        particles=side * side,
        steps=WARP_SUBSTEPS,
        units=frames,
        packages=("warp-lang", "numpy" if file == "numpy" else "taichi")[: 1 + (file != "warp")],
    )


# ------------------------------------------------------------------------------------------
# In the contestants' process


class Theirs:
    """One of the package's integrators, driven as its benchmark drives it; a unit is a frame.

    recorded: whether a frame of Warp's is recorded once and replayed.
    """

    def __init__(
        self,
        file: str,
        class_name: str,
        arguments: list[Any],
        side: int,
        folder: str,
        recorded: bool = False,
    ):
        cloth = their_cloth(side, Path(folder))
        module = _their_module(f"benchmark_cloth_{file}")
        self.integrator = getattr(module, class_name)(cloth, *arguments)
        self._frame = self._recording() if recorded else self._simulate

    def advance(self, units: int) -> None:
        for _ in range(units):
            self._frame()

    def positions(self) -> np.ndarray:
        return self.at

    def _simulate(self) -> None:
        self.at: np.ndarray = self.integrator.simulate(WARP_FRAME, WARP_SUBSTEPS)

    def _recording(self) -> Callable[[], None]:
        """A replay of a frame; its positions are those in Warp's own memory."""
        import warp

        with warp.ScopedCapture(device="cpu") as capture:
            self._simulate()
        return partial(warp.capture_launch, capture.graph)


class CompiledCloth(Compiled):
    """The scene `warp` over compressed rows, with its dashpots; a unit is a frame."""

    steps = WARP_SUBSTEPS

    def __init__(self, folder: str, side: int):
        self.advances = compiled(folder).csr3_damped_steps
        scene = build("warp", side=side)
        p, s = scene.particles, scene.springs
        half = adjacency.half_springs(s.between, len(p))
        self.x, v = (np.ascontiguousarray(a, np.float32) for a in (p.position, p.velocity))
        k, rest, c = (
            a[half.spring].astype(np.float32) for a in (s.stiffness, s.rest_length, s.damping)
        )
        w = np.where(p.fixed, 0, 1 / p.mass).astype(np.float32)
        numbers = WARP_FRAME / WARP_SUBSTEPS, scene.world.gravity[1]
        rows = half.row, half.far, k, rest, c, w
        self.arguments = (len(p), *numbers, *rows, self.x, v, np.empty_like(v))


def _their_path(name: str) -> Path:
    spec = importlib.util.find_spec("warp")
    if spec is None or not spec.submodule_search_locations:
        raise ModuleNotFoundError("warp")
    return Path(spec.submodule_search_locations[0], "examples", "benchmarks", f"{name}.py")


def _their_module(name: str) -> ModuleType:
    """A file of the package's, imported once."""
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, _their_path(name))
        if spec is None or spec.loader is None:
            raise ImportError(f"{_their_path(name)}: cannot be imported")
        sys.modules[name] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sys.modules[name])
    return sys.modules[name]


def their_cloth(side: int, folder: Path) -> SimpleNamespace:
    """The cloth of Warp's benchmark, as its class `Cloth` makes it; kept in `folder`.

    The class is taken out of its file, which as a whole would run the benchmark. At 512 x 512
    it takes seconds, so the first contestant saves its arrays for the others.
    """
    saved = folder / f"cloth-{side}.npz"
    if not saved.exists():
        source = ast.parse(_their_path("benchmark_cloth").read_text("utf-8"))
        source.body = [node for node in source.body if getattr(node, "name", "") == "Cloth"]
        names: dict[str, Any] = {"np": np}
        exec(compile(source, "benchmark_cloth.py", "exec"), names)
        k = 1000.0
        cloth = names["Cloth"](
            lower=(0.0, 0.0, 0.0),
            dx=side,
            dy=side,
            radius=0.1,
            stretch_stiffness=k,
            bend_stiffness=k,
            shear_stiffness=k,
            mass=0.1,
            fix_corners=True,
        )
        arrays: dict[str, Any] = {
            name: part for name, part in vars(cloth).items() if isinstance(part, np.ndarray)
        }
        np.savez(saved, **arrays)
    with np.load(saved) as file:
        cloth = SimpleNamespace(**dict(file))
    cloth.num_particles, cloth.num_springs = len(cloth.positions), len(cloth.spring_lengths)
    return cloth
