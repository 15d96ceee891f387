"""Forces, one file each, which are found by looking into this folder.

`contract.Term` says what a file declares. Adding a force is adding a file.
"""

import functools
from collections.abc import Iterable
from typing import Any

from taichi_cloth import declarations
from taichi_cloth.kernels.forces.contract import TRACTION, DeviceField, Term, has

TERMS = declarations.names(__path__)


@functools.cache
def load(name: str) -> Term:
    """The `Term` of the force `name`, out of `TERMS`. Importing it imports Taichi.

    Raises TypeError, which names the file and the part, where its declaration is not whole.
    """
    return declarations.load(__name__, name, "TERM", Term)


def present_in(scene: Any) -> tuple[str, ...]:
    """Names of the terms that a scene needs, in the order in which they are added up."""
    return tuple(name for name in TERMS if load(name).present(scene))


def act_on_triangles(scene: Any) -> bool:
    """True if any force that a scene needs acts on triangles."""
    return _any_on_triangles(present_in(scene))


def has_tractions(spec: Any) -> bool:
    """True if any force of a specialization acts on triangles."""
    return _any_on_triangles(spec.terms)


def _any_on_triangles(terms: Iterable[str]) -> bool:
    return any(load(name).adds == TRACTION for name in terms)


def device_fields(spec: Any) -> list[DeviceField]:
    """The fields that the forces of a specialization declare."""
    terms = [load(name) for name in spec.terms]
    return [field for term in terms if has(term.fields) for field in term.fields]


def describe(scene: Any) -> str:
    """A scene's features and forces in words: what decides which kernels it runs."""
    return f"{scene.features().describe()}; {', '.join(present_in(scene))}"
