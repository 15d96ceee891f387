"""The machine that a benchmark ran on, in words."""

from __future__ import annotations

import functools
import importlib.metadata
import os
import platform
import re
import shutil
import subprocess
from pathlib import Path

from taichi_cloth.version import __version__

VECTOR_UNITS = ("avx512f", "avx2", "avx", "asimd", "neon")  # best first
WIDEST = VECTOR_UNITS[0]  # whose vectors have 64 bytes


def describe() -> dict[str, str]:
    """Processor, cores, vector unit, memory, system and Python of this machine."""
    return {
        "processor": processor(),
        "cores": str(os.cpu_count()),
        "vectors": vector_unit(),
        "memory": _memory(),
        "system": platform.platform(),
        "python": platform.python_version(),
    }


def processor() -> str:
    """The processor's name, as the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8", "replace").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    model = next((line.partition(":")[2].strip() for line in lines if "model name" in line), "")
    return model or platform.machine()


def file_name() -> str:
    """A safe name for this machine's file of results, from its processor and cores."""
    words = re.sub(r"[^a-z0-9]+", "-", processor().lower()).strip("-") or "unknown"
    return f"{words}-{os.cpu_count()}-cores"


@functools.cache
def versions(packages: tuple[str, ...]) -> str:
    """'name version' of packages and programs, those that are there."""
    found = []
    for package in packages:
        version = _version(package)
        if version:
            found.append(f"{package} {version}")
    return ", ".join(found)


def _version(package: str) -> str | None:
    if package == "taichi-cloth":
        return __version__
    if package == "python":
        return platform.python_version()
    if package == "g++":
        if shutil.which("g++") is None:
            return None
        done = subprocess.run(["g++", "-dumpfullversion"], capture_output=True, text=True)
        return done.stdout.strip() or None
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def installed(package: str) -> bool:
    """True if a package (by the name pip knows) or g++ is there."""
    return _version(package) is not None


@functools.cache
def vector_unit() -> str:
    """The processor's best vector unit, out of VECTOR_UNITS."""
    try:
        text = Path("/proc/cpuinfo").read_text("utf-8", "replace")
    except OSError:
        return "unknown"
    flags = set(text.split())
    return next((unit for unit in VECTOR_UNITS if unit in flags), "unknown")


def _memory() -> str:
    try:
        size = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):
        return "unknown"
    return f"{size / 2**30:.0f} GiB"
