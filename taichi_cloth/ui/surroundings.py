"""The place where the program runs, as far as windows go, and what works there instead.

`doctor` shows it line by line; a run that finds no display says the part that helps.
"""

from __future__ import annotations

import ctypes
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from taichi_cloth import runtime
from taichi_cloth.ui import x11

INCHES = 96  # dots an inch of a screen that needs no larger text
F1 = 0xFFBE  # X's number of the key
KEPT = "--image FILE.png and --video FILE.mp4 keep what a window would show"


@dataclass(frozen=True)
class Place:
    """A kind of place in which windows are missing, or are slow.

    here: whether we are there, by the environment. instead: what to do where there is no display.
    """

    name: str
    here: Callable[[Mapping[str, str]], bool]
    instead: str


def _over_ssh(env: Mapping[str, str]) -> bool:
    return bool(env.get("SSH_CONNECTION") or env.get("SSH_TTY"))


def _in_container(env: Mapping[str, str]) -> bool:
    marks = ("/.dockerenv", "/run/.containerenv")
    return "container" in env or any(Path(mark).exists() for mark in marks)


def _in_wsl(env: Mapping[str, str]) -> bool:
    return "WSL_DISTRO_NAME" in env


def _in_notebook(env: Mapping[str, str]) -> bool:
    return "JPY_PARENT_PID" in env or "COLAB_RELEASE_TAG" in env


def _wayland_alone(env: Mapping[str, str]) -> bool:
    return "WAYLAND_DISPLAY" in env and not env.get("DISPLAY")


# The first that holds is what a run without a display names.
PLACES = (
    Place(
        "notebook",
        _in_notebook,
        f"in a notebook's cell sim.show() draws a picture, sim.show(frames=120) a film; {KEPT}",
    ),
    Place(
        "Wayland without XWayland",
        _wayland_alone,
        f"Wayland alone shows no window: install XWayland and set DISPLAY; {KEPT}",
    ),
    Place(
        "SSH",
        _over_ssh,
        f"over SSH, ssh -Y lends your display (slowly); {KEPT}",
    ),
    Place(
        "WSL",
        _in_wsl,
        f"in WSL, `wsl --update` brings a display; {KEPT}",
    ),
    Place(
        "container",
        _in_container,
        f"a container shows windows with -e DISPLAY -v /tmp/.X11-unix:/tmp/.X11-unix; {KEPT}",
    ),
)


def places(env: Mapping[str, str] | None = None) -> list[Place]:
    """The kinds of place that we are in. env: the environment; None: of this process."""
    env = os.environ if env is None else env
    return [place for place in PLACES if place.here(env)]


def instead(env: Mapping[str, str] | None = None) -> str:
    """Advice where a window was wanted and there is no display, in a line."""
    return next((place.instead for place in places(env)), KEPT)


def is_forwarded(env: Mapping[str, str] | None = None) -> bool:
    """True if the display is lent over SSH: each picture then goes through the network."""
    env = os.environ if env is None else env
    return _over_ssh(env) and bool(
        re.match(r"(localhost|127\.0\.0\.1|\[::1\]):", env.get("DISPLAY", ""))
    )


@dataclass(frozen=True)
class Equipment:
    """Screen, keyboard and mouse, as an X server describes them.

    size: of the screen, (width, height) pixels. scale: how much larger text its user wants, by
    the resource Xft.dpi; 1 where that is not set. has_f1: whether a key F1 is there.
    buttons: of the mouse; a wheel is the fourth and fifth.
    """

    size: tuple[int, int]
    scale: float
    has_f1: bool
    buttons: int

    @property
    def has_wheel(self) -> bool:
        """True if the mouse has a wheel."""
        return self.buttons >= 5


def equipment() -> Equipment | None:
    """Ask the X server of DISPLAY; None where there is none."""
    x = x11.xlib()
    if x is None or not runtime.display_available():
        return None
    display = x.XOpenDisplay(None)
    if not display:
        return None
    screen = x.XDefaultScreen(display)
    map_ = (ctypes.c_ubyte * 32)()
    found = Equipment(
        size=(x.XDisplayWidth(display, screen), x.XDisplayHeight(display, screen)),
        scale=_scale((x.XResourceManagerString(display) or b"").decode(errors="replace")),
        has_f1=x.XKeysymToKeycode(display, F1) != 0,
        buttons=x.XGetPointerMapping(display, map_, len(map_)),
    )
    x.XCloseDisplay(display)
    return found


def _scale(resources: str) -> float:
    """The size of text, by X's resources."""
    found = re.search(r"^Xft\.dpi:\s*([\d.]+)", resources, re.M)
    return float(found[1]) / INCHES if found else 1.0


@dataclass(frozen=True)
class Report:
    """A line on what is here. good: there; else `text` says what works instead."""

    name: str
    text: str
    good: bool = True


def reports() -> Iterator[Report]:
    """Lines of `doctor` on the place, the screen, the mouse and the keyboard."""
    there = places()
    display = runtime.display_available()
    names = ", ".join(place.name for place in there) or "this machine's own terminal or desktop"
    yield Report("where", names)
    if display:
        yield _display()
    else:
        yield Report("display", f"needs {_missing()}; {instead()}", False)
    if "WAYLAND_DISPLAY" in os.environ and display:
        yield Report("Wayland", "windows go through XWayland, which scales them by itself")
    if display and sys.platform.startswith("linux"):
        yield from _of_equipment(equipment())
    else:
        yield Report("keys", KEYS)


KEYS = "without a wheel + and - (or up and down) zoom; without F keys tab lists all keys"


def _display() -> Report:
    name = os.environ.get("DISPLAY", "") or sys.platform
    if is_forwarded():
        slow = "comes over SSH: slow; --view gui is taken; without a window: --video FILE.mp4"
        return Report("display", f"{name} {slow}", False)
    return Report("display", name)


def _missing() -> str:
    if os.environ.get("DISPLAY"):
        if x11.xlib() is None:
            return "libX11 (Debian: libx11-6)"
        return f"an X server: {os.environ['DISPLAY']} does not answer"
    return "a running X server and DISPLAY (Xvfb serves)"


def _of_equipment(found: Equipment | None) -> Iterator[Report]:
    if found is None:
        return
    width, height = found.size
    said = f"{width}x{height}, scale {found.scale:g}"
    if found.scale != 1:
        said += f": text in windows is {found.scale:g} times as large; --text-size X changes it"
    else:
        said += "; --text-size X makes the text of windows larger"
    yield Report("screen", said)
    wheel = "a wheel" if found.has_wheel else "no wheel: + and - (or up and down) zoom"
    yield Report("mouse", wheel, found.has_wheel)
    keys = "F keys" if found.has_f1 else "no F1: tab lists all keys"
    yield Report("keyboard", keys, found.has_f1)
