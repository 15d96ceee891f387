"""Launches of kernels with what they were launched with before, at a twentieth of the usual cost.

Taichi looks at all arguments of a kernel anew at every launch, for what has been compiled for them,
and packs them one by one: some 50 to 70 us in Python before a kernel begins (1.7.4), and 100 more
where it runs on several threads, which have gone to sleep meanwhile. A step of a small cloth takes
less. What was found at the first launch is kept here; a launch then takes some 5 us.

It is Taichi's own machinery, called in its own order. A Taichi that is made otherwise, and kernels
with arguments of other kinds, are launched as usual.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from types import FunctionType, NoneType
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary, ref

import numpy as np

from taichi_cloth.kernels.specialization import Specialization

STATE = "state"  # the name of the argument that has the fields, in all kernels
# What reads the result of a launch from its context, by the kind of number that it is.
_RESULTS: dict[type | None, str] = {float: "get_struct_ret_float", int: "get_struct_ret_int"}
KEPT = Specialization, FunctionType, NoneType  # what templates may be, besides


class _Signature(NamedTuple):
    """Places of a kernel's arguments, by kind.

    templates: all but the state. arrays: each with the number of axes of its elements. numbers:
    each with its type, float or int.
    """

    state: int
    templates: tuple[int, ...]
    arrays: tuple[tuple[int, int], ...]
    numbers: tuple[tuple[int, type], ...]


class PreparedLaunches:
    """The launches that one launcher has made, by kernel and by what is compiled into it.

    They do not keep the fields that they are of.
    """

    def __init__(self) -> None:
        self._of: WeakKeyDictionary[Any, dict[Any, PreparedLaunch]] = WeakKeyDictionary()
        self._last: dict[Callable[..., Any], PreparedLaunch] = {}  # of each kernel

    def find(self, kernel: Callable[..., Any], arguments: tuple[Any, ...]) -> PreparedLaunch | None:
        """Find the launch of a kernel with these arguments; None if there was none yet."""
        last = self._last.get(kernel)  # most launches are those of the frame before
        if last is not None and last.repeats(arguments):
            return last
        signature = _signature(kernel)
        if signature is None or not _are_whole(signature, arguments):
            return None
        known = self._of.get(arguments[signature.state])
        prepared = known and known.get(_key(kernel, signature, arguments))
        if not prepared or not prepared.is_of(_runtime()):
            return None
        self._last[kernel] = prepared
        return prepared

    def last(self, kernel: Callable[..., Any]) -> PreparedLaunch | None:
        """The last launch of a kernel, of those that `find` found."""
        return self._last.get(kernel)

    def note(self, kernel: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
        """Keep how a kernel was just launched, under the settings that it was compiled with."""
        signature = _signature(kernel)
        if signature is None or not _are_whole(signature, arguments):
            return
        if not all(isinstance(arguments[at], KEPT) for at in signature.templates):
            return
        known = self._of.setdefault(arguments[signature.state], {})
        known[_key(kernel, signature, arguments)] = PreparedLaunch(kernel, signature, arguments)


def was_launched(kernel: Callable[..., Any], arguments: tuple[Any, ...]) -> bool:
    """True if a kernel is compiled for such arguments already, also one that is not prepared."""
    primal = _primal(kernel)
    instance, _ = primal.mapper.lookup(arguments)
    return (primal.func, instance, primal.autodiff_mode) in primal.compiled_kernels


class PreparedLaunch:
    """A kernel, compiled for some arguments, and how it gets the others."""

    def __init__(
        self, kernel: Callable[..., Any], signature: _Signature, arguments: tuple[Any, ...]
    ) -> None:
        primal = _primal(kernel)
        made = primal.compiled_kernels[primal.ensure_compiled(*arguments)]
        runtime = _runtime()
        self._start = ref(runtime)
        program = runtime.prog
        self._compiled = program.compile_kernel(program.config(), program.get_device_caps(), made)
        self._make_context = made.make_launch_context
        given = sorted(at for at, _ in (*signature.arrays, *signature.numbers))
        place = {at: (k,) for k, at in enumerate(given)}  # templates are compiled in, and have none
        self._arrays = [(at, place[at], inner) for at, inner in signature.arrays]
        self._numbers = [(at, place[at], kind) for at, kind in signature.numbers]
        self._templates = [(at, arguments[at]) for at in signature.templates]
        self._state_at, self._state = signature.state, ref(arguments[signature.state])
        # On CPUs the context is kept for launches with the same arrays, which it does not keep.
        self._on_cpu = _shares_memory(program)
        self._context: Any = None
        self._given: list[float | None] = []  # the numbers that it has
        self._has: list[tuple[int, ref[np.ndarray]]] = []
        kinds = [_kind_of(kind) for kind in primal.return_type or ()]
        self._result = _RESULTS[kinds[0]] if kinds else ""

    def is_of(self, runtime: Any) -> bool:
        """True if it is of this start of Taichi; what is of another one is no longer there."""
        return self._start() is runtime

    def repeats(self, arguments: tuple[Any, ...]) -> bool:
        """True if a launch differs from the last one of this in its numbers alone."""
        return (
            self._context is not None
            and arguments[self._state_at] is self._state()
            and all(arguments[at] is one for at, one in self._templates)
            and self._has_arrays(arguments)
            and self.is_of(_runtime())
        )

    def repeats_with(self, state: Any, *templates: Any) -> bool:
        """True if its last launch was of a state and these templates, the first ones that it has.

        Arrays, which must be the state's own, are not looked at: that takes as long as all else.
        """
        return (
            self._context is not None
            and state is self._state()
            and all(one is of for one, (_, of) in zip(templates, self._templates, strict=False))
            and self.is_of(_runtime())
        )

    def launch(self, *numbers: float) -> Any:
        """Launch it again with other numbers, after `repeats_with`; return what it returns."""
        self._set(self._context, numbers)
        return self._run(self._context)

    def __call__(self, arguments: tuple[Any, ...]) -> Any:
        """Launch it; return what it returns.

        On GPUs the context is a new one each time: a launch leaves it pointing to memory that is
        given back.
        """
        context = self._context
        if context is None or not self._has_arrays(arguments):
            context = self._with_arrays(arguments)
        self._set(context, [arguments[at] for at, _, _ in self._numbers])
        return self._run(context)

    def _set(self, context: Any, numbers: Sequence[float]) -> None:
        """Give a context its numbers, but for those that it has: each takes a microsecond."""
        for k, (_, place, kind) in enumerate(self._numbers):
            number = kind(numbers[k])
            if number != self._given[k]:
                if kind is int:
                    context.set_arg_int(place, number)
                else:
                    context.set_arg_float(place, number)
                self._given[k] = number

    def _run(self, context: Any) -> Any:
        program = _runtime().prog
        program.launch_kernel(self._compiled, context)
        if not self._result:
            return None
        if not self._on_cpu:  # there it has ended
            program.synchronize()
        return getattr(context, self._result)((0,))

    def _has_arrays(self, arguments: tuple[Any, ...]) -> bool:
        """True if the context that is kept has these arrays."""
        return all(arguments[at] is of() for at, of in self._has)

    def _with_arrays(self, arguments: tuple[Any, ...]) -> Any:
        """A context that has these arrays."""
        context = self._make_context()
        self._given = [None] * len(self._numbers)
        for at, place, inner in self._arrays:
            array = arguments[at]
            address, _ = array.__array_interface__["data"]
            shape = array.shape[: array.ndim - inner]
            context.set_arg_external_array_with_shape(place, address, array.nbytes, shape, 0)
        if self._on_cpu:
            self._context = context
            self._has = [(at, ref(arguments[at])) for at, _, _ in self._arrays]
        return context


def _kind_of(annotation: Any) -> type | None:
    """Float or int, of a type of Taichi's numbers; None of unsigned and other ones."""
    from taichi.lang.util import cook_dtype
    from taichi.types import primitive_types
    from taichi.types.utils import is_signed

    if id(annotation) in primitive_types.real_type_ids:
        return float
    if id(annotation) in primitive_types.integer_type_ids and is_signed(cook_dtype(annotation)):
        return int
    return None


def _shares_memory(program: Any) -> bool:
    """True if the device is a CPU, whose memory is the host's."""
    import taichi as ti

    return program.config().arch in (ti.x64, ti.arm64)


@cache
def _get_runtime() -> Callable[[], Any]:
    from taichi.lang import impl

    found: Callable[[], Any] = impl.get_runtime
    return found


def _runtime() -> Any:
    return _get_runtime()()


def _primal(kernel: Callable[..., Any]) -> Any:
    """Taichi's object of a kernel that is no method of a class."""
    return getattr(kernel, "_primal", None)


@cache
def _signature(kernel: Callable[..., Any]) -> _Signature | None:
    """Places of a kernel's arguments; None if it is not launched in this way."""
    from taichi.types import ndarray_type, template

    primal = _primal(kernel)
    parts = "compiled_kernels", "ensure_compiled", "return_type", "arguments"
    if not all(hasattr(primal, part) for part in parts):
        return None
    returned = primal.return_type or ()
    if len(returned) > 1 or any(_kind_of(kind) is None for kind in returned):
        return None
    state: int | None = None
    templates: list[int] = []
    arrays: list[tuple[int, int]] = []
    numbers: list[tuple[int, type]] = []
    for at, argument in enumerate(primal.arguments):
        kind = argument.annotation
        if isinstance(kind, template):
            if argument.name == STATE:
                state = at
            else:
                templates.append(at)
        elif isinstance(kind, ndarray_type.NdarrayType):
            arrays.append((at, getattr(kind.dtype, "ndim", 0)))
        else:
            number = _kind_of(kind)
            if number is None:
                return None
            numbers.append((at, number))
    if state is None:
        return None
    return _Signature(state, tuple(templates), tuple(arrays), tuple(numbers))


def _key(kernel: Callable[..., Any], signature: _Signature, arguments: tuple[Any, ...]) -> Any:
    """All that decides what of a kernel is compiled, besides the state."""
    arrays = [(arguments[at].dtype, arguments[at].ndim) for at, _ in signature.arrays]
    return kernel, *[arguments[at] for at in signature.templates], *arrays


def _are_whole(signature: _Signature, arguments: tuple[Any, ...]) -> bool:
    """True if all arrays are NumPy's, and lie in memory as they are indexed."""
    return all(
        isinstance(arguments[at], np.ndarray) and arguments[at].flags.c_contiguous
        for at, _ in signature.arrays
    )
