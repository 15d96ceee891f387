"""What the results of a sweep are of: a journal of anything else is another sweep's."""

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
    *("output", "resume", "quiet"),
    *("error", "frame_time", "penetration", "seed", "json"),  # of `tune`, which chooses by them
)


def of_scene(command: str, source: SceneSource, options: Options, scene: Scene) -> dict[str, str]:
    """That of a command on a scene, in words by name."""
    return {
        "command": command,
        "scene": shlex.join(source.words()),
        "scene's digest": scene_hash(scene),
        "settings": shlex.join(options.words(without=BESIDE)),
        **of_place(),
    }


def of_place() -> dict[str, str]:
    """The versions of the packages, and the machine that times are taken on."""
    return {"versions": machine.versions(PACKAGES), "machine": platform.node()}
