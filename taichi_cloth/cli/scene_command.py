"""Reading the words of a command that takes a scene: which scene, its parameters, the settings."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NoReturn

from taichi_cloth.errors import InputError, nearest
from taichi_cloth.scene import library
from taichi_cloth.scene.source import DEFAULT_SCENE, SceneSource, names_file
from taichi_cloth.settings.arguments import CommandParser, value_of
from taichi_cloth.settings.options import ASSIGNMENT, AnyOptions, RunOptions, flag, parameters_of
from taichi_cloth.settings.parameters import Parameter

if TYPE_CHECKING:
    from taichi_cloth.scene.assignments import Assignment

OF_EVERY_SCENE = {"set": ASSIGNMENT}


def read(
    command: str,
    settings: type[AnyOptions],
    arguments: Sequence[str],
    about: str,
    default: Callable[[Mapping[str, str | bool]], str] = lambda texts: DEFAULT_SCENE,
) -> tuple[SceneSource, AnyOptions] | None:
    """The scene and the options on a command line; None if it asks for help, which is printed here.

    settings: the command's class of options. What these exclude of each other is the command's
        to check.
    about: a sentence for its help. default: the scene where none is named, from the texts of the
        flags that are given.
    """
    of_command = parameters_of(settings)
    of_scenes = {name: library.parameters(name) for name in library.names()}
    parser = CommandParser(command)
    # One flag sets both where scenes, or a scene and the command, have parameters of one name.
    parser.declare("", {k: p for ps in of_scenes.values() for k, p in ps.items()} | of_command)
    parser.declare("", OF_EVERY_SCENE)

    def taken(plain: Sequence[str]) -> Iterable[str]:
        named = (word for word in plain if names_file(word) or word in of_scenes)
        return {*of_command, *OF_EVERY_SCENE, *of_scenes.get(next(named, DEFAULT_SCENE), {})}

    words = parser.read(arguments, taken)

    scene, *more = words.others or [default(words.texts)]
    if more:
        raise InputError(f"unexpected '{more[0]}': the scene is already '{scene}'")
    is_file = names_file(scene)
    if not is_file and scene not in of_scenes:
        hint = nearest(scene, of_scenes)
        raise InputError(f"unknown scene '{scene}'; {hint} (or name a .toml or mesh file)")
    of_scene = {} if is_file else of_scenes[scene]
    if words.wants_help:
        print(_help(command, of_command, scene, of_scene, about))
        return None
    values: dict[str, Any] = {}
    scene_values: dict[str, Any] = {}
    for name, text in words.texts.items():
        if name not in of_command and name not in of_scene:
            _refuse(flag(name), scene, of_scene, [s for s, ps in of_scenes.items() if name in ps])
        if name in of_command:
            values[name] = value_of(name, of_command[name], text)
        if name in of_scene:
            scene_values[name] = value_of(name, of_scene[name], text)
    source = SceneSource(scene, scene_values, _assignments(words.repeated.get("set", ())))
    return source, settings.from_given(values)


def recorded(source: SceneSource, words: Sequence[str]) -> SceneSource:
    """`source` with what it leaves open as a recording has it, which says so in the flags `words`.

    Raises InputError where these are not such a scene's.
    """
    asked = read("run", RunOptions, [source.name, *words], "")
    if asked is None:
        raise InputError("arguments: --help is none of a scene")
    said, options = asked
    for name in options.given - set(said.parameters):
        raise InputError(f"arguments: {flag(name)} is none of a scene")
    return source.following(said)


def _assignments(texts: Iterable[str]) -> tuple[Assignment, ...]:
    if not texts:
        return ()
    from taichi_cloth.scene import assignments  # with NumPy: not where there are none

    return tuple(map(assignments.read, texts))


def _refuse(
    word: str, scene: str, of_scene: Mapping[str, Parameter], belongs_to: Sequence[str]
) -> NoReturn:
    """Refuse a flag that is a parameter of other scenes only."""
    if names_file(scene):
        instead = f"change the value in {scene}, or " if scene.endswith(".toml") else ""
        raise InputError(f"{word}: only built-in scenes take it; {instead}--set its key")
    has = f"has {', '.join(map(flag, of_scene))}" if of_scene else "has no parameters"
    raise InputError(
        f"{word}: scene '{scene}' does not take it (it {has}); "
        f"it belongs to {', '.join(belongs_to)}"
    )


def _help(
    command: str,
    of_command: Mapping[str, Parameter],
    scene: str,
    of_scene: Mapping[str, Parameter],
    about: str,
) -> str:
    """The command's help, with the flags of one scene."""
    scenes = f"Scenes: {', '.join(library.names())}; default {DEFAULT_SCENE}."
    parser = CommandParser(command, "[SCENE | FILE.toml | MESH.obj] [flags]", about + scenes)
    # A flag that is in both is listed with the command.
    own = {name: p for name, p in of_scene.items() if name not in of_command}
    parser.declare(f"scene '{scene}'", own | OF_EVERY_SCENE)
    parser.declare(command, of_command)
    return parser.format_help().rstrip()
