"""No window: runs whose pictures are drawn in memory, or not at all."""

from __future__ import annotations

from taichi_cloth.ui.presenters.contract import Kind

PRESENTER = Kind(name="none", rank=9, lack=lambda: None, open=None)
