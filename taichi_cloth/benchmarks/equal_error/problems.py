"""The scenes on which solvers meet: springs and dashpots alone, which all of them have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from taichi_cloth.errors import InputError, nearest
from taichi_cloth.scene.fingerprint import scene_hash
from taichi_cloth.scene.library import build
from taichi_cloth.scene.model import Scene, SpringDefaults

FRAMES, QUICK_FRAMES = 30, 10
SIDE, QUICK_SIDE = 64, 16
STIFFER = (1, 100, 10_000)  # times Warp's own stiffness
QUICK_STIFFER = (1, 100)


@dataclass(frozen=True)
class Problem:
    """A scene, and for how many of its frames it is run. key: what it is asked for by."""

    key: str
    name: str
    scene: Scene
    frames: int

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
    return [Problem("seed", hanging, seed(), frames), *swinging]


def chosen(problems: Sequence[Problem], keys: Sequence[str]) -> list[Problem]:
    """Those of these keys, all if there are none; raises InputError for an unknown one."""
    known = [problem.key for problem in problems]
    for key in keys:
        if key not in known:
            raise InputError(f"--scenes: unknown scene '{key}'; {nearest(key, known)}")
    return [problem for problem in problems if not keys or problem.key in keys]


def cloth_name(side: int, times: float, damped: bool) -> str:
    """What tables call `warp`'s scene."""
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
