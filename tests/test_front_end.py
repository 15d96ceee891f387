"""Taichi's front end after `front_end.mend`: it reads the same kernels, and says the same."""

import gc
import weakref

import pytest
import taichi as ti
from taichi.lang import kernel_impl

from taichi_cloth import front_end, runtime


@pytest.fixture(autouse=True)
def started(device):
    assert front_end.functions_work(), "the replacements are not there"


def test_functions_of_classes_and_of_functions_are_told_apart():
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

        @ti.kernel
        def apply(x: ti.i32, law: ti.template()) -> ti.i32:
            return law(x)

        kernels.append(apply(5, law))
    assert kernels == [6, 50]


def test_an_error_in_a_kernel_names_its_line():
    @ti.kernel
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

    @ti.kernel
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

    @ti.kernel
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

        @ti.kernel
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


def test_a_taichi_that_is_made_otherwise_is_left_alone(monkeypatch):
    def plain(self, is_kernel, something_new):
        """As of another Taichi."""

    monkeypatch.setattr(kernel_impl, "_get_tree_and_ctx", plain)
    front_end.mend()
    assert kernel_impl._get_tree_and_ctx is plain
    monkeypatch.delattr(kernel_impl, "_inside_class")
    front_end.mend()
    assert kernel_impl._get_tree_and_ctx is plain and not front_end.functions_work()


def test_what_is_mended_is_not_mended_again(monkeypatch):
    """Trees would be given back twice, and read by two at once."""
    transform = kernel_impl.transform_tree
    monkeypatch.setattr(front_end, "functions_work", lambda: False)  # as tests of parts do
    front_end.mend()
    assert kernel_impl.transform_tree is transform


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

    @ti.kernel
    def run(x: ti.i32) -> ti.i32:
        return 10 * twice(x, total)

    assert front_end.functions_work()
    assert run(3) == 10 * (4 * 6 + 3 * 3)


def test_what_is_compiled_soon_reads_what_was_stored():
    """Taichi without its search alone keeps two copies of a place that two expressions read."""
    stored, seen = ti.field(ti.f32, 8), ti.field(ti.f32, 8)

    @ti.kernel
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
