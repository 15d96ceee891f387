"""A state as the host has it, between the scene and the device."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import ClassVar

import numpy as np

from taichi_cloth.kernels.state import ALIVE, GONE
from taichi_cloth.limits.network import Network, Networks
from taichi_cloth.scene.model import Particles, Scene, Springs

# Columns of particles on which nothing but they themselves, and bending at them, depends.
OWN = frozenset({"fixed", "mass", "color"})


@dataclass(frozen=True)
class Judged:
    """Which of a scene's `elements` go through an obstacle since they were put where they are.

    elements: (m, 3), by their corners. known: (m,) bool, those that were looked at since. through:
    (m,) bool, those of them that go through one (`solids.goes_through`), which keeps out their
    particles alone.
    """

    elements: np.ndarray
    known: np.ndarray
    through: np.ndarray

    @classmethod
    def none(cls) -> Judged:
        """None was looked at."""
        return cls(np.zeros((0, 3), np.int64), np.zeros(0, bool), np.zeros(0, bool))

    def _only(self, known: np.ndarray) -> Judged:
        """The knowledge of those of the elements, (m,) bool, for which it stays."""
        return Judged(self.elements, self.known & known, self.through & known)

    def without(self, gone: np.ndarray) -> Judged:
        """The knowledge of elements that have none of some particles, (n,) bool, which go."""
        left = ~gone[self.elements].any(axis=1)
        return Judged(self.elements[left], self.known[left], self.through[left])

    def moved(self, particles: np.ndarray) -> Judged:
        """The knowledge that stays once some particles, (n,) bool, were put elsewhere."""
        return self._only(~particles[self.elements].any(axis=1))

    def freed(self, particles: np.ndarray) -> Judged:
        """What is known once some particles, (n,) bool, are fixed no more: their faces, which such
        a corner kept from being asked, are asked now.
        """
        return self._only(self.through | ~particles[self.elements].any(axis=1))

    def of(self, elements: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of elements (k, 3), which ones are known, and which of these go through, (k,) bool."""
        if len(self.elements) == 0:
            return np.zeros(len(elements), bool), np.zeros(len(elements), bool)
        if np.array_equal(elements, self.elements):
            return self.known, self.through
        both = np.concatenate([self.elements, elements])
        _, number = np.unique(both, axis=0, return_inverse=True)
        number, was = number.ravel(), np.full(len(both), -1)
        was[number[: len(self.elements)]] = np.where(self.known, self.through, -1)
        found = was[number[len(self.elements) :]]
        return found >= 0, found > 0


@dataclass(frozen=True)
class Grips:
    """Which obstacle each particle goes with since it was fixed, or put where it is.

    by: (n,), its number, -1: none, UNKNOWN: nobody has asked since. at: (n, dim), where in the
    obstacle's frame (`solids.held`).
    """

    UNKNOWN: ClassVar[int] = -2
    by: np.ndarray
    at: np.ndarray

    def but(self, changed: np.ndarray) -> Grips:
        """The same, but for particles of which it is to be asked anew, (n,) bool."""
        return replace(self, by=np.where(changed, self.UNKNOWN, self.by))

    def select(self, particles: np.ndarray) -> Grips:
        """Those of some particles, by number; -1: of one that came."""
        by, at = np.append(self.by, self.UNKNOWN), np.pad(self.at, ((0, 1), (0, 0)))
        return Grips(by[particles], at[particles])


@dataclass(frozen=True)
class Snapshot:
    """A snapshot of a scene: places of its particles, and which springs are broken.

    scene: with all that was spawned, every particle where it began. x, v: (n, dim), where it is
    now. marks: (s, 2) int32, status (ALIVE, BREAKING, GONE) and break step of every spring.
    judged: what is known of its faces; nothing while no obstacle is sharp. grips: what fixed
    particles go with; None: nobody has asked, or nothing takes any along.
    """

    scene: Scene
    x: np.ndarray
    v: np.ndarray
    marks: np.ndarray
    judged: Judged = Judged.none()  # noqa: RUF009, of which nothing is written to
    grips: Grips | None = None

    @classmethod
    def at_start(cls, scene: Scene, marks: np.ndarray | None = None) -> Snapshot:
        """All particles where they began; marks: absent, no spring is broken."""
        if marks is None:
            marks = np.tile(np.array([ALIVE, 0], np.int32), (len(scene.springs), 1))
        return cls(scene, scene.particles.position, scene.particles.velocity, marks)

    @property
    def alive(self) -> np.ndarray:
        """Which springs have not been over their limit, (s,) bool."""
        alive: np.ndarray = self.marks[:, 0] == ALIVE
        return alive

    @property
    def pulling(self) -> np.ndarray:
        """Which springs pull, (s,) bool: those that hold, or break and pull for one more step."""
        pulling: np.ndarray = self.marks[:, 0] != GONE
        return pulling

    def moved(self, x: np.ndarray, v: np.ndarray) -> Snapshot:
        """The state with particles put at x with v, (n, dim): of whose faces nothing is known."""
        moved = (x != self.x).any(axis=1)
        grips = self.grips and self.grips.but(moved)
        return replace(self, x=x, v=v, judged=self.judged.moved(moved), grips=grips)

    def with_particle(self, new: Particles, tied_to: int | None) -> Snapshot:
        """The state with one particle more, tied to one of the others or to none."""
        particles, springs, marks = self.scene.particles, self.scene.springs, self.marks
        x = np.concatenate([self.x, new.position])
        if tied_to is not None:
            ends = [[tied_to, len(particles)]]
            tie = Springs.build(ends, x, defaults=self.scene.spring_defaults)
            springs = springs.joined(tie)
            marks = np.concatenate([marks, np.array([[ALIVE, 0]], np.int32)])
        scene = replace(self.scene, particles=particles.joined(new), springs=springs)
        grips = self.grips and self.grips.select(np.append(np.arange(len(self.x)), -1))
        v = np.concatenate([self.v, new.velocity])
        return Snapshot(scene, x, v, marks, self.judged, grips)

    def network(self, among: Networks | None = None) -> Network:
        """The particles where they are, and the springs that pull.

        among: those of states before, of which what is still the same is taken.
        """
        return (among or Networks()).of(self.scene, self.x, self.pulling, self.v)


def same_but_own(one: Snapshot, other: Snapshot) -> bool:
    """True if two states have all the same arrays, but for the motion of particles and their `OWN`
    numbers.
    """
    mine, theirs = vars(one.scene.particles), vars(other.scene.particles)
    parts = (field.name for field in fields(Scene) if field.name != "particles")
    return (
        one.marks is other.marks
        and all(getattr(one.scene, name) is getattr(other.scene, name) for name in parts)
        and all(mine[name] is theirs[name] for name in mine.keys() - OWN)
    )
