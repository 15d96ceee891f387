"""Reading a command's arguments: a scene with its parameters, and the flags of its settings.

Settings are declared (`options.py`), scenes declare their own; flags and help texts are made from
both. Whatever a user gets wrong is an InputError, before Taichi starts.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from taichi_cloth.errors import InputError, nearest
from taichi_cloth.settings.options import Parameter, parameters_of

if TYPE_CHECKING:
    from taichi_cloth.scene.model import Scene

PROGRAM = "taichi-cloth"
DEFAULT_SCENE = "cloth"


@dataclass(frozen=True)
class Request:
    """What a command line asks for: a scene's name or file, its parameters, the settings."""

    scene: str
    scene_parameters: dict[str, Any]
    options: Any  # an object of the command's class of settings
    given: frozenset[str]  # names of the settings that the command line gives

    @property
    def is_file(self) -> bool:
        return names_file(self.scene)

    def build(self) -> Scene:
        """The scene, checked."""
        from taichi_cloth.scene import library, scenefile

        if self.is_file:
            return scenefile.load(self.scene)
        return library.build(self.scene, **self.scene_parameters)

    def words(self) -> list[str]:
        """The scene and its parameters, as one would write them after a command."""
        values = self.scene_parameters.items()
        return [self.scene, *(word for name, value in values for word in (flag(name), str(value)))]


def names_file(word: str) -> bool:
    """Whether a word names a scene's file rather than a built-in scene."""
    from taichi_cloth.scene import library

    if word in library.names() or not word:
        return False
    # os.path.exists takes a word too long for a file's name; Path.exists does not.
    return word.endswith(".toml") or os.sep in word or "/" in word or os.path.exists(word)


def flag(name: str) -> str:
    """The flag of the setting called `name`."""
    return "--" + name.replace("_", "-")


def parse_scene_command(
    command: str, settings: type, arguments: Sequence[str], about: str
) -> Request | None:
    """The request on the command line of a command that takes a scene; None if it asks for help.

    settings: the command's dataclass of settings. about: a sentence for its help, which is printed
    here. What the settings exclude of each other is the command's to check.
    """
    from taichi_cloth.scene import library

    of_scenes = {name: library.parameters(name) for name in library.names()}
    of_command = parameters_of(settings)
    known: dict[str, Parameter | None] = {flag(name): p for name, p in of_command.items()}
    known |= {flag(name): p for ps in of_scenes.values() for name, p in ps.items()} | known
    switches = {word for word, p in known.items() if p.type is bool}
    if "fast_math" in of_command:
        known |= {"--no-fast-math": of_command["fast_math"]}
        switches |= {"--no-fast-math"}

    texts, words, wants_help = split(arguments, known, switches, command)
    if len(words) > 1:
        raise InputError(f"unexpected '{words[1]}': the scene is already '{words[0]}'")
    scene = words[0] if words else DEFAULT_SCENE
    is_file = names_file(scene)
    if not is_file and scene not in of_scenes:
        raise InputError(
            f"unknown scene '{scene}'; {nearest(scene, of_scenes)} (or name a .toml file)"
        )
    declared = {} if is_file else of_scenes[scene]
    if wants_help:
        print(_scene_help(command, of_command, scene, declared, about))
        return None

    values: dict[str, Any] = {}
    scene_values: dict[str, Any] = {}
    for word, text in texts.items():
        name = word[2:].replace("-", "_")
        if word == "--no-fast-math":
            values["fast_math"] = False
        elif word in switches:
            values[name] = True
        elif name in of_command or name in declared:
            if name in of_command:
                values[name] = of_command[name].parse(word, text)
            if name in declared:
                scene_values[name] = declared[name].parse(word, text)
        elif is_file:
            raise InputError(
                f"{word}: only built-in scenes take it; change the value in {scene} instead"
            )
        else:
            has = f"has {', '.join(map(flag, declared))}" if declared else "has no parameters"
            others = [name_ for name_, ps in of_scenes.items() if name in ps]
            raise InputError(
                f"{word}: scene '{scene}' does not take it (it {has}); "
                f"it belongs to {', '.join(others)}"
            )
    return Request(scene, scene_values, settings(**values), frozenset(values))


def split(
    arguments: Sequence[str], known: Mapping[str, Any], switches: Iterable[str], command: str
) -> tuple[dict[str, str], list[str], bool]:
    """Flags with their texts, the words that are none, and whether help is wanted.

    A flag's value is whatever follows it, so that values may begin with a minus sign.
    """
    known = {**known, "--help": None, "-h": None}
    switches = {*switches, "--help", "-h"}
    texts: dict[str, str] = {}
    words = []
    queue = list(arguments)
    while queue:
        word = queue.pop(0)
        if not word.startswith("-") or word == "-":
            words.append(word)
            continue
        name, equals, text = word.partition("=")
        if name not in known:
            raise InputError(f"unknown flag '{name}'; {_flag_hint(name, known, command)}")
        if name in switches:
            if equals:
                raise InputError(f"{name} takes no value, got '{text}'")
        elif not equals:
            if not queue or queue[0].partition("=")[0] in known:
                raise InputError(f"{name} needs a value: {known[name].describe()}")
            text = queue.pop(0)
        if not text and name not in switches:
            raise InputError(f"{name} needs a value: {known[name].describe()}")
        texts[name] = text
    return texts, words, bool({"-h", "--help"} & texts.keys())


def _flag_hint(word: str, known: Iterable[str], command: str) -> str:
    hint = nearest(word, known)
    return hint if hint.startswith("did") else f"'{PROGRAM} {command} --help' shows all flags"


def _scene_help(
    command: str,
    of_command: Mapping[str, Parameter],
    scene: str,
    declared: Mapping[str, Parameter],
    about: str,
) -> str:
    from taichi_cloth.scene import library

    groups = {command: of_command}
    if declared:
        # One flag sets both where a name is in both, and is listed with the command.
        own = {name: p for name, p in declared.items() if name not in of_command}
        groups = {f"scene '{scene}'": own, **groups}
    return flags_help(
        f"{PROGRAM} {command} [SCENE | FILE.toml] [flags]",
        f"{about}Scenes: {', '.join(library.names())}; default {DEFAULT_SCENE}.",
        groups,
    )


def flags_help(usage: str, description: str, groups: Mapping[str, Mapping[str, Parameter]]) -> str:
    """A command's help, laid out by argparse from declared settings, in titled groups."""
    parser = argparse.ArgumentParser(
        usage=usage,
        description=description,
        formatter_class=lambda prog: argparse.RawDescriptionHelpFormatter(
            prog, max_help_position=28, width=100
        ),
        add_help=False,
    )
    for title, parameters in groups.items():
        group = parser.add_argument_group(title)
        for name, parameter in parameters.items():
            help_ = parameter.describe().replace("%", "%%")
            if name == "fast_math":
                group.add_argument("--fast-math", "--no-fast-math", action="store_true", help=help_)
            elif parameter.type is bool:
                group.add_argument(flag(name), action="store_true", help=help_)
            else:
                words = "|".join(parameter.choices)
                metavar = parameter.metavar or words or ("N" if parameter.type is int else "X")
                group.add_argument(flag(name), metavar=metavar, help=help_)
    return parser.format_help().rstrip()
