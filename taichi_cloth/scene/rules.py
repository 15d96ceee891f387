"""Rules of the physics that have changed, and the scenes that are others by that.

Logs, checkpoints and recordings note the model under which they were made. What an earlier one made
of a scene whose rules have changed since is refused; all else goes on to the same bits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from taichi_cloth.errors import InputError
from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.solids import met_by_faces, solids
from taichi_cloth.scene.triangles import areas, at_corners, corner_shares
from taichi_cloth.version import __version__

MODEL = 2  # of what is made from here on
NOTED: dict[str, Any] = {"model": MODEL, "version": __version__}  # by all that is made


@dataclass(frozen=True)
class Change:
    """A rule that has changed.

    model: the first one that has it as it is now. what: it is of, in words. touches: whether a
    scene is another one by that. unless: what a log notes with which that does not matter; "":
    nothing.
    """

    model: int
    what: str
    touches: Callable[[Scene], bool]
    unless: str = ""


def _assumes(*keys: str) -> Callable[[Scene], bool]:
    """A test whether the file of a scene leaves any of these keys open."""
    return lambda scene: any(key in scene.assumed for key in keys)


def _weighed_by_angles(scene: Scene) -> bool:
    """True if a mesh of the scene has its mass by a density: its triangles' shares, by angles.

    Triangles of grids, half a square each, were always shared so.
    """
    particles, triangles = scene.particles, scene.triangles
    if scene.world.dim != 3 or len(triangles) == 0:
        return False
    corners = particles.position[triangles]
    sides = np.sort(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2), axis=1)
    half = np.isclose(sides[:, 0], sides[:, 1]) & np.isclose(2 * sides[:, 0] ** 2, sides[:, 2] ** 2)
    shares = corner_shares(particles.position, triangles)
    shares = shares * areas(particles.position, triangles)[:, None]
    share = at_corners(shares, triangles, len(particles))
    with np.errstate(all="ignore"):
        density = (particles.mass / share)[triangles]
    return bool((~half & (np.ptp(density, axis=1) <= 1e-9 * density[:, 0])).any())


def _meets_faces(scene: Scene) -> bool:
    """True if a scene has what is sharp enough to pass between particles of its cloths."""
    return bool(met_by_faces(scene, solids(scene)))


def _has_finer_bodies(scene: Scene) -> bool:
    """True if a mesh is an obstacle that gives no `cell`, and its cells are not a 32nd of it."""
    for obstacle, solid in zip(scene.obstacles, solids(scene), strict=False):
        x, faces = solid.placed.vertices, solid.placed.faces
        if x is None or faces is None or obstacle.value("cell") is not None:
            continue
        if not np.isclose(solid.placed.cell, np.ptp(x[np.unique(faces)], axis=0).max() / 32):
            return True
    return False


# Whoever changes a rule adds it here, and raises MODEL once a release has the one before.
CHANGES = (
    Change(
        2,
        "the radius and the restitution of what is in metres and gives none",
        _assumes("particle.radius", "particle.restitution"),
    ),
    Change(
        2,
        "the steps of what is in metres and gives none",
        _assumes("world.dt", "world.substeps"),
        unless="dt",
    ),
    Change(
        2,
        "the contact of sandbox's discs",
        lambda scene: scene.name == "sandbox" and scene.world.contact == "resting",
    ),
    Change(2, "how the vertices of a mesh share its mass", _weighed_by_angles),
    Change(2, "the bending of meshes", lambda scene: "bending" in scene.of_meshes),
    Change(2, "how faces and edges touch what is sharp", _meets_faces),
    Change(2, "the grid of obstacles that are meshes", _has_finer_bodies),
)


def refuse_changed(scene: Scene, noted: Mapping[str, Any], where: str) -> None:
    """Raise InputError where something was made of this scene under rules that are others now.

    noted: what it says of its run, "model" and "version" among it; where: what to call it.
    """
    model, version = noted.get("model", 1), noted.get("version")
    by = f"taichi-cloth {version}" if version else "a taichi-cloth before models were noted"
    if model > MODEL:
        raise InputError(
            f"{where}: was made under model {model}, by {by}, and this is taichi-cloth "
            f"{__version__}, which knows models up to {MODEL}; take that version"
        )
    changed = [
        change.what
        for change in CHANGES
        if model < change.model and change.unless not in noted and change.touches(scene)
    ]
    if changed:
        raise InputError(
            f"{where}: was made under model {model}, by {by}; since then {', and '.join(changed)} "
            f"{'has' if len(changed) == 1 else 'have'} changed, and '{scene.name}' with it: "
            "make it anew"
        )
