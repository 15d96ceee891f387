"""A post-mortem's names of springs, and of who did something."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from taichi_cloth.post_mortem.done import LIMITING
from taichi_cloth.post_mortem.sample import Sample
from taichi_cloth.post_mortem.trace import Trace, inverse_masses


def by_whom(trace: Trace, sample: Sample, of: frozenset[str] = frozenset()) -> str:
    """The last one who did something, until a sample. of: names of acts that come first."""
    done = [act for act in trace.acts if act.frame <= sample.frame]
    done = [act for act in done if act.name in of] or done
    return f"{done[-1].words} at frame {done[-1].frame}" if done else "the scene"


def since(trace: Trace, sample: Sample) -> str:
    """With what was done just before a sample its step became too long; "": nothing was."""
    before = sample.frame if sample.part else sample.frame - 1
    done = [act for act in trace.acts if act.frame == before and act.name in LIMITING]
    return f", since {done[-1].words} at frame {before}" if done else ""


def apart(a: float, b: float) -> tuple[str, str]:
    """Two numbers in as few digits, four at least of the first, as tell them apart."""
    for digits in range(4, 10):
        said = f"{a:.{digits}g}", f"{b:.{digits}g}"
        if said[0] != said[1]:
            break
    return said


def counted(number: int, one: str, many: str) -> str:
    """A count in words: "1 spring", "2 springs"."""
    return f"{number} {one if number == 1 else many}"


def spring_of(sample: Sample) -> str:
    """The setter of a sample's limit, a spring with its numbers of then."""
    number = sample.limit.spring
    if number < 0:
        shares = sample.shares
        if shares is not None and shares.air > shares.drag and sample.limit.bent < 0:
            return air_at(sample.limit.particle)
        return sample.limit.describe()
    return _with_numbers(number, sample.stiffness, sample.inverse)


def air_at(particle: int) -> str:
    """The forces on a particle in wind."""
    return f"the air at the triangles around particle {particle}"


def _with_numbers(number: int, stiffness: float, inverse: Sequence[float]) -> str:
    of = " and ".join(f"{w:.3g}" for w in dict.fromkeys(inverse))
    return f"spring {number} (stiffness {stiffness:.3g}, inverse mass {of})"


def spring_named(trace: Trace, number: int) -> str:
    """A spring with the numbers that make it fast: "spring 17 (stiffness 1e6, ...)"."""
    for network in (trace.last, trace.before):
        at = np.flatnonzero(network.number == number)
        if number >= 0 and len(at):
            springs = network.springs
            inverse = inverse_masses(network.particles, springs.between[at[0]])
            return _with_numbers(number, float(springs.stiffness[at[0]]), inverse.tolist())
    return "what is bent or dragged"
