"""Words of ``--beside``: the settings in which a second run of a scene differs from the first."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from taichi_cloth.errors import InputError, clipped, nearest
from taichi_cloth.settings.options import MOST_SUBSTEPS, PROGRAM, RunOptions, flag, parameters_of
from taichi_cloth.settings.parameters import number_of

if TYPE_CHECKING:
    from taichi_cloth.simulation.live import Setting, Value

NONE = "none"  # for --beside, where a log says otherwise: there is no second run
# Of the options of a run, those that two runs in one process may have of their own.
OF_RUN = ("method", "dt", "substeps", "tolerance", "iterations", "topology", "execution")
# Those that they cannot, since Taichi has them once in a process.
OF_PROCESS = ("precision", "arch", "threads", "fast_math")
ON, OFF = ("on", "true", "yes"), ("off", "false", "no")


@dataclass(frozen=True)
class Given:
    """The settings of a second run that are not the first one's.

    run: options by name (`OF_RUN`), of which dt is the longest that a step may be, or "auto".
    scene: the texts of settings of `simulation.live`, by name.
    """

    run: Mapping[str, Any] = field(default_factory=dict)
    scene: Mapping[str, str] = field(default_factory=dict)

    def __str__(self) -> str:
        """As one writes it."""
        return ",".join(
            f"{name}={value}" for name, value in [*self.run.items(), *self.scene.items()]
        )


def read(text: str) -> Given:
    """Read a text such as 'method=rk4,substeps=8'. Raises InputError in one line.

    The names and values of a scene's settings are looked at with the scene (`value_of`).
    """
    declared, of_run, of_scene = parameters_of(RunOptions), {}, {}
    for part in text.split(","):
        name, equals, value = (word.strip() for word in part.partition("="))
        if not (name and equals and value):
            raise InputError(
                f"--beside: '{clipped(part)}' is no KEY=VALUE; give such as method=rk4,substeps=8"
            )
        if name in of_run or name in of_scene:
            raise InputError(f"--beside: {name} is given twice")
        if name in OF_RUN:
            of_run[name] = declared[name].parse(f"--beside {name}", value)
        elif name in OF_PROCESS:
            raise InputError(_of_process(name, clipped(value)))
        elif name in declared:
            raise InputError(f"--beside {name}: both runs share it; give {flag(name)}")
        else:
            of_scene[name] = value
    if {"dt", "substeps"} <= of_run.keys():
        raise InputError(
            "--beside: dt and substeps exclude each other: both say how long steps are"
        )
    _check_method(of_run.get("method"))
    return Given(of_run, of_scene)


def _of_process(name: str, value: str) -> str:
    """Why two runs in one process cannot differ in an option, and what can be done instead."""
    what = name.replace("_", " ")
    said = (
        f"--beside {name}: both runs share one Taichi runtime, which has one {what} from its start"
    )
    if name != "precision":
        return said
    again = f"{PROGRAM} compare --events FILE.jsonl --precision {value}"
    return f"{said}; --record the session, then {again}"


def _check_method(name: str | None) -> None:
    from taichi_cloth.kernels.methods import METHODS

    if name is not None and name not in METHODS:
        raise InputError(f"--beside method: unknown method '{name}'; {nearest(name, METHODS)}")


def steps_in(frame: float, longest: float) -> int:
    """The steps of a frame of some time if none may be longer than that."""
    steps = frame / longest
    if steps > MOST_SUBSTEPS:
        raise InputError(
            f"--beside dt={longest:g}: makes {steps:.3g} steps in each frame of {frame:g}; at most "
            f"{MOST_SUBSTEPS} can be"
        )
    return max(1, math.ceil(steps - 1e-9))


def options_of(first: RunOptions, given: Given, frame: float, taken: tuple[str, ...]) -> RunOptions:
    """The options of the second run, from those of the first.

    frame: the time of a frame of the first. taken: solver settings that the second's method takes.
    """
    from dataclasses import replace

    changes: dict[str, Any] = {
        name: given.run.get(name, getattr(first, name) if name in taken else None)
        for name in ("tolerance", "iterations")
    }
    changes |= {name: value for name, value in given.run.items() if name not in ("dt", "substeps")}
    if given.run.get("dt") == "auto":
        changes |= {"dt": "auto", "substeps": 1}
    elif "dt" in given.run:
        changes |= {"dt": frame, "substeps": steps_in(frame, given.run["dt"])}
    elif "substeps" in given.run:
        changes |= {"dt": frame, "substeps": given.run["substeps"]}
    return replace(first, **changes)


def value_of(setting: Setting, text: str) -> Value:
    """The value that a text gives to a scene's setting. Raises InputError if it is none."""
    from taichi_cloth.simulation import live

    word = text.lower()
    if setting.kind == live.FLAG:
        if word not in (*ON, *OFF):
            raise InputError(f"must be on or off, is '{clipped(text)}'")
        return word in ON
    if setting.kind == live.WORD:
        return setting.checked(text)
    if setting.optional and word in (NONE, *OFF):
        return None
    try:
        number = number_of(float, text)
    except ValueError:
        raise InputError(f"must be a number, is '{clipped(text)}'") from None
    if not math.isfinite(number):
        raise InputError(f"must be a finite number, is {text}")
    return setting.checked(number)
