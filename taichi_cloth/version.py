"""The program's version, for whoever writes it into a file or shows it."""

from __future__ import annotations

__version__ = "0.1.0"
