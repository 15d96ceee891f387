"""Readings of a trace together: when something grew, and out of what."""

from __future__ import annotations

import itertools
import math

import numpy as np

from taichi_cloth.kernels import methods
from taichi_cloth.limits.bounds import any_geometry, step_within
from taichi_cloth.limits.modes import growth
from taichi_cloth.post_mortem.sample import Sample
from taichi_cloth.post_mortem.trace import Trace

FROM_NOTHING = 0.5  # of the energy of motion and springs: above it the numerics made the most
GREW = 4.0  # times: what has grown


def grown(trace: Trace) -> int:
    """The first sample whose energy came from nothing for the most part; -1: there is none.

    What a small drift gathers in a long rest does not count: it is to have grown.
    """
    least = GREW * trace.samples[0].moving
    for k, sample in enumerate(trace.samples):
        if not math.isfinite(sample.moving):
            return k
        if sample.moving > least and sample.drift > FROM_NOTHING * sample.moving:
            return k
    return -1


def beyond(trace: Trace) -> int:
    """The first sample whose step is longer than the stable one; -1: there is none.

    Of a method without a limit no step is, whatever its h omega.
    """
    return next((k for k, sample in enumerate(trace.samples) if too_long(sample)), -1)


def too_long(sample: Sample) -> bool:
    """True if a sample's step is longer than the stable one."""
    return sample.limit.dt < math.inf and not sample.used <= 1 + 1e-9


def of_failed_frame(trace: Trace) -> int | None:
    """The sample at the beginning of the frame that failed, with what was done before it."""
    return next((k for k, s in enumerate(trace.samples) if s.part > 0), None)


def part_from_nothing(trace: Trace, sample: Sample | None = None) -> str:
    """The energy that came from nothing until a sample, in words; None: until it had grown."""
    sample = sample or trace.samples[max(grown(trace), 0)]
    if not math.isfinite(sample.moving):
        return "its energy is no number any more"
    return f"{100 * from_nothing(trace, sample):.2g} % of the energy that moved came from nothing"


def from_nothing(trace: Trace, sample: Sample) -> float:
    """The part of the energy that moved until a sample and came from nothing."""
    until = trace.samples[: trace.samples.index(sample) + 1]
    moved = max(s.moving for s in until) + abs(sample.work) + abs(sample.by_hand)
    return max(sample.drift, 0.0) / moved if moved > 0 else 0.0


def has_grown(trace: Trace) -> bool:
    """True if steps were too long for so long that the least error of rounding has become large.

    What bounds it then is that springs turn, or walls: energy need not come from nothing any more.
    """
    least, grown_by = np.finfo(np.float64 if trace.precision == "f64" else np.float32).eps, 0.0
    for sample, later in itertools.pairwise(trace.samples):
        if not 0 < sample.limit.dt < sample.h:
            grown_by = 0.0
            continue
        steps = (later.time - sample.time) / sample.h
        grown_by += steps * math.log(max(growth_of(sample), 1.0))
        if grown_by > -math.log(least):
            return True
    return False


def growth_of(sample: Sample) -> float:
    """By how much a step multiplies the mode that sets a sample's limit."""
    method = methods.load(sample.method)
    return growth(method, sample.h, sample.limit.omega2, sample.limit.damping)


def any_geometry_holds(trace: Trace) -> bool:
    """True if the step is stable however the springs turn, by where the trace begins."""
    method = methods.load(trace.settings.method)
    return trace.h <= step_within(method, any_geometry(trace.before))
