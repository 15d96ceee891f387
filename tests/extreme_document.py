"""Runs all extreme cases several times in both precisions, and writes docs/extremes.md.

python tests/extreme_document.py [--runs 10] [--resume] [--on tcp://HOST:PORT]
"""

import argparse
import json
import os
import re
import subprocess
import sys
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from extreme_cases import CASES, HEAVY_SAG, tr_bdf2_factor
from extreme_worker import FILES, PRECISIONS, applicable

from taichi_cloth.kernels import methods
from taichi_cloth.sweeps.cluster import connected
from taichi_cloth.sweeps.identity import of_place
from taichi_cloth.sweeps.journal import kept, key_of
from taichi_cloth.sweeps.tasks import Task, fill, said_of_lost

HERE = Path(__file__).parent
DOCUMENT = HERE.parent / "docs" / "extremes.md"
HEAD = """# Extremes

What happens where a simulation is asked for too much: steps at the limit of stability, ratios of a
hundred million, particles on top of each other, a million steps, numbers that overflow. Each of the
{cases} cases below asks something definite of every method that it applies to, in f32 and in f64:
numbers with a bound that comes from a closed form, from a law of conservation, or from what the
method claims. Either the bounds hold, or the run fails by name ("frame 20: particle 1 runs away at
speed 4.2e+04 ...; likely cause ...; remedy ...") in the frame in which it leaves them, and the last
good state is kept, to the bit. A case says which of the two it accepts.

`tests/test_extremes.py` runs them, those in space with every third method. This page was written by
`python tests/extreme_document.py --runs {runs}` on {machine}: {runs_of} runs of a
case with a method, of which {broken} broke a bound, and {different} gave another result than the
run before.

All run on the graph, on one thread; that the other topologies and parallel runs give the same is
what other tests are for. Steps are a tenth of the stability limit where a method has one, and where
the case does not say otherwise; where a method is unstable at every step (`explicit_euler`), so
small that the energy cannot double; and one step of 0.01 to 1000 s a frame where it has no limit.

## The cases

What is held "to 0.9 of the bound" is so at all times looked at, by all methods not named as
something else; the method is the one that comes closest. In the column of what is asked,

- *energy within the claims*: at most that of the start, times what the claims let a step add. For
  conditionally stable methods that is the largest gain of their discrete map, over all modes; for
  the others it is 1. "and 10%": where springs turn, or forces jump because particles pass through
  each other, those gains are no strict bound. Added is the noise of rounding (below), and in the
  rows with far stiffer modes what the solver's tolerance leaves beside these;
- *momentum*: that of the start and of gravity, to the rounding of n steps, 1e3 eps sqrt(n), 100
  times the solver's tolerance, and 1% for every step that the run counts as not converged; all as
  parts of sqrt(2 m E);
- *free fall*: x0 + v0 t + g t^2/2, to what a first-order method is off, g t dt/2, and half a last
  place for each step.

"""
WRONG = """
## What goes wrong, where, and by how much

Where a method is wrong, the size of its error is asserted, too: at most about three times what is
measured here.

| case | what was asked | method | f32: value / bound | f64: value / bound | why |
|---|---|---|---|---|---|
"""
NOTES = """
## What implicit methods do to motion

- Backward Euler (`implicit_euler`, and what `xpbd` and `vbd` sweep towards) divides the energy of a
  mode by 1 + dt^2 omega^2 at every step, which `damping_at_1_Hz` and `damping_at_5_Hz` confirm to
  round-off: at 60 steps a second a mode of 1 Hz loses {euler_1:.0%} of its energy in a second, and
  of one of 5 Hz {euler_5:.1g} is left. `tr_bdf2` takes {bdf_1:.3%} and {bdf_5:.1%},
  `implicit_midpoint` nothing.
- `implicit_midpoint` keeps the energy of linear springs exactly, at any step. Springs that turn, as
  all do in a cloth, are not linear: in steps far longer than their period it gains energy without a
  bound that we know. Use it where steps resolve the motion.
- Steps whose solution does not converge are counted (`Simulation.work().unconverged`), and lose the
  conservation of momentum. A tolerance of 1e-6 is one of the largest acceleration: beside a spring
  1e6 times as stiff, soft ones notice.
- Methods with sweeps (`xpbd`, `vbd`) are as good as these are many. With 10, a chain of 8 hangs a
  dozen of its lengths too low in steps of 1 s. Under a chain of masses 1e5 times as light, a heavy
  one that should come to rest at {rest:.1f} m is {xpbd:.1f} m down after a second of `xpbd`: it
  falls freely.

## What f32 cannot do

- Positions are multiples of their last place: 1.2e-7 of their size. A stiff spring takes that for
  a stretch, which is a noise of velocity of `omega^2 dt * 2.4e-7 |x| sqrt(n)` after n steps; the
  bounds on energy allow for it. At an offset of 1e6 m a place is 6 cm.
- A step in which a particle goes less than half a place leaves it where it is (in `rates_1e6_apart`
  the slow part hardly moves while the fast one swings). Its velocity is not lost: it is stored by
  itself, so gravity never vanishes.
- Below 1.2e-38 numbers count as zero, in f64 below 2.2e-308: processors are told so.
"""


def run_once(journal, number, what=()):
    """Run cases in both precisions; each result is kept in the journal as it comes.

    number: of this run; its cases that are finished are not run again. what: of which cases, as
    `extreme_worker.py` takes it; none: all.
    """
    finished = [json.loads(key) for key in journal.finished()]
    workers = []
    for precision in PRECISIONS:
        but = [f"{m}/{name}" for n, p, m, name in finished if (n, p) == (number, precision)]
        workers.append(_started(precision, what, but))
    with ThreadPoolExecutor(len(workers)) as threads:
        list(threads.map(lambda worker: _keep_all(worker, journal, number), workers))
    assert not any(worker.wait() for worker in workers), "a worker ended early: --resume goes on"


def _started(precision, what, but):
    return subprocess.Popen(
        [sys.executable, HERE / "extreme_worker.py", precision, *what, *(f"^{of}" for of in but)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env={**os.environ, "ENABLE_TAICHI_HEADER_PRINT": "0"},
    )


def _keep_all(worker, journal, number):
    for line in worker.stdout:
        result = json.loads(line)
        key = number, result["precision"], result["method"], result["case"]
        journal.add(key_of(*key), result)


def run_elsewhere(journal, runs, names, there):
    """Have other machines run cases; what is lost there is left to `run_once`."""
    files = {name: (HERE / name).read_bytes() for name in FILES}
    tasks = []
    for number in range(1, runs + 1):
        for precision in PRECISIONS:
            for method in methods.METHODS:
                of = number, precision, method
                keys = {name: key_of(*of, name) for name in applicable(method) if name in names}
                keys = {name: key for name, key in keys.items() if not journal.get(key)}
                arguments = {"precision": precision, "method": method, "keys": keys}
                said = f"run {number}: {method}, {precision}"
                task = Task(said, "extreme_worker:finished", list(keys.values()), arguments, files)
                tasks += [task] if keys else []

    def tell(task):
        print(task.name, file=sys.stderr, flush=True)

    lost = fill(journal, tasks, there.executor, tell, gone=there.gone)
    if lost:
        print(said_of_lost(lost), file=sys.stderr, flush=True)


def results_of(journal):
    """By (precision, case, method): the result of each run."""
    results = defaultdict(list)
    for key in sorted(journal.finished(), key=lambda key: json.loads(key)[0]):
        result = journal.get(key).result
        results[result["precision"], result["case"], result["method"]].append(result)
    return results


def worst(result):
    return max(result["asks"], key=lambda ask: ask["part"])


def _listed(names):
    """Methods in words: all, or those that there are."""
    names = sorted(names)
    lacking = sorted(set(methods.METHODS) - set(names))
    if not lacking:
        return "all"
    if len(lacking) <= 2:
        return "all but " + ", ".join(lacking)
    return ", ".join(names)


def _cell(of):
    """What came of a case in one precision; of: its results by method."""
    said = []
    held = {m: r for m, r in of.items() if r["status"] == "held"}
    if held:
        part, method = max((worst(r)["part"], m) for m, r in held.items())
        most = f"to {part:.3g} of the bound ({method})" if part > 0 else "exactly"
        said.append(f"held, {most}")
    failed = [m for m, r in of.items() if r["status"] == "failed"]
    if failed:
        said.append("fails by name" + ("" if len(failed) == len(of) else f": {_listed(failed)}"))
    for status in ("wrong", "broken"):
        names = [m for m, r in of.items() if r["status"] == status]
        if names:
            said.append(f"**{status}**: {_listed(names)}")
    return "; ".join(said)


def _wrong_rows(name, of, reasons):
    """Rows on what goes wrong in a case, all methods in one where all do; of: by precision."""
    missed = defaultdict(dict)  # by ask and method: the result in each precision
    for precision, results in of.items():
        for method, result in results.items():
            for ask in result["asks"]:
                if ask["part"] > 1:
                    missed[ask["words"], method][precision] = ask
    words = {ask for ask, _ in missed}
    for ask in sorted(words):
        by_method = {m: said for (a, m), said in missed.items() if a == ask}
        if len(by_method) == len(of["f64"]) > 1:
            worst_of = max(by_method.values(), key=lambda s: max(a["part"] for a in s.values()))
            by_method = {"all": worst_of}
        for method, said in by_method.items():
            cells = []
            for precision in PRECISIONS:
                if precision in said:
                    a = said[precision]
                    cells.append(f"{a['value']:.3g} / {a['bound']:.3g} = {a['part']:.3g}")
                else:
                    cells.append("held")
            why = next(iter(said.values())).get("why", "")
            number = reasons.setdefault(why, len(reasons) + 1)
            yield f"| `{name}` | {ask} | {method} | {' | '.join(cells)} | {number} |\n"


def _counts(results):
    """How many runs there are, how many broke a bound, and how many differ from the one before."""
    return (
        sum(len(all_of) for all_of in results.values()),
        sum(r["status"] == "broken" for all_of in results.values() for r in all_of),
        sum(
            a["asks"] != b["asks"] or a["status"] != b["status"]
            for all_of in results.values()
            for a, b in zip(all_of, all_of[1:], strict=False)
        ),
    )


def _rows(results, names, reasons):
    """Rows of the cases of these names, and those on what goes wrong; reasons: numbers by text."""
    last = {key: all_of[-1] for key, all_of in results.items()}
    lines, wrong = [], []
    for name in names:
        case = CASES[name]
        of = {p: {m: r for (q, c, m), r in last.items() if (q, c) == (p, name)} for p in PRECISIONS}
        asks = "; ".join(ask.words for ask in case.asks)
        if case.fails == "may":
            asks += "; or it fails by name"
        cells = " | ".join(_cell(of[p]) for p in PRECISIONS)
        lines.append(f"| `{name}` | {asks} | {_listed(of['f64'])} | {cells} |\n")
        wrong += _wrong_rows(name, of, reasons)
    return lines, wrong


def page(results, machine):
    last = {key: all_of[-1] for key, all_of in results.items()}
    runs = max(len(all_of) for all_of in results.values())
    count, broken, different = _counts(results)
    reasons = {}
    rows, wrong = _rows(results, CASES, reasons)
    lines = [
        HEAD.format(
            cases=len(CASES),
            runs=runs,
            machine=machine,
            runs_of=count,
            broken=broken,
            different=different,
        ),
        "| case | what is asked | methods | f32 | f64 |\n|---|---|---|---|---|\n",
        *rows,
    ]
    wrong += ["\n", *(f"{number}. {why}.\n" for why, number in reasons.items())]
    heavy = last["f64", "mass_ratio_1e5", "xpbd"]["asks"][0]["value"]
    y = np.array([1, 5]) * 2 * np.pi / 60
    euler, bdf = (1 + y * y) ** -60.0, np.abs(tr_bdf2_factor(1j * y)) ** 120
    notes = NOTES.format(
        euler_1=1 - euler[0],
        euler_5=euler[1],
        bdf_1=1 - bdf[0],
        bdf_5=1 - bdf[1],
        rest=HEAVY_SAG,
        xpbd=heavy,
    )
    return "".join([*lines, WRONG, *wrong, notes])


ADDED = """Those from `{first}` on were added by
`python tests/extreme_document.py --add --runs {runs}`: {count} runs, of which {broken} broke a
bound, and {different} gave another result than the run before. Their rows name the methods that
were run.
"""


def lacking(text):
    """The names of the cases that a page lacks."""
    return [name for name in CASES if f"\n| `{name}` |" not in text]


def with_added(text, results, runs):
    """The page with rows for the cases that it lacks; those of all others stay as they are."""
    names = lacking(text)
    count, broken, different = _counts(results)
    said = ADDED.format(first=names[0], runs=runs, count=count, broken=broken, different=different)
    known = re.findall(r"^(\d+)\. (.*)\.$", text, re.M)
    reasons = {why: int(number) for number, why in known}
    rows, wrong = _rows(results, names, reasons)
    text = re.sub(r"\b\d+ cases below", f"{len(CASES)} cases below", text)
    text = text.replace("\nAll run on the graph", f"\n{said}\nAll run on the graph", 1)
    text = text.replace(
        "|\n\n## What goes wrong", "|\n" + "".join(rows) + "\n## What goes wrong", 1
    )
    last = f"{known[-1][0]}. {known[-1][1]}.\n"
    more = "".join(f"{number}. {why}.\n" for why, number in list(reasons.items())[len(known) :])
    head, first, rest = text.partition("|\n\n1. ")
    return head + "|\n" + "".join(wrong) + "\n1. " + rest.replace(last, last + more, 1)


def main(arguments):
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=1)
    parser.add_argument("--add", action="store_true", help="only cases that the page lacks")
    parser.add_argument("--machine", default="2 cores of a shared machine")
    parser.add_argument("--folder", type=Path, default=HERE.parent / "build" / "extremes")
    parser.add_argument("--resume", action="store_true", help="go on with the journal in --folder")
    parser.add_argument("--on", metavar="tcp://HOST:PORT", help="on a Dask scheduler's workers")
    options = parser.parse_args(arguments)
    before = DOCUMENT.read_text()
    what = [f"/{name}" for name in lacking(before)] if options.add else []
    options.folder.mkdir(parents=True, exist_ok=True)
    known = {"command": "extremes", "of": " ".join(what) or "all", **of_place()}
    with (
        connected(options.on) as there,
        kept(options.folder, known, options.resume) as journal,
    ):
        if there:
            names = lacking(before) if options.add else list(CASES)
            run_elsewhere(journal, options.runs, names, there)
        for number in range(1, options.runs + 1):
            print(f"run {number} of {options.runs}", file=sys.stderr, flush=True)
            run_once(journal, number, what)
            if not options.add:
                DOCUMENT.write_text(page(results_of(journal), options.machine))
        if options.add:
            DOCUMENT.write_text(with_added(before, results_of(journal), options.runs))


if __name__ == "__main__":
    main(sys.argv[1:])
