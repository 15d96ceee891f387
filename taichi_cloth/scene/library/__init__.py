"""The built-in scenes: one file each, found by looking into this folder.

A scene file defines ``scene(*, name: Annotated[type, Parameter(...)] = default, ...) -> Scene``,
a pure function. Its first docstring line describes it in ``taichi-cloth list``, its parameters
become flags of ``taichi-cloth run``. Where the scene has a closed form, the file may give it as
``solution(scene, times)``, which `trade` compares to.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import typing
from collections.abc import Callable
from typing import Any

import numpy as np

from taichi_cloth.errors import InputError, nearest
from taichi_cloth.scene.checks import validate
from taichi_cloth.scene.model import Scene
from taichi_cloth.settings import accepted
from taichi_cloth.settings.parameters import Parameter


def names() -> list[str]:
    """Names of the built-in scenes, in alphabetical order."""
    found = (module.name for module in pkgutil.iter_modules(__path__))
    return sorted(name for name in found if not name.startswith("_"))


def function(name: str) -> Callable[..., Scene]:
    """The function of the scene called `name`. Raises InputError for an unknown name."""
    if not isinstance(name, str):
        raise InputError(f"a scene's name is a word, not {accepted.shown(name)}")
    if name not in names():
        raise InputError(f"unknown scene '{name}'; {nearest(name, names())}")
    found: Callable[..., Scene] = importlib.import_module(f"{__name__}.{name}").scene
    return found


def solution(name: str) -> Callable[..., tuple[np.ndarray, np.ndarray]] | None:
    """The closed form of the scene called `name`, a function of times; None without one."""
    function(name)
    return getattr(importlib.import_module(f"{__name__}.{name}"), "solution", None)


def description(name: str) -> str:
    """One line on what the scene shows."""
    return (inspect.getdoc(function(name)) or "").partition("\n")[0]


def parameters(name: str) -> dict[str, Parameter]:
    """The scene's declared parameters by name, each with its type and default filled in."""
    # Not `typing.get_type_hints`: of what defaults to None that of Python 3.10 makes an Optional.
    declared = inspect.signature(function(name), eval_str=True).parameters
    return {
        key: p.annotation.__metadata__[0].with_type(_single(p.annotation.__origin__), p.default)
        for key, p in declared.items()
    }


def _single(annotation: Any) -> type:
    """`float` of ``float`` and of ``float | None``: a default None follows from the others."""
    types: list[type] = [t for t in typing.get_args(annotation) if t is not type(None)]
    return types[0] if types else annotation


def build(name: str, **values: Any) -> Scene:
    """The scene called `name` with the given parameters, checked.

    Raises InputError for an unknown name or parameter and for a value outside its limits.
    """
    declared = parameters(name)
    for key, value in values.items():
        if key not in declared:
            raise InputError(
                f"scene '{name}' has no parameter '{key}'; " + nearest(key, declared)
                if declared
                else f"scene '{name}' has no parameters"
            )
        declared[key].check(key, value)
        # None, where it is the default, follows from the others.
        whole = declared[key].type is int and value is not None
        if whole and value not in declared[key].choices:
            values[key] = int(value)  # also of a float or a NumPy scalar that is whole
    return validate(function(name)(**values))
