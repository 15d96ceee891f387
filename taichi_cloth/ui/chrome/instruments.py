"""The contents of each meter: its value, its state, and the curves of the last seconds."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.render import style
from taichi_cloth.simulation.history import SECONDS, History
from taichi_cloth.ui.chrome.beside import DistanceReading
from taichi_cloth.ui.chrome.errors import ErrorReading
from taichi_cloth.ui.chrome.graphs import Curve, Line
from taichi_cloth.ui.text import Color

if TYPE_CHECKING:
    from taichi_cloth.simulation.gauges import Gauges
    from taichi_cloth.simulation.simulation import Simulation

SIMULATE, DRAW, WAIT = (110, 160, 235), (196, 140, 226), (54, 62, 80)
ERROR = (236, 160, 120)
RMS, LARGEST = (236, 196, 96), (120, 112, 96)  # of the distance to a run beside it
CHANGE, WORK, BY_HAND = (92, 102, 124), (110, 160, 235), (196, 140, 226)
PARTS = ((226, 120, 120), (126, 200, 138), (110, 160, 235))  # x, y, z
FRAME = 1000.0 / 60.0  # ms that a frame of a window may take
# Of the stable step. Up to 0.7 a spring may be twice as stiff as now; above, what a click or a
# tear changes may reach the limit; beyond 1 the mode grows.
NEAR = 0.7
# Of the largest kinetic and elastic energy in the graph: what drifts less is not seen in a picture,
# what drifts ten times as far is.
DRIFT = (0.01, 0.1)
# Of what a spring bears: above the first the next pull may break it.
BORNE = (0.7, 1.0)
DEEP = (0.1, 0.5)  # of the smallest radius: seen as a touch, and as one in the other


@dataclass(frozen=True)
class Meter:
    """One meter, as it is drawn.

    value: now, with its unit, in a colour that says its state. details: words with their colours,
    the legend of the curves, too; where room is scarce the last are left out. curves, lines: of the
    graph. ends: values that it must at least show. rate: readings a second, where that is less than
    every frame. label: writes a value of the graph's scale.
    """

    title: str
    value: str
    state: Color
    details: tuple[tuple[str, Color], ...]
    curves: tuple[Curve, ...]
    lines: tuple[Line, ...] = ()
    ends: tuple[float, float] = (0.0, 0.0)
    rate: float = 0.0
    label: Callable[[float], str] = field(default=lambda value: number(value))


@dataclass
class Source:
    """The inputs of meters. frames: rows of (simulate, draw, wait) [s]; None: not measured.

    now: the second of what is kept. error: of what is seen; None: nobody measures it. apart:
    how far a run beside it is; None: there is none.
    """

    sim: Simulation
    gauges: Gauges
    frames: History | None
    now: float
    error: ErrorReading | None = None
    apart: DistanceReading | None = None


def number(value: float) -> str:
    """A number in three digits, as short as can be."""
    if not math.isfinite(value):
        return "none" if value > 0 else "-inf"
    text = f"{value:.3g}"
    if "e" in text:
        digits, power = text.split("e")
        return f"{digits}e{int(power)}"
    return text


def signed(value: float) -> str:
    """The same with its sign."""
    return ("+" if value >= 0 else "-") + number(abs(value))


def percents(value: float) -> str:
    """So many percent; large ones as they are beside it, and not by powers of ten."""
    return (f"{value:.0f}" if 1e3 <= value < 1e6 else number(value)) + " %"


def percent(value: float) -> str:
    """A part as a percentage, with its sign."""
    size = abs(100 * value)
    return ("+" if value >= 0 else "-") + (f"{size:.0f} %" if size >= 9.95 else f"{size:.2g} %")


def _state(value: float, limits: tuple[float, float]) -> Color:
    """Fine, near the limit, or beyond it."""
    return style.GOOD if value < limits[0] else style.WARN if value <= limits[1] else style.BAD


def frame_time(of: Source) -> Meter | None:
    """The time of a frame, by its parts; what is left is waited for."""
    if of.frames is None or not len(of.frames):
        return None
    age, parts = of.frames.last(of.now)
    parts = 1e3 * parts
    lately = parts[age <= 1.0] if (age <= 1.0).any() else parts[-1:]
    simulate, draw, wait = lately.mean(axis=0)
    # One frame that took long, as where something was compiled, goes beyond the graph.
    usual = 1.5 * float(np.percentile(parts.sum(axis=1), 95))
    parts = np.diff(np.minimum(np.cumsum(parts, axis=1), usual), axis=1, prepend=0.0)
    busy = parts[:, :2].sum(axis=1)
    return Meter(
        "frame",
        f"{simulate + draw + wait:.1f} ms",
        _state(simulate + draw, (0.9 * FRAME, 1.05 * FRAME)),
        (
            (f"simulate {simulate:.1f}", SIMULATE),
            (f"draw {draw:.1f}", DRAW),
            (f"wait {wait:.1f}", style.MUTED),
        ),
        (
            Curve(age, parts.sum(axis=1), WAIT, filled=True),
            Curve(age, busy, DRAW, filled=True),
            Curve(age, parts[:, 0], SIMULATE, filled=True),
        ),
        (Line(FRAME, style.MUTED),),
        (0.0, 1.2 * FRAME),
        label=lambda value: f"{value:.0f} ms",
    )


def error(of: Source) -> Meter | None:
    """The error of each second, while somebody measures it."""
    found = of.error
    if found is None:
        return None
    details = tuple((words, style.MUTED) for words in found.details)
    curve = Curve(found.age, 100 * found.relative, ERROR)
    least = 0.0 if (found.relative > 0).any() else 0.01  # no error is below 0 %
    return Meter(
        "error", found.value, found.state, details, (curve,), (), (0.0, least),
        label=percents,
    )  # fmt: skip


def distance(of: Source) -> Meter | None:
    """The distance of a second run from the first."""
    found = of.apart
    if found is None:
        return None
    words = ((found.details[:1], RMS), (found.details[1:], LARGEST))
    details = tuple((word, color) for some, color in words for word in some)
    curves = (
        Curve(found.age, 100 * found.largest, LARGEST), Curve(found.age, 100 * found.rms, RMS)
    )  # fmt: skip
    return Meter(
        "distance", found.value, found.state, details, curves, (), (0.0, 0.01),
        label=percents,
    )  # fmt: skip


def margin(of: Source) -> Meter | None:
    """The step beside the stable limit, and the spring that sets it."""
    found = of.gauges.margin
    if found is None:
        return None
    age, rows = of.gauges.margins.last(of.now)
    rate = of.gauges.margins.rate(of.now)
    reach, used = found.reach, found.used
    about = "" if found.error < 0.02 else "~"
    who = found.limit.describe().replace(", between particles ", ": ").replace(" and ", "-")
    lines: tuple[Line, ...] = ()
    details: tuple[tuple[str, Color], ...] = ((who, style.MUTED),)
    if found.always:
        resolved = reach <= 1.0
        state = style.GOOD if resolved else style.WARN
        word = "stable at every step; above 1 damped or late"
        details = ((word, style.MUTED), *details)
        value, lines, top = f"{about}{number(reach)}", (Line(1.0, style.WARN),), 1.2
    elif found.never:
        state, value, top = style.BAD, f"{number(reach)}, none is stable", reach
    elif math.isinf(found.limit.dt):
        state, value, top = style.GOOD, "nothing can grow", 1.0
    else:
        limit = reach / used
        state = _state(used, (NEAR, 1.0))
        value = f"{about}{number(reach)} of {number(limit)}"
        lines, top = (Line(limit, style.BAD), Line(NEAR * limit, style.WARN)), 1.1 * limit
    curve = Curve(age, rows[:, 0], state)
    return Meter("h·omega", value, state, details, (curve,), lines, (0.0, top), rate)


def energy(of: Source) -> Meter | None:
    """The energy's change since the left edge: physical work, and numerical drift."""
    state = of.gauges.state
    if state is None:
        return None
    age, rows = of.gauges.states.last(of.now)
    change, work, by_hand, doubt = (rows[:, k] - rows[0, k] for k in (1, 2, 3, 4))
    drift = change - work - by_hand
    scale = float(rows[:, 5].max()) or 1.0
    now = float(drift[-1])
    color = _state(abs(now) / scale, DRIFT)
    touching = not of.gauges.knows_contacts
    drifts = "drift, contacts" if touching else "drift"
    if touching:  # what contacts take is no error
        color = style.INK
    unsure = abs(doubt[-1]) > max(abs(now), 1e-3 * scale)
    said = f"±{number(abs(doubt[-1]))}" if unsure else signed(now)
    details = [(f"{drifts} {said}", color), (f"work {signed(float(work[-1]))}", WORK)]
    curves = [Curve(age, change, CHANGE), Curve(age, work, WORK), Curve(age, drift, color)]
    if by_hand.any():
        details.append((f"by hand {signed(float(by_hand[-1]))}", BY_HAND))
        curves.insert(1, Curve(age, by_hand, BY_HAND))
    details.append((f"change {signed(float(change[-1]))}", CHANGE))
    rate = of.gauges.states.rate(of.now)
    value = number(state.booked.energy.total)
    least = 1e-3 * scale  # below that it is no change that matters
    return Meter(
        "energy", value, style.INK, tuple(details), tuple(curves), (Line(0.0, style.MUTED),),
        (-least, least), rate, signed,
    )  # fmt: skip


def strain(of: Source) -> Meter | None:
    """The largest strain of a spring, and how much it bears of what it can; the colour is that of
    the one which bears most.
    """
    state = of.gauges.state
    if state is None or (state.spring < 0 and not state.broken):
        return None
    age, rows = of.gauges.states.last(of.now)
    dim = of.sim.scene.world.dim
    color = _state(state.borne, BORNE)
    details = []
    if state.spring >= 0:
        a, b = state.ends
        details = [(f"spring {state.spring}: {a}-{b}", style.MUTED)]
        bears = f"{100 * state.bears:.0f} % of break force"
        details.append((bears if state.breaks else f"limit {100 * state.full:.0f} %", color))
    curve = Curve(age, 100 * np.abs(rows[:, 7 + dim]), color)
    rate = of.gauges.states.rate(of.now)
    return Meter(
        "strain", percent(state.strain), color, tuple(details), (curve,),
        (), (0.0, 1.0), rate, percents,
    )  # fmt: skip


def penetration(of: Source) -> Meter | None:
    """The deepest penetration into what is in the way, or of a pair."""
    if of.gauges.depth is None:
        return None
    age, rows = of.gauges.depths.last(of.now)
    meters = bool(of.sim.scene.world.up)  # such scenes are in SI units
    scale, unit = (1e3, " mm") if meters else (1.0, "")
    radius = of.sim.radii()
    least = float(radius[radius > 0].min(initial=math.inf))
    color = _state(of.gauges.depth, (DEEP[0] * least, DEEP[1] * least))
    rate = of.gauges.depths.rate(of.now)
    return Meter(
        "penetration", f"{number(scale * of.gauges.depth)}{unit}", color,
        ((f"deepest; smallest radius {number(scale * least)}{unit}", style.MUTED),),
        (Curve(age, scale * rows[:, 0], color),), (), (0.0, 0.1 * scale * least), rate,
    )  # fmt: skip


def broken(of: Source) -> Meter | None:
    """The number of springs that are broken; where none can break there is no such meter."""
    state, springs = of.gauges.state, of.sim.storage.scene.springs
    if state is None or not (np.isfinite(springs.break_force).any() or state.broken):
        return None
    age, rows = of.gauges.states.last(of.now)
    count = rows[:, 9 + of.sim.scene.world.dim]
    lately = int(count[-1] - count[0])
    color = style.WARN if lately else style.INK
    return Meter(
        "broken", f"{state.broken} of {len(springs)}", color,
        ((f"{signed(lately)} in {SECONDS:.0f} s", style.MUTED),),
        (Curve(age, count, color),), (), (0.0, 1.0), of.gauges.states.rate(of.now),
        lambda value: f"{value:.0f}",
    )  # fmt: skip


def momentum(of: Source) -> Meter | None:
    """The size of the momentum, and its parts."""
    state = of.gauges.state
    if state is None:
        return None
    age, rows = of.gauges.states.last(of.now)
    names = zip("xyz", state.momentum, PARTS, strict=False)
    return Meter(
        "momentum", number(float(np.linalg.norm(state.momentum))), style.INK,
        tuple((f"{name} {signed(float(part))}", color) for name, part, color in names),
        tuple(
            Curve(age, rows[:, 7 + k], PARTS[k]) for k in range(len(state.momentum))
        ),
        (Line(0.0, style.MUTED),), (0.0, 0.0), of.gauges.states.rate(of.now), signed,
    )  # fmt: skip


# The most important first: those stay where room is scarce.
ALL = (frame_time, distance, error, margin, energy, strain, penetration, broken, momentum)
