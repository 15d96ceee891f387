"""The command ``taichi-cloth tune SCENE``: the setting that meets an error, or fits a frame's time.

It chooses from what a study ran, by the errors that the error meter has of its seconds, and
confirms the choice where it was not made: in later seconds, after another start.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import shlex
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from taichi_cloth import console
from taichi_cloth.advice import survey
from taichi_cloth.advice.choice import Choice, Figures, Target, is_measured
from taichi_cloth.advice.horizon import in_seconds, say_horizon
from taichi_cloth.advice.judges import Judges
from taichi_cloth.error_meter.window import LEAST
from taichi_cloth.errors import InputError, clipped, counted
from taichi_cloth.files.names import name_for_file
from taichi_cloth.files.pending import folder_of_results
from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.penetration import touches
from taichi_cloth.scene.solids import solids
from taichi_cloth.scene.source import SceneSource
from taichi_cloth.settings.options import PROGRAM
from taichi_cloth.settings.parameters import error_limit, positive
from taichi_cloth.settings.sweeps import TuneOptions
from taichi_cloth.sweeps.cluster import connected
from taichi_cloth.sweeps.identity import of_scene
from taichi_cloth.sweeps.journal import Journal, kept
from taichi_cloth.sweeps.tasks import Elsewhere
from taichi_cloth.sweeps.within import Clock, rounded_up, said_of_left_out
from taichi_cloth.trade import command, reference, rows, settings
from taichi_cloth.trade.conditions import RunConditions
from taichi_cloth.trade.errors import touches_anything
from taichi_cloth.trade.outcomes import Outcome, Result
from taichi_cloth.trade.rows import Row
from taichi_cloth.trade.seconds import SECOND
from taichi_cloth.trade.settings import Setting

# Speeds that the confirming run begins with besides its own, in parts of the speeds that the
# scene has by itself (root of the mean square).
KICK = 0.1
# Of the time there is: until when a survey goes on, and the runs that are chosen from.
SURVEY, RUNS = 0.4, 0.6
ROWS = 2  # settings that are judged whole, about, until one meets the target
CONFIRMS = 4  # times a run: twice as many frames, which are timed, too
CHOICE = 0.8  # the same with judging them, before the choice is confirmed
BATCH = 3  # times as many as were tried before are confirmed beside each other
FAR = 1.5  # times what is wanted: an error that is expected to be so is not confirmed
UNTRIED = "the confirmation of"  # how the line begins that says that there was no time for some
MOST_TOLD = 8  # of those that did not hold
TIME_UNITS = {"us": 1e-6, "µs": 1e-6, "ms": 1e-3, "s": 1.0}
LENGTH_UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}  # where a scene is in metres


@dataclass(frozen=True)
class Attempt:
    """A setting that met the target, and whether it held where it was not chosen.

    row: of the study that it was chosen from; confirming: of later seconds, after another start.
    """

    row: Row
    confirming: Row
    held: bool

    def describe(self) -> str:
        """The result of the confirming run."""
        if is_measured(self.confirming):
            return Figures.of(self.confirming).describe()
        return self.confirming.status if not self.confirming.ok else "its error is not known"


def main(source: SceneSource, options: TuneOptions) -> int:
    """Choose, confirm, print; the exit status."""
    asked = options.error, options.frame_time, options.penetration
    target = read_target(*asked, in_metres=None)
    scene, chosen, how = command.prepare(source, options)
    if target.penetration is not None:
        target = read_target(*asked, in_metres=bool(scene.world.up))
        if not touches(scene, solids(scene)):
            raise InputError(
                f"--penetration: there is nothing that particles of scene '{scene.name}' can touch"
            )
    folder = Path(options.output or f"tune-{name_for_file(scene.name, 'scene')}")
    known = of_scene("tune", source, options, scene, options.times_on)
    frames = options.frames or reference.default_frames(scene)
    if frames < LEAST:
        raise InputError(f"--frames {frames}: an error is told of {LEAST} frames and more")
    with (
        folder_of_results(folder, ()),
        connected(options.on, options.times_on) as elsewhere,
        kept(folder, known, options.resume, options.json, how.clock.seconds) as journal,
        Judges(journal, target.floor, how.clock.seconds) as judges,
    ):
        if not options.json:
            say_horizon(frames)
        chosen, how = command.planned(scene, options, chosen, how, journal)
        how = replace(how, solver_errors=False, references=False, whole=True)
        asked_for = replace(options, frames=frames)
        of = _Tuning(source, asked_for, scene, chosen, how, target, journal, elsewhere, judges)
        tried, left_out = of.tried()
    if options.json:
        told = _as_json(source, target, tried) | {"left_out": left_out}
        print(json.dumps(rows.finite(told), indent=1, allow_nan=False))
    else:
        _show(scene.name, target, tried, said_of_left_out(how.clock, left_out))
    if tried[-1].held:
        return 0
    what = "the only setting that meets it" if len(tried) == 1 else f"all {len(tried)} that meet it"
    if left_out and left_out[-1].startswith(UNTRIED):
        what = f"{counted(len(tried), 'setting')} that should meet it"
    said = f"{what} missed it in later seconds; {target.remedy()}"
    print(f"{PROGRAM}: {target.describe()}: {said}", file=sys.stderr)
    return 1


@dataclass(frozen=True)
class _Tuning:
    """A plan of a choice: its candidates, its goal, and its way.

    options: with the frames of the horizon.
    """

    source: SceneSource
    options: TuneOptions
    scene: Scene
    chosen: Sequence[Setting]
    how: RunConditions
    target: Target
    journal: Journal
    elsewhere: Elsewhere | None
    judges: Judges
    _runs: dict[Setting, Outcome] = field(default_factory=dict)

    @property
    def _frames(self) -> int:
        assert self.options.frames
        return self.options.frames

    def tried(self) -> tuple[list[Attempt], list[str]]:
        """The settings that meet the target, as they were tried in later seconds, and what was left
        out, a line each.

        Raises InputError where none meets it.
        """
        tried: list[Attempt] = []
        rounds, passed = self._surveyed()
        for number, chosen in enumerate(rounds, 1):
            begin = self.how.clock.left()
            found, left_out, why = self._of_a_round(chosen)
            tried += found
            held, time_left = bool(tried) and tried[-1].held, self.how.clock.left()
            if held or self.how.clock.limited and time_left < begin - time_left:
                break
            if number < len(rounds) and not self.options.json:
                says = "none of these holds: far finer steps are tried"
                console.say(console.output(), says)
        if not tried:
            raise InputError(why)
        return tried, [*left_out, *passed]

    def _of_a_round(self, chosen: Sequence[Setting]) -> tuple[list[Attempt], list[str], str]:
        """The same of some settings, and why there is no advice where none meets the target."""
        clock = self.how.clock
        part = RUNS if clock.left() > (1 - RUNS) * clock.seconds else CHOICE
        runs = replace(self.how, clock=clock.part(part))
        with self._measured(self.options, self.scene, chosen, runs) as result:
            if self.judges.compiled and clock.limited and not result.outcomes:
                raise InputError(self._late("not one setting was finished", chosen))
            result.check_some(clock)
            if self.target.penetration is not None:
                _refuse_untouched(result, self.target)
            words = command.run_words(self.source, self.how)
            made = rows.rows_of(result, command.common(self.scene), words)
            self._runs.update((outcome.setting, outcome) for outcome in result.outcomes)
            choice = Choice(made, self.target, self._judged)
            tried = confirm(choice.candidates(), self.target, self._again, clock)
            left_out = list(result.left_out)
        if choice.late:
            left_out.append(f"judging {counted(choice.left, 'setting')}")
        if tried and not tried[-1].held and choice.left:
            left_out.append(f"{UNTRIED} up to {counted(choice.left, 'setting')}")
        return tried, left_out, "" if tried else self._no_advice(choice, chosen, left_out)

    def _surveyed(self) -> tuple[Sequence[Sequence[Setting]], list[str]]:
        """The settings that are worth running, in rounds of which each is run where none before
        holds, and what was left out, a line each.
        """
        clock, plan = self.how.clock, settings.unplanned
        trials = partial(survey.trials, self.chosen)
        if self.target.error is None or self.options.substeps or not trials([]):
            left_out = plan(self.scene, self.options, set(self.chosen)) if clock.limited else []
            return [self.chosen], left_out
        seconds = survey.looked_at(max(self._frames // SECOND, 1))
        found = self.judges.survey(
            self.scene, self.chosen[0].dt, seconds, trials, clock.part(SURVEY),
            error=self.target.error, relative=self.target.relative,
        )  # fmt: skip
        made = survey.Survey.of_seconds(found)
        short = clock.limited and not self.options.methods
        count = survey.ROUNDS if made.needs else 1
        rounds = [made.narrowed(self.chosen, short, again) for again in range(count)]
        if made.needs and not self.options.json:
            console.say(console.output(), f"survey: {made.describe()}", hang=2)
        passed = len(set(self.chosen) - set(rounds[0]))
        return rounds, [f"{counted(passed, 'setting')} that a survey passed over"] * bool(passed)

    @contextlib.contextmanager
    def _measured(
        self, options: TuneOptions, scene: Scene, chosen: Sequence[Setting], how: RunConditions
    ) -> Iterator[Result]:
        """The result of a study, whole."""
        given = self.source, options, scene, list(chosen), how, self.journal, self.elsewhere
        with command.measured(*given, closed=False, quiet=options.json) as result:
            if result.interrupted:
                raise result.interrupted
            result.check_whole()
            yield result

    def _judged(self, row: Row, count: int | None, fails: bool) -> Row:
        """A row with its seconds judged, as `Choice` asks for it."""
        seconds = self.judges.seconds(
            self.scene, self._runs[row.setting], self.how.clock.part(CHOICE), count=count,
            fails=self.target.refuses if fails else lambda second: False, thorough=count is None,
        )  # fmt: skip
        return replace(row, judged=seconds)

    def _again(self, some: Sequence[Row]) -> Iterator[Row]:
        """The same settings in as many later seconds after another start, one after the other."""
        other = kicked(self.scene, self._runs[some[0].setting].samples().v, self.options.seed)
        frames = min(2 * self._frames, reference.most_frames(other))
        options, whole = replace(self.options, frames=frames), replace(self.how, clock=Clock())
        with self._measured(options, other, [row.setting for row in some], whole) as result:
            runs = {outcome.setting: outcome for outcome in result.outcomes}
            for row in some:
                seconds = []
                if runs[row.setting].ok:
                    seconds = self.judges.seconds(
                        other, runs[row.setting], Clock(), begin=frames - self._frames,
                        fails=self.target.refuses,
                    )  # fmt: skip
                alone = replace(result, outcomes=[runs[row.setting]])
                judged = {row.setting: seconds}
                yield from rows.rows_of(alone, command.common(other), [], judged)

    def _no_advice(self, choice: Choice, chosen: Sequence[Setting], left_out: Sequence[str]) -> str:
        """Why there is no advice: nothing meets the target, or there was no time to see."""
        unrun = [setting for setting in chosen if setting not in self._runs]
        if not choice.late and not (self.how.clock.limited and unrun):
            return choice.refusal()
        of = counted(len(choice.usable), "setting")
        seen = f"{choice.judged} of {of} could be judged over {in_seconds(self._frames)}"
        if not choice.late:
            more = f"; {counted(len(unrun), 'more setting')} should do, and could not be run"
            seen = choice.refusal().partition(": ")[2] + more
        return self._late(seen, [] if choice.late else unrun)

    def _late(self, seen: str, unrun: Sequence[Setting]) -> str:
        """That there was no time, and the time that would do."""
        return (
            f"{self.target.describe()}: no advice within {self.how.clock.describe()}: {seen}; "
            f"use about --within {self._needed(unrun)}, or fewer --frames"
        )

    def _needed(self, unrun: Sequence[Setting]) -> str:
        """The time that would do, by what was measured until now: more settings are judged, or
        run and judged where these were `unrun`, and one is confirmed.
        """
        clock = self.how.clock
        each = max(self._frames // SECOND, 1) * self.judges.spent / max(self.judges.windows, 1)
        rates = [run.sampled_in / run.setting.substeps for run in self._runs.values() if run.ok]
        of = unrun or [setting for setting, run in self._runs.items() if run.ok]
        run = max(rates, default=0.0) * min((setting.substeps for setting in of), default=0)
        gone, more = CHOICE * clock.seconds, 0.0
        if unrun:
            gone, more = clock.seconds - clock.left(), 2 * run + self.judges.compiled
        runs, choice = RUNS * clock.seconds + more, gone + more + ROWS * each
        whole = choice + each + CONFIRMS * run + self.judges.compiled
        return rounded_up(max(runs / RUNS * bool(unrun), choice / CHOICE, whole))


def _refuse_untouched(result: Result, target: Target) -> None:
    """Refuse a penetration where nothing came to touch: every setting would keep to it."""
    runs = [outcome for outcome in result.outcomes if outcome.ok]
    if not runs or any(touches_anything(outcome.samples()) for outcome in runs):
        return
    frames = counted(result.frames or 0, "frame")
    raise InputError(
        f"{target.describe()}: nothing touches anything in the {frames} that are compared, so that "
        "no setting is known to keep to a penetration; compare more --frames"
    )


def confirm(
    candidates: Iterable[Row],
    target: Target,
    measure_again: Callable[[Sequence[Row]], Iterable[Row]],
    clock: Clock,
) -> list[Attempt]:
    """Try candidates where they were not chosen, up to the first that meets the target there, too,
    or while there is time for as many as were tried last.

    measure_again: the same rows there, one after the other. Each call compiles anew, so more and
    more rows share one. Passed over are those that miss it, too, if what failed is a measure of how
    much worse these seconds are.
    """
    tried: list[Attempt] = []
    left = (row for row in candidates if not (tried and _would_miss(row, tried, target)))
    took = 0.0
    while not (tried and clock.left() < took):
        batch = list(itertools.islice(left, max(1, BATCH * len(tried))))
        if not batch:
            break
        begin = clock.left()
        for row, found in zip(batch, measure_again(batch), strict=False):
            held = is_measured(found) and target.met_by(Figures.of(found))
            tried.append(Attempt(row, found, held))
            if held:
                return tried
        took = begin - clock.left() if clock.limited else 0.0
    return tried


def _would_miss(row: Row, failed: Sequence[Attempt], target: Target) -> bool:
    """True if a row's errors, by as much larger as those of all that failed, miss by far."""
    expected = row.told()[1]
    if target.error is None or not target.relative or expected is None:
        return False
    known = [(one.row.told()[1], one.confirming.told()[1]) for one in failed]
    return all(
        bool(here and there) and expected * (there or 0.0) > FAR * target.error * (here or 1.0)
        for here, there in known
    )


def _show(scene: str, target: Target, tried: Sequence[Attempt], left_out: Sequence[str]) -> None:
    """Print what was chosen, what was expected and confirmed of it, what was not taken, what was
    left out, and, at the end, the command that uses the choice.
    """
    to, last = console.output(), tried[-1]
    failed = [attempt for attempt in tried if not attempt.held]
    if last.held:
        console.say(to, f"{scene}, {target.describe()}: {last.row.setting.describe()}", hang=2)
        expected = f"{Figures.of(last.row).describe()}, over {in_seconds(last.row.frames or 0)}"
        console.say(to, f"expected:  {expected}", hang=11)
        console.say(to, f"confirmed: yes: {last.describe()}, later and from another start", hang=11)
    else:
        says = "no setting that meets it holds in later seconds"
        console.say(to, f"{scene}, {target.describe()}: {says}", hang=2)
    if failed:
        console.say(to, f"not confirmed{', so not taken' * last.held}:")
    for attempt in failed[:MOST_TOLD]:
        setting, expected = attempt.row.setting.describe(), Figures.of(attempt.row).describe()
        console.say(to, f"- {setting}: {attempt.describe()}; expected {expected}", hang=2)
    if len(failed) > MOST_TOLD:
        console.say(to, f"- and {len(failed) - MOST_TOLD} more, which --json lists")
    for line in left_out:
        console.say(to, line, hang=2)
    if last.held:
        console.say_command(to, last.row.command)


def read_target(
    error: str | None,
    frame_time: str | None,
    penetration: str | None = None,
    in_metres: bool | None = True,
) -> Target:
    """The target that the command line gives; raises InputError unless it is one.

    in_metres: whether lengths of the scene are metres, so that one may have a unit; None: that is
    not known yet.
    """
    if (error is None) == (frame_time is None) and (error is not None or penetration is None):
        raise InputError(
            "tune: give either --error, such as 1%, or --frame-time, such as 8ms, or --penetration"
        )
    deepest = None if penetration is None else _read_length(penetration, in_metres)
    if error is not None:
        value, relative = error_limit("--error", error)
        return Target(error=value, relative=relative, penetration=deepest)
    if frame_time is not None:
        return Target(frame_seconds=_read_time(frame_time), penetration=deepest)
    return Target(penetration=deepest)


def _read_length(given: str, in_metres: bool | None) -> float:
    text = given.strip()
    unit = next((unit for unit in LENGTH_UNITS if text.endswith(unit)), None)
    says = "a length of the scene, or one with m, cm or mm, such as 1mm"
    if unit is None:
        return positive("--penetration", text, says, given)
    length = positive("--penetration", text.removesuffix(unit), says, given)
    if in_metres is False:
        raise InputError(
            f"--penetration: '{clipped(given)}' has a unit, and this scene's lengths have none, "
            'as its [world] has no up = "y"; give a number'
        )
    return length * LENGTH_UNITS[unit]


def _read_time(frame_time: str) -> float:
    text = frame_time.strip()
    unit = next((unit for unit in TIME_UNITS if text.endswith(unit)), None)
    says = "a time with its unit, s, ms or us, such as 8ms"
    if unit is None:
        raise InputError(f"--frame-time must be {says}; is '{clipped(frame_time)}'")
    return positive("--frame-time", text.removesuffix(unit), says, frame_time) * TIME_UNITS[unit]


def kicked(scene: Scene, v: np.ndarray, seed: int) -> Scene:
    """The scene with another start: its free particles get random velocities besides.

    v: the velocities of a run of the scene, (frames + 1, n, dim), which say how fast is usual.
    """
    free = ~scene.particles.fixed
    usual = float(np.sqrt((v[:, free] ** 2).sum(axis=2).mean()))
    rng = np.random.default_rng(seed)
    kick = rng.normal(size=scene.particles.velocity.shape) / np.sqrt(scene.world.dim)
    kick[~free] = 0.0
    velocity = scene.particles.velocity + KICK * usual * kick
    return replace(scene, particles=replace(scene.particles, velocity=velocity))


def _as_json(source: SceneSource, target: Target, tried: Sequence[Attempt]) -> dict[str, Any]:
    """The result of a choice, nulls where nothing held, and all that was tried for it."""
    last = tried[-1]
    row = last.row
    told = [_attempt_as_json(attempt) for attempt in tried]
    chosen = {name: told[-1][name] for name in ("setting", "command")}
    expected: dict[str, Any] = told[-1]["expected"]
    return {
        "scene": shlex.join(source.words()),
        "target": vars(target),
        **(chosen if last.held else dict.fromkeys(chosen)),
        "frames": row.frames,
        "expected": expected if last.held else None,
        "confirmed": told[-1]["confirmed"] if last.held else {"held": False},
        "scene_hash": row.scene_hash,
        "versions": row.versions,
        "device": row.device if last.held else None,
        "tried": told,
    }


def _attempt_as_json(attempt: Attempt) -> dict[str, Any]:
    row, confirming = attempt.row, attempt.confirming
    figures = vars(Figures.of(confirming)) if is_measured(confirming) else {}
    return {
        "setting": vars(row.setting),
        "command": row.command,
        "expected": vars(Figures.of(row)),
        "confirmed": {"held": attempt.held, "status": confirming.status}
        | figures
        | {"frames": confirming.frames},
    }
