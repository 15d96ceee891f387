"""When two tables, or two scenes, are equal: NumPy's == has an answer for each of their numbers."""

from __future__ import annotations

from collections.abc import Sized
from dataclasses import fields
from typing import Any, ClassVar

import numpy as np

from taichi_cloth.errors import counted


class ByValue:
    """A dataclass that equals another one of its kind where all of their fields do.

    Arrays do where they have one shape and equal elements. It has no hash, as arrays have none.
    """

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        compared = [field.name for field in fields(self) if field.compare]  # type: ignore[arg-type]
        return all(_equal(getattr(self, name), getattr(other, name)) for name in compared)


class Rows(ByValue, Sized):
    """Arrays of a row each for what there are several of; at a prompt it says how many.

    ONE: what one of them is called.
    """

    ONE: ClassVar[str]

    def __repr__(self) -> str:
        return f"<{counted(len(self), self.ONE)}>"


def _equal(one: Any, other: Any) -> bool:
    if one is other:
        return True
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        return bool(np.array_equal(one, other))
    return bool(one == other)
