"""The scenes that a window may go on with in the place of the one that it shows."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NoReturn

from taichi_cloth.errors import InputError
from taichi_cloth.ui.chrome.layout import Parts

OWNED = "a script owns this simulation: it says which scene"


def _refuse(name: str) -> NoReturn:
    raise InputError(f"{name}: cannot be opened here")


@dataclass
class Scenes:
    """What a window offers beside its scene, and what stays from one scene to the next.

    about: by name, in the order of a list, a line on what each of them shows.
    open: makes the scene of a name ready, so that the next run can show it in the same window;
    InputError or RunFailure where that cannot be: then the present one goes on.
    fixed: why no other scene can be opened here; "": it can.

    opened: what is open beside the world; None: what is at a start. said: what the window says
    of the scene when its run begins.
    """

    about: Mapping[str, str] = field(default_factory=dict)
    open: Callable[[str], None] = _refuse
    fixed: str = ""
    opened: Parts | None = None
    said: str | None = None
