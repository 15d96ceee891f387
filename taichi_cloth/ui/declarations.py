"""Declarations that are found by looking into a folder, one file each."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterable
from typing import Protocol, TypeVar


class Declaration(Protocol):
    """What a file declares: something that bears the file's name."""

    @property
    def name(self) -> str:
        """The name of the file, too."""


D = TypeVar("D", bound=Declaration)


def names(folder: Iterable[str]) -> tuple[str, ...]:
    """The names of the files in a package's folder (its `__path__`), but for its contract."""
    found = (module.name for module in pkgutil.iter_modules(folder))
    return tuple(sorted(name for name in found if name != "contract"))


def load(package: str, name: str, constant: str, contract: type[D]) -> D:
    """What the file `name` of a package declares as `constant`, which must be a `contract`.

    A part that the declaration lacks or that makes no sense raises TypeError naming file and part.
    """
    file = f"{package.replace('.', '/')}/{name}.py"
    try:
        module = importlib.import_module(f"{package}.{name}")
    except (TypeError, ValueError) as error:
        raise TypeError(f"{file}: {error}") from error
    declared = getattr(module, constant, None)
    if not isinstance(declared, contract):
        raise TypeError(f"{file}: declares no {constant} = {contract.__name__}(...)")
    if declared.name != name:
        raise TypeError(f"{file}: name must be the file's, '{name}', is {declared.name!r}")
    return declared
