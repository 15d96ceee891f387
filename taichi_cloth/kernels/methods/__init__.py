"""Time-integration methods, one file each, which are found by looking into this folder.

A method's file has a docstring with its formula and source, and METHOD = Method(...), whose parts
`contract.Method` explains. It changes positions and velocities by `compensated.add_to_position` and
`add_to_velocity`, which are plain sums except in the precision `compensated`. Adding a method is
adding a file.
"""

import functools

from taichi_cloth import declarations
from taichi_cloth.kernels.methods.contract import Method

METHODS = declarations.names(__path__)


@functools.cache
def load(name: str) -> Method:
    """The `Method` called `name`, out of `METHODS`. Importing it imports Taichi.

    Raises TypeError, which names the file, where it declares something unknown or not everything.
    """
    return declarations.load(__name__, name, "METHOD", Method)
