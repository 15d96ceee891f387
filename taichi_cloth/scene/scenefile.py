"""Scene files: TOML <-> Scene.

`load` reads the format, `save` and `dump` write it; its tables and their keys are in `tables.py`.
Every refusal is one line with the file, the line in it where one is at fault, and what to change.
"""

from __future__ import annotations

import difflib
import os
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from taichi_cloth.errors import InputError
from taichi_cloth.files import content
from taichi_cloth.files.meshes import FORMATS
from taichi_cloth.files.pending import PendingFile
from taichi_cloth.scene import toml
from taichi_cloth.scene.assignments import Assignment
from taichi_cloth.scene.checks import validate
from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.obstacles import Obstacle, usual_contact
from taichi_cloth.scene.palette import FIXED_COLOR, PARTICLE_COLOR
from taichi_cloth.scene.properties import PARTICLE_PROPERTIES, SPRING_PROPERTIES, WorldValue
from taichi_cloth.scene.reading import Table
from taichi_cloth.scene.tables import SceneReader
from taichi_cloth.settings import accepted

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def load(path: str | Path, assignments: Sequence[Assignment] = ()) -> Scene:
    """The scene in the TOML file at `path`, checked. Raises InputError for anything amiss.

    assignments: values that take the place of the file's.
    """
    path = accepted.path("load_scene: path", path)
    remedy = f"save it as UTF-8{_of_meshes(path.name)}"
    said = content.text(path, "scene file", hint=_similar_file, remedy=remedy)
    name = os.fsencode(path.stem).decode("utf-8", "replace")
    return parse(said, path.name, name, assignments, path.parent)


def parse(
    text: str,
    name: str = "scene.toml",
    default_scene_name: str = "scene",
    assignments: Sequence[Assignment] = (),
    folder: Path = Path(),
) -> Scene:
    """The scene that `text` describes, checked; `name` is the file's in messages.

    folder: to which the files that it names are relative.
    """
    text = text.removeprefix("\ufeff").replace("\r\n", "\n")
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        said = toml.parse_error(name, str(error), text)
        raise InputError(f"{said}{_of_meshes(name)}") from None
    except RecursionError:
        raise InputError(f"{name}: is nested too deeply to be a scene") from None
    except ValueError:  # the one thing tomllib passes on: int() refuses thousands of digits
        digits = re.search(r"[\d_]{4300}", text)
        line = text.count("\n", 0, digits.start()) + 1 if digits else 1
        where = f"{name} line {line}"
        raise InputError(f"{where}: has a whole number with too many digits") from None
    return parse_table(table, name, text, default_scene_name, assignments, folder)


def parse_table(
    table: Table,
    name: str,
    text: str = "",
    default_scene_name: str = "scene",
    assignments: Sequence[Assignment] = (),
    folder: Path = Path(),
) -> Scene:
    """The scene that a file's table describes, checked; text: what it was read from."""
    reader = SceneReader(name, text, default_scene_name, folder)
    for assignment in assignments:
        reader.assign(table, assignment)
    with np.errstate(all="ignore"):  # numbers that overflow are refused by name
        return reader.scene(table)


def save(scene: Scene, path: str | Path) -> None:
    """Write `scene` to `path`, whole or not at all. Raises InputError if that cannot be written."""
    text = dump(validate(scene)).encode()
    path = accepted.path("save_scene: path", path)

    def write(file: BinaryIO) -> None:
        file.write(text)

    PendingFile(path).fill(write)


def table_of(scene: Scene) -> Table:
    """The part of a scene's file beside its particles and springs, as a table."""
    world = scene.world
    given = {
        "particle": {key: getattr(scene.particle_defaults, key) for key in PARTICLE_PROPERTIES},
        "spring": {key: getattr(scene.spring_defaults, key) for key in SPRING_PROPERTIES},
    }
    return {
        "name": scene.name,
        "world": {
            "size": list(world.size),
            **({"up": world.up} if world.up else {}),
            "gravity": list(world.gravity),
            "dt": world.dt,
            "substeps": world.substeps,
            "walls": list(world.walls),
            "collisions": world.collisions,
            "mouse": world.mouse,
            **_contact_of(scene),
            **{key: _plain(value) for key, value in world.more.items()},
        },
        **(
            {"obstacles": [_listed_obstacle(o) for o in scene.obstacles]} if scene.obstacles else {}
        ),
        **{
            kind: {key: value for key, value in numbers.items() if value is not None}
            for kind, numbers in given.items()
        },
    }


def _plain(value: WorldValue) -> Any:
    """A value of a world's key as TOML's parser gives it."""
    if isinstance(value, Mapping):
        return {name: _plain(inner) for name, inner in value.items()}
    return list(value) if isinstance(value, tuple) else value


def _contact_of(scene: Scene) -> dict[str, Any]:
    """Those keys of [world] for contacts that end a step that a scene gives."""
    world = scene.world
    given: dict[str, Any] = {}
    if world.ground is not None:
        given["ground"] = world.ground
    if world.friction != 0.0:
        given["friction"] = world.friction
    written = {*given, *world.more, *(["up"] if world.up else [])}
    written |= {"obstacles"} if scene.obstacles else set()
    if world.contact != usual_contact(written):
        given["contact"] = world.contact
    if not world.rest:
        given["rest"] = False
    return given


def _listed_obstacle(obstacle: Obstacle) -> Table:
    """An obstacle as a table of a file."""
    return {"shape": obstacle.shape, **obstacle.values}


def _similar_file(path: Path) -> str:
    try:
        names = [p.name for p in path.parent.glob("*.toml")]
    except OSError:
        return ""
    close = difflib.get_close_matches(path.name, names, n=1)
    return f"; did you mean '{path.parent / close[0]}'?" if close else ""


def _of_meshes(name: str) -> str:
    """A hint where a file of another suffix is no scene: it may be another kind of mesh."""
    if Path(name).suffix.lower() in ("", ".toml"):
        return ""
    return f"; a mesh is read from a file that ends in {', '.join(f'.{s}' for s in FORMATS)}"


# Writing


def dump(scene: Scene) -> str:
    """`scene` as TOML text that `parse` reads back as an equal scene (bit for bit).

    Cloths and meshes come out as single particles, springs and triangles; what equals the defaults
    is left out.
    """
    world = scene.world
    out = [
        f"name = {_quoted(scene.name)}",
        *_triangles(scene.triangles),
        "",
        "[world]",
        f"size = {_listed(world.size)}",
        *([f"up = {_quoted(world.up)}"] if world.up else []),
        f"gravity = {_listed(world.gravity)}",
        f"dt = {float(world.dt)!r}",
        *([f"substeps = {_toml(world.substeps)}"] if world.up or world.substeps != 1 else []),
        f"walls = [{', '.join(map(_quoted, world.walls))}]",
        f"collisions = {str(bool(world.collisions)).lower()}",
        f"mouse = {_quoted(world.mouse)}",
    ]
    out += [f"{key} = {_toml(value)}" for key, value in _contact_of(scene).items()]
    for name, value in world.more.items():
        out.append(f"{name} = {_inline(value)}")
    for table, defaults, properties in (
        ("particle", scene.particle_defaults, PARTICLE_PROPERTIES),
        ("spring", scene.spring_defaults, SPRING_PROPERTIES),
    ):
        out += ["", f"[{table}]"]
        given = ((key, getattr(defaults, key)) for key in properties)
        out += [f"{key} = {_written(value)}" for key, value in given if value is not None]
    if scene.spring_color is not None:
        out.append(f"color = {list(map(int, scene.spring_color))}")
    out += [*_particle_lines(scene), *_spring_lines(scene)]
    for obstacle in scene.obstacles:
        out += ["", "[[obstacles]]"]
        out += [f"{key} = {_toml(value)}" for key, value in _listed_obstacle(obstacle).items()]
    return "\n".join([*out, *_stencil_lines(scene)]) + "\n"


def _particle_lines(scene: Scene) -> Iterator[str]:
    """The lines of all particles, each with what is not as by default."""
    particles = scene.particles
    for i in range(len(particles)):
        yield from ("", "[[particles]]", f"position = {_listed(particles.position[i])}")
        if particles.velocity[i].any() or np.signbit(particles.velocity[i]).any():
            yield f"velocity = {_listed(particles.velocity[i])}"
        if particles.fixed[i]:
            yield "fixed = true"
        color = tuple(map(int, particles.color[i]))
        if color != (FIXED_COLOR if particles.fixed[i] else PARTICLE_COLOR):
            yield f"color = {list(color)}"
        for key in PARTICLE_PROPERTIES:
            value = float(getattr(particles, key)[i])
            if value != getattr(scene.particle_defaults, key):
                yield f"{key} = {value!r}"


def _spring_lines(scene: Scene) -> Iterator[str]:
    """The lines of all springs, each with what is not as by default."""
    springs = scene.springs
    for i in range(len(springs)):
        yield from ("", "[[springs]]", f"between = {list(map(int, springs.between[i]))}")
        for key, about in SPRING_PROPERTIES.items():
            value, default = getattr(springs, key)[i], getattr(scene.spring_defaults, key)
            if about.off is not None and value == about.off:
                if default is not None:
                    yield f"{key} = false"
            elif value != default:
                yield f"{key} = {_written(value)}"


def _stencil_lines(scene: Scene) -> Iterator[str]:
    """The lines of all stencils."""
    stencils = scene.stencils
    for i in range(len(stencils)):
        mine = slice(stencils.start[i], stencils.start[i + 1])
        yield from ("", "[[stencils]]", f"between = {stencils.particle[mine].tolist()}")
        yield f"weights = {_listed(stencils.weight[mine])}"
        yield f"bending = {float(stencils.bending[i])!r}"


def _toml(value: Any) -> str:
    """A number with all its digits, a text, or a list of these or of lists."""
    if isinstance(value, (tuple, list)):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, (int, np.integer)) and not isinstance(value, bool):
        return str(int(value))
    return _written(value)


def _triangles(triangles: np.ndarray) -> list[str]:
    """The lines of the list of triangles; none where there are none."""
    if len(triangles) == 0:
        return []
    return ["triangles = [", *(f"    [{i}, {j}, {k}]," for i, j, k in triangles.tolist()), "]"]


def _written(value: float | str) -> str:
    """A number, with all its digits, or a word."""
    return _quoted(value) if isinstance(value, str) else repr(float(value))


def _inline(value: WorldValue) -> str:
    """A number, a list of them, or an inline table."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{name} = {_inline(of)}" for name, of in value.items()) + " }"
    return repr(float(value)) if isinstance(value, (int, float)) else _listed(value)


def _listed(values: Iterable[float]) -> str:
    return "[" + ", ".join(repr(float(v)) for v in values) + "]"


def _quoted(text: str) -> str:
    """`text` as a TOML basic string."""
    escaped = "".join(
        f"\\{c}" if c in '"\\' else c if c.isprintable() else f"\\U{ord(c):08X}" for c in text
    )
    return f'"{escaped}"'
