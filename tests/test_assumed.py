"""What a scene in metres takes by itself: its steps, and how wide and bouncy its particles are."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from taichi_cloth.cli import run_options
from taichi_cloth.errors import InputError
from taichi_cloth.scene import library, rules, scenefile
from taichi_cloth.scene.assignments import read as assignment
from taichi_cloth.scene.model import ParticleDefaults, World
from taichi_cloth.scene.source import SceneSource
from taichi_cloth.settings.options import RunOptions
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.version import __version__

METRES = '[world]\nsize = [4.0, 4.0, 4.0]\nup = "y"\ngravity = [0.0, -9.81, 0.0]\n'
SHEET = """[[cloths]]
origin = [1.0, 2.0, -0.5]
columns = 6
rows = 5
spacing = 0.1
links = ["structural", "shear"]
down = [0.0, 0.0, 1.0]
stretch = 80.0
shear = 10.0
density = 0.2
"""
PIXELS = "[world]\nsize = [400.0, 300.0]\n"


def parsed(text, *assigned):
    return scenefile.parse(text, assignments=tuple(map(assignment, assigned)))


def step(text, *assigned):
    world = parsed(text, *assigned).world
    return world.dt, world.substeps


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        (PIXELS, (1.0, 1)),
        (PIXELS + "rate = 8\nsubsteps = 3\n", (1 / 8, 3)),
        (PIXELS + 'dt = 0.25\nsubsteps = "auto"\n', (0.25, "auto")),
        (METRES, (1 / 60, "auto")),
        (METRES + "rate = 60\n", (1 / 60, "auto")),
        (METRES + "dt = 0.01\nsubsteps = 7\n", (0.01, 7)),
        (PIXELS + 'up = ""\n', (1.0, 1)),
    ],
)
def test_a_file_says_its_step(text, wanted):
    assert step(text) == wanted


def test_a_mesh_is_in_metres_whichever_way_is_up(tmp_path):
    (tmp_path / "two.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    text = '[world]\nsize = [4, 4, 4]\n[[meshes]]\nfile = "two.obj"\nmove = [1, 1, 0]\n'
    scene = scenefile.parse(text, folder=tmp_path)
    assert (scene.world.dt, scene.world.substeps) == (1 / 60, "auto")
    assert scene.particle_defaults == ParticleDefaults()  # radius and bounces go by `up`


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        ("dt = 0.1\nrate = 60", r"line 6: \[world\]: rate stands for dt = 1 / rate; give one"),
        ("rate = 0", r"line 5: \[world\]: rate must be positive, is 0"),
        ("rate = -60.0", "rate must be positive, is -60"),
        ("rate = inf", "rate must be finite"),
        ('rate = "60"', "rate must be a number"),
        ("substeps = 0", 'substeps must be a whole number from 1 to 1000000, or "auto", is 0'),
        ("substeps = 1000001", 'or "auto", is 1000001'),
        ("substeps = 2.5", 'substeps must be a whole number, or "auto", is'),
        ("substeps = true", 'substeps must be a whole number, or "auto", is'),
        ('substeps = "many"', 'substeps must be a whole number, or "auto", is'),
    ],
)
def test_a_step_that_makes_no_sense_is_refused_with_its_line(lines, says):
    with pytest.raises(InputError, match=says):
        parsed(METRES + lines + "\n")


def test_an_assignment_of_the_rate_stands_for_the_files_dt_and_the_other_way_round():
    assert step(METRES + "dt = 0.1\n", "world.rate=120") == (1 / 120, "auto")
    assert step(METRES + "rate = 60\n", "world.dt=0.5") == (0.5, "auto")
    assert step(METRES, "world.substeps=3") == (1 / 60, 3)
    with pytest.raises(InputError, match="--set world.rate: rate stands for dt"):
        parsed(METRES, "world.dt=0.1", "world.rate=60")


@pytest.mark.parametrize("name", ["flag", "cloth", "warp"])
def test_steps_are_written_and_read_back(name):
    scene = library.build(name)
    assert scene.world.substeps == (1 if name == "cloth" else "auto")
    for substeps in (1, 12, "auto"):
        given = scene.with_world(substeps=substeps)
        assert scenefile.parse(scenefile.dump(given), default_scene_name=name) == given


def test_flags_stand_in_for_the_files_steps():
    def taken(world, **given):
        options = run_options.of_scene(RunOptions.from_given(given), world)
        return options.dt, options.substeps

    own, auto = World((1.0, 1.0), (0.0, 0.0), substeps=5), World((1.0, 1.0), (0.0, 0.0))
    auto = replace(auto, substeps="auto")
    assert taken(own) == (None, 5) and taken(auto) == ("auto", 1)
    assert taken(own, dt=0.1) == (0.1, 5) and taken(auto, dt=0.1) == (0.1, 1)
    assert taken(own, substeps=2) == (None, 2) and taken(auto, substeps=2) == (None, 2)
    assert taken(own, dt="auto") == ("auto", 1) and taken(auto, dt="auto") == ("auto", 1)


@pytest.mark.usefixtures("device")
def test_a_simulation_takes_the_steps_of_its_scene():
    scene = parsed(METRES + SHEET)
    sim = Simulation(scene, topology="graph", execution="serial")
    assert sim.follows and sim.substeps > 1 and sim.dt == 1 / 60
    chosen = sim.substeps
    with pytest.raises(InputError, match="it cannot be set: begin with substeps of your own"):
        sim.set_step(substeps=3)
    sim.advance(60)  # a second in which one step a frame would run away
    sim = Simulation(scene, topology="graph", execution="serial", substeps=chosen)
    assert not sim.follows and sim.substeps == chosen
    sim.load_scene(scene.with_world(substeps=9))
    assert not sim.follows and sim.substeps == 9
    sim.load_scene(scene)
    assert sim.follows and sim.substeps == chosen
    sim.load_scene(scene.with_world(substeps=9))  # one that chooses goes on choosing
    assert sim.follows and sim.substeps == chosen


@pytest.mark.parametrize(
    ("more", "radius", "words"),
    [
        (SHEET, 0.01, "0.01, a tenth of the least spacing"),
        (SHEET + "thickness = 0.004\n", 0.002, "half the thickness where cloth has one, else 0.01"),
        ("[particle]\nthickness = 0.03\n" + SHEET, 0.015, "0.015, half the thickness"),
        ("[particle]\nmass = 0.1\n" + SHEET, 0.01, "0.01, a tenth of the least spacing"),
        ("[[particles]]\nposition = [1, 1, 0]\n", 0.04, "0.04, a hundredth of the world's"),
    ],
)
def test_in_metres_a_radius_follows_from_the_cloth_and_nothing_bounces(more, radius, words):
    scene = parsed(METRES + more)
    assert np.allclose(scene.particles.radius, radius, rtol=1e-12, atol=0)
    assert (scene.particles.restitution == 0).all() and scene.particle_defaults.restitution == 0
    assert scene.assumed["particle.radius"].startswith(words)
    assert scene.assumed["particle.restitution"] == "0"
    again = scenefile.parse(scenefile.dump(scene), default_scene_name=scene.name)
    assert again == scene and not again.assumed.keys() - {"world.substeps"}


def test_a_thickness_from_which_no_radius_follows_is_refused_by_its_own_line():
    with pytest.raises(
        InputError, match=r"line 6: \[particle\]: thickness must be a finite number"
    ):
        parsed(METRES + "[particle]\nthickness = inf\n" + SHEET)


def test_what_a_file_gives_stays_and_pixels_have_the_originals_numbers():
    given = parsed(METRES + "[particle]\nradius = 0.3\nrestitution = 0.9\n" + SHEET)
    assert (given.particles.radius == 0.3).all() and (given.particles.restitution == 0.9).all()
    assert given.assumed.keys() == {"world.dt", "world.substeps"}
    two = parsed(METRES + "[[particles]]\nposition = [1, 1, 0]\nradius = 0.2\n" + SHEET)
    assert two.particles.radius[0] == 0.2 and (two.particles.radius[1:] == 0.01).all()
    pixels = parsed(PIXELS + "[[particles]]\nposition = [1, 1]\n")
    assert pixels.particle_defaults == ParticleDefaults() and not pixels.assumed


def test_explain_and_verbose_say_what_was_taken(cli, tmp_path):
    """And both run such a file as it is, in steps that are stable."""
    file = tmp_path / "sheet.toml"
    file.write_text(METRES + SHEET)
    taken = (
        "world.dt = 1/60",
        'world.substeps = "auto": as many as are stable',
        "particle.radius = 0.01, a tenth of the least spacing",
        "particle.restitution = 0",
    )
    out, _ = cli("run", file, "--headless", "--frames", 5, "--verbose")
    assert all(f"\n  {words}\n" in out for words in taken) and "5 frames" in out
    out, _ = cli("run", file, "--headless", "--frames", 5)
    assert "particle.radius" not in out
    out, _ = cli("explain", file, "--within", "5s")
    assert all(words in " ".join(out.split()) for words in taken)
    _, err = cli("run", file, "--quiet", "--verbose", check=2)
    assert "--quiet and --verbose exclude each other" in err


FALLS = METRES.replace("9.81", "1.0") + "dt = 0.01\nsubsteps = 2\n" + SHEET
OPEN, GIVEN = FALLS, FALLS + "[particle]\nradius = 0.01\nrestitution = 0.0\n"
PIXELS_OF_MESHES = """
[world]
size = [9.0, 9.0, 9.0]
dt = 0.1
substeps = 2
[[meshes]]
file = "sheet.obj"
"""
REFUSED = r"made under model 1, by .*; since then the radius and the restitution .* changed"


def older(line):
    """The first line of a log as an earlier version wrote it."""
    header = json.loads(line)["header"]
    assert header.pop("model") == 2 and header.pop("version") == __version__
    return json.dumps({"header": header})


def test_a_log_or_checkpoint_of_other_rules_is_refused_by_name(cli, tmp_path):
    """Of a scene that they touch; of others both go on, to the bit."""
    log, there, old = tmp_path / "a.jsonl", tmp_path / "a.npz", tmp_path / "old.npz"
    frames = {}
    for name, text in (("open", OPEN), ("given", GIVEN)):
        file = tmp_path / f"{name}.toml"
        file.write_text(text)
        run = "run", file, "--headless", "--frames", 3
        cli(*run, "--record", log, "--checkpoint", there, "--save", tmp_path / f"{name}.npz")
        lines = log.read_text().splitlines()
        cli(*run, "--events", log)
        log.write_text("\n".join([older(lines[0]), *lines[1:]]))
        with np.load(there) as archive:
            arrays = dict(archive)
        meta = json.loads(str(arrays["meta"]))
        assert meta.pop("noted") == {"model": 2, "version": __version__}
        np.savez(old, **arrays | {"meta": np.array(json.dumps(meta))})
        for flag, path, place in (
            ("--events", log, "a.jsonl line 1"),
            ("--resume", old, "old.npz"),
        ):
            again = tmp_path / f"{name}-again.npz"
            _, err = cli(*run, flag, path, "--save", again, check=2 * (name == "open"))
            if name == "open":
                assert re.search(rf"{place}: .*{REFUSED}.* 'open' with it", err), err
                assert not again.exists()
        with np.load(tmp_path / f"{name}.npz") as saved:
            frames[name] = saved["position"]
    with np.load(tmp_path / "given-again.npz") as resumed:
        assert resumed["frame"].tolist() == [4, 5, 6]
    cli(*run, "--events", log, "--save", again)
    with np.load(again) as replayed:
        assert (replayed["position"] == frames["given"]).all()


def test_a_recording_of_other_rules_is_compared_with_its_like_alone(cli, tmp_path):
    file, a, b = (tmp_path / name for name in ("open.toml", "a.npz", "b.npz"))
    file.write_text(OPEN)
    for path in (a, b):
        cli("run", file, "--headless", "--frames", 2, "--save", path)
    cli("compare", a, b)
    with np.load(a) as archive:
        arrays = dict(archive)
    meta = json.loads(str(arrays["meta"]))
    del meta["model"]
    meta["versions"]["taichi_cloth"] = "0.0.9"
    np.savez(a, **arrays | {"meta": np.array(json.dumps(meta))})
    _, err = cli("compare", a, b, check=2)
    assert re.search(rf"a.npz: was {REFUSED}", err) and "by taichi-cloth 0.0.9" in err


@pytest.mark.parametrize(
    ("noted", "says"),
    [
        ({"model": 1, "dt": 0.1}, "by a taichi-cloth before models were noted; since then the rad"),
        ({"model": 1}, "restitution of .*, and the steps of what .* have changed"),
        ({"model": 2}, None),
        ({"model": 3, "version": "9.9"}, "under model 3, by taichi-cloth 9.9, .*up to 2; take"),
    ],
)
def test_what_has_changed_is_named(noted, says):
    scene = parsed(METRES + SHEET)
    if says is None:
        return rules.refuse_changed(scene, noted, "x")
    with pytest.raises(InputError, match=says):
        rules.refuse_changed(scene, noted, "x")


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ("bending = 1e-5\n", "since then the bending of meshes has changed"),
        ("", None),
    ],
)
def test_the_bending_that_files_of_meshes_give_has_another_rule(keys, says, tmp_path):
    """What is listed, as a saved scene has it, is what it was."""
    (tmp_path / "sheet.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 2 4 3\n")
    (tmp_path / "mesh.toml").write_text(PIXELS_OF_MESHES + keys)
    scene = scenefile.load(tmp_path / "mesh.toml")
    noted = {"model": 1, "dt": 0.1}
    if says:
        with pytest.raises(InputError, match=says):
            rules.refuse_changed(scene, noted, "x")
    rules.refuse_changed(scene, {"model": 2}, "x")
    listed = scene if says is None else scenefile.parse(scenefile.dump(scene))
    rules.refuse_changed(listed, noted, "x")


@pytest.mark.parametrize("name", ["box", "cloth"])
def test_no_rule_of_the_seeds_scenes_has_changed(name):
    rules.refuse_changed(library.build(name), {"model": 1}, "x")


def test_logs_of_sandbox_are_of_the_rule_by_which_its_discs_touch():
    """By the seed's one they replay as ever, as the log in docs says it."""
    resting = library.build("sandbox", particles=3)
    with pytest.raises(InputError, match="the contact of sandbox's discs has changed"):
        rules.refuse_changed(resting, {}, "a log")
    rules.refuse_changed(resting, rules.NOTED, "a log")
    rules.refuse_changed(resting.with_world(contact="original"), {}, "a log")
    rules.refuse_changed(library.build("box"), {}, "a log")


def panel(folder, unit, name="panel.obj"):
    """A rectangle of 0.6 by 0.7 m, 13 by 15 vertices, in a unit of so many metres."""
    rows = [
        f"v {0.05 * i / unit:.12g} {0.05 * j / unit:.12g} 0" for j in range(15) for i in range(13)
    ]
    cells = [j * 13 + i + 1 for j in range(14) for i in range(12)]
    faces = [f"f {n} {n + 1} {n + 14} {n + 13}" for n in cells]
    (folder / name).write_text("\n".join([*rows, *faces, ""]))
    return str(folder / name)


def hung(file, *assigned):
    return SceneSource(file, {}, tuple(map(assignment, assigned))).build()


@pytest.mark.parametrize(
    ("unit", "scale", "words"),
    [
        (0.001, "0.001", "it is 700 m large, .*: if it is in millimetres, "),
        (0.01, "0.01", "it is 70 m large, .*: if it is in centimetres, "),
        (0.0254, "0.0254", "it is 27.6 m large, .*: if it is in inches, "),
        (100.0, "100", "it is 0.007 m large, and garments are about 1 m: "),
    ],
)
def test_a_garment_in_other_units_is_told_of_and_hangs_as_in_metres_once_it_is_scaled(
    tmp_path, unit, scale, words
):
    metres, other = hung(panel(tmp_path, 1.0)), panel(tmp_path, unit, "other.obj")
    assert not metres.notes
    (note,) = hung(other).notes
    flag = f"--set meshes[0].scale={scale}"
    assert re.search(words + re.escape(flag), note) and note.endswith(f"{flag} makes it 0.7 m")
    scene = hung(other, flag.removeprefix("--set "))
    assert not scene.notes
    assert (scene.particles.fixed == metres.particles.fixed).all()
    close = {"rtol": 1e-9, "atol": 1e-12}  # as many digits as the file has
    np.testing.assert_allclose(scene.world.size, metres.world.size, **close)
    for name in ("position", "mass", "radius", "thickness", "viscous"):
        here, there = (getattr(of.particles, name) for of in (scene, metres))
        np.testing.assert_allclose(here, there, **close)
    for name in ("stiffness", "rest_length", "damping"):
        here, there = (getattr(of.springs, name) for of in (scene, metres))
        np.testing.assert_allclose(here, there, **close)
    np.testing.assert_allclose(scene.stencils.bending, metres.stencils.bending, **close)
    assert (scene.world.dt, scene.world.substeps) == (1 / 60, "auto")


@pytest.mark.parametrize(
    ("assigned", "held"),
    [
        (["meshes[0].turn=[0,90,0]"], 13),  # still the upper edge
        (["meshes[0].turn=[0,0,90]"], 15),  # a side, now the upper one
        (["meshes[0].turn=[90,0,0]"], 13),  # it lies
        (["meshes[0].turn=[0,0,180]", "meshes[0].move=[3,0.75,0.5]"], 13),
        (["meshes[0].scale=2", "meshes[0].move=[3,0.2,-9]"], 13),
    ],
)
def test_pins_and_world_follow_from_the_mesh_as_it_is_placed(tmp_path, assigned, held):
    scene = hung(panel(tmp_path, 1.0), *assigned)
    x, fixed, size = (
        scene.particles.position,
        scene.particles.fixed,
        np.ptp(scene.particles.position, axis=0),
    )
    assert fixed.sum() == held
    axis, way = (1, 1) if size[1] > 1e-6 else (2, -1)  # the highest, else the farthest
    assert (way * x[fixed, axis]).min() > (way * x[~fixed, axis]).max()
    low, high = scene.world.low, scene.world.high
    assert (x >= low).all() and (high[:2] - x.max(axis=0)[:2] >= 0.99 * size.max()).all()
    if "move" in " ".join(assigned):
        np.testing.assert_allclose(x[0], assignment(assigned[-1]).value, atol=1e-12)


@pytest.mark.parametrize(
    ("assigned", "says"),
    [
        ("meshes[0].scale=-1", r"^--set meshes\[0\].scale: scale must be positive and finite"),
        ("meshes[0].scale=big", r"^--set meshes\[0\].scale: scale must be a number"),
        ("meshes[0].turn=[90,0]", r"^--set meshes\[0\].turn: turn must have 3 numbers"),
        ("meshes[0].move=[-9,0,0]", "is outside the world"),
    ],
)
def test_a_placing_that_makes_no_sense_is_refused_by_its_flag(tmp_path, assigned, says):
    with pytest.raises(InputError, match=says):
        hung(panel(tmp_path, 1.0), assigned)


def test_a_garment_in_millimetres_runs_once_it_is_scaled(cli, tmp_path):
    file = panel(tmp_path, 0.001)
    out, err = cli("run", file, "--headless", "--frames", 5, "--set", "meshes[0].scale=0.001")
    assert "5 frames" in out and "garments" not in err
    _, err = cli("run", file, "--headless", "--frames", 1)
    assert err.count("garments") == 1 and "--set meshes[0].scale=0.001 makes it 0.7 m" in err


@pytest.mark.parametrize("name", ["flag", "curtain", "twist"])
def test_places_where_faces_touch_what_is_sharp_have_changed(name):
    scene = replace(library.build(name), assumed={})
    with pytest.raises(InputError, match="how faces and edges touch what is sharp has chang"):
        rules.refuse_changed(scene, {"model": 1}, "x")
    rules.refuse_changed(scene, rules.NOTED, "x")
    rules.refuse_changed(replace(scene, obstacles=()), {"model": 1}, "x")


@pytest.mark.parametrize(
    ("name", "touched"),
    [("shirt", True), ("trampoline", False), ("drape", False), ("cloth", False), ("warp", False)],
)
def test_masses_of_meshes_have_changed_and_those_of_grids_have_not(name, touched):
    scene = replace(library.build(name), assumed={}, of_meshes=frozenset())
    if touched:
        with pytest.raises(InputError, match="how the vertices of a mesh share its mass has chang"):
            rules.refuse_changed(scene, {"model": 1}, "x")
        scene = replace(
            scene, particles=replace(scene.particles, mass=0 * scene.particles.mass + 1)
        )
    rules.refuse_changed(scene, {"model": 1}, "x")


@pytest.mark.parametrize(("high", "cell", "touched"), [(1, None, 0), (0.04, None, 1), (1, 0.02, 0)])
def test_grids_of_meshes_that_are_thin_have_changed(high, cell, touched):
    box = trimesh.creation.box((1, high, 1))
    body = f'[[obstacles]]\nshape = "mesh"\nvertices = {box.vertices.tolist()}\n'
    body += f"faces = {box.faces.tolist()}\n" + (f"cell = {cell}\n" if cell else "")
    drop = "[particle]\nradius = 0.1\nrestitution = 0.0\n[[particles]]\nposition = [0, 1, 0]\n"
    scene = parsed(METRES + drop + body)
    if touched:
        with pytest.raises(InputError, match="the grid of obstacles that are meshes has changed"):
            rules.refuse_changed(scene, {"model": 1, "dt": 1 / 60}, "x")
    else:
        rules.refuse_changed(scene, {"model": 1, "dt": 1 / 60}, "x")
