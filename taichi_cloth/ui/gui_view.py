"""Drawing with ti.GUI, Taichi's plain window: no Vulkan needed, painter's order for depth."""

from __future__ import annotations

import os
import time

import numpy as np

from taichi_cloth.files.events import Event
from taichi_cloth.scene.model import World
from taichi_cloth.ui import style, text, x11
from taichi_cloth.ui.camera import Camera
from taichi_cloth.ui.layout import Layout
from taichi_cloth.ui.view import KEYS, Kept, Picture, are_numbers, between_shown

BUTTONS = {"LMB": "left", "MMB": "middle", "RMB": "right"}
SETTLED = 0.2  # seconds a new size must last before the window follows it
LAYERS = 12  # discs that a large sphere is painted with
SLABS = 256  # springs and spheres are interleaved by depth in at most so many groups


class GuiView:
    """A ti.GUI window, or with `visible` False the same picture in memory."""

    name = "gui"
    _opened = 0

    def __init__(self, world: World, size: tuple[int, int], title: str, *, visible: bool = True):
        self.world, self.visible, self._title = world, visible, title
        self.camera = Camera(world.size) if world.dim == 3 else None
        self.has_wheel = True
        self.closed = False
        self._gui, self._tap = None, None
        self._pointer: tuple[float, float] | None = None
        self._held: set[str] = set()
        self._springs, self._discs = Kept(), Kept()
        self._wanted: tuple[tuple[int, int], float] | None = None
        self._open(size)

    def _open(self, size: tuple[int, int]) -> None:
        import taichi as ti

        # ti.GUI opens with a name of its own, by which it is found on X11, and is then renamed.
        GuiView._opened += 1
        name = f"taichi-cloth {os.getpid()}.{GuiView._opened}" if self.visible else self._title
        self._gui = ti.GUI(name, size, style.packed_one(style.WORLD), show_gui=self.visible)
        self._gui.fps_limit = None  # the app paces itself
        self.size = size
        self._pixels = np.zeros((*size, 4), np.float32)
        if self.visible:
            self._gui.show()  # only now does the window have its name
            self._tap = x11.connect(name, keys=False)
            self._gui.core.title = self._title

    def _follow_resize(self) -> None:
        """Open the window anew at the size the user gave it.

        ti.GUI's canvas keeps its first size: the rest of a larger window stays empty, and a
        smaller one cuts the picture off.
        """
        size = self._tap.size() if self._tap else None
        if size is None or size == self.size or min(size) < 64:
            self._wanted = None
            return
        now = time.perf_counter()
        if self._wanted is None or self._wanted[0] != size:
            self._wanted = (size, now)
        elif now - self._wanted[1] >= SETTLED:
            position = self._tap.position()
            self._tap.close()
            self._gui.close()
            self._open(size)
            if self._tap:
                self._tap.move(position)
            self._wanted, self._pointer = None, None

    # Events

    def poll(self) -> list[Event]:
        """The user's events since the last call, oldest first."""
        if self.closed or not self.visible:
            return []
        if self._tap and self._tap.is_gone():
            self.close()
            return []
        gui, out = self._gui, []
        for event in gui.get_events():
            pointer = self._pixel(*event.pos)
            if event.key == gui.EXIT:
                self.close()
                return []
            if event.key == gui.WHEEL:
                out.append(Event("wheel", pos=pointer, delta=event.delta[1] / 120))
            elif event.type == gui.MOTION:
                continue  # one motion a frame is enough: see below
            elif event.key in BUTTONS:
                kind = "press" if event.type == gui.PRESS else "release"
                out.append(Event(kind, pos=pointer, button=BUTTONS[event.key]))
            else:
                name = KEYS.get(event.key)
                if name is None and len(event.key) == 1 and event.key.isalpha():
                    name = event.key.lower()
                if name:
                    out.append(Event("press" if event.type == gui.PRESS else "release", key=name))
        if not gui.running:
            self.close()
            return []
        x, y = gui.get_cursor_pos()
        pointer = self._pixel(x, y)
        moved = []
        if pointer != self._pointer and 0 <= x <= 1 and 0 <= y <= 1:
            if self._pointer is not None:
                moved.append(Event("move", pos=pointer))
            self._pointer = pointer
        self._follow_resize()
        return moved + self._without_repeats(out)

    def _pixel(self, x: float, y: float) -> tuple[float, float]:
        """A position of ti.GUI's events in window pixels: it counts rows from the last one up."""
        return round(x * self.size[0], 3), round((1 - y) * self.size[1] - 1, 3)

    def _without_repeats(self, events: list[Event]) -> list[Event]:
        """Drop auto-repeat, which X sends as a release with a press right behind it."""
        out: list[Event] = []
        for i, event in enumerate(events):
            if event.key is None:
                out.append(event)
            elif event.kind == "release":
                again = Event("press", key=event.key)
                if again not in events[i + 1 :]:
                    self._held.discard(event.key)
                    out.append(event)
            elif event.key not in self._held:
                self._held.add(event.key)
                out.append(event)
        return out

    # Drawing

    def draw(self, picture: Picture) -> None:
        """Draw and present one frame."""
        if self.closed:
            return
        self._gui.clear(style.packed_one(style.WORLD))
        if self.camera:
            self._compose_3d(picture)
        else:
            self._compose_2d(picture)
        self._compose_overlay(picture)
        if self.visible:
            self._gui.show()

    def grab(self) -> np.ndarray:
        """The frame drawn last, (height, width, 3) uint8, row 0 on top."""
        pixels = np.clip(self._pixels[:, ::-1, :3].transpose(1, 0, 2), 0, 1)
        return (pixels * 255 + 0.5).astype(np.uint8)

    def close(self) -> None:
        """Give the window back. May be called twice."""
        if not self.closed:
            self.closed = True
            if self._tap:
                self._tap.close()
            self._gui.close()

    def _on_canvas(self, points) -> np.ndarray:
        """Window pixels (k, 2) in the canvas's coordinates: 0..1, y up."""
        return Layout(self.world.size[:2], self.size).to_canvas(points)

    def _circles(self, centre, radius, color) -> None:
        """Discs at `centre` (k, 2) with `radius` (k,), window pixels, packed colours (k,)."""
        self._gui.circles(self._on_canvas(centre), radius=radius, color=color)

    def _compose_2d(self, picture: Picture) -> None:
        layout = Layout(self.world.size[:2], self.size)
        low, high = layout.to_window([0, 0]), layout.to_window(self.world.size[:2])
        self._surround(low, high)
        walls = layout.walls(self.world.walls)
        if len(walls):
            a, b = self._on_canvas(walls[:, 0]), self._on_canvas(walls[:, 1])
            self._gui.lines(a, b, radius=0.75, color=style.packed_one(style.WALL))
        place = layout.world_to_canvas(picture.position)
        shown = are_numbers(place)
        segments = between_shown(picture.segments, shown)
        if len(segments):
            first, second, color = self._springs.get(_prepared_springs, segments, picture.color)
            a, b = place.take(first, axis=0), place.take(second, axis=0)
            self._gui.lines(a, b, radius=max(1.0, 0.75 * layout.scale), color=color)
        if shown.any():
            radius, color = picture.radius, picture.color
            if not shown.all():
                place, radius, color = place[shown], radius[shown], color[shown]
            for disc in self._discs.get(_prepared_discs, radius, color, layout.scale):
                self._gui.circles(place, *disc)

    def _surround(self, low, high) -> None:
        """Darken what lies outside the world's rectangle (the canvas is the world's colour)."""
        w, h = self.size
        color = style.packed_one(style.SURROUND)
        for x0, y0, x1, y1 in (
            (0, 0, low[0], h),
            (high[0], 0, w, h),
            (0, 0, w, low[1]),
            (0, high[1], w, h),
        ):
            if x1 - x0 > 0.5 and y1 - y0 > 0.5:
                a, b, c, d = self._on_canvas([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
                self._gui.triangle(a, b, c, color)
                self._gui.triangle(a, c, d, color)

    def _compose_3d(self, picture: Picture) -> None:
        camera = self.camera
        layout = Layout(self.world.size[:2], self.size)
        # Everything is sorted by depth and painted from the far end; long lines are cut, so that
        # a part of one may lie behind a sphere and another before it.
        ends, color, width = [], [], []
        edges = _cut(style.box_edges(self.world.size), 8)
        ends.append(edges)
        color.append(np.tile(style.unit(style.EDGE), (len(edges), 1)))
        width.append(np.full(len(edges), 2.2))
        position = np.asarray(picture.position, np.float64)
        pixels, radii, depths = camera.project(position, picture.radius)
        shown = np.isfinite(depths) & (depths > camera.distance / 50)
        segments = picture.segments[shown[picture.segments].all(axis=1)]
        if len(segments):
            parts = 4 if len(segments) < 4000 else 1
            ends.append(_cut(_outside(position[segments], picture.radius[segments]), parts))
            spring = style.spring_colors(picture.color, segments)
            color.append(np.repeat(spring, parts, axis=0))
            width.append(np.full(len(ends[-1]), max(2.0, self.size[1] / 260)))
        line_ends, line_color = np.concatenate(ends), np.concatenate(color)
        line_width = np.concatenate(width)
        line_pixels, _, line_depths = camera.project(line_ends.reshape(-1, 3))
        line_pixels = layout.to_window(line_pixels).reshape(-1, 2, 2)
        line_depth = line_depths.reshape(-1, 2).mean(axis=1)
        front = (line_depths.reshape(-1, 2) > camera.distance / 50).all(axis=1)
        line_pixels, line_color = line_pixels[front], style.packed(line_color[front])
        line_depth, line_width = line_depth[front], line_width[front]

        dot, _, dot_depth = camera.project(np.zeros((1, 3)))
        centre = layout.to_window(np.concatenate([pixels[shown], dot]))
        scale = layout.scale
        radius = np.concatenate([radii[shown] * scale, [3.5 * max(1.0, self.size[1] / 600)]])
        depth = np.concatenate([depths[shown], dot_depth])
        rgb = np.concatenate([picture.color[shown], [style.ORIGIN]]) / 255
        order = np.argsort(-depth, kind="stable")
        centre, radius, depth, rgb = centre[order], radius[order], depth[order], rgb[order]
        order = np.argsort(-line_depth, kind="stable")
        line_pixels, line_color = line_pixels[order], line_color[order]
        line_depth, line_width = line_depth[order], line_width[order]

        step = max(1, len(depth) // SLABS)
        bounds = [*range(0, len(depth), step), len(depth)]
        first = 0
        for a, b in zip(bounds, bounds[1:], strict=False):
            last = int(np.searchsorted(-line_depth, -depth[a], side="right"))
            self._lines_of(line_pixels, line_color, line_width, first, last)
            self._spheres(centre[a:b], radius[a:b], rgb[a:b])
            first = max(first, last)
        self._lines_of(line_pixels, line_color, line_width, first, len(line_depth))

    def _lines_of(self, pixels, color, width, first: int, last: int) -> None:
        if last > first:
            a, b = self._on_canvas(pixels[first:last, 0]), self._on_canvas(pixels[first:last, 1])
            self._gui.lines(a, b, radius=width[first:last] / 2, color=color[first:last])

    def _spheres(self, centre, radius, rgb) -> None:
        """Shaded discs, in the order given (far to near)."""
        size, shift, bright = shading(int(np.clip(radius.max(initial=0.0), 1, LAYERS)))
        spots = centre[:, None, :] + (radius[:, None] * shift)[:, :, None] * style.LIGHT[:2]
        sizes = radius[:, None] * size
        colors = rgb[:, None, :] * bright[:, None]
        self._circles(spots.reshape(-1, 2), sizes.reshape(-1), style.packed(colors.reshape(-1, 3)))

    def _compose_overlay(self, picture: Picture) -> None:
        """Copy the text's pixels over the frame (and keep the frame for `grab`)."""
        panels = text.panels(picture, self.size)
        self._gui.core.get_img(self._pixels.ctypes.data)
        height = self.size[1]
        for panel in panels:
            h, w = panel.pixels.shape[:2]
            top = height - panel.y
            block = panel.pixels[::-1].transpose(1, 0, 2).astype(np.float32) / 255
            self._pixels[panel.x : panel.x + w, top - h : top, :3] = block
        if panels:
            self._gui.core.set_img(self._pixels.ctypes.data)


def _prepared_springs(segments, color):
    """First ends, second ends, packed colours; color: of the particles."""
    first, second = np.ascontiguousarray(segments.T)
    return first, second, style.packed(style.spring_colors(color, segments))


def _prepared_discs(radius, color, scale: float):
    """(radius in pixels, packed colour) of the particles' darker rims, then of their discs."""
    radius, color = np.maximum(radius * scale, 0.8), color / 255
    inner = np.maximum(radius - 1.2, 0.6 * radius)
    return (radius, style.packed(0.45 * color)), (inner, style.packed(color))


def shading(layers: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Discs that paint a lit sphere: radius, shift along the light, brightness; (layers,) each.

    Where a sphere's brightness is at least b, its normal is within an angle a = acos(b) of the
    light. That cap is seen as an ellipse around cos(a) times the light's direction; a disc of
    the radius sin(a) stands in for it, shrunk so that it stays inside the sphere's rim.
    """
    if layers < 3:
        return np.ones(1), np.zeros(1), np.full(1, 0.85)
    angle = np.linspace(0.5 * np.pi, 0, layers, endpoint=False)
    tilt = float(np.hypot(*style.LIGHT[:2]))  # how far the brightest point is from the centre
    shift = np.cos(angle)
    size = np.minimum(np.sin(angle), 1 - tilt * shift)
    bright = style.AMBIENT + (1 - style.AMBIENT) * np.cos(angle - angle[-1] / 2)
    return size, shift, bright


def _outside(ends, radius) -> np.ndarray:
    """Lines (k, 2, 3) without the parts inside the spheres, of `radius` (k, 2), at their ends."""
    along = ends[:, 1] - ends[:, 0]
    length = np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    # Half of the line at most from each side: overlapping spheres leave nothing to draw.
    first, last = np.minimum(radius / length, 0.5).T[:, :, None]
    return np.stack([ends[:, 0] + first * along, ends[:, 1] - last * along], axis=1)


def _cut(ends, parts: int) -> np.ndarray:
    """Lines (k, 2, 3) cut into equal `parts`, (k * parts, 2, 3)."""
    t = np.linspace(0, 1, parts + 1)[:, None]
    points = ends[:, None, 0] * (1 - t) + ends[:, None, 1] * t
    return np.stack([points[:, :-1], points[:, 1:]], axis=2).reshape(-1, 2, 3)
