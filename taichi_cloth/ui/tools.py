"""What the mouse and the keys do: blow, spawn, chain, turn, zoom."""

from __future__ import annotations

import numpy as np

from taichi_cloth.errors import InputError
from taichi_cloth.files.events import Event
from taichi_cloth.scene.model import COLOR_CYCLE, FIXED_COLOR
from taichi_cloth.scene.scatter import VELOCITY_HIGH, VELOCITY_LOW
from taichi_cloth.ui.camera import Camera
from taichi_cloth.ui.layout import Layout

DEGREES_A_PIXEL = 0.1
ZOOM_STEP = 1.1  # factor a wheel notch or key press

STEP_KEYS = (".", "right")
HELP_KEYS = ("f1", "tab")
NEARER_KEYS, FARTHER_KEYS = ("+", "=", "up"), ("-", "down")


class Tools:
    """Turns events into actions on the simulation and the camera.

    Everything it does follows from its seed, the size of the window and the events, so that the
    same events at the same frames give the same run.

    sim: the `Simulation`; camera: of a 3-D scene, else None; window: (width, height) in pixels
    that the events' positions refer to; seed: of the thrown particles' velocities.
    """

    def __init__(self, sim, camera: Camera | None, window: tuple[int, int], seed: int = 0):
        self._sim, self._camera, self._seed = sim, camera, seed
        self._layout = Layout(sim.scene.world.size[:2], window)
        self._world = sim.scene.world
        self._ctrl = self._space = False
        self._pointer: np.ndarray | None = None  # [window pixels] now
        self._before: np.ndarray | None = None  # [window pixels] when the last frame began
        self.notice: str | None = None  # what to tell the user about the last click
        self._start()

    def _start(self) -> None:
        self._rng = np.random.default_rng(self._seed)
        self._thrown = 0
        self._newest: int | None = None

    def apply(self, event: Event) -> str | None:
        """Do what `event` asks for.

        What is not the simulation's or the camera's is returned for the app to do: "pause",
        "step", "reset", "status", "help" or "quit".
        """
        if event.kind == "move":
            self._move(np.array(event.pos, np.float64))
        elif event.kind == "wheel":
            self._zoom(event.delta)
        elif event.button is not None:
            if event.kind == "press" and not self._ctrl:
                self._click(event)
        elif event.key == "ctrl":
            self._ctrl = event.kind == "press"
        elif event.key == "space" and self._world.mouse == "spawn":
            self._space = event.kind == "press"
        elif event.kind == "press":
            return self._key(event.key)
        return None

    def _key(self, key: str) -> str | None:
        if key in NEARER_KEYS:
            self._zoom(1)
        elif key in FARTHER_KEYS:
            self._zoom(-1)
        elif key in ("p", "space"):
            self._before = None  # where the pointer went meanwhile is no gust
            return "pause"
        elif key in STEP_KEYS:
            self._before = None
            return "step"
        elif key == "r":
            return "reset"
        elif key == "h":
            return "status"
        elif key in HELP_KEYS:
            return "help"
        elif key == "escape":
            return "quit"
        return None

    def _move(self, pixel: np.ndarray) -> None:
        if self._ctrl and self._camera and self._pointer is not None:
            # The side that faces us follows the pointer.
            dx, dy = (pixel - self._pointer) * DEGREES_A_PIXEL
            self._camera.rotate(-dx, dy)
            self._before = None
        self._pointer = pixel

    def _zoom(self, notches: float) -> None:
        if self._camera:
            self._camera.zoom(ZOOM_STEP ** float(np.clip(notches, -100, 100)))

    def _click(self, event: Event) -> None:
        if self._world.mouse != "spawn" or event.button not in ("left", "right"):
            return
        place = self._layout.to_world(event.pos)
        if self._camera:
            place = self._camera.unproject(place)
        self.notice = None
        if not ((place >= self._world.low) & (place <= self._world.high)).all():
            self.notice = "that is outside the world: click inside it"
            return
        fixed = event.button == "right"
        velocity, color = None, FIXED_COLOR
        if not fixed:
            dim = self._world.dim
            velocity = self._rng.uniform(VELOCITY_LOW[:dim], VELOCITY_HIGH[:dim])
            color = COLOR_CYCLE[self._thrown % len(COLOR_CYCLE)]
            self._thrown += 1
        tied_to = self._newest if self._space else None
        try:
            self._newest = self._sim.spawn(
                place, velocity, fixed=fixed, color=color, tied_to=tied_to
            )
        except InputError as error:
            self.notice = str(error)

    def before_frame(self) -> None:
        """Blow with the pointer's motion since the last frame began; call before `advance`.

        The first position that is ever seen comes with no displacement.
        """
        now, before = self._pointer, self._before
        self._before = now
        if self._world.mouse != "blow" or self._ctrl or before is None or (now == before).all():
            return
        here, there = self._layout.to_world(before), self._layout.to_world(now)
        if self._camera:
            displacement = self._camera.unproject(there) - self._camera.unproject(here)
            origin, direction = self._camera.ray(there)
            self._sim.blow_ray(origin, direction, displacement)
        else:
            self._sim.blow(there, there - here)

    def reset(self) -> None:
        """The scene is at its start again: forget the chain, colours and random numbers so far."""
        self._before = None
        self.notice = None
        self._start()
