"""A window by ti.GUI, Taichi's plain one, which shows what is painted here: no Vulkan needed.

What is seen is drawn into the window's own buffer by `rasterizer.py` (with depth) and `painter.py`.
"""

from __future__ import annotations

import os
import sys
import time
from dataclasses import replace
from typing import Any

import numpy as np

from taichi_cloth import painter
from taichi_cloth.painter import Shapes
from taichi_cloth.rasterizer import Balls, Lines, Mesh, Rasterizer, Still
from taichi_cloth.runtime import refuse_other_threads
from taichi_cloth.scene.model import World
from taichi_cloth.ui import drawing, in_space, pointer, style, surfaces, veiled, x11
from taichi_cloth.ui.camera import Camera
from taichi_cloth.ui.chrome.layout import Rect
from taichi_cloth.ui.drawing import Cached
from taichi_cloth.ui.framing import camera_of_world
from taichi_cloth.ui.inputs import (
    BUTTON_NAMES,
    Event,
    changed,
    fewest_moves,
    key_name,
    released,
    said_by_x,
)
from taichi_cloth.ui.pointer import Pointer
from taichi_cloth.ui.surfaces import Solid, Topology
from taichi_cloth.ui.tiles import Panel
from taichi_cloth.ui.views.contract import Half, Picture, ViewKind, no_display
from taichi_cloth.ui.window_map import Look, WindowMap

SETTLED = 0.2  # seconds a new size must last before the window follows it
OPAQUE = 0xFF000000
SAMPLES = 2  # a pixel of a 3-D scene is the mean of the square of so many: smooth edges
LOOKED_AT, ENOUGH = 30, 0.012  # frames of a window in which a scene takes longer [s] to draw: 1
EDGE_PARTS = 16  # of the world's edges


class GuiView:
    """A ti.GUI window, or with `visible` False the same picture in memory."""

    name = "gui"
    quicker = ""
    _opened = 0

    def __init__(self, world: World, size: tuple[int, int], title: str, *, visible: bool = True):
        self.world, self.visible, self._title = world, visible, title
        self.camera: Camera | None = camera_of_world(world)
        self.room: Rect | None = None
        self.look: Look | None = None
        self.text_size = 1.0
        self.has_wheel = True
        self.closed = False
        self._gui: Any = None  # a ti.GUI
        self._tap: x11.Connection | None = None
        self._listens = False  # whether it hears of all events itself
        self._held: set[str] = set()
        self._springs, self._discs = Cached(_prepared_springs), Cached(_prepared_discs)
        self._faces = Cached(_prepared_faces), Cached(_prepared_faces)
        self._topologies = Cached(Topology.build), Cached(Topology.build)
        self._veils = veiled.Veils()
        self._sides_of, self._solids_color = Cached(_sides), Cached(_floats)
        self._spring_colors = Cached(style.spring_colors)
        self._rasterizers: dict[int, Rasterizer] = {}  # by samples
        self._still = Cached(self._make_still)
        self._stood: Still | None = None  # in the frame before
        self._seen_from: tuple[float, ...] = ()  # then
        self._turning = False
        self._samples, self._drawn, self._quickest = SAMPLES, 0, np.inf
        self._adapts = visible  # whether it draws with fewer samples where that takes too long
        self._halves: list[GuiView] = []  # draw two worlds beside each other
        self._wanted: tuple[tuple[int, int], float] | None = None
        self._open(size)

    def _open(self, size: tuple[int, int]) -> None:
        import taichi as ti

        # ti.GUI opens with a name of its own, by which it is found on X11, and is then renamed.
        GuiView._opened += 1
        name = f"taichi-cloth {os.getpid()}.{GuiView._opened}" if self.visible else self._title
        with x11.opening() as displays:
            self._gui = ti.GUI(name, size, show_gui=self.visible, fast_gui=True)
        self._gui.fps_limit = None  # the app paces itself
        self.size = size
        self._frame = _frame_of(self._gui.img.reshape(size[::-1]))
        self._rasterizers = {}  # of the size before
        if self.visible:
            # The pointer comes later, and nobody should wait then for a kernel to be compiled.
            painter.draw(self._frame, [painter.discs(np.full((1, 2), -9.0), np.ones(1), 0)])
            self._gui.show()  # only now does the window have its name
            self._tap = x11.connect(name, displays)
            self._listens = bool(self._tap and self._tap.listen())
            self._gui.core.title = self._title

    @property
    def _map(self) -> WindowMap:
        return WindowMap.of(self.world, self.size, self.room, self.look)

    @property
    def _room_height(self) -> int:
        return self.room.height if self.room else self.size[1]

    def turn_to(self, world: World, camera: Camera | None) -> None:
        """Show another world from now on; camera: of a 3-D one."""
        self.world, self.camera, self.look = world, camera, None
        self._halves = []
        self._rasterizers = {}  # how finely it is drawn is found out anew
        self._samples, self._drawn, self._quickest = SAMPLES, 0, np.inf

    def entitle(self, title: str) -> None:
        """Write a title over the window, if there is one."""
        if title != self._title and not self.closed:
            self._title = title
            if self.visible:
                self._gui.core.title = title

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
        if self._tap and self._listens:
            closes = any(event.key == self._gui.EXIT for event in self._gui.get_events())
            out = [*said_by_x(self._tap.inputs(), self.size, self._held)]
        else:
            closes, out = self._reported()
        if closes or not self._gui.running:
            self.close()
            return []
        if self._tap and self._tap.lost_focus():
            out += released(self._held)
        if self._tap and self._tap.leaves():
            out.append(Event("leave"))
        self._follow_resize()
        return fewest_moves(out)

    def _reported(self) -> tuple[bool, list[Event]]:
        """Whether ti.GUI says that the window closes, and the events that it reports."""
        gui, out = self._gui, list[Event]()
        for event in gui.get_events():
            pointer, name = self._pixel(*event.pos), key_name(event.key)
            kind = "press" if event.type == gui.PRESS else "release"
            if event.key == gui.EXIT:
                return True, []
            if event.key == gui.WHEEL:
                out.append(Event("wheel", pos=pointer, delta=event.delta[1] / 120))
            elif event.type == gui.MOTION:
                if 0 <= event.pos[0] <= 1 and 0 <= event.pos[1] <= 1:
                    out.append(Event("move", pos=pointer))
            elif event.key in BUTTON_NAMES:
                out.append(Event(kind, pos=pointer, button=BUTTON_NAMES[event.key]))
            elif name:
                out += changed(kind, name, self._held)
        return False, out

    def _pixel(self, x: float, y: float) -> tuple[float, float]:
        """A position of ti.GUI's events in window pixels: it counts rows from the last one up."""
        return round(x * self.size[0], 3), round((1 - y) * self.size[1] - 1, 3)

    # Drawing

    def draw(self, picture: Picture) -> None:
        """Draw and present one frame."""
        if self.closed:
            return
        refuse_other_threads()  # kernels draw it
        if picture.beside is not None:
            self._draw_halves(picture, picture.beside)
        elif self.camera:
            begin = time.perf_counter()
            self._compose_3d(picture, self.camera)
            self._look_at(time.perf_counter() - begin)
        else:
            self._compose_2d(picture)
        for panel in picture.overlay:
            self._lay(panel)
        if self.visible:
            if sys.platform == "darwin":
                self._gui.img[:] = _turned(self._frame).reshape(-1)
            self._gui.show()

    def _draw_halves(self, picture: Picture, half: Half) -> None:
        """Have two worlds drawn in memory, each as wide as its room, and put beside each other."""
        room = self.room or Rect(0, 0, *self.size)
        if [view.size for view in self._halves] != [(half.room.width, self.size[1])] * 2:
            size = half.room.width, self.size[1]
            self._halves = [GuiView(self.world, size, "", visible=False) for _ in range(2)]
        for view, some, place in zip(
            self._halves, (picture, half.picture), (room, half.room), strict=True
        ):
            view.camera, view.look = self.camera, self.look
            view.room, view._adapts = replace(place, x=0), self.visible
            pointer = some.pointer and replace(
                some.pointer, place=some.pointer.place - np.array([place.x, 0.0])
            )
            view.draw(replace(some, overlay=(), beside=None, pointer=pointer))
            self._frame[:, place.x : place.x + place.width] = view._frame

    def grab(self) -> np.ndarray:
        """The frame drawn last, (height, width, 3) uint8, row 0 on top."""
        return np.stack([(self._frame >> place).astype(np.uint8) for place in (16, 8, 0)], axis=2)

    def close(self) -> None:
        """Give the window back. May be called twice."""
        if not self.closed:
            self.closed = True
            if self._tap:
                self._tap.close()
            self._gui.close()

    def _compose_2d(self, picture: Picture) -> None:
        """Paint what there is, one upon another."""
        self._surround(*self._map.box())
        painter.draw(self._frame, [*self._shapes(picture, self._map), *_pointer(picture.pointer)])

    def _surround(self, low: np.ndarray, high: np.ndarray) -> None:
        """Paint the world's paper, and a darker one beside it in the room."""
        self._frame.fill(style.packed_one(style.WORLD))
        room = self.room or Rect(0, 0, *self.size)
        whole = self._frame[room.y : room.y + room.height, room.x : room.x + room.width]
        x0, y0 = np.clip(np.round(low - [room.x, room.y]), 0, whole.shape[::-1]).astype(int)
        x1, y1 = np.clip(np.round(high - [room.x, room.y]), 0, whole.shape[::-1]).astype(int)
        for beside in (whole[:y0], whole[y1:], whole[y0:y1, :x0], whole[y0:y1, x1:]):
            beside[:] = style.packed_one(style.SURROUND)

    def _shapes(self, picture: Picture, window: WindowMap) -> list[Shapes]:
        """What is painted of a plane: walls, solids, surfaces, springs, particles."""
        walls = window.walls(self.world.walls)
        found = [painter.lines(walls[:, 0], walls[:, 1], 1.5, style.packed_one(style.WALL))]
        veil: list[Shapes] = []
        if picture.ghost is not None:
            width = drawing.line_width(self._room_height)
            veil = veiled.shapes(picture.ghost, window, width)
            found += [] if picture.ghost.over else veil
        if picture.solids is not None:
            faces = picture.solids.triangles
            corner = window.to_window(picture.solids.vertex).take(faces, axis=0)
            found.append(painter.triangles(corner, *self._faces[1](faces, picture.solids.color)))
        place = window.to_window(picture.position)
        shown = drawing.are_numbers(place)
        faces = drawing.between_shown(picture.triangles, shown)
        if len(faces):
            corner = place.take(faces, axis=0)
            found.append(
                painter.triangles(corner, *self._faces[0](faces, picture.color_in_surfaces))
            )
        segments = drawing.between_shown(picture.segments, shown)
        if len(segments):
            first, second, color = self._springs(segments, picture.color, picture.spring_color)
            wide = drawing.line_width(self._room_height)
            found.append(
                painter.lines(place.take(first, axis=0), place.take(second, axis=0), wide, color)
            )
        if picture.as_spheres is not None:
            shown &= picture.as_spheres
        if shown.any():
            place, radius, color = drawing.shown_particles(place, picture, shown)
            for disc in self._discs(radius, color, window.scale):
                found.append(painter.discs(place, *disc))
        return [*found, *veil] if picture.ghost and picture.ghost.over else found

    def _compose_3d(self, picture: Picture, camera: Camera) -> None:
        """Draw what there is with a depth buffer, and the pointer over it."""
        eye = np.array([0.0, 0.0, camera.distance])
        position = camera.rotate_points(picture.position) + eye
        shown = drawing.are_numbers(position)
        segments = drawing.between_shown(picture.segments, shown)
        balls, ghost = [self._balls(picture, position, shown)], picture.ghost
        still, keep = self._standing(camera, picture.solids), True
        if still is not self._stood:  # it changes with each frame, or did so just now
            self._stood, keep = still, False
        lines = [] if keep else [*still.lines]
        meshes = self._meshes(picture, camera, position, shown)
        focal = camera.focal_length * self._map.scale
        if len(segments):
            lines.append(self._spring_lines(picture, segments, position, focal / camera.distance))
        if ghost is not None:
            width = drawing.spring_width(self.size[1])
            of_mesh, of_balls, of_lines = self._veils.of(ghost, camera, width)
            meshes, balls, lines = meshes + of_mesh, balls + of_balls, lines + of_lines
        x, y = self._map.to_window(camera.middle)
        self._fitting_rasterizer(picture).draw(
            self._frame,
            focal,
            (x, y),
            camera.nearest_drawn,
            in_space.lights(2 if picture.has_surfaces else 1),
            style.unit(style.WORLD),
            meshes=meshes if keep else [*still.meshes, *meshes],
            balls=balls,
            lines=lines,
            floor=in_space.floor(picture, camera),
            still=still if keep else None,
        )
        painter.draw(self._frame, _pointer(picture.pointer))

    def _fitting_rasterizer(self, picture: Picture) -> Rasterizer:
        """The one to draw with: a window's floor, made anew as one turns it, has fewer samples."""
        coarse = self._adapts and self._turning and picture.ground is not None
        samples = 1 if coarse else self._samples
        if samples not in self._rasterizers:
            self._rasterizers[samples] = Rasterizer(self.size, samples)
        return self._rasterizers[samples]

    def _look_at(self, seconds: float) -> None:
        """Draw with fewer samples in a window whose scene takes too long with more."""
        if not self._adapts or self._samples == 1 or self._turning:
            return
        self._drawn, self._quickest = self._drawn + 1, min(self._quickest, seconds)
        if self._drawn == LOOKED_AT:
            if self._quickest > ENOUGH:
                self._samples = 1
                self._rasterizers.pop(SAMPLES, None)
            self._drawn, self._quickest = 0, np.inf

    def _meshes(
        self, picture: Picture, camera: Camera, position: np.ndarray, shown: np.ndarray
    ) -> list[Mesh]:
        """The surfaces of cloths.

        position: (n, 3), of the picture's particles, from the eye in camera axes. shown: (n,) bool.
        """
        if not len(picture.triangles):
            return []
        topology = self._topologies[0](picture.triangles).of_shown(shown)
        front, back = self._sides_of(picture.color_in_surfaces)
        return [in_space.mesh(topology, camera, position, front, back, picture.normals)]

    def _standing(self, camera: Camera, solids: Solid | None) -> Still:
        """What only changes with the camera, or with obstacles: these, and the scenery."""
        seen = (camera.rot_x, camera.rot_y, camera.distance, camera.radius, *camera.centre)
        self._turning, self._seen_from = seen != self._seen_from, seen
        solid = (
            (None, None, None)
            if solids is None
            else (solids.vertex, solids.triangles, solids.color)
        )
        return self._still(camera, seen, self.size, *solid)

    def _make_still(
        self,
        camera: Camera,
        seen: tuple[float, ...],
        size: tuple[int, int],
        vertex: np.ndarray | None,
        triangles: np.ndarray | None,
        color: np.ndarray | None,
    ) -> Still:
        eye, meshes = np.array([0.0, 0.0, camera.distance]), []
        if vertex is not None and triangles is not None and color is not None:
            topology, colors = self._topologies[1](triangles), self._solids_color(color)
            place = camera.rotate_points(vertex) + eye
            meshes.append(in_space.mesh(topology, camera, place, colors, colors, None))
        return Still(meshes, [self._scenery(camera, eye)])

    def _balls(self, picture: Picture, position: np.ndarray, shown: np.ndarray) -> Balls:
        """The particles that are drawn."""
        if picture.as_spheres is not None:
            shown = shown & picture.as_spheres
        centre, radius = position[shown], picture.radius[shown]
        centre = np.ascontiguousarray(centre, np.float32)
        return Balls(centre, np.asarray(radius, np.float32), _floats(picture.color[shown]))

    def _scenery(self, camera: Camera, eye: np.ndarray) -> Lines:
        """The world's edges and axes, cut, so that a line stays one where its end is behind us."""
        edges, color = drawing.scenery(self.world, camera)
        end = camera.rotate_points(in_space.cut(edges, EDGE_PARTS).reshape(-1, 3)) + eye
        color = np.repeat(color, EDGE_PARTS, axis=0).astype(np.float32)
        wide = drawing.edge_width(self.size[1])
        wide_each = np.full(len(color), wide, np.float32)
        return Lines(end.astype(np.float32), color, wide_each, drawing.LIFTED)

    def _spring_lines(
        self, picture: Picture, segments: np.ndarray, position: np.ndarray, pixels: float
    ) -> Lines:
        """The springs; those of a surface lie in it, and are seen before it.

        segments: (s, 2), those that are drawn. pixels: that a world unit has where one looks.
        """
        color = self._spring_colors(picture.color, segments, picture.spring_color)
        wide = drawing.spring_width_on(picture, segments, pixels, self.size[1])
        return Lines(
            position.take(segments.reshape(-1), axis=0).astype(np.float32),
            np.ascontiguousarray(color, np.float32),
            np.full(len(segments), wide, np.float32),
            drawing.LIFTED if len(picture.triangles) else 0.0,
        )

    def _lay(self, panel: Panel) -> None:
        """Copy a panel over the frame."""
        packed = panel.tile.packed
        h, w = packed.shape
        self._frame[panel.y : panel.y + h, panel.x : panel.x + w] = packed


def _frame_of(buffer: np.ndarray) -> np.ndarray:
    """The picture (h, w) uint32, 0xRRGGBB, row 0 on top, that is drawn for a window's buffer.

    It is the buffer itself, but for macOS, whose windows have bytes in another order.
    """
    return np.zeros_like(buffer) if sys.platform == "darwin" else buffer


def _turned(frame: np.ndarray) -> np.ndarray:
    """A picture of 0xRRGGBB as macOS shows it: opaque, with red and blue in each other's places."""
    turned: np.ndarray = (frame & 255) << 16 | (frame & 0xFF00) | (frame >> 16 & 255) | OPAQUE
    return turned


def _pointer(drawn: Pointer | None) -> list[Shapes]:
    """The pointer, if it is drawn: its lines, on wider dark ones."""
    if drawn is None:
        return []
    first, second = drawn.lines().transpose(1, 0, 2)
    looks = ((pointer.SHADE, pointer.WIDE_SHADE), (pointer.COLOR, pointer.WIDE))
    return [painter.lines(first, second, wide, style.packed_one(color)) for color, wide in looks]


def _prepared_faces(triangles: np.ndarray, color: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which sides of flat triangles are the surface's edge, and packed colours."""
    return painter.outline(triangles), style.packed(style.flat_colors(color, triangles))


def _prepared_springs(
    segments: np.ndarray, color: np.ndarray, given: tuple[int, int, int] | np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """First ends, second ends, packed colours; for the rest `spring_colors`."""
    first, second = np.ascontiguousarray(segments.T)
    return first, second, style.packed(style.spring_colors(color, segments, given))


def _prepared_discs(
    radius: np.ndarray, color: np.ndarray, scale: float
) -> list[tuple[np.ndarray, np.ndarray]]:
    """(radius in pixels, packed colour) of the particles' darker rims, then of their discs."""
    layers = drawing.disc_layers(radius, color, scale)
    return [(pixels, style.packed(rgb)) for pixels, rgb in layers]


def _sides(color: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The colours (n, 3), floats 0..1, of a surface's front and back whose front has `color`."""
    return _floats(color), _floats(surfaces.back_of(color))


def _floats(color: np.ndarray) -> np.ndarray:
    return np.asarray(color / 255, np.float32)


VIEW = ViewKind(
    name="gui",
    windows=True,
    lack=no_display,
    pictures=lambda: True,
    several=True,
    open=GuiView,
)
