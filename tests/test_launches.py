"""A launch for each step and each phase, as GPUs but CUDA's are run (`kernels/loops.py`), on a CPU.

What goes on until it has settled comes to the same as in launches of whole frames.
"""

from dataclasses import replace

import inside
import numpy as np
import pytest
from cloths import ROD, loose_sheet
from face_twins import ends_of
from gpu_twins import end
from selection import thorough

from taichi_cloth.kernels import contact_fields
from taichi_cloth.scene.obstacles import Obstacle
from taichi_cloth.simulation.launch import Launcher
from taichi_cloth.simulation.simulation import Simulation


@pytest.fixture
def by_steps(monkeypatch):
    """From here on a CPU is run as such a GPU."""

    def one_launch_per_step(self, spec, path, packs):
        return replace(spec, threads=1, one_launch_per_step=True)

    monkeypatch.setattr(Launcher, "specialize", one_launch_per_step)
    monkeypatch.setattr(contact_fields, "pairs_act_at_once", lambda: True)


SCENES = ("rod that tears", "corner", "plate, fast", "rope")


@thorough
@pytest.mark.parametrize("name", SCENES)
def test_faces_settle_to_the_same_bits(name, request):
    expected, _ = ends_of(name)
    request.getfixturevalue("by_steps")
    assert ends_of(name, execution="parallel")[0] == expected


@thorough
def test_faces_settle_beside_solvers_in_lanes(few_lanes):
    """Whose steps are several launches on a CPU, too."""
    expected = sheet_on_a_rod("implicit_euler", "graph", "serial")
    found = sheet_on_a_rod("implicit_euler", "lanes", "parallel")
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7)


def sheet_on_a_rod(method, topology, execution):
    scene = loose_sheet(Obstacle.build("capsule", **ROD), speed=2.0)
    sim = Simulation(scene, method, topology=topology, execution=execution, substeps=2)
    sim.advance(12)
    assert inside.state_of(sim).face_hits.to_numpy().any()  # some lie on the rod
    return sim.positions()


@thorough
@pytest.mark.parametrize(
    ("name", "method", "arch"),
    [
        *(("stack", "implicit_euler", arch) for arch in ("vulkan", "opengl")),
        ("trampoline", "vbd", "opengl"),
    ],
)
def test_gpus_take_the_same_turns(name, method, arch, by_steps, cli_on):
    """Where cloths rest on each other, too, whose pairs a CPU takes one after the other."""
    there = np.array(
        cli_on[arch].call("gpu_twins:end_on", arch=arch, name=name, method=method, frames=2)
    )
    here = np.array(end(name, method, 2))
    np.testing.assert_allclose(there, here, rtol=0, atol=1e-9 * np.ptp(here, axis=0).max())
