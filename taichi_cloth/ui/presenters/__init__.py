"""Places that show images, one file each, found by their files' names.

A presenter's file declares `PRESENTER = Kind(...)` (`contract.py` says what its parts are). Adding
one is adding a file: its name is a word of `--view`.
"""

from __future__ import annotations

from functools import cache

from taichi_cloth import declarations
from taichi_cloth.ui.presenters.contract import Kind


@cache
def load_all() -> dict[str, Kind]:
    """Every kind of presenter by name, the best first. TypeError where a declaration is wrong."""
    names = declarations.names(__path__)
    found = [declarations.load(__name__, name, "PRESENTER", Kind) for name in names]
    return {kind.name: kind for kind in sorted(found, key=lambda kind: (kind.rank, kind.name))}
