"""How a load fills fields: their memory, where the device is a processor, and a kernel elsewhere.

`kernels/memory.py`, `kernels/transfer.py`. That runs are the same on all devices is
`test_agreement.py`'s.
"""

from types import SimpleNamespace

import inside
import numpy as np
import pytest
import small
import taichi as ti
from selection import as_thorough

from taichi_cloth.kernels import readback
from taichi_cloth.kernels.memory import shape_of
from taichi_cloth.kernels.transfer import Transfer
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.simulation.storage import layouts

# What has fields of every shape: packed rows, springs and particles by colour, lanes with lines and
# springs of no grid, air, faces and cloths with a thickness, what obstacles hold.
STORED = [
    ("cloth", "verlet", "graph"),
    ("cloth", "xpbd", "graph"),
    ("cloth", "vbd", "graph"),
    ("flag", "implicit_euler", "graph"),
    as_thorough(("curtain", "xpbd", "lanes")),
    as_thorough(("pull", "verlet", "graph")),
]


@pytest.fixture
def sim(device, scene, method, topology, monkeypatch):
    monkeypatch.setattr(layouts, "WORTH_SORTING", 0)  # rows are packed however few there are
    monkeypatch.setattr(layouts, "WORTH_PACKING", 0)
    return Simulation(small.build(scene), method, topology=topology)


def fields_of(state):
    """All fields of a state, by name."""
    parts = {of: getattr(state, of) for of in ("surface", "elements") if hasattr(state, of)}
    return {
        f"{of}.{name}": field
        for of, part in {"state": state, **parts}.items()
        for name, field in vars(part).items()
        if isinstance(field, ti.Field) and name not in ("sums", "contact_energy", "contact_balance")
    }


def by_kernel():
    """A transfer as on a device whose memory the host does not share."""
    return Transfer(SimpleNamespace(memory=None, batches={}))


ON_EACH = pytest.mark.parametrize(("scene", "method", "topology"), STORED)


@ON_EACH
def test_the_memory_of_each_field_is_its_own(sim):
    """What a kernel writes to all fields stands in the memory of each, and the other way round."""
    state, rng = inside.state_of(sim), np.random.default_rng(0)
    fields, to = fields_of(state), by_kernel()
    written = {name: rng.integers(1, 1 << 20, shape_of(field)) for name, field in fields.items()}
    for name, field in fields.items():
        to.put(field, written[name])
    to.bring(sim.storage._launcher.launch)
    for name, field in fields.items():
        np.testing.assert_array_equal(state.memory.of(field), written[name], name)
    x = state.memory.of(state.x)
    x.reshape(-1)[:] = np.arange(x.size)
    assert state.x.to_numpy().ravel().tolist() == list(range(x.size))


@ON_EACH
def test_a_load_is_the_same_by_a_kernel(sim):
    """Whatever stood there before: all rows that are in use are filled."""
    state, storage = inside.state_of(sim), sim.storage
    fields, found = fields_of(state), []
    for rubbish, to in ((0, Transfer(state)), (7, Transfer(state)), (7, by_kernel())):
        for field in fields.values():
            state.memory.of(field)[...] = rubbish
        upload = storage._upload()
        vars(upload)["_to"] = to
        upload.numbers(storage._now.numbers)
        upload.all()
        found.append({name: state.memory.of(field).copy() for name, field in fields.items()})
    clean, filled, taken = found
    for name in fields:
        np.testing.assert_array_equal(filled[name], taken[name], name)
        # What is filled is filled alike, and the rest is left alone.
        touched = filled[name] != 7
        np.testing.assert_array_equal(clean[name][touched], filled[name][touched], name)


@ON_EACH
def test_the_host_reads_what_kernels_do(sim, monkeypatch):
    """Positions and velocities, however they are stored, and which springs are whole."""
    sim.advance()
    sim.cut([0, 5, 7])
    found = []
    for few in (readback.FEW, 0):
        monkeypatch.setattr(readback, "FEW", few)
        monkeypatch.setattr(readback, "FEW_MARKS", few)
        assert readback.is_by_host(inside.state_of(sim), 1) == (few > 0)
        read = sim.storage.positions(), sim.storage.velocities(), sim.storage.marks()
        found.append((*read, sim.storage.drawn_positions().copy(), sim.storage.count_broken()))
    for by_host, by_kernel in zip(*found, strict=True):
        np.testing.assert_array_equal(by_host, by_kernel)


def test_a_solvers_counts_are_the_same_from_memory_and_by_a_kernel(device, monkeypatch):
    sim, work = Simulation(small.build("cloth"), "tr_bdf2", topology="graph"), []
    for memory in (inside.state_of(sim).memory, None):
        sim.reset()
        with monkeypatch.context() as patch:
            patch.setattr(inside.state_of(sim), "memory", memory)
            sim.advance(2)
        work.append(sim.work())
    assert work[0] == work[1] and work[0].steps == 2 and work[0].sweeps > 0
