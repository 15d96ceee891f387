"""Plain drawing as what a frame's time takes last: where pictures alone make frames late.

Fewer substeps are no help there. What is drawn without smooth edges takes less, where a view draws
these in layers, and without the discs of particles that have springs, which these show. It stays
so until frames would have had the time for all of it for a while.
"""

from __future__ import annotations

from taichi_cloth.budgets.frames import IN_TIME, UP, FrameTimes

RESTED = 60  # looks in a row, each at the last frames, at which there was time for smooth edges


class Drawing:
    """Whether pictures are drawn plainly, for a frame's time."""

    def __init__(self) -> None:
        self.plain = False
        self._took = 0.0  # what was not to simulate when edges were smooth, seconds
        self._saves: float | None = None  # what plain ones save of that
        self._rested = 0

    def look(self, times: FrameTimes, substeps: int, least: int) -> None:
        """Look at the last frames: have them drawn otherwise from now on, where that is due."""
        if not times.settled:
            return
        if not self.plain:
            if substeps == least and times.late_by_drawing(substeps):
                self.plain, self._took, self._saves = True, times.usual_rest, None
                times.draw_otherwise()
            return
        if self._saves is None:
            self._saves = max(self._took - times.usual_rest, 0.0)
        late = times.late(least, UP, self._saves)
        self._rested = self._rested + 1 if late <= 1 - IN_TIME else 0
        if self._rested >= RESTED:
            self.plain, self._rested = False, 0
            times.draw_otherwise()
