"""Ours, Newton's and SciPy's solvers at equal error: the cheapest time a frame of each.

On each scene every solver is run in ever finer settings (`search`), each run beside its error
against one reference (`truth`); the cheapest setting that meets a level is its best. The best of
all solvers are timed once more, by turns in one run, and their ratios are of these times. Ours is
timed on one thread and on all cores, Newton recorded once and replayed and launched from Python:
the bits, and so the errors, are the same, and the faster counts. Times are of all frames in one
request: ours in one call, Newton's in recordings of 32 steps, SciPy's as one integration.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

from bench.contest import Bench
from bench.equal_error import picture, runs_file
from bench.equal_error.contestants import (
    OURS,
    CannotEnter,
    Entrant,
    Kind,
    kinds,
    unfit,
)
from bench.equal_error.problems import (
    STIFFER,
    Problem,
    all_problems,
    chosen,
)
from bench.equal_error.runs_file import SearchRun
from bench.equal_error.search import (
    LEVELS,
    Choice,
    Tried,
    cheapest,
    search_all,
)
from bench.equal_error.truth import Truth, truth_of
from bench.report import Measurement
from taichi_cloth.console import percent
from taichi_cloth.files.pending import prepare_folder, write_whole
from taichi_cloth.measuring import machine
from taichi_cloth.measuring.timing import quartiles, turns
from taichi_cloth.measuring.worker import WorkerFailed
from taichi_cloth.sweeps import identity
from taichi_cloth.sweeps import journal as journals
from taichi_cloth.sweeps.journal import Journal, key_of
from taichi_cloth.sweeps.within import TimeIsUp, ending

PART = "accuracy"
JOURNAL = "-accuracy-journal"  # the folder of what is finished, beside the results
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
    """A setting that is its group's cheapest at some level, and its seconds a frame by round.

    other: the same run in another way, for a solver that has one (`Kind.other_way`).
    """

    entrant: Entrant
    tried: Tried
    other: _Best | None = None
    seconds: list[float] = field(default_factory=list)

    @property
    def median(self) -> float:
        """Of its seconds a frame; infinite before it was timed."""
        return quartiles(self.seconds).median if self.seconds else math.inf

    @property
    def quickest(self) -> _Best:
        """The one that is run in the other way, where that is the quicker."""
        return min((self, self.other or self), key=lambda one: one.median)


def measure(bench: Bench) -> Iterator[Measurement]:
    """Each scene: its reference, the search, and the race of the best; all that is finished goes
    into a journal, with which another piece goes on.

    Raises InputError for scenes that there are not, and for a journal of another machine or of
    other versions.
    """
    problems = all_problems(bench.quick)
    wanted = chosen(problems, bench.piece.scenes)
    bench.scenes = {problem.name: False for problem in problems}
    searched = _search_file(bench)
    if searched is not None and searched.exists():
        runs_file.read(searched)  # what there is can be joined
    if bench.quick:
        bench.leave_out(PART, "everyone", f"Warp's cloth, {STIFFER[-1]} × k", "left to a whole run")
    rows: list[Measurement] = []
    folder = _folder(bench)
    try:
        with (
            journals.kept(folder, _identity(bench), bench.piece.resume) as journal,
            ending(bench.piece.clock),
        ):
            for problem in wanted:
                rows += _scene(bench, problem, journal)
        folder.rmdir()
    except TimeIsUp:
        for problem in wanted:
            if not bench.scenes[problem.name]:
                why = f"not finished in {bench.piece.clock.describe()}; --resume goes on with it"
                bench.leave_out(PART, "everyone", problem.name, why)
    yield from rows


def _takers(bench: Bench, problem: Problem) -> list[Kind]:
    """All that can solve the problem and whose packages are installed; notes the others."""
    takers = []
    for kind in kinds(bench.quick, problem.touching):
        why = unfit(kind, problem)
        if not machine.installed(kind.package):
            what = f'pip install "taichi-cloth[bench]" (or {kind.package})'
            bench.leave_out(PART, kind.group, "all scenes", what)
        elif why:
            bench.leave_out(PART, kind.group, problem.name, why)
        else:
            takers.append(kind)
    return takers


def _folder(bench: Bench) -> Path:
    """The place of the journal."""
    folder = (bench.results or bench.folder) / f"{machine.file_name()}{JOURNAL}"
    prepare_folder(folder, [])
    return folder


def _identity(bench: Bench) -> dict[str, str]:
    """The identity of results, beside the scenes, which are in their keys."""
    packages = (*identity.PACKAGES, *(name for of in PACKAGES.values() for name in of))
    return {
        "command": f"bench {PART}",
        "settings": " ".join(["--quick"] * bench.quick + ["--rounds", str(bench.rounds)]),
        **identity.of_place(),
        "versions": machine.versions(tuple(dict.fromkeys(packages))),
    }


def _search_file(bench: Bench) -> Path | None:
    """The file of all runs of the search, if results are kept."""
    name = f"{machine.file_name()}{runs_file.SUFFIX}"
    return bench.results / name if bench.results is not None else None


def _scene(bench: Bench, problem: Problem, journal: Journal) -> list[Measurement]:
    """The rows of a scene, from the journal where it is finished there; puts its runs into the
    file of the search, and draws that anew.
    """
    key = key_of("scene", problem.digest)
    entry = journal.get(key)
    if entry is None:
        before = len(bench.left_out)
        runs: list[SearchRun] = []
        try:
            rows = _measure(bench, problem, runs, journal)
        except TimeIsUp:
            del bench.left_out[before:]  # of a scene that has no rows yet
            raise
        bench.end_workers()
        found = {
            "rows": [asdict(row) for row in rows],
            "left out": [asdict(row) for row in bench.left_out[before:]],
            "runs": [asdict(run) for run in runs],
        }
        entry = journal.add(key, found)
    else:
        known = [Measurement(**row) for row in entry.result["left out"]]
        bench.left_out += [row for row in known if row not in bench.left_out]
    bench.scenes[problem.name] = True
    path = _search_file(bench)
    if path is not None:
        mine = [SearchRun(**run) for run in entry.result["runs"]]
        renewed = {name: name == problem.name for name in bench.scenes}
        together = runs_file.replace_scenes(path, mine, renewed)
        write_whole(path.with_name(f"{machine.file_name()}-accuracy.png"), picture.draw(together))
    return [Measurement(**row) for row in entry.result["rows"]]


def _measure(
    bench: Bench,
    problem: Problem,
    runs: list[SearchRun],
    journal: Journal,
) -> list[Measurement]:
    """The rows of a scene; runs: gets all runs of the search."""
    takers = _takers(bench, problem)
    limit = QUICK_LIMIT if bench.quick else LIMIT
    truth = truth_of(problem, QUICK_PATIENCE if bench.quick else PATIENCE, bench.tell, journal)
    if isinstance(truth, str):
        bench.leave_out(PART, "everyone", problem.name, truth)
        return []
    levels = [level for level in LEVELS if level > truth.floor]
    for level in LEVELS:
        if level not in levels:
            why = f"the reference tells no error below {percent(truth.floor, 2)}"
            bench.leave_out(PART, "everyone", _where(problem, level), why)
    tried: dict[str, list[tuple[Entrant, Tried]]] = {kind.group: [] for kind in takers}
    for kind in takers:
        entrant = Entrant(bench, kind, problem, truth, 2 * limit, journal)
        before = [done for _, done in tried[kind.group]]
        try:
            search_all(entrant, kind.ladders, limit / truth.frames, levels, before)
        except CannotEnter as failure:
            bench.leave_out(PART, kind.name, problem.name, str(failure))
        tried[kind.group] += [(entrant, done) for done in entrant.tried]
        runs += [SearchRun.of(problem.name, kind.group, kind.name, done) for done in entrant.tried]
    best = _best_of(bench, problem, tried, levels, limit)
    _race(bench, problem, list({id(b): b for b in best.values()}.values()), truth.frames)
    rows = list(_rows(problem, truth, best))
    for level in levels:
        rows += _ratio(problem, best, level)
    return rows


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
            if key not in made:
                made[key] = _Best(entrant, found, _other(bench, entrant, found))
            best[group, level] = made[key]
    return best


def _other(bench: Bench, entrant: Entrant, tried: Tried) -> _Best | None:
    """The tries of an entrant, run in the other way."""
    kind = entrant.kind.other_way(bench.threads)
    return _Best(entrant.of_kind(kind), tried) if kind else None


def _race(bench: Bench, problem: Problem, best: list[_Best], frames: int) -> None:
    """Time the best by turns, in one go; one whose process is lost leaves.

    Raises TimeIsUp where there is not the time for it.
    """
    running = [runs for one in best for runs in (one, one.other) if runs is not None]
    a_round = sum(frames * (one.tried.seconds or 0.0) for one in running)
    if min((bench.rounds + 1) * a_round, RACE + a_round) > bench.piece.clock.left():
        raise TimeIsUp
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
    """By level, then by group: its cheapest setting, timed by turns, in each way it is run."""
    for (_, level), one in sorted(best.items(), key=lambda item: -item[0][1]):
        for runs in (one, one.other):
            if runs is not None and runs.seconds:
                yield _row(problem, truth, level, runs)


def _row(problem: Problem, truth: Truth, level: float, one: _Best) -> Measurement:
    """A setting that is the cheapest at a level."""
    low, middle, high = quartiles(one.seconds)
    kind = one.entrant.kind
    way = f", {kind.way}" * bool(kind.way)
    member = kind.name.removesuffix(way).removeprefix(kind.group).removeprefix(", ")
    setting = ", ".join(filter(None, [member, one.tried.choice.describe()]))
    return Measurement(
        part=PART,
        contestant=f"{kind.group}{way}: {setting}",
        size=_where(problem, level),
        precision=kind.precision,
        threads=kind.threads,
        execution=one.entrant.about.get("execution", ""),
        topology=one.entrant.about.get("topology", ""),
        seconds=middle,
        lower=low,
        upper=high,
        error=one.tried.error,
        against=f"the reference of {problem.name} over {truth.frames} frames, RMS, in parts of "
        f"the largest displacement: {truth.what}",
        rounds=len(one.seconds),
        note=kind.material,
        versions=machine.versions(PACKAGES.get(kind.package, (kind.package,))),
    )


def _ratio(
    problem: Problem, best: dict[tuple[str, float], _Best], level: float
) -> Iterator[Measurement]:
    """The factor by which the best peer takes longer than ours at a level; none where either lacks.

    Of each the faster way counts; where that of ours is on all cores, one thread has a row, too.
    """
    mine = best.get((OURS, level))
    peers = [b for (group, at), b in best.items() if at == level and group != OURS and b.seconds]
    if mine is None or not mine.quickest.seconds or not peers:
        return
    peer = min((b.quickest for b in peers), key=lambda b: b.median)
    compared = {"ours": mine.quickest}
    if mine.quickest is not mine and mine.seconds:
        compared["ours, one thread"] = mine
    for name, one in compared.items():
        yield Measurement(
            part=PART,
            contestant=f"best peer's time to {name}: {peer.entrant.kind.name}",
            size=_where(problem, level),
            rate=peer.median / one.median,
            unit="times",
            target=TARGETS[level] if one is mine.quickest else "",
        )
