"""Reading the words of ``python -m bench``: the parts to measure, and the settings."""

from __future__ import annotations

import sys
from collections.abc import Sequence

import bench
from bench.options import BenchOptions
from taichi_cloth.errors import InputError, nearest
from taichi_cloth.settings.arguments import CommandParser, value_of
from taichi_cloth.settings.options import parameters_of


def main(arguments: Sequence[str]) -> int:
    """Measure what the words ask for, or print help; return the exit status."""
    listed = "\n".join(f"  {part:10} {bench.summary(part)}" for part in bench.PARTS)
    parser = CommandParser("bench", "[PART ...] [flags]", f"Parts (default: all):\n{listed}")
    declared = parameters_of(BenchOptions)
    parser.declare("flags", declared)
    words = parser.read(arguments)
    if words.wants_help:
        print(parser.format_help().rstrip())
        return 0
    for part in words.others:
        if part not in bench.PARTS:
            raise InputError(f"bench: unknown part '{part}'; {nearest(part, bench.PARTS)}")
    values = {name: value_of(name, declared[name], text) for name, text in words.texts.items()}

    from bench import command

    return command.main(words.others, BenchOptions.from_given(values))


if __name__ == "__main__":
    from taichi_cloth.cli.main import main as of_command

    sys.exit(of_command(["bench", *sys.argv[1:]]))
