"""Which kernels earlier runs have compiled: Taichi has kept them, and cannot be asked.

A list of kinds of run in the user's cache folder, so that a run can say at once that it will be
silent for some seconds.
"""

from __future__ import annotations

import hashlib

from taichi_cloth.kernels.fields import Capacity
from taichi_cloth.kernels.methods.contract import Method
from taichi_cloth.kernels.specialization import Specialization
from taichi_cloth.runtime import Device, kernel_cache
from taichi_cloth.simulation import cache
from taichi_cloth.version import __version__

FILE = "compiled.json"
MOST = 1000  # kinds that are listed, the newest ones


def kind(device: Device, method: Method, spec: Specialization, capacity: Capacity) -> str:
    """A digest of what decides which kernels a run has."""
    what = (__version__, str(kernel_cache()), device, method.claims, spec, capacity)
    return hashlib.sha256(repr(what).encode()).hexdigest()[:16]


def soon(kind: str) -> str:
    """The same kind of run with kernels that were compiled soon (`runtime.compiled_soon`)."""
    return f"{kind} soon"


def was_before(kind: str) -> bool:
    """True if a run of this kind has compiled its kernels, as far as known."""
    return kernel_cache().exists() and kind in _kinds()


def note(kind: str) -> None:
    """List a kind of run whose kernels are compiled by now."""
    kinds = _kinds()
    if kind not in kinds:
        cache.write(FILE, [*kinds, kind][-MOST:])


def _kinds() -> list[str]:
    kinds = cache.read(FILE)
    return [str(kind) for kind in kinds] if isinstance(kinds, list) else []
