"""The status of a window or a picture; its rates change now and then, so that one can read them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from taichi_cloth.ui import hud
from taichi_cloth.ui.chrome.strip import Row
from taichi_cloth.ui.text import Word

if TYPE_CHECKING:
    from taichi_cloth.simulation.simulation import Simulation

NOTICE_SECONDS = 4.0  # how long a word about the last click stays, or about threads that waited


@dataclass
class Status:
    """The words of the status.

    sim: of which. device: from `Device.describe()`. meter: of a window's rates.
    """

    sim: Simulation
    device: str
    meter: hud.Meter
    _rates: tuple[Word, ...] = ()
    _rates_due: float = 0.0
    _budget: Word | None = None
    _last: tuple[str | None, int] = None, 0  # what was told
    _now: float = 0.0
    _noticed: float = 0.0  # when that was new
    _held_up: tuple[float, float] | None = None
    _held_up_until: float = 0.0
    _lost: bool = False

    def hurry(self) -> None:
        """Have the rates read anew for the next frame."""
        self._rates_due = 0.0

    def told(self, seconds: float) -> str | None:
        """The last note, if it is no older than so many seconds."""
        return self._last[0] if self._now < self._noticed + seconds else None

    def rows(
        self,
        now: float,
        *,
        state: Word | None,
        moving: bool,
        tool: str | None,
        told: tuple[str | None, int],
        urgent: str | None = None,
        budget: Word | None = None,
        in_view: Callable[[], bool] | None = None,
        found: Word | None = None,
        faster: Callable[[], Word | None] = lambda: None,
        whole: bool = False,
    ) -> tuple[Row, ...]:
        """The status of the frame that `sim` is at.

        now: seconds, of a clock that without a window goes with the frames, so that the same run
        has the same pictures. state: of a window, in a word; None without one. moving: whether
        frames come, at full speed. tool: the one in hand. told: what was last, and how often
        anything was. urgent: what is told before. budget: what is held. in_view: says whether any
        particle is. found: what differs first in a run beside it. faster: says what would be.
        whole: whether all rows are shown.
        """
        if told != self._last:
            self._last, self._noticed = told, now
        self._now = now
        if state is not None:
            if self.sim.held_up is not self._held_up:  # found anew, for as long as it goes on
                self._held_up, self._held_up_until = self.sim.held_up, now + NOTICE_SECONDS
            if now < self._rates_due and budget is not None:
                budget = self._budget or budget
            self._budget = budget
            if now >= self._rates_due:
                self._rates_due = now + hud.REFRESH
                self._rates = hud.rates(self.meter, faster()) if moving else ()
                if now < self._held_up_until:
                    self._rates += (hud.HELD_UP,)
                self._lost = in_view is not None and not in_view()
        said = self.told(NOTICE_SECONDS) or (hud.LOST if self._lost else None)
        return hud.status_rows(
            self.sim,
            self.device,
            state=state,
            tool=tool,
            rates=self._rates,
            budget=budget,
            notice=urgent or said,
            found=found,
            whole=whole,
        )
