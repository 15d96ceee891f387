"""How often a choice that `tune` makes holds, on many variants of scenes:

    python -m taichi_cloth.benchmarks.confirmation [VARIANTS]

Each variant has other stiffness, masses, drag, gravity and speeds at the start. For each, and for
some errors to meet and times to fit, it chooses as `tune` does, and looks whether the choice holds
from another start (`tune.kicked`).
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from taichi_cloth.errors import InputError
from taichi_cloth.scene import library
from taichi_cloth.scene.model import Scene
from taichi_cloth.settings.sweeps import TuneOptions
from taichi_cloth.sweeps.within import Clock
from taichi_cloth.trade import command, ode, rows, runner, settings
from taichi_cloth.trade.conditions import conditions, without_mouse
from taichi_cloth.trade.settings import Setting
from taichi_cloth.trade.tune import Figures, Target, is_measured, kicked, meeting

FRAMES = 24
VARIANTS = 40
# What is varied: one scene for each way of compiling. Variants of one share its kernels.
BASES: tuple[tuple[str, dict[str, Any]], ...] = (
    ("cloth", {"columns": 8, "rows": 6}),
    ("cloth", {"columns": 10, "rows": 8, "shear": 0.2, "bend": 0.1}),
    ("cloth", {"columns": 9, "rows": 9, "shear": 0.2, "damping": 0.05}),
    ("chain", {"particles": 12}),
)
ERRORS = (0.01, 0.001, 0.0001)  # in parts of the largest displacement
TIMES = (1.5, 4.0, 10.0)  # times the frame time of the fastest setting


@dataclass
class Count:
    """Choices that were made, and held."""

    made: int = 0
    held: int = 0

    def describe(self) -> str:
        part = 100.0 * self.held / self.made if self.made else 0.0
        return f"{self.held} of {self.made} ({part:.0f} %)"


def main(arguments: Sequence[str]) -> int:
    """Measure and print the two rates."""
    os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")
    parser = argparse.ArgumentParser(prog="python -m taichi_cloth.benchmarks.confirmation")
    parser.description = "How often a setting that `tune` chooses holds where it was not chosen."
    parser.add_argument("variants", nargs="?", type=int, default=VARIANTS, help="of all scenes")
    wanted = parser.parse_args(arguments).variants
    errors, times, variants = Count(), Count(), 0
    for number, (name, parameters) in enumerate(BASES):
        each = [wanted // len(BASES) + (k < wanted % len(BASES)) for k in range(len(BASES))]
        found = list(varied(name, parameters, each[number], seed=number))
        if not found:
            continue
        for made, again in measured(found):
            variants += 1
            _judge(made, again, errors, times)
            print(f"{name} {parameters}: {errors.describe()}, {times.describe()}", flush=True)
    print(f"variants: {variants}")
    print(f"an error to meet: held in {errors.describe()}")
    print(f"a frame's time to fit: held in {times.describe()}")
    return 0


def varied(name: str, parameters: dict[str, Any], count: int, seed: int) -> Iterator[Scene]:
    """Variants of a built-in scene: numbers differ, features do not."""
    rng = np.random.default_rng(seed)
    base = without_mouse(library.build(name, **parameters))
    particles, springs = base.particles, base.springs
    for _ in range(count):
        shape = particles.velocity.shape
        speed = rng.normal(size=shape) * ~particles.fixed[:, None] * rng.uniform(0, 1)
        yield replace(
            base.with_world(gravity=tuple(rng.uniform(0.5, 2) * np.array(base.world.gravity))),
            particles=replace(
                particles,
                velocity=particles.velocity + speed,
                mass=particles.mass * rng.uniform(0.5, 2),
                viscous=particles.viscous * rng.uniform(0.2, 2),
            ),
            springs=replace(
                springs,
                stiffness=springs.stiffness * rng.uniform(0.3, 2),
                damping=springs.damping * rng.uniform(0.2, 2),
            ),
        )


def measured(variants: Sequence[Scene]) -> Iterator[tuple[list[rows.Row], dict[Setting, rows.Row]]]:
    """For each variant its rows, and, by setting, those of the same from another start."""
    options = TuneOptions(precisions="f32,f64", quick=True)
    chosen = settings.choose(variants[0], options)
    how = replace(conditions(variants[0], options), budget=0.03, patience=3.0, clock=Clock())
    how = replace(how, solver_errors=False)
    # How fast is usual is known after a run; before, by the start and gravity alone.
    others = [kicked(scene, _usual(scene), seed=1) for scene in variants]
    study = runner.Study([*variants, *others], chosen, FRAMES, how)
    try:
        with command.progress() as study.tell:
            results = study.run()
        made = [rows.rows_of(result, {}, []) for result in results]
    finally:
        study.close()
    for mine, again in zip(made[: len(variants)], made[len(variants) :], strict=True):
        yield mine, {row.setting: row for row in again}


def _usual(scene: Scene) -> np.ndarray:
    """Velocities of a run of the scene, by its smooth solution."""
    times = np.arange(FRAMES + 1) * scene.world.dt
    v = ode.solve(scene, times).v
    solved: np.ndarray = v[np.isfinite(v).all(axis=(1, 2))]
    return solved


def _judge(
    made: list[rows.Row], again: dict[Setting, rows.Row], errors: Count, times: Count
) -> None:
    """Choose for each target; count what holds."""
    fastest = min(seconds for row in made if (seconds := row.a_frame(row.wall_upper)))
    targets = [(Target(error=error), errors) for error in ERRORS]
    targets += [(Target(frame_seconds=factor * fastest), times) for factor in TIMES]
    for target, count in targets:
        try:
            best = meeting(made, target)[0]
        except InputError:
            continue  # nothing meets it: there is no choice to confirm
        other = again[best.setting]
        count.made += 1
        count.held += is_measured(other) and target.met_by(Figures.of(other))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
