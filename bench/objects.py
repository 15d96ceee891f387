"""The seed cloth as a program of Python objects: the yardstick of the part `seed`.

Written as the original was: vectors, particles, springs and walls are objects that act on each
other, without NumPy. All forces and bounces of a step are from the state at its start.
"""

from __future__ import annotations

import math


class Vector:
    """Two numbers that add, subtract and scale."""

    def __init__(self, x: float, y: float):
        self.x, self.y = x, y

    def __add__(self, other: Vector) -> Vector:
        return Vector(self.x + other.x, self.y + other.y)

    def __sub__(self, other: Vector) -> Vector:
        return Vector(self.x - other.x, self.y - other.y)

    def __mul__(self, factor: float) -> Vector:
        return Vector(self.x * factor, self.y * factor)

    def __truediv__(self, divisor: float) -> Vector:
        return Vector(self.x / divisor, self.y / divisor)

    def __neg__(self) -> Vector:
        return Vector(-self.x, -self.y)

    def dot(self, other: Vector) -> float:
        return self.x * other.x + self.y * other.y

    def length(self) -> float:
        return math.sqrt(self.dot(self))

    def normalised(self) -> Vector:
        return self * (1.0 / self.length())


class Particle:
    """A disc with a mass; collects forces and impulses during a step, then moves."""

    def __init__(self, position: Vector, fixed: bool = False):
        self.position, self.velocity = position, Vector(0.0, 0.0)
        self.mass, self.radius, self.viscous, self.restitution = 1.0, 5.0, 0.05, 0.0
        self.fixed = fixed
        self.force, self.impulse = Vector(0.0, 0.0), Vector(0.0, 0.0)

    def apply_force(self, force: Vector) -> None:
        self.force = self.force + force

    def apply_impulse(self, impulse: Vector) -> None:
        self.impulse = self.impulse + impulse

    def move(self, dt: float, gravity: Vector) -> None:
        """Symplectic Euler: the position moves with the new velocity."""
        if not self.fixed:
            force = gravity * self.mass + self.velocity * -self.viscous + self.force
            change = (force * dt + self.impulse) / self.mass
            self.velocity = self.velocity + change
            self.position = self.position + self.velocity * dt
        self.force, self.impulse = Vector(0.0, 0.0), Vector(0.0, 0.0)


class Spring:
    """Pulls two particles together; broken once its force, a push too, exceeds the break force."""

    def __init__(
        self, a: Particle, b: Particle, stiffness: float, rest_length: float, break_force: float
    ):
        self.a, self.b = a, b
        self.stiffness, self.rest_length, self.break_force = stiffness, rest_length, break_force
        self.broken = False

    def update(self) -> None:
        between = self.b.position - self.a.position
        length = between.length()
        if length == 0:
            return
        force = self.stiffness * (length - self.rest_length)
        pull = between.normalised() * force
        self.a.apply_force(pull)
        self.b.apply_force(-pull)
        self.broken = abs(force) > self.break_force


class Wall:
    """The line through a point with a normal that points out of the room."""

    def __init__(self, point: Vector, normal: Vector):
        self.point, self.normal = point, normal

    def hit_by(self, particle: Particle) -> bool:
        outside = self.normal.dot(particle.position - self.point) + particle.radius > 0
        return outside and self.normal.dot(particle.velocity) > 0

    def bounce(self, particle: Particle) -> None:
        speed = self.normal.dot(particle.velocity)
        gain = (1 + particle.restitution) * particle.mass
        particle.apply_impulse(self.normal * (-gain * speed))


class Cloth:
    """16 x 12 particles, 25 apart, three of the first row fixed, in a room of 600 x 400."""

    REACH, STRENGTH = 50.0, 0.002  # of the pointer

    def __init__(self) -> None:
        columns, rows, spacing = 16, 12, 25.0
        corner, pinned = Vector(100.0, 20.0), (0, columns // 2, columns - 1)
        self.gravity = Vector(0.0, 0.05)
        self.floor = Wall(Vector(600.0, 400.0), Vector(0.0, 1.0))
        self.walls = [
            self.floor,
            Wall(Vector(0.0, 0.0), Vector(0.0, -1.0)),
            Wall(Vector(0.0, 0.0), Vector(-1.0, 0.0)),
            Wall(Vector(600.0, 400.0), Vector(1.0, 0.0)),
        ]
        self.pointer: Vector | None = None
        self.particles: list[Particle] = []
        self.springs: list[Spring] = []
        for row in range(rows):
            for column in range(columns):
                here = Particle(
                    corner + Vector(column, row) * spacing, fixed=row == 0 and column in pinned
                )
                if column > 0:
                    self.springs.append(Spring(here, self.particles[-1], 0.5, spacing, 5.0))
                if row > 0:
                    above = self.particles[-columns]
                    self.springs.append(Spring(here, above, 0.5, spacing, 5.0))
                self.particles.append(here)

    def blow(self, pointer: Vector, displacement: Vector) -> None:
        """The pointer moves: in the next step it pushes what is near it."""
        self.pointer, self.displacement = pointer, displacement

    def push(self) -> None:
        assert self.pointer
        for particle in self.particles:
            distance = (particle.position - self.pointer).length()
            if distance < self.REACH:
                strength = self.STRENGTH * (self.REACH - distance)
                particle.apply_force(self.displacement * strength)

    def step(self, dt: float = 1.0) -> None:
        for spring in self.springs:
            spring.update()
        self.springs = [spring for spring in self.springs if not spring.broken]
        if self.pointer:
            self.push()
            self.pointer = None
        for particle in self.particles:
            landed = False
            for wall in self.walls:
                if wall.hit_by(particle):
                    wall.bounce(particle)
                    landed = landed or wall is self.floor
            particle.move(dt, self.gravity)
            if landed and not particle.fixed and particle.velocity.y > 0:
                particle.position.y = self.floor.point.y - particle.radius

    def positions(self) -> list[tuple[float, float]]:
        return [(particle.position.x, particle.position.y) for particle in self.particles]
