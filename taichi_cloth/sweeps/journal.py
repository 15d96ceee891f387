"""A sweep's journal: what was measured, a line each, so that a sweep that was killed goes on.

`sweep.jsonl` begins with what the sweep is (its scene, its settings, the versions); each line after
that is a result with its key. Arrays are files of `sweep.files` beside it, which are on the disk
before the line that names them is. A line that a kill tore is as if it had never been begun; so is
one of which a checksum (CRC-32, of the line and of its file) says that it is not what was written.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import math
import os
import shutil
import sys
import threading
import time
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from typing import Any

from taichi_cloth.errors import InputError, clipped, counted
from taichi_cloth.files.pending import refusal

fcntl: Any = None  # where a system lacks it, two sweeps may write to one journal
with contextlib.suppress(ImportError):
    fcntl = importlib.import_module("fcntl")

NAME, FILES = "sweep.jsonl", "sweep.files"
FORMAT = 3  # of the lines: another one is another sweep's
WITHIN = "planned for"  # of the first line: the seconds that the sweep began with
BLOCK = 1 << 20  # bytes of a file that are read at once


@dataclass(frozen=True)
class Entry:
    """A finished result: JSON's values, and the file of its arrays, where it has one."""

    result: Any
    file: Path | None = None


def key_of(*parts: Any) -> str:
    """The key of a result: what it depends on, as JSON."""
    return json.dumps(parts, default=str)


class Journal:
    """The finished results of a sweep, by key; any thread may add to them.

    folder: where the journal lies. identity: what the sweep is, in words by name, which has to be
    the same when it goes on. resume: whether to go on with a journal that lies there; else that is
    dropped. within: the seconds that the sweep has; then, those for which it was planned when it
    began: it may go on in another time. Raises InputError where it is another sweep's, or another
    process writes to it.
    """

    def __init__(
        self,
        folder: Path,
        identity: Mapping[str, Any],
        resume: bool = False,
        within: float = math.inf,
    ):
        self.path, self._files = folder / NAME, folder / FILES
        self._header, self.within = {"journal": FORMAT, **identity}, within
        self._entries: dict[str, Entry] = {}
        self._lock, self._number = threading.Lock(), 0
        self._mine = f"{os.getpid()}-{time.time_ns():x}"  # of no other process
        with _on_disk(self.path):
            # Unbuffered: what a full disk refuses is not tried again when the file is closed.
            self._file: FileIO = self.path.open("a+b", buffering=0)
        try:
            self._take()
            with _on_disk(self.path):
                if resume:
                    self._read()
                if not self._entries:
                    self._begin()
        except BaseException:
            self._file.close()
            raise
        self.resumed = len(self._entries)

    def finished(self) -> list[str]:
        """The keys of all finished results, in the order in which they came."""
        with self._lock:
            return list(self._entries)

    def get(self, key: str) -> Entry | None:
        """The result of this key; None where it has to be measured."""
        with self._lock:
            return self._entries.get(key)

    def new_file(self, suffix: str) -> Path:
        """A file to write arrays to, which `add` then keeps."""
        with self._lock:
            self._number += 1
            # Of a process that was killed, workers may still write for a moment.
            return self._files / f"{self._mine}-{self._number}{suffix}"

    @contextlib.contextmanager
    def written(self, suffix: str) -> Iterator[Path]:
        """A `new_file` that is written as long as the context lasts, in this process."""
        file = self.new_file(suffix)
        with _on_disk(file):
            yield file

    def add(self, key: str, result: Any, file: Path | None = None) -> Entry:
        """Keep a result, on the disk before this returns; file: one of `new_file`, written.

        Raises InputError where the disk is full.
        """
        line: dict[str, Any] = {"key": key, "result": result}
        if file is not None:
            with _on_disk(file):
                _sync(file)
                _sync(self._files)
                size, crc = file.stat().st_size, _crc_of(file)
            line |= {"file": file.name, "bytes": size, "file's crc": crc}
        with self._lock:
            self._write(line | {"crc": _crc(line)})
            self._entries[key] = Entry(result, file)
            return self._entries[key]

    def once(self, key: str, measure: Callable[[], Any]) -> Any:
        """The result of this key, which is measured where it is not there yet."""
        entry = self.get(key) or self.add(key, measure())
        return entry.result

    def close(self) -> None:
        """Leave the journal for a sweep that goes on with it; without a result it goes."""
        if not self._entries:
            self.discard()
        self._file.close()

    def discard(self) -> None:
        """Remove the journal and its files: the sweep has come to its end."""
        shutil.rmtree(self._files, ignore_errors=True)
        with contextlib.suppress(OSError):
            self.path.unlink()
        self._file.close()

    def _take(self) -> None:
        """Keep other sweeps from this journal; they may have it once this process has ended."""
        if fcntl is None:
            return
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(
                f"{self.path}: another sweep writes to it; wait for its end, or name another folder"
            ) from None
        except OSError:  # a file system without locks
            pass

    def _begin(self) -> None:
        try:
            self._file.truncate(0)
            shutil.rmtree(self._files, ignore_errors=True)
            self._files.mkdir()
            self._write(self._header | {WITHIN: self.within})
        except BaseException:
            self.discard()
            raise

    def _write(self, line: Mapping[str, Any]) -> None:
        end, rest = os.fstat(self._file.fileno()).st_size, _as_json(line) + b"\n"
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
            os.fsync(self._file.fileno())
        except OSError as error:
            with contextlib.suppress(OSError):
                self._file.truncate(end)  # a half of a line would spoil the next one
            raise refusal(self.path, error) from None

    def _read(self) -> None:
        """Take what an earlier run finished, and cut off the line that it was torn from."""
        self._file.seek(0)
        text = self._file.read()
        whole = text[: text.rfind(b"\n") + 1]
        lines = [self._parsed(number, line) for number, line in enumerate(whole.splitlines(), 1)]
        if not lines:
            return
        within = lines[0].pop(WITHIN, None)
        self._check(lines[0])
        self.within = within if isinstance(within, float) else self.within
        for line in lines[1:]:
            if line.pop("crc", None) != _crc(line):
                continue
            file = self._files / line["file"] if "file" in line else None
            if file is None or _is_whole(file, line):
                self._entries[line["key"]] = Entry(line["result"], file)
        self._file.truncate(len(whole))
        self._files.mkdir(exist_ok=True)
        named = {entry.file for entry in self._entries.values()}
        for file in self._files.iterdir():
            if file not in named:
                file.unlink()

    def _parsed(self, number: int, line: bytes) -> dict[str, Any]:
        try:
            parsed = json.loads(line)
            if isinstance(parsed, dict) and (
                _is_entry(parsed) if number > 1 else "result" not in parsed
            ):
                return parsed
        except (ValueError, RecursionError):  # the latter of what is nested too deeply
            pass
        raise InputError(
            f"--resume {self.path}: line {number} is none of a journal; start anew without --resume"
        )

    def _check(self, header: Mapping[str, Any]) -> None:
        """See that a journal is this sweep's; raises InputError that says what of it is not."""
        mine = json.loads(json.dumps(self._header, default=str))
        for name in dict.fromkeys([*mine, *header]):
            if header.get(name) != mine.get(name):
                was, wanted = (clipped(str(of.get(name)), 200) for of in (header, mine))
                there, here = ("are", "they are") if name.endswith("s") else ("is", "it is")
                raise InputError(
                    f"--resume {self.path}: is another sweep's: its {name} {there} '{was}', here "
                    f"{here} '{wanted}'; ask for what it was begun with, or start anew without "
                    "--resume"
                )


def _is_entry(line: Mapping[str, Any]) -> bool:
    """True if a line has a result with its key, and of a file its name and size."""
    named = isinstance(line.get("file"), str) and isinstance(line.get("bytes"), int)
    without = not {"file", "bytes"} & line.keys()
    return "result" in line and isinstance(line.get("key"), str) and (named or without)


def _crc(line: Mapping[str, Any]) -> int:
    """The checksum of a line, which is the same before it is written and after it was read."""
    return zlib.crc32(_as_json(line))


def _crc_of(file: Path) -> int:
    crc = 0
    with file.open("rb") as content:
        while block := content.read(BLOCK):
            crc = zlib.crc32(block, crc)
    return crc


def _is_whole(file: Path, line: Mapping[str, Any]) -> bool:
    """True if a line's file is there, and as it was when the line was written."""
    there = file.is_file() and file.stat().st_size == line["bytes"]
    return there and _crc_of(file) == line.get("file's crc")


def _as_json(line: Mapping[str, Any]) -> bytes:
    return json.dumps(line, default=str).encode()


@contextlib.contextmanager
def _on_disk(path: Path) -> Iterator[None]:
    """Raise InputError with the path where the disk is full, or a folder cannot be written to."""
    try:
        yield
    except OSError as error:
        raise refusal(path, error) from None


def _sync(path: Path) -> None:
    """See that a file, or the names in a folder, are on the disk."""
    with contextlib.suppress(PermissionError):  # of folders, on systems that do not open them
        handle = os.open(path, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


@contextlib.contextmanager
def kept(
    folder: Path,
    identity: Mapping[str, Any],
    resume: bool,
    quiet: bool = False,
    within: float = math.inf,
) -> Iterator[Journal]:
    """A sweep's journal, as long as the context lasts: what ends that early leaves it there.

    Standard error says with what it goes on, unless `quiet`, and always what is left: who ended it
    has to know.
    """
    journal = Journal(folder, identity, resume, within)
    if resume and not quiet:
        found = counted(journal.resumed, "finished result")
        if journal.within != within:
            begun = f"{journal.within:g} s" if math.isfinite(journal.within) else "any time"
            found += f", of what was planned for {begun}"
        says = f"goes on with {found}" if journal.resumed else "there is none: this begins anew"
        print(f"--resume {journal.path}: {says}", file=sys.stderr, flush=True)
    try:
        yield journal
    except BaseException:
        journal.close()
        if count := len(journal.finished()):
            left = f"{counted(count, 'finished result')} in {journal.path}"
            print(f"--resume goes on with {left}", file=sys.stderr, flush=True)
        raise
    journal.discard()
