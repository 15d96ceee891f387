"""What comes of scenes in steps so short that their changes are lost in f32: for any precision."""

import numpy as np
import pytest
from pool import Pool

from taichi_cloth import runtime
from taichi_cloth.errors import SimulationFailure
from taichi_cloth.scene.library import build

FRAMES, COARSE, FINE = 48, 8, 8 * 32
SCENES = {
    "oscillator": lambda: build("oscillator"),
    "chain": lambda: build("chain"),
    "cloth": lambda: build("cloth", columns=8, rows=6),
}


def ends(cases, pool):
    """Positions after FRAMES frames of COARSE and of FINE steps, by case."""
    found = {}
    for case in cases:
        scene, method, topology, execution = case
        for substeps in (COARSE, FINE):
            how = {"topology": topology, "execution": execution}
            sim = pool(SCENES[scene]().with_world(walls=()), method, substeps=substeps, **how)
            sim.advance(FRAMES)
            found[" ".join([*case, str(substeps)])] = sim.positions().tolist()
    return found


def ends_in(precision, cases):
    """The same in another precision: for a process of its own."""
    runtime.start("cpu", precision, threads=2)
    return ends(cases, Pool())


def undone():
    """Whether a frame that fails leaves no trace in a state that f32 alone could not hold.

    For a process of its own.
    """
    runtime.start("cpu", "compensated", threads=2)
    sim = Pool()(SCENES["cloth"]())
    sim.advance(3)
    before = sim.positions(), sim.velocities()
    sim.blow((300.0, 150.0), (1e9, 0.0))
    with pytest.raises(SimulationFailure):
        sim.advance()
    after = sim.positions(), sim.velocities()
    assert (before[0] != before[0].astype(np.float32)).mean() > 0.5
    return all(bool((a == b).all()) for a, b in zip(before, after, strict=True))
