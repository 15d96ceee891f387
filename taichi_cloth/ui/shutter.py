"""Files that keys save while a window runs, pictures above all: never over old ones."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from taichi_cloth.errors import InputError
from taichi_cloth.files.names import name_for_file
from taichi_cloth.ui import film as films

SAID_FOR = 5.0  # seconds for which the window says where something was saved


class Shutter:
    """Takes pictures in a window, one at a time, and films that a key begins and ends.

    They show the world's room alone: what is around it says that a film is being made.

    name: of the scene, with which the files' names begin. folder: where they go; None: the current
    folder, or the home where that cannot be written to. quiet: nothing is said on the terminal.
    """

    def __init__(self, name: str, folder: str | None = None, *, quiet: bool = False):
        self._name = name_for_file(name, "picture")
        self._folder, self._quiet = folder, quiet
        self._film: films.Film | None = None
        self._to = Path()  # of the film
        self._frames = 0  # simulated since the film began
        self._due = False
        self._said, self._said_until = "", 0.0

    def press(self) -> None:
        """Take the frame that is drawn next."""
        self._due = True

    def begin_or_end(self) -> None:
        """Begin a film, or finish and save the one that is being made."""
        if self._film is not None:
            self.save()
            return
        kind = ".mp4" if films.has_ffmpeg() else ".gif"

        def begin() -> None:
            self._to = self._free(kind)
            self._film, self._frames = films.Film(self._to), 0

        self._trying(begin)

    def wants(self) -> bool:
        """True if the film takes the frame just simulated: call once a frame."""
        if self._film is None:
            return False
        self._frames += 1
        return self._film.wants()

    def add(self, pixels: np.ndarray) -> None:
        """Append the frame `pixels` (h, w, 3) uint8 to the film."""
        film = self._film
        if film is not None and not self._trying(lambda: film.add(pixels)):
            film.discard()
            self._film = None

    @property
    def due(self) -> bool:
        """True if the frame that is drawn next is to be saved as a picture."""
        return self._due

    def take(self, pixels: np.ndarray) -> None:
        """Save `pixels` (h, w, 3) uint8 as a picture of its own."""
        self._due = False
        self.keep(".png", lambda path: films.Image(path).save(pixels))

    def keep(self, kind: str, write: Callable[[Path], object]) -> None:
        """Have `write` make a new file whose name ends with `kind`, and say where."""

        def act() -> None:
            path = self._free(kind)
            write(path)
            self._tell(f"saved {_short(path)}", f"saved {path}")

        self._trying(act)

    def save(self) -> None:
        """Finish the film that is being made, if any; one without frames leaves no file."""
        film, self._film = self._film, None
        if film is None:
            return
        length = f"{self._frames / films.FILM_RATE:.1f} s"
        if not self._trying(film.save):
            film.discard()
        elif self._frames:
            self._tell(f"saved {_short(self._to)}, {length}", f"saved {self._to} ({length})")
        else:
            self._tell("nothing filmed: no frame was simulated")

    @property
    def state(self) -> str | None:
        """The window's words while a film is being made; None: none is."""
        if self._film is None:
            return None
        return f"recording {self._frames / films.FILM_RATE:.0f} s"

    @property
    def notice(self) -> str | None:
        """Its last file, or why there is none; None: nothing to say."""
        return self._said if time.monotonic() < self._said_until else None

    def _tell(self, on_screen: str, in_terminal: str | None = None) -> None:
        self._said, self._said_until = on_screen, time.monotonic() + SAID_FOR
        if in_terminal and not self._quiet:
            print(in_terminal, flush=True)

    def _trying(self, act: Callable[[], object]) -> bool:
        """True if `act` did it; what it is refused for is told, and ends no run."""
        try:
            act()
        except InputError as error:
            self._tell(str(error), f"not saved: {error}")
            return False
        return True

    def _free(self, kind: str) -> Path:
        """The first path of this kind that no file has, and none that is being written."""
        folder = Path(self._folder) if self._folder is not None else _writable()
        number = 1
        while True:
            path = (folder / f"{self._name}-{number}{kind}").absolute()
            if not os.path.exists(path) and not any(folder.glob(f"{path.name}.*.part")):
                return path
            number += 1


def _writable() -> Path:
    """The current folder, or the home where that cannot be written to."""
    here = Path.cwd()
    return here if os.access(here, os.W_OK) else Path.home()


def _short(path: Path) -> str:
    """A path as a window has room for it: from the home on."""
    home = Path.home()
    return f"~/{path.relative_to(home)}" if path.is_relative_to(home) else str(path)
