"""The command ``taichi-cloth tune SCENE``: the setting that meets an error, or fits a frame's time.

It chooses from what a study measured, and confirms the choice where it was not made: on the scene
with another start.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from taichi_cloth import console
from taichi_cloth.console import duration
from taichi_cloth.errors import InputError, clipped
from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.source import SceneSource
from taichi_cloth.settings.options import TuneOptions, number_of
from taichi_cloth.trade import command, rows
from taichi_cloth.trade.rows import Row

# Speeds that the confirming run begins with besides its own, in parts of the speeds that the
# scene has by itself (root of the mean square).
KICK = 0.1
TIME_UNITS = {"us": 1e-6, "µs": 1e-6, "ms": 1e-3, "s": 1.0}


@dataclass(frozen=True)
class Target:
    """What is wanted: a trajectory error or, where `error` is None, a frame's time in seconds.

    error: in world units, or in parts of the largest displacement where `relative`.
    """

    error: float | None = None
    relative: bool = True
    frame_seconds: float | None = None

    def describe(self) -> str:
        if self.frame_seconds is not None:
            return f"--frame-time {duration(self.frame_seconds)}"
        assert self.error is not None
        shown = f"{100 * self.error:g} %" if self.relative else f"{self.error:g}"
        return f"--error {shown}"

    def met_by(self, found: Figures) -> bool:
        if self.frame_seconds is not None:
            return found.frame_seconds <= self.frame_seconds
        assert self.error is not None
        return (found.error_relative if self.relative else found.error) <= self.error


@dataclass(frozen=True)
class Figures:
    """What a setting showed: its trajectory error (world units, and in parts of the largest
    displacement), or the least that the reference can tell from none; a frame's time in seconds.
    """

    error: float
    error_relative: float
    frame_seconds: float

    @classmethod
    def of(cls, row: Row) -> Figures:
        """The figures of a row that was timed and has an error."""
        error, relative = row.error_trajectory, row.error_trajectory_relative
        if row.below_floor and row.floor is not None and row.scale:
            error, relative = row.floor, row.floor / row.scale
        frame_seconds = row.a_frame(row.wall_seconds)
        assert error is not None and relative is not None and frame_seconds is not None
        return cls(error, relative, frame_seconds)

    def describe(self) -> str:
        percent = 100 * self.error_relative
        a_frame = duration(self.frame_seconds)
        return f"error {percent:.3g} % ({self.error:.3g}), {a_frame} a frame"


def main(source: SceneSource, options: TuneOptions) -> int:
    """Choose, confirm, print; the exit status."""
    target = read_target(options.error, options.frame_time)
    scene, chosen, how = command.prepare(source, options)
    how = replace(how, solver_errors=False)
    quiet = options.json
    with command.measured(source, options, scene, chosen, how, quiet=quiet) as result:
        if result.interrupted:
            raise KeyboardInterrupt
        assert result.reference and result.horizon  # it went to its end
        made = rows.rows_of(result, command.common(scene), command.run_words(source, how))
        best = choose(made, target)
        other = kicked(scene, result.reference.samples.v, options.seed)
    options = replace(options, frames=result.horizon.asked)
    with command.measured(source, options, other, [best.setting], how, False, quiet) as again:
        if again.interrupted:
            raise KeyboardInterrupt
        (confirming,) = rows.rows_of(again, command.common(other), [])
    expected = Figures.of(best)
    confirmed = Figures.of(confirming) if confirming.wall_seconds else None
    held = confirmed is not None and target.met_by(confirmed)
    if quiet:
        print(json.dumps(_as_json(source, target, best, expected, confirming, held), indent=1))
        return 0
    to = console.output(170)
    said = "yes" if held else "no"
    shown = confirmed.describe() if confirmed else confirming.status
    for line in (
        f"{scene.name}, {target.describe()}: {best.setting.describe()}",
        f"expected:  {expected.describe()}, over {best.frames} frames",
        f"confirmed: {said}: {shown}, from another start",
    ):
        to.print(line, highlight=False, markup=False, soft_wrap=True)
    to.print(best.command, highlight=False, markup=False, soft_wrap=True)
    return 0


def read_target(error: str | None, frame_time: str | None) -> Target:
    """The target that the command line gives; raises InputError unless it is one."""
    if (error is None) == (frame_time is None):
        raise InputError("tune: give either --error, such as 1%, or --frame-time, such as 8ms")
    if error is not None:
        number = error.strip().removesuffix("%")
        relative = number != error.strip()
        value = _positive("--error", number, "a number, or one with %, such as 1%", error)
        return Target(error=value / 100 if relative else value, relative=relative)
    assert frame_time is not None
    text = frame_time.strip()
    unit = next((unit for unit in TIME_UNITS if text.endswith(unit)), None)
    says = "a time with its unit, s, ms or us, such as 8ms"
    if unit is None:
        raise InputError(f"--frame-time must be {says}; is '{clipped(frame_time)}'")
    seconds = _positive("--frame-time", text.removesuffix(unit), says, frame_time)
    return Target(frame_seconds=seconds * TIME_UNITS[unit])


def _positive(flag: str, text: str, says: str, given: str) -> float:
    try:
        number = number_of(float, text.strip())
    except ValueError:
        number = np.nan
    if not 0 < number < np.inf:
        raise InputError(f"{flag} must be {says}; is '{clipped(given)}'")
    return number


def choose(made: Sequence[Row], target: Target) -> Row:
    """The cheapest row that meets an error; the most accurate one that fits a time.

    A row fits a time by the upper quartile of its own. Raises InputError, with the best there is,
    where none does.
    """
    usable = [row for row in made if row.ok and row.error_trajectory is not None]
    usable = [row for row in usable if row.wall_seconds is not None]
    if not usable:
        raise InputError(f"{target.describe()}: no setting could be measured")
    if target.frame_seconds is not None:
        meeting = [row for row in usable if _slow_frame(row) <= target.frame_seconds]
        best = min(usable, key=_slow_frame)
        order = _error_then_time
    else:
        meeting = [row for row in usable if target.met_by(Figures.of(row))]
        best = min(usable, key=_error_then_time)
        order = _time_then_error
    if not meeting:
        raise InputError(
            f"{target.describe()}: none of {len(usable)} settings meets it; the best is "
            f"{best.setting.describe()}: {Figures.of(best).describe()}"
        )
    return min(meeting, key=order)


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


def _as_json(
    source: SceneSource, target: Target, best: Row, expected: Figures, confirming: Row, held: bool
) -> dict[str, Any]:
    done = confirming.wall_seconds is not None
    return {
        "scene": shlex.join(source.words()),
        "target": vars(target),
        "setting": vars(best.setting),
        "command": best.command,
        "frames": best.frames,
        "expected": vars(expected),
        "confirmed": {"held": held, "status": confirming.status}
        | (vars(Figures.of(confirming)) if done else {})
        | {"frames": confirming.frames},
        "scene_hash": best.scene_hash,
        "versions": best.versions,
        "device": best.device,
    }
