"""Files that appear whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from taichi_cloth.errors import InputError


class PendingFile:
    """A file being written beside `path`, under another name until `commit`.

    Made before a long run, it shows at once whether the path can be written: raises InputError
    if not. file: binary, open for reading and writing.
    """

    def __init__(self, path: str | os.PathLike):
        self.path = Path(path)
        # What a link points to is replaced, not the link.
        self._target = Path(os.path.realpath(self.path))
        self._temporary: str | None = None
        # A device or a pipe, such as /dev/null, is written to at the end, never replaced.
        self._is_device = False
        try:
            if self._target.is_dir():
                raise IsADirectoryError
            if self._target.exists() and not os.access(self._target, os.W_OK):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
            if self._target.exists() and not self._target.is_file():
                self._is_device = True
                self.file: BinaryIO = tempfile.TemporaryFile()  # noqa: SIM115
                return
            # Beside the target, so that both are on one disk and the last step is one renaming.
            handle, self._temporary = tempfile.mkstemp(
                prefix=f"{self._target.name}.", suffix=".part", dir=self._target.parent
            )
        except IsADirectoryError:
            raise InputError(f"{self.path}: is a folder; name a file in it") from None
        except FileNotFoundError:
            raise InputError(
                f"{self.path}: cannot be written: there is no folder '{self.path.parent}'"
            ) from None
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise InputError(f"{self.path}: cannot be written: {reason}") from None
        self.file = os.fdopen(handle, "w+b")

    def commit(self) -> None:
        """Finish the file and give it its name, in place of what was there. Once only."""
        if self.file.closed:
            return
        try:
            if self._is_device:
                self.file.seek(0)
                with open(self._target, "wb") as device:
                    shutil.copyfileobj(self.file, device)
                self.file.close()
                return
            self.file.flush()
            self.file.close()
            # Temporary files are private; this one gets what any new file would get.
            mask = os.umask(0)
            os.umask(mask)
            os.chmod(self._temporary, 0o666 & ~mask)
            os.replace(self._temporary, self._target)
        except OSError as error:
            self.discard()
            raise InputError(f"{self.path}: cannot be written: {error.strerror}") from None

    def fill(self, write: Callable[[BinaryIO], None]) -> None:
        """Let `write` write the file, then commit; a disk that is full raises InputError."""
        try:
            write(self.file)
        except OSError as error:
            self.discard()
            raise InputError(f"{self.path}: cannot be written: {error.strerror}") from None
        self.commit()

    def discard(self) -> None:
        """Leave nothing behind, unless already committed."""
        with contextlib.suppress(OSError):  # a full device refuses what was not written yet
            self.file.close()
        if self._temporary is not None:
            with contextlib.suppress(OSError):
                os.unlink(self._temporary)
