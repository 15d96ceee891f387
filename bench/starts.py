"""Seconds of a start and milliseconds of a frame, beside an earlier build's, in turns.

    python -m bench.starts --against PYTHON [--rounds 3] [--scenes cloth,drape]

PYTHON is the interpreter of the earlier build's environment. A start is a command's wall time to
the end of its first headless frame: cold with an empty cache of kernels, then warm. A frame is what
the command says of those after the first. All are the least of the rounds; the last column of each
is the ratio of ours to the earlier one's.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from typing import Any

SCENES = "cloth,box,drape,flag,stack,shirt"
FRAMES = 120
SAID = re.compile(r": ([\d.]+) (us|ms|s) a frame to simulate")
IN_MS = {"us": 1e-3, "ms": 1.0, "s": 1e3}
KINDS = {"cold start": "s", "warm start": "s", "frame": "ms"}


def command(python: str, scene: str, frames: int, home: str) -> tuple[float, str]:
    """The wall seconds of a headless run, and what it printed. home: has its caches."""
    given = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    given |= {"HOME": home, "XDG_CACHE_HOME": home, "TI_OFFLINE_CACHE_FILE_PATH": home}
    given |= {"TI_SKIP_VERSION_CHECK": "ON"}
    words = ["-m", "taichi_cloth", "run", scene, "--headless", "--frames", str(frames)]
    begin = time.perf_counter()
    done = subprocess.run([python, *words], env=given, cwd=home, capture_output=True, text=True)
    taken = time.perf_counter() - begin
    if done.returncode:
        raise SystemExit(f"{python}, {scene}: {(done.stderr.strip().splitlines() or [''])[-1]}")
    return taken, done.stdout


def measure(python: str, scene: str) -> dict[str, float]:
    """A build's cold start, warm start [s] and frame [ms] of a scene, each once."""
    with tempfile.TemporaryDirectory() as home:
        cold, _ = command(python, scene, 1, home)
        warm, _ = command(python, scene, 1, home)
        said = SAID.search(command(python, scene, FRAMES, home)[1])
    if said is None:
        raise SystemExit(f"{python}, {scene}: it says nothing of its frames")
    return {
        "cold start": cold,
        "warm start": warm,
        "frame": float(said.group(1)) * IN_MS[said.group(2)],
    }


def main(words: list[str]) -> int:
    """Print a table; return the exit status."""
    parser = argparse.ArgumentParser("python -m bench.starts")
    parser.add_argument("--against", required=True, help="the Python of the earlier build")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--scenes", default=SCENES)
    given: Any = parser.parse_args(words)
    print("| scene | " + " | ".join(f"{kind} | before | ratio" for kind in KINDS) + " |")
    print("| --- |" + " --- |" * 3 * len(KINDS))
    for scene in given.scenes.split(","):
        ours, theirs = [], []
        for _ in range(given.rounds):
            ours.append(measure(sys.executable, scene))
            theirs.append(measure(given.against, scene))
        cells = []
        for kind, unit in KINDS.items():
            now, before = (min(one[kind] for one in found) for found in (ours, theirs))
            cells += [f"{now:.3g} {unit}", f"{before:.3g} {unit}", f"{now / before:.2f}"]
        print(f"| {scene} | " + " | ".join(cells) + " |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
