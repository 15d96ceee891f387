"""``taichi-cloth doctor``: what this machine offers, and what each missing thing would need."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from taichi_cloth import console, runtime, vulkan
from taichi_cloth.errors import counted
from taichi_cloth.measuring import machine
from taichi_cloth.settings.options import PATHS, TOPOLOGIES
from taichi_cloth.version import __version__

if TYPE_CHECKING:
    from rich.console import Console

MEASUREMENTS = 8  # shown of those kept


@dataclass(frozen=True)
class Finding:
    """One line of the report. good: True there, False missing (`text` says what it needs)."""

    name: str
    text: str
    good: bool = True


def main() -> int:
    """Print the report; return the exit status, which is 0: missing things are no failure."""
    found = list(findings())
    lines = [("ok" if finding.good else "--", finding.name, finding.text) for finding in found]
    styles = [None if finding.good else "yellow" for finding in found]
    to = console.output()
    headers = ("good", "name", "text")
    console.print_table(to, None, headers, lines, styles=styles, show_header=False)
    _print_choices(to)
    return 0


def _print_choices(to: Console) -> None:
    """Times of scenes that ran here: a launch and a step in each way, the newest first."""
    from taichi_cloth.simulation import autotune

    measured = list(reversed(autotune.measurements()))
    if not measured:
        console.say(to, "Cost of a launch and a step: nothing measured yet; runs do it as they go.")
        return
    ways = [f"{topology} {path}" for topology in TOPOLOGIES for path in PATHS]
    title = (
        "Microseconds a launch + a step, as measured in runs; ways that never ran are predicted\n"
        "from these"
    )
    what = "device; method; features and size of the scene"
    lines = []
    for kind in measured[:MEASUREMENTS]:
        costs = [kind.costs.get(way) for way in ways]
        numbers = [f"{1e6 * c.launch:.3g} + {1e6 * c.step:.3g}" if c else "-" for c in costs]
        lines.append([kind.what.replace("/", "; "), *numbers])
    console.print_table(to, title, [what, *ways], lines, left=(what,))
    if len(measured) > MEASUREMENTS:
        console.say(to, f"{len(measured) - MEASUREMENTS} older ones: {autotune.cache_file()}")


def findings() -> Iterator[Finding]:
    """Everything the report says, in order. Nothing is started in this process but `import`."""
    yield Finding("taichi-cloth", __version__)
    yield Finding("Python", f"{platform.python_version()} ({sys.executable})")
    for package in ("taichi", "numpy"):
        yield _package(package)
    yield Finding("system", platform.platform())
    yield Finding("processor", f"{machine.processor()}, {os.cpu_count()} cores")
    for name, lack in runtime.usable_backends().items():
        yield Finding(f"backend {name}", "usable" if lack is None else f"needs {lack}", not lack)

    from taichi_cloth.ui import surroundings

    for report in surroundings.reports():
        yield Finding(report.name, report.text, report.good)
    device = vulkan.device_name()
    yield Finding("Vulkan device", device or runtime.NEEDS["vulkan"], device is not None)
    from taichi_cloth.ui.opening import avoided_by_auto, usable_views

    for name, lack in usable_views().items():
        avoided = avoided_by_auto(name) if lack is None else None
        usable = f"usable; --view auto leaves it out: {avoided}" if avoided else "usable"
        yield Finding(f"view {name}", usable if lack is None else lack, lack is None)
    yield _video_writer()
    yield _compiled_beside()
    yield from _cache_folders()


def _package(name: str) -> Finding:
    try:
        return Finding(name, importlib.metadata.version(name))
    except importlib.metadata.PackageNotFoundError:
        return Finding(name, f"needs installing: pip install {name}", False)


def _video_writer() -> Finding:
    try:
        import imageio_ffmpeg

        version, program = imageio_ffmpeg.get_ffmpeg_version(), imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError, OSError):
        needs = "needs ffmpeg: pip install imageio imageio-ffmpeg (.gif works without)"
        return Finding("video writer", needs, False)
    return Finding("video writer", f"ffmpeg {version} ({program})")


def _compiled_beside() -> Finding:
    """Report what runs have compiled beside themselves, and where that went wrong."""
    from taichi_cloth.simulation import aside

    tried = aside.all_tried()
    done = counted(sum(one.done > 0 for one in tried), "kind")
    text = f"beside runs, for later ones: {done} of run"
    if machine.vector_unit() != machine.WIDEST:
        text += f"; 16 lanes need vectors of 64 bytes ({machine.WIDEST})"
    failed = [one for one in tried if one.failed]
    if failed:
        times = counted(sum(one.failed for one in failed), "time")
        text += f"; failed {times}, last in {failed[-1].what}: {failed[-1].why}"
    return Finding("faster kernels", text, not failed)


def _cache_folders() -> Iterator[Finding]:
    """The folders of compiled kernels and of measured execution paths."""
    from taichi_cloth.simulation import autotune

    for name, folder in (
        ("cache of compiled kernels", runtime.kernel_cache()),
        ("cache of measured speeds", autotune.cache_file().parent),
    ):
        # `Path.exists` ends with an error in a folder of somebody else.
        there = next((p for p in (folder, *folder.parents) if os.path.exists(p)), folder)
        writable = os.access(there, os.W_OK)
        yield Finding(name, f"{folder}" + ("" if writable else " needs to be writable"), writable)
