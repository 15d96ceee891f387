"""Where each second of a cold start goes: `python tests/compile_cost.py [SCENE:METHOD[:SIDE]] ...`.

A process each, with an empty cache of kernels, to the end of its first frame; SIDE: of a cloth
of so many particles a row and a column. Seconds are the processor's, which other work on the
machine hardly changes. --in-a-piece: as if no step were compiled in parts.
"""

import json
import os
import subprocess
import sys
import tempfile
import time

EACH = ("verlet", "implicit_euler", "tr_bdf2", "xpbd", "vbd")
ASKED = [f"cloth:{method}" for method in EACH] + [
    *(f"{scene}:{method}" for scene in ("box", "warp", "drape") for method in EACH[:2]),
    *("cloth:verlet:64", "cloth:implicit_euler:64"),
]
HEADS = "start", "front end", "machine code", "largest", "rest", "total"


def measure(in_a_piece, scene, method, side=None):
    """The processor's seconds of what `HEADS` names, how many kernels there are, and the path."""
    marks = [0.0]
    from taichi_cloth import front_end, runtime
    from taichi_cloth.scene.source import SceneSource
    from taichi_cloth.simulation.simulation import Simulation

    if in_a_piece:
        front_end.functions_work = lambda: False
    runtime.start("cpu")
    marks.append(time.process_time())
    front, code = _watch_kernels()
    values = {"columns": int(side), "rows": int(side)} if side else {}
    sim = Simulation(SceneSource(scene, values).build(), method)
    sim.advance()
    marks.append(time.process_time())
    start, end = marks[1:]
    reading, making = sum(front), sum(code.values())
    rest = end - start - reading - making
    found = start, reading, making, max(code.values()), rest, end
    return {"seconds": found, "kernels": len(code), "topology": sim.topology}


def _watch_kernels():
    """Lists that get the seconds of Taichi's front end, and, by kernel, of its first launch."""
    from taichi.lang import kernel_impl

    front, code = [], {}
    materialize, launch = kernel_impl.Kernel.materialize, kernel_impl.Kernel.launch_kernel

    def materialized(self, *given, **named):
        begin = time.process_time()
        materialize(self, *given, **named)
        front.append(time.process_time() - begin)

    def launched(self, kernel, *given):
        begin = time.process_time()
        result = launch(self, kernel, *given)
        code.setdefault(id(kernel), time.process_time() - begin)
        return result

    kernel_impl.Kernel.materialize, kernel_impl.Kernel.launch_kernel = materialized, launched
    return front, code


def main(asked, in_a_piece):
    """Print a table, a line for each."""
    print("| scene | method | path | kernels | " + " | ".join(HEADS) + " |")
    print("|---" * (4 + len(HEADS)) + "|")
    for words in asked:
        scene, method, *side = words.split(":")
        with tempfile.TemporaryDirectory() as folder:
            places = {"TI_OFFLINE_CACHE_FILE_PATH": folder, "XDG_CACHE_HOME": folder}
            child = [sys.executable, __file__, "--one", *in_a_piece, scene, method, *side]
            text = subprocess.run(
                child, env=os.environ | places, check=True, capture_output=True, text=True
            ).stdout
        found = json.loads(text.splitlines()[-1])
        name = f"`{scene}`" + "".join(f", {n}²" for n in side)
        seconds = " | ".join(f"{value:.2f}" for value in found["seconds"])
        print(f"| {name} | `{method}` | {found['topology']} | {found['kernels']} | {seconds} |")
        sys.stdout.flush()


if __name__ == "__main__":
    in_a_piece = [word for word in sys.argv[1:] if word == "--in-a-piece"]
    asked = [word for word in sys.argv[1:] if word not in ("--one", *in_a_piece)]
    if sys.argv[1:2] == ["--one"]:
        print(json.dumps(measure(bool(in_a_piece), *asked)))
    else:
        main(asked or ASKED, in_a_piece)
