"""NumPy archives (``.npz``) that a user names: how they are read, and what is noted in them."""

from __future__ import annotations

import contextlib
import json
import os
import stat
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from taichi_cloth.errors import InputError

# What NumPy and zipfile raise for files that are something else, or damaged.
_UNREADABLE = (
    *(OSError, ValueError, EOFError, AttributeError, TypeError, MemoryError, OverflowError),
    *(RuntimeError, SyntaxError, LookupError, tokenize.TokenError),
    *(zipfile.BadZipFile, zlib.error, struct.error),
)


def noted(name: str, given: Any) -> str:
    """The note in an archive beside its arrays, as a text in JSON; None: there is none.

    NumPy's numbers are written as Python's. name: what it is called where it is refused.
    """
    given = {} if given is None else given
    try:
        if isinstance(given, Mapping):
            return json.dumps(dict(given), default=_of_numpy)
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(f"{name} cannot be written as JSON: {error}") from None
    raise InputError(f"{name} must be a mapping, is of type {type(given).__name__}")


def _of_numpy(value: Any) -> Any:
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    raise TypeError(f"it has a value of type {type(value).__name__}")


def read(path: Path, what: str) -> dict[str, np.ndarray]:
    """The arrays of the archive at `path`, by name. what: it should be, such as "checkpoint".

    InputError where there is none, or it cannot be read. What holds Python objects is refused:
    these could do anything. So is a pipe, which has no end that one could begin at, and would be
    waited for.
    """
    try:
        mode = path.stat().st_mode
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
            raise InputError(f"{path}: is no file but a pipe or a device; name the {what} itself")
        with path.open("rb") as file:
            if not zipfile.is_zipfile(file):
                raise InputError(f"{path}: is no {what}: it is no .npz archive, or a part of one")
            _refuse_larger_than_memory(path, zipfile.ZipFile(file))
            file.seek(0)
            with np.load(file, allow_pickle=False) as archive:
                return {name: archive[name] for name in archive.files}
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file") from None
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder; name the {what} in it") from None
    except PermissionError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except _UNREADABLE as error:
        raise InputError(f"{path}: is no {what} that can be read: {error}") from None


def _refuse_larger_than_memory(path: Path, archive: zipfile.ZipFile) -> None:
    """Refuse what would take more memory than there is: the system would end the program for it."""
    needed, there = sum(member.file_size for member in archive.infolist()), 0
    with contextlib.suppress(AttributeError, OSError, ValueError):  # else nobody says
        there = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    if needed > there > 0:
        raise InputError(
            f"{path}: would take {needed / 2**30:.3g} GiB of memory, and this machine has "
            f"{there / 2**30:.3g} GiB"
        )
