"""The command ``taichi-cloth tune SCENE``: the setting that meets an error, or fits a frame's time.

It chooses from what a study measured, and confirms the choice where it was not made: on the scene
with another start.
"""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from taichi_cloth import console
from taichi_cloth.console import duration
from taichi_cloth.errors import InputError, RunFailure, clipped, counted
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
from taichi_cloth.sweeps.within import Clock, said_of_left_out
from taichi_cloth.trade import command, rows
from taichi_cloth.trade.conditions import RunConditions
from taichi_cloth.trade.errors import touches_anything
from taichi_cloth.trade.outcomes import Result
from taichi_cloth.trade.rows import Row
from taichi_cloth.trade.settings import Setting

# Speeds that the confirming run begins with besides its own, in parts of the speeds that the
# scene has by itself (root of the mean square).
KICK = 0.1
CHOICE = 0.6  # of the time there is: what choosing may take, before the choice is confirmed
BATCH = 3  # times as many as were tried before are confirmed beside each other
UNTRIED = "the confirmation of"  # how the line begins that says that there was no time for some
MOST_TOLD = 8  # of those that did not hold
TIME_UNITS = {"us": 1e-6, "µs": 1e-6, "ms": 1e-3, "s": 1.0}
LENGTH_UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}  # where a scene is in metres


@dataclass(frozen=True)
class Target:
    """What is wanted: a trajectory error, a frame's time in seconds, or neither; a penetration,
    alone or besides.

    error: in world units, or in parts of the largest displacement where `relative`. penetration:
    the deepest one that is allowed, in world units.
    """

    error: float | None = None
    relative: bool = True
    frame_seconds: float | None = None
    penetration: float | None = None

    def describe(self) -> str:
        words = []
        if self.frame_seconds is not None:
            words.append(f"--frame-time {duration(self.frame_seconds)}")
        if self.error is not None:
            shown = f"{100 * self.error:g} %" if self.relative else f"{self.error:g}"
            words.append(f"--error {shown}")
        if self.penetration is not None:
            words.append(f"--penetration {self.penetration:g}")
        return " ".join(words)

    def remedy(self) -> str:
        """What to ask for where nothing holds."""
        if self.frame_seconds is not None:
            return "ask for a longer --frame-time, or measure while the machine does nothing else"
        larger = "--error" if self.error is not None else "--penetration"
        return f"compare more --substeps or other --methods, or ask for a larger {larger}"

    def met_by(self, found: Figures) -> bool:
        if self.frame_seconds is not None and found.frame_seconds > self.frame_seconds:
            return False
        if self.error is not None:
            error = found.error_relative if self.relative else found.error
            if error > self.error:
                return False
        return self.penetration is None or found.is_within(self.penetration)


@dataclass(frozen=True)
class Figures:
    """What a setting showed: its trajectory error (world units, and in parts of the largest
    displacement), or the least that the reference can tell from none; a frame's time in seconds;
    its deepest penetration (world units), None where nothing can touch.
    """

    error: float
    error_relative: float
    frame_seconds: float
    penetration: float | None = None

    @classmethod
    def of(cls, row: Row) -> Figures:
        """The figures of a row that was timed and has an error."""
        error, relative = row.told()
        frame_seconds = row.a_frame(row.wall_seconds)
        assert error is not None and relative is not None and frame_seconds is not None
        return cls(error, relative, frame_seconds, row.penetration_max)

    def is_within(self, penetration: float) -> bool:
        """Whether its deepest penetration is at most this."""
        return self.penetration is not None and self.penetration <= penetration

    def describe(self) -> str:
        percent = 100 * self.error_relative
        a_frame = duration(self.frame_seconds)
        deep = "" if self.penetration is None else f", penetration {self.penetration:.3g}"
        return f"error {percent:.3g} % ({self.error:.3g}), {a_frame} a frame{deep}"


@dataclass(frozen=True)
class Attempt:
    """A setting that met the target, and whether it held where it was not chosen.

    row: of the study that it was chosen from; confirming: of the scene with another start.
    """

    row: Row
    confirming: Row
    held: bool

    def describe(self) -> str:
        """What the confirming run showed."""
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
    with (
        folder_of_results(folder, ()),
        connected(options.on, options.times_on) as elsewhere,
        kept(folder, known, options.resume, options.json, how.clock.seconds) as journal,
    ):
        chosen, how = command.planned(scene, options, chosen, how, journal)
        how = replace(how, solver_errors=False)
        tried, left_out = _tried(source, options, scene, chosen, how, target, journal, elsewhere)
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
    said = f"{what} missed it from another start; {target.remedy()}"
    print(f"{PROGRAM}: {target.describe()}: {said}", file=sys.stderr)
    return 1


def _tried(
    source: SceneSource,
    options: TuneOptions,
    scene: Scene,
    chosen: list[Setting],
    how: RunConditions,
    target: Target,
    journal: Journal,
    elsewhere: Elsewhere | None,
) -> tuple[list[Attempt], list[str]]:
    """The settings that meet the target, as they were tried from another start, and what was left
    out, a line each.

    Raises InputError where none meets it.
    """
    quiet, choice = options.json, replace(how, clock=how.clock.part(CHOICE))
    with command.measured(
        source, options, scene, chosen, choice, journal, elsewhere, quiet=quiet
    ) as result:
        if result.interrupted:
            raise result.interrupted
        result.check_whole()
        result.check_some(how.clock)
        if not (result.reference and result.horizon):
            raise RunFailure(
                f"{scene.name}: there is no reference to compare with; use fewer --frames"
            )
        if target.penetration is not None:
            _refuse_untouched(result, target, options)
        made = rows.rows_of(result, command.common(scene), command.run_words(source, how))
        try:
            candidates = meeting(made, target)
        except InputError as none:
            if not result.left_out:
                raise
            raise InputError(f"{none}; what --within left out may do better") from None
        other = kicked(scene, result.reference.samples.v, options.seed)
    again_options = replace(options, frames=result.horizon.asked)
    whole = replace(how, clock=Clock())  # a confirmation is whole, or none

    def measure_again(some: Sequence[Setting]) -> list[Row]:
        of = source, again_options, other, list(some), whole, journal, elsewhere, False, quiet
        with command.measured(*of) as again:
            if again.interrupted:
                raise again.interrupted
            again.check_whole()
            return rows.rows_of(again, command.common(other), [])

    tried = confirm(candidates, target, measure_again, how.clock)
    untried = 0 if tried[-1].held else len(candidates) - len(tried)
    said = [f"{UNTRIED} {counted(untried, 'setting')} that should meet it"] * (untried > 0)
    return tried, result.left_out + said


def _refuse_untouched(result: Result, target: Target, options: TuneOptions) -> None:
    """Refuse a penetration where nothing came to touch: every setting would keep to it."""
    runs = [outcome for outcome in result.outcomes if outcome.ok]
    if not runs or any(touches_anything(outcome.samples()) for outcome in runs):
        return
    assert result.horizon
    frames = counted(result.horizon.frames, "frame")
    more = "more --frames" if options.frames or not result.clock.limited else "--within more time"
    raise InputError(
        f"{target.describe()}: nothing touches anything in the {frames} that are compared, so that "
        f"no setting is known to keep to a penetration; compare {more}"
    )


def confirm(
    candidates: Sequence[Row],
    target: Target,
    measure_again: Callable[[list[Setting]], list[Row]],
    clock: Clock,
) -> list[Attempt]:
    """Try candidates from another start, up to the first that meets the target there, too, or while
    there is time for as many as were tried last.

    measure_again: rows of settings from that start. Each call computes a reference, so more and
    more settings share one.
    """
    tried: list[Attempt] = []
    took = 0.0
    while len(tried) < len(candidates) and not (tried and clock.left() < took):
        begin = clock.left()
        batch = candidates[len(tried) :][: max(1, BATCH * len(tried))]
        again = {row.setting: row for row in measure_again([row.setting for row in batch])}
        took = begin - clock.left() if clock.limited else 0.0
        for row in batch:
            found = again[row.setting]
            held = is_measured(found) and target.met_by(Figures.of(found))
            tried.append(Attempt(row, found, held))
            if held:
                return tried
    return tried


def _show(scene: str, target: Target, tried: Sequence[Attempt], left_out: Sequence[str]) -> None:
    """Print what was chosen, what was expected and confirmed of it, what was not taken, what was
    left out, and, at the end, the command that uses the choice.
    """
    to, last = console.output(), tried[-1]
    failed = [attempt for attempt in tried if not attempt.held]
    if last.held:
        console.say(to, f"{scene}, {target.describe()}: {last.row.setting.describe()}", hang=2)
        expected = f"{Figures.of(last.row).describe()}, over {last.row.frames} frames"
        console.say(to, f"expected:  {expected}", hang=11)
        console.say(to, f"confirmed: yes: {last.describe()}, from another start", hang=11)
    else:
        says = "no setting that meets it holds from another start"
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


def is_measured(row: Row) -> bool:
    """Whether it has figures."""
    return row.ok and row.error_trajectory is not None and row.wall_seconds is not None


def meeting(made: Sequence[Row], target: Target) -> list[Row]:
    """The rows that meet an error or a penetration, the cheapest first; those that fit a time, the
    best first.

    A row fits a time by the upper quartile of its own. Raises InputError, with the best there is,
    where none does.
    """
    usable = [row for row in made if is_measured(row)]
    if not usable:
        why = next((f"{r.setting.describe()}: {r.status}" for r in made if not r.ok), "")
        first = f"; the first: {why}" if why else ""
        raise InputError(f"{target.describe()}: no setting could be measured{first}")
    found = [row for row in usable if target.met_by(Figures.of(row))]
    by_time = target.frame_seconds is not None
    if by_time:
        found = [row for row in found if _slow_frame(row) <= (target.frame_seconds or 0.0)]
    order = _error_then_time if by_time else _time_then_error
    if not found:
        best = _best(usable, target)
        raise InputError(
            f"{target.describe()}: none of {len(usable)} settings meets it; the best is "
            f"{best.setting.describe()}: {Figures.of(best).describe()}"
        )
    return sorted(found, key=order)


def _best(usable: Sequence[Row], target: Target) -> Row:
    """The row that comes nearest to a target that none meets."""
    within = usable
    if target.penetration is not None:
        least = min(Figures.of(row).penetration or 0.0 for row in usable)
        most = max(least, target.penetration)
        within = [row for row in usable if Figures.of(row).is_within(most)]
    return min(within, key=_slow_frame if target.frame_seconds is not None else _error_then_time)


def _slow_frame(row: Row) -> float:
    """The upper quartile of a frame's seconds."""
    seconds = row.a_frame(row.wall_upper)
    return np.inf if seconds is None else seconds


def _error_then_time(row: Row) -> tuple[float, float]:
    """Errors that the reference cannot tell from none are alike."""
    found = Figures.of(row)
    return 0.0 if row.below_floor else found.error, found.frame_seconds


def _time_then_error(row: Row) -> tuple[float, float]:
    """The error as it came out, also where the reference cannot tell it from none."""
    return Figures.of(row).frame_seconds, row.error_trajectory or 0.0


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
    """What was chosen, nulls where nothing held, and all that was tried for it."""
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
