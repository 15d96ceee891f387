"""`explain`: what it says is what is compiled and stored; what it measures differs as it says."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import small
from selection import thorough

from taichi_cloth.cli.main import main
from taichi_cloth.errors import InputError
from taichi_cloth.explain import command as explain
from taichi_cloth.explain import costs
from taichi_cloth.explain.variants import kinds_of_links, variants
from taichi_cloth.kernels import forces
from taichi_cloth.scene import library
from taichi_cloth.scene.checks import validate
from taichi_cloth.scene.cloth import LINKS
from taichi_cloth.scene.library import build
from taichi_cloth.scene.model import Particles, Scene, World
from taichi_cloth.scene.obstacles import Obstacle
from taichi_cloth.scene.solids import solids
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.sweeps.within import Clock

DOCUMENT = Path(__file__).parent.parent / "docs" / "features.md"
# What a feature is called, and the switch of `Features`, or the force, that it is.
SWITCHES = {
    "springs": "springs",
    "fracture": "fracture",
    "dashpots": "dashpots",
    "drag": "drag",
    "walls": "walls",
    "collisions": "collisions",
    "mouse: blow": "blow",
    "air": "air",
    "bending": "bending",
    "obstacles": "obstacles",
    "moving obstacles": "moving",
    "resting pairs": "resting",
    "self-collision": "thick",
    "uniform springs": "uniform_springs",
    "uniform particles": "uniform_particles",
}
FULL = {"columns": 6, "rows": 5, "shear": 0.1, "damping": 0.02}
SCENES = [
    (name, explain.FILLED.get(name, small.SIZES.get(name, {}))) for name in library.names()
] + [("cloth", FULL)]


def switches(scene):
    """Its features, and which forces it has."""
    present = forces.present_in(scene)
    return {name: name in present for name in forces.TERMS} | vars(scene.features())


@pytest.mark.parametrize(("name", "parameters"), SCENES)
def test_a_variant_differs_in_one_feature(name, parameters):
    scene = build(name, **parameters)
    own = switches(scene)
    switched = {variant.feature: variant for variant in variants(scene, on_graph=True)}
    for feature in ("fracture", "dashpots") if len(scene.springs) else ():
        assert feature in switched
    assert "drag" in switched
    assert ("walls" in switched) == (scene.world.contact == "original")
    assert switched.keys() & {"collisions", "self-collision"}
    for feature, variant in switched.items():
        its = switches(variant.scene)
        changed = {switch for switch in own if bool(own[switch]) != bool(its[switch])}
        # The floor is a wall; numbers that differ, or are all gone, are no longer shared.
        changed -= {"floor", "uniform_springs", "uniform_particles"} - {SWITCHES.get(feature)}
        if feature == "collisions" and own["thick"]:  # cloths go on to meet each other
            assert not changed and not variant.scene.world.collisions and variant.used
        elif feature in SWITCHES:
            assert SWITCHES[feature] in changed and bool(own[SWITCHES[feature]]) == variant.used
            with_it = {
                "self-collision": {"collisions", "resting"},
                "collisions": {"resting"},
                "obstacles": {"moving", "held"},
                "moving obstacles": {"held"},
            }
            if feature != "springs":
                assert changed - with_it.get(feature, set()) == {SWITCHES[feature]}
        elif feature == "third dimension":
            assert (own["dim"], its["dim"], variant.used) == (2, 3, False) and not changed
        elif feature.endswith(" links"):
            kinds = kinds_of_links(scene), kinds_of_links(variant.scene)
            kind = feature.removesuffix(" links")
            assert not changed and [(kind in of) for of in kinds] == [
                variant.used,
                not variant.used and kind in LINKS,
            ]
        else:
            assert feature == "mouse: spawn" and variant.scene.world.mouse == "none"


def test_what_touches_is_switched_part_by_part():
    """Obstacles, their motion, and pairs that rest: each without the others."""
    world = World(size=(9.0,) * 3, gravity=(0.0,) * 3, up="y", contact="resting", collisions=True)
    world = replace(world, walls=("left", "bottom"), friction=0.2)
    ball = Obstacle.build("sphere", centre=[4.0, 4.0, 0.0], radius=1.0, spin=[0.0, 9.0, 0.0])
    bodies = Particles.build([[1.0, 1.0, 0.0], [3.0, 1.0, 0.0]], radius=0.1, restitution=0.3)
    scene = validate(Scene("touch", world, bodies, obstacles=(ball,)))
    found = {variant.feature: variant.scene for variant in variants(scene, on_graph=True)}
    own = vars(scene.features())
    for feature, gone in (
        ("obstacles", {"obstacles", "moving"}),
        ("moving obstacles", {"moving"}),
        ("resting pairs", {"resting"}),
        ("collisions", {"collisions", "resting"}),
    ):
        its = vars(validate(found[feature]).features())
        assert {name for name in own if bool(own[name]) != bool(its[name])} == gone
    pairs = found["resting pairs"]
    assert pairs.world.contact == "original" and not pairs.world.walls
    x = np.random.default_rng(1).uniform(0.0, 9.0, (20, 3))
    for one, other in zip(solids(scene), solids(pairs), strict=True):
        for theirs, own_ones in zip(other.distances(x, 0.0), one.distances(x, 0.0), strict=True):
            np.testing.assert_array_equal(theirs, own_ones)
        assert other.friction == one.friction
    assert [solid.restitution for solid in solids(pairs)] == [0.0, 0.3, 0.3]


def test_links_are_told_apart():
    scene = build("cloth", columns=5, rows=4, shear=0.1, bend=0.05)
    kinds, stiffness = kinds_of_links(scene), scene.springs.stiffness
    for kind, k in (("structural", 0.5), ("shear", 0.1), ("bend", 0.05)):
        np.testing.assert_array_equal(kinds == kind, stiffness == k)


def test_what_is_switched_off_is_neither_compiled_nor_stored(device):
    stored = {
        "fracture": "link_status",
        "drag": "viscous",
        "walls": "low",
        "mouse: blow": "push",
    }
    scene = build("cloth", columns=6, rows=5)
    how = {"topology": "lanes", "execution": "serial", "lanes": 2}
    own = costs.describe(Simulation(scene, **how))
    assert set(stored.values()) <= {f.name for f in own.fields}
    for variant in variants(scene, on_graph=False):
        if variant.feature in stored:
            its = costs.describe(Simulation(variant.scene, **how))
            assert own.plan[SWITCHES[variant.feature]] and not its.plan[SWITCHES[variant.feature]]
            assert stored[variant.feature] not in {f.name for f in its.fields}
            assert its.bytes < own.bytes


def test_fields_and_their_bytes_are_those_on_the_device(device):
    """A position in f64 and 2-D takes 16 bytes; trees hold what the fields hold, and two pads."""
    sim = Simulation(build("cloth", columns=6, rows=5), topology="graph", execution="serial")
    said = costs.describe(sim)
    fields = {f.name: f for f in said.fields}
    assert (fields["x"].shape, fields["x"].bytes) == ((30, 2), 30 * 16)
    assert (
        fields["csr_other"].bytes == 2 * 49 * 4
        and fields["csr_k"].bytes == 8
        and said.on_graph == 49
    )
    assert "ring_forces" not in fields and "link_k" not in fields
    assert said.bytes == sum(f.bytes for f in said.fields) + 2 * 32 * 4
    larger = Simulation(build("cloth", columns=60, rows=50), topology="graph", execution="serial")
    assert costs.describe(larger).bytes > 50 * said.bytes


@thorough
def test_cloths_of_more_links_are_set_beside_the_first(device):
    """Three times the springs, in a third more memory; what they cost is measured, not asserted."""
    names = ("structural", "structural, shear, bend")
    cloths = {name: build("cloth", columns=16, rows=16, **explain.LINKS[name]) for name in names}
    how = {"topology": "lanes", "execution": "serial", "lanes": 2}
    one, other = costs.compare_links(cloths, 16, how, Clock(60.0), tell=lambda *_: None)
    assert one.ratio == 1.0 and other.springs > 2.5 * one.springs
    assert other.ratio_lower <= other.ratio <= other.ratio_upper
    assert other.bytes > 1.3 * one.bytes


def test_what_fails_as_it_runs_leaves_the_race_by_itself():
    """As a scene without a feature may: here a pinned particle that gravity pulls off once free."""
    world = World(size=(4.0, 3.0), gravity=(0.0, 20.0))
    place = np.array([[2.0, 1.0]])
    held, free = (Scene("one", world, Particles.build(place, fixed=f)) for f in (True, False))
    how = {"topology": "graph", "execution": "serial"}
    running = [costs.Candidate(scene, how) for scene in (held, held, free, held)]
    costs.race(running, Clock(20.0), lambda *_: None)
    assert [bool(one.failed) for one in running] == [False, False, True, False]
    assert "particle 0" in running[2].failed and all(len(running[k].seconds) for k in (0, 1, 3))


@thorough
def test_the_command_says_it_in_json(cli):
    out, _ = cli("explain", "oscillator", "--within", "110s", "--json", "--threads", 1)
    said = json.loads(out)
    plan = said["compiled"]["plan"]
    assert plan["springs"] and plan["uniform_springs"] and not plan["drag"] and plan["threads"] == 1
    assert said["compiled"]["on_graph"] == said["springs"] == 1
    assert 0 < said["lower"] <= said["seconds"] <= said["upper"]
    assert said["compile_seconds"] > 0
    by_name = {cost["feature"]: cost for cost in said["costs"]}
    assert by_name["springs"]["used"] and not by_name["collisions"]["used"]
    assert said["left_out"] == []
    assert by_name["collisions"]["bytes"] > 0
    for cost in said["costs"]:
        assert not cost["failed"] and cost["lower"] <= cost["seconds"] <= cost["upper"]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["box", "--all"], "--all: explains all built-in scenes, not 'box' alone"),
        (["--tables", "x.md"], "--tables: give --all, too"),
        (["--all", "--tables", "x.md"], "--tables x.md: there is no such file"),
        (["--all", "--tables", "latin.md"], "latin.md: is not a text file in UTF-8 (byte 25)"),
        (["--method", "verlte"], "did you mean 'verlet'?"),
        (["--arch", "vulkan", "--threads", "2"], "--threads: only --arch cpu takes it"),
    ],
)
def test_bad_arguments_are_refused_in_one_line(arguments, says, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "latin.md").write_bytes(b"<!-- explain:machine -->\n\xfc\n<!-- end -->\n")
    assert main(["explain", *arguments]) == 2
    out, err = capsys.readouterr()
    assert says in err and err.count("\n") == 1 and not out


def test_a_document_is_filled_between_its_markers():
    text = "a\n<!-- explain:machine -->\nold\n<!-- end -->\nb\n"
    made = explain.filled(text, [], [], {"cores": "2"})
    assert made == "a\n<!-- explain:machine -->\n- cores: 2\n<!-- end -->\nb\n"
    assert explain.filled(made, [], [], {"cores": "2"}) == made
    with pytest.raises(InputError, match="did you mean 'machine'"):
        explain.filled(text.replace("machine", "machin"), [], [], {})


def test_the_document_has_every_built_in_scene_and_the_links():
    text = DOCUMENT.read_text()
    marked = {
        match[1]: match[0] for match in re.finditer(r"explain:(\w+) -->.*?<!-- end", text, re.S)
    }
    assert marked.keys() == {"machine", "scenes", "costs", "links", "saving"}
    for name in library.names():
        assert f"`{name}" in marked["scenes"]
    for name in explain.SWITCHED:
        assert f"`{name}" in marked["costs"]
    ratios = re.findall(r"([\d.]+) times as long", marked["saving"])
    assert ratios and all(float(ratio) > 1.1 for ratio in ratios)
    assert all(f"{side} x {side}" in marked["links"] for side in (16, 128))
