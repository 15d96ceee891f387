"""The time that prepared launches save.

    python -m bench.experiments.launch_cost [SCENE:METHOD:SUBSTEPS[:SIDE]] ...

Microseconds of a frame by itself, `Simulation.advance()`, with launches as Taichi makes them and
prepared (`simulation/prepared.py`): medians of frames by turns, of one simulation. SIDE: of a cloth
of so many particles a row and a column.
"""

import statistics
import sys
import time

ASKED = "cloth:symplectic_euler:1", "cloth:rk4:1", "warp:verlet:32:32"
WAYS = (("lanes", "serial"), ("graph", "serial"), ("lanes", "parallel"))
TURNS, FRAMES = 50, 10


def measure(sim):
    """The medians of a frame's microseconds: as Taichi launches it, and prepared."""
    from taichi_cloth.simulation.prepared import PreparedLaunches

    found = PreparedLaunches.find
    ways = {"usual": lambda *_: None, "prepared": found}
    times = {name: [] for name in ways}
    sim.advance()
    for _ in range(TURNS):
        for name, find in ways.items():
            PreparedLaunches.find = find
            for _ in range(FRAMES):
                begin = time.perf_counter()
                sim.advance()
                times[name].append(time.perf_counter() - begin)
    PreparedLaunches.find = found
    return [1e6 * statistics.median(each) for each in times.values()]


def main(asked):
    """Print a table, a line for each scene and way."""
    from taichi_cloth.scene.source import SceneSource
    from taichi_cloth.simulation.simulation import Simulation

    print("| scene | method, substeps | path | µs a frame | prepared |")
    print("|---" * 5 + "|")
    for words in asked:
        scene, method, substeps, *side = words.split(":")
        values = {"columns": int(side[0]), "rows": int(side[0])} if side else {}
        if side and scene == "warp":
            values = {"side": int(side[0])}
        made = SceneSource(scene, values).build()
        name = f"`{scene}`" + "".join(f", {n}²" for n in side)
        for topology, execution in WAYS:
            way = {"topology": topology, "execution": execution, "substeps": int(substeps)}
            usual, prepared = measure(Simulation(made, method, **way))
            path = f"{topology}, {execution}"
            print(f"| {name} | `{method}`, {substeps} | {path} | {usual:.0f} | {prepared:.0f} |")
            sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1:] or ASKED)
