"""Taichi's front end while `mending` mends it: it reads the same kernels, and says the same."""

import ast
import functools
import gc
import importlib
import inspect
import itertools
import linecache
import os
import pkgutil
import subprocess
import sys
import textwrap
import threading
import weakref
from pathlib import Path

import numpy as np
import pytest
import taichi as ti
from selection import as_thorough
from taichi.lang import kernel_impl
from taichi.lang.kernel_impl import Kernel

import taichi_cloth.kernels
from taichi_cloth import runtime
from taichi_cloth.front_end import mending
from taichi_cloth.front_end.mending import kernel
from taichi_cloth.front_end.replacements import Replacements
from taichi_cloth.kernels import vectors


@pytest.fixture(autouse=True)
def started(device):
    assert mending.functions_work(), "the replacements are not there"


def test_functions_of_classes_and_of_functions_are_told_apart():
    with mending._defining:

        @ti.data_oriented
        class Counter:
            @ti.func
            def more(self, i):
                return 2 * i + 1

            @ti.kernel
            def count(self, i: ti.i32) -> ti.i32:
                return self.more(i)

        @ti.kernel
        def count(i: ti.i32) -> ti.i32:
            return 3 * i

    assert Counter().count(4) == 9 and count(4) == 12


def tree_as_taichi_reads_it(function):
    """The syntax tree that Taichi alone would make of a function, with all places in it."""
    lines, start = kernel_impl.getsourcelines(function)
    wide = [textwrap.fill(line, tabsize=4, width=9999) for line in lines]
    tree = ast.parse(textwrap.dedent("\n".join(wide)))
    tree.body[0].decorator_list = []
    return ast.dump(tree, include_attributes=True), start


def tree_as_found(function):
    """The syntax tree that is made of a function where its source is found by indentation."""
    code = function.__code__
    lines = mending._function_in(linecache.getlines(code.co_filename), code)
    source = mending._source(code.co_filename, lines, code.co_firstlineno)
    return ast.dump(source.take_for_good(), include_attributes=True), source.start


def test_the_source_of_all_device_code_is_found():
    """Of each function and kernel here and of Taichi's own: what Python's `inspect` finds."""
    for module in pkgutil.walk_packages(taichi_cloth.kernels.__path__, "taichi_cloth.kernels."):
        importlib.import_module(module.name)
    read = [one.func for one in gc.get_objects() if isinstance(one, kernel_impl.Func | Kernel)]
    of = {one.__code__: one for one in read if one.__module__.startswith("taichi")}
    # Those that only say something have no statement to begin at.
    of = {code: one for code, one in of.items() if statements(code)}
    assert len(of) > 700
    for function in of.values():
        assert tree_as_found(function) == tree_as_taichi_reads_it(function), function.__qualname__


def statements(code):
    """How many lines of a function's body are compiled."""
    return len({line for _, _, line in code.co_lines() if line} - {code.co_firstlineno})


SHAPES = '''
def first(
    a,
    b=(1, 2),
):
    text = """a line
that is not indented, and
# no comment
"""
# a comment that is not indented
    return (
a, b, text)
def second(a): return a
@functools.lru_cache(
    maxsize=1
)
def third(a):
    if a:

        def inner():
            return (
                a
            )

    # its last comment
class Holder:
    @staticmethod
    def fourth():
        return 1
# not its own
    more = 2
def last():
    return """to the end
of the file
"""
'''


def test_the_source_of_a_function_of_any_shape_is_found(tmp_path):
    (tmp_path / "shapes.py").write_text(SHAPES)
    names = {"functools": functools}
    exec(compile(SHAPES, str(tmp_path / "shapes.py"), "exec"), names)
    at_top = names["first"], names["second"], names["third"].__wrapped__
    for function in (*at_top, names["Holder"].fourth):
        assert tree_as_found(function) == tree_as_taichi_reads_it(function), function
    # What is not found so is found as Taichi does.
    last = names["last"]
    with pytest.raises(SyntaxError):
        tree_as_found(last)
    source = mending._source_of(last.__code__)
    tree = ast.dump(source.parsed(), include_attributes=True)
    assert (tree, source.start) == tree_as_taichi_reads_it(last)


def test_importing_taichi_leaves_python_as_it_was(tmp_path):
    """It says nothing, and brings nothing in to ask a server with; in any number of threads."""
    program = """
import gc, inspect, sys, threading
sys.setswitchinterval(1e-6)
before = inspect.getframeinfo
from taichi_cloth.front_end import mending
found = []
many = [threading.Thread(target=lambda: found.append(mending.imported())) for _ in range(4)]
for one in many: one.start()
for one in many: one.join()
assert len(found) == 4 and len(set(map(id, found))) == 1 and mending.functions_work()
assert inspect.getframeinfo is before and gc.isenabled()
assert "ssl" not in sys.modules and "urllib.request" not in sys.modules
from urllib.request import Request
assert Request("file:///").type == "file"
"""
    words = [sys.executable, "-c", program]
    done = subprocess.run(words, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_taichi_is_told_which_of_its_functions_are_in_classes():
    def _inside_class(level):  # as Taichi's own
        return inspect.getframeinfo(sys._getframe(level))[3][0].strip().startswith("class ")

    def ask(function):
        return _inside_class(3)

    def answers():
        class Holder:
            @ask
            def of_a_class(self): ...

        @ask
        def alone(): ...

        return Holder.of_a_class, alone

    assert answers() == (True, False)
    with mending._classes_told_by_frames():
        assert answers() == (True, False)
        frame = inspect.getframeinfo(sys._getframe())  # nobody else hears anything new
        assert "getframeinfo" in frame.code_context[0]


def test_functions_of_one_name_keep_their_own_source():
    kernels = []
    for _ in range(2):

        @ti.func
        def law(x):
            return x + 1

        if kernels:

            @ti.func
            def law(x):  # noqa: F811
                return x * 10

        @kernel
        def apply(x: ti.i32, law: ti.template()) -> ti.i32:
            return law(x)

        kernels.append(apply(5, law))
    assert kernels == [6, 50]


def test_an_error_in_a_kernel_names_its_line():
    @kernel
    def wrong(n: ti.i32):
        for _i in range(n):
            _x = nobody_defined_this + 1  # noqa: F821

    with pytest.raises(ti.TaichiCompilationError) as error:
        wrong(3)
    first, source = str(error.value).strip().splitlines()[:2]
    assert "test_front_end.py" in first and first.endswith("in wrong:")
    assert source.startswith("_x = nobody_defined_this + 1")


def test_an_error_in_what_is_inlined_leaves_others_a_whole_tree():
    """It names the innermost line, and the next kernel that inlines the function is right."""

    @ti.func
    def at(x: ti.template(), i):
        return x[i, i] + 1

    @kernel
    def read(x: ti.template()) -> ti.i32:
        return at(x, 1)

    row, square = ti.field(ti.i32, 2), ti.field(ti.i32, (2, 2))
    for _ in range(2):
        with pytest.raises(ti.TaichiCompilationError) as error:
            read(row)
        assert "in at:\nreturn x[i, i] + 1" in str(error.value)
        assert read(square) == 1


def test_a_function_that_comes_into_itself_has_a_tree_for_each():
    @ti.func
    def apply(depth: ti.template(), x):
        y = 2 * x
        if ti.static(depth > 0):
            y += apply(depth - 1, y) * apply(depth - 1, x)
        return y + x  # its own, whatever was read in between

    @kernel
    def run(x: ti.i32) -> ti.i32:
        return apply(2, x)

    def expected(depth, x):
        y = 2 * x
        return y + x + (expected(depth - 1, y) * expected(depth - 1, x) if depth else 0)

    assert run(3) == expected(2, 3)


def test_what_functions_were_given_is_not_kept_with_their_trees():
    @ti.func
    def first(of: ti.template()):
        return of.x[0]

    def used():
        class Container:
            def __init__(self):
                self.x = ti.field(ti.f32, 4)

        container = Container()

        @kernel
        def run() -> ti.f32:
            return first(container)

        run()
        return weakref.ref(container)

    kernels = ti.lang.impl.get_runtime().kernels
    before = len(kernels)
    left = used()
    del kernels[before:]  # Taichi keeps all of them, with what they close over
    gc.collect()
    assert left() is None


@pytest.mark.parametrize("words", [[], as_thorough(["--thread"])], ids=["one", "many"])
def test_other_programs_on_taichi_notice_nothing(words, tmp_path):
    """Gradients, templates, structs, sparse trees, errors, settings, and each part of Taichi."""
    program = Path(__file__).with_name("foreign.py")
    environment = os.environ | {"TI_SKIP_VERSION_CHECK": "ON"}
    environment.pop("ENABLE_TAICHI_HEADER_PRINT", None)
    done = subprocess.run(
        [sys.executable, program, *words],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=environment,
    )
    assert (done.returncode, done.stdout.splitlines()[-1:]) == (0, ["nothing differs"]), done


class Part:
    """Something whose parts can be replaced."""

    number = 1

    @staticmethod
    def of(x):
        return x


def test_parts_are_put_back_once_nobody_needs_them_replaced():
    """By whom they were last needed, be it in another thread, and whatever happened meanwhile."""
    own = dict(vars(Part))
    made = []
    replaced = Replacements(
        lambda: made.append(1) or [(Part, "number", 2), (Part, "of", staticmethod(str))]
    )
    entered, leave = threading.Event(), threading.Event()

    def needs():
        with replaced:
            entered.set()
            leave.wait()

    another = threading.Thread(target=needs)
    with pytest.raises(ZeroDivisionError), replaced:
        another.start()
        entered.wait()
        with replaced:
            assert (Part.number, Part.of(3)) == (2, "3")
        _ = 1 // 0
    assert (Part.number, Part.of(3)) == (2, "3")
    leave.set()
    another.join()
    assert dict(vars(Part)) == own and made == [1]


def test_a_taichi_that_is_made_otherwise_is_left_alone(monkeypatch):
    """All that is replaced is what kernels of packs cannot do without."""

    def plain(self, is_kernel, something_new):
        """As of another Taichi."""

    def replaced():
        mending._is_as_known.cache_clear()
        return {(of.__name__, name) for of, name, _ in mending._replacements()}

    needed = {(of.__name__, name) for of, name, _ in vectors._replacements()}
    try:
        assert replaced() > needed
        monkeypatch.setattr(kernel_impl, "_get_tree_and_ctx", plain)
        assert replaced() == needed and not mending.functions_work()
        monkeypatch.undo()
        monkeypatch.delattr(kernel_impl, "_inside_class")
        assert replaced() == needed and not mending.functions_work()
    finally:
        monkeypatch.undo()
        assert replaced() > needed


def test_functions_inline_what_they_call():
    """Taichi alone inlines it into the kernel, where no such variable is, and the process ends."""

    @ti.func
    def fall(x, n: ti.template()):
        for k in range(x):
            n[None] += k * x  # x: the function's own

    @ti.real_func
    def twice(x: ti.i32, n: ti.template()) -> ti.i32:
        fall(x + 1, n)
        fall(x, n)
        return n[None]

    total = ti.field(ti.i32, ())

    @kernel
    def run(x: ti.i32) -> ti.i32:
        return 10 * twice(x, total)

    assert mending.functions_work()
    assert run(3) == 10 * (4 * 6 + 3 * 3)


def test_what_is_compiled_soon_reads_what_was_stored():
    """Taichi without its search alone keeps two copies of a place that two expressions read."""
    stored, seen = ti.field(ti.f32, 8), ti.field(ti.f32, 8)

    @kernel
    def count(times: ti.i32):
        for i in range(8):
            for _ in range(times):
                stored[i] = stored[i] + 1.0
                seen[i] = stored[i]

    config = ti.lang.impl.get_runtime().prog.config()
    before = config.opt_level, config.cache_loop_invariant_global_vars
    with runtime.compiled_soon():
        count(3)
    assert (config.opt_level, config.cache_loop_invariant_global_vars) == before == (1, True)
    assert seen.to_numpy().tolist() == stored.to_numpy().tolist() == [3.0] * 8


def test_conditions_have_the_values_that_they_have_in_python():
    def conditions(a, b, c, x):
        return [
            a < b,
            a < b < c,
            a <= b and b != c or a == c,
            not a > b,
            not a >= c or b and c,  # numbers are conditions, too
            (a and 4) and (b and 2),  # which have no bit in common
            x > 0.5 and a < c,
            a == b or x < 0.5 and not b < c,
        ]

    @kernel
    def count(a: ti.i32, b: ti.i32, c: ti.i32, x: ti.f32) -> ti.i32:
        found = 0
        if a < b:
            found += 1
        if a < b < c:
            found += 2
        if a <= b and b != c or a == c:
            found += 4
        found += 8 * ti.select(not a > b, 1, 0)
        if not a >= c or b and c:
            found += 16
        if (a and 4) and (b and 2):
            found += 32
        found += 64 * ti.select(x > 0.5 and a < c, 1, 0)
        found += 128 if a == b or x < 0.5 and not b < c else 0
        return found

    for a, b, c, x in itertools.product((0, 1, 2), (0, 1, 3), (0, 2), (0.0, 1.0)):
        expected = sum(2**k for k, true in enumerate(conditions(a, b, c, x)) if true)
        assert count(a, b, c, x) == expected, (a, b, c, x)


def test_what_is_not_needed_is_neither_read_nor_divided_by():
    """By zero a processor divides no whole numbers: the process would end."""
    numbers = ti.field(ti.i32, 4)

    @kernel
    def divide(a: ti.i32, b: ti.i32) -> ti.i32:
        return ti.select(b != 0 and a // b == 2, 1, 0) + ti.select(b == 0 or a % b == 1, 10, 0)

    @kernel
    def read(i: ti.i32) -> ti.i32:
        found = 0
        if 0 <= i < 4 and numbers[i] == 0:
            found = 1
        return found

    assert [divide(7, b) for b in (0, 3, 4)] == [10, 11, 0]
    assert [read(i) for i in (0, 3, 2**30)] == [1, 1, 0]


def test_what_components_come_to_is_what_it_was():
    """Added up from the first component on, as before: floating-point numbers would tell."""

    @kernel
    def of_vector(a: ti.types.vector(4, ti.f32)) -> ti.types.vector(5, ti.f32):
        b = ti.Vector([2.0, 0.5, 1.0, 4.0], ti.f32)
        return ti.Vector([a.dot(b), a.sum(), a.max(), (a * b).min(), a.norm_sqr()])

    @kernel
    def of_matrix(a: ti.types.matrix(2, 2, ti.i32)) -> ti.types.vector(3, ti.i32):
        return ti.Vector([a.sum(), a.max(), ti.select((a > 0).all(), 1, 0)])

    large = np.float32(2**24)
    a, b = np.array([large, 1.0, 1.0, -large], np.float32), np.array([2.0, 0.5, 1.0, 4.0])
    products = (a * b).astype(np.float32)
    total = functools.reduce(np.add, a)
    assert total == 0.0  # 2**24 + 1 is 2**24
    expected = [functools.reduce(np.add, products), total, large, products.min()]
    found = of_vector(a)
    assert list(found)[:4] == expected and found[4] == functools.reduce(np.add, a * a)
    assert list(of_matrix(ti.Matrix([[1, -2], [7, 3]]))) == [9, 7, 0]


def test_branches_on_the_same_condition_may_follow_each_other():
    """Taichi joins them, and ends with an error where one alone has an `else`."""

    @kernel
    def count(a: ti.i32, b: ti.i32) -> ti.i32:
        found, k = 0, 0
        if a < b:
            found += 1
        else:
            found += 2
        if a < b:
            found += 4
        if not a < b:
            found += 8
        else:
            for _ in range(a):
                found += 16
        while a > b + k:
            if a > b + k:
                found += 100
            else:
                found += 1000
            k += 1
        return found

    assert [count(*ab) for ab in ((1, 2), (2, 2), (4, 2))] == [1 + 4 + 16, 2 + 8, 2 + 8 + 200]
