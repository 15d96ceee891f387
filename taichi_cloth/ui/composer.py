"""Pictures as GGUI draws them: what is in a plane onto a window's canvas, the rest into its scene.

`vertices.py` has the buffers that are drawn. GGUI has copied them when a call returns.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from taichi_cloth.scene.model import World
from taichi_cloth.ui import drawing, pointer, shade, style
from taichi_cloth.ui.camera import Camera
from taichi_cloth.ui.drawing import Cached
from taichi_cloth.ui.pointer import Pointer
from taichi_cloth.ui.surfaces import Topology, brightness, floor
from taichi_cloth.ui.tiles import Panel
from taichi_cloth.ui.vertices import (
    ALPHA,
    POSITION,
    RADIUS,
    STRIDE,
    FlatLines,
    LineMesh,
    SphereMeshes,
    SurfaceMesh,
    Triangles,
    disc_vertices,
    flat_lines,
    floor_vertices,
    ghost_colors,
    ghost_lines,
    quads,
    rectangles,
    vertices,
)
from taichi_cloth.ui.views.contract import Ghost, Picture
from taichi_cloth.ui.window_map import WindowMap

SMOOTH_LINES = 12_000  # so many lines in space have smooth edges, which take long to draw
MESH_VERTICES = 5_000  # spheres are meshes up to so many vertices (8 ms in software)
FAR_AWAY = 100.0  # lights of surfaces, in distances of the eye: their rays are parallel
SPHERES = ((10.0, 1), (45.0, 2), (math.inf, 3))  # up to this radius in pixels: subdivisions


class Composer:
    """Draws pictures of worlds into a GGUI window, up to where it is shown.

    window: a ti.ui.Window. What does not change from picture to picture is kept.
    """

    def __init__(self, window: Any):
        import taichi as ti
        from taichi.ui.utils import get_field_info

        self._info: Any = get_field_info
        self._canvas, self._scene = window.get_canvas(), window.get_scene()
        self._eye: Any = ti.ui.Camera()
        # What is drawn together: each draw costs 0.1 ms, and Mesa's software Vulkan never gives the
        # 130 to 220 bytes back that it needs to know of one.
        self._flat, self._solid = Triangles(), Triangles()
        self._spheres: dict[str, SphereMeshes] = {}
        self._spring_colors = Cached(style.spring_colors)
        self._lines, self._discs = Cached(flat_lines), Cached(disc_vertices)
        self._ghost_lines, self._ghost_colors = Cached(ghost_lines), Cached(ghost_colors)
        self._line_meshes: dict[str, LineMesh] = {}
        # Of the picture; of its solids; of its ghost.
        self._topologies = tuple(Cached(Topology.build) for _ in range(3))
        self._surfaces: list[SurfaceMesh | None] = [None, None, None]
        self._tiles = lru_cache(maxsize=256)(lambda tile: rectangles(*tile.runs))
        self._laid = lru_cache(maxsize=2)(self._laid_anew)

    def compose(
        self, picture: Picture, world: World, camera: Camera | None, window: WindowMap
    ) -> None:
        """Draw a picture. camera: of a world in space. window: where the world is in the window."""
        self.put(picture, world, camera, window)
        self.show(picture, camera)
        self.over(picture, window)

    def put(self, picture: Picture, world: World, camera: Camera | None, window: WindowMap) -> None:
        """Draw a picture's world."""
        self._world, self._map = world, window
        if camera:
            self._compose_3d(picture, camera)
        else:
            self._compose_2d(picture)

    def show(self, picture: Picture, camera: Camera | None) -> None:
        """After all that is in space, have it seen by the camera."""
        if camera:
            self._look(picture, camera)
            self._canvas.scene(self._scene)

    def over(self, picture: Picture, window: WindowMap) -> None:
        """Draw what lies over a picture's world."""
        self._map = window
        self._compose_overlay(picture)
        self._draw_triangles()

    @property
    def _size(self) -> tuple[int, int]:
        return self._map.window

    def _compose_2d(self, picture: Picture) -> None:
        window, (_, height) = self._map, self._size
        self._canvas.set_background_color(style.unit(style.WORLD))
        self._surround()
        ghost = picture.ghost
        if ghost is not None and not ghost.over:
            self._ghost_2d(ghost)
        place = window.world_to_canvas(picture.position)
        shown = drawing.are_numbers(place)
        if picture.solids is not None:
            faces = picture.solids.triangles
            vertex = vertices(style.flat_colors(picture.solids.color, faces).repeat(3, axis=0))
            vertex[:, :2] = window.world_to_canvas(picture.solids.vertex)[faces.reshape(-1)]
            self._triangles(vertex, np.arange(len(vertex), dtype=np.int32))
        faces = drawing.between_shown(picture.triangles, shown)
        if len(faces):
            vertex = vertices(style.flat_colors(picture.color_in_surfaces, faces).repeat(3, axis=0))
            vertex[:, :2] = place.take(faces.reshape(-1), axis=0)
            self._triangles(vertex, np.arange(len(vertex), dtype=np.int32))
        self._lines_of_plane(picture, place, shown)
        if picture.as_spheres is not None:
            shown &= picture.as_spheres
        if picture.plain:
            shown[picture.segments.reshape(-1)] = False
        if shown.any():
            place, radius, color = drawing.shown_particles(place, picture, shown)
            vertex = self._discs(radius, color, window.scale, height, picture.plain)
            vertex[..., :2] = place
            self._circles(vertex.reshape(-1, STRIDE))
        if ghost is not None and ghost.over:
            self._ghost_2d(ghost)

    def _ghost_2d(self, ghost: Ghost) -> None:
        """Draw a ghost in a plane, in a colour that seems to be seen through."""
        window, height = self._map, self._size[1]
        place = window.world_to_canvas(ghost.position)
        shown = drawing.are_numbers(place)
        color = np.array(style.unit(ghost.flat_color))
        faces = drawing.between_shown(ghost.triangles, shown)
        if len(faces):
            vertex = vertices(np.tile(color, (faces.size, 1)))
            vertex[:, :2] = place.take(faces.reshape(-1), axis=0)
            self._triangles(vertex, np.arange(len(vertex), dtype=np.int32))
        segments = drawing.between_shown(ghost.segments, shown)
        if len(segments):
            wide = drawing.line_width(window.room.height if window.room else height)
            lines = self._ghost_lines(len(segments), wide, ghost.flat_color)
            self._lines_2d(lines, place.take(segments.reshape(-1), axis=0))
        seen = shown & ghost.as_spheres
        if seen.any():
            vertex = vertices(np.tile(color, (int(seen.sum()), 1)))
            radius = np.maximum(ghost.radius[seen] * window.scale, drawing.SMALLEST_DISC)
            vertex[:, :2], vertex[:, RADIUS] = place[seen], radius / height
            self._circles(vertex)

    def _lines_of_plane(self, picture: Picture, place: np.ndarray, shown: np.ndarray) -> None:
        """Draw the walls and springs of a 2-D world.

        place: (n, 2), of all particles on the canvas. shown: (n,) bool.
        """
        window, height = self._map, self._size[1]
        walls = window.to_canvas(window.walls(self._world.walls)).reshape(-1, 2)
        segments = drawing.between_shown(picture.segments, shown)
        if len(walls) + len(segments) == 0:
            return
        ends = np.concatenate([walls, place.take(segments.reshape(-1), axis=0)])
        wide = drawing.line_width(window.room.height if window.room else height)
        count = len(walls) // 2
        lines = self._lines(
            picture.color, segments, picture.spring_color, count, wide, picture.plain
        )
        self._lines_2d(lines, ends)

    def _lines_2d(self, lines: FlatLines, ends: np.ndarray) -> None:
        """Lines between consecutive pairs of points (2k, 2) of the canvas."""
        lines.fill(ends, self._size)
        self._triangles(lines.vertex.reshape(-1, STRIDE), lines.index)

    def _surround(self) -> None:
        """Darken what lies in the window beside the world's rectangle."""
        (x0, y0), (x1, y1) = self._map.box()
        w, h = self._size
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

    def _triangles(self, vertex: np.ndarray, index: np.ndarray) -> None:
        """Add triangles of the vertices (k, STRIDE) whose numbers are in index (3m,) int32."""
        self._flat.add(vertex, index)

    def _draw_triangles(self) -> None:
        """Draw the triangles that were added to the canvas."""
        for vertex, index in self._flat.taken():
            self._canvas.canvas.triangles(
                self._info(vertex), self._info(index), True, (1.0, 1.0, 1.0)
            )

    def _circles(self, vertex: np.ndarray) -> None:
        """Draw circles at the vertices (k, STRIDE), over what was added before."""
        self._draw_triangles()
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
            self._triangles(*self._laid(picture.overlay, self._size))

    def _laid_anew(
        self, panels: tuple[Panel, ...], size: tuple[int, int]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Panels in a window of this size, one upon another: vertices and triangles' corners."""
        points, vertex, index, count = [], [], [], 0
        for panel in panels:
            place, tile, corners = self._tiles(panel.tile)
            points.append(place + np.array([panel.x, panel.y]))
            vertex.append(tile)
            index.append(corners + np.int32(count))
            count += len(tile)
        laid = np.concatenate(vertex)
        laid[:, :2] = self._map.to_canvas(np.concatenate(points))
        return laid, np.concatenate(index)

    def _look(self, picture: Picture, camera: Camera) -> None:
        """Have the eye and the lights where they are."""
        _, h = self._size
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

    def _compose_3d(self, picture: Picture, camera: Camera) -> None:
        _, h = self._size
        focal = camera.focal_length * self._map.scale
        bright = float(brightness(style.LIGHT)) if picture.has_surfaces else 1.0
        if picture.ground is not None and camera.is_above(picture.ground):
            self._floor_3d(picture, picture.ground, camera)
        ends, color = drawing.scenery(self._world, camera)
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
        if picture.ghost is not None:
            self._ghost_3d(picture.ghost, camera, bright)
        self._draw_meshes()

    def _seen(self, camera: Camera, points: np.ndarray) -> np.ndarray:
        """World points (n, 3) in camera axes, moved aside with their depth, so that what is looked
        at is seen in the middle of the world's room, and not of the window.
        """
        place = camera.rotate_points(points)
        window = self._map
        aside = window.to_window(camera.middle) - np.array(self._size) / 2
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
        wide = drawing.spring_width_on(picture, segments, pixels, self._size[1])
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
        """Draw the surface of the picture (number 0), of its solids (1) or of its ghost (2)."""
        mesh = self._surfaces[number]
        if mesh is None or len(mesh.vertex) != 2 * len(position):
            mesh = self._surfaces[number] = SurfaceMesh.build(len(position))
            mesh.vertex[:, ALPHA] = style.GHOST_SHARE if number == 2 else 1.0
        corners = mesh.fill(
            topology, camera, position.astype(np.float32), color, normal,
            two_sided=number == 0, one_layer=number == 2,
        )  # fmt: skip
        if len(corners):
            self._mesh_3d(mesh.vertex, corners)

    def _floor_3d(self, picture: Picture, height: float, camera: Camera) -> None:
        up = camera.rotation()[:, 1] * (1 if camera.y_up else -1)
        corner, color, opacity = floor(height, camera.centre, camera.radius)
        dark = shade.of(picture, height, camera)
        if dark is not None:
            corner, color, opacity = shade.laid(dark, corner, color, opacity)
        place = self._seen(camera, corner.reshape(-1, 3)).reshape(-1, 4, 3)
        front = (place[:, :, 2] + camera.distance > camera.nearest_drawn).all(axis=1)
        self._mesh_3d(*floor_vertices(place[front], color[front], opacity[front], up))

    def _mesh_3d(self, vertex: np.ndarray, index: np.ndarray) -> None:
        """Add triangles of the vertices (k, STRIDE) whose numbers are in index (3m,) int32."""
        self._solid.add(vertex, index)

    def _draw_meshes(self) -> None:
        """Draw the triangles that were added to the scene."""
        for vertex, index in self._solid.taken():
            self._scene.scene.mesh(
                self._info(vertex), True, self._info(index),
                (1.0, 1.0, 1.0), False, len(index), 0, len(vertex), 0, False,
            )  # fmt: skip

    def _lines_3d(self, vertex: np.ndarray, width: float) -> None:
        """Lines between consecutive pairs of vertices; width in pixels."""
        self._draw_meshes()
        count = len(vertex)
        self._scene.scene.lines(
            self._info(vertex), self._info(None), True, (1.0, 1.0, 1.0), width, count, 0, count, 0
        )

    def _ghost_3d(self, ghost: Ghost, camera: Camera, bright: float) -> None:
        """Draw a ghost in space, a little behind where it is."""
        position = self._seen(camera, ghost.position)
        position *= 1 + drawing.LIFTED
        position[:, 2] += drawing.LIFTED * camera.distance
        shown = drawing.are_numbers(position)
        shown &= position[:, 2] + camera.distance > camera.nearest_drawn
        color = self._ghost_colors(len(position))
        if len(ghost.triangles):
            topology = self._topologies[2](ghost.triangles).of_shown(shown)
            self._surface_3d(2, topology, camera, position, color, ghost.normals)
        segments = drawing.between_shown(ghost.segments, shown)
        if len(segments):
            ends, pale = position.take(segments, axis=0), color[segments[:, 0]] / 255
            wide = drawing.spring_width(self._size[1])
            self._smooth_lines("ghost", ends, pale, wide, camera, bright)
        seen = shown & ghost.as_spheres
        if seen.any():
            focal = camera.focal_length * self._map.scale
            centre, depth = position[seen], position[seen, 2] + camera.distance
            self._spheres_3d(
                centre, ghost.radius[seen], color[seen], depth, focal, "ghost", style.GHOST_SHARE
            )

    def _spheres_3d(
        self,
        centre: np.ndarray,
        radius: np.ndarray,
        color: np.ndarray,
        depth: np.ndarray,
        focal: float,
        name: str = "particles",
        opacity: float = 1.0,
    ) -> None:
        """Draw shaded spheres; those of a name keep their meshes.

        centre: (k, 3) camera axes, world units. radius: (k,) world units. color: (k, 3) uint8.
        depth: (k,) from the eye, world units. focal: pixels per unit of x/z slope.
        """
        largest = float(np.max(radius * focal / depth))
        level = next(n for limit, n in SPHERES if largest <= limit)
        if len(centre) * (10 * 4**level + 2) > MESH_VERTICES:
            self._particles_3d(centre, radius, color, depth)
            return
        meshes = self._spheres.get(name)
        if meshes is None or (meshes.count, meshes.level) != (len(centre), level):
            meshes = self._spheres[name] = SphereMeshes.build(len(centre), level)
            meshes.vertex[:, :, ALPHA] = opacity
        meshes.fill(centre, radius, color)
        self._mesh_3d(meshes.vertex.reshape(-1, STRIDE), meshes.index)

    def _particles_3d(
        self, centre: np.ndarray, radius: np.ndarray, color: np.ndarray, depth: np.ndarray
    ) -> None:
        """Many spheres as GGUI's particles: one quad each, with the depth of a sphere.

        GGUI sizes them by width/height of the window and by the distance along the ray, not
        along the axis; the radius is corrected for both.
        """
        w, h = self._size
        ray = np.sqrt(centre[:, 0] ** 2 + centre[:, 1] ** 2 + depth**2)
        vertex = vertices(color / 255)
        vertex[:, POSITION] = centre
        vertex[:, RADIUS] = radius * (h / w) * ray / depth
        white = (1.0, 1.0, 1.0)
        self._draw_meshes()
        self._scene.scene.particles(self._info(vertex), True, True, white, 1.0, len(vertex), 0)
