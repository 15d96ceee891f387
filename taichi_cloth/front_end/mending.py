"""Mends Taichi's front end, the part, in Python, that reads each kernel before its cache.

A kernel whose machine code is cached is read and checked by that part all the same, at every start:
with what it inlines, up to some seconds for a solver's. Profiled (Taichi 1.7.4), most of them are
spent on what this module replaces by what leads to the same kernels:

- each expression gets a drawing of its source line, wrapped and underlined, for messages of errors.
  Here it gets the line as it is.
- the source of a function is looked for anew, in its whole file and token by token, and parsed
  anew, wherever the function is inlined. Here it is looked for by how far its lines are indented,
  and kept, with as many trees of it as are read at once.
- whether a function stands in a class is read off the source of whoever executes the class. Here
  the class's own frame tells; of Taichi's own functions, too, while it is imported.
- what reads a node of a tree is looked up by a name that is made anew, with an object that notes
  where the node stands. Here it is kept for each kind of node, and the place noted by itself.
- NumPy tells the range of integers anew at each constant. Here it is kept.
- each field, and each level of where fields lie, gets a text of the whole stack under which it was
  made, for messages of errors: a third of what making them takes. Here it gets none.

What it makes of conditions and of sums takes the compiler long, which `conditions` and `reductions`
mend. And where a real function calls an inlined one, that comes into the kernel instead of the
function (Taichi 1.7.4 ends the process then). Here it comes into what calls it. And what a real
function was made of, with the fields that it was given, is kept no longer than it is read.

Taichi is mended while one of our kernels is read, functions here are defined, or fields made, and
is itself again right afterwards: other programs in this process find it as it was.
"""

from __future__ import annotations

import ast
import contextlib
import functools
import importlib
import inspect
import linecache
import os
import sys
import textwrap
import threading
import traceback
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from importlib.machinery import SOURCE_SUFFIXES, FileFinder, SourceFileLoader
from types import CodeType, FrameType, ModuleType
from typing import Any

from taichi_cloth import imports
from taichi_cloth.front_end import conditions, reductions
from taichi_cloth.front_end.replacements import Replacement, Replacements

# What is replaced or called of Taichi's modules: a Taichi that lacks any of it is left alone.
HERE = {
    "kernel_impl": (
        *("_get_tree_and_ctx", "_get_global_vars", "transform_tree", "_inside_class"),
        *("getsourcefile", "getsourcelines", "Func"),
    ),
    "expr": ("_check_in_range", "_clamp_unsigned_to_range"),
    "impl": ("get_traceback",),
    "snode": ("get_traceback",),
    "ast.ast_transformer_utils": ("Builder", "ASTTransformerContext", "handle_exception_from_cpp"),
}
NEEDED = HERE, conditions.NEEDED, reductions.NEEDED
# What keeps Taichi silent where it is imported and started.
SILENT = {"ENABLE_TAICHI_HEADER_PRINT": "0", "TI_SKIP_VERSION_CHECK": "ON"}
# Nodes of syntax trees that Taichi writes nothing on: there is one of each kind for all trees.
SHARED = ast.expr_context, ast.boolop, ast.operator, ast.unaryop, ast.cmpop

_importing = threading.RLock()
_found: list[Any] = []  # Taichi, once `imported` has it
_more: list[Callable[[], Iterable[Replacement]]] = []  # of `replace_too`


def imported() -> Any:
    """Taichi; the first call imports it, and others that come meanwhile wait.

    It says nothing then: it would print a banner.
    """
    with _importing:
        if not _found:
            with told_nothing(), _no_server_asked(), _classes_told_by_frames():
                _found.append(imports.module("taichi"))
        return _found[0]


@contextlib.contextmanager
def told_nothing() -> Iterator[None]:
    """While it lasts, Taichi prints no banner, and asks no server for its newest version.

    Unless the environment says otherwise, which is afterwards as it was.
    """
    lacking = {name: value for name, value in SILENT.items() if name not in os.environ}
    os.environ.update(lacking)
    try:
        yield
    finally:
        for name in lacking:
            os.environ.pop(name, None)


def _no_server_asked() -> contextlib.AbstractContextManager[None]:
    """While it lasts, Taichi does not get what it asks servers with, unless it is to ask."""
    if os.environ["TI_SKIP_VERSION_CHECK"] == "ON":
        return imports.put_off("urllib.request")
    return contextlib.nullcontext()


# --- while one of our kernels is read -------------------------------------------------------------


def kernel(function: Callable[..., Any]) -> Any:
    """Taichi's decorator `ti.kernel`, for kernels here: while one is read, Taichi is mended."""
    made = imported().kernel(function)
    made._primal.__class__ = _kernel_class()
    return made


@functools.cache
def _kernel_class() -> type:
    from taichi.lang.kernel_impl import Kernel

    class MendedKernel(Kernel):  # type: ignore[misc]
        """A kernel that Taichi reads mended. To launch it costs what it did."""

        def materialize(self, key: Any = None, args: Any = None, arg_features: Any = None) -> None:
            self.runtime.materialize()
            if key is None or key not in self.compiled_kernels:
                with _reading, _notes():
                    super().materialize(key, args, arg_features)

    return MendedKernel


def replace_too(make: Callable[[], Iterable[Replacement]]) -> None:
    """Replace more while kernels are read: what `make` returns. To be called before any is."""
    _more.append(make)


def _replacements() -> Iterator[Replacement]:
    """All that is replaced while a kernel is read.

    Of a Taichi that is made otherwise, only what kernels here cannot do without: the rest is speed.
    """
    for make in _more:
        yield from make()
    if not _is_as_known():
        return
    from taichi.lang import expr, impl, kernel_impl
    from taichi.lang.ast.ast_transformer_utils import ASTTransformerContext, Builder

    yield from conditions.replacements()
    yield from reductions.replacements()
    yield from _defining_replacements()
    yield kernel_impl, "_get_tree_and_ctx", _tree_and_context
    yield kernel_impl, "transform_tree", _giving_back(kernel_impl.transform_tree)
    yield kernel_impl.Func, "do_compile", _dropping(kernel_impl.Func.do_compile)
    yield ASTTransformerContext, "get_pos_info", _place
    yield Builder, "__call__", _visiting(impl.get_runtime)
    yield expr, "_check_in_range", _is_in_range
    yield expr, "_clamp_unsigned_to_range", _wrapped_into_range


_reading = Replacements(_replacements)
_kept: list[dict[str, Any]] = []  # notes of the kernels that are being read, the innermost last


@contextlib.contextmanager
def _notes() -> Iterator[None]:
    _kept.append({})
    try:
        yield
    finally:
        _kept.pop()


def notes() -> dict[str, Any]:
    """The memory of the kernel that is being read, as long as it is; else nothing is kept."""
    return _kept[-1] if _kept else {}


def functions_work() -> bool:
    """True if real functions may call others: Taichi is mended, as it is the one that is known."""
    return _is_as_known()


@functools.cache
def _is_as_known() -> bool:
    """True if Taichi has all that is replaced or called here, and reads functions as is known."""
    imported()
    for of, names in (one for needed in NEEDED for one in needed.items()):
        module = importlib.import_module(f"taichi.lang.{of}")
        if not all(hasattr(module, name) for name in names):
            return False
    kernel_impl = importlib.import_module("taichi.lang.kernel_impl")
    theirs = inspect.signature(kernel_impl._get_tree_and_ctx)
    return list(theirs.parameters) == list(inspect.signature(_tree_and_context).parameters)


# --- while functions are defined, and fields are made ---------------------------------------------


def _defining_replacements() -> Iterator[Replacement]:
    from taichi.lang import kernel_impl

    if _is_as_known():
        yield kernel_impl, "_inside_class", _inside_class


def _stackless_replacements() -> Iterator[Replacement]:
    from taichi.lang import impl, snode

    if _is_as_known():
        yield impl, "get_traceback", _no_stack
        yield snode, "get_traceback", _no_stack


_defining = Replacements(_defining_replacements)
# While it lasts, fields are made without a text of the stack.
fields_without_stacks = Replacements(_stackless_replacements)


class _Loader(SourceFileLoader):
    """Loads a module of device code; Taichi hears by frames where its functions are defined."""

    def exec_module(self, module: ModuleType) -> None:
        with _defining:
            super().exec_module(module)


def load_quickly(folder: str) -> None:
    """Have Python load the modules in a folder by `_Loader`."""
    sys.path_importer_cache[folder] = FileFinder(folder, (_Loader, SOURCE_SUFFIXES))


# --- sources and their trees ----------------------------------------------------------------------


@dataclass
class _Source:
    """The source of a function, and those trees of it that nobody reads at the moment.

    lines: as they stand in `file`, from line number `start` on. places: by line of the function,
    what messages of errors say of it. nodes: by tree, the attributes of those that Taichi writes
    its results on.
    """

    file: str
    lines: list[str]
    start: int
    places: dict[int, str] = field(default_factory=dict)
    trees: list[ast.Module] = field(default_factory=list)
    nodes: dict[ast.Module, list[dict[str, Any]]] = field(default_factory=dict)

    def parsed(self) -> ast.Module:
        """A new tree."""
        tree = ast.parse(textwrap.dedent("\n".join(self.lines)))
        tree.body[0].decorator_list = []  # type: ignore[attr-defined]
        return tree

    def take(self) -> ast.Module:
        """A tree that is the caller's until it is given back."""
        tree = self.trees.pop() if self.trees else self.parsed()
        if tree not in self.nodes:
            self.nodes[tree] = _attributes_in(tree)
        return tree

    def take_for_good(self) -> ast.Module:
        """A tree that is the caller's, who may change it."""
        tree = self.trees.pop() if self.trees else self.parsed()
        self.nodes.pop(tree, None)
        return tree

    def give_back(self, tree: ast.Module) -> None:
        """Have a tree for others, without what was written on it, if it is one of `take`."""
        if tree in self.nodes:
            for attributes in self.nodes[tree]:
                attributes.pop("ptr", None)
                attributes.pop("caller", None)
            self.trees.append(tree)


def _attributes_in(tree: ast.Module) -> list[dict[str, Any]]:
    """Those of each node of a tree, but for `SHARED` ones: `ast.walk` takes twice as long."""
    nodes: list[ast.AST] = [tree]
    for node in nodes:  # which come meanwhile
        for value in vars(node).values():
            for one in value if isinstance(value, list) else (value,):
                if isinstance(one, ast.AST) and not isinstance(one, SHARED):
                    nodes.append(one)
    return [vars(node) for node in nodes]


@functools.cache
def _source_of(code: CodeType) -> _Source:
    """The source of the functions that have this code: of those of a closure it is kept once."""
    from taichi.lang import kernel_impl

    file, start = code.co_filename, code.co_firstlineno
    linecache.checkcache(file)
    with contextlib.suppress(IndexError, SyntaxError):  # then it is found as Taichi does
        return _source(file, _function_in(linecache.getlines(file), code), start)
    lines, start = kernel_impl.getsourcelines(code)
    return _source(kernel_impl.getsourcefile(code), lines, start)


def _source(file: str, lines: list[str], start: int) -> _Source:
    """The source of a function with its first tree, of lines as Taichi takes them.

    Raises SyntaxError where these are not a function.
    """
    source = _Source(file, [line.expandtabs(4).rstrip() for line in lines], start)
    source.trees.append(source.parsed())
    return source


def _function_in(lines: list[str], code: CodeType) -> list[str]:
    """Those lines of a file that define the function with this code, decorators among them.

    Up to where a line after its last statement is indented no deeper than they are: Python's own
    `inspect` takes each function of the file apart into tokens for it. What this does not find are
    sources that are in no file (IndexError), functions without a statement, and text at the end of
    one that is indented less than it: what is returned then is no function.
    """
    first, end = code.co_firstlineno - 1, max(line or 0 for _, _, line in code.co_lines())
    depth = _depth(lines[first])
    while end < len(lines) and (_depth(lines[end]) > depth or _says_nothing(lines[end])):
        end += 1
    while _says_nothing(lines[end - 1]):
        end -= 1
    return lines[first:end]


def _depth(line: str) -> int:
    """The indentation of a line."""
    return len(line) - len(line.lstrip())


def _says_nothing(line: str) -> bool:
    """True if a line is empty, or a comment."""
    return line.lstrip()[:1] in ("", "#")


def _tree_and_context(
    self: Any,
    excluded_parameters: Any = (),
    is_kernel: bool = True,
    arg_features: Any = None,
    args: Any = None,
    ast_builder: Any = None,
    is_real_function: bool = False,
) -> tuple[ast.Module, Any]:
    """The tree of a kernel or function, and the context in which Taichi is to read it.

    self: Taichi's object of it; the other parameters are those of Taichi's context.
    """
    from taichi.lang import impl, kernel_impl
    from taichi.lang.ast.ast_transformer_utils import ASTTransformerContext

    source, names = _source_of(self.func.__code__), kernel_impl._get_global_vars(self.func)
    if is_kernel or is_real_function:  # their trees are changed, and read once
        tree = source.take_for_good()
        for at in self.template_slot_locations:
            names[self.arguments[at].name] = args[at]
    else:
        tree = source.take()
    if ast_builder is not None:  # of the kernel, which calls the function that is under way
        ast_builder = impl.get_runtime().compiling_callable.ast_builder()
    context = ASTTransformerContext(
        excluded_parameters=excluded_parameters,
        is_kernel=is_kernel,
        func=self,
        arg_features=arg_features,
        global_vars=names,
        argument_data=args,
        src=source.lines,
        start_lineno=source.start,
        file=source.file,
        ast_builder=ast_builder,
        is_real_function=is_real_function,
    )
    context.source = source
    return tree, context


def _giving_back(transform: Callable[..., Any]) -> Callable[..., Any]:
    """Taichi's function that reads a tree, which gives it back afterwards."""

    @functools.wraps(transform)
    def transform_and_give_back(tree: ast.Module, ctx: Any) -> Any:
        try:
            return transform(tree, ctx)
        finally:
            ctx.source.give_back(tree)

    return transform_and_give_back


def _dropping(do_compile: Callable[..., None]) -> Callable[..., None]:
    """Taichi's method that compiles a real function, which drops what it was made of afterwards."""

    @functools.wraps(do_compile)
    def compile_and_drop(self: Any, key: Any, *args: Any, **named: Any) -> None:
        do_compile(self, key, *args, **named)
        self.compiled[key.instance_id] = None

    return compile_and_drop


def _inside_class(level_of_class_stackframe: int) -> bool:
    """True if a function is defined in a class, from how many frames up executes that class."""
    return _is_class(sys._getframe(level_of_class_stackframe - 1))


def _is_class(frame: FrameType) -> bool:
    """True if a frame executes the body of a class."""
    return "__qualname__" in frame.f_locals


@contextlib.contextmanager
def _classes_told_by_frames() -> Iterator[None]:
    """While it lasts, Taichi hears by `_inside_class` where its own functions are defined.

    Its modules define them before anything of them can be replaced; but how they read the source
    can be.
    """
    read = inspect.getframeinfo

    def told(frame: Any, context: int = 1) -> inspect.Traceback:
        inner: FrameType | None = sys._getframe(1)
        if inner is None or inner.f_code.co_name != "_inside_class":
            return read(frame, context)
        while inner and inner.f_back is not frame:  # at last it is what `frame` executes
            inner = inner.f_back
        source = ["class Its:" if inner and _is_class(inner) else "some_call()"]
        return inspect.Traceback(frame.f_code.co_filename, frame.f_lineno, "", source, 0)

    inspect.getframeinfo = told
    try:
        yield
    finally:
        inspect.getframeinfo = read


def _no_stack(stacklevel: int = 1) -> str:
    """Of where a field was made: nothing."""
    return ""


# --- nodes of trees -------------------------------------------------------------------------------


def _visiting(runtime_of: Callable[[], Any]) -> Callable[..., Any]:
    """A reader of nodes, as Taichi's `Builder` is, which notes for as long where each stands.

    runtime_of: Taichi's function that gives its runtime; it is called for each node.
    """

    def visit(self: Any, ctx: Any, node: ast.AST) -> Any:
        kinds: Any = (type(self), type(node))
        build, has_place = _builder_of(*kinds)
        runtime = runtime_of()
        runtime.src_info_stack.append(ctx.get_pos_info(node) if has_place else "")
        try:
            return build(ctx, node)
        except Exception as error:
            if runtime.print_full_traceback:
                raise
            if ctx.raised or not has_place:
                raise error.with_traceback(None) from None
            ctx.raised = True
            raise _placed(error, ctx.get_pos_info(node)) from None
        finally:
            runtime.src_info_stack.pop()

    return visit


@functools.cache
def _builder_of(builder: type, kind: type[ast.AST]) -> tuple[Callable[..., Any], bool]:
    """The method of a builder for nodes of a kind, and whether these stand in the source."""
    build = getattr(builder, "build_" + kind.__name__, _refuse)
    return build, issubclass(kind, (ast.stmt, ast.expr))


def _refuse(ctx: Any, node: ast.AST) -> None:
    from taichi.lang.exception import TaichiSyntaxError

    raise TaichiSyntaxError(f'Unsupported node "{node.__class__.__name__}"')


def _placed(error: Exception, place: str) -> Exception:
    """The error that Taichi raises for one that came up at a place."""
    from taichi.lang.ast.ast_transformer_utils import handle_exception_from_cpp
    from taichi.lang.exception import TaichiCompilationError

    found: Exception = handle_exception_from_cpp(error)
    is_known = isinstance(found, TaichiCompilationError)
    kind = type(found) if is_known else TaichiCompilationError
    placed: Exception = kind(place + (str(found) if is_known else traceback.format_exc()))
    return placed


def _place(self: Any, node: Any) -> str:
    """The place of a node of a function's syntax tree: file, line, function, and the line itself.

    self: Taichi's context of that function.
    """
    places: dict[int, str] = self.source.places
    line = node.lineno
    if line not in places:
        at, source = line + self.lineno_offset, self.src[line - 1].strip()
        places[line] = f'File "{self.file}", line {at}, in {self.func.func.__name__}:\n{source}\n'
    return places[line]


# --- constants ------------------------------------------------------------------------------------


@functools.cache
def _range_of(kind: Any) -> tuple[int, int]:
    """The least and the largest integer of a kind of NumPy's."""
    import numpy as np

    return int(np.iinfo(kind).min), int(np.iinfo(kind).max)


def _is_in_range(kind: Any, value: int) -> bool:
    """True if a kind of integers of NumPy's has a value."""
    least, most = _range_of(kind)
    return bool(least <= value <= most)


def _wrapped_into_range(kind: Any, value: int) -> int:
    """The signed integer of a kind that has the same bits as an unsigned one."""
    least, most = _range_of(kind)
    if least <= value <= most:
        return value
    return value - (most - least + 1)
