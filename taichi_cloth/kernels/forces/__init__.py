"""Forces, one file each, which are found by looking into this folder.

`contract.Term` says what a file declares. Adding a force is adding a file.
"""

import functools
import importlib
import pkgutil
from typing import Any

from taichi_cloth.kernels.forces.contract import TRACTION, Term

TERMS = tuple(sorted(m.name for m in pkgutil.iter_modules(__path__) if m.name != "contract"))


@functools.cache
def load(name: str) -> Term:
    """The `Term` of the force `name`, out of `TERMS`. Importing it imports Taichi.

    Raises TypeError, which names the file and the part, where its declaration is not whole.
    """
    try:
        term = getattr(importlib.import_module(f"{__name__}.{name}"), "TERM", None)
    except (TypeError, ValueError) as error:
        raise TypeError(f"kernels/forces/{name}.py: {error}") from error
    if not isinstance(term, Term):
        raise TypeError(f"kernels/forces/{name}.py: declares no TERM = Term(...)")
    return term


def present_in(scene: Any) -> tuple[str, ...]:
    """Names of the terms that a scene needs, in the order in which they are added up."""
    return tuple(name for name in TERMS if load(name).present(scene))


def act_on_triangles(scene: Any) -> bool:
    """Whether any force that a scene needs acts on triangles."""
    return any(load(name).adds == TRACTION for name in present_in(scene))


def describe(scene: Any) -> str:
    """A scene's features and forces in words: what decides which kernels it runs."""
    return f"{scene.features().describe()}; {', '.join(present_in(scene))}"
