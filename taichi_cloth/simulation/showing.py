"""A simulation that shows itself. Who draws, measures, examines it is said from above."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    import numpy as np


class Artist(Protocol):
    """The drawer of simulations, in the words of `taichi_cloth.ui.showing`."""

    def shown(self, sim: Any, frames: int | None, **how: Any) -> Any:
        """A notebook's cell, or the summary of a window."""

    def picture(self, sim: Any, **how: Any) -> np.ndarray:
        """The present frame, (h, w, 3) uint8."""

    def as_png(self, pixels: np.ndarray) -> bytes:
        """Pixels (h, w, 3) uint8 as a file."""


class Examiner(Protocol):
    """The writer of reports, in the words of `taichi_cloth.post_mortem.reporting`."""

    def report(
        self, sim: Any, path: str | Path, draw: Callable[[], np.ndarray] | None, seconds: float
    ) -> Any:
        """The page at a path, and what was found out."""


_artist: Callable[[], Artist] | None = None
_examiner: Callable[[], Examiner] | None = None
_measurer: Callable[[Any], Any] | None = None
_explainer: Callable[[Any], Any] | None = None


def drawn_by(artist: Callable[[], Artist]) -> None:
    """Say who draws; `artist` is called when something is first to be drawn."""
    global _artist
    _artist = artist


def examined_by(examiner: Callable[[], Examiner]) -> None:
    """Say who writes reports; `examiner` is called when the first one is asked for."""
    global _examiner
    _examiner = examiner


def measured_by(measurer: Callable[[Any], Any]) -> None:
    """Say who measures the errors of what a window shows; `measurer` is called with a simulation,
    and returns a `taichi_cloth.ui.chrome.errors.Errors` that is to be closed.
    """
    global _measurer
    _measurer = measurer


def explained_by(explainer: Callable[[Any], Any]) -> None:
    """Say who finds out why a window's run failed; `explainer` is called with a simulation, and
    returns a `taichi_cloth.ui.chrome.why.Examiner`.
    """
    global _explainer
    _explainer = explainer


def explained(sim: Any) -> Any:
    """The finder of a failure's cause in a window."""
    assert _explainer is not None, "the package's __init__ says who explains"
    return _explainer(sim)


def measured(sim: Any) -> Any:
    """The meter of a simulation's errors when it is asked for."""
    assert _measurer is not None, "the package's __init__ says who measures"
    return _measurer(sim)


def _called() -> Artist:
    assert _artist is not None, "the package's __init__ says who draws"
    return _artist()


class Showing:
    """Showing a simulation, in notebooks and scripts."""

    def show(self, frames: int | None = None, **how: Any) -> Any:
        """Show it: in a notebook's cell a picture, or a film of the next `frames`; else a window.

        In a notebook the result is what IPython displays: the last expression of a cell is enough.
        A film goes on from the present frame, and the simulation is then as many frames further.
        Elsewhere this is `taichi_cloth.show`, which returns a `Summary` when its window is closed.

        frames: of a film, at least 1; of a window, after which it closes.
        how: further arguments of `taichi_cloth.picture`, or outside notebooks of
            `taichi_cloth.show`: `size`, `camera`, `parts`, `on_frame`.

        Raises InputError for a number of frames or a size that makes no sense.
        """
        return _called().shown(self, frames, **how)

    def report(self, path: str | Path, *, pictures: bool = True, seconds: float = 20.0) -> Any:
        """Write what led here into one HTML file, and return it.

        Of a run that failed: the frames before, h omega, energy and strain over time, the cause in
        words with its proof, and the cheapest setting that survives, found by running it. Of one
        that did not: how it stands. The simulation is as it was afterwards, to the bit.

        pictures: whether frames are drawn. seconds: that the trials may take, and going back as
        many. What it returns has `cause` and `search`, with the setting that survives as `best`.
        InputError where the file cannot be written.
        """
        assert _examiner is not None, "the package's __init__ says who examines"
        from taichi_cloth.settings import accepted  # NumPy, which to import the package does not

        pictures = accepted.flag("report: pictures", pictures)
        draw = partial(_called().picture, self) if pictures else None
        return _examiner().report(self, path, draw, seconds)

    def _repr_png_(self) -> bytes:
        """The present frame, as notebooks show a value that ends a cell."""
        artist = _called()
        return artist.as_png(artist.picture(self))
