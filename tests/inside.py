"""What tests of kernels need of a simulation's inside, in one place: all else asks it from outside.

Kernels are tested on a state that a simulation has loaded, because only it lays particles out.
"""

import math
from contextlib import contextmanager
from dataclasses import replace

import pytest
import taichi as ti
from taichi.lang import impl

from taichi_cloth import runtime
from taichi_cloth.kernels import lane_memory, methods
from taichi_cloth.simulation import autotune, simulation
from taichi_cloth.simulation.launch import Launcher
from taichi_cloth.simulation.prediction import Cost, Prediction
from taichi_cloth.simulation.storage import containers


def refuse_both_ways():
    """From here on no kernel that sees the memory of lanes may read a field that lies in it.

    Taichi would take them for different memory (`kernels/lane_memory.py`).
    """
    subscript = impl.subscript

    def refusing(ast_builder, value, *indices, **given):
        both = isinstance(value, ti.Field) and lane_memory.sees(value)
        assert not both, "a kernel that sees the memory of lanes reads a field of it"
        return subscript(ast_builder, value, *indices, **given)

    impl.subscript = refusing


def state_of(sim):
    """Its fields on the device."""
    return sim.storage.state


def spec_of(sim):
    """What its kernels are compiled for, with loops that Taichi spreads."""
    threads = runtime.current_device().threads
    return replace(sim.storage.specialization, threads=threads, one_launch_per_step=True)


def fields_of(sim):
    """The names of the fields that it has room for."""
    return set(vars(sim.storage.state))


def move_to(sim, topology, path, x, v):
    """Go on from positions x and velocities v, (n, dim)."""
    sim.load_as(topology, path, x, v)


def add_vectors(sim, name, haloed=False):
    """Another vector of each particle, state.<name>; haloed: read by those that it is tied to."""
    state, tree = state_of(sim), ti.FieldsBuilder()
    field = state._pack_vectors(spec_of(sim), tree=tree, copied=haloed)
    state.trees.append(tree.finalize())
    setattr(state, name, field)
    if haloed:
        state.haloed = (*state.haloed, field)


def add_sums(sim, count):
    """Room for `count` sums over all particles, state.sums[k, 0]."""
    state_of(sim).add_sums(count)


def take_step(sim, step):
    """Take one step of a method that is this function, ti.func(spec, state, t)."""
    method = replace(methods.load("symplectic_euler"), step=step)
    launcher = Launcher(method, runtime.current_device())
    launcher.advance(sim.storage.specialization, state_of(sim), sim.steps, 1, 1)


def candidates_of(sim):
    """The ways to run a simulation, as `autotune.choose` takes them."""
    return sim._prediction()


def predict_by(monkeypatch, cost):
    """Let cost(topology, path) -> Cost be what a way of running is predicted to cost."""
    monkeypatch.setattr(Prediction, "predict", lambda _, topology, path: cost(topology, path))


def lose_patience(monkeypatch, sim):
    """Let threads of a simulation look slower than one alone, at once."""
    monkeypatch.setattr(autotune.Watch, "PATIENCE", 0.0)
    monkeypatch.setattr(autotune.Watch, "SLOWER", 0.0)
    monkeypatch.setattr(autotune.Watch, "OWN", math.inf)
    monkeypatch.setattr(autotune.Watch, "REGRET", -math.inf)
    choice = sim._watch.choice
    costs = {"serial": Cost(1.0, 1.0), "parallel": Cost(0.5, 0.5)}
    sim._watch = autotune.Watch(replace(choice, costs=costs), sim.substeps)


def counting_kernels(monkeypatch):
    """The ways, (threads, lanes, one launch per step), whose frames are launched from now on."""
    ways = []
    before = Launcher.advance

    def advance(launcher, spec, *arguments):
        ways.append((spec.threads, spec.lanes, spec.one_launch_per_step))
        return before(launcher, spec, *arguments)

    monkeypatch.setattr(Launcher, "advance", advance)
    return ways


CHOOSES = Launcher._hurries


def compile_soon(patch):
    """From here on every simulation on the graph has kernels that compile in half the time.

    Most of what tests take is compiling. Windows and short runs begin with those kernels, too, and
    they have the bits of the others (`test_aside.py`).
    """

    def on_the_graph(launcher, spec, capacity):
        return launcher.device.arch == "cpu" and spec.lanes == 1

    patch.setattr(Launcher, "_hurries", on_the_graph)


def compile_to_run_fast(patch):
    """From here on simulations have the kernels that they have without tests."""
    patch.setattr(Launcher, "_hurries", CHOOSES)


def way_to_compile():
    """What tells simulations apart whose kernels are compiled in one way and in the other."""
    return Launcher._hurries


@contextmanager
def few_lanes():
    """Packs of 2 lanes in simulations made meanwhile: they compile in a third of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulation, "LANES", 2)
        yield


@contextmanager
def room_for_clicks(count):
    """Room for `count` particles that clicks add, in simulations made meanwhile."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(containers, "SPAWN_CAPACITY", count)
        yield


def not_starting(monkeypatch, instead):
    """Call `instead` where a run would start Taichi."""
    monkeypatch.setattr(runtime, "start", instead)
