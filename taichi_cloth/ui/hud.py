"""Words of the status and of the key list, and the meter of their rates."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from taichi_cloth.errors import counted
from taichi_cloth.render import style
from taichi_cloth.scene.model import Scene
from taichi_cloth.ui import tools
from taichi_cloth.ui.chrome.strip import Row
from taichi_cloth.ui.chrome.toolbar import Button
from taichi_cloth.ui.plane_moves import PANS
from taichi_cloth.ui.schedule import FRAME_RATE
from taichi_cloth.ui.text import Word
from taichi_cloth.ui.tools.contract import Tool

if TYPE_CHECKING:
    from taichi_cloth.simulation.simulation import Simulation

WINDOW = 0.75  # seconds over which rates are averaged
ON_TIME = 0.95  # of these: fewer a second are late
LATE = 2.0  # seconds for which frames have come late before it is said what would be faster
BUSY = 0.9  # of a frame's time: where they take less to simulate and draw, something else is slow
REFRESH = 0.4  # seconds between changes of the rates: each takes 2 to 4 ms to write and draw
# Beside the rates, where the execution was asked for and threads only wait.
HELD_UP = Word("threads wait for another program", style.WARN, 4)

# Where no particle is in the picture.
LOST = "nothing is in view: f frames what there is, r goes back to the start"

# Where the run has failed, and keys ask for a frame more.
STOPPED = "no frame follows here: r begins anew, left goes back, to go on from there"


class Meter:
    """Measures frames: how long they take to simulate and to draw, and how many a second."""

    def __init__(self, clock: Callable[[], float] = time.perf_counter):
        self._clock = clock
        self._frames: deque[tuple[float, float, float]] = deque()
        self._busy = 0.0  # seconds since frames began to be due, pauses left out
        self._done = 0
        self._last: float | None = None
        self._late_since: float | None = None
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
        if self.frames_per_second > ON_TIME * FRAME_RATE:
            self._late_since = None
        elif self._late_since is None:
            self._late_since = now

    def interrupt(self) -> None:
        """Frames are not due until the next one (a pause)."""
        self._last = self._late_since = None
        self._frames.clear()

    def compiles(self) -> None:
        """The next frame compiles: nothing is late, and what it takes says nothing of the next."""
        self.interrupt()
        self._skip = True

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
    def late(self) -> float:
        """Seconds for which frames have come late all the time; 0: they do not."""
        if self._late_since is None or self._last is None:
            return 0.0
        return self._last - self._late_since

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


def rates(meter: Meter, advice: Word | None = None) -> tuple[Word, ...]:
    """The rates of a window and the time of a frame. advice: what would be `faster`."""
    rate = meter.frames_per_second
    if rate == 0:
        return ()
    late = rate <= ON_TIME * FRAME_RATE
    said = f"{rate:.{0 if rate >= 9.95 else 1}f} frames/s"
    words = [Word(said, style.WARN if late else style.GOOD, 1)]
    if late and advice is not None:
        words.append(advice)
    if late:
        speed = rate / FRAME_RATE
        behind = f"{meter.behind:.1f} s behind real time ({speed:.2f}x)"
        words.append(Word(behind, style.WARN, 5))
    words.append(Word(f"simulate {1e3 * meter.simulate:.2f} ms", style.MUTED, 6))
    words.append(Word(f"draw {1e3 * meter.draw:.1f} ms", style.MUTED, 7))
    return tuple(words)


def faster(meter: Meter, *, shortens: Callable[[], bool]) -> Word | None:
    """The one thing by which late frames would be shorter; None: they are not late, or nothing is
    known to help.

    shortens: whether to hold frames a second would make frames shorter; asked only where that is
    the matter.
    """
    simulate, draw = meter.simulate, meter.draw
    if meter.late < LATE or simulate + draw < BUSY / FRAME_RATE:
        return None
    if draw > simulate:
        helps = "smaller window"
    elif shortens():
        helps = f"hold {FRAME_RATE:.0f}fps (o)"
    else:
        return None
    return Word(f"faster: {helps}", style.KEY_INK, 5)


def buttons(
    scene: Scene,
    tool: Tool[Any] | None,
    opens: Sequence[Button] = (),
    *,
    paused: bool,
    tied: bool = False,
    strain: bool = False,
    ghost: bool = False,
) -> tuple[Button, ...]:
    """The tool bar's: tools that have a key, then at the right end `opens`, what can be opened.

    tied: whether there are springs now, also in a scene that came with none.
    """
    found = [
        Button(other.key, other.name, chosen=other is tool)
        for other in tools.load_all().values()
        if other.key
    ]
    found.append(Button("p", "play" if paused else "pause", chosen=paused, right=True))
    found += opens
    if len(scene.triangles):
        found.append(Button("d", "draw", right=True))
    if tied or len(scene.springs):
        found.append(Button("e", "strain", chosen=strain, right=True))
    found.append(Button("y", "ghost", chosen=ghost, right=True))
    found += [Button("h", "status", right=True), Button("tab", "keys", right=True)]
    return tuple(found)


def status_rows(
    sim: Simulation,
    device: str,
    *,
    state: Word | None,
    tool: str | None = None,
    rates: Sequence[Word] = (),
    notice: str | None = None,
    budget: Word | None = None,
    found: Word | None = None,
    whole: bool = False,
) -> tuple[Row, ...]:
    """The status of the frame that `sim` is at: counts, time; then settings and backend.

    device: from `Device.describe()`. state: of a window, such as "playing"; None without one, whose
    pictures say nothing that may be otherwise in the next run of the same. tool: the one in hand.
    rates: how fast a window runs. notice: what is told in the place of the first row's words,
    before all others where room is scarce.
    budget: what is held.
    found: what differs first in a run beside it.
    whole: whether a window shows all rows, so that `h` shows none.
    """
    alive = len(sim.drawn_springs())
    broken = sim.spring_count - alive
    names = (Word(f"frame {sim.frame}", style.MUTED, 8), Word(f"time {sim.time:.6g}", style.INK, 3))
    counts = (
        Word(counted(sim.particle_count, "particle"), style.INK, 4),
        Word(f"{counted(alive, 'spring')}, {broken} broken", style.INK, 4),
        *([Word("at rest", style.INK, 4)] if sim.at_rest() else []),
    )
    settings = _settings(sim, device, windowed=state is not None)
    if budget is not None:
        settings = (settings[0], budget, *settings[1:])
    more = (found,) if found else ()
    if state is None:
        first = Row((Word(sim.scene.name, style.INK), *more, *counts), (*names,))
        return first, Row(settings)
    title = (state, Word(sim.scene.name, style.INK, 2))
    hand = (Word(tool, style.KEY_INK, 1),) if tool else ()
    aside = (Word(sim.aside, style.MUTED, 7),) if sim.aside else ()
    usual = (*title, *hand, *more, *counts, *aside)
    if notice:
        usual = (replace(state, rank=state.rank + 1), Word(notice, style.KEY_INK))
    hints = (
        Word("h none" if whole else "h more", style.MUTED, 9),
        Word("tab keys", style.MUTED, 9),
    )
    pace = rates or names[:1]  # where time stands still, which frame is seen
    return Row(usual, (*pace, *hints)), Row((*settings,), names)


def _settings(sim: Simulation, device: str, *, windowed: bool) -> tuple[Word, ...]:
    """Method, step and backend; what went wrong with the method beside it."""
    step = f"dt {sim.dt:g}" + (f" in {sim.substeps} substeps" if sim.substeps > 1 else "")
    words = [Word(sim.method, style.INK)]
    unconverged, unsettled = sim.work().unconverged, sim.unsettled()
    if unconverged:
        words.append(Word(f"{unconverged} steps unconverged", style.BAD))
    if unsettled:
        words.append(Word(f"{unsettled} steps with overlaps", style.WARN))
    if sim.unguarded():
        words.append(Word(f"{sim.unguarded()} pairs unguarded", style.WARN))
    path = f"{device}, {sim.way}" if windowed else device
    return (*words, Word(step, style.INK, 1), Word(path, style.MUTED, 2))


def reset_notice(frames: int) -> str:
    """The effect of going back to the start on `--save` and `--export` of so many frames."""
    return f"back to the start: the next frame makes files forget {counted(frames, 'frame')}"


def _drags(tool: Tool[Any] | None, *, space: bool) -> list[str]:
    """Buttons that move the camera or the picture: those that the tool in hand leaves."""
    taken, hits = (tool.buttons, tool.hits) if tool else ((), None)

    def line(buttons: Iterable[str], does: str, *others: str) -> list[str]:
        free = [button for button in buttons if hits or button not in taken]
        shared = " or ".join(button for button in free if button in taken)
        where = f" ({shared}: where it is empty)" if shared else ""
        how = [f"drag {' or '.join(free)}"] * bool(free) + [*others]
        return [f"{', '.join(how)}\t{does}{where}"] if how else []

    if not space:
        return line(reversed(PANS), "move the picture")
    turn = line(["left"], "turn the scene", "ctrl + motion")
    return turn + line(["right"], "move the scene")


def help_lines(
    scene: Scene,
    has_wheel: bool,
    tool: Tool[Any] | None = None,
    *,
    saves: bool = False,
    tied: bool = False,
    file: bool = False,
) -> tuple[str, ...]:
    """Every key and mouse action of this scene, as "key<tab>action".

    tool: the one in hand; None: the one that the pointer is from the start.
    saves: whether the run keeps a trajectory or an export, which a reset shortens.
    tied: whether there are springs now, also in a scene that came with none.
    file: whether going back to the start reads the scene's file anew.
    """
    tool = tool or tools.for_mouse(scene.world.mouse)
    lines = list(tool.actions(scene)) if tool else []
    lines += [f"{other.key}\t{other.help}" for other in tools.load_all().values() if other.key]
    nearer = "wheel, + -, up down" if has_wheel else "+ -, up down"
    lines.append(f"{nearer}\tcome nearer, go farther")
    lines += _drags(tool, space=scene.world.dim == 3)
    what = "fill the picture with what there is", "all of the world, or of what left it"
    lines.append(f"f\t{what[0] if scene.world.dim == 3 else what[1]}")
    lines.append("z, home\tthe view before; that of the start")
    lines += [
        "o\tsettings, live; by up down, left right",
        "l\tthe last 10 seconds, to go through",
        ("p" if tool and "space" in tool.modifiers else "space, p") + "\tpause and go on",
        ".  or right arrow\tone frame, while paused",
        ",  or left arrow\tone frame back, in the last 10 s",
        "q\tslow motion: half as fast, down to 1/16",
        "r\tback to the start"
        + ("; reads an edited file" if file else "")
        + ("; what is saved begins anew" if saves else ""),
        *(["d\tdraw surface, springs, particles"] if len(scene.triangles) else []),
        *(["e\tcolours of strain"] if tied or len(scene.springs) else []),
        "m\tmeters: the last 10 seconds",
        "a\thow wrong the last second was",
        "k\twhy a run stopped; u: go on with what survives",
        "y\tghost: where finer steps would be",
        "h\tmore of the status, or none",
        "s\tsave a picture",
        "v\tfilm, until v again",
        "w\twrite a checkpoint, for run --resume",
        "x\texport the last 10 seconds",
        "tab or f1\tthis list",
        "escape\tclose the last, put the tool away; else quit",
    ]
    return tuple(lines)
