"""Interaction logs: what the user did, frame by frame.

A log is a text file, one JSON object a line, in frame order:
``{"frame": 0, "event": "move", "pos": [300.0, 200.0]}``. The first line may be a header:
``{"header": {...}}``. Events of frame f (from 0) are applied before that frame is advanced.

Here a line is a frame, the name of an event's kind, and fields. Which kinds there are and what
their fields hold is declared by those who make the events (`Kind`); `ui/interaction.py` reads the
logs of this program.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

from taichi_cloth.errors import InputError, clipped, nearest
from taichi_cloth.files.content import content
from taichi_cloth.files.pending import PendingFile

# Reads a field: (its name, its JSON value) -> the value that events carry. It raises InputError
# with a clause such as "pos must be two finite numbers, is [1]".
Reader = Callable[[str, Any], Any]

MOST_ITERATIONS = 1_000_000  # of a header: as many as the flag may say
_EXAMPLE = '{"frame": 0, "event": "move", "pos": [300, 200]}'


class Recordable(Protocol):
    """An event that a log can hold."""

    @property
    def kind(self) -> str:
        """The name of its kind."""

    def fields(self) -> dict[str, Any]:
        """Its fields as JSON values, in the order in which they are written."""


E = TypeVar("E", bound=Recordable)
E_co = TypeVar("E_co", bound=Recordable, covariant=True)


@dataclass(frozen=True)
class Kind(Generic[E_co]):
    """A kind of event: its name and its fields.

    name: the word in a line's "event".
    required: readers of the fields that each event has, by name.
    optional: readers of those that it may have.
    make: the event with these fields; it raises InputError where they do not go together.
    """

    name: str
    required: Mapping[str, Reader]
    optional: Mapping[str, Reader]
    make: Callable[[dict[str, Any]], E_co]

    @property
    def fields(self) -> dict[str, Reader]:
        """The readers of all fields, by name."""
        return {**self.required, **self.optional}

    def read(self, entry: Mapping[str, Any]) -> E_co:
        """The event whose fields are `entry`. Raises InputError with a clause that says why not."""
        _check_keys(entry, ("frame", "event", *self.fields))
        for name in self.required:
            if name not in entry:
                raise InputError(f"'{name}' is missing; a {self.name} event needs it")
        readers = self.fields.items()
        return self.make({name: read(name, entry[name]) for name, read in readers if name in entry})


@dataclass(frozen=True)
class Log(Generic[E]):
    """A log that was read: its header (empty if it has none) and its events by frame."""

    header: dict[str, Any] = field(default_factory=dict)
    by_frame: dict[int, list[E]] = field(default_factory=dict)

    @property
    def last_frame(self) -> int:
        """The last frame that has an event; -1 if none has."""
        return max(self.by_frame, default=-1)


def load(path: str | Path, kinds: Iterable[Kind[E]]) -> Log[E]:
    """The interaction log at `path`, whose events are of `kinds`.

    Raises InputError naming the first line that is wrong.
    """
    path, by_name = Path(path), {kind.name: kind for kind in kinds}
    log: Log[E] = Log()
    last_frame = 0
    for number, raw in enumerate(content(path, "interaction log").split(b"\n"), start=1):
        where = f"{path.name} line {number}"
        try:
            line = raw.decode("utf-8-sig" if number == 1 else "utf-8").strip()
        except UnicodeDecodeError:
            raise InputError(f"{where}: is not text in UTF-8") from None
        if not line:
            continue
        try:
            entry = _object(line)
            if "header" in entry:
                log.header.update(_header(number, entry))
                continue
            frame, event = _event(entry, by_name)
            if frame < last_frame:
                raise InputError(
                    f"frame {frame} comes after frame {last_frame}; events must be in order"
                )
        except InputError as error:
            raise InputError(f"{where}: {error}") from None
        last_frame = frame
        log.by_frame.setdefault(frame, []).append(event)
    return log


def _object(line: str) -> dict[str, Any]:
    """The JSON object on a line, without NaN, infinities or repeated keys."""

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        entry = dict(pairs)
        if len(entry) < len(pairs):
            names = [name for name, _ in pairs]
            twice = next(name for name in names if names.count(name) > 1)
            raise InputError(f"'{twice}' is given twice")
        return entry

    def refuse_constant(word: str) -> None:
        raise InputError(f"numbers must be finite, found {word}")

    try:
        entry = json.loads(line, object_pairs_hook=unique, parse_constant=refuse_constant)
    except json.JSONDecodeError as error:
        raise InputError(f"is not JSON: {error.msg} (column {error.colno})") from None
    except (RecursionError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"is not JSON that can be read: {error}") from None
    if not isinstance(entry, dict):
        raise InputError(f"must be an object such as {_EXAMPLE}")
    return entry


def _header(number: int, entry: dict[str, Any]) -> dict[str, Any]:
    """The header that line `number` holds, checked."""
    if number != 1:
        raise InputError("a header can only be the first line")
    _check_keys(entry, ("header",))
    header = entry["header"]
    if not isinstance(header, dict):
        raise InputError("header must be an object in braces")
    _check_header(header)
    return header


def _check_header(header: dict[str, Any]) -> None:
    """Refuse values of the header's keys that a replay uses and that make no sense."""
    window, seed = header.get("window", [1, 1]), header.get("seed", 0)
    if not isinstance(window, list) or len(window) != 2 or not all(map(_is_count, window)):
        raise InputError(f"window must be [width, height] in pixels, is {show(window)}")
    if seed != 0 and not _is_count(seed):
        raise InputError(f"seed must be a whole number from 0, is {show(seed)}")
    for key in ("scene", "method", "topology", "precision", "beside", "version"):
        if not isinstance(header.get(key, ""), str):
            raise InputError(f"{key} must be a name, is {show(header[key])}")
    arguments = header.get("arguments", [])
    if not isinstance(arguments, list) or not all(isinstance(word, str) for word in arguments):
        raise InputError(f"arguments must be a list of texts, is {show(arguments)}")
    if not isinstance(header.get("tools", False), bool):
        raise InputError(f"tools must be true or false, is {show(header['tools'])}")
    dt, substeps = header.get("dt", 1.0), header.get("substeps", 1)
    if dt != "auto" and (not _is_finite(dt) or dt <= 0):
        raise InputError(f"dt must be a positive number or auto, is {show(dt)}")
    tolerance, iterations = header.get("tolerance", 1.0), header.get("iterations", 1)
    if not _is_finite(tolerance) or tolerance <= 0:
        raise InputError(f"tolerance must be a positive number, is {show(tolerance)}")
    if not _is_count(iterations) or iterations > MOST_ITERATIONS:
        raise InputError(
            f"iterations must be a whole number from 1 to {MOST_ITERATIONS}, is {show(iterations)}"
        )
    if not _is_count(header.get("model", 1)):
        raise InputError(f"model must be a whole number from 1, is {show(header['model'])}")
    if "start_frame" in header:
        whole_number("start_frame", header["start_frame"])
    if not _is_count(substeps):
        raise InputError(f"substeps must be a whole number from 1, is {show(substeps)}")


def _event(entry: dict[str, Any], kinds: Mapping[str, Kind[E]]) -> tuple[int, E]:
    """Frame and event of one line's object, checked."""
    for key in ("frame", "event"):
        if key not in entry:
            fields = (name for kind in kinds.values() for name in kind.fields)
            _check_keys(entry, ("frame", "event", *fields))
            raise InputError(f"'{key}' is missing; a line is such as {_EXAMPLE}")
    frame, name = whole_number("frame", entry["frame"]), entry["event"]
    if not isinstance(name, str) or name not in kinds:
        raise InputError(f"unknown event {show(name)}; {_hint(name, kinds)}")
    fields_only = {k: v for k, v in entry.items() if k not in ("frame", "event")}
    return frame, kinds[name].read(fields_only)


def _check_keys(entry: Mapping[str, Any], known: Iterable[str]) -> None:
    known = tuple(dict.fromkeys(known))
    for key in entry:
        if key not in known:
            raise InputError(f"unknown key '{key}'; {nearest(key, known)}")


def _hint(word: object, known: Iterable[str]) -> str:
    """The known word that is most like `word`; all of them where it is no word."""
    return nearest(word, known) if isinstance(word, str) else f"known: {', '.join(known)}"


# Readers of fields


def number(name: str, value: Any) -> float:
    """A finite number."""
    if not _is_finite(value):
        raise InputError(f"{name} must be a finite number, is {show(value)}")
    return float(value)


def whole_number(name: str, value: Any) -> int:
    """A whole number from 0, such as a particle's index."""
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise InputError(f"{name} must be a whole number from 0, is {show(value)}")
    return value


def pair(name: str, value: Any) -> tuple[float, float]:
    """Two finite numbers, such as a position in a window."""
    if not isinstance(value, list) or len(value) != 2 or not all(map(_is_finite, value)):
        raise InputError(f"{name} must be two finite numbers, is {show(value)}")
    return float(value[0]), float(value[1])


def numbers(count: int | None = None) -> Reader:
    """The reader of a list of so many finite numbers, such as a place; None: of any that many."""

    def read(name: str, value: Any) -> tuple[float, ...]:
        of = "finite numbers" if count is None else f"{count} finite numbers"
        if not isinstance(value, list) or not all(map(_is_finite, value)):
            raise InputError(f"{name} must be a list of {of}, is {show(value)}")
        if count is not None and len(value) != count:
            raise InputError(f"{name} must be a list of {of}, is {show(value)}")
        return tuple(map(float, value))

    return read


def indices(name: str, value: Any) -> tuple[int, ...]:
    """Numbers of particles or springs: one whole number from 0, or a list of such."""
    given = value if isinstance(value, list) else [value]
    return tuple(whole_number(name, one) for one in given)


def so_many_indices(fewest: int, most: int) -> Reader:
    """The reader of `indices` of which there are at least and at most so many."""

    def read(name: str, value: Any) -> tuple[int, ...]:
        found = indices(name, value)
        if not fewest <= len(found) <= most:
            count = f"{most}" if fewest == most else f"{fewest} to {most}"
            raise InputError(f"{name} must be a list of {count} whole numbers, is {show(value)}")
        return found

    return read


def flag(name: str, value: Any) -> bool:
    """True or false."""
    if not isinstance(value, bool):
        raise InputError(f"{name} must be true or false, is {show(value)}")
    return value


def text(name: str, value: Any) -> str:
    """A text."""
    if not isinstance(value, str):
        raise InputError(f"{name} must be a text, is {show(value)}")
    return value


def word_of(known: Iterable[str], shown: tuple[str, ...] | None = None) -> Reader:
    """The reader of a word out of `known`; shown: the words that hints choose from (all)."""
    words = frozenset(known)

    def word(name: str, value: Any) -> str:
        if not isinstance(value, str) or value not in words:
            hint = _hint(value, shown or sorted(words))
            raise InputError(f"unknown {name} {show(value)}; {hint}")
        return value

    return word


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 < value < 2**63


def _is_finite(value: Any) -> bool:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    try:
        return math.isfinite(float(value))
    except OverflowError:
        return False


def show(value: Any) -> str:
    """`value` as JSON, cut where it is long."""
    try:
        return clipped(json.dumps(value))
    except (RecursionError, ValueError):  # which may be read, yet not be written
        return "nested too deeply, or too long"


class Recorder:
    """Writes an interaction log; the file appears, whole, at `close`.

    Raises InputError at once if `path` cannot be written. header: see `write_header`.
    """

    def __init__(self, path: str | Path, header: dict[str, Any] | None = None):
        self._pending = PendingFile(path)
        self._last_frame = 0
        self._begins: dict[int, int] = {}  # of each frame with events: where in the file
        if header:
            self.write_header(header)

    def write_header(self, header: dict[str, Any]) -> None:
        """Write the header, where it was not known when the file was opened; before any event."""
        if self._pending.file.tell():
            raise ValueError("a log's header is its first line")
        self._write({"header": header})

    def write(self, frame: int, event: Recordable) -> None:
        """Append what happened before `frame` (from 0) was advanced. Frames must not decrease."""
        if frame < self._last_frame:
            raise ValueError(f"event of frame {frame} after one of frame {self._last_frame}")
        self._last_frame = int(frame)
        self._begins.setdefault(self._last_frame, self._pending.file.tell())
        self._write({"frame": int(frame), "event": event.kind, **event.fields()})

    def rewind(self, frame: int) -> None:
        """Forget the events of `frame` and later ones: the run goes on another way from there."""
        later = [begin for noted, begin in self._begins.items() if noted >= frame]
        if later:
            self._pending.file.seek(min(later))
            self._pending.file.truncate()
        self._begins = {noted: begin for noted, begin in self._begins.items() if noted < frame}
        self._last_frame = frame

    def _write(self, entry: dict[str, Any]) -> None:
        self._pending.write(json.dumps(entry).encode() + b"\n")

    def close(self) -> None:
        """Give the file its name. May be called twice."""
        self._pending.commit()

    def discard(self) -> None:
        """Forget everything, unless already closed; what was at the path before stays."""
        self._pending.discard()

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *_: object) -> None:
        # Also after a failure or Ctrl-C: what was done until then is what one wants to replay.
        self.close()
