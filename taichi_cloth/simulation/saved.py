"""Checkpoints as files: arrays and what else there is of a run, in an ``.npz``."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from taichi_cloth.errors import InputError
from taichi_cloth.files import archives
from taichi_cloth.files.pending import PendingFile
from taichi_cloth.kernels.specialization import Specialization
from taichi_cloth.scene.holding import Hold
from taichi_cloth.scene.model import Particles, Scene, Springs, World
from taichi_cloth.scene.obstacles import Obstacle
from taichi_cloth.scene.stencils import Stencils
from taichi_cloth.settings import accepted
from taichi_cloth.simulation.snapshot import Grips, Judged, Snapshot
from taichi_cloth.simulation.storage.kept import Kept

VERSION = 1  # of the file; another one is refused
TABLES = {"particles": Particles, "springs": Springs, "stencils": Stencils}


@dataclass(frozen=True)
class Saved:
    """A checkpoint that was read back: its parts by name, and what was noted about its run."""

    parts: dict[str, Any]
    about: dict[str, Any]


def digest(scene: Scene) -> str:
    """A digest of a scene in 16 letters: of all of its numbers.

    Whether it is compiled for mouse tools is none: a window's scene is, a picture's is not.
    """
    world = replace(scene.world, tools=False)
    found = hashlib.sha256(repr([scene.name, world, scene.obstacles]).encode())
    for name in (*TABLES, "triangles"):
        table = getattr(scene, name)
        for key, column in (vars(table) if name in TABLES else {name: table}).items():
            found.update(f"{key} {column.shape}".encode() + np.ascontiguousarray(column).tobytes())
    found.update(repr([scene.particle_defaults, scene.spring_defaults]).encode())
    return found.hexdigest()[:16]


def joined(given: Scene, saved: Scene) -> Scene:
    """The scene of a file, with what the file leaves to the scene `given` from there.

    Tables that are equal are those of `given` themselves.
    """
    tables = {}
    for name in TABLES:
        here, there = getattr(given, name), getattr(saved, name)
        pairs = zip(vars(here).values(), vars(there).values(), strict=True)
        tables[name] = here if all(np.array_equal(a, b) for a, b in pairs) else there
    same = np.array_equal(given.triangles, saved.triangles)
    return replace(
        given,
        world=saved.world,
        obstacles=given.obstacles if given.obstacles == saved.obstacles else saved.obstacles,
        triangles=given.triangles if same else saved.triangles,
        **tables,
    )


def write(path: Path, parts: Mapping[str, Any], about: Mapping[str, Any]) -> None:
    """Write a checkpoint's parts to a file, which appears whole or not at all."""
    file = PendingFile(path)
    try:
        into(file, parts, about)
    except BaseException:
        file.discard()
        raise


def into(file: PendingFile, parts: Mapping[str, Any], about: Mapping[str, Any]) -> None:
    """Write a checkpoint's parts to a file that is open already."""
    kept: Kept = parts["kept"]
    scene = kept.taken.scene
    arrays: dict[str, Any] = {"marks": kept.taken.marks, "triangles": scene.triangles}
    arrays |= {f"judged.{key}": of for key, of in vars(kept.taken.judged).items()}
    arrays |= {
        f"grips.{key}": of
        for key, of in (vars(kept.taken.grips) if kept.taken.grips else {}).items()
    }
    for name in TABLES:
        table = vars(getattr(scene, name))
        arrays |= {f"{name}.{key}": column for key, column in table.items()}
    arrays |= {f"field.{key}": array for key, array in kept.fields.items()}
    held = scene.world.held
    arrays |= {} if held is None else {f"held.{key}": of for key, of in vars(held).items()}
    settings = dict(parts["settings"])
    arrays["work"], arrays["unsettled"] = settings.pop("_work"), settings.pop("_unsettled")
    auto = None if parts["auto"] is None else dict(parts["auto"])
    if auto is not None:
        vectors = auto.pop("vectors")
        arrays |= {f"auto.{k}": v for k, v in enumerate(vectors) if v is not None}
    flags = {name: getattr(kept, name) for name in ("topology", "pushed", "held", "altered")}
    meta = {
        "version": VERSION,
        "digest": parts["digest"] or digest(parts["scene"]),
        **{name: parts[name] for name in ("frame", "time", "name", "method", "precision")},
        "prepared": dict(parts["prepared"]),
        "settings": settings,
        "auto": auto,
        "kept": flags,
        "spec": vars(kept.spec),
        "world": vars(replace(scene.world, held=None)),
        "obstacles": [vars(obstacle) for obstacle in scene.obstacles],
        "about": dict(about),
        "noted": dict(parts["noted"]),
    }
    arrays["meta"] = np.array(json.dumps(meta))
    file.fill(lambda to: np.savez(to, **arrays))


def read(path: Path) -> Saved:
    """The checkpoint in a file. InputError where there is none that can be read."""
    arrays = archives.read(path, "checkpoint")
    try:
        meta = json.loads(str(arrays.pop("meta")))
        version = meta["version"]
        if version != VERSION:
            raise InputError(
                f"{path}: is a checkpoint of version {version}, and this program reads {VERSION}: "
                "save it anew"
            )
        return Saved(_parts(meta, arrays), meta["about"])
    except InputError:
        raise
    except (KeyError, ValueError, AttributeError, TypeError, OverflowError) as error:
        lacks = f"it has no {error}" if isinstance(error, KeyError) else str(error)
        raise InputError(f"{path}: is no checkpoint: {lacks}") from None


def _parts(meta: dict[str, Any], arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    """The parts of a `Checkpoint`."""

    def under(name: str) -> dict[str, np.ndarray]:
        begin = f"{name}."
        return {k.removeprefix(begin): v for k, v in arrays.items() if k.startswith(begin)}

    scene = Scene(
        meta["name"],
        replace(
            World(**meta["world"]),
            held=Hold(**under("held")) if under("held") else None,
        ),
        triangles=arrays["triangles"],
        obstacles=tuple(Obstacle(of["shape"], of["values"]) for of in meta["obstacles"]),
        **{name: table(**under(name)) for name, table in TABLES.items()},
    )
    x, v = scene.particles.position, scene.particles.velocity  # overwritten by what is kept
    named = {field.name for field in fields(Specialization)}
    spec = {name: accepted.plain(value) for name, value in meta["spec"].items() if name in named}
    settings = dict(meta["settings"]) | {"_work": arrays["work"]}
    settings["_unsettled"] = arrays.get("unsettled", np.zeros(2, np.int64))  # older files have none
    settings.setdefault("_first", 0)
    settings["_since"] = tuple(settings["_since"])
    judged = Judged(**under("judged")) if under("judged") else Judged.none()  # of older files
    grips = Grips(**under("grips")) if under("grips") else None
    auto = meta["auto"]
    if auto is not None:
        auto["vectors"] = [arrays.get(f"auto.{k}") for k in range(2)]
    return {
        **{name: meta[name] for name in ("frame", "time", "name", "digest", "method", "precision")},
        "scene": None,
        "prepared": meta["prepared"],
        "noted": meta.get("noted", {}),  # of the first model none
        "settings": settings,
        "auto": auto,
        "kept": Kept(
            taken=Snapshot(scene, x, v, arrays["marks"], judged, grips),
            fields=under("field"),
            spec=Specialization(**spec),
            **meta["kept"],
        ),
    }
