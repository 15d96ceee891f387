"""The bits of what this version computes and draws, to be held against another version's.

    python -m bench.digest [--part 1/10] [--out FILE] [--against FILE]

A line for each run: its name, then a digest of its bits or, where it is refused or fails, the
message. Runs are built-in scenes x methods x topologies x precisions x 1 and 2 threads, of 60
frames each; six recorded sessions; and twelve pictures. `--part 1/10` takes a fixed tenth of the
scenes' runs, and all sessions and pictures. All of it takes hours.

`--against FILE` names the lines that differ from those of an earlier `--out`; the exit status is
then 1 if there are any.
"""

from __future__ import annotations

import argparse
import hashlib
import itertools
import os
import subprocess
import sys
import tempfile
import zlib
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

CHECKOUT = Path(__file__).parents[1]
PRECISIONS, THREADS, TOPOLOGIES = ("f32", "f64", "compensated"), (1, 2), ("graph", "lanes")
FRAMES = 60
AT_ONCE = 2  # processes
LONGEST = 900  # seconds that a process may take
LOGS = CHECKOUT / "tests"
SESSIONS = {  # by log: the scene, and how many frames
    "golden/cloth_blow.jsonl": ("cloth", 120),
    "golden/cloth_storm.jsonl": ("cloth", 120),
    "held_out/failing/cut_by_hand.jsonl": ("cloth", 90),
    "held_out/failing/hold_stiff.jsonl": ("cloth", 60),
    "held_out/failing/set_stiffness_log.jsonl": ("cloth", 60),
    "held_out/failing/spawned_chain.jsonl": ("box", 60),
}
PICTURES = (
    *("cloth", "box", "sandbox", "drape", "flag", "stack", "shirt", "twist", "pull", "curtain"),
    *("chain", "trampoline"),
)


def runs(part: tuple[int, int]) -> list[tuple[str, ...]]:
    """Scene, method, topology, precision and threads of a part's runs; (1, 1) is all of them."""
    from taichi_cloth.kernels.methods import METHODS
    from taichi_cloth.scene import library

    threads = [str(count) for count in THREADS]
    every = itertools.product(library.names(), METHODS, TOPOLOGIES, PRECISIONS, threads)
    which, of = part
    return [run for run in every if zlib.crc32(" ".join(run).encode()) % of == which - 1]


def digest(arrays: Iterable[np.ndarray]) -> str:
    """Of the bits of arrays, in their order."""
    found = hashlib.sha256()
    for array in arrays:
        found.update(np.ascontiguousarray(array).tobytes())
    return found.hexdigest()[:16]


def of_run(scene: str, method: str, topology: str) -> str:
    """The digest of one run on the device that is started; or why there is none."""
    from taichi_cloth.errors import InputError, RunFailure
    from taichi_cloth.scene import library
    from taichi_cloth.simulation.simulation import Simulation

    try:
        sim = Simulation(library.build(scene), method, topology=topology)
        sim.advance(FRAMES)
    except (InputError, RunFailure) as error:
        return f"{type(error).__name__}: {' '.join(str(error).split())}"
    return digest([sim.positions(), sim.velocities(), sim.springs_alive()])


def of_picture(scene: str) -> str:
    """The digest of a scene's picture after some frames."""
    import taichi_cloth

    sim = taichi_cloth.Simulation(taichi_cloth.scenes.build(scene), dt="auto")
    sim.advance(20)
    return digest([taichi_cloth.picture(sim, size=(320, 240))])


def of_session(log: str) -> str:
    """The digest of a recorded session, replayed by the command line."""
    scene, frames = SESSIONS[log]
    with tempfile.TemporaryDirectory() as folder:
        saved = Path(folder) / "saved.npz"
        words = ["run", scene, "--events", str(LOGS / log), "--headless", "--quiet"]
        words += ["--frames", str(frames), "--save", str(saved), "--precision", "f64"]
        done = subprocess.run(
            [sys.executable, "-m", "taichi_cloth", *words],
            capture_output=True,
            text=True,
            cwd=folder,
            env={**os.environ, "PYTHONPATH": str(CHECKOUT)},
        )
        if not saved.exists():
            return f"exit {done.returncode}: {(done.stderr.strip().splitlines() or [''])[-1]}"
        with np.load(saved) as arrays:
            real = [arrays[name] for name in sorted(arrays) if arrays[name].dtype.kind == "f"]
            return f"exit {done.returncode}: {digest(real)}"


def in_process(words: list[str]) -> None:
    """Print what a process of this program finds: `name = digest` a line."""
    from taichi_cloth import runtime

    if words[0] == "pictures":
        runtime.start("cpu", "f32", threads=2)
        for scene in PICTURES:
            print(f"picture {scene} = {of_picture(scene)}", flush=True)
        return
    precision, threads, *each = words
    for word in each:
        scene, method, topology = word.split(":")
        runtime.start("cpu", precision, threads=int(threads))
        name = " ".join((scene, method, topology, precision, threads))
        print(f"{name} = {of_run(scene, method, topology)}", flush=True)


def processes(part: tuple[int, int]) -> Iterator[list[str]]:
    """The words of each process: runs of one scene, precision and number of threads."""

    def alike(run: tuple[str, ...]) -> tuple[str, ...]:
        return run[0], run[3], run[4]

    for (_, precision, threads), found in itertools.groupby(sorted(runs(part), key=alike), alike):
        yield [precision, threads, *(":".join(run[:3]) for run in found)]
    yield ["pictures"]


def lines(part: tuple[int, int]) -> Iterator[str]:
    """All lines of a part."""

    def ask(words: list[str]) -> list[str]:
        command = [sys.executable, "-m", "bench.digest", "--process", *words]
        try:
            done = subprocess.run(
                command, cwd=CHECKOUT, capture_output=True, text=True, timeout=LONGEST
            )
        except subprocess.TimeoutExpired:
            return [f"{' '.join(words)} = took more than {LONGEST} s"]
        said = [line for line in done.stdout.splitlines() if " = " in line]
        if done.returncode:
            last = (done.stderr.strip().splitlines() or [""])[-1]
            said.append(f"{' '.join(words)} = exit {done.returncode}: {last}")
        return said

    with ThreadPoolExecutor(AT_ONCE) as pool:
        for said in pool.map(ask, processes(part)):
            yield from said
        yield from pool.map(lambda log: f"session {log} = {of_session(log)}", SESSIONS)


def main(words: list[str]) -> int:
    """Print the digest; return the exit status."""
    if words[:1] == ["--process"]:
        in_process(words[1:])
        return 0
    parser = argparse.ArgumentParser("python -m bench.digest")
    parser.add_argument("--part", default="1/1", help="which part of how many, as 1/10")
    parser.add_argument("--out", help="a file for the lines")
    parser.add_argument("--against", help="a file of lines, by an earlier version")
    given: Any = parser.parse_args(words)
    os.environ.setdefault("TI_SKIP_VERSION_CHECK", "ON")
    which, of = map(int, given.part.split("/"))
    found = {}
    for line in lines((which, of)):
        print(line, flush=True)
        name, _, said = line.partition(" = ")
        found[name] = said
    if given.out:
        text = "".join(f"{name} = {said}\n" for name, said in found.items())
        Path(given.out).write_text(text)
    if not given.against:
        return 0
    before = dict(line.split(" = ", 1) for line in Path(given.against).read_text().splitlines())
    differ = [name for name, said in found.items() if before.get(name) != said]
    for name in differ:
        print(f"differs: {name}: {before.get(name, 'nothing')} before, {found[name]} now")
    print(f"{len(found)} lines, {len(differ)} differ from {given.against}")
    return 1 if differ else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
