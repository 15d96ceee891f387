"""Tasks of a sweep: what any machine with the same versions can do, in a process of its own.

A task goes as bytes, arrays and files in it, to a `concurrent.futures.Executor` (this machine's, a
cluster's), and comes back as results for the sweep's journal. What becomes of it there is `run`:
Taichi never runs in the process of the executor, which would lose its worker while kernels run.
"""

from __future__ import annotations

import functools
import hashlib
import os
import pickle
import platform
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from taichi_cloth.errors import InputError, clipped, counted, one_line
from taichi_cloth.measuring import machine
from taichi_cloth.sweeps.identity import PACKAGES
from taichi_cloth.sweeps.journal import Journal

TASK, ANSWER = "task", "answer"  # files in the folder of a task's process
TURN = 0.2  # seconds after which whoever waits looks whether it is still to


@dataclass(frozen=True)
class Finished:
    """A result of a task: its key in the journal, JSON's values, and the content of its file."""

    key: str
    result: Any
    content: bytes | None = None


@dataclass(frozen=True)
class Task:
    """A function of a module, "module:name", which returns `Finished` results.

    keys: of its results. arguments: what pickles. files: by name, put into the folder that it runs
    in, from which it can import, too.
    """

    name: str
    function: str
    keys: Sequence[str]
    arguments: Mapping[str, Any]
    files: Mapping[str, bytes] = field(default_factory=dict)


@dataclass(frozen=True)
class Elsewhere:
    """The places of a sweep's tasks: errors come from any of `executor`'s processes, times from
    `timing` alone, a machine's of this name; None: they are measured in this process's own workers.

    gone: says why no process of one of these executors will do what waits; nothing while one may.
    """

    executor: Executor
    timing: Executor | None = None
    timed_on: str = field(default_factory=platform.node)
    gone: Callable[[Executor], str] = lambda executor: ""


class TaskLost(RuntimeError):
    """The process of a task ended before it had an answer."""


def place() -> tuple[str, str]:
    """This machine's name, and the versions of what results depend on."""
    return platform.node(), f"{machine.versions(PACKAGES)}, taichi-cloth's files {_digest()}"


@functools.cache
def _digest() -> str:
    """Of this package's files, which may differ in one version while somebody works on them."""
    root, found = Path(__file__).parents[1], hashlib.sha256()
    for file in sorted(root.rglob("*.py")):
        content = file.read_bytes()
        found.update(f"{file.relative_to(root).as_posix()} {len(content)} ".encode() + content)
    return found.hexdigest()[:8]


# ------------------------------------------------------------------------------------------
# Where the sweep is


def fill(
    journal: Journal,
    tasks: Sequence[Task],
    executor: Executor,
    tell: Callable[[Task], None] = lambda task: None,
    stop: Callable[[], bool] = lambda: False,
    gone: Callable[[Executor], str] = lambda executor: "",
) -> list[str]:
    """Have tasks done whose results a journal lacks, and put these there as they come.

    tell: called with each task that is done. stop: whether to leave the rest. gone: as that of
    `Elsewhere`. Returns why tasks were lost, a line each, whose results are not there. Raises
    InputError where a worker has other versions.
    """
    waiting: dict[Future[bytes], Task] = {}
    lost = []
    for task in tasks:
        if all(journal.get(key) for key in task.keys):
            tell(task)
            continue
        try:
            waiting[executor.submit(run, _payload(task))] = task
        except Exception as error:  # of an executor that has ended
            lost.append(f"{task.name}: {_said(error)}")
    try:
        while waiting and not stop():
            for future in wait(waiting, timeout=TURN, return_when=FIRST_COMPLETED).done:
                task = waiting.pop(future)
                why = _take(journal, task, future)
                if why:
                    lost.append(f"{task.name}: {why}")
                tell(task)
            why = gone(executor) if waiting else ""
            if why:
                lost += [f"{task.name}: {why}" for task in waiting.values()]
                break
    finally:
        for future in waiting:
            future.cancel()
    return lost


def _take(journal: Journal, task: Task, future: Future[bytes]) -> str:
    """Put the results of a task into the journal; else why there are none."""
    if future.cancelled():
        return "it was cancelled there"
    try:
        kind, answer = pickle.loads(future.result())
    except Exception as error:  # whatever an executor says of a worker that it lost
        return _said(error)
    if kind == "refused":
        raise InputError(answer)
    if kind == "failed":
        return str(answer)
    for finished in answer:
        file = None
        if finished.content is not None:
            with journal.written(".npz") as file:
                file.write_bytes(finished.content)
        journal.add(finished.key, finished.result, file)
    lacking = sum(journal.get(key) is None for key in task.keys)
    return f"{lacking} of {counted(len(task.keys), 'result')} did not come" if lacking else ""


def _said(error: Exception) -> str:
    """Why a task was lost, in a line; our own words say it without the name of an exception."""
    return clipped(str(error), 300) if isinstance(error, TaskLost) else one_line(error)


def said_of_lost(lost: Sequence[str]) -> str:
    """A line on tasks that were lost elsewhere, and are done here instead."""
    return f"--on: {counted(len(lost), 'task')} lost there, and done here; the first: {lost[0]}"


def _payload(task: Task) -> bytes:
    """The input of `run`: the versions stand outside, as others may not read the task."""
    return pickle.dumps((place()[1], pickle.dumps(task)))


# ------------------------------------------------------------------------------------------
# Where it runs


def run(payload: bytes, wanted: Callable[[], bool] = lambda: True) -> bytes:
    """Do a task in a process of its own, as long as it is wanted; the answer.

    Raises TaskLost where that ends early.
    """
    versions, task = pickle.loads(payload)
    host, mine = place()
    if versions != mine:
        return pickle.dumps(("refused", refusal(host, mine, versions)))
    with tempfile.TemporaryDirectory(prefix="taichi-cloth-task-") as name:
        folder = Path(name)
        (folder / TASK).write_bytes(task)
        with (folder / "complaints").open("w+") as complaints:
            process = subprocess.Popen(
                [sys.executable, "-m", "taichi_cloth.sweeps.process", name],
                stdin=subprocess.PIPE,  # which ends with this process, and the task with it
                stdout=complaints,
                stderr=complaints,
                env={**os.environ, "OMP_NUM_THREADS": "1"},
                start_new_session=True,
            )
            status = _ended(process, wanted)
        if (folder / ANSWER).exists():
            return (folder / ANSWER).read_bytes()
        words = (folder / "complaints").read_text(errors="replace").strip().splitlines()[-1:]
        raise TaskLost(f"its process on {host} ended with {status}: {''.join(words)}")


def _ended(process: subprocess.Popen[bytes], wanted: Callable[[], bool]) -> int:
    """The status with which a process ends; raises TaskLost once it is not wanted any more."""
    try:
        while True:
            try:
                return process.wait(TURN)
            except subprocess.TimeoutExpired:
                if not wanted():
                    raise TaskLost("nobody waits for it any more") from None
    finally:
        process.kill()
        process.wait()
        if process.stdin:
            process.stdin.close()


def finished_by(work: Callable[[Journal], object], known: Mapping[str, Any]) -> list[Finished]:
    """The results that work adds to a journal of its own, which begins with these by key."""
    with tempfile.TemporaryDirectory() as folder:
        journal = Journal(Path(folder), {})
        for key, result in known.items():
            journal.add(key, result)
        try:
            work(journal)
            added = [key for key in journal.finished() if key not in known]
            return [Finished(key, entry.result) for key in added if (entry := journal.get(key))]
        finally:
            journal.discard()


def refusal(host: str, there: str, here: str) -> str:
    """A note on a worker whose versions are others than those of the sweep."""
    mine = dict(word.rsplit(" ", 1) for word in here.split(", "))
    other = dict(word.rsplit(" ", 1) for word in there.split(", ") if word)
    names = [name for name in mine | other if mine.get(name) != other.get(name)]
    differ = ", ".join(f"{name} {other.get(name, 'absent')}" for name in names)
    needs = ", ".join(f"{name} {mine.get(name, 'absent')}" for name in names)
    return f"--on: the worker on {host} has {differ}; this sweep needs {needs}: install that there"
