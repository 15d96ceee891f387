"""A simulation's state as a `Picture`: what is drawn of it, and in which colours."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.render import style
from taichi_cloth.render.drawing import Cached
from taichi_cloth.render.picture import Picture
from taichi_cloth.scene.model import Scene
from taichi_cloth.settings.options import STRAIN
from taichi_cloth.ui import shown
from taichi_cloth.ui.between import Between
from taichi_cloth.ui.chrome.errors import Errors
from taichi_cloth.ui.chrome.messages import Meanings
from taichi_cloth.ui.framing import camera_of, points_up
from taichi_cloth.ui.ghosts import Ghosts
from taichi_cloth.ui.solids import Solids
from taichi_cloth.ui.strained import Strained
from taichi_cloth.ui.tools.contract import Marks

if TYPE_CHECKING:
    from taichi_cloth.simulation.simulation import Simulation


LEAST_SPAWNED = 1 / 100  # of the picture's shorter side


class Depiction:
    """Makes pictures of a simulation; what has not changed is kept from one to the next.

    show: what is drawn of cloths, words of `settings.options.SHOWN`; None: what suits the scene.
    errors: who knows where the reference is, which is drawn as a ghost when asked for.
    strain: whether springs and surfaces have the colours of what they bear.
    strained: these colours. between: what pictures between two frames are made from.
    """

    def __init__(
        self, sim: Simulation, show: frozenset[str] | None = None, errors: Errors | None = None
    ) -> None:
        show = show or frozenset()
        self.strain = STRAIN in show
        self.show = show - {STRAIN} or shown.default_for(sim.scene)
        self.strained = Strained(sim)
        self._sim = sim
        self._radius = Cached(_drawn_radius)
        largest = float(sim.scene.particles.radius.max(initial=0.0))
        self._discs = _largest_disc(sim.scene), largest
        self._ground = _ground(sim.scene)
        self._came = len(sim.scene.particles), _least_spawned(sim.scene)
        self._chosen = Cached(shown.chosen)
        self._surface_colors = Cached(shown.surface_colors)
        self._turned, self._turned_over = Cached(self._find_turned), Cached(shown.turned_over)
        self._solids = Solids()
        self.between = Between()
        self._errors, self._ghosts = errors, Ghosts()

    @property
    def ghostly(self) -> bool:
        """True if the reference is shown as a ghost, where it is known."""
        return self._errors is not None and self._errors.ghost() is not None

    def show_next(self) -> None:
        """Go on to the next choice of what is drawn of cloths."""
        self.show = shown.next_choice(self.show)

    def picture(self, marks: Marks | None = None, part: float = 1.0) -> Picture:
        """The state as it is now.

        marks: what a tool draws beside it. part: below 1, how far the picture is on the way to it
        from the frame before; what is drawn alone changes.
        """
        sim, between = self._sim, self.between
        triangles, segments, as_spheres = self._chosen(
            self.show, sim.drawn_triangles(), sim.drawn_springs(), sim.particle_count
        )
        position = sim.drawn_positions() if part >= 1 else between.positions(sim, part)
        spring_color: tuple[int, int, int] | np.ndarray | None = sim.scene.spring_color
        # As they are stored, the same arrays until they change; `Simulation` gives copies.
        stored = sim.storage.scene.particles
        color = stored.color
        if self.strain:
            spring_color, color = self.strained.colors(position, segments, sim.particle_count)
            surface_color = color
        else:
            surface_color = self._surface_colors(color, stored.fixed, sim.storage.scene.triangles)
        normals = None
        if len(triangles) and sim.scene.world.dim == 3:
            normals = sim.drawn_normals() if part >= 1 else between.normals(sim, part)
            turned = self._turned(sim.storage.scene.triangles)
            if turned.any():
                triangles, normals = self._turned_over(triangles, turned), normals.copy()
                some = normals[: len(turned)]
                np.negative(some, out=some, where=turned[:, None])
        made = Picture(
            position=position,
            radius=self._radius(stored.radius, *self._discs, *self._came),
            color=color,
            segments=segments,
            spring_color=spring_color,
            surface_color=surface_color,
            triangles=triangles,
            normals=normals,
            as_spheres=as_spheres,
            solids=self._solids.of(sim, sim.time if part >= 1 else between.time(sim, part)),
            ground=self._ground,
        )
        reading = self._errors.ghost() if self._errors else None
        if reading is not None and reading.away is not None:
            made = replace(made, ghost=self._ghosts.of(made, reading.away, reading.torn))
        return made if marks is None else _with_marks(made, marks)

    def _find_turned(self, triangles: np.ndarray) -> np.ndarray:
        """Which particles are in surfaces that begin with their back to the camera, (n,) bool.

        They are drawn the other way round, so that one sees the colour that was asked for.
        """
        camera, position = camera_of(self._sim.scene), self._sim.storage.scene.particles.position
        if camera is None:
            return np.zeros(0, bool)
        up = 1.0 if camera.y_up else -1.0
        return shown.turned_away(camera.eye, position, triangles, up)

    def legends(self) -> list[Meanings]:
        """Legends of the colours, where they mean anything."""
        found = [self.strained.legend()] if self.strain else []
        reading = self._errors.ghost() if self._errors else None
        if reading is not None:
            found.append(((reading.words, style.GHOST),))
        return found


def _drawn_radius(
    radius: np.ndarray, most: float, usual: float, came: int, least: float
) -> np.ndarray:
    """Radii to draw, (n,) float32: at most `most`, but of balls that are larger than all particles
    that the scene came with, `usual`: these are seen as large as they are.

    What was put there since, after the `came` first ones, is drawn with `least` at least.
    """
    drawn: np.ndarray = np.where(radius > usual, radius, np.minimum(radius, most))
    drawn[came:] = np.maximum(drawn[came:], least)
    return drawn.astype(np.float32)


def _ground(scene: Scene) -> float | None:
    """The height of the floor that is drawn in space; None: none is.

    Where y points up and there is none, it lies under what is seen from the start, which would else
    float in a void. Nothing rests on that one.
    """
    world = scene.world
    if world.dim == 2 or world.ground is not None or not points_up(world):
        return world.ground if world.dim == 3 else None
    if any(one.shape == "plane" for one in scene.obstacles):
        return None
    camera = camera_of(scene)
    return float(camera.centre[1] - camera.radius) if camera else None


def _least_spawned(scene: Scene) -> float:
    """The least radius that is drawn of what clicks put into a scene, world units: one that is seen
    from where the scene is looked at first.
    """
    camera, side = camera_of(scene), min(scene.world.size[:2])
    if camera:
        side *= camera.distance / camera.focal_length
    return LEAST_SPAWNED * side


def _with_marks(picture: Picture, marks: Marks) -> Picture:
    """`picture` with what a tool draws beside the scene."""
    count, real = len(picture.position), picture.position.dtype
    place = marks.position.astype(real)
    if marks.on is not None:  # where the picture has them, which may be between two frames
        place[: len(marks.on)] = picture.position[marks.on]
    as_spheres = picture.as_spheres
    if as_spheres is not None:
        as_spheres = np.concatenate([as_spheres, np.ones(len(marks.position), bool)])
    spring_color = picture.spring_color
    if len(marks.segments) and spring_color is not None:
        if isinstance(spring_color, tuple):
            given = np.array(spring_color, np.uint8)
            spring_color = np.tile(given, (len(picture.segments), 1))
        spring_color = np.concatenate([spring_color, marks.color[marks.segments[:, 0]]])
    return replace(
        picture,
        spring_color=spring_color,
        position=np.concatenate([picture.position, place]),
        radius=np.concatenate([picture.radius, marks.radius.astype(np.float32)]),
        color=np.concatenate([picture.color, marks.color]),
        surface_color=np.concatenate([picture.color_in_surfaces, marks.color]),
        segments=np.concatenate([picture.segments, count + marks.segments]),
        as_spheres=as_spheres,
        normals=None,
    )


def _largest_disc(scene: Scene) -> float:
    """The radius above which a particle is drawn smaller than it is, world units.

    Particles that pass through each other may be larger than the mesh they sit in, and would
    hide its springs. Where they collide, or hang in chains, their size is what one looks at.
    """
    springs, position = scene.springs, scene.particles.position
    if scene.world.collisions or len(springs) <= len(position):
        return np.inf
    a, b = springs.between.T
    return 0.3 * float(np.median(np.linalg.norm(position[a] - position[b], axis=1))) or np.inf
