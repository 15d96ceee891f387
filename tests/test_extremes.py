"""Extreme cases for every method in f32 and f64: each bound holds, or the run fails by name.

A process for each precision runs the cases (`extreme_worker.py`) while the tests wait for results;
`docs/extremes.md` has them in a table.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from extreme_cases import CASES
from extreme_worker import PRECISIONS, applicable

from taichi_cloth.kernels import methods

WORKER = Path(__file__).with_name("extreme_worker.py")
ALL = [(method, name) for method in methods.METHODS for name in applicable(method)]


class Worker:
    """The results of one precision, as they come."""

    def __init__(self, precision, wanted):
        self._process = subprocess.Popen(
            [sys.executable, WORKER, precision, *wanted],
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "ENABLE_TAICHI_HEADER_PRINT": "0"},
        )
        self._results = {}

    def result(self, method, name):
        while (method, name) not in self._results:
            line = self._process.stdout.readline()
            assert line, f"the process of {method}, {name} ended: {self._process.wait()}"
            result = json.loads(line)
            self._results[result["method"], result["case"]] = result
        return self._results[method, name]

    def stop(self):
        self._process.stdout.close()
        self._process.terminate()
        self._process.wait()


@pytest.fixture(scope="module")
def workers(request):
    """Both started at once, to run the cases that were selected."""
    asked = [
        item.callspec.params for item in request.session.items if "precision" in item.fixturenames
    ]
    asked = [of for of in asked if of.get("method") in methods.METHODS and "name" in of]
    started = {}
    for precision in PRECISIONS:
        wanted = [f"{of['method']}/{of['name']}" for of in asked if of["precision"] == precision]
        if wanted:
            started[precision] = Worker(precision, wanted)
    yield started
    for worker in started.values():
        worker.stop()


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("method, name", ALL)
def test_extreme(workers, method, name, precision):
    result = workers[precision].result(method, name)
    assert result["status"] != "broken", json.dumps(result, indent=1)


def test_there_are_forty_cases_and_each_method_takes_most():
    assert len(CASES) >= 40
    for method in methods.METHODS:
        assert len(applicable(method)) >= 40
