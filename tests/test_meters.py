"""Meters and strain colours as they are drawn: legible at every size, cheap, alike in every run."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from taichi_cloth.render import style
from taichi_cloth.render.picture import Rect
from taichi_cloth.scene.library import build
from taichi_cloth.scene.model import Particles, Scene, Springs, World
from taichi_cloth.simulation.gauges import Gauges
from taichi_cloth.simulation.history import History
from taichi_cloth.simulation.strain import CLOTHS, allowed, borne, lengths, strains
from taichi_cloth.ui import strained
from taichi_cloth.ui.chrome import graphs, instruments, meters
from taichi_cloth.ui.chrome.beside import DistanceReading
from taichi_cloth.ui.chrome.errors import ErrorReading
from taichi_cloth.ui.chrome.instruments import Source
from taichi_cloth.ui.chrome.layout import Parts, arrange
from taichi_cloth.ui.chrome.meters import Meters


@pytest.fixture(scope="module")
def source(device):
    """All meters of a cloth that has run for 3 seconds.

    Frame times, errors and the distance of a second run are made up.
    """
    from taichi_cloth.simulation.simulation import Simulation

    sim = Simulation(build("cloth", columns=8, rows=6), "symplectic_euler", topology="graph")
    gauges, times = Gauges(sim, paced=False), History(10.0, 1200, 3)
    for frame in range(180):
        if frame in (60, 61):
            sim.blow([180.0, 60.0], [90.0, 20.0])
        gauges.before_frame()
        sim.advance(1)
        times.note(frame / 60, 0.002 + 0.001 * (frame % 3), 0.008, 0.004)
        gauges.after_frame(frame / 60)
    said = "0.8 % (0.3)", ("solver 0.1 %", "f32 0.01 %", "holds 4.2 s", "1 s old"), style.INK
    error = ErrorReading(*said, np.array([2.0, 1.0, 1.0, 0.0]), np.array([0.01, 0.01, 0.02, 0.02]))
    said = "0.22 % (0.08)", ("mean 0.3 %", "largest 0.6 %"), style.INK
    apart = DistanceReading(*said, error.age, error.relative, 2 * error.relative)
    return Source(sim, gauges, times, 179 / 60, error, apart)


def test_a_column_is_legible_at_every_size(source):
    """No word is cut off, and the first meters stay where there is little room."""
    made = [make(source) for make in instruments.ALL]
    assert all(made)
    for size in ((800, 600), (1280, 800), (1920, 1080), (2560, 1440)):
        layout = arrange(size, Parts(bar=True, strip=1, columns=("meters",)))
        rect, height = layout.columns["meters"], layout.text
        panel = meters.drawn(made, rect, height)
        assert panel.tile.pixels.shape == (rect.height, rect.width, 3)
        edges = (
            panel.tile.pixels[[0, -1]].reshape(-1, 3),
            panel.tile.pixels[:, [0, -1]].reshape(-1, 3),
        )
        assert all((edge == style.PAPER).all() for edge in edges)
        said = panel.words.split("\n")
        assert all(meter.title in said and meter.value in said for meter in made)
    for width in (220, 480):
        for height in (12, 30):
            panel = meters.drawn(made, Rect(0, 0, width, 12 * height), height)
            said = panel.words.split("\n")
            assert said[0] == "frame" and "momentum" not in said


def test_a_graph_shows_newest_values_at_its_right_edge():
    block = np.zeros((50, 100, 3), np.uint8)
    age, value = np.array([10.0, 5.0, 0.0]), np.array([0.0, 0.0, 1.0])
    curve, color = graphs.Curve(age, value, (200, 0, 0)), [200, 0, 0]
    graphs.draw(block, [curve], [graphs.Line(1.0, (0, 0, 200))], (0.0, 1.0), 10.0, 2)
    lit = (block == color).all(axis=2)
    rows = np.where(lit.any(axis=0), lit.argmax(axis=0), -1)
    assert (rows[2:50] == 48).all() and rows[-1] <= 1 and (np.diff(rows[50:]) <= 0).all()
    assert (block[0, 10] == [0, 0, 200]).all()
    # Between readings nothing is known of, and after the last, it is not on a line.
    value = np.array([1.0, 1.0, np.nan, 0.0, 0.0, np.nan])
    curve = graphs.Curve(np.array([8.0, 6.0, 5.9, 4.0, 2.0, 1.9]), value, (200, 0, 0))
    graphs.draw(block, [curve], [], (0.0, 1.0), 10.0, 2)
    lit = (block == color).all(axis=2)
    assert lit[0, 22:38].all() and lit[48, 62:78].all() and lit[:, :18].sum() == 0
    assert not (lit[:, 44:58].any() or lit[:, 84:].any())
    for low, high in ((0.0, 3.3), (-2.0, 7.0), (0.96, 1.0), (-3e-4, 0.0), (5.0, 5.0)):
        bottom, top = graphs.scale(low, high)
        assert bottom <= low <= high <= top and top - bottom <= 2 * max(high - low, high)


def test_without_a_window_the_same_run_has_the_same_meters(source):
    """No frame times, and nothing else that the clock decides."""
    sim, blocks = source.sim, []
    for _ in range(2):
        sim.reset()
        shown = Meters(sim, windowed=False)
        for _ in range(30):
            shown.before_frame()
            sim.advance(1)
            shown.frame(0.01 * np.random.rand(), 0.0, 0.0)
        blocks.append(shown.panel(Rect(0, 0, 300, 700), 15))
    assert "frame" not in blocks[0].words.split("\n")
    assert np.array_equal(blocks[0].tile.pixels, blocks[1].tile.pixels)


def test_colours_go_from_pushed_to_the_limit(source):
    """Of springs by what they bear, of a particle by that of its springs which bears most."""
    x = np.array([[0.0, 0.0], [1.0, 0.0], [1.5, 0.0], [3.0, 0.0]])
    springs = Springs.build(
        [(0, 1), (1, 2), (2, 3)], x, stiffness=2.0, rest_length=[1.0, 1.0, 1.0],
        break_force=[1.0, 2.0, np.inf],
    )  # fmt: skip
    length = lengths(x, springs.between)
    assert strains(length, springs) == pytest.approx([0.0, -0.5, 0.5])
    assert borne(length, springs) == pytest.approx([0.0, -0.5, 5.0])
    # What breaks in tension alone is compared with a cloth's strain where it is pushed.
    of_cloth = replace(springs, break_in=np.full(3, "tension"))
    assert borne(length, of_cloth) == pytest.approx([0.0, -5.0, 5.0])
    calm, pushed, limit = strained.colors(np.array([0.0, -1.0, 7.0]))
    assert tuple(calm) == strained.CALM and tuple(pushed) == strained.PUSHED
    assert tuple(limit) == strained.LIMIT
    sim = source.sim
    position, holding = sim.positions(), sim.drawn_springs()
    of_springs, of_particles = strained.Strained(sim).colors(position, holding, len(position))
    some = holding[3:9]
    assert np.array_equal(
        strained.Strained(sim).colors(position, some, len(position))[0], of_springs[3:9]
    )
    bears = borne(lengths(position, holding), sim.scene.springs.select(sim.springs_alive()))
    ends = (holding == 5).any(axis=1)
    most = bears[ends][np.abs(bears[ends]).argmax()]
    assert np.array_equal(of_particles[5], strained.colors(np.array([most]))[0])


def test_what_is_stretched_from_the_start_is_full_at_that():
    """A slinky that hangs would be all red at a cloth's tenth; its colours tell top from bottom."""
    for name, full in (("slinky", 0.8), ("warp", CLOTHS)):
        scene = build(name)
        x, springs = scene.particles.position, scene.springs
        assert allowed(x, springs) == pytest.approx(full)
        bears = borne(lengths(x, springs.between), springs, allowed(x, springs))
        assert bears.max() == pytest.approx(1.0 if name == "slinky" else 0.0)
        fake = SimpleNamespace(scene=scene, storage=SimpleNamespace(scene=scene))
        assert strained.Strained(fake).legend()[-1] == (f"{100 * full:.0f} %", strained.LIMIT)


def test_the_spring_that_is_named_says_what_itself_bears(device, pool):
    """Where only the first of two can break: first it is stretched most, then the other one is.
    Nor can it by a push, where it breaks in tension alone.
    """
    world = World(size=(100.0, 100.0), gravity=(0.0, 0.0))
    for stretched, breaks_in, value, said in (
        ([1.5, 1.2], "both", "+50 %", "20 % of break force"),
        ([1.2, 1.5], "both", "+50 %", "limit 10 %"),
        ([0.5, 1.2], "both", "-50 %", "60 % of break force"),
        ([0.5, 1.2], "tension", "-50 %", "limit 10 %"),
    ):
        x = np.array([[50.0, 50.0], [51.0, 50.0], [52.0, 50.0]])
        springs = Springs.build(
            [(0, 1), (1, 2)], x, stiffness=2.0, rest_length=1 / np.array(stretched),
            break_force=[10 / 3, np.inf], break_in=breaks_in,
        )  # fmt: skip
        scene = Scene("mixed", world, Particles.build(x), springs)
        sim = pool(scene)
        gauges = Gauges(sim, paced=False)
        gauges._full = CLOTHS  # not what the scene begins with
        gauges.after_frame(0.0)
        meter = instruments.strain(Source(sim, gauges, None, 0.0))
        assert meter.value == value and meter.state == style.BAD
        assert [words for words, _ in meter.details][1] == said
        colors = strained.Strained(sim)
        colors._allowed = lambda *_: CLOTHS
        assert colors.legend()[-1][0] == "break force or 10 %"


def test_colours_follow_springs_that_were_changed(source):
    """Of other stiffness, and as many: what was kept of the ones before is no longer so."""
    sim = source.sim
    sim.reset()
    colors = strained.Strained(sim)
    for factor in (1.0, 2.0):
        sim.set(stiffness=factor * 0.25)
        length = lengths(sim.positions(), sim.drawn_springs())
        seen, _ = colors.colors(sim.positions(), sim.drawn_springs(), sim.particle_count)
        assert np.array_equal(seen, strained.colors(borne(length, sim.storage.scene.springs)))


def test_views_draw_them(device, source, tmp_path, monkeypatch):
    """A picture of the run with meters has them at the right, and strain's colours in the world."""
    from PIL import Image

    from taichi_cloth.ui import app
    from taichi_cloth.ui.view import View

    sim = source.sim
    sim.reset()
    shown = View("gui", sim.scene.world, (800, 600))
    show = frozenset({"springs", "particles", "strain"})
    path = str(tmp_path / "frame.png")
    made, advance = [], sim.advance
    monkeypatch.setattr(sim, "advance", lambda frames: (made.append(frames), advance(frames)))
    app.run(sim, shown, frames=20, quiet=True, meters=True, show=show, image=path)
    shown.close()
    assert made == [1] * 20  # as graphs show each
    picture = np.asarray(Image.open(path))
    column = arrange((800, 600), Parts(strip=2, columns=("meters",))).columns["meters"]
    beside = picture[column.y : column.y + column.height, column.x :]
    for color in (graphs.PAPER, instruments.WORK):
        assert (np.abs(beside.astype(int) - color).max(axis=2) <= 1).any()
    world = picture[: column.height, : column.x].astype(int)
    assert (np.abs(world - strained.CALM).max(axis=2) < 12).sum() > 50


def test_percentages_at_an_axis_are_written_as_those_beside_it():
    """Chains of `sandbox` are pulled to ten times their length."""
    said = [instruments.percents(value) for value in (0.0, 0.08, 20.0, 2000.0, 2e5, 3e9)]
    assert said == ["0 %", "0.08 %", "20 %", "2000 %", "200000 %", "3e9 %"]
