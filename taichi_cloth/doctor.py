"""``taichi-cloth doctor``: what this machine offers, and what each missing thing would need."""

from __future__ import annotations

import ctypes
import ctypes.util
import importlib.metadata
import os
import platform
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from taichi_cloth import __version__, runtime
from taichi_cloth.options import PATHS, TOPOLOGIES

MEASUREMENTS = 8  # shown of those kept


@dataclass(frozen=True)
class Finding:
    """One line of the report. good: True there, False missing (`text` says what it needs)."""

    name: str
    text: str
    good: bool = True


def main() -> int:
    """Print the report; return the exit status, which is 0: missing things are no failure."""
    from rich import box
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, show_header=False, pad_edge=False)
    table.add_column()
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for finding in findings():
        mark = "[green]ok[/]" if finding.good else "[yellow]--[/]"
        table.add_row(mark, finding.name, escape(finding.text))
    # A pipe or a file has no width: give whole sentences a line where they fit.
    console = Console() if sys.stdout.isatty() else Console(width=160)
    console.print(table)
    _print_choices(console)
    return 0


def _print_choices(console) -> None:
    """How scenes are run here: what a step took in each way, the newest measurements first."""
    from rich import box
    from rich.table import Table

    from taichi_cloth import execution

    measured = [kind for kind in reversed(execution.measurements()) if kind.seconds]
    if not measured:
        console.print("Fastest way to run a scene: nothing measured yet; the first run does it.")
        return
    ways = [f"{topology} {path}" for topology in TOPOLOGIES for path in PATHS]
    title = "Microseconds a step, as measured at a scene's first start; * is what runs by itself"
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("device; method; features and size of the scene", overflow="fold")
    for way in ways:
        table.add_column(way.replace(" ", "\n"), justify="right")
    for kind in measured[:MEASUREMENTS]:
        best = execution.fastest(kind.seconds)
        times = [
            f"{'*' * (way == best)}{1e6 * kind.seconds[way]:.3g}" if way in kind.seconds else "-"
            for way in ways
        ]
        table.add_row(kind.what.replace("/", "; "), *times)
    console.print(table)
    if len(measured) > MEASUREMENTS:
        console.print(f"{len(measured) - MEASUREMENTS} older ones: {execution.cache_file()}")


def findings() -> Iterator[Finding]:
    """Everything the report says, in order. Nothing is started in this process but `import`."""
    yield Finding("taichi-cloth", __version__)
    yield Finding("Python", f"{platform.python_version()} ({sys.executable})")
    for package in ("taichi", "numpy"):
        yield _package(package)
    yield Finding("system", platform.platform())
    yield Finding("processor", f"{processor()}, {os.cpu_count()} cores")
    for name, lack in runtime.usable_backends().items():
        yield Finding(f"backend {name}", "usable" if lack is None else f"needs {lack}", not lack)

    if runtime.display_available():
        yield Finding("display", os.environ.get("DISPLAY", "") or platform.system())
    else:
        yield Finding("display", "needs a running X server and DISPLAY (Xvfb serves)", False)
    device = vulkan_device()
    yield Finding("Vulkan device", device or runtime.NEEDS["vulkan"], device is not None)
    from taichi_cloth.ui.opening import usable_views

    for name, lack in usable_views().items():
        yield Finding(f"view {name}", "usable" if lack is None else lack, lack is None)
    yield _video_writer()
    yield from _cache_folders()


def _package(name: str) -> Finding:
    try:
        return Finding(name, importlib.metadata.version(name))
    except importlib.metadata.PackageNotFoundError:
        return Finding(name, f"needs installing: pip install {name}", False)


def processor() -> str:
    """The processor's name, as the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8", "replace").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    model = next((line.partition(":")[2].strip() for line in lines if "model name" in line), "")
    return model or platform.machine()


def vulkan_device() -> str | None:
    """Name of the first Vulkan device, or None. Asked in a process of its own: drivers crash."""
    code = "from taichi_cloth import doctor; print(doctor.first_vulkan_device() or '')"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    try:
        answer = subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True,
            text=True,
            timeout=20,
            env=environment,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return answer.stdout.strip() or None


def first_vulkan_device() -> str | None:
    """Name of the first Vulkan device in the loader's list; None without a loader or device."""
    names = {"win32": "vulkan-1.dll", "darwin": "libvulkan.dylib"}
    library = ctypes.util.find_library("vulkan") or names.get(sys.platform, "libvulkan.so.1")
    try:
        vulkan = ctypes.CDLL(library)
    except OSError:
        return None

    class InstanceCreateInfo(ctypes.Structure):
        _fields_ = [  # noqa: RUF012
            ("type", ctypes.c_int32),
            ("next", ctypes.c_void_p),
            ("flags", ctypes.c_uint32),
            ("application", ctypes.c_void_p),
            ("layer_count", ctypes.c_uint32),
            ("layers", ctypes.c_void_p),
            ("extension_count", ctypes.c_uint32),
            ("extensions", ctypes.c_void_p),
        ]

    instance, count = ctypes.c_void_p(), ctypes.c_uint32()
    # VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO is 1; VK_SUCCESS is 0, VK_INCOMPLETE 5.
    create = InstanceCreateInfo(type=1)
    if vulkan.vkCreateInstance(ctypes.byref(create), None, ctypes.byref(instance)) != 0:
        return None
    try:
        enumerate_devices = vulkan.vkEnumeratePhysicalDevices
        if enumerate_devices(instance, ctypes.byref(count), None) != 0 or not count.value:
            return None
        devices = (ctypes.c_void_p * count.value)()
        if enumerate_devices(instance, ctypes.byref(count), devices) not in (0, 5):
            return None
        # VkPhysicalDeviceProperties: five 32-bit numbers, then the name (256 bytes); 824 in all.
        properties = ctypes.create_string_buffer(2048)
        vulkan.vkGetPhysicalDeviceProperties(ctypes.c_void_p(devices[0]), properties)
        return properties.raw[20:276].split(b"\0")[0].decode("utf-8", "replace")
    finally:
        vulkan.vkDestroyInstance(instance, None)


def _video_writer() -> Finding:
    try:
        import imageio_ffmpeg

        version, program = imageio_ffmpeg.get_ffmpeg_version(), imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError, OSError):
        needs = "needs ffmpeg: pip install imageio imageio-ffmpeg (.gif works without)"
        return Finding("video writer", needs, False)
    return Finding("video writer", f"ffmpeg {version} ({program})")


def _cache_folders() -> Iterator[Finding]:
    """Where compiled kernels and the measured execution paths are kept."""
    from taichi.lang import impl

    from taichi_cloth import execution

    for name, folder in (
        ("cache of compiled kernels", Path(impl.default_cfg().offline_cache_file_path)),
        ("cache of measured speeds", execution.cache_file().parent),
    ):
        there = folder if folder.exists() else _first_existing(folder)
        writable = os.access(there, os.W_OK)
        yield Finding(name, f"{folder}" + ("" if writable else " needs to be writable"), writable)


def _first_existing(folder: Path) -> Path:
    return next(parent for parent in folder.parents if parent.exists())
