"""The report of ``taichi-cloth run``: of a run that failed, or that was asked for one."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from taichi_cloth.errors import InputError, SimulationFailure
from taichi_cloth.files.pending import PendingFile
from taichi_cloth.settings.options import RunOptions

if TYPE_CHECKING:
    from taichi_cloth.post_mortem.examine import PostMortem
    from taichi_cloth.simulation.simulation import Simulation

# Beside what a report is put that nobody asked for: what the run writes.
BESIDE = ("save", "record", "checkpoint", "export", "image", "video")


@contextlib.contextmanager
def written(
    sim: Simulation, options: RunOptions, words: Sequence[str], file: PendingFile | None
) -> Iterator[None]:
    """Write the report of the run that is made meanwhile, if it fails or one was asked for.

    words: the scene as after `run`. file: what `--report` began; None: a run that fails has its
    report beside the other files that it writes, and without any it has none.
    """
    sim.past.keeps = True  # type: ignore[union-attr]
    try:
        yield
    except SimulationFailure as failure:
        place = file or _beside(options)
        if place is not None:
            with contextlib.suppress(InputError):  # a full disk: the failure is what to tell
                _write(sim, place, words, options, failure)
        raise
    if file is not None:
        _write(sim, file, words, options, None)


def _beside(options: RunOptions) -> PendingFile | None:
    """Where a run that failed has its report."""
    paths = [Path(path) for name in BESIDE if (path := getattr(options, name))]
    if not paths:
        return None
    with contextlib.suppress(InputError):
        return PendingFile(paths[0].with_name(f"{paths[0].stem}.report.html"))
    return None


def _write(
    sim: Simulation,
    file: PendingFile,
    words: Sequence[str],
    options: RunOptions,
    failure: SimulationFailure | None,
) -> None:
    from taichi_cloth.post_mortem import page
    from taichi_cloth.post_mortem.examine import examine
    from taichi_cloth.ui import showing

    try:
        found: PostMortem = examine(sim, words=words, draw=partial(showing.picture, sim))
        page.write(found, file)
    finally:
        file.discard()
    if options.quiet:
        return
    if failure is not None:
        kind = "cause" if found.cause.numerical else "cause, not numerics"
        print(f"{kind}: {found.line}")
    print(f"report: {file.path}", flush=True)
