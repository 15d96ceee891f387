"""The program's version, for whoever writes it into a file or shows it."""

from __future__ import annotations

__version__ = "1.0.0"
