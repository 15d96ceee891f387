"""Which kernels a run begins with: of eight or sixteen lanes, compiled soon or to run fast."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from taichi_cloth import runtime
from taichi_cloth.cli import run_beside
from taichi_cloth.errors import InputError
from taichi_cloth.measuring import machine
from taichi_cloth.settings.options import HEADLESS_FRAMES, RunOptions

if TYPE_CHECKING:
    from taichi_cloth.scene.model import Scene

EIGHT, SIXTEEN = "8", "16"
# Particles times steps of a run without a window, from which kernels that run faster gain more than
# they cost. Sixteen lanes gain 2 ns each, and take 0.2 to 0.3 s longer to read from the cache; on
# the graph it is 3 to 10 ns each, and 0.3 to 3 s longer to compile.
WORTH = 3e8
MOST_SOON = 4000  # particles; with more, steps of what compiles soon take 1.2 times as long
# Steps that a frame with `--dt auto` is taken to have: scenes in space begin with 18 to 53.
STEPS_OF_AUTO = 30


def consistent(options: RunOptions) -> RunOptions:
    """The options with the topology that sixteen lanes are of; refuses what has none."""
    if options.lanes != SIXTEEN or "lanes" not in options.given:
        return options
    if options.arch != "cpu":
        raise InputError(f"--lanes {SIXTEEN}: only --arch cpu has lanes, not {options.arch}")
    if options.topology == "graph":
        raise InputError(f"--lanes {SIXTEEN} and --topology graph exclude each other; give one")
    return replace(options, topology="lanes")


def word(lanes: object) -> str:
    """The word after `--lanes` for the lanes that a log or a checkpoint says it is of."""
    from taichi_cloth.simulation import sixteen

    return SIXTEEN if lanes == sixteen.LANES else EIGHT


def lanes_of(scene: Scene, options: RunOptions) -> int | str | None:
    """The lanes of a run, as `Simulation` takes them."""
    from taichi_cloth.kernels import methods
    from taichi_cloth.simulation import sixteen

    if runtime.current_device().arch != "cpu":
        return None  # a log of a run that had some may be replayed there
    most = methods.load(options.method).most_lanes(scene.world.dim)
    if options.lanes == SIXTEEN:
        if most is not None and most < sixteen.LANES:
            if "lanes" not in options.given:
                return None  # a log says it, of another method
            raise InputError(
                f"--lanes {SIXTEEN}: method {options.method} takes at most {most}; leave it out"
            )
        return sixteen.LANES
    return "auto" if may_choose(options) and lasts(scene, options) else None


def may_choose(options: RunOptions) -> bool:
    """True if a run may take sixteen lanes unasked.

    Bits of f32 may differ, so one that names its topology has eight, on every run; and runs beside
    each other have the same ones.
    """
    if options.lanes != "auto" or run_beside.asked(options) or options.hold:
        return False
    named = options.topology != "auto" and "lanes" not in options.given
    return not named and machine.vector_unit() == machine.WIDEST


def lasts(scene: Scene, options: RunOptions) -> bool:
    """True if a run is so long that kernels which run faster may be worth the while."""
    return _is_open(options) or _is_long(scene, options)


def soon(scene: Scene, options: RunOptions) -> bool:
    """True if a run begins with kernels that compile soon, where no earlier one left faster ones.

    Nobody wants to wait for a window, and short runs would end before faster ones have paid.
    """
    if len(scene.particles) > MOST_SOON:
        return False
    return _is_open(options) or not _is_long(scene, options)


def _is_open(options: RunOptions) -> bool:
    """True if it is a window that stays until somebody closes it."""
    from taichi_cloth.ui.opening import opens_window

    return options.frames is None and opens_window(options.view)


def _is_long(scene: Scene, options: RunOptions) -> bool:
    """True if a run that ends by itself has more work than `WORTH`."""
    in_a_frame = STEPS_OF_AUTO if options.dt == "auto" else options.substeps
    return in_a_frame * (options.frames or HEADLESS_FRAMES) * len(scene.particles) >= WORTH
