"""What Python programs and notebooks see of a simulation."""

import io
import subprocess
import sys
import types

import numpy as np
import pytest
from PIL import Image

import taichi_cloth as tc
from taichi_cloth.errors import SimulationFailure
from taichi_cloth.scene import library
from taichi_cloth.ui import app, showing

CLOTH = library.build("cloth", columns=4, rows=3)


@pytest.fixture
def notebook(monkeypatch):
    """As a kernel has it: IPython is there, and the shell has a kernel."""
    ipython, display = types.ModuleType("IPython"), types.ModuleType("IPython.display")
    shell = types.SimpleNamespace(kernel=True)
    ipython.get_ipython, ipython.display = lambda: shell, display
    display.Image = lambda data, format: (data, format)
    monkeypatch.setitem(sys.modules, "IPython", ipython)
    monkeypatch.setitem(sys.modules, "IPython.display", display)
    return shell


def test_pictures_of_planes_and_spaces(pool):
    flat, deep = pool(CLOTH), pool(library.build("box", particles=3))
    first = tc.picture(flat, size=(90, 60))
    assert first.shape == (60, 90, 3) and first.dtype == np.uint8
    assert (first == tc.picture(flat, size=(90, 60))).all()
    assert (first != tc.picture(flat, size=(90, 60), parts="surface")).any()
    with_status, without = (tc.picture(flat, size=(240, 180), status=s) for s in (True, False))
    assert (with_status != without).any()
    flat.advance(3)
    assert (first != tc.picture(flat, size=(90, 60))).any()
    camera = tc.camera_of(deep.scene)
    before = tc.picture(deep, size=(80, 80), camera=camera)
    camera.rotate(40.0, 10.0)
    assert (before != tc.picture(deep, size=(80, 80), camera=camera)).any()
    assert tc.picture(deep).shape[2] == 3


def test_a_script_runs_what_it_shows(pool, capsys):
    sim, seen = pool(CLOTH), []
    summary = tc.show(sim, view="none", frames=5, on_frame=lambda sim: seen.append(sim.frame))
    assert (summary.frames, summary.quit, seen) == (5, False, [0, 1, 2, 3, 4])
    ended = tc.show(sim, view="none", on_frame=lambda sim: sim.frame < 7)
    assert (ended.frames, ended.quit, sim.frame) == (2, True, 7)

    def cut(sim):
        sim.cut([0])

    tc.show(sim, view="none", frames=1, on_frame=cut)
    assert not sim.springs_alive()[0]
    assert sim.show(frames=1, view="none").frames == 1  # no notebook: the same


def test_windows_of_scripts_say_why_a_run_failed(pool, monkeypatch):
    """As those of the command line do, with calls in the place of flags."""
    sim = pool(CLOTH, dt=5.0)
    monkeypatch.setattr(app, "run", lambda sim, view, **asked: asked["examiner"])
    examiner = tc.show(sim, view="none", frames=1)
    with pytest.raises(SimulationFailure):
        sim.advance(200)
    finding = examiner.examine(lambda words: None, tries=True)
    assert finding.numerical and finding.settings["substeps"] > 1


def test_windows_of_scripts_measure_errors(pool, monkeypatch):
    """When asked to, by a key; until then nobody listens."""
    sim = pool(CLOTH)
    monkeypatch.setattr(app, "run", lambda sim, view, **asked: asked["errors"])
    errors = tc.show(sim, view="none", frames=1)
    assert not errors.on and not sim.listeners
    errors.switch()
    assert errors.on and sim.listeners
    errors.close()
    assert not sim.listeners


@pytest.mark.parametrize(
    "how, error",
    [
        ({"size": (0, 10)}, "size: width must be"),
        ({"size": 7}, "size: must be a width and a height"),
        ({"parts": "skin"}, "unknown word 'skin'"),
        ({"parts": []}, "parts: must be some of"),
        ({"frames": 0}, "show: frames must be"),
        ({"view": "x"}, "unknown view 'x'"),
        ({"view": 3}, "unknown view '3'; known: auto, ggui, gui, none"),
        ({"parts": 3}, "parts: must be some of"),
        ({"camera": (1, 2)}, r"show: camera must be a Camera, is \(1, 2\)"),
        ({"on_frame": 3}, "show: on_frame must be a function, is 3"),
        ({"status": "no"}, "show: status must be True or False, is 'no'"),
        ({"paused": 1}, "show: paused must be True or False, is 1"),
    ],
)
def test_what_makes_no_sense_is_refused(pool, how, error):
    with pytest.raises(tc.InputError, match=error):
        tc.show(pool(CLOTH), **{"view": "none", "frames": 1, **how})


@pytest.mark.parametrize("how", [{"camera": 3}, {"status": 1}])
def test_pictures_and_films_refuse_what_windows_do(pool, how):
    for name, draw in (("picture", tc.picture), ("film", lambda *a, **k: showing.film(*a, 1, **k))):
        with pytest.raises(tc.InputError, match=f"{name}: {next(iter(how))} must be"):
            draw(pool(CLOTH), **how)


@pytest.mark.parametrize("what", [CLOTH, "cloth", None])
@pytest.mark.parametrize("show", [tc.show, tc.picture, lambda what: showing.film(what, 1)])
def test_what_is_no_simulation_is_refused(show, what):
    with pytest.raises(
        tc.InputError, match=r"must be given a Simulation, is .*; Simulation\(scene"
    ):
        show(what)


def test_a_notebook_gets_a_picture_or_a_film(pool, notebook):
    sim = pool(CLOTH)
    data, kind = sim.show(size=(60, 40))
    assert kind == "png" and Image.open(io.BytesIO(data)).size == (60, 40)
    data, kind = sim.show(frames=6, size=(60, 40))
    film = Image.open(io.BytesIO(data))
    assert (kind, film.size, film.n_frames, sim.frame) == ("gif", (60, 40), 5, 6)
    assert Image.open(io.BytesIO(sim._repr_png_())).format == "PNG"
    del notebook.kernel  # a terminal's IPython
    assert sim.show(frames=1, view="none").frames == 1


def test_to_import_the_package_imports_no_numpy():
    """It says first how NumPy's threads wait, which that reads once."""
    program = "import sys, taichi_cloth; print('numpy' in sys.modules)"
    answer = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert answer.stdout.strip() == "False", answer.stderr
