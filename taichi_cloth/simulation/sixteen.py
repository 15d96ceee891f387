"""Sixteen lanes: where they are faster than eight, and what of them earlier runs have compiled.

In f32 eight lanes are half of a vector of 64 bytes. Kernels of sixteen compile a quarter longer, so
a run that may choose begins with eight, unless an earlier one of its kind has left those of
sixteen: it compiles them beside itself (`cli/run_aside.py`), for runs to come. Taichi would not
take them up in the middle of a run: it looks once, when it starts, at what other processes have
compiled (`engine.ALONE`). And the bits of f32 may differ: its sums of products are rounded once or
twice as the compiler finds them, so logs and checkpoints say which lanes they are of.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from taichi_cloth.simulation import aside, compiled

if TYPE_CHECKING:
    from taichi_cloth.simulation.storage.storage import Storage

LANES = 16
PRECISION = "f32"  # in f64 eight fill a vector
# Particles of scenes for which it is done: a step of fewer is short anyway, more would be in memory
# twice meanwhile.
LEAST, MOST = 16_000, 5_000_000
# Methods under which it was measured to pay: steps take 1.2 to 1.8 times as long in eight lanes
# (docs/speed.md).
METHODS = "symplectic_euler", "verlet", "rk4", "xpbd", "vbd"


def pays(storage: Storage, method: str) -> bool:
    """True if sixteen lanes are faster than eight for what a storage has taken, under a method.

    Measured on a processor with vectors of 64 bytes; whoever asks knows that this one has them.
    """
    return (
        storage.device.arch == "cpu"
        and storage.device.precision == PRECISION
        and method in METHODS
        and LEAST <= len(storage.scene.particles) <= MOST
        and storage.is_simple()
    )


def are_compiled(storage: Storage, what: str, path: str) -> bool:
    """True if an earlier run has left the kernels of a storage in lanes, to be run on a path.

    what: of which kind of run (`compiled_as`).
    """
    return aside.tried(compiled_as(what)).done > 0 and compiled.was_before(
        storage.kind("lanes", path)
    )


def compiled_as(kind_of_run: str) -> str:
    """Their name in `aside.Tried`, of a kind of run (`Simulation.kind_of_run`)."""
    return f"{LANES} lanes/{kind_of_run}"
