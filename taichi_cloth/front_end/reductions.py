"""Sums and largest components of vectors, as Taichi's front end writes them: one expression.

Taichi 1.7.4 keeps what it has of a sum in a variable, which it stores and reads again for each
component: half of the statements of a scalar product, of which a law of contacts has dozens. Here
they are added up in the same order, without.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

from taichi_cloth.front_end.replacements import Replacement

# What is replaced or called here of Taichi's modules.
NEEDED = {"matrix_ops": ("_reduce",), "impl": ("expr_init", "subscript")}


def replacements() -> list[Replacement]:
    """Replacements of parts of the Taichi that is imported, while a kernel is read."""
    from taichi.lang import matrix_ops

    return [(matrix_ops, "_reduce", _reducing(matrix_ops._reduce))]


def _reducing(reduce: Callable[..., Any]) -> Callable[..., Any]:
    """Taichi's function that joins all components by one of two numbers, which does so at once.

    reduce: Taichi's, for matrices, and for Python's own numbers.
    """
    from taichi.lang import impl
    from taichi.lang.expr import Expr

    @functools.wraps(reduce)
    def reduced(vector: Any, join: Callable[[Any, Any], Any]) -> Any:
        if not isinstance(vector, Expr) or len(vector.get_shape()) > 1:
            return reduce(vector, join)
        kept = impl.expr_init(vector)  # a variable, so that it is computed once
        return functools.reduce(join, (impl.subscript(None, kept, k) for k in range(vector.n)))

    return reduced
