"""Every run of the search, kept as a table beside the results."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from bench.equal_error.search import Choice, Tried
from bench.report import read_table
from taichi_cloth.files.pending import write_whole

SUFFIX = "-accuracy-search.csv"


@dataclass(frozen=True)
class SearchRun:
    """A run of a contestant: of which scene, group and solver, in what setting, with what result.

    error: in parts of the largest displacement; seconds: of a frame. None where it failed.
    """

    scene: str
    group: str
    contestant: str
    setting: str
    substeps: int | None
    iterations: int | None
    tolerance: float | None
    error: float | None
    seconds_a_frame: float | None
    status: str

    @classmethod
    def of(cls, scene: str, group: str, contestant: str, tried: Tried) -> SearchRun:
        choice = tried.choice
        return cls(
            scene=scene,
            group=group,
            contestant=contestant,
            setting=choice.describe(),
            **asdict(choice),
            error=tried.error,
            seconds_a_frame=tried.seconds,
            status=tried.failed or "ok",
        )

    @property
    def tried(self) -> Tried:
        """The result of the search."""
        choice = Choice(self.substeps, self.iterations, self.tolerance)
        failed = "" if self.status == "ok" else self.status
        return Tried(choice, self.error, self.seconds_a_frame, failed)


NAMES = tuple(f.name for f in fields(SearchRun))
COUNTS, NUMBERS = ("substeps", "iterations"), ("tolerance", "error", "seconds_a_frame")


def replace_scenes(
    path: Path, runs: Iterable[SearchRun], scenes: Mapping[str, bool]
) -> list[SearchRun]:
    """Put the runs of scenes into a file, in place of those it had; what is in it then.

    scenes: all, in their order, and whether runs are theirs; the others' stay. Raises InputError.
    """
    kept = [run for run in read(path) if not scenes.get(run.scene, True)] if path.exists() else []
    names = list(scenes)
    together = sorted([*kept, *runs], key=lambda run: names.index(run.scene))
    write(path, together)
    return together


def write(path: Path, runs: Iterable[SearchRun]) -> None:
    """Write all runs, whole. Raises InputError."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(NAMES)
    for run in runs:
        values = asdict(run)
        for name in NUMBERS:
            values[name] = "" if values[name] is None else f"{values[name]:.4g}"
        table.writerow("" if values[name] is None else values[name] for name in NAMES)
    write_whole(path, text.getvalue().encode())


def read(path: Path) -> list[SearchRun]:
    """The runs of a file; raises InputError."""
    kinds = dict.fromkeys(NUMBERS, float) | dict.fromkeys(COUNTS, int)
    return [SearchRun(**record) for record in read_table(path, NAMES, kinds, "search")[1]]
