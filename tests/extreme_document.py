"""Runs all extreme cases several times in both precisions, and writes docs/extremes.md.

python tests/extreme_document.py [--runs 10]
"""

import argparse
import json
import os
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

import numpy as np
from extreme_cases import CASES, HEAVY_SAG, tr_bdf2_factor
from extreme_worker import PRECISIONS

from taichi_cloth.kernels import methods

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

`tests/test_extremes.py` runs them all. This page was written by
`python tests/extreme_document.py --runs {runs}` on {machine}: {runs_of} runs of a
case with a method, of which {broken} broke a bound, and {different} gave another result than the
run before.

All run on the graph, on one thread; that the other topologies and parallel runs give the same is
what other tests are for. Steps are a tenth of the stability limit where a method has one, and where
the case does not say otherwise; where a method is unstable at every step (`explicit_euler`), so
small that the energy cannot double; and one step of 0.01 to 1000 s a frame where it has no limit.

## The cases

"Part of the bound" is the largest value over its bound, of all methods and at all times looked at.
"""
WRONG = """
## What goes wrong, where, and by how much

Where a method is wrong, the size of its error is asserted, too: at most about three times what is
measured here.

| case | what was asked | method | precision | value | bound | times | why |
|---|---|---|---|---|---|---|---|
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


def results_of(runs):
    """After each run: its number; by (precision, case, method) the results so far."""
    results = defaultdict(list)
    for number in range(1, runs + 1):
        print(f"run {number} of {runs}", file=sys.stderr, flush=True)
        workers = [
            subprocess.Popen(
                [sys.executable, HERE / "extreme_worker.py", precision],
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
                env={**os.environ, "ENABLE_TAICHI_HEADER_PRINT": "0"},
            )
            for precision in PRECISIONS
        ]
        for precision, worker in zip(PRECISIONS, workers, strict=True):
            for line in worker.communicate()[0].splitlines():
                result = json.loads(line)
                results[precision, result["case"], result["method"]].append(result)
            assert worker.returncode == 0, f"the worker of {precision} ended early"
        yield number, results


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
        said.append(f"held, {max(part, 0):.2g} of the bound" + (f" ({method})" if part > 0 else ""))
    failed = [m for m, r in of.items() if r["status"] == "failed"]
    if failed:
        said.append("fails by name" + ("" if len(failed) == len(of) else f": {_listed(failed)}"))
    for status in ("wrong", "broken"):
        names = [m for m, r in of.items() if r["status"] == status]
        if names:
            said.append(f"**{status}**: {_listed(names)}")
    return "; ".join(said)


def page(results, runs, machine):
    last = {key: all_of[-1] for key, all_of in results.items()}
    count = sum(len(all_of) for all_of in results.values())
    broken = sum(r["status"] == "broken" for all_of in results.values() for r in all_of)
    different = sum(
        a["asks"] != b["asks"] or a["status"] != b["status"]
        for all_of in results.values()
        for a, b in zip(all_of, all_of[1:], strict=False)
    )
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
    ]
    wrong = []
    for name, case in CASES.items():
        of = {p: {m: r for (q, c, m), r in last.items() if (q, c) == (p, name)} for p in PRECISIONS}
        asks = "; ".join(ask.words for ask in case.asks)
        if case.fails == "may":
            asks += "; or it fails by name"
        cells = " | ".join(_cell(of[p]) for p in PRECISIONS)
        lines.append(f"| `{name}` | {asks} | {_listed(of['f64'])} | {cells} |\n")
        for precision in PRECISIONS:
            for method, result in of[precision].items():
                for ask in result["asks"]:
                    if ask["part"] > 1:
                        numbers = f"{ask['value']:.3g} | {ask['bound']:.3g} | {ask['part']:.3g}"
                        where = f"`{name}` | {ask['words'].split(',')[0]} | {method} | {precision}"
                        wrong.append(f"| {where} | {numbers} | {ask.get('why', '')} |\n")
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


def main(arguments):
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=1)
    parser.add_argument("--machine", default="2 cores of a shared machine")
    options = parser.parse_args(arguments)
    for number, results in results_of(options.runs):
        DOCUMENT.write_text(page(results, number, options.machine))


if __name__ == "__main__":
    main(sys.argv[1:])
