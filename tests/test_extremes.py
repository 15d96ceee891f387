"""Extreme cases for every method in f32 and f64: each bound holds, or the run fails by name.

A process for each precision runs the cases (`extreme_worker.py`) while the tests wait for results;
`docs/extremes.md` has them in a table. By default all cases run with the default method, and each
with one other. Cases of contact in space, air and bending, of which each kind is to be compiled for
each method, run here with every third method, in one of the two precisions.
"""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from extreme_cases import CASES
from extreme_worker import PRECISIONS, applicable
from selection import mostly_thorough

from taichi_cloth.kernels import methods

WORKER = Path(__file__).with_name("extreme_worker.py")
DOCUMENT = Path(__file__).parent.parent / "docs" / "extremes.md"
DEFAULT = "symplectic_euler"
OTHERS = [method for method in methods.METHODS if method != DEFAULT]
QUICK = ("springs", "contact")  # kinds that share few compilations
KINDS = list(dict.fromkeys(case.kind for case in CASES.values()))


def runs_in(method, name):
    """The precisions in which a case runs with a method."""
    kind = CASES[name].kind
    turn = list(methods.METHODS).index(method) + KINDS.index(kind)
    if kind in QUICK:
        return PRECISIONS
    return () if turn % 3 else (PRECISIONS[turn // 3 % 2],)


ALL = [
    (method, name, precision)
    for precision in PRECISIONS
    for method in methods.METHODS
    for name in applicable(method)
    if precision in runs_in(method, name)
]


def by_default(method, name, precision):
    """All cases of the default method that share two compilations; of each other one some, in one
    of the precisions."""
    if CASES[name].kind not in QUICK:
        return False
    if method == DEFAULT:
        return True
    turn, case = OTHERS.index(method), list(CASES).index(name)
    if CASES[name].kind != "springs" or precision != PRECISIONS[turn % len(PRECISIONS)]:
        return False
    return case % len(OTHERS) == turn


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
        item.callspec.params
        for item in request.session.items
        if getattr(item, "originalname", "") == "test_extreme"
    ]
    started = {}
    for precision in PRECISIONS:
        wanted = [f"{of['method']}/{of['name']}" for of in asked if of["precision"] == precision]
        if wanted:
            started[precision] = Worker(precision, wanted)
    yield started
    for worker in started.values():
        worker.stop()


@pytest.mark.parametrize(
    ("method", "name", "precision"),
    mostly_thorough(ALL, default=[of for of in ALL if by_default(*of)]),
)
def test_extreme(workers, method, name, precision):
    result = workers[precision].result(method, name)
    assert result["status"] != "broken", json.dumps(result, indent=1)


def test_each_method_takes_most_cases_and_the_document_has_them_all():
    for method in methods.METHODS:
        assert len(applicable(method)) > 0.75 * len(CASES), method
    table = DOCUMENT.read_text().partition("\n## The cases\n")[2].partition("\n## ")[0]
    assert re.findall(r"^\| `([^`]+)` \|", table, re.M) == list(CASES)
