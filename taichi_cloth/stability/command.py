"""The command ``taichi-cloth stability``: the largest stable step of each method on a scene."""

from __future__ import annotations

import contextlib
import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from taichi_cloth import console, runtime
from taichi_cloth.errors import InputError, nearest
from taichi_cloth.files.names import name_for_file
from taichi_cloth.files.pending import folder_of_results
from taichi_cloth.kernels import methods
from taichi_cloth.limits.network import Network
from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.source import SceneSource
from taichi_cloth.settings.sweeps import StabilityOptions
from taichi_cloth.stability import elsewhere, experiment, report
from taichi_cloth.stability.experiment import Map, Started, StepLimits, TellRun, claimed
from taichi_cloth.sweeps.cluster import connected
from taichi_cloth.sweeps.identity import of_scene
from taichi_cloth.sweeps.journal import Journal, kept
from taichi_cloth.sweeps.tasks import said_of_lost
from taichi_cloth.sweeps.within import Clock, TimeIsUp, clock, ending, said_of_left_out

# How far a bisection is told to be: runs, about, each as long as WEIGHT of a map's.
BISECTION = 10
EXACT_IN_TIME = 2000  # coordinates up to which a time to keep to leaves some for exact limits
INEXACT = "exact limits of damped modes: the computed ones may be a percent shorter"
WEIGHT = 14


def main(source: SceneSource, options: StabilityOptions) -> int:
    """Do what the command asks for; the exit status. Ctrl-C keeps what is finished."""
    names, end = _methods(options.method), clock(options.within, options.quick)
    scene = source.build()
    with np.errstate(all="ignore"):  # what overflows is refused
        prepared = experiment.at_rest(scene)
        network = Network.from_scene(prepared)
        experiment.check_rates(scene, network)
    folder = Path(options.output or f"stability-{name_for_file(scene.name, 'scene')}")
    known = of_scene("stability", source, options, scene)
    with (
        folder_of_results(folder, report.FILES),
        connected(options.on) as there,
        kept(folder, known, options.resume, options.quiet) as journal,
    ):
        np.seterr(all="ignore")  # numbers that overflow are the watchdog's to report
        runtime.start("cpu", "f64")
        # What bounds the time has to be known soon: modes with dashpots take minutes where there
        # are many.
        exact = not end.limited or prepared.particles.position.size <= EXACT_IN_TIME
        limits = [experiment.computed(name, network, exact) for name in names]
        maps: list[Map] = []
        interrupted = None
        lost: list[str] = []
        with _progress(limits, options.quiet) as tell:
            try:
                with ending(end):
                    if there:
                        lost = elsewhere.measure(
                            prepared, limits, tell, journal, there, lambda: end.left() < 0
                        )
                    _measure(prepared, limits, maps, within(end, tell), journal)
            except (TimeOver, TimeIsUp):
                maps[:] = [
                    drawn for drawn in maps if journal.get(experiment.map_key(prepared, drawn))
                ]
            except KeyboardInterrupt as interrupt:
                interrupted = interrupt
        if lost:
            print(said_of_lost(lost), file=sys.stderr, flush=True)
        experiment.take_finished(prepared, limits, maps, journal)
        left_out = experiment.left_out(prepared, limits, journal) if end.limited else []
        if not exact:
            left_out.insert(0, INEXACT)
        stall = experiment.stall(scene)
        written = report.write(folder, scene, limits, maps, stall)
        if not options.quiet:
            report.show(scene, limits, stall, all_methods=options.method is None)
            rates = experiment.drag_of_wind(scene) / scene.particles.mass
            report.say_of_wind(rates, limits, experiment.as_it_starts(scene, names))
            for line in said_of_left_out(end, left_out):
                console.say(console.output(), line, hang=2)
            console.say(console.output(), f"\nwritten: {', '.join(map(str, written))}")
        if interrupted:
            raise interrupted
    return 0


class TimeOver(Exception):
    """The time that the command had is over."""


def _measure(
    scene: Scene, limits: Sequence[StepLimits], maps: list[Map], tell: TellRun, journal: Journal
) -> None:
    """Measure all limits, and then, with what was compiled for them, all maps."""
    started = [Started(scene, of.method) for of in limits]
    for runs, of_method in zip(started, limits, strict=True):
        experiment.measure_limit(runs, of_method, tell, journal)
    for runs in started:
        experiment.draw_maps(runs, maps, tell, journal)


def within(end: Clock, tell: TellRun) -> TellRun:
    """A check before each run: it raises TimeOver where that would end too late."""

    def tell_in_time(method: str, map_: str) -> None:
        if end.left() < experiment.MOST_SECONDS:
            raise TimeOver
        tell(method, map_)

    return tell_in_time if end.limited else tell


def _methods(chosen: str | None) -> list[str]:
    """The methods that have a limit, or the one chosen."""
    limited = [m for m in methods.METHODS if claimed(m) < math.inf]
    if chosen is None:
        return limited
    if chosen not in methods.METHODS:
        raise InputError(f"--method: unknown method '{chosen}'; {nearest(chosen, methods.METHODS)}")
    if chosen not in limited:
        raise InputError(
            f"--method {chosen}: it is stable at every step; those with a limit: "
            f"{', '.join(limited)}"
        )
    return [chosen]


@contextlib.contextmanager
def _progress(limits: Sequence[StepLimits], quiet: bool) -> Iterator[TellRun]:
    """A bar with the time left, on a terminal's standard error; elsewhere nothing."""
    # What is done when a method's limit or its maps begin, and all there is to do.
    begins, total = {}, 0
    for of_map in (False, True):
        for of in limits:
            begins[of.method, of_map] = total
            if not math.isinf(of.limit.dt):
                maps = 2 * experiment.MESH.points * (claimed(of.method) > 0)
                total += maps if of_map else BISECTION * WEIGHT
    present, done = ("", False), 0

    def tell(method: str, map_: str) -> None:
        nonlocal present, done
        if (method, bool(map_)) != present:
            present = method, bool(map_)
            done = begins[present]
        done += 1 if map_ else WEIGHT
        show(f"{method}, map of {map_}" if map_ else f"{method}, bisection", done, total)

    with console.progress(("text", "bar", "left"), shown=not quiet) as show:
        show("computing", 0, total)
        yield tell
