"""Drawing with ti.GUI, Taichi's plain window: no Vulkan needed, painter's order for depth."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from taichi_cloth.scene.model import World
from taichi_cloth.ui import drawing, style, surfaces, text, x11
from taichi_cloth.ui.camera import Camera
from taichi_cloth.ui.drawing import Cached
from taichi_cloth.ui.framing import camera_of_world
from taichi_cloth.ui.inputs import BUTTON_NAMES, Event, fewest_moves, key_name
from taichi_cloth.ui.surfaces import Topology
from taichi_cloth.ui.views.contract import Picture, ViewKind, no_display
from taichi_cloth.ui.window_map import WindowMap

SETTLED = 0.2  # seconds a new size must last before the window follows it
LAYERS = 12  # discs that a large sphere is painted with
SLABS = 256  # springs, surfaces and spheres are interleaved by depth in at most so many groups


class GuiView:
    """A ti.GUI window, or with `visible` False the same picture in memory."""

    name = "gui"
    _opened = 0

    def __init__(self, world: World, size: tuple[int, int], title: str, *, visible: bool = True):
        self.world, self.visible, self._title = world, visible, title
        self.camera: Camera | None = camera_of_world(world)
        self.has_wheel = True
        self.closed = False
        self._gui: Any = None  # a ti.GUI
        self._tap: x11.Connection | None = None
        self._held: set[str] = set()
        self._springs, self._discs = Cached(_prepared_springs), Cached(_prepared_discs)
        self._topologies = Cached(Topology.build), Cached(Topology.build)
        self._back_of = Cached(surfaces.back_of)
        self._wanted: tuple[tuple[int, int], float] | None = None
        self._open(size)

    def _open(self, size: tuple[int, int]) -> None:
        import taichi as ti

        # ti.GUI opens with a name of its own, by which it is found on X11, and is then renamed.
        GuiView._opened += 1
        name = f"taichi-cloth {os.getpid()}.{GuiView._opened}" if self.visible else self._title
        with x11.opening() as displays:
            self._gui = ti.GUI(name, size, style.packed_one(style.WORLD), show_gui=self.visible)
        self._gui.fps_limit = None  # the app paces itself
        self.size = size
        self._map = WindowMap.of(self.world, size)
        self._pixels = np.zeros((*size, 4), np.float32)
        if self.visible:
            self._gui.show()  # only now does the window have its name
            self._tap = x11.connect(name, displays)
            self._gui.core.title = self._title

    def _follow_resize(self) -> None:
        """Open the window anew at the size the user gave it.

        ti.GUI's canvas keeps its first size: the rest of a larger window stays empty, and a
        smaller one cuts the picture off.
        """
        tap = self._tap
        size = tap.size() if tap else None
        if tap is None or size is None or size == self.size or min(size) < 64:
            self._wanted = None
            return
        now = time.perf_counter()
        if self._wanted is None or self._wanted[0] != size:
            self._wanted = (size, now)
        elif now - self._wanted[1] >= SETTLED:
            position = tap.position()
            tap.close()
            self._gui.close()
            self._open(size)
            if self._tap is not None:
                self._tap.move(position)
            self._wanted = None

    # Events

    def poll(self) -> list[Event]:
        """The user's events since the last call, oldest first.

        Raises ConnectionCut where the window's connection to the display is cut.
        """
        if self.closed or not self.visible:
            return []
        if self._tap and self._tap.is_gone():
            cut = self._tap.is_cut()
            self.close()
            if cut:
                raise x11.ConnectionCut
            return []
        gui = self._gui
        out: list[Event] = []
        for event in gui.get_events():
            pointer = self._pixel(*event.pos)
            if event.key == gui.EXIT:
                self.close()
                return []
            if event.key == gui.WHEEL:
                out.append(Event("wheel", pos=pointer, delta=event.delta[1] / 120))
                continue
            if event.type == gui.MOTION:
                if 0 <= event.pos[0] <= 1 and 0 <= event.pos[1] <= 1:
                    out.append(Event("move", pos=pointer))
                continue
            kind = "press" if event.type == gui.PRESS else "release"
            if event.key in BUTTON_NAMES:
                out.append(Event(kind, pos=pointer, button=BUTTON_NAMES[event.key]))
            elif key_name(event.key):
                out.append(Event(kind, key=key_name(event.key)))
        if not gui.running:
            self.close()
            return []
        self._follow_resize()
        return fewest_moves(self._without_repeats(out))

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
            self._compose_3d(picture, self.camera)
        else:
            self._compose_2d(picture)
        self._compose_overlay(picture)
        if self.visible:
            self._gui.show()

    def grab(self) -> np.ndarray:
        """The frame drawn last, (height, width, 3) uint8, row 0 on top."""
        return drawing.as_image(self._pixels)

    def close(self) -> None:
        """Give the window back. May be called twice."""
        if not self.closed:
            self.closed = True
            if self._tap:
                self._tap.close()
            self._gui.close()

    def _compose_2d(self, picture: Picture) -> None:
        window = self._map
        low, high = window.box()
        self._surround(low, high)
        walls = window.walls(self.world.walls)
        if len(walls):
            a, b = window.to_canvas(walls[:, 0]), window.to_canvas(walls[:, 1])
            self._gui.lines(a, b, radius=0.75, color=style.packed_one(style.WALL))
        place = window.world_to_canvas(picture.position)
        shown = drawing.are_numbers(place)
        if picture.solids is not None:
            corner = window.world_to_canvas(picture.solids.vertex)
            flat = style.flat_colors(picture.solids.color, picture.solids.triangles)
            corners = corner.take(picture.solids.triangles.T, axis=0)
            self._gui.triangles(*corners, style.packed(flat))
        faces = drawing.between_shown(picture.triangles, shown)
        if len(faces):
            codes = style.packed(style.flat_colors(picture.color, faces))
            self._gui.triangles(*place.take(faces.T, axis=0), codes)
        segments = drawing.between_shown(picture.segments, shown)
        if len(segments):
            first, second, color = self._springs(segments, picture.color, picture.spring_color)
            a, b = place.take(first, axis=0), place.take(second, axis=0)
            self._gui.lines(a, b, radius=max(1.0, 0.75 * window.scale), color=color)
        if picture.as_spheres is not None:
            shown &= picture.as_spheres
        if shown.any():
            place, radius, color = drawing.shown_particles(place, picture, shown)
            for disc in self._discs(radius, color, window.scale):
                self._gui.circles(place, *disc)

    def _surround(self, low: np.ndarray, high: np.ndarray) -> None:
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
                a, b, c, d = self._map.to_canvas([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
                self._gui.triangle(a, b, c, color)
                self._gui.triangle(a, c, d, color)

    def _compose_3d(self, picture: Picture, camera: Camera) -> None:
        """Sort lines, triangles and spheres by depth and paint them from the far end."""
        position = np.asarray(picture.position, np.float64)
        pixels, radii, depths = camera.project(position, picture.radius)
        shown = np.isfinite(depths) & (depths > camera.nearest_drawn)
        if picture.ground is not None:
            self._draw_floor(picture.ground, camera)
        lines = self._lines(picture, camera, position, shown)
        faces = self._faces(picture, camera, shown)
        if picture.as_spheres is not None:
            shown &= picture.as_spheres
        centre, depth = self._map.to_window(pixels[shown]), depths[shown]
        radius, rgb = radii[shown] * self._map.scale, picture.color[shown] / 255
        if not camera.y_up:
            dot, _, dot_depth = camera.project(np.zeros((1, 3)))
            centre = np.concatenate([centre, self._map.to_window(dot)])
            radius = np.concatenate([radius, [drawing.origin_radius(self.size[1])]])
            depth = np.concatenate([depth, dot_depth])
            rgb = np.concatenate([rgb, [np.array(style.ORIGIN) / 255]])
        order = np.argsort(-depth, kind="stable")
        centre, radius, depth, rgb = centre[order], radius[order], depth[order], rgb[order]

        cuts = depth[:: max(1, len(depth) // SLABS)]
        if len(faces.depth):
            among = np.sort(np.concatenate([depth, lines.depth]))[::-1]
            cuts = among[:: max(1, len(among) // SLABS)]
        line = face = ball = 0
        for cut, below in zip(cuts, [*cuts[1:], -np.inf], strict=True):
            line = self._draw_lines(lines, line, _until(lines.depth, cut))
            face = self._draw_faces(faces, face, _until(faces.depth, cut))
            last = int(np.searchsorted(-depth, -below, side="left"))
            self._draw_spheres(centre[ball:last], radius[ball:last], rgb[ball:last])
            ball = max(ball, last)
        self._draw_lines(lines, line, len(lines.depth))
        self._draw_faces(faces, face, len(faces.depth))

    def _draw_floor(self, height: float, camera: Camera) -> None:
        """Paint the floor: below everything, as nothing is seen from under it."""
        corner, color, opacity = surfaces.floor(height, camera.centre, camera.radius)
        pixels, _, depths = camera.project(corner.reshape(-1, 3))
        front = (depths > camera.nearest_drawn).reshape(-1, 4).all(axis=1)
        up = camera.rotation()[:, 1] * (1 if camera.y_up else -1)
        share = opacity.mean(axis=1)[:, None]
        behind = np.array(style.unit(style.WORLD))
        rgb = share * surfaces.brightness(up) * color[:, 0] + (1 - share) * behind
        places = self._map.to_canvas(self._map.to_window(pixels)).reshape(-1, 4, 2)[front]
        codes = style.packed(rgb)[front]
        if len(codes):
            a, b, c, d = places.transpose(1, 0, 2)
            self._gui.triangles(a, b, c, codes)
            self._gui.triangles(a, c, d, codes)

    def _faces(self, picture: Picture, camera: Camera, shown: np.ndarray) -> _Faces:
        """The triangles of all surfaces, the far ones first."""
        parts, solids = [], picture.solids
        if len(picture.triangles):
            topology = self._topologies[0](picture.triangles).of_shown(shown)
            back = self._back_of(picture.color)
            parts.append(
                surfaces.painted(
                    topology, camera, picture.position, picture.color, back, picture.normals
                )
            )
        if solids is not None:
            topology = self._topologies[1](solids.triangles)
            parts.append(surfaces.painted(topology, camera, solids.vertex, solids.color))
        if not parts:
            return _Faces(np.zeros((0, 3, 2)), np.zeros(0, np.uint32), np.zeros(0))
        pixels, color, depth = (np.concatenate(columns) for columns in zip(*parts, strict=True))
        order = np.argsort(-depth, kind="stable")
        places = self._map.world_to_canvas(pixels[order].reshape(-1, 2))
        return _Faces(places.reshape(-1, 3, 2), style.packed(color)[order], depth[order])

    def _lines(
        self, picture: Picture, camera: Camera, position: np.ndarray, shown: np.ndarray
    ) -> _Lines:
        """The world's edges and the springs between particles that are shown, the far ones first.

        Long lines are cut, so that a part of one may lie behind a sphere and another before it.
        """
        edges, edge_color = drawing.scenery(self.world, camera)
        edges = _cut(edges, 8)
        ends, color = [edges], [np.repeat(edge_color, 8, axis=0)]
        width = [np.full(len(edges), 2.2)]
        segments = drawing.between_shown(picture.segments, shown)
        if len(segments):
            parts = 4 if len(segments) < 4000 else 1
            ends.append(_cut(_outside(position[segments], picture.radius[segments]), parts))
            rgb = style.spring_colors(picture.color, segments, picture.spring_color)
            color.append(np.repeat(rgb, parts, axis=0))
            pixel = camera.focal_length * self._map.scale / camera.distance
            wide = drawing.spring_width_on(picture, segments, pixel, self.size[1])
            width.append(np.full(len(ends[-1]), wide))
        pixels, _, depths = camera.project(np.concatenate(ends).reshape(-1, 3))
        depths = depths.reshape(-1, 2)
        front = np.flatnonzero((depths > camera.nearest_drawn).all(axis=1))
        depth = depths.mean(axis=1)
        if len(picture.triangles):  # springs lie in them: a little before them
            depth -= np.linalg.norm(np.diff(np.concatenate(ends), axis=1), axis=2)[:, 0]
        order = front[np.argsort(-depth[front], kind="stable")]
        return _Lines(
            self._map.to_window(pixels).reshape(-1, 2, 2)[order],
            style.packed(np.concatenate(color)[order]),
            np.concatenate(width)[order],
            depth[order],
        )

    def _draw_faces(self, faces: _Faces, first: int, last: int) -> int:
        """Draw the triangles from `first` to before `last`; where to go on."""
        if last > first:
            a, b, c = faces.place[first:last].transpose(1, 0, 2)
            self._gui.triangles(a, b, c, faces.color[first:last])
        return max(first, last)

    def _draw_lines(self, lines: _Lines, first: int, last: int) -> int:
        """Draw the lines from `first` to before `last`; where to go on."""
        if last > first:
            ends = lines.pixels[first:last]
            a, b = self._map.to_canvas(ends[:, 0]), self._map.to_canvas(ends[:, 1])
            width, color = lines.width[first:last], lines.color[first:last]
            self._gui.lines(a, b, radius=width / 2, color=color)
        return max(first, last)

    def _draw_spheres(self, centre: np.ndarray, radius: np.ndarray, rgb: np.ndarray) -> None:
        """Draw shaded discs in the order given (far to near).

        centre: (k, 2) window pixels. radius: (k,) window pixels. rgb: (k, 3) floats 0..1.
        """
        if not len(centre):
            return
        size, shift, bright = shading(int(np.clip(radius.max(initial=0.0), 1, LAYERS)))
        spots = centre[:, None, :] + (radius[:, None] * shift)[:, :, None] * style.LIGHT[:2]
        places = self._map.to_canvas(spots.reshape(-1, 2))
        colors = style.packed((rgb[:, None, :] * bright[:, None]).reshape(-1, 3))
        self._gui.circles(places, radius=(radius[:, None] * size).reshape(-1), color=colors)

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


@dataclass(frozen=True)
class _Lines:
    """Lines in 3-D as they are painted, the far ones first.

    pixels: (k, 2, 2) window pixels of their ends. color: (k,) packed.
    width: (k,) pixels. depth: (k,) of their middles, world units.
    """

    pixels: np.ndarray
    color: np.ndarray
    width: np.ndarray
    depth: np.ndarray


@dataclass(frozen=True)
class _Faces:
    """Triangles in 3-D as they are painted, the far ones first.

    place: (m, 3, 2) of their corners on the canvas. color: (m,) packed.
    depth: (m,) by which they are ordered, world units.
    """

    place: np.ndarray
    color: np.ndarray
    depth: np.ndarray


def _until(depth: np.ndarray, cut: float) -> int:
    """How many of the depths, the far ones first, are at least `cut`."""
    return int(np.searchsorted(-depth, -cut, side="right"))


def _prepared_springs(
    segments: np.ndarray, color: np.ndarray, all_have: tuple[int, int, int] | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """First ends, second ends, packed colours; for the rest `spring_colors`."""
    first, second = np.ascontiguousarray(segments.T)
    return first, second, style.packed(style.spring_colors(color, segments, all_have))


def _prepared_discs(
    radius: np.ndarray, color: np.ndarray, scale: float
) -> list[tuple[np.ndarray, np.ndarray]]:
    """(radius in pixels, packed colour) of the particles' darker rims, then of their discs."""
    layers = drawing.disc_layers(radius, color, scale)
    return [(pixels, style.packed(rgb)) for pixels, rgb in layers]


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


def _outside(ends: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Lines (k, 2, 3) without the parts inside the spheres, of `radius` (k, 2), at their ends."""
    along = ends[:, 1] - ends[:, 0]
    length = np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    # Half of the line at most from each side: overlapping spheres leave nothing to draw.
    first, last = np.minimum(radius / length, 0.5).T[:, :, None]
    return np.stack([ends[:, 0] + first * along, ends[:, 1] - last * along], axis=1)


def _cut(ends: np.ndarray, parts: int) -> np.ndarray:
    """Lines (k, 2, 3) cut into equal `parts`, (k * parts, 2, 3)."""
    t = np.linspace(0, 1, parts + 1)[:, None]
    points = ends[:, None, 0] * (1 - t) + ends[:, None, 1] * t
    return np.stack([points[:, :-1], points[:, 1:]], axis=2).reshape(-1, 2, 3)


VIEW = ViewKind(
    name="gui",
    windows=True,
    lack=no_display,
    pictures=lambda: True,
    several=True,
    open=GuiView,
)
