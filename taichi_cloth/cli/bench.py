"""Reading the words of ``taichi-cloth bench``: the parts to measure, and the settings."""

from __future__ import annotations

from collections.abc import Sequence

from taichi_cloth import benchmarks
from taichi_cloth.errors import InputError, nearest
from taichi_cloth.settings.arguments import CommandParser, value_of
from taichi_cloth.settings.options import BenchOptions, parameters_of


def main(arguments: Sequence[str]) -> int:
    """Measure what the words ask for, or print help; return the exit status."""
    listed = "\n".join(f"  {part:10} {benchmarks.summary(part)}" for part in benchmarks.PARTS)
    parser = CommandParser("bench", "[PART ...] [flags]", f"Parts (default: all):\n{listed}")
    declared = parameters_of(BenchOptions)
    parser.declare("flags", declared)
    words = parser.read(arguments)
    if words.wants_help:
        print(parser.format_help().rstrip())
        return 0
    for part in words.others:
        if part not in benchmarks.PARTS:
            raise InputError(f"bench: unknown part '{part}'; {nearest(part, benchmarks.PARTS)}")
    values = {name: value_of(name, declared[name], text) for name, text in words.texts.items()}

    from taichi_cloth.benchmarks import command

    return command.main(words.others, BenchOptions.from_given(values))
