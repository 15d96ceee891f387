"""Exports: what other programs read is what the simulation had, whole or not at all."""

import struct
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from gltf import glb

from taichi_cloth import Simulation
from taichi_cloth.cli.main import main
from taichi_cloth.errors import InputError
from taichi_cloth.files import exports
from taichi_cloth.files.exports import Export
from taichi_cloth.files.exports.frame import Clock
from taichi_cloth.files.trajectory import Trajectory, load
from taichi_cloth.scene.source import SceneSource

TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]])
SPRINGS = np.array([[0, 1], [1, 2], [2, 3], [3, 0], [0, 2]])
DT = 1 / 24
FORMATS = ("frames", "frames/cloth.ply", "frames/cloth.obj", "a.npz", "a.pc2", "a.usda")


class Moving:
    """What an export asks of a simulation: four particles that move, a triangle that tears."""

    dt = DT
    scene = SimpleNamespace(file_points=None, world=SimpleNamespace(dim=3, up="y"))

    def __init__(self, surface=True):
        self.frame, self.surface, self.more = 0, surface, 0

    @property
    def time(self):
        return self.frame * DT

    def positions(self):
        """Single precision, as of most runs, with digits of every size."""
        x = np.random.default_rng(self.frame).normal(0, 3, (4 + self.more, 3))
        return x.astype(np.float32).astype(float)

    def springs(self):
        return SPRINGS

    def springs_alive(self):
        return np.array([True, True, self.frame < 4, True, True])

    def triangles(self):
        return TRIANGLES if self.surface else TRIANGLES[:0]

    def triangles_alive(self):
        return np.array([True, self.frame < 4])[: len(self.triangles())]


def recorded(path, frames, every=1, sim=None):
    """An export of some frames that is still to be saved, and the positions of those it keeps."""
    export, sim, kept = Export(path, DT, every), sim or Moving(), {}
    for sim.frame in range(1, frames + 1):
        export.record(sim)
        if sim.frame % every == 0:
            kept[sim.frame] = sim.positions()
    return export, kept


def read_usda(path):
    """Positions and corners of faces by frame, as USD's text has them, and the frames a second."""
    text = path.read_text()

    def samples(name):
        if f"{name} = " in text:
            return {0: eval(text.partition(f"{name} = ")[2].partition("\n")[0])}
        block = text[text.index(f"{name}.timeSamples = {{") :].partition("\n    }")[0]
        lines = [line.strip().rstrip(",").partition(": ") for line in block.splitlines()[1:]]
        return {int(frame): eval(values, {"__builtins__": {}}) for frame, _, values in lines}

    rate = float(text.partition("timeCodesPerSecond = ")[2].partition("\n")[0])
    ends = [int(text.partition(f"{word}TimeCode = ")[2].split()[0]) for word in ("start", "end")]
    return samples("points"), samples("faceVertexIndices"), rate, ends


def read_back(path, name):
    """Positions by frame, triangles by frame, and frames in a second, where the format has it."""
    if name == "a.usda":
        points, faces, rate, (first, last) = read_usda(path)
        corners, now = {}, []
        for n in points:
            now = faces.get(n, faces.get(0, now))
            corners[n] = np.reshape(now, (-1, 3))
        assert (first, last) == (min(points), max(points))
        return points, corners, rate
    if name == "a.npz":
        with np.load(path) as z:
            faces = [z["triangles"][whole] for whole in z["triangle_whole"]]
            numbers = z["frame"].tolist()
            np.testing.assert_allclose(z["time"], z["frame"] * DT)
            points = dict(zip(numbers, z["position"], strict=True))
            return points, dict(zip(numbers, faces, strict=True)), float(z["rate"])
    if name == "a.pc2":
        data = path.read_bytes()
        word, version, points, first, step, samples = struct.unpack("<12siiffi", data[:32])
        assert word == b"POINTCACHE2\0" and version == 1 and len(data) == 32 + 12 * points * samples
        table = np.frombuffer(data, "<f4", offset=32).reshape(samples, points, 3)
        frames = (first + step * np.arange(samples)).astype(int).tolist()
        return dict(zip(frames, table, strict=True)), None, None
    found = sorted((path if name == "frames" else path.parent).iterdir())
    by_frame = {}
    for file in found:
        read = trimesh.load(file, process=False, maintain_order=True)
        by_frame[int(file.stem.partition("_")[2])] = read.vertices, read.faces
    about = found[0].read_bytes()[:200].decode("ascii", "replace")
    rate = float(about.partition(" frames a unit")[0].rpartition(", ")[2])
    x, faces = ({n: part[i] for n, part in by_frame.items()} for i in (0, 1))
    return x, faces, rate


@pytest.mark.parametrize("name", FORMATS)
def test_what_is_read_back_is_what_the_simulation_had(tmp_path, name):
    """Positions within 1e-6, the triangles that are whole, every second frame, and the rate."""
    export, kept = recorded(tmp_path / name, 6, every=2)
    export.save()
    points, faces, rate = read_back(tmp_path / name, name)
    assert list(points) == [2, 4, 6] == list(kept)
    for n, x in points.items():
        np.testing.assert_allclose(x, kept[n], atol=1e-6, rtol=0)
    if faces is not None:
        assert [len(f) for f in faces.values()] == [2, 1, 1] and rate == 24
        np.testing.assert_array_equal(faces[2], TRIANGLES)
    assert not list(tmp_path.rglob("*.part"))


def test_a_rate_is_whole_but_for_rounding_in_every_unit_of_time():
    """Also of scenes in microseconds; that of film which is slowed for television is not whole."""
    rates = (24.0, 49.0, 60.0, 24000 / 1001, 60e6, 483e6)
    assert any(1 / (1 / rate) != rate for rate in rates if rate > 1e6)
    for rate in rates:
        assert Clock(1 / rate, 1).rate == pytest.approx(rate, rel=1e-15)
        assert Clock(1 / rate, 1).rate.is_integer() == (rate != 24000 / 1001)
    for dt, rate in ((0.0166667, 60.0), (0.016667, 1 / 0.016667), (0.0083333, 120.0), (1.0, 1.0)):
        assert Clock(dt, 1).rate == rate


@pytest.mark.parametrize("name", FORMATS)
def test_the_last_frame_of_a_run_that_failed_stands_where_it_was(tmp_path, name):
    """A point cache, whose samples are equally far apart, would play it later, and goes without."""
    export, kept = recorded(tmp_path / name, 5, every=2)
    sim = Moving()
    sim.frame = 5
    export.record(sim, last=True)
    export.save()
    points = read_back(tmp_path / name, name)[0]
    assert list(points) == ([2, 4] if name == "a.pc2" else [2, 4, 5])
    np.testing.assert_allclose(points[4], kept[4], atol=1e-6, rtol=0)


@pytest.mark.parametrize("name", FORMATS)
def test_an_export_appears_whole_or_not_at_all(tmp_path, name):
    """A run that is given up leaves what was there; after a reset it begins anew."""
    first, _ = recorded(tmp_path / name, 5)
    first.save()
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    second, _ = recorded(tmp_path / name, 2)
    second.discard()
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before
    third, kept = recorded(tmp_path / name, 3)
    third.record(Moving())  # a reset: what was noted is forgotten
    for sim in [Moving()]:
        for sim.frame in (1, 2):
            third.record(sim)
    third.save()
    points = read_back(tmp_path / name, name)[0]
    assert list(points) == [1, 2]
    np.testing.assert_array_equal(np.float32(points[2]), np.float32(kept[2]))
    assert not list(tmp_path.rglob("*.part"))


@pytest.mark.parametrize("name", ["frames", "a.pc2", "a.usda"])
def test_an_interrupt_in_the_middle_of_a_frame_leaves_the_whole_ones(tmp_path, name, monkeypatch):
    export, kept = recorded(tmp_path / name, 2)
    sim = Moving()
    sim.frame = 3
    if name == "frames":
        written = Path.write_bytes

        def half(self, data):
            written(self, data[:50])
            raise KeyboardInterrupt

        monkeypatch.setattr(Path, "write_bytes", half)
    else:
        file = export._writer._file

        def half(data):
            file.file.write(data[:7])
            raise KeyboardInterrupt

        monkeypatch.setattr(file, "write", half)
    with pytest.raises(KeyboardInterrupt):
        export.record(sim)
    monkeypatch.undo()
    export.save()
    points = read_back(tmp_path / name, name)[0]
    assert list(points) == [1, 2]
    np.testing.assert_array_equal(np.float32(points[2]), np.float32(kept[2]))


def test_a_full_disk_is_a_line_and_leaves_nothing(tmp_path, monkeypatch):
    for name in ("frames", "a.pc2"):
        export, _ = recorded(tmp_path / name, 1)
        sim = Moving()
        sim.frame = 2

        def fail(*_):
            raise OSError(28, "No space left on device")

        if name == "frames":
            monkeypatch.setattr(Path, "write_bytes", fail)
        else:
            monkeypatch.setattr(export._writer._file, "file", Full(export._writer._file.file))
        with pytest.raises(InputError, match="No space left on device"):
            export.record(sim)
        monkeypatch.undo()
        assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["a.pc2", "a.usda"])
@pytest.mark.parametrize("back", [0, 1])
def test_a_disk_that_is_full_as_a_run_goes_back_is_a_line_and_leaves_nothing(tmp_path, name, back):
    """What was written is then often no further than memory."""
    export, _ = recorded(tmp_path / name, 2)
    export._writer._file.file = Full(export._writer._file.file)
    with pytest.raises(InputError, match=rf"{name}: cannot be written: No space left on device"):
        export.rewind(back)
    assert not list(tmp_path.iterdir())


class Full:
    """A file on a disk without room."""

    def __init__(self, file):
        self.closed, self.close = False, file.close

    def write(self, *_):
        raise OSError(28, "No space left on device")

    seek = truncate = write


def test_a_scene_without_a_surface_and_particles_that_come_later(tmp_path):
    """Springs as edges; what is clicked in later is left out, and counted."""
    sim = Moving(surface=False)
    export, _ = recorded(tmp_path / "chain.obj", 1, sim=sim)
    sim.frame, sim.more = 2, 3
    export.record(sim)
    export.save()
    assert export.left_out == 3
    text = (tmp_path / "chain_00002.obj").read_text()
    assert text.count("\nv ") == 4 and text.count("\nl ") == len(SPRINGS)


class Clicked(Moving):
    """What a trajectory asks besides; `more` particles are tied to the one before each."""

    velocities = Moving.positions

    def __init__(self):
        super().__init__()
        began = SimpleNamespace(position=self.positions(), fixed=np.zeros(4, bool))
        world = SimpleNamespace(dim=3, up="y")
        self.scene = SimpleNamespace(world=world, particles=began, file_points=None)

    @property
    def particle_count(self):
        return 4 + self.more

    def springs(self):
        return np.concatenate([SPRINGS, np.arange(3, 3 + self.more)[:, None] + [0, 1]])

    def springs_alive(self):
        return np.ones(len(self.springs()), bool)


def test_an_archive_has_no_springs_of_particles_that_it_leaves_out(tmp_path):
    sim, path = Clicked(), tmp_path / "run.npz"
    export = Export(path, sim.dt)
    for sim.frame, sim.more in ((1, 0), (2, 2)):
        export.record(sim)
    export.save()
    found = np.load(path)
    np.testing.assert_array_equal(found["springs"], SPRINGS)
    assert found["spring_held"].shape == (2, len(SPRINGS)) and export.left_out == 2


def test_a_trajectory_that_goes_back_to_before_a_click_has_nothing_of_what_was_clicked(tmp_path):
    """Neither its particles nor its springs, whose ends would be none of the file's."""
    sim, made, kept = Clicked(), Trajectory(tmp_path / "run.npz"), []
    for sim.frame, sim.more in ((1, 0), (2, 0), (3, 2)):
        made.record(sim)
        kept.append(sim.positions())
    made.rewind(2)
    made.save()
    found = load(tmp_path / "run.npz")
    np.testing.assert_array_equal(found.position, kept[:2])
    np.testing.assert_array_equal(found.spring, SPRINGS)
    assert found.spring_alive.shape == (2, len(SPRINGS))


class Elsewhere(Moving):
    """It tears, has a spring more or a particle more as it is told to, and not by its frame."""

    torn = tied = False

    def springs(self):
        return np.concatenate([SPRINGS, [[1, 3]]]) if self.tied else SPRINGS

    def springs_alive(self):
        return np.array([True, True, not self.torn, True, True, True])[: len(self.springs())]

    def triangles_alive(self):
        return np.array([True, not self.torn])


@pytest.mark.parametrize("name", FORMATS)
def test_an_export_whose_run_went_back_is_as_if_it_had_never_been_there(tmp_path, name):
    """To the byte, however far it went back; it began anew, and had nothing of what was before."""

    def made(path, *ways):
        export, sim = Export(path, DT, 2), Elsewhere()
        for back, frames, told in ways:
            export.rewind(back)
            vars(sim).update({"torn": False, "tied": False, "more": 0, **told})
            for sim.frame in frames:
                export.record(sim)
        export.save()
        found = sorted(file for file in tmp_path.rglob("*") if file.is_file())
        return [(file.name, file.read_bytes()) for file in found], export.frames, export.left_out

    began, gone = (0, range(1, 6), {}), (5, range(6, 10), {"torn": True, "tied": True, "more": 2})
    for back in (5, 4, 2, 1):
        on = (back, range(back + 1, 11), {"torn": back < 5})
        straight = made(tmp_path / name, (0, range(1, back + 1), {}), on)
        assert made(tmp_path / name, began, gone, on) == straight and straight[1:] == (5, 0)
    *_, frames, left_out = made(tmp_path / name, began, gone, (7, range(8, 9), gone[2]))
    assert (frames, left_out) == (4, 2)


@pytest.mark.parametrize("name", FORMATS)
def test_a_scene_whose_y_points_down_hangs_downwards(tmp_path, name):
    """Turned half round about x, so that no triangle is turned over; archives are the scene's."""
    sim = Moving()
    sim.scene = SimpleNamespace(file_points=None, world=SimpleNamespace(dim=3, up=""))
    export, kept = recorded(tmp_path / name, 2, sim=sim)
    export.save()
    points, faces, _ = read_back(tmp_path / name, name)
    turn = [1, 1, 1] if name == "a.npz" else [1, -1, -1]
    for n, x in points.items():
        np.testing.assert_allclose(x, kept[n] * turn, atol=1e-6, rtol=0)
    if faces is not None:
        np.testing.assert_array_equal(faces[1], TRIANGLES)


def test_a_cache_has_its_mesh_beside_it_and_never_over_another_one(tmp_path, capsys):
    """As the scene begins, with the same vertices; a mesh that fits is left as it is."""
    (tmp_path / "cloth.glb").write_bytes(glb(np.eye(4)))
    scene = SceneSource(str(tmp_path / "cloth.glb")).build()
    sim = Simulation(scene, method="symplectic_euler", substeps=100, topology="graph")

    def made():
        export = Export(tmp_path / "out.pc2", sim.dt, scene=scene)
        sim.advance()
        export.record(sim, last=True)
        export.save()

    made()
    mesh = trimesh.load(tmp_path / "out.obj", process=False)
    sample = np.frombuffer((tmp_path / "out.pc2").read_bytes(), "<f4", offset=32).reshape(4, 3)
    np.testing.assert_array_equal(mesh.vertices, scene.particles.position)
    np.testing.assert_array_equal(mesh.faces, scene.triangles)
    np.testing.assert_allclose(sample, sim.positions(), atol=1e-6)
    # A user's own file of this mesh, whose vertices lie elsewhere.
    own = (tmp_path / "out.obj").read_text().replace("# frame", "# mine").replace("v 1", "v 1.0")
    (tmp_path / "out.obj").write_text(own)
    made()
    assert (tmp_path / "out.obj").read_text() == own
    other = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 4\nf 2 3 4\n"
    (tmp_path / "out.obj").write_text(other)
    before = (tmp_path / "out.pc2").read_bytes()
    words = ["run", str(tmp_path / "cloth.glb"), "--headless", "--frames", "2"]
    assert main([*words, "--export", str(tmp_path / "out.pc2")]) == 2
    says = f"--export {tmp_path}/out.pc2: the mesh that it fits, '{tmp_path}/out.obj', would be wri"
    assert says in capsys.readouterr().err and (tmp_path / "out.pc2").read_bytes() == before
    assert (tmp_path / "out.obj").read_text() == other and not list(tmp_path.glob("*.part"))
    with pytest.raises(InputError, match="there is no folder"):
        Export(tmp_path / "none/out.pc2", sim.dt, scene=scene)


def test_torn_cloth_in_obj_files_is_noted_once(tmp_path):
    """With the frames in which vertices have no face; formats that keep these say nothing."""
    for name, says in (
        (
            "frames/cloth.obj",
            ["in 3 frames torn cloth has vertices without a face, up to 1: t"],
        ),
        ("frames/cloth.ply", []),
        ("a.usda", []),
    ):
        export, _ = recorded(tmp_path / name, 6)
        assert [note[: len(s)] for note, s in zip(export.notes(), says, strict=True)] == says
        export.rewind(3)
        assert export.notes() == []
        export.discard()


def test_what_is_exported_is_valid_usd(tmp_path):
    """By usd-core's own validators: of a surface that tears, and of points alone."""
    usd, checks = pytest.importorskip("pxr.Usd"), pytest.importorskip("pxr.UsdValidation")
    for surface in (True, False):
        path = tmp_path / f"{surface}.usda"
        export, _ = recorded(path, 6, sim=Moving(surface))
        export.save()
        validators = checks.ValidationRegistry().GetOrLoadAllValidators()
        stage = usd.Stage.Open(str(path))
        assert len(validators) > 20 and stage.GetTimeCodesPerSecond() == 24
        assert checks.ValidationContext(validators).Validate(stage) == []


def test_formats_that_are_none_are_refused_by_name(tmp_path, monkeypatch, capsys):
    (tmp_path / "file").touch()
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(__import__("sys").modules, "pxr", None)  # as where it is not installed
    for word, says in (
        ("a.foo", "'.foo' is no format of results; did you mean '.obj'?"),
        ("a.usd", ".usd needs usd-core, which is not there (pip install 'taichi-cloth[usd]')"),
        ("no/a.pc2", "there is no folder 'no'"),
        ("no/way/a.ply", "there is no folder 'no'"),
        ("file/a.ply", "'file' is a file, not a folder"),
    ):
        assert main(["run", "--headless", "--frames", "1", "--export", word]) == 2
        assert says in capsys.readouterr().err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "here"]
    assert exports.open_export(Path("here"), exports.Clock(1.0, 1)).discard() is None
