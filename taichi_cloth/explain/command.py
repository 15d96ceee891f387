"""``taichi-cloth explain``: the command, its tables, and those of a document (`costs` measures)."""

from __future__ import annotations

import datetime
import json
import os
import shlex
import sys
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taichi_cloth import console
from taichi_cloth.console import Tell, duration, markdown_table
from taichi_cloth.errors import InputError, counted, nearest
from taichi_cloth.files.pending import PendingFile
from taichi_cloth.kernels import forces
from taichi_cloth.scene.source import SceneSource
from taichi_cloth.settings.options import ExplainOptions, check_run, flag
from taichi_cloth.sweeps.within import Clock, clock, said_of_left_out
from taichi_cloth.version import __version__

if TYPE_CHECKING:
    from rich.console import Console

    from taichi_cloth.explain.costs import Compiled, Cost, Explanation, LinkCost
    from taichi_cloth.runtime import Device
    from taichi_cloth.scene.model import Scene

# The scenes of `--all`: those that are empty at their start are filled.
FILLED: dict[str, dict[str, Any]] = {
    "box": {"particles": 200, "radius": 12.0},
    "sandbox": {"particles": 200, "radius": 5.0},
}
# The scenes of `--all` whose features are switched one by one; of others it measures the whole.
SWITCHED = ("box", "chain", "cloth", "drape", "oscillator", "sandbox", "slinky")
SIDES = (16, 128, 512)  # particles in a row and a column of the cloths whose links are compared
LINKS: dict[str, dict[str, float]] = {  # parameters of the scene `cloth`
    "structural": {},
    "structural, shear": {"shear": 0.1},
    "structural, bend": {"bend": 0.05},
    "structural, shear, bend": {"shear": 0.1, "bend": 0.05},
}
MARKED = "explain"  # what marks a document's places
SMALL_FIELD = 1024  # bytes below which fields are shown together


def main(source: SceneSource, options: ExplainOptions) -> int:
    """Explain a scene, or all of them; returns the exit status."""
    options, end = _consistent(source, options), clock(options.within, options.quick)
    document = _document(options)
    scenes = _built_in() if options.all else {shlex.join(source.words()): source.build()}

    import numpy

    from taichi_cloth import runtime
    from taichi_cloth.explain import costs

    numpy.seterr(all="ignore")  # what overflows is the watchdog's to report
    device = runtime.start(options.arch, options.precision, options.threads, cache=False)
    machine = _machine(device)
    how = {
        name: getattr(options, name)
        for name in ("method", "dt", "substeps", "execution", "topology")
        if name in options.given or name not in ("dt", "substeps")
    }
    found, cloths = [], []
    with console.progress(("text", "bar", "elapsed")) as show_progress:

        def tell(name: str) -> Tell:
            return lambda text, done, total: show_progress(f"{name}: {text}", done, total)

        for name, scene in scenes.items():
            switch = not options.all or scene.name in SWITCHED
            explanation = costs.explain(scene, how, end, tell(name), switch=switch)
            found.append(replace(explanation, scene=name))
        if options.all:
            for side in SIDES:
                named = _cloths(side)
                told = tell(f"links of a cloth, {side} x {side}")
                cloths += costs.compare_links(named, side, how, Clock(), told)
    if options.json:
        said: dict[str, Any] = asdict(found[0])
        if options.all:
            said = {"scenes": [asdict(e) for e in found], "links": [asdict(c) for c in cloths]}
        print(json.dumps({"machine": machine} | said, indent=1))
    else:
        to = console.output()
        for explanation in found:
            show(explanation, to)
            for line in said_of_left_out(end, explanation.left_out):
                console.say(to, line, hang=2)
        if cloths:
            _show_table("What a cloth's links cost", *_table_of_links(cloths), to)
        console.say(to, "; ".join(f"{k}: {v}" for k, v in machine.items()))
    if document:
        text = filled(console.document(document.path, MARKED), found, cloths, machine)
        document.fill(lambda file: file.write(text.encode()))
        print(f"tables filled: {document.path}", file=sys.stderr)
    return 0


def _consistent(source: SceneSource, options: ExplainOptions) -> ExplainOptions:
    """The options with what follows from them filled in; refuses what makes no sense."""
    options = check_run(options)
    if options.all and source != SceneSource():
        raise InputError(f"--all: explains all built-in scenes, not '{source.name}' alone")
    if options.tables and not options.all:
        raise InputError("--tables: give --all, too, whose tables a document gets")
    if options.all and (options.quick or options.within):
        raise InputError("--all explains all built-in scenes: it takes as long as it takes")
    return options


def _document(options: ExplainOptions) -> PendingFile | None:
    if not options.tables:
        return None
    console.document(Path(options.tables), MARKED)
    return PendingFile(options.tables)


def _built_in() -> dict[str, Scene]:
    """All built-in scenes, by the words that one would write after a command."""
    from taichi_cloth.scene import library

    named = {}
    for name in library.names():
        values = FILLED.get(name, {})
        words = [name, *(f"{flag(k)} {v:g}" for k, v in values.items())]
        named[" ".join(words)] = library.build(name, **values)
    return named


def _cloths(side: int) -> dict[str, Scene]:
    from taichi_cloth.scene import library

    return {
        name: library.build("cloth", columns=side, rows=side, **links)
        for name, links in LINKS.items()
    }


def _machine(device: Device) -> dict[str, str]:
    import platform

    import taichi

    from taichi_cloth.measuring import machine

    return {
        "processor": f"{machine.processor()}, {os.cpu_count()} cores",
        "device": device.describe(),
        "versions": f"taichi-cloth {__version__}, taichi {'.'.join(map(str, taichi.__version__))}, "
        f"python {platform.python_version()}",
        "measured": datetime.date.today().isoformat(),
    }


# ------------------------------------------------------------------------------------------
# Tables


def show(explanation: Explanation, to: Console) -> None:
    """Print what is known of a scene: what it uses, what is compiled, stored, and what it costs."""
    e, compiled = explanation, explanation.compiled

    def say(text: str) -> None:
        console.say(to, text, hang=2)

    sizes = f"{counted(e.particles, 'particle')}, {counted(e.springs, 'spring')}"
    say(f"{e.scene}: {sizes}; {e.features}")
    say(
        f"{e.method}, dt {e.dt:g}, {counted(e.substeps, 'substep')}: "
        f"{duration(e.seconds)} a step (quartiles {duration(e.lower)} .. {duration(e.upper)}), "
        f"{e.compile_seconds:.2f} s to compile, {_bytes(compiled.bytes)} on the device"
    )
    if e.assumed:
        say("taken: " + "; ".join(f"{key} = {words}" for key, words in e.assumed.items()))
    to.print()
    say(f"compiled: {_path(compiled)}; {_places(compiled)}")
    say(f"  on: {', '.join(_switches(compiled.plan, True)) or 'nothing'}")
    say(f"  off: {', '.join(_switches(compiled.plan, False)) or 'nothing'}")
    to.print()
    if e.costs:  # else there was no time for any
        _show_table("what each feature costs", *_table_of_costs(e), to)
        for cost in e.costs:
            if cost.note or cost.failed:
                say(f"{cost.feature}: {'without it ' * cost.used}{cost.failed or cost.note}")
        less = "What a scene does without a feature is part of its cost"
        say(f"{less}: below zero, the rest is cheaper.")
        to.print()
    _show_table("fields on the device", *_table_of_fields(e), to)


def _path(compiled: Compiled) -> str:
    plan = compiled.plan
    packs = f", packs of {plan['lanes']} particles" if plan["lanes"] > 1 else ""
    if plan["blocks"]:
        blocks = counted(plan["blocks"], "block")
        loops = f"whole frames in one launch by {blocks} of threads that stay on the GPU"
    elif plan["one_launch_per_step"]:
        loops = "each step a launch whose loops are parallel"
    else:
        loops = f"whole frames in one launch on {counted(plan['threads'], 'thread')}"
    return f"{compiled.topology}{packs}; {compiled.execution}, {loops}"


def _places(compiled: Compiled) -> str:
    words = [f"{count} {kind} links" for kind, count in compiled.links.items()]
    if words:
        words = [f"{counted(compiled.grids, 'regular grid')} with {', '.join(words)}"]
    if compiled.on_graph or not words:
        words.append(f"{counted(compiled.on_graph, 'spring')} as lists of neighbours")
    return ", ".join(words)


def _switches(plan: dict[str, Any], on: bool) -> list[str]:
    """The plan's features that are on, or off, in words."""
    names = {
        "springs": "springs on the graph",
        "links": "links of grids",
        "uniform_springs": "one set of numbers for all springs",
        "uniform_particles": "one set of numbers for all particles",
        "fracture": "fracture",
        "walls": "walls",
        "floor": "floor",
        "obstacles": "obstacles",
        "collisions": "collisions",
        "rows_share_stiffness": "one row of stiffness for all rows",
        "compensated": "compensated sums",
    }
    always = {"gravity", "springs"}  # the first is on in every scene, the second is listed above
    names |= {name: name for name in forces.TERMS if name not in always}
    return [words for name, words in names.items() if bool(plan[name]) is on]


def _table_of_costs(e: Explanation) -> tuple[list[str], list[list[str]]]:
    headers = ["feature", "scene", "what", "with", "without", "cost a step", "quartiles"]
    headers += ["of a step", "to compile", "memory"]
    return headers, [_line_of_cost(cost, e) for cost in e.costs]


def _line_of_cost(cost: Cost, e: Explanation) -> list[str]:
    line = [cost.feature, "has it" if cost.used else "lacks it", cost.about]
    if cost.seconds is None or cost.bytes is None:
        return [*line, "fails", "", "", "", "", "", ""]
    return [
        *line,
        duration(cost.seconds_with),
        duration(cost.seconds_without),
        duration(cost.seconds, sign=True),
        f"{duration(cost.lower, sign=True)} .. {duration(cost.upper, sign=True)}",
        f"{100 * cost.seconds / e.seconds:+.0f} %",
        f"{cost.compile_seconds:+.2f} s",
        _bytes(cost.bytes, sign=True),
    ]


def _table_of_fields(e: Explanation) -> tuple[list[str], list[list[str]]]:
    fields = e.compiled.fields
    large = [f for f in fields if f.bytes >= SMALL_FIELD]
    small = [f for f in fields if f.bytes < SMALL_FIELD]
    lines = [[f.name, " x ".join(map(str, f.shape)), f.type, _bytes(f.bytes)] for f in large]
    names = ", ".join(f.name for f in small)
    lines.append([names, f"{len(small)} small ones", "", _bytes(sum(f.bytes for f in small))])
    rest = e.compiled.bytes - sum(f.bytes for f in fields)
    lines.append(["(keeps fields on cache lines of their own)", "", "", _bytes(rest)])
    lines.append(["together", "", "", _bytes(e.compiled.bytes)])
    return ["field", "shape", "numbers", "memory"], lines


def _table_of_links(cloths: Sequence[LinkCost]) -> tuple[list[str], list[list[str]]]:
    headers = ["cloth", "links", "springs", "path", "a step", "quartiles", "times structural"]
    headers += ["quartiles", "to compile", "memory"]
    return headers, [
        [
            f"{c.side} x {c.side}",
            c.links,
            str(c.springs),
            f"{c.topology}, {c.execution}",
            duration(c.seconds),
            f"{duration(c.lower)} .. {duration(c.upper)}",
            f"{c.ratio:.2f}",
            f"{c.ratio_lower:.2f} .. {c.ratio_upper:.2f}",
            f"{c.compile_seconds:.2f} s",
            _bytes(c.bytes),
        ]
        for c in cloths
    ]


# Columns of text; numbers are aligned to the right.
LEFT = ("feature", "scene", "what", "cloth", "links", "path", "field", "numbers")
# Columns that a narrow terminal goes without, the first ones first; `--json` has them all.
SPARED = ("quartiles", "with", "without", "of a step", "springs", "to compile")


def _show_table(title: str, headers: list[str], lines: list[list[str]], to: Console) -> None:
    left_out = console.print_table(to, title, headers, lines, LEFT, spared=SPARED)
    if left_out:
        console.say(to, f"(left out, for the terminal is narrow: {', '.join(left_out)})")
        to.print()


def _bytes(count: int, sign: bool = False) -> str:
    plus = "+" if sign and count >= 0 else ""
    for unit, scale in (("GiB", 2**30), ("MiB", 2**20), ("KiB", 2**10)):
        if abs(count) >= scale:
            return f"{plus}{count / scale:.3g} {unit}"
    return f"{plus}{count} B"


# ------------------------------------------------------------------------------------------
# Documents


def filled(
    text: str,
    found: Sequence[Explanation],
    cloths: Sequence[LinkCost],
    machine: dict[str, str],
) -> str:
    """A document with what stands between its markers made anew.

    A marker is ``<!-- explain:WHAT -->``, and ends at ``<!-- end -->``; WHAT: scenes, costs, links,
    saving, machine.
    """
    bodies = {
        "scenes": lambda: markdown_table(*_table_of_scenes(found)),
        "costs": lambda: markdown_table(*_table_of_all_costs(found)),
        "links": lambda: markdown_table(*_table_of_links(cloths)),
        "saving": lambda: _saving(cloths),
        "machine": lambda: "\n".join(f"- {name}: {value}" for name, value in machine.items()),
    }

    def body(what: str, _: str | None) -> str:
        if what not in bodies:
            raise InputError(f"<!-- explain:{what} -->: {nearest(what, bodies)}")
        return bodies[what]()

    return console.filled(text, MARKED, body)


def _table_of_scenes(found: Sequence[Explanation]) -> tuple[list[str], list[list[str]]]:
    headers = ["scene", "features", "particles", "springs", "path", "a step", "to compile"]
    return [*headers, "memory"], [
        [
            f"`{e.scene}`",
            e.features,
            str(e.particles),
            str(e.springs),
            f"{e.compiled.topology}, {e.compiled.execution}",
            duration(e.seconds),
            f"{e.compile_seconds:.2f} s",
            _bytes(e.compiled.bytes),
        ]
        for e in found
    ]


def _table_of_all_costs(found: Sequence[Explanation]) -> tuple[list[str], list[list[str]]]:
    """Features down, scenes across: a step's time and the time to compile; what a scene lacks is
    in brackets, with what it would add. Scenes whose features were not switched are left out.
    """
    found = [e for e in found if e.costs]
    features = dict.fromkeys(cost.feature for e in found for cost in e.costs)
    lines = []
    for feature in features:
        line = [feature]
        for e in found:
            cost = next((c for c in e.costs if c.feature == feature), None)
            if cost is None:
                line.append("")
            elif cost.failed:
                line.append("fails")
            else:
                text = f"{duration(cost.seconds, sign=True)}, {cost.compile_seconds:+.2f} s"
                line.append(text if cost.used else f"({text})")
        lines.append(line)
    return ["feature", *(f"`{e.scene}`" for e in found)], lines


def _saving(cloths: Sequence[LinkCost]) -> str:
    """A sentence a size: how much cheaper the structural cloth is than the one with all links."""
    lines = []
    for side in dict.fromkeys(c.side for c in cloths):
        one, *_, all_links = (c for c in cloths if c.side == side)
        lines.append(
            f"At {side} x {side} particles a step takes {duration(one.seconds)} with structural "
            f"links alone and {duration(all_links.seconds)} with shear and bend links besides: "
            f"{all_links.ratio:.2f} times as long (quartiles {all_links.ratio_lower:.2f} to "
            f"{all_links.ratio_upper:.2f}), for {all_links.springs / one.springs:.2f} times the "
            f"springs, {all_links.bytes / one.bytes:.2f} times the memory and "
            f"{all_links.compile_seconds - one.compile_seconds:+.2f} s to compile."
        )
    return "\n".join(lines)
