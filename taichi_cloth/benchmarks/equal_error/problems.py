"""The scenes on which solvers meet: springs and dashpots alone, which all of them have."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from taichi_cloth.scene.library import build
from taichi_cloth.scene.model import Scene, SpringDefaults

FRAMES, QUICK_FRAMES = 30, 10
SIDE, QUICK_SIDE = 64, 16
STIFFER = (1, 100, 10_000)  # times Warp's own stiffness
QUICK_STIFFER = (1, 100)


@dataclass(frozen=True)
class Problem:
    """A scene, and for how many of its frames it is run."""

    name: str
    scene: Scene
    frames: int


def all_problems(quick: bool) -> list[Problem]:
    """All of them; quick: smaller and shorter, without the stiffest."""
    frames, side = (QUICK_FRAMES, QUICK_SIDE) if quick else (FRAMES, SIDE)
    stiffer = QUICK_STIFFER if quick else STIFFER
    swinging = [
        Problem(cloth_name(side, times, damped), warp(side, times, damped), frames)
        for times in stiffer
        for damped in (True, False)
    ]
    return [Problem("seed cloth", seed(), frames), *swinging]


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
