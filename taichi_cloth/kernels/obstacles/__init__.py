"""Shapes of obstacles, one file each, which are found by looking into this folder.

`contract.Shape` says what a file declares. Adding a shape is adding a file.
"""

import functools

from taichi_cloth import declarations
from taichi_cloth.kernels.obstacles.contract import Shape

SHAPES = declarations.names(__path__)


@functools.cache
def load(name: str) -> Shape:
    """The `Shape` called `name`, out of `SHAPES`. Importing it imports Taichi.

    Raises TypeError, which names the file and the part, where its declaration is not whole.
    """
    return declarations.load(__name__, name, "SHAPE", Shape)
