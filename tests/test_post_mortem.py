"""Why a run failed, and what survives: named, tried, written, and shown, with no bit changed."""

import math
import re
from dataclasses import replace
from html.parser import HTMLParser
from types import SimpleNamespace

import failing_runs
import numpy as np
import pytest
from failing_held_out import REPRESENTATIVE
from failing_runs import CASES, Runner
from test_timeline import Script, press

from taichi_cloth.cli.run_report import Examining
from taichi_cloth.errors import InputError, SimulationFailure
from taichi_cloth.files.events import Log
from taichi_cloth.limits.eigenmodes import Limit
from taichi_cloth.limits.network import Network
from taichi_cloth.limits.tracking import Shares
from taichi_cloth.post_mortem import causes, onset, survivors
from taichi_cloth.post_mortem.breaks import Torn
from taichi_cloth.post_mortem.causes import AIR, DAMPING, STEP, TEARING, cause_of
from taichi_cloth.post_mortem.examine import flags
from taichi_cloth.post_mortem.sample import Sample
from taichi_cloth.post_mortem.trace import traced
from taichi_cloth.scene.library import build
from taichi_cloth.scene.model import Particles, Scene, Springs, World
from taichi_cloth.simulation.checkpoint import Checkpoint
from taichi_cloth.simulation.past import APART, Past, Settings
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.ui import app, hud
from taichi_cloth.ui.inputs import Event

pytestmark = pytest.mark.usefixtures("device")


class Parts(HTMLParser):
    """What a page is made of, and the addresses that it would load."""

    def __init__(self, page):
        super().__init__()
        self.tags, self.addresses, self.open = [], [], []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.addresses += [value for name, value in attrs if name in ("src", "href", "xlink:href")]
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        self.open = self.open[:-1] if self.open[-1:] == [tag] else self.open

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def runner():
    return Runner(seconds=10.0)


QUICK = ("stiff_spring/symplectic_euler", "blown", "tearing")
FEW = [case for case in CASES if case.name in QUICK]


@pytest.mark.parametrize("case", FEW, ids=lambda case: case.name)
def test_the_cause_is_named_and_the_setting_survives(runner, case):
    """Numerics, what somebody did, and physics: told apart; nothing of the run is changed."""
    said = runner.run(case)
    assert said["right"] and said["survives"] and said["same"], said


def test_a_report_has_all_in_one_file(tmp_path):
    """What was done comes again: spring 5 is named, which was made stiff at frame 20."""
    sim = Simulation(failing_runs.shaken()(), dt=1 / 60, substeps=4, topology="graph")
    sim.advance(20)
    sim.set(springs=[5], stiffness=1e7)
    with pytest.raises(SimulationFailure):
        sim.advance(100)
    before = sim.positions(), sim.frame
    found = sim.report(tmp_path / "a.html", seconds=5.0)
    np.testing.assert_array_equal(before[0], sim.positions())
    assert (sim.frame, sim.substeps) == (before[1], 4)
    assert found.cause.kind == STEP and found.cause.spring == 5 and found.cause.numerical
    assert "since `set` of stiffness at frame 20" in found.cause.proof
    page = (tmp_path / "a.html").read_text()
    parts = Parts(page)
    assert parts.open == [] and parts.tags.count("img") >= 3 and "svg" in parts.tags
    assert all(address.startswith(("data:image/png", "#")) for address in parts.addresses)
    assert not re.search(r"<script|<link|@import|url\(http", page)
    assert found.command in page and "spring 5 (stiffness 1e+07, inverse mass 10)" in page
    # What survives there does so for a user who takes it.
    sim.reset()
    sim.set_step(substeps=found.search.best.settings.substeps)
    sim.advance(20)
    sim.set(springs=[5], stiffness=1e7)
    sim.advance(60)
    assert "nothing went wrong" in sim.report(tmp_path / "b.html", pictures=False).cause.says
    with pytest.raises(InputError):
        sim.report(tmp_path / "nowhere" / "c.html")


def test_a_run_that_began_at_a_saved_checkpoint_is_made_again_under_any_method(tmp_path):
    """It was refused, as the file was of another method than the run, or a trial, had by then."""
    sim = Simulation(build("oscillator"), topology="graph", execution="serial")
    sim.advance(5)
    sim.checkpoint().save(tmp_path / "there.npz")
    sim.restore(Checkpoint.load(tmp_path / "there.npz"))
    sim.set_method("verlet")
    sim.set_step(dt=40.0)
    with pytest.raises(SimulationFailure):
        sim.advance(200)
    before = sim.positions(), sim.frame, sim.method
    found = sim.report(tmp_path / "a.html", pictures=False, seconds=5.0)
    assert found.cause.kind == STEP and found.search.best is not None
    assert repr(found) == f"<PostMortem: {found.line}>"
    tries = survivors._Tries(sim, sim.past, sim.past.origin, sim.frame + 1)
    with sim.past.resting(sim):
        for method in ("verlet", "xpbd", "verlet"):
            assert tries.run(Settings(method, 1.0, 1)).survived
    np.testing.assert_array_equal(sim.positions(), before[0])
    assert (sim.frame, sim.method) == before[1:]


def test_a_step_just_over_its_limit_is_not_sound(tmp_path):
    """Before anything has grown that one could see; just below it is sound."""
    for dt, numerical in ((19.9999, False), (20.0001, True)):  # h omega = dt / 10
        sim = Simulation(build("oscillator"), dt=dt, topology="graph", execution="serial")
        sim.advance(40)
        cause = sim.report(tmp_path / "a.html", pictures=False).cause
        assert cause.numerical == numerical and (cause.kind == STEP) == numerical
    assert "h omega = 2.00001 > 2 from the start" in cause.proof and cause.spring == 0
    assert "the longest stable step is 20, and it is 20.0001" in cause.proof


def test_where_substeps_would_take_too_long_xpbd_is_tried_first():
    """A stretched shirt, of which neither these nor equations in f32 had an end in time."""
    sim = Simulation(build("oscillator"), dt=40.0, topology="graph", execution="serial")
    with pytest.raises(SimulationFailure):
        sim.advance(200)
    trace = traced(sim, 5.0)
    for wait, method in ((0.0, "xpbd"), (1.0, "symplectic_euler")):
        tried = survivors._wanted(trace, cause_of(trace), [], sim, wait, lambda seconds: True)
        assert next(tried).method == method


def test_a_run_that_chooses_its_steps_goes_on_choosing_them(tmp_path):
    """Its trials differ by the method alone, and so do the flags of what survives."""
    now = Settings("xpbd", 0.5, 7, {"iterations": 4.0}, follows=True)
    before = replace(now, method="verlet", solver={})
    assert flags(now, before) == ["--method", "xpbd", "--iterations", "4"]
    whole = ["--method", "xpbd", "--dt", "auto", "--iterations", "4"]
    assert flags(now, before, whole=True) == whole
    sim = Simulation(
        failing_runs.thrown(1e9)(), "verlet", dt="auto", topology="graph", execution="serial"
    )
    with pytest.raises(SimulationFailure):
        sim.advance(50)
    found = sim.report(tmp_path / "a.html", pictures=False)
    (trial,) = found.search.trials  # shorter frames would be none
    assert trial.settings.follows and not trial.survived and found.command == ""


def test_what_tore_long_ago_is_told_apart(tmp_path):
    """Springs that a step tore which had become too long, and those that their load did."""
    sim = Simulation(build("cloth", columns=12, rows=9), topology="graph", execution="serial")
    sim.set_step(substeps=2)
    sim.advance(30)
    sim.set(stiffness=20.0)
    sim.advance(250)  # all of it lies on the floor by now
    found = sim.report(tmp_path / "a.html", pictures=False)
    assert found.cause.kind == STEP and found.trace.torn.before == 0
    assert "from frame 31 on, since `set` of stiffness at frame 30" in found.cause.proof
    assert f"{found.trace.torn.count} springs broke" in found.cause.proof
    assert found.trace.torn.first[0] > 30
    sim.reset()
    sim.set_step(substeps=8)
    sim.set(gravity=(0.0, 0.9))
    sim.advance(250)
    found = sim.report(tmp_path / "b.html", pictures=False)
    assert found.cause.kind == TEARING and not sim.springs_alive()[found.cause.spring]
    assert f"spring {found.cause.spring} broke first, in frame" in found.cause.proof


def sample(omega2=1.0, **given):
    """A moment of a run by symplectic Euler at steps of 1, which are stable up to omega^2 = 4."""
    limit = Limit(2.0 / math.sqrt(omega2), omega2=omega2, spring=0, particle=0)
    plain = dict(
        time=0.0, frame=0, part=0.0, total=1.0, moving=1.0, drift=0.0, work=0.0, by_hand=0.0,
        reach=math.sqrt(omega2), used=1.0 / limit.dt, method="symplectic_euler", h=1.0,
        limit=limit, shares=None, stiffness=1.0, inverse=(1.0,),
        strain=0.0, spring=0, ends=(0, 1), speed=0.0, fastest=0, broken=0,
    )  # fmt: skip
    return Sample(**{**plain, **given})


def test_what_grew_before_steps_were_short_again_is_not_added():
    """Two spells of long steps, each with 0.6 of what makes the least rounding large: both together
    are enough, but not with a stable step between them, which ends what grew.
    """
    grows = math.log(onset.growth_of(sample(omega2=4.1)))
    spell = 0.6 * -math.log(np.finfo(np.float64).eps) / grows
    begin, middle, end = (sample(omega2=4.1, time=k * spell) for k in range(3))
    together = SimpleNamespace(precision="f64", samples=[begin, middle, end])
    assert onset.has_grown(together)
    again = [sample(time=spell), replace(middle, time=spell + 1)]
    apart = SimpleNamespace(precision="f64", samples=[begin, *again, end])
    assert not onset.has_grown(apart)


def test_what_work_gave_is_no_energy_from_nothing():
    """A drift of 1 beside 1 that moves, 5 of work and 4 by hand is a tenth of it all."""
    one = sample(moving=1.0, drift=1.0, work=5.0, by_hand=4.0)
    assert onset.from_nothing(SimpleNamespace(samples=[one]), one) == pytest.approx(0.1)


@pytest.mark.parametrize("drift", [0.0, 90.0])
def test_a_spring_s_energy_is_no_cause_where_the_step_made_it(drift):
    """It is enough for a lost particle either way: the cause only if it did not come from nothing
    before the frame that failed.
    """
    x = np.array([[0.0, 0.0], [1.0, 0.0]])
    springs = Springs.build([(0, 1)], x, stiffness=1e8, rest_length=0.5)
    world = World((40.0, 20.0), gravity=(0.0, 0.0))
    network = Network.from_scene(Scene("pair", world, Particles.build(x), springs))
    trace = SimpleNamespace(
        samples=[sample(), sample(moving=100.0, drift=drift), sample(moving=100.0, part=0.5)],
        before=network,
        last=network,
        speed_limit=1000.0,
        whole=True,
        acts=[],
        scene="pair",
    )
    assert (causes._energy(trace) is None) == (drift > 0)


@pytest.mark.parametrize(("before", "kind"), [(6, TEARING), (4, STEP)])
def test_springs_are_torn_by_what_tore_most_of_them(before, kind):
    """Of 10 springs some broke before a step was too long: most of them, or the fewer."""
    trace = SimpleNamespace(torn=Torn(10, before, (3, 1), sample(omega2=5.0), "from the start"))
    assert causes._torn(trace, "sound").kind == kind


@pytest.mark.parametrize(
    ("dashpot", "drag", "air", "kind", "word"),
    [
        (0.5, 0.0, 0.3, DAMPING, "dashpot"),
        (0.1, 0.5, 0.3, DAMPING, "drag"),
        (0.1, 0.2, 0.3, AIR, "air"),
    ],
)
def test_what_damps_most_is_named(dashpot, drag, air, kind, word):
    """By its share of the damping of the mode that grows."""
    shares = Shares(np.zeros(1), np.array([dashpot]), 0.0, 0.0, drag, air)
    found, named = causes._damper(sample(shares=shares))
    assert found == kind and word in named


def test_acts_since_a_place_are_those_after_it_also_when_early_ones_were_let_go():
    """A run that cannot be gone back to its start keeps a few places, and no act before the first:
    where each place's own acts begin is counted from there.
    """
    sim = SimpleNamespace(method="verlet", dt=1.0, substeps=1, solver={}, follows=False)
    checkpoint = SimpleNamespace(arrays=lambda: [])
    past, frames = Past(), range(0, 30 * APART, APART)
    past.forget()
    for sim.frame in frames:
        past.offer(sim, checkpoint)
        past.act(sim.frame, "set", (sim.frame,), {})
    assert 1 < len(past.places()) <= len(past.acts) < len(frames)
    for place in past.places():
        assert list(past.acts_since(place)) == [k for k in frames if k >= place.frame]


def test_what_is_kept_for_it_changes_no_bit():
    """Checkpoints after each few frames, or none: the same positions; and not too many are kept."""
    ends = []
    for keeps in (False, True):
        sim = Simulation(build("cloth", columns=12, rows=9), topology="graph", execution="serial")
        sim.past.keeps = keeps
        sim.past._next = 0.0
        sim.past._clock = lambda: 0.0
        for k in range(300):
            if k % 40 == 0:
                sim.blow([200.0 + k, 150.0], [3.0, 1.0])
            sim.advance()
        ends.append(sim.positions())
        assert (len(sim.past.ring) > 4) == keeps and len(sim.past.ring) < 12
    np.testing.assert_array_equal(*ends)


def flat(words):
    return " ".join(words.split())


def test_a_window_stays_and_goes_on_with_what_survives():
    """The panel opens, k has settings tried, a frame back is seen, and u plays on from before with
    other substeps; also where a log is replayed, which goes on past the failure.
    """
    scene = build("cloth", columns=12, rows=9)
    sim = Simulation(scene, dt=1.9, topology="graph", execution="serial")
    seen = []

    class Seen(Script):
        def draw(self, picture):
            seen.append("\n".join(panel.words for panel in picture.overlay))

    turns = [
        *[[]] * 60,
        press("u"),  # nothing survives yet
        press("k"),  # which tries
        press("k"),
        press("k"),
        press("."),
        press("space"),
        press("left"),
        [],
        press("u"),
        *[[]] * 60,
    ]
    log = Log(by_frame={500: [Event("move", pos=(1.0, 1.0))]})
    view, examiner = Seen(scene.world, turns), Examining(sim, ["cloth"])
    app.run(sim, view, quiet=True, examiner=examiner, replay=log)
    assert any("Numerics: the step is too long" in words for words in seen)
    untried = [k for k, words in enumerate(seen) if "k looks for a setting" in flat(words)]
    tried = [k for k, words in enumerate(seen) if "u: go on with it from the start" in flat(words)]
    assert untried and tried and max(untried) < min(tried)
    assert any("k looks for one first" in flat(words) for words in seen)
    closed = [words for words in seen if "Stopped: " in words and "Numerics: " not in words]
    assert closed and "u goes on with what survives" in closed[-1].replace("\n", " ")
    assert sum(hud.STOPPED in words for words in seen) == 2  # until the key back
    assert sim.substeps > 1 and sim.dt == 1.9 and sim.frame > 40
    assert np.isfinite(sim.positions()).all() and sim.springs_alive().all()
    with pytest.raises(SimulationFailure):  # who quits at the panel is told as before
        sim.reset()
        sim.set_step(substeps=1)
        app.run(sim, Script(scene.world, [*[[]] * 60, [Event("press", key="escape")]]), quiet=True)


def test_a_run_that_fails_leaves_its_report(cli, tmp_path):
    """Beside what it saves, or where it was asked for; the error is one line as before."""
    saved = tmp_path / "run.npz"
    words = "run", "cloth", "--headless", "--columns", 12, "--rows", 9, "--dt", 1.9
    out, err = cli(*words, "--save", saved, check=3)
    assert err.count("error:") == 1 and f"report: {tmp_path / 'run.report.html'}" in out
    # One cause in both: what the error calls likely without a report is known with one.
    assert "cause: the step is too long for spring" in out
    # What the warning named is said again; nothing was tried, which nobody asked for.
    remedy = "use --substeps 3, a smaller --dt, or softer springs; --survivors looks for a setting"
    assert "use --substeps 3, --dt auto" in err and err.count(remedy) == 1 and remedy in out
    assert "What was tried" not in (tmp_path / "run.report.html").read_text()
    assert "; cause: the step is too long for spring" in err and "likely" not in err
    assert saved.exists()
    cli(*words[:-2], "--frames", 30, "--report", tmp_path / "good.html")
    assert "nothing went wrong" in (tmp_path / "good.html").read_text()
    _, err = cli(*words, "--report", tmp_path / "no" / "x.html", check=2)
    assert "there is no folder" in err
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        *("good.html", "run.npz", "run.report.html")
    ]


def test_what_survives_of_a_run_that_was_resumed_runs(cli, tmp_path):
    """The command line that its report proposes is done as it stands there."""
    words = "run", "cloth", "--columns", 12, "--rows", 9, "--headless"
    there, page = tmp_path / "there.npz", tmp_path / "page.html"
    cli(*words, "--frames", 12, "--checkpoint", there)
    again = "--resume", there, "--dt", 1.9, "--survivors"
    out, _ = cli(*words, *again, check=3)  # without a file for a page: said all the same
    assert "--substeps 3 survives" in out and "report" not in out
    cli(*words, *again, "--report", page, check=3)
    (given,) = set(re.findall("taichi-cloth (run cloth [^<]*)", page.read_text()))
    assert f"--resume {there}" in given and "without" not in given
    out, _ = cli(*given.split(), "--headless", "--frames", 80)
    assert "80 frames" in out


@pytest.mark.thorough
def test_of_all_failing_runs_nearly_all_are_right(runner):
    """In 95 of 100 the cause is right, in 95 the setting survives; physics is never numerics.

    Each second case, as all take minutes: `failing_runs.py` runs them all.
    """
    said = [runner.run(case) for case in CASES[::2]]
    failed = [one for one in said if one["failed"]]
    assert len(failed) >= 25
    assert sum(one["right"] for one in failed) >= 0.95 * len(failed)
    assert sum(one["survives"] for one in failed) >= 0.95 * len(failed)
    assert all(one["right"] for one in said if not one["failed"])


@pytest.mark.thorough
@pytest.mark.parametrize("name", REPRESENTATIVE)
def test_causes_of_runs_that_it_was_not_made_on(cli, name):
    """Command lines whose causes were written down before a post-mortem of them was seen."""
    [said] = cli.call("failing_held_out:judged", names=[name])
    assert said["as_expected"] and said["right"], said
    assert said["survives"] or not said["to_survive"], said
