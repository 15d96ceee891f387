"""What tests of kernels need of a simulation's inside, in one place: all else asks it from outside.

Kernels are tested on a state that a simulation has loaded, because only it lays particles out.
"""

from contextlib import contextmanager
from types import SimpleNamespace

import pytest

from taichi_cloth import runtime
from taichi_cloth.simulation import execution, simulation


def state_of(sim):
    """Its fields on the device."""
    return sim._state


def plan_of(sim):
    """What its kernels are compiled for, with loops that Taichi spreads."""
    return sim._spread_plan


def fields_of(sim):
    """The names of the fields that it has room for."""
    return set(vars(sim._state))


def particles_and_springs_of(sim):
    """What there is now, with what was spawned."""
    return sim._particles, sim._springs


def move_to(sim, topology, path, x, v):
    """Go on from positions x and velocities v, (n, dim)."""
    sim.load_as(topology, path, x, v)


def add_vectors(sim, name, haloed=False):
    """Another vector of each particle, state.<name>; haloed: read by those that it is tied to."""
    sim._state.add_vectors(sim._spread_plan, name, haloed=haloed)


def add_sums(sim, count):
    """Room for `count` sums over all particles, state.sums[k, 0]."""
    sim._state.add_sums(count)


def take_step(sim, step):
    """Take one step of a method that is this function, ti.func(plan, state, t)."""
    execution.run_frames(SimpleNamespace(step=step), sim._plan, sim._state, sim.steps, 1, 1)


def is_alone(sim):
    """Whether it is about to run on one thread: of a simulation that is being measured."""
    return sim._plan.threads == 1


def stored_in(sim):
    """The topology that it is stored in: of a simulation that is being measured."""
    return "lanes" if sim._plan.links else "graph"


def measure_by(monkeypatch, measure):
    """Let measure(sim) -> seconds be how fast a way of running is; returns what it replaces."""
    before = execution._measure
    monkeypatch.setattr(execution, "_measure", measure)
    return before


def lose_patience(monkeypatch, sim):
    """Let threads of a simulation look slower than one alone, at once."""
    monkeypatch.setattr(simulation.Pace, "PATIENCE", 0.0)
    sim._pace = simulation.Pace(alone=1e-12)  # nothing is as fast


@contextmanager
def few_lanes():
    """Cells of 2 lanes in simulations made meanwhile: they compile in a third of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulation, "LANES", 2)
        yield


@contextmanager
def room_for_clicks(count):
    """Room for `count` particles that clicks add, in simulations made meanwhile."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulation, "SPAWN_CAPACITY", count)
        yield


def not_starting(monkeypatch, instead):
    """Call `instead` where a run would start Taichi."""
    monkeypatch.setattr(runtime, "start", instead)
