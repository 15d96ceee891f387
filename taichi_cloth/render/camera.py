"""The 3-D camera: a turntable around what it looks at, with a perspective projection.

A point is moved so that what the camera looks at, from the start the world's centre (w/2, h/2, 0),
is the origin, turned about the y axis by `rot_y` and then about the x axis by `rot_x`, and
projected with the scale ``focal_length / (distance + z)``; the image of the origin is the pixel
(w/2, h/2). Pixels here belong to a window of the world's own width and height (`window_map`
scales other windows); y points down, z away from the viewer. A world whose y points up is
first turned half about the x axis, so that its z points to the viewer.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from taichi_cloth.errors import InputError
from taichi_cloth.settings import accepted

FOCAL_LENGTH = 1.7  # in the picture's shorter side: an angle of 33 degrees, a portrait lens
ELEVATION = (14.0, -24.0)  # degrees, rot_x and rot_y of a camera that frames: from above and aside
POSE = 6  # numbers: centre, distance, rot_x, rot_y
FILLED = 0.92  # share of the picture that what is framed may fill


class Camera:
    """A camera that looks at a 3-D world.

    world_size: (w, h) or (w, h, d), world units.
    distance: from the eye to the centre, world units.
    focal_length: pixels per unit of x/z slope.
    rot_x, rot_y: degrees.
    centre: what it looks at, shape (3,), world units; None: the world's centre.
    radius: of the sphere around the centre that is to be seen, world units; None: the world's.
    y_up: whether the world's y points up.

    Raises InputError, as its methods do, for what is no such number or array; where it is, how
    far away and how it is turned may be set, too (`pose` all at once).
    """

    def __init__(
        self,
        world_size: ArrayLike,
        distance: float = 2000.0,
        focal_length: float = 1000.0,
        rot_x: float = 15.0,
        rot_y: float = 15.0,
        *,
        centre: ArrayLike | None = None,
        radius: float | None = None,
        y_up: bool = False,
    ):
        size = accepted.numbers("Camera: world_size", world_size)
        if size.shape not in ((2,), (3,)):
            raise InputError("Camera: world_size must be two or three lengths")
        accepted.require("Camera: world_size", size, size > 0, "must be positive")
        self.world_size = tuple(map(float, size))
        self.distance = accepted.number("Camera: distance", distance, above=0)
        self.focal_length = accepted.number("Camera: focal_length", focal_length, above=0)
        self.rot_x = accepted.number("Camera: rot_x", rot_x)
        self.rot_y = accepted.number("Camera: rot_y", rot_y)
        self.y_up = accepted.flag("Camera: y_up", y_up)
        w, h = self.world_size[:2]
        self.middle = np.array([w / 2, h / 2])  # the pixel of what it looks at
        middle = [w / 2, h / 2, 0.0] if centre is None else centre
        self.centre: np.ndarray = accepted.array("Camera: centre", middle, (3,))
        # As far as the world is visible; outside the sphere around it, with 5 % to spare, and, to a
        # point of one's choice, as near as the knots of a large net ask for.
        if radius is None:
            radius = _half_diagonal(self.world_size)
        self.radius = accepted.number("Camera: radius", radius, above=0)
        self.nearest, self.farthest = 1.05 * self.radius, 40.0 * self.radius
        self.nearest_to_point = 0.1 * self.radius

    @classmethod
    def original(cls, world_size: Sequence[float]) -> Camera | None:
        """The camera of the original program, whose box is some 500 units wide.

        None where the world is so much larger or smaller that it shows little of it.
        """
        camera = cls(world_size)
        return camera if 2 < camera.distance / camera.radius < 12 else None

    @classmethod
    def framing(
        cls, world_size: Sequence[float], low: ArrayLike, high: ArrayLike, *, y_up: bool
    ) -> Camera:
        """A camera, a little above, that sees a box as large as fits into the picture.

        low, high: the box's corners, shape (3,), world units.
        """
        low, high = np.asarray(low, np.float64), np.asarray(high, np.float64)
        w, h = (float(length) for length in world_size[:2])
        radius = max(float(np.linalg.norm(high - low)) / 2, 1e-6 * max(w, h))
        focal = FOCAL_LENGTH * min(w, h)
        camera = cls(
            world_size, 1.0, focal, *ELEVATION, centre=(low + high) / 2, radius=radius, y_up=y_up
        )
        corners = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)])
        camera.pose = camera.framed(np.where(corners, high, low))
        return camera

    @property
    def eye(self) -> np.ndarray:
        """Its place, shape (3,), world units."""
        place: np.ndarray = np.array([0.0, 0.0, -self.distance]) @ self.rotation() + self.centre
        return place

    def is_above(self, height: float) -> bool:
        """True if it is above a floor at this height. From below none is drawn: it would hide all
        that stands on it, and be one plane with the undersides of that.
        """
        above = float(self.eye[1]) - height
        return above > 0 if self.y_up else above < 0

    @property
    def upright(self) -> bool:
        """True if what it sees does not stand on its head, as it does beyond a pole."""
        return math.cos(math.radians(self.rot_x)) >= 0

    @property
    def nearest_drawn(self) -> float:
        """The depth from which on things are drawn, world units."""
        return self.distance / 50

    def rotation(self) -> np.ndarray:
        """The matrix (3, 3) that turns world axes into the camera's: about y, then about x."""
        a, b = math.radians(self.rot_x), math.radians(self.rot_y)
        about_x = np.array(
            [[1, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]]
        )
        about_y = np.array(
            [[math.cos(b), 0, math.sin(b)], [0, 1, 0], [-math.sin(b), 0, math.cos(b)]]
        )
        rotation: np.ndarray = about_x @ about_y
        return rotation @ np.diag([1.0, -1.0, -1.0]) if self.y_up else rotation

    def rotate_points(self, positions: ArrayLike) -> np.ndarray:
        """World `positions` (n, 3) relative to the centre, in the camera's axes, shape (n, 3)."""
        x = accepted.numbers("positions", positions, finite=False)
        if x.size % 3 or x.shape[-1:] != (3,):
            raise InputError(f"positions must have shape (n, 3), has shape {x.shape}")
        offset = x.reshape(-1, 3) - self.centre
        turned: np.ndarray = offset @ self.rotation().T
        return turned

    def project(
        self, positions: ArrayLike, radius: ArrayLike = 0.0
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Project spheres: ``(pixels (n, 2), radii (n,), depths (n,))``.

        positions: (n, 3) world units; radius: one for all or (n,), world units.
        depths are distances along the viewing direction, in world units; a point with a depth
        of zero or less is behind the eye, and its pixel and radius mean nothing.
        """
        turned = self.rotate_points(positions)
        depths = self.distance + turned[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = self.focal_length / depths
            pixels = turned[:, :2] * scale[:, None] + self.middle
            radii = np.broadcast_to(np.asarray(radius, np.float64), depths.shape) * scale
        return pixels, radii, depths

    def unproject(self, pixel: ArrayLike) -> np.ndarray:
        """The world point (3,) under `pixel` (2,) on the plane through the centre that faces us."""
        offset = (_pixel(pixel) - self.middle) * (self.distance / self.focal_length)
        point: np.ndarray = np.array([*offset, 0.0]) @ self.rotation() + self.centre
        return point

    def ray(self, pixel: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """The line of sight through `pixel` (2,): eye (3,) and unit direction (3,), world axes."""
        rotation = self.rotation()
        slope = (_pixel(pixel) - self.middle) / self.focal_length
        direction = np.array([slope[0], slope[1], 1.0]) @ rotation
        return self.eye, direction / np.linalg.norm(direction)

    def rotate(self, dx_deg: float, dy_deg: float) -> None:
        """Add `dx_deg` to `rot_y` and `dy_deg` to `rot_x`, degrees (kept within -180..180)."""
        dx_deg, dy_deg = accepted.number("dx_deg", dx_deg), accepted.number("dy_deg", dy_deg)
        self.rot_y = math.remainder(self.rot_y + dx_deg, 360.0)
        self.rot_x = math.remainder(self.rot_x + dy_deg, 360.0)

    def pan(self, pixels: ArrayLike) -> None:
        """Move what is looked at so that the picture goes by `pixels` (2,)."""
        offset = _pixel(pixels) * (self.distance / self.focal_length)
        self.centre = self.centre - np.array([*offset, 0.0]) @ self.rotation()

    @property
    def pose(self) -> tuple[float, ...]:
        """The place looked at, the distance and the direction: `POSE` numbers, which may be set."""
        return (*map(float, self.centre), self.distance, self.rot_x, self.rot_y)

    @pose.setter
    def pose(self, pose: tuple[float, ...]) -> None:
        *centre, distance, rot_x, rot_y = map(float, accepted.array("pose", pose, (POSE,)))
        self.distance = accepted.number("pose: distance", distance, above=0)
        self.centre, self.rot_x, self.rot_y = np.array(centre), rot_x, rot_y

    def framed(
        self, points: ArrayLike, around: float = 0.0, filled: float = FILLED
    ) -> tuple[float, ...]:
        """Its pose where it sees all points from the same side, as large as fits into the picture.

        points: (n, 3), n > 0, world units; around: how far things reach around them, world units.
        filled: share of the picture that they may fill.
        """
        points = np.asarray(points, np.float64)
        low, high = points.min(axis=0) - around, points.max(axis=0) + around
        radius = max(float(np.linalg.norm(high - low)) / 2, 1e-6 * max(self.world_size[:2]))
        turned = (points - (low + high) / 2) @ self.rotation().T
        # From the distance D and with the centre at u, a point at (x, z) is inside the picture
        # where |x - u| <= slope (D + z): the points that are first to leave it say both.
        slope = filled * self.middle / self.focal_length
        deep = slope * turned[:, 2:]
        right = (turned[:, :2] - deep).max(axis=0) + around
        left = (turned[:, :2] + deep).min(axis=0) - around
        fits = float(((right - left) / (2 * slope)).max())
        centre = (low + high) / 2 + np.array([*(left + right) / 2, 0.0]) @ self.rotation()
        middle = (float(number) for number in centre)
        return (*middle, max(fits, 1.05 * radius), self.rot_x, self.rot_y)

    def zoom(self, factor: float, about: ArrayLike | None = None) -> None:
        """Come nearer by `factor` (2: half the distance; below 1: farther), within limits.

        about: the point (3,) that it comes nearer to, and that keeps its pixel, world units; None:
        what is looked at, and no nearer than the eye is outside the world, as in logs of old.
        What is looked at stays within 40 of the world's radii; to a point one comes as near as a
        tenth. An eye that was put beyond a limit by hand stays there until it is moved.
        """
        wanted = self.distance / accepted.number("the zoom factor", factor, above=0)
        nearest = self.nearest if about is None else self.nearest_to_point
        low, high = min(nearest, self.distance), max(self.farthest, self.distance)
        before, self.distance = self.distance, min(max(wanted, low), high)
        if about is not None:
            point = accepted.array("the zoom's point", about, (3,))
            self.centre = point + (self.centre - point) * (self.distance / before)


def _pixel(value: ArrayLike) -> np.ndarray:
    """A pixel, or a way in pixels, (2,)."""
    return accepted.array("pixel", value, (2,))


def _half_diagonal(lengths: Sequence[float]) -> float:
    return 0.5 * math.sqrt(sum(length**2 for length in lengths))
