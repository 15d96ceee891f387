"""Sixteen lanes: where they are faster than eight, and what of them earlier runs have compiled.

In f32 eight lanes are half of a vector of 64 bytes. Kernels of sixteen compile a quarter longer, so
a run that may choose begins with eight, unless an earlier one of its kind has left those of
sixteen: it compiles them beside itself (`cli/run_sixteen.py`), for runs to come. Taichi would not
take them up in the middle of a run: it looks once, when it starts, at what other processes have
compiled (`engine.ALONE`). And the bits of f32 may differ: its sums of products are rounded once or
twice as the compiler finds them, so logs and checkpoints say which lanes they are of.

What was compiled so, and what failed, is kept in the user's cache folder.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from taichi_cloth.simulation import cache, compiled

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

FILE = "sixteen.json"
TRIES = 2  # of a kind of run, after which it is left alone
MOST_KINDS = 200  # that are kept, the newest ones


@dataclass(frozen=True)
class Tried:
    """What came of compiling sixteen lanes beside runs of a kind.

    what: device, method, features and size. done, failed: how often. why: it failed last.
    """

    what: str
    done: int = 0
    failed: int = 0
    why: str = ""


def pays(storage: Storage, method: str) -> bool:
    """Whether sixteen lanes are faster than eight for what a storage has taken, under a method.

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
    """Whether an earlier run has left the kernels of a storage in lanes, to be run on a path.

    what: of which kind of run, as in `Tried`.
    """
    return tried(what).done > 0 and compiled.was_before(storage.kind("lanes", path))


def tried(what: str) -> Tried:
    """What came of it in a kind of run."""
    return next((one for one in all_tried() if one.what == what), Tried(what))


def all_tried() -> list[Tried]:
    """What came of it in all of them, the newest last."""
    table = cache.read(FILE)
    entries = table.items() if isinstance(table, dict) else ()
    return [Tried(what, *entry) for what, entry in entries if _is_entry(entry)]


def note(what: str, why: str = "") -> None:
    """Note that the kernels of a kind of run were compiled; why: that they were not."""
    now = tried(what)
    now = replace(now, failed=now.failed + 1, why=why) if why else replace(now, done=now.done + 1)
    kept = [*(one for one in all_tried() if one.what != what), now]  # the newest come last
    table = {one.what: [one.done, one.failed, one.why] for one in kept[-MOST_KINDS:]}
    cache.write(FILE, table)


def _is_entry(entry: object) -> bool:
    """Whether this is what `note` writes."""
    return (
        isinstance(entry, list)
        and len(entry) == 3
        and all(type(count) is int and count >= 0 for count in entry[:2])
        and isinstance(entry[2], str)
    )
