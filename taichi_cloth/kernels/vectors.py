"""The vectors of a pack of several lanes, as kernels compute with them: component by component.

Each component is a vector of the processor, with a number for each lane. Taichi has matrices for
this, but takes a component out of one number by number, and puts it back so. Most of a kernel's
statements were that, for each of which Taichi searches all of the kernel, and LLVM did not see
through some of it: steps of `xpbd` and `vbd` took three times as long (docs/design.md, "Taichi's
traps"). So arithmetic on `Vectors` is written out for their components as a kernel is read.
"""

import functools
import operator

from taichi.lang import impl
from taichi.lang.common_ops import TaichiOperations
from taichi.lang.expr import Expr

from taichi_cloth.front_end import mending


class Vectors:
    """Vectors in lanes: components, for each a number for each lane, (lanes,).

    They take + - * / with others, with one number for all, and with one for each lane; in a kernel
    they can be assigned to, and += adds to them.
    """

    def __init__(self, components):
        self.components = list(components)

    @property
    def n(self):
        """The number of components."""
        return len(self.components)

    def copied(self):
        """A variable of the kernel that is being read, with the same value."""
        return Vectors([impl.expr_init(part) for part in self.components])

    def _for_each(self, other):
        """Components for those here: of other vectors, or one number, or one for each lane."""
        if isinstance(other, Expr):
            other = impl.expr_init(other)  # a variable, so that it is computed once
        return other.components if isinstance(other, Vectors) else [other] * self.n

    def _each(self, other, op):
        pairs = zip(self.components, self._for_each(other), strict=True)
        return Vectors([op(mine, theirs) for mine, theirs in pairs])

    def __add__(self, other):
        return self._each(other, operator.add)

    def __sub__(self, other):
        return self._each(other, operator.sub)

    def __mul__(self, other):
        return self._each(other, operator.mul)

    def __truediv__(self, other):
        return self._each(other, operator.truediv)

    def __radd__(self, other):
        return self._each(other, lambda a, b: b + a)

    def __rsub__(self, other):
        return self._each(other, lambda a, b: b - a)

    def __rmul__(self, other):
        return self._each(other, lambda a, b: b * a)

    def _assign(self, other):
        for mine, new in zip(self.components, other.components, strict=True):
            mine._assign(new)

    def _augassign(self, other, op):
        for mine, more in zip(self.components, self._for_each(other), strict=True):
            mine._augassign(more, op)


def _replacements():
    """Let Taichi copy `Vectors` into variables, and leave arithmetic with them to them."""

    def leaving(operate):
        @functools.wraps(operate)
        def operated(self, other):
            return NotImplemented if isinstance(other, Vectors) else operate(self, other)

        return operated

    def copying(init):
        @functools.wraps(init)
        def initialized(rhs):
            return rhs.copied() if isinstance(rhs, Vectors) else init(rhs)

        return initialized

    for name in ("__add__", "__sub__", "__mul__", "__truediv__"):
        yield TaichiOperations, name, leaving(getattr(TaichiOperations, name))
    yield impl, "expr_init", copying(impl.expr_init)


mending.replace_too(_replacements)
