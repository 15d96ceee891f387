"""Ours, Newton's and SciPy's solvers at equal error: the cheapest time a frame of each.

On each scene every solver is run in ever finer settings (`search`), each run beside its error
against one reference (`truth`); the cheapest setting that meets a level is its best. The best of
all solvers are timed once more, by turns in one run, and their ratios are of these times. Times are
of all frames in one request: ours in one call, Newton's step by step, SciPy's as one integration.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from taichi_cloth.benchmarks.contest import Bench
from taichi_cloth.benchmarks.equal_error import picture, runs_file
from taichi_cloth.benchmarks.equal_error.contestants import OURS, Entrant, Kind, enter, kinds
from taichi_cloth.benchmarks.equal_error.problems import STIFFER, Problem, all_problems
from taichi_cloth.benchmarks.equal_error.runs_file import SearchRun
from taichi_cloth.benchmarks.equal_error.search import (
    LEVELS,
    Choice,
    Tried,
    cheapest,
    search_all,
)
from taichi_cloth.benchmarks.equal_error.truth import Truth, truth_of
from taichi_cloth.benchmarks.report import Measurement
from taichi_cloth.console import percent
from taichi_cloth.files.pending import write_whole
from taichi_cloth.measuring import machine
from taichi_cloth.measuring.timing import quartiles, turns
from taichi_cloth.measuring.worker import WorkerFailed

PART = "accuracy"
PACKAGES = {"taichi": ("taichi-cloth", "taichi"), "newton": ("newton", "warp-lang")}
# The target at each level: how many times cheaper than the best peer.
TARGETS = {level: ">= 10" if level == 0.01 else ">= 1" for level in LEVELS}
# Seconds of a run past which nobody is given finer settings; of each reference; of a scene's race,
# after which no further round begins.
LIMIT, QUICK_LIMIT = 30.0, 1.0
PATIENCE, QUICK_PATIENCE = 600.0, 20.0
RACE = 120.0


@dataclass
class _Best:
    """A setting that is its group's cheapest at some level, and its seconds a frame by round."""

    entrant: Entrant
    tried: Tried
    seconds: list[float] = field(default_factory=list)


def measure(bench: Bench) -> Iterator[Measurement]:
    """Each scene: its reference, the search, and the race of the best."""
    takers = []
    for kind in kinds(bench.quick):
        if machine.installed(kind.package):
            takers.append(kind)
        else:
            why = f'pip install "taichi-cloth[bench]" (or {kind.package})'
            bench.leave_out(PART, kind.name, "all scenes", why)
    bench.leave_out(PART, "Newton, Style3D", "all scenes", "it has triangles, and no springs")
    bench.leave_out(PART, "everyone", "a drape with contacts", "is not among the scenes yet")
    if bench.quick:
        bench.leave_out(PART, "everyone", f"Warp's cloth, {STIFFER[-1]} × k", "left to a whole run")
    runs: list[SearchRun] = []
    for problem in all_problems(bench.quick):
        yield from _measure(bench, problem, takers, runs)
        bench.end_workers()
        _keep(bench, runs)


def _keep(bench: Bench, runs: Sequence[SearchRun]) -> None:
    """Write the runs so far, and their picture, beside the results, if they are kept."""
    if bench.results is not None:
        name = machine.file_name()
        runs_file.write(bench.results / f"{name}{runs_file.SUFFIX}", runs)
        write_whole(bench.results / f"{name}-accuracy.png", picture.draw(runs))


def _measure(
    bench: Bench, problem: Problem, takers: Sequence[Kind], runs: list[SearchRun]
) -> Iterator[Measurement]:
    limit = QUICK_LIMIT if bench.quick else LIMIT
    truth = truth_of(problem, QUICK_PATIENCE if bench.quick else PATIENCE, bench.tell)
    if isinstance(truth, str):
        bench.leave_out(PART, "everyone", problem.name, truth)
        return
    levels = [level for level in LEVELS if level > truth.floor]
    for level in LEVELS:
        if level not in levels:
            why = f"the reference tells no error below {percent(truth.floor, 2)}"
            bench.leave_out(PART, "everyone", _where(problem, level), why)
    tried: dict[str, list[tuple[Entrant, Tried]]] = {kind.group: [] for kind in takers}
    for kind in takers:
        entrant = enter(bench, PART, kind, problem, truth, patience=2 * limit)
        if entrant is None:
            continue
        try:
            before = [done for _, done in tried[kind.group]]
            found = search_all(entrant, kind.ladders, limit / truth.frames, levels, before)
        except WorkerFailed as failure:
            bench.leave_out(PART, kind.name, problem.name, str(failure))
            continue
        tried[kind.group] += [(entrant, done) for done in found]
        runs += [SearchRun.of(problem.name, kind.group, kind.name, done) for done in found]
    best = _best_of(bench, problem, tried, levels, limit)
    _race(bench, problem, list({id(b): b for b in best.values()}.values()))
    yield from _rows(problem, truth, best)
    for level in levels:
        yield from _ratio(problem, best, level)


def _best_of(
    bench: Bench,
    problem: Problem,
    tried: dict[str, list[tuple[Entrant, Tried]]],
    levels: Sequence[float],
    limit: float,
) -> dict[tuple[str, float], _Best]:
    """The cheapest of each group at each level, one object a setting; notes who misses one.

    limit: seconds of a run past which nobody was given finer settings.
    """
    made: dict[tuple[str, Choice], _Best] = {}
    best: dict[tuple[str, float], _Best] = {}
    for group, pairs in tried.items():
        for level in levels:
            found = cheapest((done for _, done in pairs), level)
            if found is None:
                least = min((d.error for _, d in pairs if d.error is not None), default=math.inf)
                sought = f"no setting tried, up to one that took {limit:g} s,"
                why = f"{sought} has an error of at most {100 * level:g} %"
                has = f"; the least is {percent(least, 2)}" if math.isfinite(least) else ""
                bench.leave_out(PART, group, problem.name, why + has)
                break
            entrant = next(entrant for entrant, done in pairs if done is found)
            key = entrant.kind.name, found.choice
            best[group, level] = made.setdefault(key, _Best(entrant, found))
    return best


def _race(bench: Bench, problem: Problem, best: list[_Best]) -> None:
    """Time the best by turns; one whose process is lost leaves."""
    running = list(best)
    for number, one in turns(running, bench.rounds, rotate=True, patience=RACE, least=1):
        name = one.entrant.kind.name
        bench.tell(f"{problem.name}: the best by turns: {name}", number, bench.rounds + 1)
        try:
            seconds = one.entrant.time(one.tried.choice)
        except WorkerFailed as failure:
            bench.leave_out(PART, name, problem.name, str(failure))
            running.remove(one)
            continue
        if number > 0:
            one.seconds += seconds


def _where(problem: Problem, level: float) -> str:
    return f"{problem.name}: {100 * level:g} %"


def _rows(
    problem: Problem, truth: Truth, best: dict[tuple[str, float], _Best]
) -> Iterator[Measurement]:
    """By level, then by group: its cheapest setting, timed by turns."""
    for (_, level), one in sorted(best.items(), key=lambda item: -item[0][1]):
        if not one.seconds:
            continue
        low, middle, high = quartiles(one.seconds)
        kind = one.entrant.kind
        member = kind.name.removeprefix(kind.group).removeprefix(", ")
        setting = ", ".join(filter(None, [member, one.tried.choice.describe()]))
        yield Measurement(
            part=PART,
            contestant=f"{kind.group}: {setting}",
            size=_where(problem, level),
            precision=kind.precision,
            threads=1,
            execution=one.entrant.about.get("execution", ""),
            topology=one.entrant.about.get("topology", ""),
            seconds=middle,
            lower=low,
            upper=high,
            error=one.tried.error,
            against=f"the reference of {problem.name} over {truth.frames} frames, RMS, in parts of "
            f"the largest displacement: {truth.what}",
            rounds=len(one.seconds),
            versions=machine.versions(PACKAGES.get(kind.package, (kind.package,))),
        )


def _ratio(
    problem: Problem, best: dict[tuple[str, float], _Best], level: float
) -> Iterator[Measurement]:
    """How many times as long as ours the best peer takes at a level; none where either lacks."""
    mine = best.get((OURS, level))
    peers = [b for (group, at), b in best.items() if at == level and group != OURS and b.seconds]
    if mine is None or not mine.seconds or not peers:
        return
    middle = {id(b): quartiles(b.seconds).median for b in [mine, *peers]}
    peer = min(peers, key=lambda b: middle[id(b)])
    yield Measurement(
        part=PART,
        contestant=f"best peer's time to ours: {peer.entrant.kind.name}",
        size=_where(problem, level),
        rate=middle[id(peer)] / middle[id(mine)],
        unit="times",
        target=TARGETS[level],
    )
