"""The report of ``taichi-cloth run``: of a run that failed, or that was asked for one."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_cloth import signals
from taichi_cloth.errors import InputError, SimulationFailure
from taichi_cloth.files.pending import PendingFile, is_device
from taichi_cloth.settings.options import WRITES, RunOptions, flag_words
from taichi_cloth.simulation.past import Settings

if TYPE_CHECKING:
    from taichi_cloth.post_mortem.examine import PostMortem
    from taichi_cloth.scene.source import SceneSource
    from taichi_cloth.simulation.simulation import Simulation
    from taichi_cloth.ui.chrome.why import Finding

PATIENCE = 5.0  # seconds that a window waits for the trials
UNTRIED = "--survivors looks for a setting that survives, by running it"
UNTRIED_HERE = "k looks for a setting that survives, by running it"
OWN = ("method", "dt", "substeps")  # settings of every run, in the order in which they are set
# Flags that are to be the same where a run is made again.
ALIKE = (
    *("arch", "precision", "execution", "topology", "threads", "fast_math", "seed", "resume"),
    *("unconverged", "lanes"),
)


def words_of(source: SceneSource, options: RunOptions) -> list[str]:
    """The command line of a run after `run`, but for its method, step, solver and output."""
    given = {name: getattr(options, name) for name in ALIKE if name in options.given}
    events = options.events or options.record  # a window's session is in the log that it writes
    if events is not None:
        given["events"] = events
    return [*source.words(), *flag_words(given)]


@contextlib.contextmanager
def written(
    sim: Simulation, options: RunOptions, words: Sequence[str], file: PendingFile | None
) -> Iterator[None]:
    """Write the report of the run that is made meanwhile, if it fails or one was asked for; that
    one also where it is interrupted, unless that happens once more.

    words: as `words_of` makes them. file: what `--report` began; None: a run that fails has its
    report beside the other files that it writes, and without any it has none. A failure that was
    looked into, for a report or for `--survivors`, says the cause that was found.
    """
    sim.past.keeps = True  # type: ignore[union-attr]
    try:
        yield
    except SimulationFailure as failure:
        place = file or _beside(options)
        if place is not None or options.survivors:
            with contextlib.suppress(InputError):  # a full disk: the failure is what to tell
                _write(sim, place, words, options, failure)
        raise
    except KeyboardInterrupt:
        if file is not None:
            _write(sim, file, words, options, None)
        raise
    if file is not None:
        _write(sim, file, words, options, None)


class Examining:
    """Finds out for a window why its run failed. words: as `words_of` makes them; of a window that
    a script opened none. tries: whether settings are tried unasked.
    """

    def __init__(self, sim: Simulation, words: Sequence[str] = (), tries: bool = False) -> None:
        self._sim, self._words, self._tries = sim, words, tries

    def examine(self, tell: Callable[[str], None], tries: bool) -> Finding | None:
        """The cause that is found; tell: called with what is being tried; tries: whether anything
        is, though it was not asked for at the start.
        """
        from taichi_cloth.post_mortem.examine import examine, flags

        now = Settings.of(self._sim)

        def trying(settings: Settings) -> None:
            tell(f"trying {' '.join(flags(settings, now)) or 'it again'}")

        untried = "" if tries or self._tries else UNTRIED_HERE
        found = examine(
            self._sim, words=self._words, seconds=PATIENCE, tell=trying, untried=untried
        )
        _explain(found)
        return _finding(found)


def _explain(found: PostMortem) -> None:
    """Have the failure say what the post-mortem says."""
    from taichi_cloth.post_mortem.causes import UNKNOWN

    failure = found.trace.failure
    if failure is not None and found.cause.kind != UNKNOWN:
        failure.explain(found.cause.says, found.remedy or found.search.says)


def _finding(found: PostMortem) -> Finding:
    """A window's words on a post-mortem."""
    from taichi_cloth.kernels import methods
    from taichi_cloth.post_mortem.causes import DAMPINGS
    from taichi_cloth.ui.chrome.why import Finding

    trace, best, failure = found.trace, found.search.best, found.trace.failure
    title = f"frame {failure.frame}: particle {failure.particle} {failure.what}" if failure else ""
    limit = methods.load(trace.settings.method).claims.stability_limit
    samples, damped = trace.samples, found.cause.kind in DAMPINGS
    settings: dict[str, Any] = {}
    if best is not None:
        pairs = {
            name: (getattr(best.settings, name), getattr(trace.settings, name)) for name in OWN
        }
        if best.settings.method == trace.settings.method:  # a new one takes its defaults
            had = trace.settings.solver
            pairs |= {name: (value, had.get(name)) for name, value in best.settings.solver.items()}
        settings = {name: value for name, (value, before) in pairs.items() if value != before}
    columns = {
        name: np.array([getattr(sample, of) for sample in samples])
        for name, of in (
            *(("time", "time"), ("reach", "damped" if damped else "reach")),
            *(("energy", "moving"), ("created", "drift")),
        )
    }
    remedy = f"{found.remedy}: {found.search.says}" if best else found.search.says
    return Finding(
        title, found.cause.says, found.cause.proof, found.cause.numerical, remedy, settings,
        back=(failure.frame - 1 if failure else samples[-1].frame) - samples[0].frame,
        whole=trace.whole and not trace.acts,
        limit=limit if 0 < limit < np.inf and not damped else None,
        tried=found.search.asked,
        reads="h d, by damping" if damped else "h omega",
        **columns,
    )  # fmt: skip


def _beside(options: RunOptions) -> PendingFile | None:
    """The place of a failed run's report that nobody asked for: beside its files."""
    given = [Path(path) for name in WRITES if (path := getattr(options, name))]
    paths = [path for path in given if not is_device(path)]
    if not paths:
        return None
    with contextlib.suppress(InputError):
        return PendingFile(paths[0].with_name(f"{paths[0].stem}.report.html"))
    return None


def _write(
    sim: Simulation,
    file: PendingFile | None,
    words: Sequence[str],
    options: RunOptions,
    failure: SimulationFailure | None,
) -> None:
    from taichi_cloth.post_mortem import page
    from taichi_cloth.post_mortem.examine import examine
    from taichi_cloth.ui import showing

    draw = None if file is None else partial(showing.picture, sim)
    untried = "" if options.survivors else UNTRIED
    try:
        with signals.raising() if failure else contextlib.nullcontext():  # which may take minutes
            found: PostMortem = examine(sim, words=words, draw=draw, untried=untried)
        if file is not None:
            page.write(found, file)
        _explain(found)
    finally:
        if file is not None:
            file.discard()
    if options.quiet:
        return
    if failure is not None:
        kind = "cause" if found.cause.numerical else "cause, not numerics"
        print(f"{kind}: {found.line}")
    if file is not None:
        print(f"report: {file.path}", flush=True)
