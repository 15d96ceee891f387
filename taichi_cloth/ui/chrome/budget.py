"""A budget of a window's run, as the window sees it. Who keeps it is said from above."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

from taichi_cloth.ui.text import Word

if TYPE_CHECKING:
    from taichi_cloth.simulation.live import Value

HOLD = "hold"  # the name of the panel's row
OFF = "off"
METHOD = "method"
SETS = ("substeps", "tolerance", "iterations")  # the settings that it chooses, beside the method


class Budget(Protocol):
    """Keeps a run to a frame's time or to an error, while one is chosen.

    words: what may be chosen, `OFF` first. chosen: which is. fixed: why none can be; "": one can.
    why: what it chose last, and why, in a sentence. about: what a word means. plain: whether
    pictures are drawn plain, for a frame's time. shortens: whether to hold frames a second would
    make frames shorter than they are now.
    """

    chosen: str
    fixed: str
    about: str

    @property
    def words(self) -> tuple[str, ...]: ...

    @property
    def why(self) -> str: ...

    @property
    def plain(self) -> bool: ...

    @property
    def shortens(self) -> bool: ...

    def status(self) -> Word | None:
        """Its words in the status; None: nothing is held."""

    def choose(self, word: str) -> None:
        """Hold something else from now on; InputError where that cannot be."""

    def by_hand(self, name: str) -> str:
        """The user set what it sets: hold nothing any more, or for a method, leave that as it is;
        what to tell of it, "": nothing.
        """

    def unmeasured(self) -> bool:
        """The error meter was switched off: hold no error any more; whether one was held."""

    def before_frame(self, give: Callable[[str, Value], None]) -> None:
        """Choose for the next frame; `give` sets a setting by its name, and logs that."""

    def after_frame(self, simulate: float, rest: float) -> None:
        """A frame took so many seconds to simulate, and for all else but waiting."""
