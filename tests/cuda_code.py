"""What a CUDA GPU would run, looked at without one: `python tests/cuda_code.py [SCENE:METHOD ...]`.

Taichi compiles for a driver that runs nothing (`cuda_driver.cpp`), which keeps the code (PTX). Of
each scene under each method it says what a GPU would do wrong, in ways that no CPU can show:

- barriers on ways that part from thread to thread, where threads of a block wait at several places
  for each other (PTX ISA, bar.sync: all threads of a warp must execute the same one);
- reads past all stores (ld.global.nc) of what the same kernel may have written.
"""

import contextlib
import itertools
import os
import re
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

HERE = Path(__file__).parent
REGISTER = re.compile(r"%(?:rd|rs|r|fd|f|p)\d+")
BARRIER = re.compile(r"(?:bar|barrier)\.")
# Whether there is a thread of such a number, once for a whole launch: blocks are whole.
OF_ALL_THREADS = re.compile(r"setp\.\w+\.\w+\s+%p\d+, %r\d+, (\d+);")
BLOCK = 256
DONE, DRAWING = "done", "drawing"


def make_driver(folder):
    """Compile the driver into `folder`, as Taichi and `runtime` ask for it."""
    library = folder / "libcuda.so"
    source = str(HERE / "cuda_driver.cpp")
    subprocess.run(["g++", "-w", "-shared", "-fPIC", source, "-o", str(library)], check=True)
    (folder / "libcuda.so.1").symlink_to(library)


def code_of(driver, folder, scene, method, precision="f64"):
    """All code of a scene's first frame under a method, a text for each kernel; driver: a folder
    that `make_driver` has filled; folder: an empty one.
    """
    given = {
        "CUDA_CODE": str(folder),
        "LD_LIBRARY_PATH": str(driver),
        "PYTHONPATH": os.pathsep.join([str(HERE.parent), os.environ.get("PYTHONPATH", "")]),
        "TI_OFFLINE_CACHE": "0",
        "TI_SKIP_VERSION_CHECK": "ON",
    }
    asked = [sys.executable, __file__, "--compile", scene, method, precision]
    ran = subprocess.run(asked, env=os.environ | given, capture_output=True, text=True)
    assert ran.stdout.strip() == DONE, ran.stdout + ran.stderr
    first, *others = sorted(folder.glob("*.ptx"))  # the first is Taichi's own
    return [path.read_text() for path in others]


def compile_frame(scene, method, precision):
    """Compile all that a frame launches; nothing of it is run, so it ends in a failure.

    scene: `DRAWING` compiles pictures of a plane and of space instead.
    """
    from bench.agreement import GIVEN
    from taichi_cloth import runtime
    from taichi_cloth.errors import InputError, SimulationFailure
    from taichi_cloth.scene import library
    from taichi_cloth.simulation.simulation import Simulation

    runtime.start("cuda", precision)
    if scene == DRAWING:
        draw()
    made = library.build(scene, **GIVEN.get(scene, {}))
    try:
        sim = Simulation(made, method, dt="auto", execution="parallel")
    except InputError:  # of `explicit_euler`, which no step makes stable
        sim = Simulation(made, method, execution="parallel")
    with contextlib.suppress(SimulationFailure):
        sim.advance()
    print(DONE, flush=True)
    os._exit(0)  # Taichi would free what this driver never had


def draw():
    """Compile what draws a plane and space with all that a picture may have, and end."""
    from dataclasses import replace

    import numpy as np
    import taichi as ti
    from test_drawing import WORLD, camera
    from test_raster import random_picture

    from taichi_cloth.render.renderer import Renderer

    rng = np.random.default_rng(7)
    for made in [random_picture(rng) for _ in range(3)]:
        Renderer((120, 100)).draw(made, WORLD, camera(rot_x=20), None, None)
    flat = replace(made, position=made.position[:, :2], normals=None, ground=None, ghost=None)
    plane = replace(WORLD, size=(2.0, 2.0), gravity=(0.0, 0.0))
    last = Renderer((120, 100))
    last.draw(flat, plane, None, None, None)
    last.copy_to(ti.Vector.field(4, ti.u8, (120, 100)))  # as GGUI shows it
    print(DONE, flush=True)
    os._exit(0)


# --- barriers ------------------------------------------------------------------------------------


def functions(code):
    """The names and lines of a text's functions."""
    name, lines = "", None
    for line in code.splitlines():
        begins = re.match(r"(?:\.visible \.entry|\.func(?: \(.*\))?)\s+(\w+)", line)
        if begins:
            name = begins.group(1)
        elif line == "{":
            lines = []
        elif line == "}" and lines is not None:
            yield name, lines
            lines = None
        elif lines is not None:
            lines.append(line.split("//")[0].strip())


def blocks_of(lines):
    """A function's basic blocks by their labels, in order: what each does, and who may follow."""
    blocks, label, names = {"": []}, "", map("{}".format, itertools.count())
    for line in lines:
        begins = re.match(r"(\$\w+):", line)
        if begins:
            label = begins.group(1)
            blocks[label] = []
        elif line and line not in ("{", "}") and not line.startswith("."):
            blocks[label].append(line)
            if re.search(r"\bbra\b|\bret\b", line):
                label = next(names)
                blocks[label] = []
    order = [*blocks, "end"]
    follow = {}
    for label, after in itertools.pairwise(order):
        last = blocks[label][-1] if blocks[label] else ""
        to = re.findall(r"\bbra(?:\.uni)?\s+(\$\w+)", last)
        if last.startswith("ret"):
            to = ["end"]
        follow[label] = to if to and not last.startswith("@") else [*to, after]
    return blocks, follow


def differing(blocks):
    """The registers that differ from thread to thread, by way of what they are computed from.

    An atomic's answer is taken for the same: those that all threads ask for are.
    """
    found, before = set(), -1
    lines = [line for block in blocks.values() for line in block]
    while len(found) > before:
        before = len(found)
        for line in lines:
            registers = REGISTER.findall(line)
            if not registers or re.match(r"st|bra|@|ret|call|atom", line):
                continue
            of_all = OF_ALL_THREADS.match(line)
            if of_all and int(of_all.group(1)) >= BLOCK - 1:
                continue
            own = "%tid" in line or re.search(r"ld\.param\.u32.*_param_[12]\]", line)
            if own or found.intersection(registers[1:]):
                found.add(registers[0])
    return found


def always_after(follow):
    """For each basic block those that come after it on every way to the end, itself included."""
    labels = [*follow, "end"]
    place = {label: 1 << k for k, label in enumerate(labels)}
    after = dict.fromkeys(labels, (1 << len(labels)) - 1) | {"end": place["end"]}
    changed = True
    while changed:
        changed = False
        for label in reversed(follow):
            common = (1 << len(labels)) - 1
            for other in follow[label]:
                common &= after[other]
            if after[label] != place[label] | common:
                after[label], changed = place[label] | common, True
    return {label: {k for k in labels if after[label] & place[k]} for label in labels}


def parted(code):
    """Where threads part and meet at several places: the functions and labels of such branches."""
    found = []
    for name, lines in functions(code):
        if not any(BARRIER.match(line) for line in lines):
            continue
        blocks, follow = blocks_of(lines)
        differ, after = differing(blocks), always_after(follow)
        for label, lines_of in blocks.items():
            on = re.match(r"@!?(%p\d+)", lines_of[-1]) if lines_of else None
            if not on or on.group(1) not in differ:
                continue
            seen, to_see = set(), list(follow[label])
            while to_see:  # up to where all ways have met
                other = to_see.pop()
                if other not in seen and (other not in after[label] or other == label):
                    seen.add(other)
                    to_see += follow.get(other, [])
            if any(BARRIER.match(line) for other in seen for line in blocks.get(other, ())):
                found.append((name, label))
    return found


def barriers(code):
    """How many barriers a text has."""
    return sum(bool(BARRIER.match(line)) for _, lines in functions(code) for line in lines)


def main(words):
    """Look at scenes under methods, at all of them if none is named; print what is wrong."""
    from taichi_cloth.kernels.methods import METHODS
    from taichi_cloth.runtime import available_cores
    from taichi_cloth.scene import library

    every = [f"{scene}:{method}" for scene in library.names() for method in METHODS]

    def look(driver, word):
        with tempfile.TemporaryDirectory() as folder:
            code = code_of(driver, Path(folder), *word.split(":"))
        wrong = [where for text in code for where in parted(text)]
        past = sum(text.count("ld.global.nc") for text in code)
        counted = sum(map(barriers, code))
        return f"{word}: {len(code)} kernels, {counted} barriers, {len(wrong)} parted, {past} past"

    with tempfile.TemporaryDirectory() as driver:
        make_driver(Path(driver))
        with ThreadPoolExecutor(available_cores()) as pool:
            for line in pool.map(lambda word: look(Path(driver), word), words or every):
                print(line, flush=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--compile"]:
        compile_frame(*sys.argv[2:])
    else:
        main(sys.argv[1:])
