"""Errors of a run: its samples beside those of a reference (NumPy, float64)."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from taichi_cloth.scene.model import Scene
from taichi_cloth.simulation import diagnostics

# Of a run: the deepest penetration at the end of a frame, the energy that contacts gave, the time
# of the first touch.
CONTACTS = ("penetration", "gained", "first_touch")


@dataclass(frozen=True)
class Samples:
    """States of a run at the start and at the end of each frame.

    x, v: (frames + 1, n, dim); alive: (frames + 1, s), or (frames + 1, 0) where no spring breaks.
    contacts: (frames + 1, 3): what `CONTACTS` names, since the start; NaN where nothing can touch
    or, of the time of the first touch, until it comes; no rows where nobody looked.
    """

    x: np.ndarray
    v: np.ndarray
    alive: np.ndarray
    contacts: np.ndarray = field(default_factory=lambda: np.zeros((0, len(CONTACTS))))

    def __len__(self) -> int:
        return len(self.x)

    @classmethod
    def read(cls, path: Path | str) -> Samples:
        with np.load(path) as file:
            x, v = (file[name].astype(np.float64) for name in "xv")
            return cls(x, v, file["alive"], file["contacts"])

    def first(self, frames: int) -> Samples:
        """Those up to the end of frame number `frames`."""
        end = frames + 1
        return Samples(self.x[:end], self.v[:end], self.alive[:end], self.contacts[:end])


@dataclass(frozen=True)
class Distance:
    """The distance of two runs, in world units, over the particles that are free.

    final_rms, final_max: root of the mean square, and largest, distance of a particle at the end;
    trajectory, trajectory_max: the same over particles and over the ends of all frames.
    """

    final_rms: float
    final_max: float
    trajectory: float
    trajectory_max: float


def distance(a: Samples, b: Samples, free: np.ndarray) -> Distance:
    """The distance of two runs of as many frames; free: (n,) bool.

    A particle that either run does not have yet, whose row is NaN, counts from when both have it.
    """
    square = squares(a, b, free)[1:]
    return Distance(*at_once(square[-1]), *at_once(square))


def squares(a: Samples, b: Samples, free: np.ndarray) -> np.ndarray:
    """Square of the distance of each free particle at each sample, (frames + 1, free)."""
    return _square_length(a.x[:, free] - b.x[:, free])


def at_once(square: np.ndarray) -> tuple[float, float]:
    """Root of the mean, and of the largest, of squares of distances; NaN is left out."""
    return float(np.sqrt(_mean(square))), float(np.sqrt(_largest(square)))


def rms_by_frame(a: Samples, b: Samples, free: np.ndarray) -> np.ndarray:
    """Root of the mean square distance of a particle at each sample, (frames + 1,)."""
    rms: np.ndarray = np.sqrt(_mean(squares(a, b, free), axis=1))
    return rms


def max_by_frame(a: Samples, b: Samples, free: np.ndarray) -> np.ndarray:
    """Largest distance of a particle at each sample, (frames + 1,)."""
    largest: np.ndarray = np.sqrt(_largest(squares(a, b, free), axis=1))
    return largest


def displacement(samples: Samples, free: np.ndarray) -> float:
    """Largest distance of a free particle from where it began."""
    moved = samples.x[:, free] - samples.x[:1, free]
    return float(np.sqrt(_largest(_square_length(moved))))


def extent(samples: Samples, free: np.ndarray, diagonal: float) -> tuple[float, str]:
    """The scale of errors, and its name: the largest displacement of a free particle.

    diagonal: the world's [length], which stands for it where nothing moves.
    """
    largest = displacement(samples, free)
    if largest > 0:
        return largest, "the largest displacement"
    return diagonal, "the world's diagonal, as nothing moves"


def _square_length(d: np.ndarray) -> np.ndarray:
    """Square of the lengths of vectors (..., dim), by component: NumPy is slow along short axes."""
    square: np.ndarray = np.square(d[..., 0])
    for axis in range(1, d.shape[-1]):
        square = square + np.square(d[..., axis])
    return square


def _mean(square: np.ndarray, axis: int | None = None) -> Any:
    """The mean of what is there; 0 where nothing is."""
    there = ~np.isnan(square)
    if there.all() and square.size:
        return square.mean(axis=axis)
    return np.where(there, square, 0.0).sum(axis=axis) / np.maximum(there.sum(axis=axis), 1)


def _largest(square: np.ndarray, axis: int | None = None) -> Any:
    """The largest of what is there; 0 where nothing is."""
    return np.fmax.reduce(square, axis=axis, initial=0.0)


@dataclass(frozen=True)
class Invariants:
    """Energy, momentum and stretch of a run by sample.

    energy: (frames + 1,), what springs, speeds and heights hold; scale: the largest energy of
    springs and speeds, and how much that of heights varies; momentum: (frames + 1, dim) of the free
    particles; impulse: the largest sum of mass times speed; strain: the largest relative change of
    a spring's length, of those that hold and have a rest length.
    """

    energy: np.ndarray
    scale: float
    momentum: np.ndarray
    impulse: float
    strain: float

    @classmethod
    def of(cls, scene: Scene, samples: Samples) -> Invariants:
        particles, springs = scene.particles, scene.springs
        free, mass = ~particles.fixed, particles.mass
        energies, momenta, strain = [], [], 0.0
        impulse = 0.0
        everything = np.ones(len(springs), bool)
        a, b = springs.between.T
        for x, v, alive in zip(samples.x, samples.v, samples.alive, strict=True):
            holds = alive if len(alive) else everything
            energies.append(diagnostics.energy(scene, x, v, holds))
            momenta.append(diagnostics.momentum(v, mass, particles.fixed))
            impulse = max(impulse, float((mass * np.linalg.norm(v, axis=1))[free].sum()))
            measured = holds & (springs.rest_length > 0)
            if measured.any():
                length = np.linalg.norm(x[b[measured]] - x[a[measured]], axis=1)
                rest = springs.rest_length[measured]
                strain = max(strain, float(np.abs(length / rest - 1.0).max()))
        heights = np.array([energy.gravitational for energy in energies])
        return cls(
            energy=np.array([energy.total for energy in energies]),
            scale=float(max(e.kinetic + e.elastic for e in energies) + np.ptp(heights)),
            momentum=np.array(momenta),
            impulse=impulse,
            strain=strain,
        )

    def energy_drift(self, reference: Invariants) -> float:
        """Largest difference from the reference's energy, in parts of the reference's scale."""
        return _part(np.abs(self.energy - reference.energy).max(), reference.scale)

    def momentum_drift(self, reference: Invariants) -> float:
        """Largest difference from the reference's momentum, in parts of its impulse."""
        apart = np.linalg.norm(self.momentum - reference.momentum, axis=1).max()
        return _part(apart, reference.impulse)


def _part(number: float, scale: float) -> float:
    return float(number / scale) if scale > 0 else float(number)


@dataclass(frozen=True)
class Breaks:
    """Springs that broke in a run, beside those of a reference.

    count; agreeing: how many of them broke in the reference, too; first: the frame in which the
    first broke, None where none did; later: by how many frames that is later than in the
    reference, None where either has none.
    """

    count: int
    agreeing: int
    first: int | None
    later: int | None

    @classmethod
    def of(cls, samples: Samples, reference: Samples) -> Breaks:
        broken, true = (break_frames(of) for of in (samples, reference))
        first, true_first = first_frame(broken), first_frame(true)
        return cls(
            count=int((broken >= 0).sum()),
            agreeing=int(((broken >= 0) & (true >= 0)).sum()),
            first=first,
            later=None if first is None or true_first is None else first - true_first,
        )


def break_frames(samples: Samples) -> np.ndarray:
    """The frame in which each spring broke, (s,), -1 for those that hold."""
    broken = ~samples.alive
    return np.where(broken.any(axis=0), broken.argmax(axis=0), -1)


def first_frame(frames: np.ndarray) -> int | None:
    """The frame of the first break, of those of all springs; None where none breaks."""
    broken = frames[frames >= 0]
    return int(broken.min()) if len(broken) else None


@dataclass(frozen=True)
class Contacts:
    """The account of contacts in a run, None where that is not known.

    penetration: the deepest one at the end of a frame [length]; energy: what they gave, summed over
    the steps in which they gave any (`kernels.contact_account`); later: by how much the first touch
    came after the reference's [time], None where either has none.
    """

    penetration: float | None
    energy: float | None
    later: float | None

    @classmethod
    def of(cls, samples: Samples, reference: Samples) -> Contacts:
        penetration, energy, first = _at_end(samples)
        *_, true_first = _at_end(reference)
        later = None if first is None or true_first is None else first - true_first
        return cls(penetration, energy, later)


def touches_anything(samples: Samples) -> bool:
    """True if particles touched something in a run, as far as anybody looked."""
    *_, first = _at_end(samples)
    return first is not None


def _at_end(samples: Samples) -> list[float | None]:
    """The numbers of `CONTACTS`, at the end of a run."""
    if len(samples.contacts) == 0:
        return [None] * len(CONTACTS)
    return [None if np.isnan(number) else float(number) for number in samples.contacts[-1]]
