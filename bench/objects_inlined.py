"""The seed cloth as the leanest program of Python objects: `objects`, its vectors written out.

One object per particle and per spring, without NumPy; it has no mouse.
"""

from __future__ import annotations

import math


class Particle:
    def __init__(self, x: float, y: float, fixed: bool):
        self.x, self.y, self.fixed = x, y, fixed
        self.vx = self.vy = self.fx = self.fy = 0.0
        self.mass, self.radius, self.viscous, self.restitution = 1.0, 5.0, 0.05, 0.0

    def accelerate(self, gravity: float) -> None:
        self.fx = -self.viscous * self.vx
        self.fy = self.mass * gravity - self.viscous * self.vy

    def bounce(self, width: float, height: float) -> tuple[float, float, bool]:
        """Velocity change from the four walls, and whether the floor was hit."""
        jx = jy = 0.0
        gain = 1.0 + self.restitution
        if (self.x - self.radius < 0 and self.vx < 0) or (
            self.x + self.radius > width and self.vx > 0
        ):
            jx = -gain * self.vx
        floor = self.y + self.radius > height and self.vy > 0
        if floor or (self.y - self.radius < 0 and self.vy < 0):
            jy = -gain * self.vy
        return jx, jy, floor

    def move(self, dt: float, width: float, height: float) -> None:
        if self.fixed:
            return
        jx, jy, floor = self.bounce(width, height)
        self.vx += dt * self.fx / self.mass + jx
        self.vy += dt * self.fy / self.mass + jy
        self.x += dt * self.vx
        self.y += dt * self.vy
        if floor and self.vy > 0:
            self.y = height - self.radius


class Spring:
    def __init__(
        self, a: Particle, b: Particle, stiffness: float, rest_length: float, break_force: float
    ):
        self.a, self.b = a, b
        self.stiffness, self.rest_length, self.break_force = stiffness, rest_length, break_force
        self.alive = True

    def pull(self) -> None:
        dx, dy = self.b.x - self.a.x, self.b.y - self.a.y
        length = math.sqrt(dx * dx + dy * dy)
        if length == 0:
            return
        force = self.stiffness * (length - self.rest_length)
        fx, fy = force * dx / length, force * dy / length
        self.a.fx += fx
        self.a.fy += fy
        self.b.fx -= fx
        self.b.fy -= fy
        self.alive = abs(force) <= self.break_force


class Cloth:
    """16 x 12 particles, 25 apart, three of the first row fixed, in a room of 600 x 400."""

    def __init__(self, columns: int = 16, rows: int = 12, spacing: float = 25.0):
        self.width, self.height, self.gravity = 600.0, 400.0, 0.05
        pinned = {0, columns // 2, columns - 1}
        self.particles = [
            Particle(100 + spacing * c, 20 + spacing * r, r == 0 and c in pinned)
            for r in range(rows)
            for c in range(columns)
        ]
        self.springs: list[Spring] = []
        for r in range(rows):
            for c in range(columns):
                here = self.particles[r * columns + c]
                if c > 0:
                    self.springs.append(
                        Spring(here, self.particles[r * columns + c - 1], 0.5, spacing, 5.0)
                    )
                if r > 0:
                    self.springs.append(
                        Spring(here, self.particles[(r - 1) * columns + c], 0.5, spacing, 5.0)
                    )

    def step(self, dt: float = 1.0) -> None:
        for particle in self.particles:
            particle.accelerate(self.gravity)
        for spring in self.springs:
            spring.pull()
        self.springs = [spring for spring in self.springs if spring.alive]
        for particle in self.particles:
            particle.move(dt, self.width, self.height)

    def positions(self) -> list[tuple[float, float]]:
        return [(particle.x, particle.y) for particle in self.particles]
