"""Other programs on Taichi, run before and after ours in one process: they notice nothing.

`python tests/foreign.py` runs them, says what differs, and ends with status 1 if anything does.
`--thread`: ours run in a thread of their own, too, and those that compile for longer.
"""

import os
import subprocess
import sys
import threading
import types

import numpy as np
import taichi as ti


def tape():
    """Gradients by reverse and by forward mode."""
    x, loss = ti.field(ti.f32, 4, needs_grad=True), ti.field(ti.f32, (), needs_grad=True)

    @ti.kernel
    def energy():
        for i in x:
            loss[None] += 0.5 * x[i] ** 2 * ti.sin(x[i])

    x.from_numpy(np.linspace(0.1, 2.0, 4, dtype=np.float32))
    with ti.ad.Tape(loss):
        energy()
    yield x.grad.to_numpy().tolist()
    ti.root.lazy_dual()
    y, total = ti.field(ti.f32, 2, needs_dual=True), ti.field(ti.f32, (), needs_dual=True)

    @ti.kernel
    def cubes():
        for i in y:
            total[None] += y[i] ** 3

    y.from_numpy(np.array([1.0, 2.0], np.float32))
    with ti.ad.FwdMode(loss=total, param=y, seed=[1.0, 0.5]):
        cubes()
    yield total.dual[None]


@ti.func
def chosen(a: ti.template(), i, wide: ti.template()):
    found = ti.cast(a[i], dtype=ti.f32)
    if ti.static(wide):
        for k in ti.static(range(3)):
            found += k * a[i]
    return found


@ti.kernel
def templates(a: ti.template(), wide: ti.template(), x: ti.i32) -> ti.types.vector(4, ti.f32):
    b = ti.Matrix([[1.0, 2.0], [x, 4.0]])
    v = ti.Vector([b.sum(), b.max(), chosen(a, 1, wide), (b @ b).trace()])
    if 0 <= x < 3 and not (x == 2 or x > 5):
        v[0] -= 1
    elif x & 1 == 1:
        v[1] = ti.select(v[0] > 3.0, 7.0, 8.0)
    else:
        v += v.dot(v)
    return v


def template_arguments():
    a = ti.field(ti.i32, 3)
    a.from_numpy(np.array([5, 6, 7], np.int32))
    for wide in (False, True):
        for x in range(4):
            yield list(templates(a, wide, x))


@ti.dataclass
class Ball:
    at: ti.math.vec2
    radius: ti.f32

    @ti.func
    def area(self):
        return 3.0 * self.radius**2 + self.at.norm_sqr()


@ti.data_oriented
class Counter:
    def __init__(self):
        self.n = ti.field(ti.i32, ())

    @ti.func
    def twice(self, k):
        return 2 * k

    @ti.kernel
    def add(self, k: ti.i32) -> ti.i32:
        self.n[None] += self.twice(k)
        return self.n[None]


def structs():
    balls = Ball.field(shape=2)

    @ti.kernel
    def areas() -> ti.f32:
        total = 0.0
        for _ in range(1):
            for i in range(2):
                balls[i] = Ball(at=[i, 1.0], radius=2.0)
                total += balls[i].area()
        return total

    yield areas(), balls.to_numpy()["radius"].tolist()
    counter = Counter()
    yield counter.add(3), counter.add(1)


def sparse_trees():
    x, n, row = ti.field(ti.i32), ti.field(ti.i32, ()), ti.field(ti.i32)
    block = ti.root.pointer(ti.i, 8)
    block.bitmasked(ti.i, 4).place(x)
    rows = ti.root.dynamic(ti.j, 64, chunk_size=8)
    rows.place(row)

    @ti.kernel
    def fill():
        for i in range(3):
            x[9 * i] = i + 1
        for i in range(5):
            row.append(i * i)

    @ti.kernel
    def count():
        for i in x:
            n[None] += 10 * x[i] + i
        for i in range(32):
            if ti.is_active(block, i):
                n[None] += 1000

    fill()
    count()
    yield n[None], row.to_numpy()[:5].tolist()
    block.deactivate_all()
    count()
    yield n[None]


def errors():
    """Messages of Taichi, with the place and the drawing of the line at fault."""

    @ti.kernel
    def unknown_name():
        for _ in range(3):
            x = nobody_defined_this + 1  # noqa: F821, F841

    @ti.func
    def inner(a):
        return a.no_such_part

    @ti.kernel
    def of_what_is_inlined():
        inner(ti.Vector([1, 2]))

    @ti.kernel
    def of_types():
        x = 1
        x = "text"  # noqa: F841

    @ti.kernel
    def reads(x: ti.template()) -> ti.f32:
        return x[0, 0]

    def of_indices():
        reads(ti.field(ti.f32, 3))

    def not_placed():  # the last: it stays so
        unplaced = ti.field(ti.f32)
        reads(unplaced)

    for fails in (unknown_name, of_what_is_inlined, of_types, of_indices, not_placed):
        try:
            fails()
        except Exception as error:
            yield type(error).__name__, str(error)
        else:
            yield "no error"


def settings():
    """What `ti.init` starts with, and what else the process has of Taichi."""
    names = [name for name in dir(ti.cfg) if name[0] != "_"]
    names.remove("print_ir_dbg_info")  # never set by 1.7.4: it is what the memory held
    yield [(name, str(getattr(ti.cfg, name))) for name in names]
    yield ti.lang.impl.get_runtime().unrolling_limit, ti._logging.is_logging_effective("info")
    banner = subprocess.run(
        [sys.executable, "-c", "import taichi"], capture_output=True, text=True, check=True
    )
    yield banner.stdout
    yield sorted((k, v) for k, v in os.environ.items() if "TAICHI" in k or k.startswith("TI_"))


PROGRAMS = tape, template_arguments, structs, sparse_trees, errors, settings


def run():
    """What all of them find, by name."""
    found = {}
    for program in PROGRAMS:
        ti.init(arch=ti.cpu, log_level=ti.ERROR)
        found[program.__name__] = list(program())
    return found


def parts():
    """All functions and classes of Taichi, and what these have, each by its place."""
    kinds = (
        types.FunctionType | type | staticmethod | classmethod | property | types.BuiltinMethodType
    )
    found = {}
    for name, module in list(sys.modules.items()):
        if name.partition(".")[0] == "taichi" and module is not None:
            for key, value in list(vars(module).items()):
                if isinstance(value, kinds):
                    found[f"{name}.{key}"] = value
                if isinstance(value, type) and value.__module__.startswith("taichi"):
                    for inner, part in list(vars(value).items()):
                        if isinstance(part, kinds):
                            found[f"{name}.{key}.{inner}"] = part
    return found


def ours(name, method, topology):
    """A simulation of ours, and its picture."""
    import taichi_cloth as tc

    tc.start()
    sim = tc.Simulation(tc.scenes.build(name), method, topology=topology)
    sim.advance(2)
    tc.picture(sim, size=(160, 120))


def run_ours():
    ours("cloth", "symplectic_euler", "lanes")
    if sys.argv[1:] == ["--thread"]:
        ours("flag", "tr_bdf2", "graph")
        another = threading.Thread(target=ours, args=("cloth", "verlet", "lanes"))
        another.start()
        another.join()


def main():
    rounds, wholes = [], []
    for meanwhile in (lambda: None, run_ours):  # the same lines call, as messages name them
        meanwhile()
        wholes.append(parts())
        rounds.append(run())
    whole, left = wholes
    changed = [name for name, part in left.items() if whole.get(name, part) is not part]
    failed = [f"{name} is another one" for name in changed]
    for name, before in rounds[0].items():
        for old, new in zip(before, rounds[1][name], strict=True):
            if repr(old) != repr(new):
                failed.append(f"{name}:\n{difference(old, new)}")
    print("\n".join(failed) or "nothing differs")
    return bool(failed)


def difference(old, new):
    """What two findings do not share."""
    if isinstance(old, list | tuple) and len(old) == len(new):
        pairs = [(a, b) for a, b in zip(old, new, strict=True) if repr(a) != repr(b)]
        return "\n".join(f"{a}\n{b}" for a, b in pairs)
    return f"{old}\n{new}"


if __name__ == "__main__":
    sys.exit(main())
