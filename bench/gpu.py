"""Cloths on a GPU, beside the bandwidth of its memory; and every scene there, beside the CPU.

A step of the structural cloth must read and write each particle's position and velocity and read
its inverse mass: 36 bytes in f32 and two dimensions; whatever else a topology moves counts against
it. The bandwidth is that of a copy of 256 MiB on the same backend. Warp's cloth is that of its own
benchmark (part `warp`): many frames in a call, and one by one, as a window asks for them.
"""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from typing import Any

from bench import agreement, ours
from bench.cloths import (
    STRUCTURAL_FRAME,
    STRUCTURAL_SCENE,
    STRUCTURAL_SUBSTEPS,
    WARP,
    WARP_SUBSTEPS,
)
from bench.contest import Bench
from bench.report import Measurement
from taichi_cloth import runtime, vulkan

PART = "gpu"
SIDES = (128, 512, 2048)
QUICK_SIDES = (128,)
BACKENDS = ("cuda", "vulkan")
WORK = 30_000_000  # particle-steps in a round, about
FRAMES = 1  # of 16 steps: when the error is measured
BYTES = 36  # that must move for a step of a particle
COPIED = 2**26  # floats
WANTED, LARGE = 40, 2048  # percent of the copy's speed, from this side on
WARP_SIDE, WARP_FRAMES = 128, 60  # frames in a round, and when the error is measured
WARP_WANTED = 0.2  # ms a frame: what Warp says of itself


def measure(bench: Bench) -> Iterator[Measurement]:
    """Each backend that is there, one after the other."""
    bench.tell("looking for GPUs", 0, 1)
    usable = runtime.usable_backends()
    for arch in [bench.arch] if bench.arch else BACKENDS:
        if usable[arch]:
            bench.leave_out(PART, arch, "", f"not usable here; it needs {usable[arch]}")
            continue
        device = _device(arch)
        software = bool(device and vulkan.is_software(device))
        if software and not bench.arch:
            why = f"only a software driver here ({device}); --arch vulkan times that"
            bench.leave_out(PART, arch, "", why)
            continue
        note = f"a software driver, on the processor: {device}" if software else device or ""
        yield from _measure_backend(bench, arch, note)


def _device(arch: str) -> str | None:
    """The name of a backend's device, where the system tells."""
    if arch == "vulkan":
        return vulkan.device_name()
    if arch == "cuda" and shutil.which("nvidia-smi"):
        command = ["nvidia-smi", "--query-gpu=name", "--format=csv,noheader"]
        done = subprocess.run(command, capture_output=True, text=True)
        return done.stdout.partition("\n")[0].strip() or None
    return None


def _measure_backend(bench: Bench, arch: str, note: str) -> Iterator[Measurement]:
    shared: dict[str, Any] = {"library": f"ours {arch}", "precision": "f32", "threads": 1}
    copy = bench.enter(
        PART,
        f"{arch}: copy",
        "bench.contestants:Copy",
        {"arch": arch, "count": COPIED},
        size=f"2 x {COPIED}",
        particles=COPIED,
        steps=1,
        units=4,
        packages=ours.PACKAGES,
        **shared,
    )
    bandwidth = None
    for row in bench.rows(PART, bench.race(PART, [copy]), {}, ""):
        if row.seconds:
            bandwidth = 8 * COPIED / row.seconds
            row.rate, row.unit = bandwidth / 1e9, "GB/s"
        row.threads, row.note = None, note
        yield row
    if copy:
        copy.drop()
    for side in QUICK_SIDES if bench.quick else SIDES:
        yield from _measure_size(bench, arch, side, note, bandwidth)
    yield from _measure_warp(bench, arch, note)
    yield from agreement.measure(bench, PART, arch, note)


def _measure_size(
    bench: Bench, arch: str, side: int, note: str, bandwidth: float | None
) -> Iterator[Measurement]:
    size, scene = f"{side} x {side}", (STRUCTURAL_SCENE, {"columns": side, "rows": side})
    reference = ours.reference(bench, PART, scene, side * side, frames=[FRAMES], **STRUCTURAL_FRAME)
    contestants = [
        ours.enter(
            bench,
            PART,
            f"{arch}: ours, {layout}",
            scene,
            precision="f32",
            arch=arch,
            size=size,
            particles=side * side,
            units=max(1, WORK // (side * side * STRUCTURAL_SUBSTEPS)),
            topology=layout,
            **STRUCTURAL_FRAME,
        )
        for layout in ours.TOPOLOGIES
    ]
    finished = bench.race(PART, bench.mark_after(PART, contestants, FRAMES))
    against = f"an f64 run on the CPU at a sixteenth of the step, after {STRUCTURAL_SUBSTEPS} steps"
    for row in bench.rows(PART, finished, reference, against):
        row.threads, row.note = None, note
        yield row
        if bandwidth and row.rate:
            yield Measurement(
                part=PART,
                contestant=f"{row.contestant}: {BYTES} bytes a particle-step, of the copy's speed",
                size=size,
                rate=100 * BYTES * row.rate / bandwidth,
                unit="%",
                target=f">= {WANTED}" if side >= LARGE else "",
            )
    for contestant in finished:
        contestant.drop()


def _measure_warp(bench: Bench, arch: str, note: str) -> Iterator[Measurement]:
    """Warp's cloth, whose frames are to be as short as Warp's own."""
    side, steps = WARP_SIDE, WARP_SUBSTEPS
    size, scene = f"{side} x {side}", (WARP, {"side": side})
    reference = ours.reference(bench, PART, scene, side * side, steps, [WARP_FRAMES])
    contestants = [
        ours.enter(
            bench,
            PART,
            f"{arch}: Warp's cloth, {layout}, {how}",
            scene,
            precision="f32",
            arch=arch,
            size=size,
            particles=side * side,
            units=WARP_FRAMES,
            substeps=steps,
            topology=layout,
            batch=batch,
        )
        for layout in ours.TOPOLOGIES
        for how, batch in (("a round's frames in one call", None), ("frame by frame", 1))
    ]
    finished = bench.race(PART, contestants, marks=[WARP_FRAMES])
    against = f"{ours.AGAINST} on the CPU, after {WARP_FRAMES} frames"
    for row in bench.rows(PART, finished, reference, against):
        row.threads, row.note = None, note
        yield row
        if row.seconds:
            yield Measurement(
                part=PART,
                contestant=f"{row.contestant}: a frame",
                size=size,
                rate=1e3 * steps * row.seconds,
                unit="ms",
                target=f"<= {WARP_WANTED}",
            )
    for contestant in finished:
        contestant.drop()
