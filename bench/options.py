"""The flags of `bench`."""

from __future__ import annotations

from dataclasses import dataclass

from taichi_cloth.settings.options import (
    ARCHS,
    Options,
    resume_setting,
    setting,
    within_setting,
)


@dataclass(frozen=True)
class BenchOptions(Options):
    """Settings of the benchmark."""

    rounds: int | None = setting(
        None,
        "counted rounds of each contest (default: 7, with --quick 3)",
        int,
        minimum=2,
        maximum=1000,
        metavar="N",
    )
    quick: bool = setting(False, "smaller sizes and fewer rounds: about a minute")
    output: str = setting("bench/results", "folder of the results", metavar="DIR")
    arch: str | None = setting(
        None,
        "backend of the part gpu (default: cuda and vulkan)",
        str,
        choices=tuple(arch for arch in ARCHS if arch not in ("cpu", "gpu")),
    )
    against: str | None = setting(
        None,
        "the Python of an earlier build's environment, for the part windows",
        str,
        metavar="PYTHON",
    )
    scenes: str | None = setting(
        None,
        "only these scenes of the part accuracy, whose others keep their rows",
        str,
        metavar="A,B",
    )
    within: str | None = within_setting()
    resume: bool = resume_setting()
    tables: str | None = setting(
        None,
        "fill a document's tables from the results; without a PART nothing is measured",
        str,
        metavar="FILE.md",
    )
