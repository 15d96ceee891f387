"""The scenes on which solvers meet: springs, dashpots and contacts, as all of them have them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from taichi_cloth.errors import InputError, nearest
from taichi_cloth.scene.cloth import grid
from taichi_cloth.scene.fingerprint import scene_hash
from taichi_cloth.scene.library import build
from taichi_cloth.scene.material import Material
from taichi_cloth.scene.model import Scene, SpringDefaults, World
from taichi_cloth.scene.obstacles import Obstacle

FRAMES, QUICK_FRAMES = 30, 10
SIDE, QUICK_SIDE = 64, 16
DRAPED, QUICK_DRAPED = 33, 17  # particles along the side of what falls
WIDTH, RADIUS, NEAR = 1.6, 0.3, 0.005  # of the cloth; of the sphere; from where on it touches [m]
STIFFER = (1, 100, 10_000)  # times Warp's own stiffness
QUICK_STIFFER = (1, 100)


@dataclass(frozen=True)
class Problem:
    """A scene, and for how many of its frames it is run. key: what it is asked for by."""

    key: str
    name: str
    scene: Scene
    frames: int

    @property
    def touching(self) -> bool:
        """True if there is what particles can touch: no method is of high order beyond that."""
        return bool(self.scene.obstacles) or self.scene.world.ground is not None

    @cached_property
    def digest(self) -> str:
        """Of all its physics, and of the frames: what results are of."""
        return f"{scene_hash(self.scene)}, {self.frames} frames"


def all_problems(quick: bool) -> list[Problem]:
    """All of them; quick: smaller and shorter, without the stiffest."""
    frames, side = (QUICK_FRAMES, QUICK_SIDE) if quick else (FRAMES, SIDE)
    stiffer = QUICK_STIFFER if quick else STIFFER
    swinging = [
        Problem(
            "-".join(["warp", *([f"{times}"] * (times != 1)), *(["undamped"] * (not damped))]),
            cloth_name(side, times, damped),
            warp(side, times, damped),
            frames,
        )
        for times in stiffer
        for damped in (True, False)
    ]
    # A shorter run has rows of its own.
    hanging = f"seed cloth, {frames} frames" if quick else "seed cloth"
    along = QUICK_DRAPED if quick else DRAPED
    falling = Problem("drape", f"drape {along}²", drape(along), frames)
    return [Problem("seed", hanging, seed(), frames), *swinging, falling]


def chosen(problems: Sequence[Problem], keys: Sequence[str]) -> list[Problem]:
    """Those of these keys, all if there are none; raises InputError for an unknown one."""
    known = [problem.key for problem in problems]
    for key in keys:
        if key not in known:
            raise InputError(f"--scenes: unknown scene '{key}'; {nearest(key, known)}")
    return [problem for problem in problems if not keys or problem.key in keys]


def cloth_name(side: int, times: float, damped: bool) -> str:
    """The name of `warp`'s scene in tables."""
    words = [f"Warp's cloth {side}²", "" if times == 1 else f"{times:g} × k"]
    return ", ".join(filter(None, [*words, "" if damped else "no dashpots"]))


def seed() -> Scene:
    """The cloth of the first program as it begins to hang, without drag, walls and fracture."""
    full = build("cloth")
    springs = full.springs
    return replace(
        full,
        name="seed cloth",
        world=replace(full.world, walls=(), mouse="none"),
        particles=replace(full.particles, viscous=np.zeros(len(full.particles))),
        springs=replace(springs, break_force=np.full(len(springs), np.inf)),
        spring_defaults=SpringDefaults(),
    )


def drape(side: int) -> Scene:
    """A sheet of structural springs that falls on a sphere, over it and onto the floor; SI units.

    So many particles along a side; it touches at `NEAR`, without friction, and not itself. As far
    as one can be the same everywhere: each solver has a friction of its own, triangles can be these
    springs and no others (`newton_model`), and have no dashpots.
    """
    particles, springs = grid(
        (1.0 - WIDTH / 2, 2.0 * RADIUS + 4 * NEAR, -WIDTH / 2 + 0.05),
        side,
        side,
        WIDTH / (side - 1),
        links=("structural",),
        across=(1.0, 0.0, 0.0),
        down=(0.0, 0.0, 1.0),
        material=Material(density=0.2, stretch=80.0, damping_time=0.0),
    )
    return Scene(
        name="drape",
        world=World(
            size=(2.0, 1.5, 2.0),
            up="y",
            mouse="none",
            gravity=(0.0, -9.81, 0.0),
            dt=1 / 60,
            ground=0.0,
        ),
        particles=replace(particles, radius=np.full(len(particles), NEAR)),
        springs=springs,
        obstacles=(Obstacle.build("sphere", centre=[1.0, RADIUS, 0.0], radius=RADIUS),),
    )


def warp(side: int, times: float = 1, damped: bool = True) -> Scene:
    """The cloth of Warp's benchmark with so many times its stiffness, with its dashpots or none."""
    made = build("warp", side=side)
    springs = made.springs
    return replace(
        made,
        springs=replace(
            springs,
            stiffness=times * springs.stiffness,
            damping=springs.damping if damped else np.zeros(len(springs)),
        ),
    )
