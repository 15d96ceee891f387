"""Reading a command's words: argparse takes flags that are made from declared settings.

Whatever a user gets wrong is an InputError, before Taichi starts.
"""

from __future__ import annotations

import argparse
import re
import shutil
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

from taichi_cloth.errors import InputError, clipped, nearest
from taichi_cloth.settings.options import PROGRAM, flag
from taichi_cloth.settings.parameters import Parameter

NARROWEST, WIDEST = 40, 120  # columns of help texts
USAGE = "usage: "  # what argparse begins a help text with


@dataclass(frozen=True)
class Words:
    """A command line, before its values are checked.

    texts: what is given for each setting: a value's text, or whether a switch is on.
    repeated: the texts of each setting that may be given several times, in order.
    others: the words that are neither flags nor their values, in order.
    wants_help: whether it asks for help.
    """

    texts: dict[str, str | bool]
    repeated: dict[str, list[str]]
    others: list[str]
    wants_help: bool


class CommandParser(argparse.ArgumentParser):
    """Reads the words of one command, and lays out its help.

    Beside flags, any words are taken. Values stay texts, because what they may be can depend on
    those words: `--particles` has other limits for each scene.
    """

    def __init__(self, command: str, usage: str = "[flags]", description: str = "") -> None:
        super().__init__(
            usage=laid_out(f"{USAGE}{PROGRAM} {command} {usage}").removeprefix(USAGE),
            description=laid_out(description),
            formatter_class=lambda prog: argparse.RawDescriptionHelpFormatter(
                prog, max_help_position=28, width=_width()
            ),
            argument_default=argparse.SUPPRESS,  # what is not given is not there
            add_help=False,  # commands print their own, which depends on the scene
            allow_abbrev=False,
            exit_on_error=False,
        )
        self.add_argument("-h", "--help", action="store_true", help=argparse.SUPPRESS)
        self._command = command
        self._declared: dict[str, Parameter] = {}

    def declare(self, title: str, parameters: Mapping[str, Parameter]) -> None:
        """Take the flags of these settings; help shows them under `title`."""
        group = self.add_argument_group(title)
        for name, parameter in parameters.items():
            group.add_argument(flag(name), **_as_argument(parameter))
            self._declared[flag(name)] = parameter

    def read(
        self,
        arguments: Sequence[str],
        taken: Callable[[Sequence[str]], Iterable[str]] | None = None,
    ) -> Words:
        """The words of a command line. Raises InputError for an unknown flag or a missing value.

        taken: names of the settings whose flags go with words that are no flags; a hint names none
        but these. None: all go.
        """
        if "--" in arguments:
            self._refuse_flag("--")  # argparse would take all that follows it for words
        try:
            given, others = self.parse_known_args(arguments)
        except argparse.ArgumentError as error:
            self._refuse_missing(str(error.argument_name))
        for word in others:
            if word.startswith("-") and word != "-":
                plain = [other for other in others if not other.startswith("-")]
                self._refuse_flag(word.partition("=")[0], taken(plain) if taken else None)
        wants_help = vars(given).pop("help", False)
        texts = {name: text for name, text in vars(given).items() if text is not None}
        for name, text in texts.items():
            # Also of `--save=--`, which argparse empties.
            if not (all(text) if isinstance(text, list) else text or text is False):
                self._refuse_missing(flag(name))
        repeated = {name: text for name, text in texts.items() if isinstance(text, list)}
        single = {name: text for name, text in texts.items() if name not in repeated}
        return Words(single, repeated, others, wants_help)

    def error(self, message: str) -> NoReturn:
        """Refuse the command line; argparse would end the program, with its usage."""
        raise InputError(message)

    def _parse_optional(self, word: str) -> Any:
        """The flag that a word is, as argparse has it; None for a value, and a word that is none.

        argparse itself takes whatever begins with a minus sign for a flag, but plain numbers; a
        value can be -inf, or a file's name.
        """
        name, equals, text = word.partition("=")
        if name not in self._option_string_actions:
            return None
        if equals and self._option_string_actions[name].nargs == 0:
            raise InputError(f"{name} takes no value, got '{clipped(text)}'")
        return super()._parse_optional(word)

    def _refuse_flag(self, name: str, taken: Iterable[str] | None = None) -> NoReturn:
        flags = self._option_string_actions if taken is None else [*map(flag, taken), "--help"]
        hint = nearest(name.lstrip("-"), (word[2:] for word in flags if word != "-h"))
        hint = hint.replace("'", "'--", 1)
        if not hint.startswith("did"):
            hint = f"'{PROGRAM} {self._command} --help' shows all flags"
        raise InputError(f"unknown flag '{clipped(name)}'; {hint}")

    def _refuse_missing(self, name: str) -> NoReturn:
        raise InputError(f"{name} needs a value: {self._declared[name].describe()}")


def _width() -> int:
    """Columns of a help text: those of the terminal, between two limits; 80 where there is none."""
    return min(max(shutil.get_terminal_size().columns, NARROWEST), WIDEST)


def laid_out(text: str) -> str:
    """A help text in whole words; what is listed as '  name  what it is' stays in its column."""
    lines = []
    for line in text.splitlines():
        listed = re.match(r"( +\S+ +|usage: +\S+ +)?", line)
        indent = " " * (len(listed[0]) if listed else 0)
        wrapped = textwrap.wrap(
            line, _width(), subsequent_indent=indent, break_on_hyphens=False, break_long_words=False
        )
        lines += wrapped or [""]
    return "\n".join(lines)


def _as_argument(parameter: Parameter) -> dict[str, Any]:
    """A declared setting in argparse's terms."""
    help_ = parameter.describe().replace("%", "%%")
    if parameter.type is not bool:
        metavar = parameter.metavar or "|".join(parameter.choices)
        action = "append" if parameter.repeated else "store"
        metavar = metavar or ("N" if parameter.type is int else "X")
        return {"help": help_, "metavar": metavar, "action": action}
    if parameter.default is not False:  # it may be on by itself: it can be turned off, too
        return {"help": help_, "action": argparse.BooleanOptionalAction, "default": None}
    return {"help": help_, "action": "store_true"}


def value_of(name: str, parameter: Parameter, text: str | bool) -> Any:
    """The value given for a setting. Raises InputError if it is none, or not allowed."""
    return text if isinstance(text, bool) else parameter.parse(flag(name), text)
