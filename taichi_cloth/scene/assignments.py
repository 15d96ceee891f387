"""Values in the place of a scene's own, by keys of scene files: ``--set world.gravity=[0,0.1]``.

An assignment is what one would write into a scene file. `scenefile` puts it into a file's tables,
`reassignment` into a built-in scene.
"""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from typing import Any

from taichi_cloth.errors import InputError, clipped
from taichi_cloth.scene.toml import Keys, dotted

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

_PART = r"[A-Za-z][A-Za-z0-9_-]{0,60}(?:\[[0-9]{1,9}\])*"
_KEY = re.compile(rf"{_PART}(?:\.{_PART})*")
_EXAMPLE = "world.gravity=[0,0.1]"


@dataclass(frozen=True)
class Assignment:
    """A value for one key of a scene file.

    text: as it was written. keys: the way to the value, such as ("cloths", 0, "columns"). value: as
    TOML has it.
    """

    text: str
    keys: Keys
    value: Any


def read(text: str) -> Assignment:
    """The assignment that `text` writes, as ``KEY=VALUE``; raises InputError where it writes none.

    The value is TOML. What is no TOML is a text, or a list of them, whose quotes a shell has taken.
    """
    key, equals, value = text.partition("=")
    key, value = key.strip(), value.strip()
    if not (equals and value and _KEY.fullmatch(key)):
        raise InputError(f"--set must be KEY=VALUE, such as {_EXAMPLE}; is '{clipped(text)}'")
    keys: list[str | int] = []
    for name, index in re.findall(r"([A-Za-z][A-Za-z0-9_-]*)|\[([0-9]+)\]", key):
        keys.append(name or int(index))
    return Assignment(text, tuple(keys), _value(dotted(tuple(keys)), value))


def _value(key: str, text: str) -> Any:
    attempts = [text]
    if not re.search(r"""[][{}"'=,#\n]""", text):
        attempts.append(f"'{text}'")
    elif not re.search(r"""["'\n]""", text):
        words = r"(?<![\w.+-])(?!(?:true|false|inf|nan)\b)([A-Za-z_][\w-]*)(?!\s*=)"
        attempts.append(re.sub(words, r"'\1'", text))
    for attempt in attempts:
        try:
            table = tomllib.loads(f"value = {attempt}")
        except tomllib.TOMLDecodeError:
            continue
        except RecursionError:
            raise InputError(f"--set {key}: is nested too deeply") from None
        except ValueError:  # the one thing tomllib passes on: int() refuses thousands of digits
            raise InputError(f"--set {key}: has a whole number with too many digits") from None
        if len(table) == 1:  # not further keys on lines of their own
            return table["value"]
    raise InputError(
        f"--set {key}: '{clipped(text)}' is no value of TOML, such as 0.1, true, [0,0.1] or a text"
    )
