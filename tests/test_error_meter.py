"""The error meter: windows made again to the bit, errors as `trade` has them, its process."""

import os
import pickle
import re
import signal
import threading
from dataclasses import asdict, replace
from types import SimpleNamespace

import numpy as np
import pytest
from cloths import mixed
from commands import command

from taichi_cloth.cli import run_meter
from taichi_cloth.cli.run_meter import MeasuredErrors
from taichi_cloth.error_meter import meter as meters
from taichi_cloth.error_meter.ghost import Ghost
from taichi_cloth.error_meter.judge import Judge, _Plan
from taichi_cloth.error_meter.meter import ErrorMeter
from taichi_cloth.error_meter.others import Trial
from taichi_cloth.error_meter.verdict import Verdict
from taichi_cloth.error_meter.window import FRAMES, GHOST, LEAST, SCENE, WINDOW, Window
from taichi_cloth.errors import InputError
from taichi_cloth.render import style
from taichi_cloth.render.picture import Picture, Rect
from taichi_cloth.render.window_map import WindowMap
from taichi_cloth.scene import library
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.trade import errors, ode
from taichi_cloth.ui.chrome.meters import Meters
from taichi_cloth.ui.depiction import Depiction
from taichi_cloth.ui.ghosts import Ghosts
from taichi_cloth.ui.view import View

pytestmark = pytest.mark.usefixtures("device")


@pytest.fixture(scope="module")
def torn():
    """A cloth that flies apart, with all that springs and particles can have."""
    scene = mixed(2, mouse="blow").with_world(tools=True)
    return Simulation(scene, topology="graph", execution="serial", substeps=2)


@pytest.fixture(scope="module")
def judge(device):
    return Judge(1)


def measured(judge, folder, patience):
    """All that a judge says of the window in a folder."""
    verdict = Verdict(**judge.measure(str(folder), patience))
    return Verdict(**judge.part(patience)) if verdict.known else verdict


class Here(ErrorMeter):
    """An error meter that judges nothing: it keeps its windows."""

    def __init__(self, sim):
        self.windows = []
        super().__init__(sim)

    def _judge(self, window, trials):
        self.windows.append(window)

    def _end(self, shown=True):
        super()._end(shown)
        if self._task:  # a busy machine may end it only after the next frame, which is skipped then
            self._task.join()


def act(sim, frame):
    """What a user may do in a second, before a frame."""
    if frame % 7 == 3:
        sim.blow((150.0, 120.0), (3.0, -2.0))
    if frame == 5:
        sim.grab([8, 9], sim.positions()[8], 0.4)
    if 5 < frame < 20:
        sim.drag(sim.held().place + (0.5, -0.25))
    if frame == 20:
        sim.let_go()
    if frame == 22:
        sim.set(stiffness=0.3, springs=[1, 2], gravity=(0.0, 0.05))
    if frame == 25:
        sim.spawn((100.0, 100.0), (1.0, 0.0), tied_to=3)
        sim.cut([4, 5])
    if frame == 30:
        sim.pin([11])
        sim.add_spring(0, 13)
    if frame == FRAMES - 2:  # and holds as the second ends
        sim.grab([14], sim.positions()[14], 0.4)


def run(sim, frames=FRAMES):
    for frame in range(frames):
        act(sim, frame)
        sim.advance()


def test_it_changes_no_bit_and_a_window_is_made_again_to_the_bit(torn, judge):
    """With all that can be done in it: the same steps in f64 are where the run was."""
    run(torn)
    state = torn.positions(), torn.velocities(), torn.springs_alive()
    assert not state[2].all() and torn.particle_count > len(torn.scene.particles)

    torn.reset()
    meter = Here(torn)
    try:
        run(torn)
        for one, other in zip(
            state, (torn.positions(), torn.velocities(), torn.springs_alive()), strict=True
        ):
            np.testing.assert_array_equal(one, other)
        (window,) = meter.windows
        assert window.frames == FRAMES and len(window.acts) > 20

        torn.advance()  # a window that begins with broken springs, added particles, and a hold
        torn.drag(torn.held().place + (2.0, -3.0))
        torn.blow((150.0, 120.0), (3.0, -2.0))
        torn.advance(FRAMES - 1)
        (_, second) = meter.windows
        assert second.start.snapshot.scene.world.held is not None
        for of in (window, second, second):
            plan = _Plan(of.method, of.substeps, of.solver, of.start)
            np.testing.assert_array_equal(judge._run(of, plan).x, of.shown)
    finally:
        meter.close()
    assert not torn.listeners


def test_windows_end_where_another_run_begins(torn):
    """Those that are too short say nothing, and what is done in none is not noted."""
    torn.reset()
    meter = Here(torn)
    try:
        torn.advance(10)
        torn.reset()
        torn.advance(30)
        with pytest.raises(InputError):  # as without a meter
            torn.set(mass=(1.0 for _ in range(2)))
        torn.set_step(substeps=4)
        torn.advance(20)
        torn.remove([0])
        torn.advance(FRAMES + 1)
        assert [(w.first, w.frames, w.substeps[0]) for w in meter.windows] == [
            (1, 29, 2),
            (30, 20, 4),
            (50, FRAMES, 4),
        ]
    finally:
        meter.close()
        torn.set_step(substeps=2)


@pytest.fixture(scope="module")
def chain(judge, tmp_path_factory):
    """A chain after a second: the simulation, its window, the verdict, and SciPy's solution."""
    scene, folder = library.build("chain"), tmp_path_factory.mktemp("chain")
    sim = Simulation(scene, topology="graph", execution="serial")
    meter = Here(sim)
    sim.advance(FRAMES)
    meter.close()
    (window,) = meter.windows
    window.write(folder / WINDOW, None)
    verdict = measured(judge, folder, 60.0)
    smooth = ode.solve(scene, np.arange(FRAMES + 1) * sim.dt, 60.0)
    return SimpleNamespace(sim=sim, window=window, verdict=verdict, smooth=smooth, folder=folder)


def test_errors_are_those_of_trade(chain, judge, tmp_path):
    """Beside SciPy's solution of a chain; where a disturbance grows, and where it does not."""
    window, verdict, smooth = chain.window, chain.verdict, chain.smooth
    none = np.zeros((FRAMES + 1, 0), bool)
    apart = errors.distance(
        errors.Samples(np.array(window.shown), smooth.v, none),
        errors.Samples(smooth.x, smooth.v, none),
        ~chain.sim.fixed(),
    )
    assert not verdict.trouble
    assert verdict.error == pytest.approx(apart.trajectory, rel=1e-3)
    assert verdict.solver is None and verdict.rounding is None and 0 < verdict.ahead < 20
    # In no time nothing is made again.
    window.write(tmp_path / WINDOW, None)
    verdict = measured(judge, tmp_path, 1e-9)
    assert not verdict.known and "to make again" in verdict.describe(in_metres=False)


class Shorter(Judge):
    """A judge that makes fewer frames, of finer references too, or whose references part, and which
    then has no time for more than four.
    """

    def __init__(self, judge, most=FRAMES, parts=FRAMES, finer=FRAMES):
        super().__init__(1)
        self._sims, self._most, self._parts = judge._sims, most, parts
        self._finer, self._coarsest = finer, np.inf
        self._rng = np.random.default_rng(0)

    def _run(self, window, plan):
        self._coarsest = min(self._coarsest, plan.substeps[0])
        most = self._most if plan.substeps[0] == self._coarsest else self._finer
        made = super()._run(window, plan).first(min(most, self._most))
        if self._parts < FRAMES and plan.substeps[0] >= 8 * self._coarsest:
            self._until = 0.0  # by no clock
        made.x[self._parts + 1 :] += self._rng.normal(size=made.x[self._parts + 1 :].shape)
        return made


def test_what_no_reference_tells_is_left_out(chain, judge, tmp_path):
    """Where time ends, or where references part: the error is that of the frames before."""
    chain.window.write(tmp_path / WINDOW, None)
    none = np.zeros((FRAMES + 1, 0), bool)
    shown = errors.Samples(np.array(chain.window.shown), chain.smooth.v, none)
    smooth = errors.Samples(chain.smooth.x, chain.smooth.v, none)
    short = measured(Shorter(judge, most=24), tmp_path, 60.0)
    assert short.judged == 24 and short.further == "60 s allow no more"
    assert "error over the first 0.4 s of the last second: 1.8 %" in short.describe(True)
    late = measured(Shorter(judge, finer=30), tmp_path, 60.0)
    assert late.judged == 30 and late.further == "60 s allow no more"
    parted = measured(Shorter(judge, parts=40), tmp_path, 60.0)
    assert 40 <= parted.judged <= 42 and parted.further == "further on references differ"
    for verdict, frames in ((short, 24), (parted, 40)):
        apart = errors.distance(shown.first(frames), smooth.first(frames), ~chain.sim.fixed())
        assert not verdict.trouble and verdict.growth is not None
        assert verdict.error == pytest.approx(apart.trajectory, rel=0.1)
    assert Ghost.read(tmp_path / GHOST, chain.window).end == parted.judged
    # Of too few frames nothing is said.
    lost = measured(Shorter(judge, most=9), tmp_path, 60.0)
    assert not lost.known and "to make again" in lost.trouble
    unsure = measured(Shorter(judge, parts=9), tmp_path, 60.0)
    assert unsure.judged == FRAMES and unsure.trouble.startswith("two references differ by")


def test_the_ghost_is_where_the_reference_is(chain):
    """SciPy's solution, at each frame of its window; then by as much aside as at its end."""
    sim, window = chain.sim, chain.window
    ghost = Ghost.read(chain.folder / GHOST, window)
    for frame in (0, 30, FRAMES):
        there = window.shown[frame] + ghost.at(frame)
        np.testing.assert_allclose(there, chain.smooth.x[frame], atol=1e-2 * chain.verdict.error)
    np.testing.assert_array_equal(ghost.at(FRAMES + 40), ghost.at(FRAMES))
    assert replace(ghost, first=1).at(0) is None
    thinned = replace(ghost, stride=10, shown=window.shown[::10], away=ghost.away[::10])
    mean = (ghost.at(30) + ghost.at(40)) / 2
    np.testing.assert_allclose(thinned.at(35), mean, rtol=1e-5)
    # In a picture: pale there, and only there.
    measured = MeasuredErrors(sim, waits=False, told=False)
    measured._meter = SimpleNamespace(ghost=ghost, refused="", close=lambda: None)
    depiction = Depiction(sim, errors=measured)
    view = View("gui", sim.scene.world, (900, 300))

    def pale():
        view.draw(depiction.picture())
        return (view.grab() == style.GHOST_ON_WORLD).all(axis=2)

    try:
        assert measured.ghost() is None and not pale().any()
        measured.next_ghost()
        reading = measured.ghost()
        times = run_meter.magnification(ghost)
        assert times > 1 and reading.words.endswith(f"at this frame, difference x{times:g}")
        seen, window_map = pale(), WindowMap.of(sim.scene.world, (900, 300))
        place = sim.positions() + times * (chain.smooth.x[-1] - sim.positions())
        place[:, 1] += 0.5 * sim.radii()  # beside the springs, which are drawn over it
        columns, rows = np.round(window_map.to_window(place)).astype(int).T
        apart = np.linalg.norm(place[:, None] - sim.positions(), axis=2)
        far = (apart > 1.2 * sim.radii()).all(axis=1)
        assert far.any() and seen[rows[far], columns[far]].all()
        measured.next_ghost()
        assert "true size" in measured.ghost().words and pale().sum() < seen.sum()
        sim.advance(30)
        assert "as 0.5 s ago" in measured.ghost().words
        assert measured.ghost().away is not None
        # The timeline reaches ten seconds back.
        for frames, ago in ((151, "3 s ago: go back there (,)"), (600, "10 s ago")):
            old = measured._meter.ghost = replace(ghost, first=ghost.first - frames)
            words = f"ghost: known of frames {old.start} to {old.end}, {ago}"
            assert (measured.ghost().words, measured.ghost().away) == (words, None)
        assert measured.next_ghost() == "ghost: off" and not pale().any()
    finally:
        view.close()
        sim.reset()
        sim.advance(FRAMES)


@pytest.fixture
def meter(chain):
    """One that judges nothing, on the chain at its start; that stands afterwards where it was."""
    there = chain.sim.checkpoint()
    chain.sim.reset()
    meter = Here(chain.sim)
    yield meter
    meter.close()
    chain.sim.restore(there)


def test_a_ghost_goes_with_the_run_it_is_of(chain, meter):
    """Back in the same run it stays; where that goes another way, it is forgotten."""
    sim = chain.sim
    meter.ghost = ghost = Ghost.read(chain.folder / GHOST, chain.window)
    sim.advance(20)
    middle = sim.checkpoint()
    sim.advance(FRAMES - 15)
    meter.recent = [Verdict(0, 15, error=1.0, scale=9.0), chain.verdict]
    assert meter.last is chain.verdict
    sim.restore(middle)
    assert meter.last is meter.recent[0] and meter.age == 5
    sim.advance(FRAMES - 15)
    assert meter.ghost is ghost and meter.last is chain.verdict
    sim.restore(middle)
    sim.pin([3])
    sim.advance(2)
    assert meter.ghost is None and meter.recent == [meter.last]
    sim.advance(FRAMES - 17)
    assert meter.recent == [meter.last] and meter.age == FRAMES - 10
    meter.ghost = ghost
    sim.reset()
    assert meter.ghost is None


def test_a_verdict_that_comes_after_the_run_went_back_is_shown_where_it_is_of(chain, meter):
    """At its second's end, once one is there again; where the run goes another way, it is not."""
    sim = chain.sim
    sim.advance(20)
    middle = sim.checkpoint()
    sim.advance(FRAMES - 15)
    present = sim.checkpoint()
    meter._task.join()
    (window,) = meter.windows
    sim.restore(middle)
    whole = replace(chain.verdict, solver=0.1)
    for verdict in chain.verdict, whole:  # what its error comes from is told later
        meter._show(window, verdict)
        assert meter.last is None and meter.recent == [verdict]
    sim.restore(present)  # it was only looked at
    assert meter.last is whole and meter.age == 5
    sim.restore(middle)
    sim.advance(FRAMES - 20)
    assert meter.last is whole and meter.age == 0
    sim.restore(middle)
    sim.pin([3])
    meter._judged = window  # as if it were still being judged
    sim.advance(1)
    meter._show(window, whole)
    sim.advance(FRAMES)
    assert meter.last is None


def test_the_last_verdict_is_one_that_was_there_as_it_was_asked_for(chain):
    """Another thread may put one in its place meanwhile that ends beyond what is shown."""
    verdicts = [[chain.verdict], []]

    class Replaced(Here):
        shown = property(lambda _: verdicts.pop(0))

    meter = Replaced(chain.sim)
    try:
        assert meter.last is chain.verdict and meter.last is None
    finally:
        meter.close()


@pytest.mark.parametrize("few", [0, meters.FEW])
def test_nothing_of_a_run_is_shown_in_the_one_before_its_reset(chain, meter, few, monkeypatch):
    """To which a timeline goes back: it is at frames that the run since then has not come to."""
    sim = chain.sim
    monkeypatch.setattr(meters, "FEW", few)
    sim.advance(33)
    before = sim.checkpoint()
    sim.reset()
    sim.advance(23)
    present = sim.checkpoint()
    meter.recent = recent = [Verdict(0, 15, error=1.0, scale=9.0)]
    meter.ghost = ghost = Ghost.read(chain.folder / GHOST, chain.window)
    sim.restore(present)
    assert meter.recent == recent and meter.ghost is ghost
    sim.restore(before)
    assert (meter.recent, meter.ghost) == ([], None)


def test_of_many_particles_what_is_of_another_run_is_forgotten_up_to_where_it_was_seen(
    chain, meter, monkeypatch
):
    """Each fifth frame is looked at: between, the run may have gone another way already."""
    monkeypatch.setattr(meters, "FEW", 0)
    sim = chain.sim
    sim.advance(20)
    middle = sim.checkpoint()
    sim.advance(10)
    known = [Verdict(first, 15, error=1.0, scale=9.0) for first in (5, 8, 12)]
    sim.restore(middle)
    sim.advance(5)
    meter.recent = list(known)
    sim.restore(middle)
    sim.pin([3])
    sim.advance(5)
    assert meter.recent == known[:1]


@pytest.mark.parametrize("act", ["reset", "remove", "set_step"])
def test_what_is_told_while_the_run_becomes_another_is_not_of_that(chain, act, monkeypatch):
    """Nothing after a reset; after a removal the error, but no ghost, whose particles there were.

    Whoever asks for a reset waits while a verdict is put among the others.
    """
    ghost = Ghost.read(chain.folder / GHOST, chain.window)
    asked, may_answer = threading.Event(), threading.Event()

    class Answers(Here):
        _judge = ErrorMeter._judge

        def _ask(self, window, within):
            asked.set()
            assert may_answer.wait(60)
            return chain.verdict, ghost

        def _ask_parts(self, trials):
            return chain.verdict

        def _end(self, shown=True):
            ErrorMeter._end(self, shown)

    there = chain.sim.checkpoint()
    meter = Answers(chain.sim)
    try:
        chain.sim.advance(FRAMES)
        assert asked.wait(60)
        if act == "reset":
            meter.recent = [Verdict(-99, 15, error=1.0, scale=9.0)]
            late = threading.Thread(target=meter.before_act, args=(act, (), {}))

            def apart(one, other):
                if not late.ident:
                    late.start()
                late.join(0.3)
                return True

            monkeypatch.setattr(meters, "_apart", apart)
        else:
            meter.before_act(act, (), {})
        may_answer.set()
        meter._task.join()
        if act == "reset":
            late.join()
        assert (meter.recent, meter.ghost) == {
            "reset": ([], None),
            "remove": ([chain.verdict], None),
            "set_step": ([chain.verdict], ghost),
        }[act]
    finally:
        meter.close()
        chain.sim.restore(there)


def test_a_ghost_has_no_springs_that_broke_in_the_reference():
    """Nor triangles with such a side, nor what came after its second began."""
    picture = Picture(
        np.zeros((6, 2), np.float32), np.ones(6), np.zeros((6, 3), np.uint8),
        np.array([[0, 1], [2, 1], [2, 3], [4, 5]]),
        triangles=np.array([[0, 1, 2], [1, 3, 2], [3, 4, 5]]),
    )  # fmt: skip
    away = np.ones((5, 2), np.float32)
    made = Ghosts().of(picture, away, np.array([[1, 0]]))
    assert made.segments.tolist() == [[2, 1], [2, 3]] and made.triangles.tolist() == [[1, 3, 2]]
    assert made.position.tolist() == away.tolist() and made.as_spheres.tolist() == [True] * 5
    # Of many there are pins, from some of them to where the ghost is.
    many = np.random.default_rng(0).random((9000, 2)).astype(np.float32)
    picture = replace(picture, position=many, radius=np.ones(9000), color=np.zeros((9000, 3)))
    pins = Ghosts().of(picture, np.full((9000, 2), 0.5, np.float32), made.segments[:0])
    feet, heads = pins.position[pins.segments].swapaxes(0, 1)
    np.testing.assert_allclose(heads - feet, 0.5, rtol=1e-6)
    assert pins.over and 250 < len(heads) == pins.as_spheres.sum() < 350


@pytest.mark.thorough
def test_a_window_is_made_again_by_other_methods(chain, judge, tmp_path):
    """Each by its own steps: the window's own method as a rival errs as the window itself, one of
    a higher order less, and what blows up leaves what was found before.
    """
    chain.window.write(tmp_path / WINDOW, None)
    verdict = Verdict(**judge.measure(str(tmp_path), 60.0))
    n = verdict.own_substeps
    trials = [
        Trial(verdict.method, 2 * n, n, within=1.0),
        Trial("rk4", n, n, within=0.0),
        Trial("explicit_euler", 8, 1, within=1e9),
    ]
    others = Verdict(**judge.part(60.0, trials=[asdict(trial) for trial in trials])).others
    (twice, finer), (same, error) = others[verdict.method]
    assert (twice, same) == (2 * n, n) and error == pytest.approx(verdict.relative, rel=1e-12)
    assert finer < 0.7 * error and others["rk4"][0][1] < 1e-2 * error
    assert {substeps for substeps, _ in others["explicit_euler"]} <= {8, 4, 2, 1}


def surveying(judge, scene, folder):
    """A judge that surveys a scene from its start, by what another one has compiled."""
    made = Judge(1)
    made._sims = judge._sims
    (folder / SCENE).write_bytes(pickle.dumps(scene))
    return made


def test_a_survey_has_the_errors_of_seconds_that_follow_each_other(chain, judge, tmp_path):
    """From the start, and from where SciPy's solution is a second later; by one reference each."""
    sim, second = chain.sim, chain.window
    method, n = chain.verdict.method, chain.verdict.own_substeps
    trials = [asdict(Trial(method, n, n, 4 * n))]
    made = surveying(judge, sim.scene, tmp_path)
    asked = {"folder": str(tmp_path), "dt": second.dt, "patience": 60.0, "relative": True}
    here = [made.survey(within=0.01, trials=trials, **asked) for _ in range(2)]
    assert not any(found["trouble"] or found["slow"] or found["resting"] for found in here)
    there = replace(sim.scene.particles, position=chain.smooth.x[-1], velocity=chain.smooth.v[-1])
    sim.load_scene(replace(sim.scene, particles=there), second.dt, n)
    later = Window.opened(sim)
    for _ in range(FRAMES):
        sim.advance()
        later.note_frame(sim)
    sim.load_scene(second.start.snapshot.scene, second.dt, n)
    (tmp_path / "later").mkdir()
    later.write(tmp_path / "later" / WINDOW, None)
    for found, verdict in zip(
        here, (chain.verdict, measured(judge, tmp_path / "later", 60.0)), strict=True
    ):
        (substeps, error), *_ = found["tries"][method]
        assert substeps == n and 0.01 * error == pytest.approx(verdict.relative, rel=0.02)
    # A second that is passed over is run through; an error may be a length; one may have no time.
    made = surveying(judge, sim.scene, tmp_path)
    asked["relative"] = False
    assert made.survey(within=1.0, trials=[], **asked)["tries"] == {}
    (_, error), *_ = made.survey(within=1.0, trials=trials, **asked)["tries"][method]
    assert error == pytest.approx(measured(judge, tmp_path / "later", 60.0).error, rel=0.02)
    slow = made.survey(within=1.0, trials=trials, **asked | {"patience": 1e-9})
    assert slow["slow"] and "a second again" in slow["trouble"] and not slow["tries"]


def test_an_error_below_what_is_asked_for_takes_no_finer_reference(chain, judge, tmp_path):
    sim = judge._sims["rk4"]
    sim.begin_from(chain.window.start, chain.window.dt, 8)
    window = Window.opened(sim)
    for _ in range(FRAMES):
        sim.advance()
        window.note_frame(sim)
    window.write(tmp_path / WINDOW, None)
    whole = Verdict(**judge.measure(str(tmp_path), 60.0))
    soon = Verdict(**judge.measure(str(tmp_path), 60.0, floor=1e-3))
    assert not (whole.trouble or soon.trouble) and whole.relative < 1e-5
    assert soon.substeps < whole.substeps and soon.judged == FRAMES
    assert abs(soon.relative - whole.relative) < 1e-3 / 5
    # An error above it is told as ever.
    same = Verdict(**judge.measure(str(chain.folder), 60.0, floor=chain.verdict.relative / 10))
    assert (same.error, same.substeps) == (chain.verdict.error, chain.verdict.substeps)


def test_parts_of_the_error_are_told_apart(judge, tmp_path):
    """A solver that stops early, and positions that are rounded: each has its own share."""
    sim = Simulation(library.build("chain"), "xpbd", topology="graph", iterations=2)
    window = Window.opened(sim)
    for _ in range(FRAMES):
        sim.advance()
        window.note_frame(sim)
    noise = np.random.default_rng(0).normal(size=np.shape(window.shown)) * 0.01
    rounded = replace(window, precision="f32", shown=list(np.array(window.shown) + noise))
    rounded.write(tmp_path / WINDOW, None)
    verdict = measured(judge, tmp_path, 60.0)
    assert verdict.rounding == pytest.approx(0.01 * np.sqrt(2), rel=0.1)
    sim.set_solver(iterations=256)
    sim.reset()
    exact = [sim.positions()]
    for _ in range(FRAMES):
        sim.advance()
        exact.append(sim.positions())
    free = ~sim.fixed()
    square = ((np.array(exact) - np.array(window.shown))[1:, free] ** 2).sum(axis=2)
    assert verdict.solver == pytest.approx(np.sqrt(square.mean()), rel=1e-3)
    assert verdict.rounding < verdict.solver
    by_frame = np.array(verdict.by_frame)
    assert np.sqrt((by_frame**2).mean()) == pytest.approx(verdict.error)
    aim = np.median(by_frame) / verdict.scale * (1 + 1e-9)
    within = [verdict.frames_within(part) for part in (0, aim, 1)]
    assert within == [0, verdict.judged // 2, verdict.judged]
    said = verdict.describe(in_metres=True)
    assert re.match(r"error over the last second: [\d.]+ % \([\d.]+ m\), of which solver", said)


def test_a_process_that_ends_is_said_and_leaves_nothing(monkeypatch):
    """It is started again, some times; the run goes on; the folder goes, too."""
    sim = Simulation(library.build("chain"), topology="graph", execution="serial")
    told = []
    meter = ErrorMeter(sim, tell=told.append)
    began = []

    def killed(worker, **request):
        if "do" in request:
            began.append(worker)
            os.kill(worker._process.pid, signal.SIGKILL)
        return asked(worker, **request)

    asked = meters.Worker.ask
    monkeypatch.setattr(meters.Worker, "ask", killed)
    try:
        while len(told) < meters.MOST_LOST:
            sim.advance()
        sim.advance(2 * FRAMES)
    finally:
        meter.close()
    assert len(told) == meters.MOST_LOST and not meter.busy
    assert all("its process ended" in verdict.describe(False) for verdict in told)
    assert "not measured: its process failed 3 times" in meter.summary()
    assert all(worker._process.returncode == -signal.SIGKILL for worker in began)
    assert not os.path.exists(meter._folder.name)


def test_one_that_rests_leaves_the_processor_to_the_run_for_a_while(monkeypatch):
    """For so many times as long as it worked; the frames of that time pass unmeasured."""
    sim = Simulation(library.build("chain"), topology="graph", execution="serial")
    now = [0.0]

    def asked(meter, window, within):
        now[0] += 2.0
        return Verdict(window.first, window.frames, trouble="other programs"), None

    monkeypatch.setattr(meters, "time", SimpleNamespace(perf_counter=lambda: now[0]))
    monkeypatch.setattr(ErrorMeter, "_ask", asked)
    meter = ErrorMeter(sim)
    meter.rests = 3.0
    sim.advance(FRAMES)
    meter._task.join()
    sim.advance(5)
    assert len(meter.verdicts) == 1 and meter.skipped == 5
    assert "rests" in meter.progress()
    now[0] = 7.9
    sim.advance()
    assert meter.skipped == 6
    now[0] = 8.1  # 2 s of work, 6 of rest
    sim.advance(2)  # with the first a window begins
    assert meter.skipped == 6 and meter.progress() == f"frame 1 of {FRAMES}"
    meter.close()


def test_one_that_ends_before_its_process_does_not_wait_for_it(monkeypatch):
    """Closed while its thread starts the process, it ends that before anything is asked of it."""
    sim = Simulation(library.build("chain"), topology="graph", execution="serial")
    meter, asked, begun = ErrorMeter(sim), [], threading.Event()

    class Late(meters.Worker):
        def __init__(self, *given, **named):
            begun.wait()
            super().__init__(*given, **named)

        def ask(self, **request):
            asked.append(request)
            return super().ask(**request)

    monkeypatch.setattr(meters, "Worker", Late)
    sim.advance(FRAMES)
    monkeypatch.setattr(meter._task, "join", lambda of=meter._task.join: (begun.set(), of()))
    meter.close()
    assert not asked and not meter.busy and not meter.verdicts
    assert "before the first second was made again" in meter.summary()


def test_a_run_that_ends_within_its_first_second_says_so(torn):
    for frames, then, says in (
        (LEAST - 1, 0, "it ended 14 frames into a second of 60"),
        (LEAST, 0, "it ended 15 frames into a second of 60"),
        (LEAST - 1, LEAST, "it ended 15 frames into a second of 60"),
        (LEAST - 1, LEAST - 1, "no 15 frames in a row in which anything can move"),
    ):
        torn.reset()
        meter = ErrorMeter(torn, waits=True)
        torn.advance(frames)
        if then:
            torn.reset()
            torn.advance(1 + then)
        for _ in range(2):
            meter.close()
            assert meter.summary() == f"error: not measured: {says}"


def test_what_cannot_be_measured_is_said():
    """Scenes with too many particles, and those in which nothing can move, start no process."""
    world = SimpleNamespace(dim=2)
    many = SimpleNamespace(particle_count=10**6, scene=SimpleNamespace(world=world))
    assert "1000000 particles" in ErrorMeter(many).summary()
    sim = Simulation(library.build("box", particles=0), topology="graph")
    meter = ErrorMeter(sim, waits=True)
    sim.advance(FRAMES + 5)
    meter.close()
    assert meter.last is None and "anything can move" in meter.summary()


def test_a_window_says_it_in_a_row_of_its_meters(torn):
    """Switched on by its key; what was measured before the run went back is not shown."""
    torn.reset()
    measured = MeasuredErrors(torn, waits=False, told=False)
    shown = Meters(torn, windowed=False, errors=measured)
    rect = Rect(0, 0, 320, 900)
    assert "error" not in shown.panel(rect, 16).words
    assert shown.switch("error").startswith("measuring") and shown.measures
    assert "error\nmeasuring\nframe 0 of 60" in shown.panel(rect, 16).words
    meter = measured._meter
    now = torn.frame - FRAMES
    known = Verdict(now, FRAMES, "f32", 0.3, 10.0, 100.0, 0.1, 8, 0.01, 0.001, growth=0.1)
    meter.recent.append(known)
    meter.recent.append(replace(known, trouble="two references differ"))
    reading = measured.reading()
    assert reading.value == "3 % (0.3)"
    assert reading.details[:3] == ("solver 0.1 %", "f32 0.01 %", "holds 1.7 s")
    np.testing.assert_allclose(reading.relative, 2 * [0.03, 0.03, np.nan])
    np.testing.assert_allclose(reading.age, 2 * [1.0, 0.0, 0.0], atol=1e-4)
    # What is older than a graph reaches back sets no scale of it.
    meter.recent.insert(0, replace(known, first=now - 10 * FRAMES, error=3.0))
    np.testing.assert_allclose(measured.reading().relative, 2 * [0.03, 0.03, np.nan])
    # Also where the run stands still.
    assert "error\n3 % (0.3)" in shown.panel(rect, 16).words
    resting = replace(known, scale=1e-4, error=1e-6)
    assert resting.describe(False) == "error over the last second: 1e-06; nothing moves"
    torn.reset()
    assert measured.reading().value == "measuring"
    assert shown.switch("error") == "error meter: off" and not torn.listeners
    assert "nothing measures errors" in Meters(torn).switch("error")


def test_a_headless_run_says_each_second_and_all_of_them():
    output, _ = command("run", "chain", "--headless", "--frames", "130", "--error-meter")
    lines = output.splitlines()
    told = [line for line in lines if line.startswith("frame ")]
    assert [line.partition(":")[0] for line in told] == ["frame 60", "frame 120"]
    for line in told:
        said = r"last second: 0\.\d+ % \(0\.\d+\), of which f32 .* %; a nudge of a millionth grows"
        assert re.search(said, line)
    assert any(re.match(r"error a second: 0\.\d+ % .* over 2 of 2 windows$", x) for x in lines)
