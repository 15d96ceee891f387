"""Sizes of built-in scenes with which tests that go through all of them stay quick."""

from taichi_cloth.scene import library

SIZES = {
    "box": {"particles": 30},
    "curtain": {"columns": 17},
    "drape": {"side": 17},  # so fine that no side of it is tested against its sphere
    "flag": {"columns": 10},
    "net": {"side": 12},
    "pull": {"columns": 18},
    "sandbox": {"particles": 30},
    "stack": {"side": 7, "sheets": 2},
    "trampoline": {"side": 13},
    "twist": {"columns": 21},
    "warp": {"side": 8},
}


def build(name):
    """The scene called `name`, small."""
    return library.build(name, **SIZES.get(name, {}))
