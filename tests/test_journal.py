"""Sweeps go on after a kill: nothing that was finished is lost, nothing is measured twice."""

import csv
import errno
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from selection import thorough

from taichi_cloth.errors import InputError
from taichi_cloth.kernels import methods
from taichi_cloth.limits.network import Network
from taichi_cloth.scene import library
from taichi_cloth.scene.source import SceneSource
from taichi_cloth.settings.sweeps import TradeOptions, TuneOptions
from taichi_cloth.stability import experiment
from taichi_cloth.sweeps import journal as journals
from taichi_cloth.sweeps.identity import of_scene
from taichi_cloth.sweeps.journal import Journal, kept, key_of

OF = {"command": "trade", "scene": "cloth"}


def written(folder, count):
    """A journal of some results, the first with a file, left as a kill would leave it."""
    journal = Journal(folder, OF)
    for number in range(count):
        file = None
        if number == 0:
            file = journal.new_file(".npz")
            np.savez(file, x=np.arange(3.0))
        journal.add(key_of("run", number), {"error": number / 3, "never": float("inf")}, file)
    journal._file.close()  # as the system does
    return folder / journals.NAME


def test_what_is_finished_is_there_after_a_kill_at_any_byte(tmp_path):
    """Whatever of the last line was written: the results before it are whole, to the bit."""
    path = written(tmp_path, 3)
    whole = path.read_bytes()
    ends = [at + 1 for at, byte in enumerate(whole) if byte == 10]
    (tmp_path / journals.FILES / "torn.npz").write_bytes(b"half")
    for size in range(len(whole), 0, -7):
        path.write_bytes(whole[:size])
        journal = Journal(tmp_path, OF, resume=True)
        assert journal.resumed == max(sum(end <= size for end in ends) - 1, 0)
        for number in range(journal.resumed):
            found = journal.get(key_of("run", number))
            assert found.result == {"error": number / 3, "never": float("inf")}
            assert number or list(np.load(found.file)["x"]) == [0, 1, 2]
        assert journal.get(key_of("run", journal.resumed)) is None
        journal.add(key_of("run", 9), "more")
        journal._file.close()
        again = Journal(tmp_path, OF, resume=True)
        assert again.get(key_of("run", 9)).result == "more"
        assert not (tmp_path / journals.FILES / "torn.npz").exists()
        again._file.close()


def test_a_file_that_is_not_there_is_written_anew(tmp_path):
    written(tmp_path, 2)
    (file,) = (tmp_path / journals.FILES).iterdir()
    file.write_bytes(b"")
    journal = Journal(tmp_path, OF, resume=True)
    assert journal.finished() == [key_of("run", 1)]
    journal.discard()
    assert not list(tmp_path.iterdir())


def test_what_is_not_as_it_was_written_is_measured_again(tmp_path):
    """Of a file that changed at the same size, and of lines that are JSON as before."""
    path = written(tmp_path, 3)
    whole = path.read_bytes()
    (file,) = (tmp_path / journals.FILES).iterdir()
    states = file.read_bytes()
    file.write_bytes(states[:-1] + bytes([states[-1] ^ 1]))
    path.write_bytes(whole.replace(b"0.6666", b"0.6667"))
    journal = Journal(tmp_path, OF, resume=True)
    assert journal.finished() == [key_of("run", 1)] and not file.exists()
    assert journal.once(key_of("run", 2), lambda: "again") == "again"
    journal._file.close()
    path.write_bytes(whole.replace(b', "crc"', b', "sum"'))
    assert Journal(tmp_path, OF, resume=True).resumed == 0


def test_a_line_that_is_nested_deeply_is_none_of_a_journal(tmp_path):
    path = written(tmp_path, 1)
    with path.open("ab") as file:
        file.write(b"[" * 100_000 + b"\n")
    with pytest.raises(InputError, match="line 3 is none of a journal"):
        Journal(tmp_path, OF, resume=True)


@pytest.mark.parametrize(
    ("identity", "says"),
    [
        ({**OF, "scene": "box"}, "its scene is 'cloth', here it is 'box'"),
        ({**OF, "settings": "--quick"}, "its settings are 'None', here they are '--quick'"),
        ({"command": "trade"}, "its scene is 'cloth', here it is 'None'"),
    ],
)
def test_another_sweep_s_journal_is_refused_by_name_and_stays(tmp_path, identity, says):
    path = written(tmp_path, 2)
    before = path.read_bytes()
    with pytest.raises(InputError, match="another sweep's") as refused:
        Journal(tmp_path, identity, resume=True)
    assert says in str(refused.value) and str(path) in str(refused.value)
    assert path.read_bytes() == before
    for word in (b'"result"', b'"key"', b'"bytes"'):
        path.write_bytes(before.replace(word, b'"other"'))
        with pytest.raises(InputError, match="line 2 is none of a journal"):
            Journal(tmp_path, OF, resume=True)
    assert Journal(tmp_path, OF).resumed == 0  # anew


def full(*_):
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_full_disk_is_named_and_leaves_what_was_whole(tmp_path, monkeypatch):
    """No half of a line, and no journal that has none."""
    path = tmp_path / journals.NAME
    with monkeypatch.context() as disk:
        disk.setattr(os, "fsync", full)
        with pytest.raises(InputError, match=f"^{path}: cannot be written: No space left"):
            Journal(tmp_path, OF)
    assert not list(tmp_path.iterdir())
    journal = Journal(tmp_path, OF)
    journal.add("a", 1)
    with monkeypatch.context() as disk:
        disk.setattr(os, "fsync", full)
        with pytest.raises(InputError, match=f"^{path}: cannot be written: No space left"):
            journal.add("b", 2)
        with pytest.raises(InputError, match="npz: cannot be written"), journal.written(".npz"):
            full()
    journal.add("c", 3)
    journal.close()
    assert Journal(tmp_path, OF, resume=True).finished() == ["a", "c"]


def test_one_sweep_at_a_time_writes_to_a_journal(tmp_path):
    first = Journal(tmp_path, OF)
    with pytest.raises(InputError, match="another sweep writes to it"):
        Journal(tmp_path, OF, resume=True)
    first.discard()
    Journal(tmp_path, OF).discard()


def test_a_sweep_that_comes_to_its_end_leaves_no_journal_and_one_that_fails_says_so(
    tmp_path, capsys
):
    with kept(tmp_path, OF, resume=False):
        pass
    with pytest.raises(KeyboardInterrupt), kept(tmp_path, OF, resume=False):
        raise KeyboardInterrupt
    assert not list(tmp_path.iterdir()) and capsys.readouterr().err == ""
    with pytest.raises(KeyboardInterrupt), kept(tmp_path, OF, resume=True) as journal:
        assert journal.once("a", lambda: 1) == journal.once("a", lambda: 2) == 1
        raise KeyboardInterrupt
    assert "--resume goes on with 1 finished result in" in capsys.readouterr().err
    with pytest.raises(KeyboardInterrupt), kept(tmp_path, OF, resume=True, quiet=True):
        raise KeyboardInterrupt
    error = capsys.readouterr().err  # what is left, and no more than that
    assert error.startswith("--resume goes on with 1 finished result in") and error.count("\n") == 1
    with kept(tmp_path, OF, resume=True) as journal:
        assert journal.once("a", lambda: 2) == 1
    assert "goes on with 1 finished result" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_sweep_is_what_its_results_depend_on():
    """The target of `tune` chooses among results: they serve for another one."""
    source = SceneSource("cloth", {"columns": 5, "rows": 4})
    scene = source.build()

    def of(options):
        return of_scene("trade", source, options, scene)

    asked = of(TradeOptions.from_given({"frames": 30, "output": "a"}))
    assert asked == of(TradeOptions.from_given({"frames": 30, "output": "b", "resume": True}))
    assert asked["settings"] == "--frames 30" and "taichi-cloth " in asked["versions"]
    assert asked != of(TradeOptions.from_given({"frames": 31}))
    for beside in ({"within": "60s"}, {"quick": True}):
        assert asked == of(TradeOptions.from_given({"frames": 30, **beside}))
    assert of(TuneOptions.from_given({"error": "1%"})) == of(TuneOptions.from_given({}))


@thorough
def test_a_map_of_stability_is_not_drawn_twice(device, tmp_path):
    """Interrupted in the second of two maps, it goes on with that."""
    scene = experiment.at_rest(library.build("oscillator"))
    network = Network.from_scene(scene)
    method = next(m for m in methods.METHODS if 0 < experiment.claimed(m) < np.inf)

    def measured(stop_in=None, **how):
        limits, maps, told = experiment.computed(method, network), [], []

        def tell(_, kind):
            told.append(kind)
            if kind == stop_in:
                raise KeyboardInterrupt

        with kept(tmp_path, OF, **how) as journal:
            experiment.measure(scene, limits, maps, tell, journal)
        return limits, maps, told

    with pytest.raises(KeyboardInterrupt):
        measured("mass", resume=False)
    limits, maps, told = measured(resume=True)
    assert set(told) == {"mass"} and limits.status == "measured" and limits.runs > 5
    assert [m.kind for m in maps] == ["stiffness", "mass"]
    assert all(len(m.points) == len(m.factor) * experiment.MESH.steps for m in maps)


# ------------------------------------------------------------------------------------------
# Kills

SMALL = [
    "--columns",
    "5",
    "--rows",
    "4",
    "--frames",
    "20",
    "--within",
    "110s",
    "--precisions",
    "f64",
]
TRADE = ["trade", "cloth", *SMALL, "--methods", "verlet", "--substeps", "1,2"]
TIMED = {"wall_seconds", "wall_lower", "wall_upper", "repeats", "pareto"}


def rows_of(folder):
    """The rows of a trade, without what a clock says."""
    with (folder / "trade.csv").open(newline="") as file:
        table = list(csv.DictReader(file))
    return [{name: of for name, of in row.items() if name not in TIMED} for row in table]


class Sweep:
    """A trade in a process of its own, whose journal is looked at while it runs."""

    def __init__(self, folder, caches, *more):
        self.path = folder / journals.NAME
        command = [sys.executable, "-m", "taichi_cloth", *TRADE, "--output", str(folder), *more]
        env = {**os.environ, **caches}
        self.process = subprocess.Popen(command, env=env, stderr=subprocess.PIPE, text=True)

    def keys(self):
        """The keys of the results that are finished."""
        lines = self.path.read_bytes().splitlines(keepends=True) if self.path.exists() else []
        return [json.loads(line)["key"] for line in lines[1:] if line.endswith(b"\n")]

    def wait_for(self, word, count=1):
        """Until so many results of a kind are finished."""
        while sum(word in key for key in self.keys()) < count:
            assert self.process.poll() is None
            time.sleep(0.01)

    def workers(self):
        """The processes that it started."""
        tasks = Path(f"/proc/{self.process.pid}/task")
        found = [(task / "children").read_text().split() for task in tasks.iterdir()]
        return [int(pid) for of in found for pid in of]


@thorough
@pytest.mark.skipif(sys.platform != "linux", reason="it finds processes in /proc")
def test_kills_of_a_worker_and_of_the_whole_lose_nothing(cli, caches, tmp_path):
    """A worker is killed while it runs, then all of them; rows are those of a run without that."""
    cli(*TRADE, "--output", tmp_path / "whole")
    killed = Sweep(tmp_path / "killed", caches)
    killed.wait_for('"sample"', 2)
    for pid in killed.workers():
        os.kill(pid, signal.SIGKILL)
    killed.wait_for('"time"', 1)
    killed.process.kill()
    killed.process.communicate()
    before = killed.keys()
    again, seen = Sweep(tmp_path / "killed", caches, "--resume"), before
    while again.process.poll() is None:
        seen = again.keys() or seen
        time.sleep(0.01)
    error = again.process.communicate()[1]
    assert again.process.returncode == 0, error
    assert f"goes on with {len(before)} finished results" in error
    assert seen[: len(before)] == before and len(set(seen)) == len(seen) > len(before)
    assert rows_of(tmp_path / "killed") == rows_of(tmp_path / "whole")
    assert not list((tmp_path / "killed").glob("sweep*"))
