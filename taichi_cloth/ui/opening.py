"""Which view to open: what was asked for, or the best there is here."""

from __future__ import annotations

import sys

from taichi_cloth.errors import InputError, nearest
from taichi_cloth.render.camera import Camera
from taichi_cloth.scene.model import World
from taichi_cloth.settings.options import VIEWS
from taichi_cloth.ui import presenters, surroundings
from taichi_cloth.ui.chrome.layout import arrange, at_start
from taichi_cloth.ui.framing import window_of
from taichi_cloth.ui.halves import halves
from taichi_cloth.ui.presenters.contract import Kind
from taichi_cloth.ui.view import View


def usable_views() -> dict[str, str | None]:
    """Every kind of view: None if it can open here, else why not. Taichi is imported."""
    return {name: kind.lack() for name, kind in presenters.load_all().items()}


def avoided_by_auto(name: str) -> str | None:
    """Why `--view auto` leaves out a kind of view that can open here; None: it does not."""
    return presenters.load_all()[name].avoided()


def in_memory(world: World, size: tuple[int, int]) -> View:
    """A view that draws pictures of a world in memory; there may be several."""
    return View("none", world, size)


def offscreen(view: View, world: World) -> View:
    """A view in memory that shows what `view` shows, also after its window was closed."""
    copy = in_memory(world, view.size)
    copy.camera, copy.room, copy.text_size = view.camera, view.room, view.text_size
    return copy


def opens_window(kind: str) -> bool:
    """True if `open_view` opens a window for this kind, or for "auto"."""
    kinds = presenters.load_all()
    if kind != "auto":
        return kind in kinds and kinds[kind].open is not None
    return any(one.open is not None and one.lack() is None for one in kinds.values())


def open_view(
    kind: str,
    world: World,
    *,
    size: tuple[int, int] | None = None,
    title: str = "taichi-cloth",
    pictures: bool = False,
    camera: Camera | None = None,
    status: bool = True,
    text_size: float | None = None,
    pair: bool = False,
) -> View:
    """Open a view of `world`; `runtime.start` must have been called unless kind is "none".

    kind: "ggui", "gui", "none", or "auto": GGUI where a display and a graphics card's Vulkan are
        there, else ti.GUI where a display is, else none, with one line on standard error that says
        so.
    size: (width, height) in pixels; None: what suits world and screen.
    pictures: whether a view without a window must still draw (for images and films).
    camera: of a 3-D world; None: one that shows the whole of it.
    status: whether there will be a status beside the world.
    text_size: of what is written there, in parts of the usual; None: as large as the screen's user
        wants all text (`surroundings.Equipment.scale`), in a picture as usual.
    pair: whether two worlds are shown beside each other.

    Raises InputError where the kind that was asked for cannot be had.
    """
    if not isinstance(kind, str) or kind not in VIEWS:
        raise InputError(f"unknown view '{kind}'; {nearest(kind, VIEWS)}")
    kinds = presenters.load_all()
    chosen = _best(kinds) if kind == "auto" else kinds[kind]
    lack = chosen.lack()
    if lack is not None:
        raise InputError(f"--view {kind}: {lack}; --view none runs without a window")
    kind, visible = chosen.name, chosen.open is not None
    screen = surroundings.equipment() if visible else None
    text_size = text_size or (screen.scale if screen else 1.0)
    parts = at_start(windowed=visible, status=status, text=text_size)
    chosen_size = size or window_of(world, parts, screen.size if screen else None, 1 + pair)
    try:
        presenter = chosen.open(chosen_size, title) if chosen.open else None
    except RuntimeError as error:  # of Taichi: a display or driver that fails after all
        reason = str(error).strip().partition("\n")[0]
        raise InputError(f"--view {kind}: the window could not open: {reason}") from None
    view = View(kind, world, chosen_size, presenter, draws=visible or pictures)
    view.camera = camera or view.camera
    view.text_size = text_size
    layout = arrange(view.size, parts)
    view.room = halves(layout.world, layout.text).left if pair else layout.world
    return view


def _best(kinds: dict[str, Kind]) -> Kind:
    """The first kind that can be opened here; a line on standard error where it has no window."""
    lacks = {name: kind.lack() for name, kind in kinds.items()}
    usable = [kind for name, kind in kinds.items() if lacks[name] is None]
    if usable[0].open is None:
        # What the view lacks that needs least.
        lack = [reason for reason in lacks.values() if reason is not None][-1]
        print(f"no window: {lack}; running headless", file=sys.stderr)
        print(f"what works here: {surroundings.instead()}", file=sys.stderr)
        return usable[0]
    if surroundings.is_forwarded():
        print(
            f"the display comes over SSH, so windows are slow: {surroundings.KEPT}", file=sys.stderr
        )
        return next((kind for kind in usable if kind.name == "gui"), usable[0])
    return next(kind for kind in usable if kind.avoided() is None)
