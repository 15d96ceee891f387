"""A process of its own that does what it is asked: one JSON request a line in, one answer out.

    {"make": "module:Class", "as": KEY, "with": {...}}  ->  {"result": the object's `about`}
    {"of": KEY, "do": METHOD, "with": {...}}            ->  {"result": ..., "seconds": ...}
    {"drop": KEY}                                       ->  {"result": null}

An array is answered with the name of the file it was saved to, in the folder that is this
process's argument. What goes wrong is answered as {"failed": "one line"}. When standard input ends,
its parent has, however that was killed: the process ends at once, and removes that folder.

Taichi has one backend, precision and fast_math in a process, so what compares them has one process
for each: `Worker` is such a process as its parent sees it, `main` is what runs in it.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import itertools
import json
import os
import queue
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

from taichi_cloth.errors import one_line

ENDED = "its process ended"  # how a failure begins that took the process with it


class WorkerFailed(RuntimeError):
    """A request to a process went wrong; the message is one line."""


class Worker:
    """A process as its parent sees it.

    folder: where it saves arrays; environment: variables that it gets besides this process's own.
    niceness: by how much all of its threads give way to others, where the system knows that.
    """

    def __init__(self, folder: Path, environment: dict[str, str], niceness: int = 0):
        self._complaints = tempfile.TemporaryFile("w+", dir=folder)  # noqa: SIM115
        self._process = subprocess.Popen(
            [sys.executable, "-m", "taichi_cloth.measuring.worker", str(folder), str(niceness)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._complaints,
            text=True,
            env={**os.environ, **environment},
            start_new_session=True,  # Ctrl-C is for the parent, which then ends its workers
        )
        assert self._process.stdin and self._process.stdout
        self._requests, self._answers = self._process.stdin, self._process.stdout

    def ask(self, **request: Any) -> dict[str, Any]:
        """The answer to a request; raises WorkerFailed."""
        try:
            print(json.dumps(request), file=self._requests, flush=True)
            line = self._answers.readline()
        except (OSError, ValueError):  # ended, or closed here by another thread
            line = ""
        if not line:
            self.kill()  # it may still be ending, and would pass for alive
            raise WorkerFailed(f"{ENDED}: {self._last_words()}".rstrip(": "))
        answer: dict[str, Any] = json.loads(line)
        if "failed" in answer:
            raise WorkerFailed(answer["failed"])
        return answer

    def _last_words(self) -> str:
        try:
            self._complaints.seek(0)
            return (self._complaints.read().strip().splitlines()[-1:] or [""])[0]
        except (OSError, ValueError):
            return ""

    @property
    def alive(self) -> bool:
        """True if the process still runs."""
        return self._process.poll() is None

    @property
    def ended_by(self) -> int | None:
        """The number of the signal that ended the process; None where none did."""
        status = self._process.poll()
        return -status if status is not None and status < 0 else None

    def kill(self) -> None:
        """End the process; a thread that waits for its answer gets WorkerFailed."""
        self._process.kill()
        self._process.wait()

    def close(self) -> None:
        """End the process, and close what connects to it."""
        self.kill()
        for stream in (self._requests, self._answers, self._complaints):
            with contextlib.suppress(OSError):
                stream.close()


def main(folder: Path, niceness: int = 0) -> None:
    """Serve requests until standard input ends.

    folder: temporary, of the parent, which removes it where it can. niceness: see `Worker`.
    """
    # Before there is another thread: each has a niceness of its own, that of who started it.
    if niceness and hasattr(os, "nice"):
        os.nice(niceness)
    # Libraries greet on standard output: the answers keep it for themselves.
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    objects: dict[str, Any] = {}
    requests: queue.SimpleQueue[str] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(requests, folder), daemon=True).start()
    for number in itertools.count():
        line = requests.get()
        try:
            answer = _answer(json.loads(line), objects, folder / f"{os.getpid()}-{number}.npy")
        except Exception as error:
            answer = {"failed": one_line(error)}
        print(json.dumps(answer), file=answers, flush=True)


def _listen(requests: queue.SimpleQueue[str], folder: Path) -> None:
    """Pass requests on until standard input ends; then end the process, whatever it is doing."""
    for line in sys.stdin:
        requests.put(line)
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(0)


def _answer(request: dict[str, Any], objects: dict[str, Any], file: Path) -> dict[str, Any]:
    if "make" in request:
        module, _, name = request["make"].partition(":")
        made = getattr(importlib.import_module(module), name)(**request["with"])
        objects[request["as"]] = made
        return {"result": getattr(made, "about", {})}
    if "drop" in request:
        del objects[request["drop"]]
        gc.collect()
        return {"result": None}
    method = getattr(objects[request["of"]], request["do"])
    begin = time.perf_counter()
    result = method(**request["with"])
    seconds = time.perf_counter() - begin
    if isinstance(result, np.ndarray):
        np.save(file, result)
        result = str(file)
    return {"result": result, "seconds": seconds}


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
