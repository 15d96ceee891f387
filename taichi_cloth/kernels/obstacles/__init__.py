"""Shapes of obstacles, one file each, which are found by looking into this folder.

`contract.Shape` says what a file declares. Adding a shape is adding a file.
"""

import functools
import importlib
import pkgutil

from taichi_cloth.kernels.obstacles.contract import Shape

SHAPES = tuple(sorted(m.name for m in pkgutil.iter_modules(__path__) if m.name != "contract"))


@functools.cache
def load(name: str) -> Shape:
    """The `Shape` called `name`, out of `SHAPES`. Importing it imports Taichi.

    Raises TypeError, which names the file and the part, where its declaration is not whole.
    """
    try:
        shape = getattr(importlib.import_module(f"{__name__}.{name}"), "SHAPE", None)
    except (TypeError, ValueError) as error:
        raise TypeError(f"kernels/obstacles/{name}.py: {error}") from error
    if not isinstance(shape, Shape):
        raise TypeError(f"kernels/obstacles/{name}.py: declares no SHAPE = Shape(...)")
    return shape
