"""Mouse tools, one file each, found by their files' names.

A tool's file declares `TOOL = Tool(...)` (`contract.py` says what its parts are). Adding a tool is
adding a file.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from taichi_cloth import declarations
from taichi_cloth.ui.tools.contract import Tool


@cache
def load_all() -> dict[str, Tool[Any]]:
    """Every tool, by name. TypeError naming file and part where a declaration is wrong."""
    tools: dict[str, Tool[Any]] = {}
    taken: dict[str, str] = {}
    for name in declarations.names(__path__):
        tool = tools[name] = declarations.load(__name__, name, "TOOL", Tool)
        claims = [f"mouse '{tool.mouse}'"] if tool.mouse else []
        claims += [f"key '{tool.key}'"] if tool.key else []
        for claim in [*claims, *(f"event '{event.name}'" for event in tool.events)]:
            other = taken.setdefault(claim, name)
            if other != name:
                raise TypeError(f"taichi_cloth/ui/tools/{name}.py: {other}.py has {claim}, too")
    return tools


def for_mouse(mouse: str) -> Tool[Any] | None:
    """The tool that the pointer is from the start in a scene with this `[world] mouse`, if any."""
    return next((tool for tool in load_all().values() if tool.mouse == mouse), None)
