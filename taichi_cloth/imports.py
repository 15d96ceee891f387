"""Imports modules: many at once, or not before they are used."""

from __future__ import annotations

import contextlib
import gc
import importlib.util
import sys
from collections.abc import Iterator
from types import ModuleType


def module(name: str) -> ModuleType:
    """Import a module by its full name, with all that it imports.

    Python looks for no garbage meanwhile: what an import makes stays, and to look through it again
    and again takes a tenth of it.
    """
    was_on = gc.isenabled()
    gc.disable()
    try:
        return importlib.import_module(name)
    finally:
        if was_on:
            gc.enable()


@contextlib.contextmanager
def put_off(name: str) -> Iterator[None]:
    """While it lasts, who imports a module of a package gets one that comes when it is used.

    As Python's documentation of `importlib` does it. Only if the module is not there yet; the
    package is imported now. Whoever imports it afterwards gets the module itself: several threads
    that are the first to use one that was put off may find it empty (Python up to 3.12).
    """
    package, _, its = name.rpartition(".")
    spec = None if name in sys.modules else importlib.util.find_spec(name)
    if spec is None or spec.loader is None:
        yield
        return
    spec.loader = importlib.util.LazyLoader(spec.loader)
    stand_in = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(stand_in)
    of = vars(sys.modules[package])
    of[its] = stand_in  # so that importing it from the package looks no further
    try:
        yield
    finally:
        if sys.modules.get(name) is stand_in:
            del sys.modules[name]
        if of.get(its) is stand_in:
            del of[its]
