"""Numbers that carry a bound of what rounding in f32 or f64 can have done to them, and a twin.

A number is a `Decimal` of 40 digits with any exponent, and a bound of how far the device's may be
from it: half a unit in the last place for each operation, times SLACK for other orders of sums and
fused operations, and the least normal number where the device flushes to zero (Higham, Accuracy and
Stability of Numerical Algorithms, 3.3, running error analysis). The twin steps a scene by the
formulas of symplectic Euler, pairs and fracture in such numbers, and says where rounding may have
decided otherwise.
"""

import decimal
from decimal import Decimal

import numpy as np

CONTEXT = decimal.Context(prec=40, Emax=10**6, Emin=-(10**6), traps=[])
ENDLESS = Decimal("Infinity")
SLACK = 8
WATCHED = Decimal(float(np.finfo(np.float32).max))  # what is more counts as infinite
# Inverse mass of a fixed particle in a collision with what has more than that of HEAVY, else 0.
HEAVIEST, HEAVY = 1e-9, 1e-6


class Doubt(Exception):
    """Rounding may have decided a comparison either way."""


class Number:
    """value and error: |device's - value| <= error; infinite where the device may overflow."""

    unit = tiny = most = Decimal(0)  # set by `calculate_in`
    __slots__ = ("error", "value")

    def __init__(self, value, error=0):
        self.value, self.error = value, error

    @classmethod
    def given(cls, value):
        """A number of the scene, as the device rounds it."""
        value = Decimal(float(value))
        return cls._rounded(value, Decimal(0), abs(value))

    @classmethod
    def _rounded(cls, value, error, size):
        size = abs(size)
        error = error + SLACK * cls.unit * size
        if 0 < size < cls.tiny * 2:
            error += cls.tiny
        if size + error > cls.most:
            error = ENDLESS
        return cls(value, error)

    @property
    def lost(self):
        """Whether the device may have anything here, also infinity."""
        return self.error.is_infinite() or self.error.is_nan()

    def __add__(self, b):
        return self._rounded(
            self.value + b.value, self.error + b.error, max(abs(self.value), abs(b.value))
        )

    def __neg__(self):
        return Number(-self.value, self.error)

    def __sub__(self, b):
        return self + -b

    def __mul__(self, b):
        if self.lost or b.lost:
            return Number(self.value * b.value, ENDLESS)
        error = abs(self.value) * b.error + abs(b.value) * self.error + self.error * b.error
        value = self.value * b.value
        return self._rounded(value, error, value)

    def inverse(self):
        if self.lost or abs(self.value) <= self.error:
            return Number(1 / self.value if self.value else Decimal(0), ENDLESS)
        value = 1 / self.value
        error = abs(value) * self.error / (abs(self.value) - self.error)
        return self._rounded(value, error, value)

    def root(self):
        if self.lost:
            return Number(max(self.value, Decimal(0)).sqrt(), ENDLESS)
        value = max(self.value, Decimal(0)).sqrt()
        low = max(self.value - self.error, Decimal(0)).sqrt()
        error = max((self.value + self.error).sqrt() - value, value - low)
        return self._rounded(value, error, value)

    def positive(self):
        """Whether it is above 0; Doubt where rounding decides."""
        if self.lost or (abs(self.value) <= self.error and self.error > 0):
            raise Doubt
        return self.value > 0


def calculate_in(real):
    """From now on errors are those of np.float32 or np.float64."""
    decimal.setcontext(CONTEXT)
    about = np.finfo(real)
    Number.unit = Decimal(float(about.eps)) / 2
    Number.tiny, Number.most = Decimal(float(about.tiny)), Decimal(float(about.max))


ZERO = Number(Decimal(0), Decimal(0))
ONE = Number(Decimal(1), Decimal(0))


def dot(a, b):
    total = a[0] * b[0]
    for x, y in zip(a[1:], b[1:], strict=True):
        total = total + x * y
    return total


def _scaled(number, vector):
    return [number * part for part in vector]


def _sum(a, b):
    return [x + y for x, y in zip(a, b, strict=True)]


def _difference(a, b):
    return [x - y for x, y in zip(a, b, strict=True)]


class Twin:
    """A scene, stepped. x, v: of each particle, a `Number` an axis.

    walls: (axis, side) of each; what happens at them has tests of its own (`test_contact.py`), and
    is a Doubt here. sure: whether it is certain which springs hold at the start. suspects:
    particles that may have ended a step of the last frame not finite or too fast; culprits: those
    that certainly have.
    """

    def __init__(self, scene, dt, substeps, speed_limit, walls):
        p, s, world = scene.particles, scene.springs, scene.world
        given = Number.given
        self.scene, self.substeps, self.walls = scene, substeps, walls
        self.x = [[given(c) for c in row] for row in p.position]
        moving = np.where(p.fixed[:, None], 0.0, p.velocity)
        self.v = [[given(c) for c in row] for row in moving]
        self.w = [ZERO if f else given(m).inverse() for m, f in zip(p.mass, p.fixed, strict=True)]
        self.radius, self.restitution = map(given, p.radius), map(given, p.restitution)
        self.radius, self.restitution = list(self.radius), list(self.restitution)
        self.viscous = list(map(given, p.viscous))
        self.springs = [
            (int(a), int(b), given(k), given(rest), given(c))
            for (a, b), k, rest, c in zip(
                s.between, s.stiffness, s.rest_length, s.damping, strict=True
            )
        ]
        with np.errstate(all="ignore"):
            shortest, longest = s.lengths_held()
        self.held = [
            (given(a) if a > 0 else None, given(b) if np.isfinite(b) else None)
            for a, b in zip(shortest, longest, strict=True)
        ]
        self.dt = given(dt / substeps)
        self.gravity = list(map(given, world.gravity))
        self.low, self.high = list(map(given, world.low)), list(map(given, world.high))
        self.limit = given(speed_limit)
        self.pulls = [True] * len(s)
        self.suspects, self.culprits = set(), set()
        self.sure = True
        try:
            self.holds = [self._holds(i) for i in range(len(s))]
        except Doubt:
            self.sure = False

    def _holds(self, i):
        a, b = self.springs[i][:2]
        d = _difference(self.x[b], self.x[a])
        d2 = dot(d, d)
        short, long = self.held[i]
        over = long is not None and (d2 - long * long).positive()
        return not (over or (short is not None and (short * short - d2).positive()))

    def frame(self):
        """A frame; Doubt where rounding decides what happens in it."""
        self.suspects, self.culprits = set(), set()
        for _ in range(self.substeps):
            self._step()
            if self.suspects:
                return
            self.pulls = self.holds
            self.holds = [h and self._holds(i) for i, h in enumerate(self.pulls)]

    def _accelerations(self):
        force = [[ZERO] * len(row) for row in self.x]
        for (a, b, k, rest, c), pulls in zip(self.springs, self.pulls, strict=True):
            if not pulls:
                continue
            d = _difference(self.x[b], self.x[a])
            length = dot(d, d).root()
            if length.value == 0 and length.error == 0:
                continue
            along = _scaled(length.inverse(), d)
            tension = k * (length - rest)
            if c.value:
                tension = tension + c * dot(_difference(self.v[b], self.v[a]), along)
            pull = _scaled(tension, along)
            force[a], force[b] = _sum(force[a], pull), _difference(force[b], pull)
        found = []
        for f, v, w, c in zip(force, self.v, self.w, self.viscous, strict=True):
            a = self.gravity
            if c.value:
                a = _difference(a, _scaled(w, _scaled(c, v)))
            found.append(_sum(a, _scaled(w, f)))
        return found

    def _pair_bounces(self):
        jumps = [[ZERO] * len(row) for row in self.x]
        for i, w in enumerate(self.w):
            for j in range(len(self.x)) if w.value > 0 else ():
                d = _difference(self.x[j], self.x[i])
                reach, d2 = self.radius[i] + self.radius[j], dot(d, d)
                if i == j or (d2 - reach * reach).positive() or not d2.positive():
                    continue
                n = _scaled(d2.root().inverse(), d)
                closing = dot(_difference(self.v[i], self.v[j]), n)
                if closing.value == 0 and closing.error == 0 or not closing.positive():
                    continue
                other = self.w[j]
                if other.value == 0 and w.value > HEAVY:
                    other = Number.given(HEAVIEST)
                e = ONE + self.restitution[i] * self.restitution[j]
                change = e * closing * (w * (w + other).inverse())
                jumps[i] = _difference(jumps[i], _scaled(change, n))
        return jumps

    def _step(self):
        world = self.scene.world
        jumps = self._pair_bounces() if world.collisions else [[ZERO] * world.dim] * len(self.x)
        moved = []
        for i, a in enumerate(self._accelerations()):
            x, v = self.x[i], self.v[i]
            if self.w[i].value == 0:
                moved.append((x, v))
                continue
            new_v = _sum(_sum(v, _scaled(self.dt, a)), jumps[i])
            new_x = _sum(x, _scaled(self.dt, new_v))
            if any(self._past(wall, at, i) for wall in self.walls for at in (x, new_x)):
                raise Doubt
            moved.append((new_x, new_v))
        for i, (x, v) in enumerate(moved):
            speed2 = dot(v, v)
            over = speed2 - self.limit * self.limit
            place = sum(abs(c.value) + c.error for c in x)
            if place > WATCHED or speed2.value + speed2.error > WATCHED:
                self.suspects.add(i)
            if any(c.lost for c in (*x, *v)) or speed2.lost or over.value > -over.error:
                self.suspects.add(i)
            if not (speed2.lost or over.lost) and over.value > over.error:
                self.culprits.add(i)
        self.x, self.v = [m[0] for m in moved], [m[1] for m in moved]

    def _past(self, wall, x, i):
        """Whether particle i at x is past a wall: what then happens is not for this twin."""
        axis, side = wall
        gap = self.high[axis] - x[axis] if side > 0 else x[axis] - self.low[axis]
        return (self.radius[i] - gap).positive()
