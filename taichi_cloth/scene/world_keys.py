"""Further keys of `[world]`: those that the physics terms declare, in a file each."""

from __future__ import annotations

import functools
from typing import Any

from taichi_cloth.scene.properties import Rule, WorldKey


@functools.cache
def world_keys() -> dict[str, WorldKey]:
    """The keys by name; `World.more` carries their values.

    It reads the terms' declarations, and with them imports Taichi: to be asked only where a scene
    has more than the keys of every scene.
    """
    from taichi_cloth.kernels import forces
    from taichi_cloth.kernels.forces.contract import has

    terms = (forces.load(name) for name in forces.TERMS)
    return {key.name: _key(key) for term in terms if has(term.keys) for key in term.keys}


def _key(key: Any) -> WorldKey:
    """A key as a term declares it, `kernels.forces.contract.Key`."""
    return WorldKey(
        key.name,
        key.unit,
        key.help,
        _rule(key.minimum, key.maximum),
        key.vector,
        whole=key.whole,
        table={part.name: _key(part) for part in key.table},
        optional=key.default is not None,
        needs=key.needs,
        in_space=key.in_space,
    )


def _rule(minimum: float | None, maximum: float | None) -> Rule | None:
    if minimum is None and maximum is None:
        return None
    says = "must be " + " and ".join(
        f"{words} {limit:g}"
        for words, limit in (("at least", minimum), ("at most", maximum))
        if limit is not None
    )
    low = -float("inf") if minimum is None else minimum
    high = float("inf") if maximum is None else maximum
    return Rule(says, says, lambda a: (a >= low) & (a <= high))
