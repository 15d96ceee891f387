"""Mends Taichi's front end, the part, in Python, that reads each kernel before its cache.

A kernel whose machine code is cached is read and checked by that part all the same, at every start:
with what it inlines, up to some seconds for a solver's. Profiled (Taichi 1.7.4), three quarters of
it are spent on three things, which this module replaces by what leads to the same kernels:

- each expression gets a drawing of its source line, wrapped and underlined, for messages of errors.
  Here it gets the line as it is.
- the source of a function is looked for anew, in its whole file, wherever the function is inlined.
  Here it is kept.
- whether a function stands in a class is read off the source of whoever executes the class. Here
  the class's own frame tells.

And where a real function calls an inlined one, that comes into the kernel instead of the function
(Taichi 1.7.4 ends the process then). Here it comes into what calls it. And what a real function was
made of, with the fields that it was given, is kept no longer than it is read.
"""

from __future__ import annotations

import functools
import inspect
import sys
import textwrap
from types import SimpleNamespace
from typing import Any


def mend() -> None:
    """Mend the Taichi that is imported; once is enough, and more does no harm.

    It should come before kernels are defined.

    A Taichi that is made otherwise is left as it is: it is only slower.
    """
    _quicken()
    _inline_where_called()


def functions_work() -> bool:
    """Whether real functions may call others, as `mend` makes them."""
    from taichi.lang import kernel_impl

    return hasattr(kernel_impl._get_tree_and_ctx, "into_caller")


def _inline_where_called() -> None:
    from taichi.lang import impl, kernel_impl

    read = getattr(kernel_impl, "_get_tree_and_ctx", None)
    if read is None or "ast_builder" not in inspect.signature(read).parameters or functions_work():
        return

    @functools.wraps(read)
    def read_into_caller(*args: Any, ast_builder: Any = None, **named: Any) -> Any:
        if ast_builder is not None:  # of the kernel, which calls the function that is under way
            ast_builder = impl.get_runtime().compiling_callable.ast_builder()
        return read(*args, ast_builder=ast_builder, **named)

    read_into_caller.into_caller = True  # type: ignore[attr-defined]
    kernel_impl._get_tree_and_ctx = read_into_caller
    do_compile = kernel_impl.Func.do_compile

    @functools.wraps(do_compile)
    def compile_and_drop(self: Any, key: Any, *args: Any, **named: Any) -> None:
        do_compile(self, key, *args, **named)
        self.compiled[key.instance_id] = None

    kernel_impl.Func.do_compile = compile_and_drop


def _quicken() -> None:
    from taichi.lang import kernel_impl
    from taichi.lang.ast.ast_transformer_utils import ASTTransformerContext

    reads = "getsourcefile", "getsourcelines", "textwrap", "_inside_class"
    if not all(hasattr(kernel_impl, name) for name in reads):
        return
    if not hasattr(ASTTransformerContext, "get_pos_info") or _is_quick(kernel_impl):
        return
    ASTTransformerContext.get_pos_info = _position
    kernel_impl._inside_class = _inside_class
    kernel_impl.getsourcefile = functools.cache(kernel_impl.getsourcefile)
    kernel_impl.getsourcelines = functools.cache(kernel_impl.getsourcelines)
    kernel_impl.textwrap = SimpleNamespace(
        fill=functools.cache(textwrap.fill), dedent=functools.cache(textwrap.dedent)
    )


def _is_quick(kernel_impl: Any) -> bool:
    return hasattr(kernel_impl.getsourcelines, "cache_info")


def _position(self: Any, node: Any) -> str:
    """Where a node of a function's syntax tree stands: file, line, function, and the line itself.

    self: Taichi's context of that function.
    """
    line = node.lineno + self.lineno_offset
    source = self.src[node.lineno - 1].strip()
    return f'File "{self.file}", line {line}, in {self.func.func.__name__}:\n{source}\n'


def _inside_class(level_of_class_stackframe: int) -> bool:
    """Whether a function is defined in a class, from how many frames up executes that class."""
    return "__qualname__" in sys._getframe(level_of_class_stackframe - 1).f_locals
