"""Reading a whole file that a user names, as bytes or as text."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from taichi_cloth.errors import InputError

# A scene of a million particles takes 60 MB. What is larger is no file that somebody wrote, or has
# no end, such as /dev/zero.
LARGEST = 2**29


def content(
    path: Path, what: str, hint: Callable[[Path], str] = lambda path: "", called: str = ""
) -> bytes:
    """The bytes of the file at `path`; raises InputError where it cannot be read.

    what: what it should be, such as "scene file". hint: what to add where there is no such file.
    called: how errors call it, if not by its path.
    """
    called = called or str(path)
    try:
        with open(path, "rb") as file:
            # What says its size is refused by it, before anything is read.
            large = os.fstat(file.fileno()).st_size > LARGEST
            read = b"" if large else file.read(LARGEST + 1)
    except FileNotFoundError:
        raise InputError(f"{called}: there is no such file{hint(path)}") from None
    except IsADirectoryError:
        raise InputError(f"{called}: is a folder; name the {what} in it") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{called}: cannot be read: {reason}") from None
    if large or len(read) > LARGEST:
        raise InputError(f"{called}: has more than {LARGEST >> 20} MiB, too much for a {what}")
    return read


def text(
    path: Path,
    what: str,
    hint: Callable[[Path], str] = lambda path: "",
    called: str = "",
    remedy: str = "save it as UTF-8",
) -> str:
    """Read the file at `path`; raises InputError where it cannot be read or is not in UTF-8.

    remedy: what to do then. The other parameters are those of `content`.
    """
    try:
        return content(path, what, hint, called).decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(
            f"{called or path}: is not a text file in UTF-8 (byte {error.start}); {remedy}"
        ) from None
