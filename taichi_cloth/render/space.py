"""A world in space, as a camera sees it, drawn into a room of an image."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from taichi_cloth.render import drawing, style, surfaces
from taichi_cloth.render.camera import Camera
from taichi_cloth.render.drawing import Cached
from taichi_cloth.render.picture import Bounds, Ghost, Picture, Rect, Solid
from taichi_cloth.render.rasterizer import NOWHERE, Floor, Group, Lens, Rasterizer, Things
from taichi_cloth.render.shadow import Shadows
from taichi_cloth.render.surfaces import Topology
from taichi_cloth.render.window_map import WindowMap

EDGE_PARTS = 16  # of the world's edges: a line stays one where its end is behind us
MOST = 50_000  # triangles of which is known what lies beside them
MOVES = 20  # frames for which obstacles that moved are drawn anew in each


class Space:
    """Draws one world; what has not changed is kept from frame to frame.

    room: where, in an image `height` pixels high, by which lines are as wide as they are.
    """

    def __init__(self, room: Rect, height: int):
        self._room, self._height = room, height
        self._rasterizer = Rasterizer(room.width, room.height)
        self._sides, self._flat = Cached(_sides), Cached(_both)
        self._corners, self._lines, self._balls = Cached(_corners), Cached(_lines), Cached(_balls)
        self._topologies = Cached(Topology.build), Cached(Topology.build), Cached(Topology.build)
        self._solid_corners, self._of_solid = Cached(_corners), Cached(self._made_of_solid)
        self._ghost_corners = Cached(_corners)
        self._looks: tuple[Any, ...] | None = None  # from where it is seen
        self._lens: Lens
        self._floor: Floor | None
        self._seen: tuple[Any, ...] | None = None  # from where, and what stands there
        self._solids: np.ndarray | None = None  # the vertices of obstacles in the frame before
        self._shadows = Shadows()
        self._kept: tuple[Any, ...] = ()
        self._moving = 0  # frames for which they are drawn anew

    def draw(
        self,
        image: Any,
        width: int,
        picture: Picture,
        bounds: Bounds,
        camera: Camera,
        window: WindowMap,
        again: tuple[int, ...] = NOWHERE,
    ) -> None:
        """Draw a picture into an image (h * width,) int32.

        window: where the world is in it. again: columns and rows of the room, from and to, in which
        something else was drawn meanwhile.
        """
        pose = *camera.pose, camera.focal_length, camera.radius, camera.y_up
        seen = pose, window, picture.has_surfaces, picture.ground
        if seen != self._looks:
            self._looks = seen
            self._lens, self._floor = self._look(picture, camera, window), _floor(picture, camera)
        lens, floor = self._lens, self._floor
        self._stand(picture, bounds, camera, lens, floor)
        cloth = self._cloth(picture, lens, camera.distance)
        solids = None if picture.solids is None else self._solid(picture.solids)
        shade = None
        if floor is not None and picture.ground is not None:
            shade = self._shadows.of(cloth, solids, picture.ground, camera)
        things = [cloth] if solids is None or not self._moving else [cloth, solids]
        veil = [] if picture.ghost is None else [self._ghost(picture.ghost, lens)]
        self._rasterizer.draw(
            image, width, (self._room.x, self._room.y), joined(things, veil), lens, floor, shade,
            again,
        )  # fmt: skip

    def _look(self, picture: Picture, camera: Camera, window: WindowMap) -> Lens:
        """The lens of a camera in a window."""
        x, y = window.to_window(camera.middle) - [self._room.x, self._room.y]
        return Lens(
            camera.eye,
            camera.rotation(),
            camera.focal_length * window.scale,
            (float(x), float(y)),
            camera.nearest_drawn,
            _lights(2 if picture.has_surfaces else 1),
            style.SHEEN,
        )

    def _stand(
        self, picture: Picture, bounds: Bounds, camera: Camera, lens: Lens, floor: Floor | None
    ) -> None:
        """Have ready what lies behind all that moves; it is made anew where the camera moved."""
        solids = picture.solids
        vertex = None if solids is None else solids.vertex
        if vertex is not self._solids:
            self._moving = 0 if self._solids is None else MOVES
            self._solids = vertex
        self._moving = max(self._moving - 1, 0)
        standing = solids is not None and not self._moving
        seen = (self._looks, id(bounds), id(vertex) if standing else None)
        if seen == self._seen:
            return
        self._seen, self._kept = seen, (bounds, vertex)  # so that no others get their places
        self._rasterizer.lay(style.packed_one(style.WORLD), floor, lens)
        things = [self._scenery(bounds, camera)]
        if standing and solids is not None:
            things.append(self._solid(solids))
        self._rasterizer.stand(joined(things, []), replace(lens, sheen=0.0))

    def _cloth(self, picture: Picture, lens: Lens, distance: float) -> Things:
        """Surfaces, springs and particles. distance: from the eye to what it looks at."""
        place = np.asarray(picture.position, np.float32)
        none = Things()
        normal: np.ndarray = none.normal
        side, corner, beside = none.side, none.corner, none.beside
        if len(picture.triangles):
            corner, beside = self._corners(picture.triangles)
            side = self._sides(picture.color_in_surfaces)
            normal = _normals(picture, place, self._topologies[0])
        line = self._lines(picture.segments, picture.color, picture.spring_color)
        ball = self._balls(picture.as_spheres, picture.radius, picture.color)
        wide, lift = 1.0, 0.0
        if len(line):
            pixels = lens.focal / distance  # of a world unit where one looks
            wide = drawing.spring_width_on(picture, picture.segments, pixels, self._height)
            lift = drawing.LIFTED if len(corner) else 0.0
        firm = Group(len(corner), len(ball), len(line), wide, lift)
        return Things(place, normal, side, corner, beside, ball, line, firm)

    def _ghost(self, ghost: Ghost, lens: Lens) -> Things:
        """A ghost, a little behind where it is."""
        place = lens.eye + (1 + drawing.LIFTED) * (ghost.position - lens.eye)
        place = np.asarray(place, np.float32)
        code = style.packed_one(style.GHOST)
        normal: np.ndarray = np.zeros((0, 3), np.float32)
        if len(ghost.triangles):
            normal = _normals(ghost, place, self._topologies[2])
        side = np.full((len(normal), 2), code, np.int32)
        color = np.tile(np.array(style.GHOST, np.uint8), (len(place), 1))
        line = _lines(ghost.segments, color, style.GHOST)
        ball = _balls(ghost.as_spheres, ghost.radius, color)
        corner, beside = self._ghost_corners(ghost.triangles)
        wide = drawing.spring_width(self._height)
        group = Group(len(corner), len(ball), len(line), wide, -drawing.LIFTED)
        return Things(place, normal, side, corner, beside, ball, line, group)

    def _solid(self, solids: Solid) -> Things:
        """Obstacles."""
        return self._of_solid(solids.vertex, solids.triangles, solids.color)

    def _made_of_solid(
        self, vertex: np.ndarray, triangles: np.ndarray, color: np.ndarray
    ) -> Things:
        place, (corner, beside) = np.asarray(vertex, np.float32), self._solid_corners(triangles)
        normal = self._topologies[1](triangles).unit_normals(place)
        return Things(place, normal, self._flat(color), corner, beside, firm=Group(len(corner)))

    def _scenery(self, bounds: Bounds, camera: Camera) -> Things:
        """The world's edges and axes, cut into parts."""
        edges, color = drawing.scenery(bounds, camera)
        share = np.linspace(0, 1, EDGE_PARTS + 1)[:, None]
        points = edges[:, None, 0] * (1 - share) + edges[:, None, 1] * share
        place = np.stack([points[:, :-1], points[:, 1:]], axis=2).reshape(-1, 3)
        code = style.packed(color).astype(np.int32)
        line = np.empty((len(place) // 2, 3), np.int32)
        line[:, :2] = np.arange(len(place)).reshape(-1, 2)
        line[:, 2] = np.repeat(code, EDGE_PARTS)
        group = Group(0, 0, len(line), drawing.edge_width(self._height), drawing.LIFTED)
        return Things(place.astype(np.float32), line=line, firm=group)


def joined(firm: list[Things], veil: list[Things]) -> Things:
    """Things as one; all lines of a layer are as wide as the first ones."""
    every = firm + veil
    if len(every) == 1:
        return every[0]
    surfaced = max((n for n, one in enumerate(every) if len(one.normal)), default=-1)
    normal, side = [], []
    for one in every[: surfaced + 1]:
        missing = len(one.place) - len(one.normal)
        normal += [one.normal, np.zeros((missing, 3), np.float32)]
        side += [one.side, np.zeros((missing, 2), np.int32)]
    first = np.cumsum([0, *(len(one.place) for one in every)])[:-1]
    none, pairs = Things(), list(zip(every, first.astype(np.int32), strict=True))
    before = np.cumsum([0, *(len(one.corner) for one in every)])[:-1].astype(np.int32)
    triangles = list(zip(every, before, strict=True))
    of_ball, of_line = np.array([1, 0, 0], np.int32), np.array([1, 1, 0], np.int32)
    return Things(
        np.concatenate([one.place for one in every]),
        np.concatenate([none.normal, *normal]),
        np.concatenate([none.side, *side]),
        np.concatenate([one.corner + n for one, n in pairs]),
        np.concatenate([np.where(one.beside < 0, -1, one.beside + n) for one, n in triangles]),
        np.concatenate([one.ball + n * of_ball for one, n in pairs]),
        np.concatenate([one.line + n * of_line for one, n in pairs]),
        _counted(firm),
        _counted(veil),
    )


def _counted(things: list[Things]) -> Group:
    """Count each kind."""
    if not things:
        return Group()
    groups = [one.firm for one in things]
    lines = next((group for group in groups if group.lines), groups[0])
    return replace(
        lines,
        triangles=sum(group.triangles for group in groups),
        balls=sum(group.balls for group in groups),
        lines=sum(group.lines for group in groups),
    )


def _lights(count: int) -> np.ndarray:
    """The first lights, (3, 4)."""
    found = np.zeros((3, 4))
    for n, (light, strength) in enumerate(style.LIGHTS[:count]):
        found[n] = *light, strength
    found[2, 3] = style.AMBIENT
    return found


def _floor(picture: Picture, camera: Camera) -> Floor | None:
    """The floor of a picture, as it is drawn; None: there is none to be seen."""
    height = picture.ground
    if height is None or not camera.is_above(height):
        return None
    side, reach = surfaces.floor_tiles(camera.radius)
    up, along, across = camera.rotation()[:, [1, 0, 2]].T
    eye = camera.eye
    bright = surfaces.brightness(up)
    one, other = (bright * np.array(style.unit(tile)) for tile in style.TILES)
    return Floor(
        above=float(eye[1] - height),
        axes=(up, along, across),
        eye=(eye[0], eye[2]),
        middle=(camera.centre[0], camera.centre[2]),
        side=side,
        reach=reach,
        colors=(one, other),
    )


def _normals(of: Picture | Ghost, place: np.ndarray, topology: Cached) -> np.ndarray:
    """Unit normals of particles at `place`: those given, or those of the triangles."""
    given = of.normals
    if given is None:
        shown = topology(of.triangles).of_shown(drawing.are_numbers(place))
        given = shown.unit_normals(place)
    return np.asarray(given, np.float32)


def _packed(color: np.ndarray) -> np.ndarray:
    """Colours (n, 3) uint8 as 0xRRGGBB, (n,) int32."""
    codes: np.ndarray = color.astype(np.int32) @ np.array([1 << 16, 1 << 8, 1], np.int32)
    return codes


def _sides(color: np.ndarray) -> np.ndarray:
    """The colours (n, 2) of a surface's front and back whose front has `color`."""
    return np.stack([_packed(color), _packed(surfaces.back_of(color))], axis=1)


def _both(color: np.ndarray) -> np.ndarray:
    return np.repeat(_packed(color)[:, None], 2, axis=1)


def _corners(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles (m, 3) int32, and those that share their sides, -1 where none does."""
    beside = np.full(triangles.shape, -1, np.int32)
    if len(triangles) <= MOST:  # more are so small that nobody sees what is missing
        ends = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2), axis=2)
        key = ends.reshape(-1, 2).astype(np.int64) @ [1 << 31, 1]
        order = np.argsort(key, kind="stable")
        same = np.flatnonzero(key[order[1:]] == key[order[:-1]])
        one, other = order[same], order[same + 1]
        beside.reshape(-1)[one], beside.reshape(-1)[other] = other // 3, one // 3
    return np.ascontiguousarray(triangles, np.int32), beside


def _lines(
    segments: np.ndarray, color: np.ndarray, given: tuple[int, int, int] | np.ndarray | None
) -> np.ndarray:
    """Springs as the rasterizer takes them, (s, 3)."""
    found = np.empty((len(segments), 3), np.int32)
    found[:, :2] = segments
    found[:, 2] = style.packed(style.spring_colors(color, segments, given))
    return found


def _balls(as_spheres: np.ndarray | None, radius: np.ndarray, color: np.ndarray) -> np.ndarray:
    """Particles as the rasterizer takes them, (k, 3)."""
    drawn = np.arange(len(radius)) if as_spheres is None else np.flatnonzero(as_spheres)
    found = np.empty((len(drawn), 3), np.int32)
    found[:, 0], found[:, 1] = drawn, _packed(color[drawn])
    found[:, 2] = radius[drawn].astype(np.float32).view(np.int32)
    return found
