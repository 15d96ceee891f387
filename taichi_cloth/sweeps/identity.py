"""The identity of a sweep's results: a journal of anything else is another sweep's."""

from __future__ import annotations

import platform
import shlex

from taichi_cloth.measuring import machine
from taichi_cloth.scene.fingerprint import scene_hash
from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.source import SceneSource
from taichi_cloth.settings.options import Options

PACKAGES = ("taichi-cloth", "taichi", "numpy", "scipy", "python")
# Settings that change no result: a sweep may go on with other ones.
BESIDE = (
    *("output", "resume", "on", "times_on", "quiet"),
    *("within", "quick"),  # what they plan, a journal keeps itself
    *("error", "frame_time", "penetration", "seed", "json"),  # of `tune`, which chooses by them
)


def of_scene(
    command: str, source: SceneSource, options: Options, scene: Scene, timed_on: str | None = None
) -> dict[str, str]:
    """That of a command on a scene, in words by name. timed_on: another machine than this one."""
    return {
        "command": command,
        "scene": shlex.join(source.words()),
        "scene's digest": scene_hash(scene),
        "settings": shlex.join(options.words(without=BESIDE)),
        **of_place(timed_on),
    }


def of_place(timed_on: str | None = None) -> dict[str, str]:
    """The versions of the packages, and the machine that is timed: this one by default."""
    return {"versions": machine.versions(PACKAGES), "machine": timed_on or platform.node()}
