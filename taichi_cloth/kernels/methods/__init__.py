"""Time-integration methods, one file each, discovered by name.

A method's file has a docstring with its formula and source, `CLAIMS`, and `step(plan, state, t)`,
a ti.func that advances the state by state.dt[None], as thread t of those that share the work.
`begin(plan, state, t)`, where it has one, comes before its first step, and after every change of
the state from outside: forces that it keeps from step to step are computed there.
`VECTORS` names what it must remember of each particle: state.<name>, fields of cells.
Adding a method is adding a file.
"""

import importlib
import pkgutil

METHODS = tuple(sorted(m.name for m in pkgutil.iter_modules(__path__) if m.name != "claims"))


def load(name):
    """The module of the method `name`, out of `METHODS`. Importing it imports Taichi."""
    return importlib.import_module(f"{__name__}.{name}")
