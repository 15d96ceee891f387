"""Windows, pictures and films for Python: what scripts and notebooks call."""

from __future__ import annotations

import io
import sys
import tempfile
from collections.abc import Callable, Iterable
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_cloth.errors import InputError, printable
from taichi_cloth.render.camera import Camera
from taichi_cloth.settings import accepted
from taichi_cloth.settings.options import HEADLESS_FRAMES, PROGRAM, SHOWN, shown_parts
from taichi_cloth.simulation import showing
from taichi_cloth.ui import app
from taichi_cloth.ui.framing import camera_of, window_of
from taichi_cloth.ui.opening import in_memory, open_view
from taichi_cloth.ui.summary import Summary
from taichi_cloth.ui.view import View

if TYPE_CHECKING:
    from taichi_cloth.scene.model import Scene
    from taichi_cloth.simulation.simulation import Simulation

MOST_PIXELS = 8192  # of a picture's side
FILM_WIDTH = 640  # pixels of a film in a notebook: a second of it is then some hundred kB


def show(
    sim: Simulation,
    *,
    on_frame: Callable[[Simulation], object] | None = None,
    view: str = "auto",
    size: tuple[int, int] | None = None,
    frames: int | None = None,
    camera: Camera | None = None,
    parts: str | Iterable[str] | None = None,
    paused: bool = False,
    status: bool = True,
) -> Summary:
    """Open a window on `sim`, with all keys and tools, and run until it is closed.

    It begins at the present frame, and the simulation stays where the window left it. Without a
    display it says so and what to do instead, and runs `frames` frames, or 600, without a window.

    on_frame: called with `sim` before each frame; `sim.set`, `sim.blow`, `sim.cut` and all others
        may be used there. Where it returns False the window closes.
    view: "auto", "ggui", "gui" or "none". size: (width, height) in pixels; None: what fits.
    frames: after which the window closes; None: when the user closes it.
    camera: of a 3-D scene, which the user turns; None: one that shows what there is.
    parts: of cloths that are drawn: "surface", "springs", "particles"; None: what suits the scene.
    paused: begin paused. status: whether the status is shown (`h` hides and shows it).

    Raises InputError where a view that was asked for cannot be had, and SimulationFailure where
    the simulation failed and the user quit at the banner.
    """
    _check(sim, "show", camera=camera, on_frame=on_frame, status=status, paused=paused)
    drawn = _parts(parts)
    if frames is not None:
        frames = accepted.whole_number("show: frames", frames, 1)
    world = sim.scene.world
    opened = open_view(
        view,
        world,
        size=_checked_size(size),
        title=f"{PROGRAM}: {printable(sim.scene.name)}",
        camera=camera or camera_of(sim.scene),
        status=status,
    )
    with closing(opened), closing(showing.measured(sim)) as errors:
        if frames is None and not opened.visible:
            frames = HEADLESS_FRAMES
        return app.run(
            sim,
            opened,
            frames=frames,
            on_frame=on_frame,
            paused=paused,
            status=status,
            show=drawn,
            errors=errors,
            examiner=showing.explained(sim),
        )


def picture(
    sim: Simulation,
    *,
    size: tuple[int, int] | None = None,
    camera: Camera | None = None,
    parts: str | Iterable[str] | None = None,
    status: bool = False,
) -> np.ndarray:
    """The present frame of `sim` as pixels, (height, width, 3) uint8, drawn without a window.

    size: (width, height) in pixels; None: as a window would have. camera: of a 3-D scene; None:
    one that shows what the scene has at its start. parts: of cloths that are drawn: "surface",
    "springs", "particles"; None: what suits the scene. status: whether its lines are in it.
    """
    _check(sim, "picture", camera=camera, status=status)
    with closing(_offscreen(sim, size, camera)) as view:
        return app.pixels_of(sim, view, status=status, show=_parts(parts))


def shown(sim: Simulation, frames: int | None, **how: Any) -> Any:
    """The value of `Simulation.show`: see there."""
    if not in_notebook():
        return show(sim, frames=frames, **how)
    from IPython.display import Image

    if frames is None:
        return Image(data=as_png(picture(sim, **how)), format="png")
    return Image(data=film(sim, frames, **how), format="gif")


def film(
    sim: Simulation,
    frames: int,
    *,
    on_frame: Callable[[Simulation], object] | None = None,
    size: tuple[int, int] | None = None,
    camera: Camera | None = None,
    parts: str | Iterable[str] | None = None,
    status: bool = False,
) -> bytes:
    """The next `frames` frames of `sim` as an animated GIF at the scene's speed, without a window.

    The simulation is then as many frames further. Arguments are those of `picture` and `show`.
    """
    _check(sim, "film", camera=camera, on_frame=on_frame, status=status)
    frames = accepted.whole_number("show: frames", frames, 1)
    if size is None:
        width, height = window_of(sim.scene.world)
        size = min(width, FILM_WIDTH), max(1, round(height * min(1, FILM_WIDTH / width)))
    with closing(_offscreen(sim, size, camera)) as view, tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.gif"
        app.run(
            sim,
            view,
            frames=frames,
            film=str(path),
            on_frame=on_frame,
            quiet=True,
            status=status,
            show=_parts(parts),
        )
        return path.read_bytes()


def as_png(pixels: np.ndarray) -> bytes:
    """Pixels (h, w, 3) uint8 as the content of a PNG file."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format="PNG")
    return buffer.getvalue()


def in_notebook() -> bool:
    """True if a notebook's kernel runs us, which shows pictures beneath its cells."""
    if "IPython" not in sys.modules:
        return False
    from IPython import get_ipython

    shell = get_ipython()
    return shell is not None and hasattr(shell, "kernel")


def _check(
    sim: Any, name: str, *, camera: Any, status: Any, on_frame: Any = None, paused: Any = False
) -> None:
    """Raise InputError where what is to be shown is no simulation, such as a scene, or how is not
    as it must be; before anything opens.
    """
    if not isinstance(sim, showing.Showing):
        says = f"{name}: must be given a Simulation, is {accepted.shown(sim)}"
        raise InputError(f"{says}; Simulation(scene) makes one of a scene")
    if camera is not None and not isinstance(camera, Camera):
        raise InputError(f"{name}: camera must be a Camera, is {accepted.shown(camera)}")
    scene: Scene = vars(sim)["scene"]
    if camera is not None and scene.world.dim == 2:
        raise InputError(f"{name}: camera: '{scene.name}' is 2-D, and is seen without one")
    if on_frame is not None and not callable(on_frame):
        raise InputError(f"{name}: on_frame must be a function, is {accepted.shown(on_frame)}")
    accepted.flag(f"{name}: status", status)
    accepted.flag(f"{name}: paused", paused)


def _offscreen(sim: Simulation, size: tuple[int, int] | None, camera: Camera | None) -> View:
    """A view in memory, of which there may be several."""
    world = sim.scene.world
    view = in_memory(world, _checked_size(size) or window_of(world))
    view.camera = camera or camera_of(sim.scene)
    return view


def _checked_size(size: tuple[int, int] | None) -> tuple[int, int] | None:
    """A size (width, height) as it was given, or InputError."""
    if size is None:
        return None
    try:
        width, height = size
    except (TypeError, ValueError):
        raise InputError("size: must be a width and a height, in pixels") from None
    least, most = 16, MOST_PIXELS
    return (
        accepted.whole_number("size: width", width, least, most),
        accepted.whole_number("size: height", height, least, most),
    )


def _parts(parts: str | Iterable[str] | None) -> frozenset[str] | None:
    if parts is None:
        return None
    must = f"some of {', '.join(SHOWN)}"
    words = accepted.listed("parts:", parts.split(",") if isinstance(parts, str) else parts, must)
    if not words or not all(isinstance(word, str) for word in words):
        raise InputError(f"parts: must be {must}")
    return shown_parts(",".join(words))
