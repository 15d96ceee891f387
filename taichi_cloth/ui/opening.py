"""Which view to open: what was asked for, or the best there is here."""

from __future__ import annotations

import sys

from taichi_cloth import runtime
from taichi_cloth.errors import InputError, nearest
from taichi_cloth.scene.model import World
from taichi_cloth.settings.options import VIEWS
from taichi_cloth.ui.layout import default_window
from taichi_cloth.ui.view import NullView, View

_DISPLAY = "there is no display (is DISPLAY set, and is its X server running?)"
_VULKAN = "GGUI needs Vulkan, which is not there (install a Vulkan driver, such as Mesa's)"


def usable_views() -> dict[str, str | None]:
    """Every kind of view: None if it can open here, else why not. Taichi is imported."""
    display = None if runtime.display_available() else _DISPLAY
    return {
        "ggui": display or (None if runtime.vulkan_available() else _VULKAN),
        "gui": display,
        "none": None,
    }


def offscreen(view: View, world: World) -> View:
    """A view in memory that shows what `view` shows, also after its window was closed."""
    from taichi_cloth.ui.gui_view import GuiView

    # On ti.GUI, because a second GGUI window in a process ends it.
    copy = GuiView(world, tuple(view.size), "", visible=False)
    copy.camera = view.camera
    return copy


def open_view(
    kind: str,
    world: World,
    *,
    size: tuple[int, int] | None = None,
    title: str = "taichi-cloth",
    pictures: bool = False,
) -> View:
    """Open a view of `world`; `runtime.start` must have been called unless kind is "none".

    kind: "ggui", "gui", "none", or "auto": GGUI where a display and Vulkan are there, else
        ti.GUI where a display is, else none, with one line on standard error that says so.
    size: (width, height) in pixels; None: the world's own size where a screen allows it.
    pictures: whether a view without a window must still draw (for images and films); it uses
        GGUI where Vulkan is there, else ti.GUI, both off-screen.

    Raises InputError where the kind that was asked for cannot be had.
    """
    if kind not in VIEWS:
        raise InputError(f"unknown view '{kind}'; {nearest(kind, VIEWS)}")
    if kind == "none" and not pictures:
        return NullView(world, size)
    size = tuple(size or default_window(world.size))
    from taichi_cloth.ui.ggui_view import GguiView
    from taichi_cloth.ui.gui_view import GuiView

    if kind != "none":
        usable = usable_views()
        if kind == "auto":
            kind = next(name for name, reason in usable.items() if reason is None)
            if kind == "none":
                print(f"no window: {_DISPLAY}; running headless", file=sys.stderr)
                return open_view("none", world, size=size, title=title, pictures=pictures)
        elif usable[kind] is not None:
            raise InputError(f"--view {kind}: {usable[kind]}; --view none runs without a window")
    visible = kind != "none"
    of = GguiView if kind == "ggui" or (not visible and runtime.vulkan_available()) else GuiView
    try:
        return of(world, size, title, visible=visible)
    except RuntimeError as error:  # of Taichi: a display or driver that fails after all
        reason = str(error).strip().partition("\n")[0]
        raise InputError(f"--view {kind}: the window could not open: {reason}") from None
