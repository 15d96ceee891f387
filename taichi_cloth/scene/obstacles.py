"""Obstacles as a scene gives them: a shape's name and values of its keys, and what is refused.

Their shapes are declared in `kernels/obstacles/`, one file each; reading those imports Taichi, so
it is done only where a scene has an obstacle. Where obstacles are, and what they do to particles,
is in `solids`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_cloth.errors import InputError, nearest
from taichi_cloth.scene import toml
from taichi_cloth.settings import accepted

if TYPE_CHECKING:
    from taichi_cloth.kernels.obstacles.contract import Key

CONTACTS = ("original", "resting")  # how walls and pairs of particles treat positions
# Keys of [world] and tables of a file that the original programs had nothing of.
NEWER = frozenset({"up", "ground", "friction", "air", "obstacles", "meshes"})


@dataclass(frozen=True)
class Obstacle:
    """One obstacle: the name of its shape, and values of its keys, which are those of scene files.

    Points are tuples of numbers, lists of them tuples of tuples, whatever they were given as. What
    is absent has its default.
    """

    shape: str
    values: Mapping[str, Any] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", accepted.plain(self.values))

    @classmethod
    def build(cls, shape: str, **values: Any) -> Obstacle:
        """An obstacle from numbers, lists and arrays, such as build("sphere", centre=[0, 1, 0],
        radius=0.3, friction=0.4); `checks.validate` says what is wrong with them.
        """
        return cls(shape, values)

    def with_file(self, folder: Path) -> tuple[Obstacle, tuple[str, ...]]:
        """This obstacle with what its file has, in the place of the file's name, and notes on it.

        folder: where a relative name begins. InputError where the file has no sound mesh.
        """
        from taichi_cloth.scene import meshfile

        name = self.values.get("file")
        twice = not {"vertices", "faces"}.isdisjoint(self.values)
        if not isinstance(name, str) or self.shape != "mesh" or twice:
            return self, ()  # `fault` says what is wrong
        body = meshfile.read_body(folder / name)
        values = {key: value for key, value in self.values.items() if key != "file"}
        given = {"vertices": body.vertices, "faces": body.triangles}
        return Obstacle.build(self.shape, **given, **values), body.notes

    def value(self, name: str) -> Any:
        """The value of a key, its default where it is absent."""
        return self.values.get(name, keys_of(self.shape)[name].default)


def shapes() -> tuple[str, ...]:
    """The names of the shapes that there are."""
    from taichi_cloth.kernels import obstacles

    return obstacles.SHAPES


def keys_of(shape: str) -> dict[str, Key]:
    """The keys of a shape and those that all obstacles have, by name."""
    from taichi_cloth.kernels import obstacles
    from taichi_cloth.kernels.obstacles.contract import COMMON

    return {key.name: key for key in (*obstacles.load(shape).keys, *COMMON)}


def usual_contact(given: Iterable[str]) -> str:
    """The rule of contacts where a scene file names none, out of `CONTACTS`.

    given: the keys of its [world] and its tables. Scenes that have nothing newer than the original
    programs keep their rule, which the golden data has.
    """
    return CONTACTS[0] if NEWER.isdisjoint(given) else CONTACTS[1]


def fault(obstacle: Any, dim: int) -> tuple[str | None, str] | None:
    """The fault of an obstacle in a world of `dim` dimensions: (key or None, words)."""
    from taichi_cloth.kernels import obstacles
    from taichi_cloth.kernels.obstacles.contract import REQUIRED

    if not isinstance(obstacle, Obstacle):
        return None, f"must be an Obstacle, is {accepted.shown(obstacle)}"
    if not isinstance(obstacle.shape, str) or obstacle.shape not in shapes():
        return (
            "shape",
            f"unknown shape {obstacle.shape!r}; {nearest(str(obstacle.shape), shapes())}",
        )
    given: Any = obstacle.values
    if not isinstance(given, Mapping):
        return None, f"values must be a mapping of keys to values, is {accepted.shown(given)}"
    shape, known = obstacles.load(obstacle.shape), keys_of(obstacle.shape)
    if dim not in shape.dims:
        lengths = "three" if dim == 2 else "two"
        return "shape", f"a {dim}-D world has no {obstacle.shape}; give size {lengths} lengths"
    for name in obstacle.values:
        if name not in known:
            return name, f"unknown key '{name}' of a {obstacle.shape}; {nearest(name, known)}"
    for name, key in known.items():
        if name in obstacle.values:
            words = _fault_of_value(key, obstacle.values[name], dim)
            if words:
                return name, f"{name} {words}"
        elif key.default == REQUIRED:
            return None, f"'{name}' is missing"
    values = {name: obstacle.value(name) for name in known}
    if values["stops"] is not None and values["stops"] < values["starts"]:
        starts, stops = values["starts"], values["stops"]
        return "stops", f"stops must not be before starts, {starts:g}, is {stops:g}"
    return shape.refusal(values)


def _fault_of_value(key: Key, value: Any, dim: int) -> str | None:
    """The fault of a value of a key, in words that follow its name."""
    from taichi_cloth.kernels.obstacles import contract

    if key.kind == contract.TEXT:
        return None if isinstance(value, str) else f"must be a text, is {toml.describe(value)}"
    if key.kind in (contract.TURN, contract.SPIN):
        shape: tuple[int, ...] = () if dim == 2 else (3,)
        must = "a number of degrees" if dim == 2 else "three numbers"
    elif key.kind == contract.NUMBER:
        shape, must = (), "a number"
    elif key.kind in (contract.POINT, contract.DIRECTION):
        shape, must = (dim,), f"{dim} numbers in a {dim}-D world"
    else:
        count = (len(value),) if isinstance(value, tuple) else (0,)
        shape = (*((key.count,) if key.count else count), 3 if key.kind == contract.FACES else dim)
        must = f"a list of {key.count or ''}{' ' * bool(key.count)}points of {dim} numbers"
        if key.kind == contract.FACES:
            must = "a list of three whole numbers each"
    try:
        numbers = accepted.numbers("", value, finite=False)
    except InputError:
        return f"must be {must}, is {toml.describe(value)}"
    if _has_truth(value) or numbers.shape != shape:
        return f"must be {must}, is {toml.describe(value)}"
    if not np.isfinite(numbers).all():
        return f"must be finite, is {toml.describe(value)}"
    if key.kind == contract.FACES and (numbers != np.floor(numbers)).any():
        return f"must be {must}"
    if np.abs(numbers).max(initial=0.0) > contract.FAR / 1e3:
        return f"must be at most {contract.FAR / 1e3:g} in size; use other units"
    if key.kind == contract.DIRECTION and not numbers.any():
        return "must not be zero"
    for words, limit, holds in (
        ("at least", key.minimum, key.minimum is None or (numbers >= key.minimum).all()),
        ("more than", key.above, key.above is None or (numbers > key.above).all()),
        ("at most", key.maximum, key.maximum is None or (numbers <= key.maximum).all()),
    ):
        if not holds:
            return f"must be {words} {limit:g}, is {toml.describe(value)}"
    return None


def _has_truth(value: Any) -> bool:
    """True if a value, or one of those in a list or a list of lists, is True or False."""
    if isinstance(value, tuple):
        return any(_has_truth(inner) for inner in value)
    return isinstance(value, (bool, np.bool_))
