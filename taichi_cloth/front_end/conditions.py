"""Conditions, as Taichi's front end writes them for its compiler: without branches on what is true.

Read as Taichi 1.7.4 does it, `a < b` is the statement `if true: a < b` on a variable, as a chain of
comparisons is joined to a true one; and a condition on which numbers are selected is negated twice.
In a kernel that searches for contacts these were a sixth of the statements, and compiling takes a
time with their square. Here a chain begins with its first comparison, and of negations in pairs
nothing is left. Values are the same.

`and` and `or` stay branches, which keep what is right of them from being read; where both are at
hand, `&` and `|` say so: on GPUs of the numbers 0 and 1, since shaders have these operators of
whole numbers alone (Taichi writes them of conditions all the same: OpenGL's compilers refuse it,
and Vulkan leaves open what comes of it).

And an `if` with an `else` gets a condition of its own: two of which Taichi knows that they ask the
same, and that follow each other, it joins, and where one of them has no `else` it forgets whose the
other's is (`simplify.cpp`), and ends with an error.
"""

from __future__ import annotations

import ast
import functools
from collections.abc import Callable
from typing import Any

from taichi_cloth.front_end.replacements import Replacement

# What is replaced or called here of Taichi's modules.
NEEDED = {
    "ops": ("logical_and", "logical_not", "cast", "bit_and", "bit_or"),
    "impl": ("begin_frontend_if", "expr_init"),
    "ast.ast_transformer": ("ASTTransformer",),
}


def replacements() -> list[Replacement]:
    """Replacements of parts of the Taichi that is imported, while a kernel is read."""
    from taichi.lang import impl, ops
    from taichi.lang.ast.ast_transformer import ASTTransformer

    has_else: list[bool] = []  # of each `if` that is being read, the innermost last
    # A loop begins with: if it goes on, else break.
    readers = {
        name: staticmethod(_noting(getattr(ASTTransformer, name), has_else))
        for name in ("build_If", "build_While")
    }
    return [
        (ops, "logical_and", _beginning(ops.logical_and)),
        (ops, "logical_not", _in_pairs(ops.logical_not)),
        (ops, "cast", _casting(ops.cast)),
        (ops, "bit_and", _by_numbers(ops.bit_and)),
        (ops, "bit_or", _by_numbers(ops.bit_or)),
        *((ASTTransformer, name, reader) for name, reader in readers.items()),
        (impl, "begin_frontend_if", _branching(impl.begin_frontend_if, has_else)),
    ]


def _is_condition(value: Any) -> bool:
    """True if a value of the front end is one condition, which is true or false."""
    from taichi.lang.expr import Expr
    from taichi.types.primitive_types import u1

    return isinstance(value, Expr) and bool(value.ptr.get_rvalue_type() == u1)


def _beginning(logical_and: Callable[..., Any]) -> Callable[..., Any]:
    """Taichi's `and` of two, which begins a chain: true and what is not known yet is the latter."""

    @functools.wraps(logical_and)
    def joined(a: Any, b: Any) -> Any:
        return b if a is True and _is_condition(b) else logical_and(a, b)

    return joined


def _in_pairs(logical_not: Callable[..., Any]) -> Callable[..., Any]:
    """Taichi's negation, which gives of a condition that it negated the condition."""

    @functools.wraps(logical_not)
    def negated(a: Any) -> Any:
        if hasattr(a, "negates"):
            return a.negates
        b = logical_not(a)
        if _is_condition(a):
            b.negates = a
        return b

    return negated


def _casting(cast: Callable[..., Any]) -> Callable[..., Any]:
    """Taichi's cast, which leaves conditions that are to be conditions."""

    @functools.wraps(cast)
    def given(obj: Any, dtype: Any) -> Any:  # named as Taichi names them: some are given by name
        from taichi.types.primitive_types import u1

        return obj if dtype is u1 and _is_condition(obj) else cast(obj, dtype)

    return given


def _by_numbers(bitwise: Callable[..., Any]) -> Callable[..., Any]:
    """Taichi's `&` or `|`, which in shaders takes conditions for numbers."""

    @functools.wraps(bitwise)
    def joined(a: Any, b: Any) -> Any:
        import taichi as ti

        if ti.cfg.arch == ti.cpu or not (_is_condition(a) and _is_condition(b)):
            return bitwise(a, b)
        return bitwise(ti.cast(a, ti.i32), ti.cast(b, ti.i32)) != 0

    return joined


def _noting(build_if: Callable[..., Any], has_else: list[bool]) -> Callable[..., Any]:
    """A reader of an `if` or a `while`, which notes for as long whether that has an `else`."""

    def build(ctx: Any, node: ast.If | ast.While) -> Any:
        has_else.append(isinstance(node, ast.While) or bool(node.orelse))
        try:
            return build_if(ctx, node)
        finally:
            has_else.pop()

    return build


def _branching(begin_if: Callable[..., None], has_else: list[bool]) -> Callable[..., None]:
    """The begin of a branch: one with an `else` on a variable that Taichi sees set twice.

    Of such a variable it does not ask what it is set to.
    """
    from taichi.lang import impl

    def begin(builder: Any, condition: Any, place: Any) -> None:
        if has_else[-1] and _is_condition(condition):
            own = impl.expr_init(condition)
            own._assign(own)
            condition = own
        begin_if(builder, condition, place)

    return begin
