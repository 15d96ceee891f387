"""Sweeps on other machines: tasks as bytes, workers that are lost, and what is refused by name."""

import contextlib
import csv
import json
import os
import pickle
import platform
import signal
import socket
import subprocess
import sys
import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import extreme_document
import extreme_worker
import numpy as np
import pytest
from selection import thorough
from test_journal import SMALL, TIMED

from bench.accuracy import command as accuracy
from bench.accuracy import matrix
from taichi_cloth.cli.main import main
from taichi_cloth.errors import InputError
from taichi_cloth.kernels import methods
from taichi_cloth.limits.network import Network
from taichi_cloth.scene import library
from taichi_cloth.scene.source import SceneSource
from taichi_cloth.settings.sweeps import TradeOptions
from taichi_cloth.stability import elsewhere as stability
from taichi_cloth.stability import experiment
from taichi_cloth.sweeps import cluster as dask
from taichi_cloth.sweeps import tasks
from taichi_cloth.sweeps.journal import Journal, key_of
from taichi_cloth.sweeps.tasks import Elsewhere, Task, TaskLost, fill
from taichi_cloth.trade import command, elsewhere
from taichi_cloth.trade.outcomes import StudyFailure
from taichi_cloth.trade.rows import rows_of

HOST = platform.node()

# What a task runs: sent with it, as it is no module of the package.
GIVEN = b"""
import os, signal, time
from taichi_cloth.sweeps.tasks import Finished

def halves(of, text):
    content = open(text, "rb").read()
    return [Finished(f"half {n}", n / 2, content) for n in of]

def killed(of):
    os.kill(os.getpid(), signal.SIGKILL)

def slow(of):
    time.sleep(600)

def wrong(of):
    raise ValueError("no\\nhalf")
"""


def task(do, *of, **arguments):
    keys = [f"half {n}" for n in of]
    files = {"given.py": GIVEN, "words.txt": b"of the task"}
    return Task(do, f"given:{do}", keys, {"of": of, **arguments}, files)


def test_tasks_run_in_processes_of_their_own_and_one_that_is_lost_loses_no_other(tmp_path):
    """On any executor; files go as bytes, there and back; what is finished is not asked again."""
    done, stop = [], threading.Event()
    wanted = [task("killed", 7), task("wrong", 8), task("halves", 1, 3, text="words.txt")]
    journal = Journal(tmp_path, {})
    with ThreadPoolExecutor(2) as executor:
        lost = fill(journal, wanted, executor, done.append, stop.is_set)
        assert len(done) == 3 and len(lost) == 2
        assert any("killed: its process on" in why and "-9" in why for why in lost)
        assert "wrong: ValueError: no half" in lost
        assert journal.get("half 3").result == 1.5
        assert journal.get("half 1").file.read_bytes() == b"of the task"
        assert journal.get("half 7") is None
    assert fill(journal, wanted[2:], None) == []  # nothing is left to ask for
    stop.set()
    waiting = Future()  # one that never ends
    executor = type("Busy", (), {"submit": lambda self, *_: waiting})()
    fill(journal, wanted[:1], executor, stop=stop.is_set)
    assert waiting.cancelled()
    journal.discard()


def test_what_nobody_will_do_is_not_waited_for(tmp_path):
    """Neither here, for an executor that has nobody left or has ended, nor there."""
    journal, asked = Journal(tmp_path, {}), [task("slow", 1)]
    busy = type("Busy", (), {"submit": lambda self, *_: Future()})()
    assert fill(journal, asked, busy, gone=lambda _: "all left") == ["slow: all left"]
    ended = ThreadPoolExecutor(1)
    ended.shutdown()
    (why,) = fill(journal, asked, ended)
    assert why.startswith("slow: RuntimeError: ")
    with pytest.raises(TaskLost, match="nobody waits for it"):
        tasks.run(tasks._payload(asked[0]), lambda: False)
    journal.discard()


def test_a_worker_of_other_versions_is_refused_by_name(tmp_path, monkeypatch):
    journal, asked = Journal(tmp_path, {}), task("halves", 1, text="words.txt")
    monkeypatch.setattr(tasks, "place", lambda: ("there", "taichi 1.7.3, numpy 2.0"))
    payload = tasks._payload(asked)
    monkeypatch.undo()
    executor = type("Other", (), {})()
    executor.submit = lambda run, _: answered(run(payload))
    with pytest.raises(InputError, match="--on: the worker on .* has .*; this sweep needs") as no:
        fill(journal, [asked], executor)
    assert "taichi 1.7.3" in str(no.value) and "numpy 2.0" in str(no.value)
    journal.discard()


def answered(answer):
    future = Future()
    future.set_result(answer)
    return future


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--on", "10.0.0.1"], "--on must be a Dask scheduler's address, such as tcp://"),
        (["--on", "tcp://10.0.0.1:99999"], "is 'tcp://10.0.0.1:99999'"),
        (["--times-on", "a"], "give --on, too"),
    ],
)
def test_a_place_that_is_none_is_refused_in_one_line(words, says, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["trade", "oscillator", *words]) == 2
    error = capsys.readouterr().err
    assert says in error and error.count("\n") == 1 and not list(tmp_path.iterdir())


def test_nobody_imports_dask_who_does_not_ask_for_it():
    code = (
        "import sys, taichi_cloth.advice.tune, taichi_cloth.sweeps.cluster, taichi_cloth.cli.main;"
        "print([name for name in sys.modules if name in ('dask', 'distributed')])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_an_address_where_no_scheduler_answers_is_refused_soon(tmp_path, monkeypatch, capsys):
    pytest.importorskip("distributed")
    monkeypatch.chdir(tmp_path)
    assert dask.PATIENCE < 3  # beside what it takes to start
    for words, says in (
        (b"", "no scheduler answers within"),
        (b"HTTP/1.1 400 No\r\n\r\n", "is no"),
    ):
        with listening(words) as address:
            assert main(["trade", "oscillator", "--on", address]) == 2
        error = capsys.readouterr().err
        assert f"--on {address}: " in error and says in error and error.count("\n") == 1


@contextlib.contextmanager
def listening(words):
    """The address of what takes connections, and says these words to each."""
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        server.listen()

        def answer():
            with contextlib.suppress(OSError):
                while True:
                    taken.append(server.accept()[0])
                    taken[-1].sendall(words)

        taken = []
        threading.Thread(target=answer, daemon=True).start()
        yield f"tcp://127.0.0.1:{server.getsockname()[1]}"


# ------------------------------------------------------------------------------------------
# A cluster of two workers


@pytest.fixture(scope="module")
def cluster(caches):
    """(the scheduler's address, a function that tells the workers' processes)."""
    pytest.importorskip("distributed")
    process = subprocess.Popen(
        [sys.executable, str(Path(__file__).with_name("local_cluster.py"))],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        env={**os.environ, **caches},
    )  # fmt: skip
    address = process.stdout.readline().strip()

    def workers():
        print(file=process.stdin, flush=True)
        return json.loads(process.stdout.readline())

    yield address, workers
    process.stdin.close()
    process.wait(timeout=60)


@thorough
def test_rows_of_a_cluster_that_lost_a_worker_are_those_of_one_machine(
    cluster, cli, caches, tmp_path
):
    """To the bit in all columns but times, which the workers of one machine take."""
    address, workers = cluster
    asked = ["trade", "cloth", *SMALL, "--methods", "verlet,symplectic_euler", "--substeps", "1,2"]
    words = [sys.executable, "-m", "taichi_cloth", *asked]
    process = subprocess.Popen(
        [*words, "--output", str(tmp_path / "there"), "--on", address, "--times-on", HOST],
        env={**os.environ, **caches}, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    while not (busy := [of for of in workers() if of["tasks"]]):
        assert process.poll() is None
        time.sleep(0.02)
    os.kill(busy[0]["pid"], signal.SIGKILL)
    error = process.communicate()[1]
    assert process.returncode == 0 and "lost" not in error, error
    cli(*asked, "--output", tmp_path / "here")
    there, here = (table(tmp_path / name) for name in ("there", "here"))
    assert len(there) == 4 and there == here
    assert {row["timed_on"] for row in there} == {HOST}


def table(folder):
    with (folder / "trade.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    return [{name: of for name, of in row.items() if name not in TIMED} for row in rows]


@thorough
def test_a_machine_without_a_worker_is_not_timed(cluster, cli, tmp_path):
    address, _ = cluster
    _, error = cli("trade", "oscillator", "--on", address, "--times-on", "nobody", check=2)
    assert f"--times-on nobody: no worker is there; on: {HOST}" in error


# ------------------------------------------------------------------------------------------
# What each sweep sends, on any executor


class Asked(ThreadPoolExecutor):
    """An executor that remembers what it was asked for, in the order in which it was."""

    def __init__(self):
        super().__init__(2)
        self.functions, self.names = [], []

    def submit(self, run, payload):
        asked = pickle.loads(pickle.loads(payload)[1])
        self.functions.append(asked.function.rpartition(":")[2])
        self.names.append(asked.name)
        return super().submit(run, payload)


def test_times_are_taken_on_the_machine_that_is_asked_for_alone():
    with pytest.raises(RuntimeError, match="times are taken on there, and this is"):
        elsewhere.times(None, None, {}, [], 1, 0.1, "there")


@thorough
def test_errors_come_from_any_process_and_times_from_one_place():
    source = SceneSource("oscillator")
    asked = {
        "methods": "verlet",
        "substeps": "1,2",
        "precisions": "f64",
        "frames": 5,
        "quick": True,
    }
    options = TradeOptions.from_given(asked)
    of = source, options, *command.prepare(source, options)
    with Asked() as anywhere, Asked() as one:
        there = Elsewhere(anywhere, one)
        with command.measured(*of, elsewhere=there, quiet=True) as found:
            rows = rows_of(found, {}, [])
    assert [row.status for row in rows] == ["ok", "ok"] and all(
        row.error_trajectory for row in rows
    )
    assert {row.timed_on for row in rows} == {HOST} and all(row.wall_seconds for row in rows)
    assert set(anywhere.functions) == {"samples"} and set(one.functions) == {"times"}


@thorough
def test_times_of_a_machine_that_is_lost_are_taken_nowhere_else():
    """The study says so, and what to do: its scheduler went while errors had come."""

    class Left:
        def run(self, *_, **__):
            raise AttributeError("'NoneType' object has no attribute 'broadcast'")  # as Dask's does

    source = SceneSource("oscillator")
    asked = {"methods": "verlet", "substeps": "1,2", "precisions": "f64", "frames": 5}
    options = TradeOptions.from_given(asked | {"quick": True})
    of = source, options, *command.prepare(source, options)
    with Asked() as anywhere:
        there = Elsewhere(anywhere, dask._Workers(Left(), "node7"), "node7")
        with command.measured(*of, elsewhere=there, quiet=True) as found:
            assert {outcome.lost for outcome in found.outcomes} == {True}
            says = r"2 of 2 settings were lost, the first because no time came from node7 "
            says += r"\(verlet, cpu f64: the scheduler does not answer any more\); see that the "
            says += "scheduler and a worker there answer, and --resume"
            with pytest.raises(StudyFailure, match=says):
                found.check_whole()


@thorough
def test_limits_of_steps_come_from_other_processes_too(tmp_path):
    """What is measured there is not measured here, limit or map."""
    scene = experiment.at_rest(library.build("oscillator"))
    method = next(m for m in methods.METHODS if 0 < experiment.claimed(m) < np.inf)
    limits, maps, ran = experiment.computed(method, Network.from_scene(scene)), [], []
    journal = Journal(tmp_path, {})
    with ThreadPoolExecutor(1) as executor:
        there = Elsewhere(executor)
        assert not stability.measure(scene, [limits], lambda *_: None, journal, there)
    experiment.measure(scene, limits, maps, lambda *of: ran.append(of), journal)
    assert not ran and limits.status == "measured"
    assert [m.kind for m in maps] == ["stiffness", "mass"] and all(m.points for m in maps)
    journal.discard()


@thorough
def test_extreme_cases_run_where_the_tests_are_not(tmp_path, monkeypatch, capsys):
    """Their files go with them; what is finished is not run again."""
    monkeypatch.setattr(methods, "METHODS", ("verlet",))
    name, journal = extreme_worker.applicable("verlet")[0], Journal(tmp_path, {})
    with Asked() as executor:
        for _ in range(2):
            extreme_document.run_elsewhere(journal, 1, [name], Elsewhere(executor))
    assert sorted(executor.names) == ["run 1: verlet, f32", "run 1: verlet, f64"]
    results = extreme_document.results_of(journal)
    assert set(results) == {(precision, name, "verlet") for precision in ("f32", "f64")}
    assert "lost" not in capsys.readouterr().err
    journal.discard()


def test_the_parts_of_the_bench_of_accuracy_are_sent_but_for_times(tmp_path):
    """Cells that are finished are sent along, so that they are not run again."""
    journal = Journal(tmp_path, {})
    key = key_of("cell", "net", "verlet", "graph", "f64")
    journal.add(key, [{"error": 0.1}, 2.0])
    journal.add("events", "kept")
    parts = "orders", "events", "costs", "matrix", "smooth"
    sent = {task.name: task for task in accuracy._tasks(parts, journal, {})}
    assert list(sent) == ["orders", *(f"matrix, {name}" for name in matrix.SCENES)]
    assert sent["matrix, net"].arguments["known"] == {key: [{"error": 0.1}, 2.0]}
    assert sent["matrix, cloth"].arguments["known"] == {}
    journal.discard()
