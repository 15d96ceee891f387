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


def _stays() -> None:
    """The scene of no file: nobody can have edited it."""


@dataclass
class Scenes:
    """Scenes that a window offers, and what stays from one to the next.

    about: by name, in the order of a list, a line on what each of them shows.
    open: makes the scene of a name ready, so that the next run can show it in the same window;
    InputError or RunFailure where that cannot be: then the present one goes on.
    edited: what makes the present scene ready as its file says by now, as `open` does; None: it
    says what it said, or there is no file. Raises InputError where it says no scene any more.
    fixed: why no other scene can be opened here; "": it can.

    file: that the present scene is read from; "": none. opened: what is open beside the world;
    None: what is at a start. paused: whether a run begins so that nobody asked to. tool: the name
    of one that is in hand from a start; "": the scene's. pose: from where a run is looked at in
    space; None: as its scene says. said: what the window says of the scene
    when its run begins.
    """

    about: Mapping[str, str] = field(default_factory=dict)
    open: Callable[[str], None] = _refuse
    fixed: str = ""
    edited: Callable[[], Callable[[], None] | None] = _stays
    file: str = ""
    opened: Parts | None = None
    paused: bool = False
    tool: str = ""
    pose: tuple[float, ...] | None = None
    said: str | None = None
