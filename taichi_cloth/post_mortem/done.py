"""Acts on a run from outside, as its past has them, and a post-mortem's words for them."""

from __future__ import annotations

import pickle
from dataclasses import dataclass

import numpy as np

# Acts that set something on which a stable step depends; that change it in any way, that give
# speeds, that push, and that stretch springs.
SETTING = frozenset(("set", "set_step", "set_method", "set_solver", "add_spring", "spawn"))
LIMITING = SETTING | {"_hold", "restore"}
THROWING = frozenset(("set", "spawn", "restore"))
PUSHING = frozenset(("_push", "hold", "_hold", "drag"))
PULLING = frozenset(("set", "drag", "_hold", "add_spring", "spawn", "restore"))
# In words, where the name of the method that did it says too little.
WORDS = {
    "_push": "a blow",
    "hold": "a held force",
    "_hold": "the pointer's hold",
    "drag": "the pointer's drag",
    "let_go": "letting go",
    "spawn": "what was spawned",
    "add_spring": "a spring that was added",
}
CHOICES = frozenset(("springs", "particles"))  # arguments that say of whom something is set


@dataclass(frozen=True)
class Act:
    """Something that was done, before the frame after so many.

    name: of the method that did it. given: what it was given by name, but for whom.
    """

    frame: int
    name: str
    given: tuple[str, ...] = ()

    @property
    def words(self) -> str:
        """An act in words: "a blow", "`set` of stiffness"."""
        called = WORDS.get(self.name, f"`{self.name.lstrip('_')}`")
        told = self.given if self.name in ("set", "set_step", "set_solver") else ()
        return f"{called} of {' and '.join(told)}" if told else called


def act_of(frame: int, act: bytes) -> Act:
    """Acts, out of the past of a simulation (`simulation.acts.noted`)."""
    name, _, given = pickle.loads(act)
    return Act(frame, name, tuple(key for key in given if key not in CHOICES))


def cut_by(act: bytes) -> list[int]:
    """The springs that an act cuts."""
    name, args, given = pickle.loads(act)
    if name != "cut":
        return []
    springs = np.atleast_1d(np.asarray([*args, *given.values()][0]))
    found: list[int] = (np.flatnonzero(springs) if springs.dtype == bool else springs).tolist()
    return found
