"""Files that appear whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import stat
import tempfile
import weakref
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import BinaryIO

from taichi_cloth.errors import InputError

_unfinished: set[str] = set()  # files and folders that are being written, under other names


class PendingFile:
    """A file being written beside `path`, under another name until `commit`.

    Made before a long run, it shows at once whether the path can be written: raises InputError
    if not. file: binary, open for reading and writing.

    What nobody commits, because a program forgets it or ends by an error, leaves nothing behind.
    """

    def __init__(self, path: str | os.PathLike[str]):
        self.path = self._target = Path(path)
        # None for a device or a pipe, such as /dev/null: that is written to at the end, and never
        # replaced.
        self._temporary: str | None = None
        try:
            if not is_device(self.path):  # a pipe's link, such as /dev/stdout, names nothing
                # What a link points to is replaced, not the link.
                self._target = Path(os.path.realpath(self.path))
            if self._target.is_dir():
                raise IsADirectoryError
            if self._target.exists():
                _refuse_kept(self._target)
            if not is_device(self._target):
                # Beside the target, so that both are on one disk and the last step is one renaming.
                handle, self._temporary = tempfile.mkstemp(
                    prefix=f"{self._target.name}.", suffix=".part", dir=self._target.parent
                )
        except IsADirectoryError:
            raise InputError(f"{self.path}: is a folder; name a file in it") from None
        except FileNotFoundError as error:
            of = self._target if self.path.is_symlink() else self.path
            if of.parent.is_dir():  # as /proc is, in which nobody makes files
                raise refusal(self.path, error) from None
            raise InputError(
                f"{self.path}: cannot be written: there is no folder '{of.parent}'"
            ) from None
        except (OSError, ValueError) as error:
            raise refusal(self.path, error) from None
        if self._temporary is None:
            self.file: BinaryIO = _nameless(self.path)
            return
        self.file = os.fdopen(handle, "w+b")
        _unfinished.add(self._temporary)
        self._forgotten = weakref.finalize(self, _remove, self.file, self._temporary, os.getpid())

    def write(self, content: bytes) -> None:
        """Append to the file; a disk that is full raises InputError."""
        try:
            self.file.write(content)
        except OSError as error:
            self.discard()
            raise refusal(self.path, error) from None

    def cut(self, size: int) -> None:
        """Have the file end after so many bytes, where `write` goes on; raises as that does."""
        try:
            self.file.seek(size)  # which writes what was not written yet
            self.file.truncate()
        except OSError as error:
            self.discard()
            raise refusal(self.path, error) from None

    def commit(self) -> None:
        """Finish the file and give it its name, in place of what was there. Once only."""
        if self.file.closed:
            return
        try:
            if self._temporary is None:  # a device
                self.file.seek(0)
                with open(self._target, "wb") as device:
                    shutil.copyfileobj(self.file, device)
                self.file.close()
                return
            self.file.flush()
            self.file.close()
        except OSError as error:
            self.discard()
            raise refusal(self.path, error) from None
        with contextlib.suppress(OSError):  # not every kind of disk has them
            os.chmod(self._temporary, _permissions(self._target))
        try:
            os.replace(self._temporary, self._target)
        except OSError as error:  # the target became a folder, or is one of a container's mounts
            self._forgotten.detach()
            reason = str(error.strerror)
            if os.path.exists(self._temporary):  # else its folder was removed
                reason += f"; all of it is in {self._temporary}"
            raise InputError(f"{self.path}: cannot be written: {reason}") from None
        self._forgotten.detach()
        _unfinished.discard(self._temporary)

    def fill(self, write: Callable[[BinaryIO], object]) -> None:
        """Let `write` write the file, then commit; a disk that is full raises InputError."""
        try:
            write(self.file)
        except OSError as error:
            self.discard()
            raise refusal(self.path, error) from None
        except BaseException:  # an interrupt
            self.discard()
            raise
        self.commit()

    def discard(self) -> None:
        """Leave nothing behind, unless already committed."""
        if self._temporary is not None:
            self._forgotten()
            return
        with contextlib.suppress(OSError):
            self.file.close()


def _remove(file: BinaryIO, path: str, process: int) -> None:
    """Close and remove a file of this process: a copy of it, as of a fork, removes none."""
    if os.getpid() != process:
        return
    with contextlib.suppress(OSError):  # a full device refuses what was not written yet
        file.close()
    with contextlib.suppress(OSError):
        os.unlink(path)
    _unfinished.discard(path)


def unfinished(path: Path) -> None:
    """Have `discard_all` remove a file or folder, too, that something else writes."""
    _unfinished.add(str(path))


def discard_all() -> None:
    """Remove all that is not finished, before the process ends at once."""
    for path in list(_unfinished):
        if os.path.isdir(path):
            shutil.rmtree(path, ignore_errors=True)
        else:
            with contextlib.suppress(OSError):
                os.unlink(path)


def _refuse_kept(target: Path) -> None:
    """Raise PermissionError where a file that is there is not to be replaced by this user."""
    if not os.access(target, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    if is_device(target) or not hasattr(os, "geteuid"):
        return
    # In a folder such as /tmp nobody replaces files of others, also such that all may write to.
    folder = target.parent.stat()
    may = os.geteuid() in (0, target.stat().st_uid, folder.st_uid)
    if folder.st_mode & stat.S_ISVTX and not may:
        raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))


def _nameless(path: Path) -> BinaryIO:
    """A temporary file for what `path` is to get; InputError where no folder takes one."""
    try:
        return tempfile.TemporaryFile()
    except OSError as error:
        raise refusal(path, error) from None


def _permissions(target: Path) -> int:
    """Those that a file written there gets: what the one has that it replaces, else a new file's.

    Temporary files are private.
    """
    try:
        return stat.S_IMODE(target.stat().st_mode)
    except OSError:
        return 0o666 & ~creation_mask()


def refusal(path: str | os.PathLike[str], error: Exception) -> InputError:
    """The error to raise where a path cannot be written, with the system's reason."""
    reason = getattr(error, "strerror", None) or error
    return InputError(f"{path}: cannot be written: {reason}")


def creation_mask() -> int:
    """The permissions that new files and folders do not get."""
    mask = os.umask(0)
    os.umask(mask)
    return mask


def is_device(path: Path) -> bool:
    """True if it is neither a file nor a folder, such as /dev/null: it takes all that comes."""
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):  # what cannot be looked at is refused where it is written
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def write_whole(path: str | os.PathLike[str], content: bytes) -> None:
    """Write a file that appears whole or not at all; raises InputError where it cannot."""
    PendingFile(path).fill(lambda file: file.write(content))


def write_all(contents: Mapping[Path, bytes]) -> None:
    """Write files, all of them or, where a disk is full, none; raises InputError."""
    with contextlib.ExitStack() as unfinished:
        pending = []
        for path, content in contents.items():
            file = PendingFile(path)
            unfinished.callback(file.discard)
            pending.append(file)
            try:
                file.file.write(content)
                file.file.flush()
            except OSError as error:
                raise refusal(path, error) from None
        for file in pending:
            file.commit()


@contextlib.contextmanager
def folder_of_results(folder: Path, names: Iterable[str]) -> Iterator[None]:
    """A folder that `prepare_folder` made, for as long as the context lasts; empty, it goes."""
    there = os.path.exists(folder)
    try:
        prepare_folder(folder, names)
        yield
    finally:
        if not there:
            with contextlib.suppress(OSError):
                folder.rmdir()


def make_folder(flag: str, folder: Path) -> None:
    """Make a folder that a flag names, unless it is there; InputError where it cannot be made."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise InputError(f"{flag} {folder}: cannot be made: it is a file") from None
    except OSError as error:
        raise InputError(f"{flag} {folder}: cannot be made: {error.strerror}") from None


def prepare_folder(folder: Path, names: Iterable[str]) -> None:
    """See before a long run that files of these names can be written to a folder, which is made.

    A disk without room for a line is full.

    Raises InputError in the words of the flag `--output`, which names the folder.
    """
    make_folder("--output", folder)
    for name in names:
        pending = PendingFile(folder / name)
        try:
            pending.file.write(b" " * 80)
            pending.file.flush()
        except OSError as error:
            raise InputError(f"--output {folder}: cannot be written to: {error.strerror}") from None
        finally:
            pending.discard()
