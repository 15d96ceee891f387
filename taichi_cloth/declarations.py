"""Declarations that are found by looking into a folder, one file each.

Forces, methods, shapes of obstacles, mouse tools and views are all found so.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterable
from typing import TypeVar

D = TypeVar("D")


def names(folder: Iterable[str]) -> tuple[str, ...]:
    """The names of the files in a package's folder (its `__path__`), but for its contract."""
    found = (module.name for module in pkgutil.iter_modules(folder))
    return tuple(sorted(name for name in found if name != "contract"))


def load(package: str, name: str, constant: str, contract: type[D]) -> D:
    """Load the `constant` that the file `name` of a package declares, which must be a `contract`.

    One that says its name has the file's. A part that the declaration lacks or that makes no sense
    raises TypeError naming file and part.
    """
    file = f"{package.replace('.', '/')}/{name}.py"
    try:
        module = importlib.import_module(f"{package}.{name}")
    except (TypeError, ValueError) as error:
        raise TypeError(f"{file}: {error}") from error
    declared = getattr(module, constant, None)
    if not isinstance(declared, contract):
        raise TypeError(f"{file}: declares no {constant} = {contract.__name__}(...)")
    if (given := getattr(declared, "name", name)) != name:
        raise TypeError(f"{file}: name must be the file's, '{name}', is {given!r}")
    return declared
