"""The time that settings are judged over, in words."""

from __future__ import annotations

from taichi_cloth import console
from taichi_cloth.errors import counted
from taichi_cloth.trade.seconds import SECOND


def in_seconds(frames: int) -> str:
    """'5 seconds (300 frames)'; a second is one of the error meter."""
    seconds = f"{frames / SECOND:.3g}"
    return f"{seconds} second{'s' * (seconds != '1')} ({counted(frames, 'frame')})"


def say_horizon(frames: int) -> None:
    """Say over which time errors are told, before they are."""
    console.say(
        console.output(),
        f"HORIZON: {in_seconds(frames)}. An error is that of each second by itself, as "
        "--error-meter has it; a longer run may show more. --frames asks for another time.",
        hang=2,
    )
