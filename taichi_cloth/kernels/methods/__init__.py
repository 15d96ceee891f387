"""Time-integration methods, one file each, which are found by looking into this folder.

A method's file has a docstring with its formula and source, and METHOD = Method(...), whose parts
`contract.Method` explains. It changes positions and velocities by `compensated.add_to_position` and
`add_to_velocity`, which are plain sums except in the precision `compensated`. Adding a method is
adding a file.
"""

import functools
import importlib
import pkgutil

from taichi_cloth.kernels.methods.contract import Method

METHODS = tuple(sorted(m.name for m in pkgutil.iter_modules(__path__) if m.name != "contract"))


@functools.cache
def load(name: str) -> Method:
    """The `Method` called `name`, out of `METHODS`. Importing it imports Taichi.

    Raises TypeError, which names the file, where it declares something unknown or not everything.
    """
    try:
        method = getattr(importlib.import_module(f"{__name__}.{name}"), "METHOD", None)
    except (TypeError, ValueError) as error:
        raise TypeError(f"kernels/methods/{name}.py: {error}") from error
    if not isinstance(method, Method):
        raise TypeError(f"kernels/methods/{name}.py: declares no METHOD = Method(...)")
    return method
