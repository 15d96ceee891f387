"""The command ``taichi-cloth trade SCENE``: error beside cost, as files, a table and a plot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from taichi_cloth import console
from taichi_cloth.advice.choice import TimeOver
from taichi_cloth.advice.horizon import say_horizon
from taichi_cloth.advice.judges import Judges
from taichi_cloth.error_meter.window import LEAST
from taichi_cloth.errors import counted
from taichi_cloth.files.names import name_for_file
from taichi_cloth.files.pending import folder_of_results
from taichi_cloth.scene.source import SceneSource
from taichi_cloth.settings.sweeps import TradeOptions
from taichi_cloth.sweeps.cluster import connected
from taichi_cloth.sweeps.identity import of_scene
from taichi_cloth.sweeps.journal import Journal, kept
from taichi_cloth.trade import command, reference, report, rows
from taichi_cloth.trade.outcomes import Outcome, Result
from taichi_cloth.trade.seconds import SECOND, Second
from taichi_cloth.trade.settings import Setting, unplanned

RUNS = 0.6  # of the time there is: what the runs and their references may take


def main(source: SceneSource, options: TradeOptions) -> int:
    """Measure, write the files, print the table; the exit status."""
    scene, chosen, how = command.prepare(source, options)
    frames = options.frames or reference.default_frames(scene)
    folder = Path(options.output or f"trade-{name_for_file(scene.name, 'scene')}")
    known = of_scene("trade", source, options, scene, options.times_on)
    with (
        folder_of_results(folder, command.FILES),
        connected(options.on, options.times_on) as elsewhere,
        kept(folder, known, options.resume, within=how.clock.seconds) as journal,
    ):
        say_horizon(frames)
        chosen, how = command.planned(scene, options, chosen, how, journal)
        runs = replace(how, clock=how.clock.part(RUNS), whole=True) if frames > SECOND else how
        with command.measured(source, options, scene, chosen, runs, journal, elsewhere) as result:
            result.check_some(how.clock)
            if not result.outcomes:
                # Before anything was finished.
                raise result.interrupted or KeyboardInterrupt
            result.clock = how.clock
            if how.clock.limited and not result.interrupted:
                result.left_out += unplanned(scene, options, set(chosen))
            seconds = _judged(result, journal)
            words = command.run_words(source, how)
            made = rows.rows_of(result, command.common(scene), words, seconds)
        written = command.write(folder, source, options, result, made)
        _show(folder, written, result, made, len(chosen))
        if result.interrupted:
            raise result.interrupted
        result.check_whole()
    return 0


def _judged(result: Result, journal: Journal) -> dict[Setting, list[Second]] | None:
    """The seconds of all settings, the cheapest first, as long as there is time.

    None where the reference covers the one second there is: the trajectory error is that second's.
    """
    horizon, frames = result.horizon, result.frames or 0
    covered = result.reference and horizon and horizon.frames == frames <= SECOND
    runs = [outcome for outcome in result.outcomes if outcome.ok and outcome.seconds]
    seconds: dict[Setting, list[Second]] = {}
    if covered or frames < LEAST:
        return None
    if result.interrupted:
        return seconds
    runs.sort(key=_median)
    with Judges(journal) as judges, command.progress() as tell:
        try:
            for number, outcome in enumerate(runs):
                tell(f"seconds of {outcome.setting.describe()}", number, len(runs))
                found = judges.seconds(result.scene, outcome, result.clock, thorough=False)
                seconds[outcome.setting] = found
            tell("all seconds are judged", len(runs), len(runs))
        except TimeOver:
            late = counted(len(runs) - len(seconds), "setting")
            result.left_out.append(f"the errors of {late}, the slowest ones")
        except KeyboardInterrupt as interrupt:
            result.interrupted = interrupt
    return seconds


def _median(outcome: Outcome) -> float:
    return sorted(outcome.seconds)[len(outcome.seconds) // 2]


def _show(
    folder: Path,
    written: Sequence[str],
    result: Result,
    made: Sequence[rows.Row],
    chosen: int,
) -> None:
    """Print the table, what was written, and what to take; chosen: settings asked for."""
    to = console.output()
    report.show(result, made, to)
    console.say(to, f"written: {folder}/ {', '.join(written)}")
    if result.interrupted:
        finished = f"{len(made)} of {chosen} settings were finished, and are kept"
        console.say(to, f"interrupted: {finished}")
    report.show_front(result, made, to)
