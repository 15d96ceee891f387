"""Imports modules: many at once, or only where they are used."""

from __future__ import annotations

import gc
import importlib.util
import sys
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


def when_used(name: str) -> None:
    """Have a module imported where an attribute of it is first asked for, if it is not there yet.

    As Python's documentation of `importlib` does it. The package that it is in is imported now.
    """
    spec = None if name in sys.modules else importlib.util.find_spec(name)
    if spec is None or spec.loader is None:
        return
    spec.loader = importlib.util.LazyLoader(spec.loader)
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    package, _, its = name.rpartition(".")
    if package:
        setattr(sys.modules[package], its, module)
