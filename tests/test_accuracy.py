"""docs/accuracy.md: its numbers are measured, its table has every method."""

import contextlib
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from selection import mostly_thorough, thorough

from bench.accuracy import (
    command,
    experiments,
    friction,
    matrix,
    pictures,
    tables,
)
from taichi_cloth.errors import InputError
from taichi_cloth.kernels import methods
from taichi_cloth.limits import modes
from taichi_cloth.settings.options import PRECISIONS, TOPOLOGIES
from taichi_cloth.sweeps import journal

ROOT = Path(__file__).parent.parent
DOCUMENT = ROOT / "docs" / "accuracy.md"
HERTZ = (1.0, 5.0, 10.0)


@pytest.mark.usefixtures("device")
@pytest.mark.parametrize("method", mostly_thorough(methods.METHODS, default=["verlet", "tr_bdf2"]))
def test_measured_damping_and_pitch_are_those_of_the_discrete_map(method):
    module = methods.load(method)
    for f, measured in zip(HERTZ, experiments.measured_swings(method, HERTZ), strict=True):
        theory = experiments.swing(module, f)
        assert measured.kept == pytest.approx(theory.kept, rel=1e-9, abs=1e-10)
        assert measured.pitch == pytest.approx(theory.pitch, abs=1e-9)
        h, omega = 1 / experiments.RATE, 2 * math.pi * f
        assert theory.kept == pytest.approx(modes.growth(module, h, omega**2, 0.0) ** 60)


def test_damping_is_that_of_the_textbooks():
    """Hairer, Wanner II, IV.3: with w = h omega, what a step leaves of an amplitude."""

    def kept(method, w):
        return experiments.swing(methods.load(method), w / (2 * math.pi), rate=1).kept

    for w in (0.1, 0.5, 1.5):
        for method in ("implicit_euler", "xpbd", "vbd"):
            assert kept(method, w) == pytest.approx(1 / math.sqrt(1 + w * w))
        assert kept("explicit_euler", w) == pytest.approx(math.sqrt(1 + w * w))
        for method in ("symplectic_euler", "verlet", "implicit_midpoint"):
            assert kept(method, w) == pytest.approx(1.0)
        assert kept("rk4", w) == pytest.approx(math.sqrt(1 - w**6 / 72 + w**8 / 576))
    # The pitch: sin(w'/2) = w/2 of the leapfrog, tan(w'/2) = w/2 of the midpoint rule.
    for method, exact in (("verlet", math.asin), ("implicit_midpoint", math.atan)):
        swing = experiments.swing(methods.load(method), 1 / (2 * math.pi), rate=1)
        assert 1 + swing.pitch == pytest.approx(2 * exact(0.5))


@thorough
def test_a_second_order_method_is_measured_as_one(device):
    found = experiments.orders(["verlet"])["verlet"]
    assert found["chain"] == pytest.approx(2, abs=0.05) and found["cloth"] == pytest.approx(
        2, abs=0.1
    )


@thorough
def test_a_contact_with_friction_leaves_the_orders_that_the_document_has(device):
    """Two of a body that lands, slides or stays, to the bit; one of a cloth."""
    for name, order in (("verlet", 2), ("symplectic_euler", 1)):
        found = friction.orders_with_friction([name])[name]
        for kind in ("before", "at", "past", "stuck"):
            assert found[kind] == pytest.approx(order, abs=0.15), kind
        assert found["cloth_before"] == pytest.approx(order, abs=0.1)
        assert found["cloth"] == pytest.approx(1, abs=0.35) and found["creep"] == 0.0


def test_the_landing_on_a_slope_solves_its_equation():
    """The closed form against steps so short that their order does not matter."""
    for mu in (friction.SLIDES, friction.STICKS):
        scene = friction.bodies(mu)
        times = friction.DT * np.arange(1, friction.FRAMES + 1)
        ways, landed = friction.exact(scene, mu, times)
        assert landed.min() > friction.BEFORE * friction.DT and landed.max() < times[-8]
        start = scene.particles.position - friction.FOOT
        height, s = start @ friction.NORMAL - friction.RADIUS, start @ friction.DOWN
        u, w, lies = 0.0 * height, 1.5 + 0.0 * s, height < 0
        pull, along = (friction.G * f(friction.SLOPE) for f in (np.cos, np.sin))
        steps = 6000
        h = times[-1] / steps
        for _ in range(steps):
            new_u = np.where(lies, 0.0, u - h * (pull + friction.DRAG * u))
            new_w = w + h * (along - friction.DRAG * w - lies * mu * pull)
            new_w = np.where(lies, np.maximum(new_w, 0.0), new_w)
            height, s = height + h * (u + new_u) / 2, s + h * (w + new_w) / 2
            hit = (height < 0) & ~lies
            w = np.where(hit, np.maximum(new_w + mu * new_u, 0.0), new_w)
            u, height, lies = (
                np.where(hit, 0.0, new_u),
                np.where(hit | lies, 0.0, height),
                lies | hit,
            )
        x = friction.FOOT + np.outer(height + friction.RADIUS, friction.NORMAL)
        x += np.outer(s, friction.DOWN)
        np.testing.assert_allclose(x, ways[-1], rtol=0, atol=2e-3)


def results():
    """Those that the document shows: of the machine that it was written on."""
    (path,) = (ROOT / "bench" / "results").glob("*-accuracy.json")
    return command.read(path)


def test_the_document_is_made_from_the_results():
    text, kept = DOCUMENT.read_text(), results()
    assert set(kept) == set(command.PARTS)
    assert tables.filled(text, kept) == text
    for part in command.PARTS:
        assert kept[part]["command"] in text
    drawn = re.findall(r"\]\(images/(accuracy-\w+)\.png\)", text)
    assert len(drawn) >= 3
    assert all((DOCUMENT.parent / "images" / f"{name}.png").is_file() for name in drawn)


def test_the_matrix_is_made_from_the_results_and_has_every_cell():
    text, kept = (ROOT / "docs" / "matrix.md").read_text(), results()
    assert tables.filled(text, kept) == text
    data = kept["matrix"]["data"]
    assert list(data) == list(matrix.SCENES)
    for name, of in data.items():
        most = 0.5 if name in ("box", "sandbox") else 0.1  # crowds, whose order chance decides
        assert set(of["cells"]) == set(methods.METHODS)
        for cells in of["cells"].values():
            assert len(cells) == len(TOPOLOGIES) * len(PRECISIONS)
            for cell in cells.values():
                assert cell.get("refused") or cell["error"] < most, name


@thorough
def test_a_cell_is_an_error_or_says_why_it_is_refused(monkeypatch):
    names = ["symplectic_euler", "rk4"]
    found = matrix.matrix(["oscillator", "net"], names, ["f32", "f64"])
    assert [list(of["cells"]) for of in found.values()] == [names, names]
    chain, net = (found[name]["cells"] for name in ("oscillator", "net"))
    assert "no regular grid" in chain["rk4"]["lanes f64"]["refused"]
    assert (
        chain["rk4"]["graph f64"]["error"] < 1e-4 < chain["symplectic_euler"]["graph f64"]["error"]
    )
    for topology in TOPOLOGIES:
        assert net["rk4"][f"{topology} f64"]["error"] < 1e-6
        assert 1e-7 < net["rk4"][f"{topology} f32"]["error"] < 1e-3
        assert 1e-3 < net["symplectic_euler"][f"{topology} f32"]["error"] < 0.1
    # One cell takes all the time that a scene has; then one takes longer than it may.
    graph = (["oscillator"], names, ["f64"], ["graph"])
    first, second = matrix.matrix(*graph, budget=0.0)["oscillator"]["cells"].values()
    assert first["graph f64"]["error"] > 0 and "together" in second["graph f64"]["not measured"]
    # What was measured is kept, and the rest measured; not where the scene was run differently.
    kept = {"oscillator": matrix.matrix(*graph, budget=0.0)["oscillator"]}
    kept["oscillator"]["cells"]["symplectic_euler"]["graph f64"]["error"] = 0.5
    again = matrix.matrix(*graph, kept=kept)["oscillator"]["cells"]
    assert again["symplectic_euler"]["graph f64"]["error"] == 0.5
    assert again["rk4"]["graph f64"]["error"] < 1e-6
    kept["oscillator"]["frames"] += 1
    again = matrix.matrix(*graph, kept=kept)["oscillator"]["cells"]
    assert again["symplectic_euler"]["graph f64"]["error"] < 1e-2
    monkeypatch.setattr(matrix, "PATIENCE", 1e-3)
    for cells in matrix.matrix(*graph)["oscillator"]["cells"].values():
        assert cells["graph f64"] == matrix.TOO_SLOW


class _Measured:
    """In place of a matrix's processes: cells with errors of their own, until it is killed."""

    def __init__(self, cells):
        self.cells, self.seen = cells, []

    def __call__(self, folder, precision):
        return contextlib.nullcontext(self)

    def exact(self, name):
        return ""

    def cell(self, method, **asked):
        if len(self.seen) == self.cells:
            raise KeyboardInterrupt
        self.seen.append(method)
        return {"error": len(method) / 100}, 1.0


def test_cells_of_a_killed_matrix_are_not_measured_again(tmp_path, monkeypatch):
    """From the first on, which a journal begins with."""
    names = ("rk4", "verlet", "tr_bdf2")
    asked = {"scenes": ["oscillator"], "names": names, "precisions": ["f64"]}
    asked["topologies"] = ["graph"]
    first, rest = _Measured(2), _Measured(3)
    monkeypatch.setattr(matrix, "_Process", first)
    with pytest.raises(KeyboardInterrupt), journal.kept(tmp_path, {}, False) as begun:
        matrix.matrix(**asked, journal=begun)
    monkeypatch.setattr(matrix, "_Process", rest)
    with journal.kept(tmp_path, {}, True) as resumed:
        found = matrix.matrix(**asked, journal=resumed)
    assert len(first.seen) == 2 and sorted(first.seen + rest.seen) == sorted(names)
    cells = found["oscillator"]["cells"]
    assert {name: cells[name]["graph f64"]["error"] for name in names} == {
        name: len(name) / 100 for name in names
    }


def test_its_table_has_a_row_for_every_method_and_says_what_was_measured():
    kept = results()
    table = re.search(r"<!-- accuracy:methods -->\n(.*?)<!-- end -->", DOCUMENT.read_text(), re.S)[
        1
    ]
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in table.splitlines()]
    by_method = {row[0].strip("`"): row for row in rows[2:]}
    assert set(by_method) == set(methods.METHODS) and len(rows) == len(methods.METHODS) + 2
    for name, row in by_method.items():
        claims = methods.load(name).claims
        chain, cloth = map(float, row[1].split(", "))
        assert abs(chain - claims.order) <= 0.05 and abs(cloth - claims.order) <= 0.1
        assert row[-1] == claims.choose and claims.choose.endswith(".")
        for f, measured in kept["damping"]["data"][name].items():
            theory = experiments.swing(methods.load(name), float(f))
            np.testing.assert_allclose(measured["kept"], theory.kept, rtol=1e-5, atol=1e-9)


def test_pictures_are_drawn_from_results():
    kept = results()
    part = {name: kept[name] for name in ("stiff", "damping")}
    drawn = pictures.draw_all(part)
    assert set(drawn) == {"accuracy-stiff", "accuracy-damping"}
    assert all(content.startswith(b"\x89PNG") for content in drawn.values())


def test_what_is_missing_is_said_in_a_line(tmp_path, capsys):
    document = tmp_path / "a.md"
    document.write_text("<!-- accuracy:methods -->\n<!-- end -->\n")
    assert command.main(["coststs"]) == 2
    assert "did you mean 'costs'" in capsys.readouterr().err
    assert command.main(["--tables", str(tmp_path / "none.md")]) == 2
    assert command.main(["--tables", str(document), "--output", str(tmp_path)]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 2
    with pytest.raises(InputError, match="part 'damping'"):
        tables.filled(document.read_text(), {"orders": {"data": {}}})
    command.keep(tmp_path / "r.json", "orders", {"data": {"a": [1 / 3]}})
    command.keep(tmp_path / "r.json", "events", {"data": 1})
    assert json.loads((tmp_path / "r.json").read_text())["orders"]["data"] == {"a": [0.333333]}
