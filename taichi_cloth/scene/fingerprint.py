"""A digest that tells two scenes apart, of all their physics."""

from __future__ import annotations

import hashlib
from dataclasses import fields

import numpy as np

from taichi_cloth.scene.model import Scene


def scene_hash(scene: Scene) -> str:
    """16 digits that two scenes share only if all of their physics is the same."""
    digest = hashlib.sha256()
    world = scene.world
    digest.update(repr((world.size, world.gravity, world.walls, world.collisions)).encode())
    if scene.features().obstacles:
        given = world.up, world.ground, world.friction, world.contact
        digest.update(repr((given, scene.obstacles)).encode())
        if not world.rest:
            digest.update(b"no rest")
    if world.more:
        digest.update(repr(sorted(world.more.items())).encode())
        digest.update(np.ascontiguousarray(scene.triangles).tobytes())
    for part in (scene.particles, scene.springs):
        for column in fields(part):
            if column.name != "color":
                digest.update(np.ascontiguousarray(getattr(part, column.name)).tobytes())
    if len(scene.stencils):
        for values in vars(scene.stencils).values():
            digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()[:16]
