"""CONTRIBUTING.md, followed to the letter in a copy of the package: its files are all it takes."""

import csv
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
TEXT = (ROOT / "CONTRIBUTING.md").read_text()
FILES = dict(
    re.findall(r"[Aa]s `(taichi_cloth/[\w/]+\.py)`:\n\n```python\n(.*?)^```", TEXT, re.M | re.S)
)
STEPS = re.findall(r"^   ```text\n(.*?)^   ```", TEXT, re.M | re.S)

# Beside the declarations' own tests: all run on both topologies, and agree.
RUNS = """
import numpy as np
from dataclasses import replace
import taichi_cloth as tc
from taichi_cloth.simulation.diagnostics import acceleration_at_start

tc.start(arch="cpu", precision="f64", threads=1)
scene = tc.scenes.build("tissue")


def run(scene, method, topology, **how):
    sim = tc.Simulation(scene, method, topology=topology, execution="serial", lanes=2, **how)
    before = sim.energy()
    assert before.potential["trap"] > 0
    sim.advance(20)
    return sim, before.total


for method in ("midpoint", "implicit_midpoint"):
    ends = []
    for topology in ("lanes", "graph"):
        sim, before = run(scene, method, topology, substeps=8)
        assert abs(sim.energy().total - before) < 2e-3 * abs(before), method
        ends.append(sim.positions())
    np.testing.assert_allclose(*ends, rtol=0, atol=1e-7)

creeping = replace(scene, springs=replace(scene.springs, creep=np.full(len(scene.springs), 0.05)))
ends = []
for topology in ("lanes", "graph"):
    sim, _ = run(creeping, "symplectic_euler", topology)
    rest = sim.storage.snapshot().scene.springs.rest_length
    a, b = sim.springs().T
    x = sim.positions()
    apart = np.linalg.norm(x[b] - x[a], axis=1)
    assert (abs(rest - 10) > 1e-3).all()  # it crept, with its spring
    assert np.corrcoef(rest, apart)[0, 1] > 0.5
    ends.append(np.column_stack([x[a], x[b], rest]))
np.testing.assert_allclose(*ends, rtol=0, atol=1e-11)
rigid, _ = run(scene, "symplectic_euler", "graph")
assert abs(rigid.positions() - x).max() > 1e-3

p, free = scene.particles, scene.with_world(more={})
pulled = acceleration_at_start(scene) - acceleration_at_start(free)
expected = -scene.world.more["trap"] * (p.position - 100) / p.mass[:, None]
np.testing.assert_allclose(pulled, expected, rtol=0, atol=1e-12)
assert abs(expected).max() > 0.1
"""


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    """A copy of the package with what CONTRIBUTING adds; the environment that uses it."""
    folder = tmp_path_factory.mktemp("copy")
    ignore = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "taichi_cloth", folder / "taichi_cloth", ignore=ignore)
    assert len(FILES) == 4 and not any((folder / name).exists() for name in FILES)
    for name, text in FILES.items():
        (folder / name).write_text(text)
    declared, rows = STEPS
    properties = folder / "taichi_cloth/scene/properties.py"
    before, after = properties.read_text().split("\n\n\nPARTICLE_PROPERTIES = ")
    properties.write_text(f"{before}\n    {declared.strip()}\n\n\nPARTICLE_PROPERTIES = {after}")
    numbers = folder / "taichi_cloth/kernels/spring_numbers.py"
    rest, creep = (line.strip() for line in rows.splitlines())
    text = re.sub(r'SpringNumber\("rest".*\),', rest, numbers.read_text())
    numbers.write_text(text.replace("\n)\nK, REST, C", f"\n    {creep}\n)\nK, REST, C"))
    return {**os.environ, "PYTHONPATH": str(folder)}


def python(environment, *arguments, cwd):
    done = subprocess.run(
        [sys.executable, *map(str, arguments)],
        env=environment,
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=500,
    )
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    return done.stdout


def test_they_run_on_both_topologies(copy, tmp_path):
    python(copy, "-c", RUNS, cwd=tmp_path)


def test_they_are_listed_and_their_keys_are_checked(copy, tmp_path):
    shown = python(copy, "-m", "taichi_cloth", "run", "tissue", "--help", cwd=tmp_path)
    assert "--trap" in shown
    (tmp_path / "a.toml").write_text("[world]\nsize = [9.0, 9.0]\ntrap = -1.0\n")
    script = "import taichi_cloth as tc; tc.load_scene('a.toml')"
    with pytest.raises(AssertionError, match="a.toml line 3: .*trap must be at least 0"):
        python(copy, "-c", script, cwd=tmp_path)


@pytest.mark.thorough
def test_they_pass_what_declarations_are_held_to(copy):
    tests = ROOT / "tests" / "test_forces.py"
    python(copy, "-m", "pytest", "-q", "-p", "no:cacheprovider", tests, cwd=ROOT)


@pytest.mark.thorough
def test_explain_shows_the_force_and_trade_measures_the_method(copy, tmp_path):
    how = ["--topology", "graph", "--execution", "serial"]
    command = ["-m", "taichi_cloth", "explain", "tissue", "--within", "110s", "--json", *how]
    explained = json.loads(python(copy, *command, cwd=tmp_path))
    (trap,) = [cost for cost in explained["costs"] if cost["feature"] == "trap"]
    assert trap["used"] and trap["seconds"] is not None and trap["bytes"] > 0
    (creep,) = [cost for cost in explained["costs"] if cost["feature"] == "creep"]
    assert not creep["used"] and creep["bytes"] > 0

    command = ["-m", "taichi_cloth", "trade", "tissue", "--within", "110s", "--output", "out"]
    command += ["--methods", "midpoint,rk4", "--precisions", "f64"]
    command += ["--frames", 20, "--substeps", "2,4,8"]
    python(copy, *command, *how, cwd=tmp_path)
    with open(tmp_path / "out" / "trade.csv") as file:
        rows = [row for row in csv.DictReader(file) if row["method"] == "midpoint"]
    errors = [float(row["error_trajectory_relative"]) for row in rows]
    assert len(errors) == 3 and errors[0] > errors[1] > errors[2] < 1e-3
    assert float(rows[-1]["order"]) == pytest.approx(2, abs=0.1)
