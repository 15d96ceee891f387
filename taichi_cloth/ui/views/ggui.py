"""Drawing with GGUI, Taichi's Vulkan window: depth-buffered, fast, also off-screen.

`vertices.py` has the buffers that are drawn. GGUI has copied them when a call returns.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from taichi_cloth import runtime
from taichi_cloth.scene.model import World
from taichi_cloth.ui import drawing, pointer, rescue, style, text, x11
from taichi_cloth.ui.camera import Camera
from taichi_cloth.ui.chrome.layout import Rect
from taichi_cloth.ui.drawing import Cached
from taichi_cloth.ui.framing import camera_of_world
from taichi_cloth.ui.inputs import BUTTON_NAMES, BUTTONS, Event, fewest_moves, key_name
from taichi_cloth.ui.pointer import Pointer
from taichi_cloth.ui.surfaces import Topology, brightness, floor
from taichi_cloth.ui.text import Panel
from taichi_cloth.ui.vertices import (
    POSITION,
    RADIUS,
    STRIDE,
    FlatLines,
    LineMesh,
    SphereMeshes,
    SurfaceMesh,
    disc_vertices,
    floor_vertices,
    quads,
    vertices,
)
from taichi_cloth.ui.views.contract import Picture, ViewKind, no_display
from taichi_cloth.ui.window_map import Look, WindowMap

NO_VULKAN = "GGUI needs Vulkan, which is not there (install a Vulkan driver, such as Mesa's)"
WHEEL = {4: 1.0, 5: -1.0}  # X's numbers of the wheel's buttons -> notches away from the user
SETTINGS = Path("imgui.ini")  # of GGUI's text library, which we do not use
SMOOTH_LINES = 12_000  # so many lines in space have smooth edges, which take long to draw
MESH_VERTICES = 5_000  # spheres are meshes up to so many vertices (8 ms in software)
ENTITLED = 0.25  # seconds after which a title is written again
FAR_AWAY = 100.0  # lights of surfaces, in distances of the eye: their rays are parallel
SPHERES = ((10.0, 1), (45.0, 2), (math.inf, 3))  # up to this radius in pixels: subdivisions


class GguiView:
    """A GGUI window, or with `visible` False the same picture in memory."""

    name = "ggui"

    def __init__(self, world: World, size: tuple[int, int], title: str, *, visible: bool = True):
        import taichi as ti
        from taichi.ui.utils import get_field_info

        self._ti: Any = ti
        self._info: Any = get_field_info
        self.world, self.visible = world, visible
        self.camera: Camera | None = camera_of_world(world)
        self.room: Rect | None = None
        self.look: Look | None = None
        self.text_size = 1.0
        self._had_settings = SETTINGS.exists()
        # The app paces itself; GGUI's own limit would count as time spent drawing.
        with x11.opening() as displays:
            self._window = ti.ui.Window(
                title, size, vsync=False, show_window=visible, fps_limit=1000
            )
        self._canvas = self._window.get_canvas()
        self._scene: Any = self._window.get_scene()
        self._eye: Any = ti.ui.Camera()
        self._tap = x11.connect(title, displays) if visible else None
        self._guard = rescue.Guard(self._cut) if self._tap else None
        self._listens = bool(self._tap and self._tap.listen())
        self._pointer: tuple[float, float] | None = None
        self._held: set[str] = set()
        self._last: Picture | None = None
        self._fresh = False  # whether what was drawn last can still be taken from the window
        self._spheres: SphereMeshes | None = None
        self._spring_colors = Cached(style.spring_colors)
        self._lines, self._discs = Cached(_flat_lines), Cached(disc_vertices)
        self._line_meshes: dict[str, LineMesh] = {}
        self._title, self._named = title, 0.0
        self._topologies = Cached(Topology.build), Cached(Topology.build)
        self._surfaces: list[SurfaceMesh | None] = [None, None]  # of the picture; of its solids
        self._panel_vertices = lru_cache(maxsize=16)(self._panel_vertices_anew)
        self._written = lru_cache(maxsize=2)(self._written_anew)
        self.has_wheel = self._listens
        self.closed = False
        self._size = size

    @property
    def size(self) -> tuple[int, int]:
        """Current width and height in pixels."""
        if self.closed or not self.visible:
            return self._size
        w, h = self._window.get_window_shape()
        if w > 0 and h > 0:  # a minimised window reports zero
            self._size = (int(w), int(h))
        return self._size

    def turn_to(self, world: World, camera: Camera | None) -> None:
        """Show another world from now on; camera: of a 3-D one."""
        self.world, self.camera, self.look = world, camera, None
        self._last, self._fresh = None, False

    def entitle(self, title: str) -> None:
        """Write a title over the window; GGUI writes its own again once a second."""
        now = time.perf_counter()
        if self._tap and not self.closed and (title != self._title or now > self._named):
            self._title, self._named = title, now + ENTITLED
            self._tap.entitle(title)

    # Events

    def poll(self) -> list[Event]:
        """The user's events since the last call, oldest first.

        Raises ConnectionCut where the window's connection to the display is cut.
        """
        if self.closed or not self.visible:
            return []
        if self._was_destroyed():
            return []
        if not self._window.running:
            self.close()
            return []
        if self._tap and self._listens:
            self._window.get_events()  # makes Xlib read; which come, and where, X says better
            return fewest_moves(self._read(self._tap))
        return self._reported()

    def _read(self, tap: x11.Connection) -> Iterator[Event]:
        """The events that X sent to the window, each where the pointer was then."""
        w, h = self.size
        for given in tap.inputs():
            if given.kind == "move":
                if 0 <= given.pos[0] <= w and 0 <= given.pos[1] <= h:
                    yield Event("move", pos=given.pos)
            elif given.button in WHEEL:
                if given.kind == "press":
                    yield Event("wheel", pos=given.pos, delta=WHEEL[given.button])
            elif 1 <= given.button <= len(BUTTONS):
                yield Event(given.kind, pos=given.pos, button=BUTTONS[given.button - 1])
            else:
                names = [name for name in map(key_name, given.keys) if name]
                yield from self._changed(given.kind, names[0]) if names else ()

    def _reported(self) -> list[Event]:
        """The events as GGUI reports them: none has a position, and it knows no wheel."""
        ui = self._ti.ui
        # Presses come before releases: a click within one frame still arrives as a click.
        reported = [
            (kind, event.key)
            for tag, kind in ((ui.PRESS, "press"), (ui.RELEASE, "release"))
            for event in self._window.get_events(tag)
        ]
        # Only now, as the pointer may have moved right before a click.
        w, h = self.size
        x, y = self._window.get_cursor_pos()
        pointer = (round(x * w, 3), round((1 - y) * h, 3))  # to what a mouse resolves
        out: list[Event] = []
        if pointer != self._pointer and 0 <= x <= 1 and 0 <= y <= 1:
            # The position at the start is where the pointer happens to be, not a motion.
            if self._pointer is not None:
                out.append(Event("move", pos=pointer))
            self._pointer = pointer
        elif self._pointer is None:
            self._pointer = pointer
        for kind, key in reported:
            out += self._translated(kind, key, pointer)
        return out

    def _translated(self, kind: str, key: str, pointer: tuple[float, float]) -> list[Event]:
        if key in BUTTON_NAMES:
            return [Event(kind, pos=pointer, button=BUTTON_NAMES[key])]
        name = key_name(key)
        return self._changed(kind, name) if name else []

    def _changed(self, kind: str, key: str) -> list[Event]:
        """The event, unless it only repeats what the key already does (auto-repeat)."""
        if (kind == "press") == (key in self._held):
            return []
        (self._held.add if kind == "press" else self._held.discard)(key)
        return [Event(kind, key=key)]

    # Drawing

    def draw(self, picture: Picture) -> None:
        """Draw and present one frame. Raises ConnectionCut, as `poll` does."""
        if self.closed:
            return
        self._last = picture
        self._compose(picture)
        if self.visible:
            if self._was_destroyed():  # Vulkan would end the process
                return
            self._window.show()
        self._fresh = not self.visible

    def grab(self) -> np.ndarray:
        """The frame drawn last, (height, width, 3) uint8, row 0 on top."""
        if self._last is None:
            raise RuntimeError("nothing has been drawn yet")
        if not self._fresh:
            # What was shown or taken is gone; the same picture is drawn again.
            self._compose(self._last)
        self._fresh = False
        pixels = drawing.as_image(self._window.get_image_buffer_as_numpy())
        if self.visible and not self._was_destroyed():
            # Else it would be shown in the place of the next frame, which would be drawn over it.
            self._window.show()
        return pixels

    def _was_destroyed(self) -> bool:
        """Whether the window is gone; it is closed then. Raises ConnectionCut where that is why."""
        if self._tap is None or not self._tap.is_gone():
            return False
        failure = self._cut()
        if failure is not None:
            raise failure
        self.close()
        return True

    def _cut(self) -> x11.ConnectionCut | None:
        """That the window's connection was cut, if it was; then it is closed, and left alone."""
        if self._tap is None or self.closed or not self._tap.is_cut():
            return None
        self.closed = True
        x11.keep(self._window)
        self._forget()
        return x11.ConnectionCut()

    def close(self) -> None:
        """Give the window back. May be called twice."""
        if not self.closed:
            self.closed = True
            self._window.destroy()
            self._forget()

    def _forget(self) -> None:
        """Give back what the window had besides."""
        if self._guard:
            self._guard.release()
        if self._tap:
            self._tap.close()
        # The text library behind GGUI leaves its settings in the current folder.
        if not self._had_settings:
            SETTINGS.unlink(missing_ok=True)

    def _compose(self, picture: Picture) -> None:
        if self.camera:
            self._compose_3d(picture, self.camera)
        else:
            self._compose_2d(picture)
        self._compose_overlay(picture)

    @property
    def _map(self) -> WindowMap:
        return WindowMap.of(self.world, self.size, self.room, self.look)

    def _compose_2d(self, picture: Picture) -> None:
        window, (_, height) = self._map, self.size
        self._canvas.set_background_color(style.unit(style.WORLD))
        self._surround()
        place = window.world_to_canvas(picture.position)
        shown = drawing.are_numbers(place)
        if picture.solids is not None:
            faces = picture.solids.triangles
            vertex = vertices(style.flat_colors(picture.solids.color, faces).repeat(3, axis=0))
            vertex[:, :2] = window.world_to_canvas(picture.solids.vertex)[faces.reshape(-1)]
            self._triangles(vertex)
        faces = drawing.between_shown(picture.triangles, shown)
        if len(faces):
            vertex = vertices(style.flat_colors(picture.color_in_surfaces, faces).repeat(3, axis=0))
            vertex[:, :2] = place.take(faces.reshape(-1), axis=0)
            self._triangles(vertex)
        self._lines_of_plane(picture, place, shown)
        if picture.as_spheres is not None:
            shown &= picture.as_spheres
        if shown.any():
            place, radius, color = drawing.shown_particles(place, picture, shown)
            vertex = self._discs(radius, color, window.scale, height)
            vertex[..., :2] = place
            self._circles(vertex.reshape(-1, STRIDE))

    def _lines_of_plane(self, picture: Picture, place: np.ndarray, shown: np.ndarray) -> None:
        """Draw the walls and springs of a 2-D world.

        place: (n, 2), of all particles on the canvas. shown: (n,) bool.
        """
        window, height = self._map, self.size[1]
        walls = window.to_canvas(window.walls(self.world.walls)).reshape(-1, 2)
        segments = drawing.between_shown(picture.segments, shown)
        if len(walls) + len(segments) == 0:
            return
        ends = np.concatenate([walls, place.take(segments.reshape(-1), axis=0)])
        wide = drawing.line_width(self.room.height if self.room else height)
        count = len(walls) // 2
        lines = self._lines(picture.color, segments, picture.spring_color, count, wide)
        self._lines_2d(lines, ends)

    def _lines_2d(self, lines: FlatLines, ends: np.ndarray) -> None:
        """Lines between consecutive pairs of points (2k, 2) of the canvas."""
        lines.fill(ends, self.size)
        self._triangles(lines.vertex.reshape(-1, STRIDE), lines.index)

    def _surround(self) -> None:
        """Darken what lies in the window beside the world's rectangle."""
        (x0, y0), (x1, y1) = self._map.box()
        w, h = self.size
        beside = np.array([(0, 0, x0, h), (x1, 0, w, h), (x0, 0, x1, y0), (x0, y1, x1, h)])
        beside = beside[((beside[:, 2:] - beside[:, :2]) > 0.5).all(axis=1)]
        if len(beside):
            color = np.tile(style.unit(style.SURROUND), (len(beside), 1))
            self._triangles(self._rectangle_vertices(beside, color), quads(len(beside)))

    def _rectangle_vertices(self, corners: ArrayLike, color: np.ndarray) -> np.ndarray:
        """Vertices, four of each, of rectangles (k, 4) x0, y0, x1, y1 in window pixels, with
        colours (k, 3).
        """
        x0, y0, x1, y1 = np.asarray(corners, np.float64).T
        points = np.stack([x0, y0, x1, y0, x1, y1, x0, y1], axis=1)
        vertex = vertices(np.repeat(color, 4, axis=0))
        vertex[:, :2] = self._map.to_canvas(points.reshape(-1, 2))
        return vertex

    def _triangles(self, vertex: np.ndarray, index: np.ndarray | None = None) -> None:
        """Triangles of each three vertices, or of those whose numbers are in index (3m,) int32."""
        self._canvas.canvas.triangles(self._info(vertex), self._info(index), True, (1.0, 1.0, 1.0))

    def _circles(self, vertex: np.ndarray) -> None:
        self._canvas.canvas.circles(self._info(vertex), True, True, (1.0, 1.0, 1.0), 0.01)

    def _draw_pointer(self, drawn: Pointer) -> None:
        """Draw the pointer: its lines, on wider dark ones."""
        ends = self._map.to_canvas(drawn.lines().reshape(-1, 2))
        for color, wide in ((pointer.SHADE, pointer.WIDE_SHADE), (pointer.COLOR, pointer.WIDE)):
            colors = np.tile(style.unit(color), (len(ends) // 2, 1))
            self._lines_2d(FlatLines.build(colors, wide, layers=((0.0, 1.0),)), ends)

    def _compose_overlay(self, picture: Picture) -> None:
        if picture.pointer is not None:
            self._draw_pointer(picture.pointer)
        if picture.overlay:
            for rectangles, index, pixels in self._written(picture.overlay, self.size):
                self._triangles(rectangles, index)
                if len(pixels):
                    self._circles(pixels)

    def _written_anew(
        self, panels: tuple[Panel, ...], size: tuple[int, int]
    ) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Panels in a window of this size, in layers, of which none overlap within one: vertices of
        rectangles, their triangles' corners, and circles, which single pixels are drawn as.
        """
        out = []
        for layer in text.layers(panels):
            parts = [self._panel_vertices(panel, size) for panel in layer]
            rectangles, pixels = (np.concatenate(part) for part in zip(*parts, strict=True))
            out.append((rectangles, quads(len(rectangles) // 4), pixels))
        return out

    def _panel_vertices_anew(
        self, panel: Panel, size: tuple[int, int]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Vertices of a panel's rectangles in a window of this size, and of its single pixels."""
        corners, color = text.runs(panel)
        single = ((corners[:, 2:] - corners[:, :2]) == 1).all(axis=1)
        pixels = vertices(color[single])
        pixels[:, :2] = self._map.to_canvas(corners[single, :2] + 0.5)
        pixels[:, RADIUS] = 0.5 / size[1]
        return self._rectangle_vertices(corners[~single], color[~single]), pixels

    def _compose_3d(self, picture: Picture, camera: Camera) -> None:
        _, h = self.size
        focal = camera.focal_length * self._map.scale
        self._canvas.set_background_color(style.unit(style.WORLD))
        eye, span = self._eye, camera.farthest
        eye.position(0, 0, -camera.distance)
        eye.lookat(0, 0, 0)
        eye.up(0, -1, 0)
        eye.fov(math.degrees(2 * math.atan(h / 2 / focal)))
        eye.z_near(camera.distance / 100)
        eye.z_far(camera.distance + span)
        self._scene.set_camera(eye)
        self._scene.ambient_light((style.AMBIENT,) * 3)
        lights, away = (style.LIGHTS, FAR_AWAY) if picture.has_surfaces else (style.LIGHTS[:1], 2.0)
        for light, strength in lights:
            self._scene.point_light(light * (away * camera.distance), (strength,) * 3)

        bright = float(brightness(style.LIGHT)) if picture.has_surfaces else 1.0
        if picture.ground is not None:
            self._floor_3d(picture.ground, camera)
        ends, color = drawing.scenery(self.world, camera)
        ends = self._seen(camera, ends.reshape(-1, 3)).reshape(-1, 2, 3)
        front = (ends[..., 2] + camera.distance > camera.nearest_drawn).all(axis=1)
        wide = drawing.edge_width(h)
        self._smooth_lines("scenery", ends[front], color[front], wide, camera, bright)
        position = self._seen(camera, picture.position)
        shown = drawing.are_numbers(position)
        shown &= position[:, 2] + camera.distance > camera.nearest_drawn
        segments = drawing.between_shown(picture.segments, shown)
        self._surfaces_3d(picture, camera, position, shown)
        if picture.as_spheres is not None:
            shown &= picture.as_spheres
        centre, radius, color = position[shown], picture.radius[shown], picture.color[shown]
        if len(centre):
            self._spheres_3d(centre, radius, color, centre[:, 2] + camera.distance, focal)
        if len(segments):  # last: where their edges fade, one sees what is behind
            self._springs_3d(picture, camera, segments, position, bright)
        self._canvas.scene(self._scene)

    def _seen(self, camera: Camera, points: np.ndarray) -> np.ndarray:
        """World points (n, 3) in camera axes, moved aside with their depth, so that what is looked
        at is seen in the middle of the world's room, and not of the window.
        """
        place = camera.rotate_points(points)
        window = self._map
        aside = window.to_window(camera.middle) - np.array(self.size) / 2
        slope = aside / (camera.focal_length * window.scale)
        place[:, :2] += slope * (place[:, 2:] + camera.distance)
        return place

    def _smooth_lines(
        self,
        name: str,
        ends: np.ndarray,
        color: np.ndarray,
        width: float,
        camera: Camera,
        bright: float,
    ) -> None:
        """Draw lines whose edges fade, as `LineMesh` has them; those of a name keep their mesh."""
        mesh = self._line_meshes.get(name)
        if mesh is None or len(mesh.vertex) != len(ends):
            mesh = self._line_meshes[name] = LineMesh.build(len(ends))
        focal = camera.focal_length * self._map.scale
        mesh.fill(ends.astype(np.float32), color, width, focal, camera.distance, bright=bright)
        self._mesh_3d(mesh.vertex.reshape(-1, STRIDE), mesh.index)

    def _springs_3d(
        self,
        picture: Picture,
        camera: Camera,
        segments: np.ndarray,
        position: np.ndarray,
        bright: float,
    ) -> None:
        """Draw springs; those of a surface lie in it, and are seen before it.

        segments: (s, 2), those that are drawn. position: (n, 3), of all particles in camera axes.
        """
        focal = camera.focal_length * self._map.scale
        ends = position.take(segments, axis=0)
        if len(picture.triangles):  # along the line of sight, a little nearer
            ends[..., 2] += camera.distance
            ends *= 1 - drawing.LIFTED
            ends[..., 2] -= camera.distance
        pixels = focal / camera.distance
        wide = drawing.spring_width_on(picture, segments, pixels, self.size[1])
        color = self._spring_colors(picture.color, segments, picture.spring_color)
        if len(segments) <= SMOOTH_LINES:
            self._smooth_lines("springs", ends, color, wide, camera, bright)
            return
        vertex = vertices(color.repeat(2, axis=0))
        vertex[:, POSITION] = ends.reshape(-1, 3)
        self._lines_3d(vertex, wide)

    def _surfaces_3d(
        self, picture: Picture, camera: Camera, position: np.ndarray, shown: np.ndarray
    ) -> None:
        """Draw the surfaces of cloths, and those of obstacles.

        position: (n, 3), of the picture's particles in camera axes. shown: (n,) bool.
        """
        if len(picture.triangles):
            topology = self._topologies[0](picture.triangles).of_shown(shown)
            self._surface_3d(
                0, topology, camera, position, picture.color_in_surfaces, picture.normals
            )
        solids = picture.solids
        if solids is not None:
            vertex = self._seen(camera, solids.vertex)
            in_front = vertex[:, 2] + camera.distance > camera.nearest_drawn
            topology = self._topologies[1](solids.triangles).of_shown(in_front)
            self._surface_3d(1, topology, camera, vertex, solids.color, None)

    def _surface_3d(
        self,
        number: int,
        topology: Topology,
        camera: Camera,
        position: np.ndarray,
        color: np.ndarray,
        normal: np.ndarray | None,
    ) -> None:
        """Draw the surface of the picture (number 0) or of its solids (1)."""
        mesh = self._surfaces[number]
        if mesh is None or len(mesh.vertex) != 2 * len(position):
            mesh = self._surfaces[number] = SurfaceMesh.build(len(position))
        corners = mesh.fill(
            topology,
            camera,
            position.astype(np.float32),
            color,
            normal,
            two_sided=number == 0,
        )
        if len(corners):
            self._mesh_3d(mesh.vertex, corners)

    def _floor_3d(self, height: float, camera: Camera) -> None:
        up = camera.rotation()[:, 1] * (1 if camera.y_up else -1)
        corner, color, opacity = floor(height, camera.centre, camera.radius)
        place = self._seen(camera, corner.reshape(-1, 3)).reshape(-1, 4, 3)
        front = (place[:, :, 2] + camera.distance > camera.nearest_drawn).all(axis=1)
        self._mesh_3d(*floor_vertices(place[front], color[front], opacity[front], up))

    def _mesh_3d(self, vertex: np.ndarray, index: np.ndarray) -> None:
        """Triangles of the vertices (k, STRIDE) whose numbers are in index (3m,) int32."""
        self._scene.scene.mesh(
            self._info(vertex), True, self._info(index),
            (1.0, 1.0, 1.0), False, len(index), 0, len(vertex), 0, False,
        )  # fmt: skip

    def _lines_3d(self, vertex: np.ndarray, width: float) -> None:
        """Lines between consecutive pairs of vertices; width in pixels."""
        count = len(vertex)
        self._scene.scene.lines(
            self._info(vertex), self._info(None), True, (1.0, 1.0, 1.0), width, count, 0, count, 0
        )

    def _spheres_3d(
        self,
        centre: np.ndarray,
        radius: np.ndarray,
        color: np.ndarray,
        depth: np.ndarray,
        focal: float,
    ) -> None:
        """Draw shaded spheres.

        centre: (k, 3) camera axes, world units. radius: (k,) world units. color: (k, 3) uint8.
        depth: (k,) from the eye, world units. focal: pixels per unit of x/z slope.
        """
        largest = float(np.max(radius * focal / depth))
        level = next(n for limit, n in SPHERES if largest <= limit)
        if len(centre) * (10 * 4**level + 2) > MESH_VERTICES:
            self._particles_3d(centre, radius, color, depth)
            return
        meshes = self._spheres
        if meshes is None or (meshes.count, meshes.level) != (len(centre), level):
            meshes = self._spheres = SphereMeshes.build(len(centre), level)
        meshes.fill(centre, radius, color)
        self._mesh_3d(meshes.vertex.reshape(-1, STRIDE), meshes.index)

    def _particles_3d(
        self, centre: np.ndarray, radius: np.ndarray, color: np.ndarray, depth: np.ndarray
    ) -> None:
        """Many spheres as GGUI's particles: one quad each, with the depth of a sphere.

        GGUI sizes them by width/height of the window and by the distance along the ray, not
        along the axis; the radius is corrected for both.
        """
        w, h = self.size
        ray = np.sqrt(centre[:, 0] ** 2 + centre[:, 1] ** 2 + depth**2)
        vertex = vertices(color / 255)
        vertex[:, POSITION] = centre
        vertex[:, RADIUS] = radius * (h / w) * ray / depth
        white = (1.0, 1.0, 1.0)
        self._scene.scene.particles(self._info(vertex), True, True, white, 1.0, len(vertex), 0)


def _flat_lines(
    color: np.ndarray,
    segments: np.ndarray,
    given: tuple[int, int, int] | np.ndarray | None,
    walls: int,
    width: float,
) -> FlatLines:
    """Walls and then springs, of a width in pixels; for the rest `spring_colors`."""
    springs = style.spring_colors(color, segments, given)
    return FlatLines.build(
        np.concatenate([np.tile(style.unit(style.WALL), (walls, 1)), springs]), width
    )


VIEW = ViewKind(
    name="ggui",
    windows=True,
    lack=lambda: no_display() or (None if runtime.vulkan_available() else NO_VULKAN),
    pictures=runtime.vulkan_available,
    several=False,  # a second GGUI window in a process ends it
    open=GguiView,
)
