"""C++ that benchmarks are measured beside: compiled on the spot from `cpp`, and run in contests."""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from bench.contest import Bench, Contestant
from taichi_cloth.measuring import machine

FLAGS = ("-O3", "-march=native", "-ffast-math", "-fopenmp", "-shared", "-fPIC")


def enter_compiled(
    bench: Bench,
    name: str,
    kind: str,
    arguments: dict[str, Any],
    *,
    part: str,
    steps: int,
    threads: int | None = None,
    **shared: Any,
) -> Contestant | None:
    """Enter a contestant of C++, class `kind` ("module:Class"), compiled here; None without g++."""
    if not machine.installed("g++"):
        bench.leave_out(part, name, shared["size"], "no g++ here; install a C++ compiler")
        return None
    return bench.enter(
        part,
        name,
        kind,
        {"folder": str(bench.folder), **arguments},
        library="C++",
        precision="f32",
        threads=threads or bench.threads,
        steps=steps,
        packages=("g++",),
        **shared,
    )


# ------------------------------------------------------------------------------------------
# In the contestants' process


def compiled(folder: str) -> ctypes.CDLL:
    """The C++ functions, compiled for this processor; RuntimeError with the compiler's words."""
    library = Path(folder, "yardsticks.so")
    if not library.exists():
        sources = sorted(Path(__file__).with_name("cpp").glob("*.cpp"))
        command = ["g++", *FLAGS, *map(str, sources), "-o", str(library)]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(f"g++: {done.stderr.strip().splitlines()[0]}")
    return ctypes.CDLL(str(library))


def call(function: Callable[..., Any], count: int, *arguments: int | float | np.ndarray) -> None:
    """Call a C function: `count` as long, int as int, float as float, arrays as pointers."""
    converted: list[Any] = [ctypes.c_long(count)]
    for value in arguments:
        if isinstance(value, np.ndarray):
            converted.append(value.ctypes.data_as(ctypes.c_void_p))
        elif isinstance(value, float):
            converted.append(ctypes.c_float(value))
        else:
            converted.append(ctypes.c_int(value))
    function(*converted)


class Compiled:
    """A contestant in C++.

    advances: the library's function that makes a number of steps with `arguments`; steps: of a unit
    of work. x: positions, (n, dim) float32.
    """

    advances: Callable[..., Any]
    steps: int
    arguments: tuple[Any, ...]
    x: np.ndarray

    def advance(self, units: int) -> None:
        call(self.advances, units * self.steps, *self.arguments)

    def positions(self) -> np.ndarray:
        return self.x
