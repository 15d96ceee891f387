"""``python -m bench.accuracy``: measures what `docs/accuracy.md` says.

    python -m bench.accuracy                             # all parts
    python -m bench.accuracy costs stiff                 # these two
    python -m bench.accuracy matrix --missing            # what it has no error of
    python -m bench.accuracy --resume                    # after a kill
    python -m bench.accuracy --on tcp://HOST:8786     # errors on a Dask cluster
    python -m bench.accuracy --tables docs/accuracy.md   # measures nothing

Each part's results are kept in `bench/results`, in this machine's file.
"""

from __future__ import annotations

import argparse
import datetime
import importlib
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taichi_cloth.errors import InputError, RunFailure, nearest
from taichi_cloth.files.pending import write_whole
from taichi_cloth.scene.source import SceneSource
from taichi_cloth.settings.options import PROGRAM, flag_words
from taichi_cloth.settings.sweeps import TradeOptions

if TYPE_CHECKING:
    from taichi_cloth.sweeps.journal import Journal
    from taichi_cloth.sweeps.tasks import Elsewhere, Finished, Task

COMMAND = "python -m bench.accuracy"

# Parts that are trades: the scene, and what is asked for.
TRADES: dict[str, tuple[SceneSource, dict[str, Any]]] = {
    "smooth": (SceneSource("cloth"), {"precisions": "f64", "iterations": "10"}),
    "stiff": (
        SceneSource("docs/cable.toml"),
        {"precisions": "f64", "frames": 30, "iterations": "10,100"},
    ),
    "sweeps": (
        SceneSource("cloth", {"shear": 5, "bend": 5}),
        {
            "precisions": "f64",
            "frames": 30,
            "methods": "implicit_euler,xpbd,vbd",
            "substeps": "1,4",
            "iterations": "1,2,4,8,16,32,64,128",
        },
    ),
    "contacts": (
        SceneSource("box", {"particles": 40, "radius": 12}),
        {
            "precisions": "f64",
            "iterations": "10",
            "frames": 60,
            "substeps": "2,8,32,128,512",
        },
    ),
    "precisions": (
        SceneSource("cloth"),
        {
            "methods": "verlet,rk4",
            "frames": 60,
            "without_fast_math": True,
            "substeps": "2,8,32,128,512,2048",
        },
    ),
}
# Functions by module, which run in this process, in f64, or in workers of their own.
MEASURED = {
    "orders": "experiments.orders",
    "damping": "experiments.damping",
    "long": "experiments.long_runs",
    "events": "experiments.orders_with_events",
    "friction": "friction.orders_with_friction",
    "costs": "experiments.costs",
    "matrix": "matrix.matrix",
}
TIMED = "costs"  # which this machine is asked for, whatever measures the rest
PARTS = (*MEASURED, *TRADES)
KEPT = (
    "method", "substeps", "step", "iterations", "tolerance", "precision", "fast_math", "status",
    "error_trajectory_relative", "error_discretisation", "error_solver", "below_floor",
    "energy_drift", "wall_seconds", "wall_lower", "wall_upper", "frames", "force_evaluations",
    "sweeps", "order", "pareto",
)  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure parts, keep their results, fill a document; the exit status."""
    parser = argparse.ArgumentParser(prog=COMMAND, description=__doc__.splitlines()[0])
    parser.add_argument("parts", nargs="*", metavar="PART", help=", ".join(PARTS))
    parser.add_argument("--tables", metavar="FILE.md", help="fill its tables, draw its plots")
    parser.add_argument("--output", metavar="DIR", default="bench/results")
    parser.add_argument("--missing", action="store_true", help="matrix: keep the errors it has")
    parser.add_argument("--resume", action="store_true", help="go on where a killed run was")
    parser.add_argument("--on", metavar="tcp://HOST:PORT", help="errors on a Dask cluster")
    given = parser.parse_args(arguments)
    try:
        _run(given)
    except (InputError, RunFailure) as error:
        print(f"{COMMAND}: error: {error}", file=sys.stderr)
        return error.exit_status
    return 0


def _run(given: argparse.Namespace) -> None:
    """Do what the command line asks for."""
    from bench.accuracy import pictures, tables
    from taichi_cloth import console
    from taichi_cloth.measuring import machine

    words, document = given.parts, given.tables and Path(given.tables)
    for word in words:
        if word not in PARTS:
            raise InputError(f"unknown part '{word}'; {nearest(word, PARTS)}")
    if document:
        console.document(document, tables.MARKED)
    path = Path(given.output) / f"{machine.file_name()}-accuracy.json"
    chosen = [part for part in PARTS if part in words] or ([] if document else list(PARTS))
    if chosen:
        kept = read(path)["matrix"]["data"] if given.missing else None
        _measure_all(chosen, path, kept, given.resume, given.on)
    if document:
        results = read(path)
        text = console.document(document, tables.MARKED)
        write_whole(document, tables.filled(text, results).encode())
        for name, content in pictures.draw_all(results).items():
            if f"images/{name}.png" in text:
                write_whole(document.parent / "images" / f"{name}.png", content)


def _measure_all(
    parts: Sequence[str],
    path: Path,
    of_matrix: dict[str, Any] | None,
    resume: bool,
    on: str | None,
) -> None:
    """Measure parts, and put each into the file of results as soon as it is whole."""
    from taichi_cloth.sweeps import cluster, identity, journal, tasks

    known = {"command": COMMAND, "parts": " ".join(parts), **identity.of_place()}
    path.parent.mkdir(parents=True, exist_ok=True)
    with (
        cluster.connected(on) as there,
        journal.kept(path.parent, known, resume) as finished,
    ):
        if there:
            sent = _tasks(parts, finished, of_matrix or {})
            lost = tasks.fill(finished, sent, there.executor, _tell, gone=there.gone)
            if lost:
                print(tasks.said_of_lost(lost), file=sys.stderr, flush=True)
        for part in parts:
            if finished.get(part):
                continue
            print(f"measuring: {part}", file=sys.stderr, flush=True)
            keep(path, part, measure(part, finished, of_matrix, there))
            finished.add(part, "kept")


def _tasks(parts: Sequence[str], journal: Journal, of_matrix: dict[str, Any]) -> list[Task]:
    """Parts for other machines: all but what is timed, and trades, which see to themselves."""
    from bench.accuracy import matrix
    from taichi_cloth.sweeps.tasks import Task

    found: list[Task] = []
    for part in parts:
        if journal.get(part) or part in (*TRADES, TIMED):
            continue
        if part == "matrix":
            found += matrix.tasks(journal, of_matrix)
        else:
            key = _data_key(part)
            found.append(Task(part, f"{__name__}:finished", [key], {"part": part, "key": key}))
    return found


def finished(part: str, key: str) -> list[Finished]:
    """A part's data, as a task has it; key: of it."""
    from taichi_cloth.sweeps.tasks import Finished

    return [Finished(key, _computed(part))]


def _data_key(part: str) -> str:
    return json.dumps(["data", part])


def _tell(task: Task) -> None:
    print(f"there: {task.name}", file=sys.stderr, flush=True)


def measure(
    part: str,
    journal: Journal | None = None,
    of_matrix: dict[str, Any] | None = None,
    there: Elsewhere | None = None,
) -> dict[str, Any]:
    """A part's results, with what it takes to measure them again.

    journal: has what is finished of it, and gets the rest. of_matrix: results of the matrix, whose
    errors are taken over. there: where errors of trades are measured, if not here.
    """
    from taichi_cloth.measuring import machine
    from taichi_cloth.sweeps.identity import PACKAGES

    if part in TRADES:
        command, data = _trade(part, journal, there)
    else:
        command = f"{COMMAND} {part}"
        data = _experiment(part, journal, of_matrix)
    about = machine.describe()
    return {
        "command": command,
        "date": datetime.date.today().isoformat(),
        "machine": f"{about['processor']}, {about['cores']} cores, {about['system']}",
        "versions": machine.versions(PACKAGES),
        "data": data,
    }


def _experiment(part: str, journal: Journal | None, of_matrix: dict[str, Any] | None) -> Any:
    """A part's data, from the journal where it has them."""
    if part == "matrix":
        return _computed(part, kept=of_matrix, journal=journal)
    if journal is None:
        return _computed(part)
    return journal.once(_data_key(part), lambda: _computed(part))


def _computed(part: str, **asked: Any) -> Any:
    """A part's data, measured in this process or in workers of its own."""
    from taichi_cloth import runtime

    module, name = MEASURED[part].split(".")
    if part not in (TIMED, "matrix"):
        runtime.start("cpu", "f64", threads=1, fast_math=False)
    found = importlib.import_module(f"bench.accuracy.{module}")
    function: Callable[..., Any] = getattr(found, name)
    return function(**asked)


def _trade(part: str, journal: Journal | None, there: Elsewhere | None) -> tuple[str, Any]:
    """The rows of `taichi-cloth trade`, what they were compared to, and the scale of errors."""
    from taichi_cloth.trade import command, rows

    source, asked = TRADES[part]
    options = TradeOptions.from_given(asked)
    scene, chosen, how = command.prepare(source, options)
    with command.measured(source, options, scene, chosen, how, journal, there) as result:
        made = rows.rows_of(result, command.common(scene), command.run_words(source, how))
        if result.interrupted:
            raise result.interrupted
    horizon, found = result.horizon, result.reference
    assert horizon and found  # it went to its end
    data = {
        "title": f"{scene.name}: {len(scene.particles)} particles, {horizon.frames} frames",
        "scale": horizon.scale,
        "frames": horizon.frames,
        "particles": len(scene.particles),
        "reference": [horizon.describe(), *found.describe(horizon)],
        "floor": found.floor(horizon) / horizon.scale,
        "rows": [{name: row.record()[name] for name in KEPT} for row in made],
    }
    return " ".join([PROGRAM, "trade", *source.words(), *flag_words(asked)]), data


def keep(path: Path, part: str, results: dict[str, Any]) -> None:
    """Put a part's results into a file, in place of those it had; the other parts' stay."""
    path.parent.mkdir(parents=True, exist_ok=True)
    kept = read(path) if path.exists() else {}
    whole = {name: kept[name] for name in PARTS if name in kept} | {part: results}
    text = json.dumps(_rounded(whole), indent=1, allow_nan=False) + "\n"
    write_whole(path, text.encode())


def _rounded(data: Any) -> Any:
    """Six digits of every number."""
    if isinstance(data, dict):
        return {name: _rounded(of) for name, of in data.items()}
    if isinstance(data, list):
        return [_rounded(of) for of in data]
    return float(f"{data:.6g}") if isinstance(data, float) else data


def read(path: Path) -> dict[str, Any]:
    """Results by part. Raises InputError where there are none."""
    try:
        results: dict[str, Any] = json.loads(path.read_text("utf-8"))
        return results
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from None
