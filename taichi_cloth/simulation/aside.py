"""Kernels that runs compiled beside themselves for runs to come, and what failed.

It is kept in the user's cache folder, by kind of run.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from taichi_cloth.simulation import cache

FILE = "aside.json"
TRIES = 2  # of a kind of run, after which it is left alone
MOST_KINDS = 200  # that are kept, the newest ones


@dataclass(frozen=True)
class Tried:
    """The outcome of compiling something beside runs of a kind.

    what: what was compiled, then device, method, features and size. done, failed: how often.
    why: it failed last.
    """

    what: str
    done: int = 0
    failed: int = 0
    why: str = ""


def tried(what: str) -> Tried:
    """Its outcome in a kind of run."""
    return next((one for one in all_tried() if one.what == what), Tried(what))


def all_tried() -> list[Tried]:
    """Its outcome in all of them, the newest last."""
    table = cache.read(FILE)
    entries = table.items() if isinstance(table, dict) else ()
    return [Tried(what, *entry) for what, entry in entries if _is_entry(entry)]


def note(what: str, why: str = "") -> None:
    """Note that something was compiled beside a kind of run; why: that it was not."""
    now = tried(what)
    now = replace(now, failed=now.failed + 1, why=why) if why else replace(now, done=now.done + 1)
    kept = [*(one for one in all_tried() if one.what != what), now]  # the newest come last
    table = {one.what: [one.done, one.failed, one.why] for one in kept[-MOST_KINDS:]}
    cache.write(FILE, table)


def _is_entry(entry: object) -> bool:
    """True if this is what `note` writes."""
    return (
        isinstance(entry, list)
        and len(entry) == 3
        and all(type(count) is int and count >= 0 for count in entry[:2])
        and isinstance(entry[2], str)
    )
