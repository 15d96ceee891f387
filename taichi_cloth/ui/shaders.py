"""Taichi's shaders for GGUI, without what nothing drawn here needs and software takes time for.

They branch on uniforms: whether each vertex has its own colour, or radius. Mesa's software Vulkan
(seen in 22.3) puts uniforms into such shaders as constants and compiles them, anew at each draw of
a scene: 1 ms, and 110 to 200 KB that it keeps. Here all vertices have their own, so the conditions
are made constants in copies of the shaders. Nor is the colour of what is flat interpolated, as all
corners of a triangle, and all of a circle, have the same. What is drawn stays the same.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from taichi_cloth.settings.options import PROGRAM
from taichi_cloth.simulation import cache

# Of each shader its conditional branches in order, and what their conditions are here; None: left.
BRANCHES: dict[str, tuple[bool | None, ...]] = {
    "Mesh_vk_vert.spv": (False,),  # no colour of its own
    "Particles_vk_vert.spv": (False, False),  # no radius, no colour
    "SceneLines2quad_vk_comp.spv": (None, False, True),  # past the end; indexed; coloured
    "Triangles_vk_vert.spv": (False,),
    "Circles_vk_vert.spv": (False, False),
}
# Of each shader the location of its input that all corners share: the colour.
SHARED = {"Triangles_vk_frag.spv": 1, "Circles_vk_frag.spv": 1}

# SPIR-V: words of a module's head, which of them is the bound of its ids, and opcodes.
HEAD, BOUND, MAGIC = 5, 3, 0x07230203
TYPE_BOOL, CONSTANT_TRUE, CONSTANT_FALSE, BRANCH_CONDITIONAL = 20, 41, 42, 250
VARIABLE, INPUT, DECORATE, LOCATION, FLAT = 59, 1, 71, 30, 14


def open_window(title: str, size: tuple[int, int], *, visible: bool) -> Any:
    """A ti.ui.Window with our copies of the shaders; with Taichi's own where they are others."""
    import taichi as ti

    module: Any = importlib.import_module("taichi.ui.window")
    own = module.__file__
    package = _package(Path(own).parent.parent / "shaders")
    if package is not None:
        module.__file__ = str(package / "ui" / "window.py")  # beside which it looks for shaders
    try:
        # The app paces itself; GGUI's own limit would count as time spent drawing.
        return ti.ui.Window(title, size, vsync=False, show_window=visible, fps_limit=1000)
    finally:
        module.__file__ = own


def _package(source: Path) -> Path | None:
    """A folder whose shaders are copies of those in `source`; None where none can be made."""
    try:
        files = {path.name: path.read_bytes() for path in sorted(source.glob("*.spv"))}
        files |= {name: fixed(files[name], held) for name, held in BRANCHES.items()}
        files |= {name: shared(files[name], at) for name, at in SHARED.items()}
        digest = hashlib.sha256(b"".join(files.values())).hexdigest()[:16]
        folder = cache.folder() / f"shaders-{digest}"
        if not folder.is_dir():
            _fill(folder, files)
        if not _is_whole(folder, files):
            print(
                f"{PROGRAM}: note: {folder} is damaged, and Taichi's own shaders draw instead; "
                "remove it to have it made anew",
                file=sys.stderr,
            )
            return None
    except (OSError, KeyError, ValueError):
        return None
    return folder


def _is_whole(folder: Path, files: dict[str, bytes]) -> bool:
    """Whether the copies of an earlier run are what they should be."""
    for name, content in files.items():
        try:
            if (folder / "shaders" / name).read_bytes() != content:
                return False
        except OSError:
            return False
    return True


def _fill(folder: Path, files: dict[str, bytes]) -> None:
    """Make the folder as a whole, as another run may be making it at the same time."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    new = Path(tempfile.mkdtemp(dir=folder.parent))
    try:
        (new / "shaders").mkdir()
        for name, content in files.items():
            (new / "shaders" / name).write_bytes(content)
        with contextlib.suppress(OSError):  # the other run was first
            os.rename(new, folder)
    finally:
        shutil.rmtree(new, ignore_errors=True)


def fixed(module: bytes, held: Sequence[bool | None]) -> bytes:
    """A SPIR-V module in which the conditions of branches are constants.

    held: of each conditional branch, in order, what it is to be; None: it is left. ValueError where
    the module has another number of branches, or is none.
    """
    head, instructions = _read(module)
    bound = int(head[BOUND])
    constants = {False: bound, True: bound + 1}
    head[BOUND] = bound + len(constants)
    parts, branch = [head], 0
    for code, instruction in instructions:
        if code == BRANCH_CONDITIONAL:
            value = held[branch] if branch < len(held) else None
            if value is not None:
                instruction[1] = constants[value]
            branch += 1
        parts.append(instruction)
        if code == TYPE_BOOL:
            for value, opcode in ((False, CONSTANT_FALSE), (True, CONSTANT_TRUE)):
                new = [3 << 16 | opcode, instruction[1], constants[value]]
                parts.append(np.array(new, "<u4"))
    if branch != len(held):
        raise ValueError(f"{branch} conditional branches instead of {len(held)}")
    return bytes(np.concatenate(parts))


def shared(module: bytes, location: int) -> bytes:
    """A SPIR-V module of fragments, whose input at a location is that of a first corner.

    ValueError where the module has no such input, or is none.
    """
    head, instructions = _read(module)
    inputs = {int(i[2]) for code, i in instructions if code == VARIABLE and i[3] == INPUT}
    parts, found = [head], False
    for code, instruction in instructions:
        parts.append(instruction)
        placed = code == DECORATE and list(instruction[2:]) == [LOCATION, location]
        if placed and int(instruction[1]) in inputs:
            parts.append(np.array([3 << 16 | DECORATE, instruction[1], FLAT], "<u4"))
            found = True
    if not found:
        raise ValueError(f"no input at location {location}")
    return bytes(np.concatenate(parts))


def _read(module: bytes) -> tuple[np.ndarray, list[tuple[int, np.ndarray]]]:
    """A SPIR-V module's head, and its instructions with their opcodes, all as words that may be
    changed; ValueError where it is none.
    """
    words = np.frombuffer(module, "<u4").copy()
    if len(words) < HEAD or words[0] != MAGIC:
        raise ValueError("not a SPIR-V module")
    return words[:HEAD], list(_instructions(words))


def _instructions(words: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    at = HEAD
    while at < len(words):
        code, length = int(words[at]) & 0xFFFF, int(words[at]) >> 16
        if length == 0 or at + length > len(words):
            raise ValueError("not a whole SPIR-V module")
        yield code, words[at : at + length]
        at += length
