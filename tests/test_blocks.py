"""Blocks of threads that stay on a CUDA GPU for whole frames (`kernels/loops.py`), on a CPU.

All of it but what needs such a GPU, a block's own barrier: a CPU's threads take turns at each loop
as those of blocks do, sums are joined in three levels, particles are sorted by the loops of GPUs.
"""

from dataclasses import replace
from types import SimpleNamespace

import inside
import numpy as np
import pytest
import small
import taichi as ti
from hypothesis import given
from hypothesis import strategies as st
from selection import mostly_thorough

from taichi_cloth.front_end.mending import kernel
from taichi_cloth.kernels import loops, methods
from taichi_cloth.kernels.packs import plus
from taichi_cloth.kernels.watchdog import NO_FAULT
from taichi_cloth.runtime import Device
from taichi_cloth.simulation.launch import MOST_TURNS, Launcher
from taichi_cloth.simulation.simulation import Simulation

FRAMES = 3
H100 = Device("cuda", "f32", 1, True, multiprocessors=132)


@pytest.fixture
def as_blocks(monkeypatch):
    """From here on the CPU's threads take turns as those of blocks do."""
    specialize = Launcher.specialize

    def taking_turns(self, spec, path, packs):
        return replace(specialize(self, spec, path, packs), blocks=int(path == "parallel"))

    monkeypatch.setattr(Launcher, "specialize", taking_turns)
    monkeypatch.setattr(loops, "in_three_levels", lambda: True)


def run(name, method, topology):
    """A small scene after some frames, with packs of one particle, as on GPUs."""
    settings = {"topology": topology, "lanes": 1, "execution": "parallel", "dt": "auto"}
    sim = Simulation(small.build(name), method, **settings)
    sim.advance(FRAMES)
    return sim


STABLE = [method for method in methods.METHODS if method != "explicit_euler"]  # by `--dt auto`
# Whose loops are all in `newton_cg` and in the forces, as those of `implicit_euler` are.
ITS_LOOPS = ("implicit_midpoint", "tr_bdf2")
CASES = [
    *(("box", method, "graph") for method in methods.METHODS),
    *(("trampoline", method, "graph") for method in STABLE if method not in ITS_LOOPS),
    *(("flag", method, "graph") for method in ("implicit_euler", "vbd")),
    ("net", "implicit_euler", "graph"),
    ("trampoline", "tr_bdf2", "graph"),  # which evaluates forces before its stages, too
    *(("warp", method, "lanes") for method in STABLE),
]
SOME = [
    ("box", "symplectic_euler", "graph"),  # sorted into cells
    ("trampoline", "verlet", "graph"),  # an obstacle, bending
    ("net", "implicit_euler", "graph"),
    ("warp", "tr_bdf2", "lanes"),
    ("warp", "vbd", "lanes"),
]


@pytest.mark.parametrize(("name", "method", "topology"), mostly_thorough(CASES, SOME))
def test_threads_that_take_turns_come_to_the_same(name, method, topology, request):
    """To the last bits of a sum over all particles, whose order is another one."""
    plain = run(name, method, topology)
    request.getfixturevalue("as_blocks")
    turning = run(name, method, topology)
    assert turning.storage.specialization.blocks == 1 and turning.substeps == plain.substeps
    extent = np.ptp(plain.positions(), axis=0).max()
    for mine, its in zip(places(turning), places(plain), strict=True):
        np.testing.assert_allclose(mine, its, rtol=0, atol=1e-10 * extent)


def places(sim):
    return sim.positions(), sim.velocities()


# --- sums in three levels -------------------------------------------------------------------------


@given(st.integers(0, 10**8))
def test_three_levels_take_each_pack_once_and_few_at_a_time(packs):
    pieces, groups = loops.levels_of(packs)
    assert (pieces == 0) == (groups == 0) == (packs == 0)
    if packs:
        most = int(np.ceil(packs ** (1 / 3))) + 1
        assert -(-packs // pieces) <= most and -(-pieces // groups) <= most and groups <= most
    # What `State.add_sums` makes room for: the sum, its pieces and their groups.
    assert 1 + pieces + groups <= packs + 3


@ti.func
def index(spec: ti.template(), state: ti.template(), i):
    return ti.cast(i + 1, state.real)


@ti.func
def two_numbers(spec: ti.template(), state: ti.template(), i):
    return [ti.cast(i + 1, state.real), ti.cast((i * 7919) % 1009, state.real)]


@kernel
def join_all(
    spec: ti.template(), state: ti.template(), packs: ti.i32, pieces: ti.i32, groups: ti.i32
):
    state.n_packs[None] = packs
    state.n_pieces[None], state.n_groups[None] = pieces, groups
    loops.join(spec, state, 0, two_numbers, ti.static((plus, ti.max)))
    loops.add_up(spec, state, 0, index, 2)


def test_sums_in_three_levels_are_sums(as_blocks):
    sim = Simulation(small.build("net"), "implicit_euler", topology="graph", lanes=1)
    spec, state = inside.spec_of(sim), inside.state_of(sim)
    before = state.n_packs[None]
    for packs in (0, 1, 2, 3, 5, 8, 9, 27, 64, 100, before):
        join_all(spec, state, packs, *loops.levels_of(packs))
        i = np.arange(packs)
        largest = (i * 7919 % 1009).max(initial=0)
        expected = [packs * (packs + 1) / 2, largest, packs * (packs + 1) / 2]
        assert state.sums.to_numpy()[:3, 0].tolist() == expected


# --- how a GPU is run -----------------------------------------------------------------------------


def test_blocks_are_as_many_as_a_gpu_holds_at_once(pool):
    spec = inside.spec_of(pool(small.build("net"), "verlet"))
    launcher = Launcher(methods.load("verlet"), H100)
    for packs, blocks in ((1, 1), (256, 1), (257, 2), (128**2, 64), (10**5, 128)):
        made = launcher.specialize(spec, "parallel", packs)
        assert (made.blocks, made.threads) == (blocks, blocks * loops.BLOCK)
        assert not made.one_launch_per_step


def test_large_scenes_have_a_launch_for_each_step(pool):
    """Unless their steps have phases: those would ask the host after each."""
    spec = inside.spec_of(pool(small.build("net"), "verlet"))
    most = MOST_TURNS * 128 * loops.BLOCK
    for method, stays in (("verlet", False), ("implicit_euler", True), ("xpbd", True)):
        launcher = Launcher(methods.load(method), H100)
        assert launcher.specialize(spec, "parallel", most).blocks == 128
        made = launcher.specialize(spec, "parallel", most + 1)
        assert (made.blocks > 0, made.one_launch_per_step) == (stays, not stays)


def test_pairs_of_cloth_have_launches_of_their_own(pool):
    spec = replace(inside.spec_of(pool(small.build("net"), "verlet")), resting=True, thick=True)
    made = Launcher(methods.load("implicit_euler"), H100).specialize(spec, "parallel", 100)
    assert made.one_launch_per_step and made.blocks == 0


@pytest.mark.parametrize(("method", "frames"), [("verlet", 4000), ("implicit_euler", 64)])
def test_launches_of_small_scenes_end_soon(method, frames):
    launcher = Launcher(methods.load(method), H100)
    assert launcher.frames_per_launch(substeps=4, size=3) == frames


@pytest.mark.parametrize(
    ("method", "substeps", "packs", "by_steps"),
    [
        ("verlet", 16, 128**2, False),
        ("verlet", 16_001, 3, True),
        ("implicit_euler", 256, 3, False),
        ("implicit_euler", 257, 3, True),
        ("implicit_euler", 16, 2048**2, True),
    ],
)
def test_frames_that_take_long_have_a_launch_for_each_step(
    method, substeps, packs, by_steps, pool, monkeypatch
):
    launcher, launched = Launcher(methods.load(method), H100), []
    spec = launcher.specialize(inside.spec_of(pool(small.build("net"), "verlet")), "parallel", 3)
    monkeypatch.setattr(launcher, "_launch_steps", lambda spec, *_: launched.append(spec))
    monkeypatch.setattr(launcher, "_launch", lambda *_, **how: NO_FAULT)
    state = SimpleNamespace(packs=packs, lane_memory=None, real=ti.f64)
    launcher.advance(spec, state, 0, 1, substeps)
    assert bool(launched) == by_steps
    assert all(made.one_launch_per_step and made.blocks == 0 for made in launched)


def test_a_gpu_whose_multiprocessors_are_not_known_has_no_blocks_that_stay(pool):
    """As those of Vulkan, Metal and OpenGL, whose blocks may not wait for each other."""
    spec = inside.spec_of(pool(small.build("net"), "verlet"))
    launcher = Launcher(methods.load("implicit_euler"), replace(H100, multiprocessors=0))
    made = launcher.specialize(spec, "parallel", 100)
    assert made.one_launch_per_step and made.blocks == 0
