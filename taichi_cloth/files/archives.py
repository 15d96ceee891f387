"""Reading a NumPy archive (``.npz``) that a user names."""

from __future__ import annotations

import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np

from taichi_cloth.errors import InputError

# What NumPy and zipfile raise for files that are something else, or damaged.
_UNREADABLE = (
    *(OSError, ValueError, EOFError, AttributeError, TypeError, MemoryError, OverflowError),
    *(RuntimeError, SyntaxError, zipfile.BadZipFile, zlib.error, struct.error),
)


def read(path: Path, what: str) -> dict[str, np.ndarray]:
    """The arrays of the archive at `path`, by name. what: it should be, such as "checkpoint".

    InputError where there is none, or it cannot be read. What holds Python objects is refused:
    these could do anything.
    """
    try:
        with path.open("rb") as file:
            if not zipfile.is_zipfile(file):
                raise InputError(f"{path}: is no {what}: it is no .npz archive, or a part of one")
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
