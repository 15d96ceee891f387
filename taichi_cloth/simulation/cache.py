"""JSON files in the user's cache folder: what runs have learned for runs to come."""

from __future__ import annotations

import contextlib
import functools
import json
import os
from pathlib import Path
from typing import Any, BinaryIO

from taichi_cloth.errors import InputError
from taichi_cloth.files.pending import PendingFile


def folder() -> Path:
    """The folder that they are in."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "taichi-cloth"


def read(name: str) -> Any:
    """The contents of a file; None where there is none, or none that can be read."""
    try:
        return json.loads((folder() / name).read_text())
    except (OSError, ValueError):
        return None


def write(name: str, content: object) -> None:
    """Replace a file. One that cannot be written costs the next run a little, and no word."""
    text = json.dumps(content, indent=1).encode()
    with contextlib.suppress(OSError, InputError):
        folder().mkdir(parents=True, exist_ok=True)
        PendingFile(folder() / name).fill(functools.partial(_put, text))


def _put(text: bytes, file: BinaryIO) -> None:
    file.write(text)
