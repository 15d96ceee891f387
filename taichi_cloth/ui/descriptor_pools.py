"""Taichi's pools of Vulkan descriptor sets are given back under Mesa's software driver, too.

GGUI takes a descriptor set for each draw, and Taichi gives a pool of them back once the driver has
said that it is full and another one is in use. A graphics card's driver says so after some dozens;
Mesa's lavapipe (seen in 22.3) never does, so a window kept 130 to 220 bytes of each draw, 131 MB an
hour. Here it is said in the driver's place: Vulkan lets it answer VK_ERROR_OUT_OF_POOL_MEMORY at
any time ("Descriptor Set Allocation" in its specification), and Taichi takes a new pool then.

Taichi calls the driver through a pointer that its library keeps (as volk, the loader that it uses,
does). Where that pointer is not found, or leads elsewhere, all stays as it is.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import importlib
import mmap
import re
import struct
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

POINTER = b"vkAllocateDescriptorSets"
DRIVER = "libvulkan_lvp"
LARGEST = 64  # sets of a pool
OUT_OF_POOL_MEMORY = -1000069000  # VkResult
# VkResult f(VkDevice, const VkDescriptorSetAllocateInfo*, VkDescriptorSet*)
ALLOCATE = ctypes.CFUNCTYPE(ctypes.c_int32, *3 * [ctypes.c_void_p])

# ELF with 64 bits, little-endian: where its head keeps the sections' place, size and number; the
# parts of a section's head; the kind of a section that has symbols; one of these.
SECTIONS, SECTION, SYMBOLS = ("<40xQ10xHH", 64), "<IIQQQQIIQQ", 2
SYMBOL = np.dtype(
    {"names": ["name", "value"], "formats": ["<u4", "<u8"], "offsets": [0, 8], "itemsize": 24}
)


class _Mapping(NamedTuple):
    begin: int
    end: int
    executable: bool
    offset: int
    path: str


def limit() -> bool:
    """Let no pool have more than `LARGEST` sets; whether that was needed and could be done.

    To be called once a window is open: before, the driver is not known.
    """
    if not sys.platform.startswith("linux") or sys.maxsize < 2**32:
        return False
    with contextlib.suppress(OSError, ImportError, ValueError, struct.error):
        module: Any = importlib.import_module("taichi._lib.core.taichi_python")
        library, mappings = Path(module.__file__).resolve(), list(_mappings())
        begins = [m.begin for m in mappings if m.path == str(library) and m.offset == 0]
        place = ctypes.c_void_p.from_address(min(begins) + symbol(library, POINTER))
        driver = place.value or 0
        if any(m.begin <= driver < m.end and m.executable and DRIVER in m.path for m in mappings):
            limited = ALLOCATE(_limited(ALLOCATE(driver)))
            place.value = ctypes.cast(limited, ctypes.c_void_p).value
            atexit.register(_give_back, place, driver, limited)
            return True
    return False


def _limited(allocate: Any) -> Any:
    """The driver's function, that says after every `LARGEST` sets that their pool is full."""
    taken = 0

    def call(device: int, info: int, sets: int) -> int:
        nonlocal taken
        taken += 1
        if taken <= LARGEST:
            return int(allocate(device, info, sets))
        taken = 0
        return OUT_OF_POOL_MEMORY

    return call


def _give_back(place: ctypes.c_void_p, driver: int, limited: Any) -> None:
    """Have the library call the driver itself again; until then `limited` is kept."""
    place.value = driver


def _mappings() -> Iterator[_Mapping]:
    """The files that this process has in its memory."""
    for line in Path("/proc/self/maps").read_text().splitlines():
        parts = line.split(maxsplit=5)
        if len(parts) == 6:
            begin, end = (int(word, 16) for word in parts[0].split("-"))
            yield _Mapping(begin, end, "x" in parts[1], int(parts[2], 16), parts[5])


def symbol(library: Path, name: bytes) -> int:
    """Where a shared library (ELF, 64 bits) keeps what a symbol names, from its beginning.

    ValueError where it has no such symbol, or several.
    """
    with library.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        if data[:6] != b"\x7fELF\x02\x01":
            raise ValueError(f"{library} is no library of 64 bits")
        at, size, count = struct.unpack_from(SECTIONS[0], data)
        heads = [struct.unpack_from(SECTION, data, at + k * size) for k in range(count)]
        for _, kind, _, _, begin, length, strings, *_ in heads:
            if kind != SYMBOLS:
                continue
            _, _, _, _, first, words, *_ = heads[strings]
            ends = re.compile(re.escape(name) + b"\0").finditer(data, first, first + words)
            table = np.frombuffer(data[begin : begin + length], SYMBOL)
            # A name may share its place with the end of a longer one.
            names = np.isin(table["name"], [end.start() - first for end in ends])
            found = np.unique(table["value"][names])
            if len(found) == 1:
                return int(found[0])
    raise ValueError(f"{library} has no one symbol {name.decode()}")
