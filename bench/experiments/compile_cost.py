"""Parts of a cold start, second by second.

    python -m bench.experiments.compile_cost [SCENE:METHOD ...]

A process each, with an empty cache of kernels, to the end of its first frame, as `run` begins in a
window. Modules are there as bytecode, which `pip install` leaves. Seconds are the processor's,
which other work on the machine hardly changes.
"""

import argparse
import compileall
import inspect
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

EACH = ("verlet", "implicit_euler", "tr_bdf2", "xpbd", "vbd")
ASKED = [f"cloth:{method}" for method in EACH] + [
    *(f"{scene}:{method}" for scene in ("box", "warp", "drape") for method in EACH[:2]),
    *("cloth:verlet:64", "cloth:implicit_euler:64"),
]
HEADS = "start", "front end", "machine code", "largest", "rest", "total"
HERE = Path(__file__).resolve().parents[2]
PAIRS = 40  # of frames by turns


class Start(NamedTuple):
    """A start that is asked for; side: of a cloth of so many particles a row and a column."""

    scene: str
    method: str
    side: str = ""
    topology: str = ""

    def __str__(self):
        words = [f"`{self.scene}`", f"{self.side}²" if self.side else "", self.topology]
        return ", ".join(word for word in words if word) + f" | `{self.method}`"


def measure(asked, in_a_piece, to_run_fast):
    """The processor's seconds of what `HEADS` names, how many kernels there are, and the path."""
    import taichi_cloth as tc

    way = {"topology": asked.topology} if asked.topology else {}
    if "soon" in inspect.signature(tc.Simulation).parameters:  # an earlier version has no choice
        way["soon"] = not to_run_fast
    if in_a_piece:
        from taichi_cloth.front_end import mending

        mending.functions_work = lambda: False
    tc.start("cpu")
    start = time.process_time()
    front, code = _watch_kernels()
    sim = tc.Simulation(built(asked), asked.method, **way)
    sim.advance()
    end = time.process_time()
    reading, making = sum(front), sum(code.values())
    rest = end - start - reading - making
    found = start, reading, making, max(code.values()), rest, end
    return {"seconds": found, "kernels": len(code), "topology": sim.topology}


def built(asked):
    """The scene of a start."""
    from taichi_cloth.scene.source import SceneSource

    values = {"columns": int(asked.side), "rows": int(asked.side)} if asked.side else {}
    return SceneSource(asked.scene, values).build()


def by_turns(asked):
    """The factor by which frames take longer with kernels compiled soon, on one thread.

    The median of pairs of some frames each, by turns, and whether positions end with the same bits.
    """
    from taichi_cloth import runtime
    from taichi_cloth.simulation.simulation import Simulation

    runtime.start("cpu")
    way = {"topology": asked.topology or "graph", "dt": "auto", "execution": "serial"}
    fast, soon = (Simulation(built(asked), asked.method, soon=it, **way) for it in (False, True))
    for sim in (fast, soon):
        sim.advance(2)
    frames = max(1, int(0.02 / _seconds(fast, 1)))
    soon.advance(1)
    ratios = []
    for pair in range(PAIRS):
        took = {sim: _seconds(sim, frames) for sim in ((fast, soon), (soon, fast))[pair % 2]}
        ratios.append(took[soon] / took[fast])
    same = bool((fast.positions() == soon.positions()).all())
    return {"ratio": statistics.median(ratios), "hurried": soon.hurries, "same": same}


def _seconds(sim, frames):
    """The time that a simulation takes for so many frames."""
    begin = time.perf_counter()
    sim.advance(frames)
    return time.perf_counter() - begin


def _watch_kernels():
    """Lists that get the seconds of Taichi's front end, and, by kernel, of its first launch."""
    from taichi.lang import kernel_impl

    front, code = [], {}
    materialize, launch = kernel_impl.Kernel.materialize, kernel_impl.Kernel.launch_kernel

    def materialized(self, *given, **named):
        begin = time.process_time()
        materialize(self, *given, **named)
        front.append(time.process_time() - begin)

    def launched(self, kernel, *given):
        begin = time.process_time()
        result = launch(self, kernel, *given)
        code.setdefault(id(kernel), time.process_time() - begin)
        return result

    kernel_impl.Kernel.materialize, kernel_impl.Kernel.launch_kernel = materialized, launched
    return front, code


def least(times, asked, flags, checkout=""):
    """The words of `started` on the cheapest of so many starts."""
    found = [started(asked, flags, checkout) for _ in range(times)]
    return min(found, key=lambda one: one["seconds"][-1])


def started(asked, flags, checkout=""):
    """The words of `measure` on a start in a process of its own; checkout: of another version."""
    with tempfile.TemporaryDirectory() as folder:
        places = {"TI_OFFLINE_CACHE_FILE_PATH": folder, "XDG_CACHE_HOME": folder}
        if checkout:
            places["PYTHONPATH"] = checkout
        child = [sys.executable, __file__, "--one", *flags, ":".join(asked)]
        text = subprocess.run(
            child, env=os.environ | places, check=True, capture_output=True, text=True
        ).stdout
    return json.loads(text.splitlines()[-1])


def rows(asked, flags, times):
    """A row of a table for each start: where its seconds go."""
    yield "| scene | method | path | kernels | " + " | ".join(HEADS) + " |"
    yield "|---" * (4 + len(HEADS)) + "|"
    for start in asked:
        found = least(times, start, flags)
        seconds = " | ".join(f"{value:.2f}" for value in found["seconds"])
        yield f"| {start} | {found['topology']} | {found['kernels']} | {seconds} |"


def rows_beside(asked, flags, times, checkout):
    """A row of a table for each start: what it took in another version, and what in this one."""
    yield (
        "| scene | method | path | largest kernel before | now | total before | now | ratio |"
        " but for the start |"
    )
    yield "|---" * 9 + "|"
    for start in asked:
        before, now = least(times, start, flags, checkout), least(times, start, flags)
        cells = [before["seconds"][3], now["seconds"][3], before["seconds"][5], now["seconds"][5]]
        cells.append(cells[3] / cells[2])
        after_start = [one["seconds"][5] - one["seconds"][0] for one in (before, now)]
        cells.append(after_start[1] / after_start[0])
        seconds = " | ".join(f"{value:.2f}" for value in cells)
        yield f"| {start} | {now['topology']} | {seconds} |"


def rows_by_turns(asked, flags):
    """A row of a table for each start: what compiling it soon costs later."""
    yield "| scene | method | ratio | bits |"
    yield "|---" * 4 + "|"
    for start in asked:
        found = started(start, flags)
        kept = f"{found['ratio']:.2f}" if found["hurried"] else "not compiled soon"
        yield f"| {start} | {kept} | {'same' if found['same'] else 'other'} |"


def main():
    """Measure what the command line asks for, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("asked", nargs="*", metavar="SCENE:METHOD[:SIDE[:TOPOLOGY]]", default=ASKED)
    parser.add_argument("--before", metavar="CHECKOUT", help="a version to compare with")
    parser.add_argument("--in-a-piece", action="store_true", help="compile no step in parts")
    parser.add_argument("--to-run-fast", action="store_true", help="compile as long runs do")
    parser.add_argument("--turns", action="store_true", help="frames of both kinds by turns")
    parser.add_argument("--times", type=int, default=1, help="the least of so many starts each")
    parser.add_argument("--one", action="store_true", help="in this process, as JSON")
    given = parser.parse_args()
    asked = [Start(*words.split(":")) for words in given.asked]
    if given.one:
        measured = given.in_a_piece, given.to_run_fast
        print(json.dumps(by_turns(*asked) if given.turns else measure(*asked, *measured)))
        return
    for version in (HERE, given.before):
        if version:
            compileall.compile_dir(Path(version) / "taichi_cloth", quiet=2)
    flags = ["--in-a-piece"] * given.in_a_piece + ["--to-run-fast"] * given.to_run_fast
    how = flags, given.times
    table = rows_beside(asked, *how, given.before) if given.before else rows(asked, *how)
    if given.turns:
        table = rows_by_turns(asked, [*flags, "--turns"])
    for row in table:
        print(row, flush=True)


if __name__ == "__main__":
    main()
