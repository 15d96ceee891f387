"""Kinds of views, one file each, found by their files' names.

A view's file declares `VIEW = ViewKind(...)` (`contract.py` says what its parts are). Adding a view
is adding a file, and its name to `VIEWS` in `settings/options.py`, where a view stands before those
that "auto" takes in its absence.
"""

from __future__ import annotations

from functools import cache

from taichi_cloth import declarations
from taichi_cloth.settings.options import VIEWS
from taichi_cloth.ui.views.contract import ViewKind


@cache
def load_all() -> dict[str, ViewKind]:
    """Every kind of view by name, the best first. TypeError where a declaration is wrong."""
    found = declarations.names(__path__)
    unnamed = set(found) ^ (set(VIEWS) - {"auto"})
    if unnamed:
        names = ", ".join(sorted(unnamed))
        raise TypeError(f"only one of ui/views/ and VIEWS in settings/options.py has: {names}")
    return {
        name: declarations.load(__name__, name, "VIEW", ViewKind)
        for name in VIEWS
        if name != "auto"
    }
