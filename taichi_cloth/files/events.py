"""The interaction log: what the user did, frame by frame, in window pixels.

A log is a text file, one JSON object a line, in frame order:
``{"frame": 0, "event": "move", "pos": [300.0, 200.0]}``. The first line may be a header:
``{"header": {...}}``. Events of frame f (from 0) are applied before that frame is advanced.
"""

from __future__ import annotations

import json
import math
import string
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, NoReturn

from taichi_cloth.errors import InputError, nearest
from taichi_cloth.files.pending import PendingFile

KINDS = ("move", "press", "release", "wheel")
BUTTONS = ("left", "middle", "right")
# Names of the keys a log can hold. Shifted letters and signs are keys of their own only where the
# program gives them a meaning.
NAMED_KEYS = (
    *("space", "ctrl", "shift", "alt", "tab", "return", "escape", "backspace", "delete"),
    *("up", "down", "left", "right", "home", "end", "page_up", "page_down"),
    *(f"f{n}" for n in range(1, 13)),
)
KEYS = frozenset(NAMED_KEYS) | (
    frozenset(string.ascii_lowercase + string.digits + string.punctuation)
)
# Each kind's JSON keys besides "frame" and "event": those it must have, those it may have.
_FIELDS = {
    "move": (("pos",), ()),
    "press": ((), ("pos", "button", "key")),
    "release": ((), ("pos", "button", "key")),
    "wheel": (("delta",), ("pos",)),
}


@dataclass(frozen=True)
class Event:
    """One thing the user did with mouse or keyboard.

    kind: out of `KINDS`. pos: (x, y) in window pixels, origin top left, y down (None for keys).
    button: out of `BUTTONS`; key: lower-case name out of `KEYS` ("space", "ctrl", "f1", ".",
    "a"); delta: wheel notches, positive away from the user.
    """

    kind: str
    pos: tuple[float, float] | None = None
    button: str | None = None
    key: str | None = None
    delta: float = 0.0


@dataclass(frozen=True)
class Log:
    """A log that was read: its header (empty if it has none) and its events by frame."""

    header: dict[str, Any] = field(default_factory=dict)
    by_frame: dict[int, list[Event]] = field(default_factory=dict)

    @property
    def last_frame(self) -> int:
        """The last frame that has an event; -1 if none has."""
        return max(self.by_frame, default=-1)


def load(path: str | Path) -> Log:
    """The interaction log at `path`. Raises InputError naming the first line that is wrong."""
    path = Path(path)
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file") from None
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder; name the interaction log in it") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot be read: {reason}") from None
    log = Log()
    last_frame = 0
    for number, raw in enumerate(content.split(b"\n"), start=1):
        where = f"{path.name} line {number}"
        try:
            line = raw.decode("utf-8-sig" if number == 1 else "utf-8").strip()
        except UnicodeDecodeError:
            raise InputError(f"{where}: is not text in UTF-8") from None
        if not line:
            continue
        entry = _object(where, line)
        if "header" in entry:
            if number != 1:
                raise InputError(f"{where}: a header can only be the first line")
            _known_keys(where, entry, ("header",))
            if not isinstance(entry["header"], dict):
                raise InputError(f"{where}: header must be an object in braces")
            _check_header(where, entry["header"])
            log.header.update(entry["header"])
            continue
        frame, event = _event(where, entry)
        if frame < last_frame:
            raise InputError(
                f"{where}: frame {frame} comes after frame {last_frame}; events must be in order"
            )
        last_frame = frame
        log.by_frame.setdefault(frame, []).append(event)
    return log


def _check_header(where: str, header: dict[str, Any]) -> None:
    """Refuse values of the header's keys that a replay uses and that make no sense."""
    window, seed = header.get("window", [1, 1]), header.get("seed", 0)
    if not isinstance(window, list) or len(window) != 2 or not all(map(_is_count, window)):
        raise InputError(f"{where}: window must be [width, height] in pixels, is {_show(window)}")
    if seed != 0 and not _is_count(seed):
        raise InputError(f"{where}: seed must be a whole number from 0, is {_show(seed)}")
    for key in ("scene", "method", "topology"):
        if not isinstance(header.get(key, ""), str):
            raise InputError(f"{where}: {key} must be a name, is {_show(header[key])}")
    dt, substeps = header.get("dt", 1.0), header.get("substeps", 1)
    if dt != "auto" and (not _is_finite(dt) or dt <= 0):
        raise InputError(f"{where}: dt must be a positive number or auto, is {_show(dt)}")
    if not _is_count(substeps):
        raise InputError(f"{where}: substeps must be a whole number from 1, is {_show(substeps)}")


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 < value < 2**63


def _object(where: str, line: str) -> dict[str, Any]:
    """The JSON object on a line, without NaN, infinities or repeated keys."""

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        entry = dict(pairs)
        if len(entry) < len(pairs):
            names = [name for name, _ in pairs]
            twice = next(name for name in names if names.count(name) > 1)
            raise InputError(f"{where}: '{twice}' is given twice")
        return entry

    def refuse_constant(word: str) -> NoReturn:
        raise InputError(f"{where}: numbers must be finite, found {word}")

    try:
        entry = json.loads(line, object_pairs_hook=unique, parse_constant=refuse_constant)
    except json.JSONDecodeError as error:
        raise InputError(f"{where}: is not JSON: {error.msg} (column {error.colno})") from None
    except (RecursionError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{where}: is not JSON that can be read: {error}") from None
    if not isinstance(entry, dict):
        raise InputError(f"{where}: must be an object such as {_EXAMPLE}")
    return entry


_EXAMPLE = '{"frame": 0, "event": "move", "pos": [300, 200]}'


def _known_keys(where: str, entry: dict[str, Any], known: tuple[str, ...]) -> None:
    for key in entry:
        if key not in known:
            raise InputError(f"{where}: unknown key '{key}'; {nearest(key, known)}")


def _event(where: str, entry: dict[str, Any]) -> tuple[int, Event]:
    """Frame and event of one line's object, checked."""
    for key in ("frame", "event"):
        if key not in entry:
            every = ("frame", "event", "pos", "button", "key", "delta")
            _known_keys(where, entry, every)
            raise InputError(f"{where}: '{key}' is missing; a line is such as {_EXAMPLE}")
    frame, kind = entry["frame"], entry["event"]
    if isinstance(frame, bool) or not isinstance(frame, int) or frame < 0:
        raise InputError(f"{where}: frame must be a whole number from 0, is {_show(frame)}")
    if kind not in KINDS:
        hint = nearest(kind, KINDS) if isinstance(kind, str) else f"known: {', '.join(KINDS)}"
        raise InputError(f"{where}: unknown event {_show(kind)}; {hint}")
    required, optional = _FIELDS[kind]
    _known_keys(where, entry, ("frame", "event", *required, *optional))
    for key in required:
        if key not in entry:
            raise InputError(f"{where}: '{key}' is missing; a {kind} event needs it")
    values: dict[str, Any] = {}
    if "pos" in entry:
        pos = entry["pos"]
        if not isinstance(pos, list) or len(pos) != 2 or not all(map(_is_finite, pos)):
            raise InputError(f"{where}: pos must be two finite numbers, is {_show(pos)}")
        values["pos"] = (float(pos[0]), float(pos[1]))
    if kind in ("press", "release"):
        if ("button" in entry) == ("key" in entry):
            raise InputError(f"{where}: a {kind} event needs either 'button' or 'key'")
        name, known = ("button", BUTTONS) if "button" in entry else ("key", KEYS)
        word = entry[name]
        if not isinstance(word, str) or word not in known:
            words = BUTTONS if name == "button" else NAMED_KEYS
            hint = nearest(word, words) if isinstance(word, str) else f"known: {', '.join(words)}"
            raise InputError(f"{where}: unknown {name} {_show(word)}; {hint}")
        if name == "button" and "pos" not in entry:
            raise InputError(f"{where}: 'pos' is missing; a {kind} of a button needs it")
        values[name] = word
    if kind == "wheel":
        if not _is_finite(entry["delta"]):
            raise InputError(f"{where}: delta must be a finite number, is {_show(entry['delta'])}")
        values["delta"] = float(entry["delta"])
    return frame, Event(kind, **values)


def _is_finite(value: Any) -> bool:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    try:
        return math.isfinite(float(value))
    except OverflowError:
        return False


def _show(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 40 else text[:37] + "..."


class Recorder:
    """Writes an interaction log; the file appears, whole, at `close`.

    Raises InputError at once if `path` cannot be written. header: see `write_header`.
    """

    def __init__(self, path: str | Path, header: dict[str, Any] | None = None):
        self._pending = PendingFile(path)
        self._last_frame = 0
        if header:
            self.write_header(header)

    def write_header(self, header: dict[str, Any]) -> None:
        """Write the header, where it was not known when the file was opened; before any event."""
        if self._pending.file.tell():
            raise ValueError("a log's header is its first line")
        self._write({"header": header})

    def write(self, frame: int, event: Event) -> None:
        """Append what happened before `frame` (from 0) was advanced. Frames must not decrease.

        A key that logs have no name for is left out: nothing in the program reacts to one.
        """
        if frame < self._last_frame:
            raise ValueError(f"event of frame {frame} after one of frame {self._last_frame}")
        if event.key is not None and event.key not in KEYS:
            return
        self._last_frame = int(frame)
        entry: dict[str, Any] = {"frame": int(frame), "event": event.kind}
        if event.pos is not None:
            entry["pos"] = [float(event.pos[0]), float(event.pos[1])]
        if event.button is not None:
            entry["button"] = event.button
        if event.key is not None:
            entry["key"] = event.key
        if event.kind == "wheel":
            entry["delta"] = float(event.delta)
        self._write(entry)

    def _write(self, entry: dict[str, Any]) -> None:
        self._pending.file.write(json.dumps(entry).encode() + b"\n")

    def close(self) -> None:
        """Give the file its name. May be called twice."""
        self._pending.commit()

    def discard(self) -> None:
        """Forget everything, unless already closed; what was at the path before stays."""
        self._pending.discard()

    def __enter__(self) -> Recorder:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        # Also after a failure or Ctrl-C: what was done until then is what one wants to replay.
        self.close()
