"""The parts of the physics: which of them a scene needs (`Scene.features`)."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Features:
    """The parts of the physics a scene needs; what is False is neither compiled nor stored."""

    dim: int
    springs: bool
    uniform_springs: bool  # all springs share their numbers, which are then stored once
    uniform_particles: bool  # all particles share radius, restitution and viscous; likewise
    fracture: bool
    walls: tuple[tuple[int, int], ...]  # (axis, side) of each wall
    floor: bool
    collisions: bool
    obstacles: tuple[str, ...] = ()  # shapes, those of the ground and of resting walls included
    moving: bool = False  # whether any of them moves
    resting: bool = False  # whether pairs that collide rest on each other
    held: bool = False  # whether fixed particles may go with obstacles that move
    thick: bool = False  # whether cloths have a thickness, and do not pass through themselves

    def describe(self) -> str:
        """In words, such as '2-D, uniform springs, fracture, drag, 4 walls, floor'."""
        words = {name.replace("_", " "): has for name, has in vars(self).items()}
        words["springs"] = self.springs and not self.uniform_springs
        words["uniform springs"] = self.springs and self.uniform_springs
        words["walls"] = words["obstacles"] = words["moving"] = None
        words["held"] = None
        if self.walls:
            words[f"{len(self.walls)} walls"] = True
        if self.obstacles:
            moving = "moving " * self.moving
            words[f"{moving}obstacles ({', '.join(self.obstacles)})"] = True
            words["moving pins"] = self.held
        return ", ".join([f"{self.dim}-D", *(word for word, has in words.items() if has is True)])
