"""What the status and the key list say, and the meter of their rates."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from taichi_cloth.errors import counted
from taichi_cloth.scene.model import Scene
from taichi_cloth.ui import tools
from taichi_cloth.ui.tools.contract import Tool

if TYPE_CHECKING:
    from taichi_cloth.simulation.simulation import Simulation

FRAME_RATE = 60.0  # frames a second that count as real time
WINDOW = 0.75  # seconds over which rates are averaged
REFRESH = 0.2  # seconds between changes of the rates: faster cannot be read
# Follows the rates where the execution was asked for, and threads only wait.
HELD_UP = "  \u00b7  threads wait for another program"


class Meter:
    """Measures frames: how long they take to simulate and to draw, and how many a second."""

    def __init__(self, clock: Callable[[], float] = time.perf_counter):
        self._clock = clock
        self._frames: deque[tuple[float, float, float]] = deque()
        self._busy = 0.0  # seconds since frames began to be due, pauses left out
        self._done = 0
        self._last: float | None = None
        self._skip = True

    def frame(self, simulate: float, draw: float) -> None:
        """One frame is done; it took `simulate` and `draw` seconds."""
        now = self._clock()
        if self._skip:  # the first frame compiles: what it took says nothing of the next
            self._skip, self._last = False, now
            return
        self._frames.append((now, simulate, draw))
        while now - self._frames[0][0] > WINDOW and len(self._frames) > 2:
            self._frames.popleft()
        if self._last is not None:
            self._busy += now - self._last
            self._done += 1
        self._last = now

    def interrupt(self) -> None:
        """Frames are not due until the next one (a pause)."""
        self._last = None
        self._frames.clear()

    def restart(self) -> None:
        """Forget what was late (the scene starts anew)."""
        self.interrupt()
        self._busy, self._done = 0.0, 0

    @property
    def frames_per_second(self) -> float:
        """Frames a second lately; 0 before the second frame."""
        if len(self._frames) < 2:
            return 0.0
        span = self._frames[-1][0] - self._frames[0][0]
        return (len(self._frames) - 1) / span if span > 0 else 0.0

    @property
    def simulate(self) -> float:
        """Mean seconds a frame took to simulate lately."""
        return sum(f[1] for f in self._frames) / max(len(self._frames), 1)

    @property
    def draw(self) -> float:
        """Mean seconds a frame took to draw lately."""
        return sum(f[2] for f in self._frames) / max(len(self._frames), 1)

    @property
    def behind(self) -> float:
        """Seconds by which the scene lags behind `FRAME_RATE` frames a second (0: on time)."""
        return max(0.0, self._busy - self._done / FRAME_RATE)


def rates_line(meter: Meter, *, paused: bool) -> str:
    """The first line of a window's status: how fast it runs, and what a frame takes."""
    rate = meter.frames_per_second
    if paused:
        pace = "paused"
    elif rate == 0 or rate > 0.95 * FRAME_RATE:
        pace = f"{rate:.0f} frames/s"
    else:
        speed = rate / FRAME_RATE
        pace = f"{rate:.0f} frames/s, {meter.behind:.1f} s behind real time ({speed:.2f}x)"
    return _row(pace, f"simulate {1e3 * meter.simulate:.2f} ms", f"draw {1e3 * meter.draw:.1f} ms")


def status_lines(
    sim: Simulation, device: str, *, rates: str | None, notice: str | None = None
) -> tuple[str, ...]:
    """The status of the frame that `sim` is at: counts, time, settings, backend.

    device: from `Device.describe()`. rates: a window's `rates_line`; None without a window, whose
    pictures say nothing that may be otherwise in the next run of the same.
    notice: a line that stands above; None: none.
    """
    alive = len(sim.drawn_springs())
    broken = sim.spring_count - alive
    step = f"dt {sim.dt:g}" + (f" in {sim.substeps} substeps" if sim.substeps > 1 else "")
    method, unconverged = sim.method, sim.work().unconverged
    if unconverged:
        method += f" ({unconverged} steps unconverged)"
    if sim.unsettled():
        method += f" ({sim.unsettled()} steps with overlaps)"
    counts = _row(
        f"{sim.particle_count} particles",
        f"{alive} springs, {broken} broken",
        f"time {sim.time:.6g}",
        f"frame {sim.frame}",
    )
    if rates is None:
        lines = [counts, _row(sim.scene.name, method, step, device)]
    else:
        path = f"{device}, {sim.execution} {sim.topology}"
        lines = [rates, counts, _row(sim.scene.name, method, step, path, "tab: keys")]
    return (notice, *lines) if notice else tuple(lines)


def _row(*parts: str) -> str:
    return "  \u00b7  ".join(parts)


def reset_notice(frames: int) -> str:
    """What going back to the start does to `--save`, of which `frames` are noted."""
    return f"back to the start: the next frame makes --save forget {counted(frames, 'frame')}"


def help_lines(
    scene: Scene, has_wheel: bool, tool: Tool[Any] | None = None, *, saves: bool = False
) -> tuple[str, ...]:
    """Every key and mouse action of this scene, as "key<tab>action".

    tool: the one in hand; None: the one that the pointer is from the start.
    saves: whether the run keeps a trajectory, which a reset shortens.
    """
    tool = tool or tools.for_mouse(scene.world.mouse)
    lines = list(tool.actions(scene)) if tool else []
    lines += [f"{other.key}\t{other.help}" for other in tools.load_all().values() if other.key]
    if scene.world.dim == 3:
        nearer = "wheel, + -, up down" if has_wheel else "+ -, up down"
        lines += [
            "drag left, ctrl + motion\tturn the scene (left: where it is empty)",
            "drag right\tmove the scene",
            f"{nearer}\tcome nearer, go farther",
            "f\tfill the picture with what there is",
            "z\tback to the view before",
        ]
    lines += [
        ("p" if tool and "space" in tool.modifiers else "space, p") + "\tpause and go on",
        ".  or right arrow\tone frame, while paused",
        ",  or left arrow\tone frame back, in the last 10 s",
        "m\tslow motion: half as fast, down to 1/16",
        "r\tback to the start" + ("; --save begins anew" if saves else ""),
        *(["d\tdraw surface, springs, particles"] if len(scene.triangles) else []),
        "h\thide or show the status",
        "s\tsave a picture",
        "v\tfilm, until v again",
        "tab or f1\tthis list",
        "escape\tquit",
    ]
    return tuple(lines)
