"""The interaction log of this program: events of mouse and keyboard, and those of the tools."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taichi_cloth.errors import InputError
from taichi_cloth.files import events
from taichi_cloth.files.events import Kind
from taichi_cloth.settings import accepted
from taichi_cloth.ui import inputs, tools
from taichi_cloth.ui.inputs import Event
from taichi_cloth.ui.tools.contract import LoggedEvent, ToolEvent

if TYPE_CHECKING:
    from taichi_cloth.simulation import live
    from taichi_cloth.simulation.simulation import Simulation

LogEvent = Event | ToolEvent
Log = events.Log[LogEvent]


def load(path: str | Path) -> Log:
    """The interaction log at `path`. Raises InputError naming the first line that is wrong."""
    kinds: list[Kind[LogEvent]] = [*map(_with_tools, inputs.KINDS), *_tool_kinds().values()]
    return events.load(accepted.path("load_events: path", path), kinds)


def _with_tools(kind: Kind[Event]) -> Kind[Event]:
    """The kind; that of a tool in hand knows which there are: for any other the scene's own would
    be taken.
    """
    if kind.name != "tool":
        return kind
    known = tuple(tools.load_all())
    return replace(kind, required={"name": events.word_of(("", *known), known)})


def as_logged(event: ToolEvent) -> ToolEvent:
    """`event` as it is read back from a log. TypeError where its fields are not those declared."""
    kind = _tool_kinds().get(event.kind)
    if kind is None:
        raise TypeError(f"no tool declares the event '{event.kind}'")
    try:
        return kind.read(json.loads(json.dumps(event.fields())))
    except (InputError, TypeError) as error:
        raise TypeError(f"a tool's event '{event.kind}': {error}") from error


def replay(sim: Simulation, event: ToolEvent) -> None:
    """Do to `sim` what `event` says that a tool did."""
    _declared()[event.kind].replay(sim, event.values)


def set_event(name: str, value: live.Value) -> ToolEvent:
    """The event that gives a setting of `simulation.live` a value."""
    return as_logged(ToolEvent("set", {"name": name, "value": value}))


def _setting_value(name: str, value: Any) -> live.Value:
    """A number, a word, true or false, or null: off."""
    if value is None or isinstance(value, (bool, str)):
        return value
    return value if isinstance(value, int) else events.number(name, value)


def _set(sim: Simulation, values: Mapping[str, Any]) -> None:
    from taichi_cloth.simulation import live  # which needs Taichi

    live.apply(sim, values["name"], values["value"])


SET = LoggedEvent("set", {"name": events.text, "value": _setting_value}, _set)


@cache
def _declared() -> dict[str, LoggedEvent]:
    of_tools = (event for tool in tools.load_all().values() for event in tool.events)
    return {event.name: event for event in (SET, *of_tools)}


@cache
def _tool_kinds() -> dict[str, Kind[ToolEvent]]:
    return {
        name: Kind(name, event.fields, {}, partial(_made, name))
        for name, event in _declared().items()
    }


def _made(name: str, values: dict[str, Any]) -> ToolEvent:
    return ToolEvent(name, values)
