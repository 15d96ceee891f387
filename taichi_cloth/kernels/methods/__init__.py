"""Time-integration methods, one file each, discovered by name.

A method's file has a docstring with its formula and source, `CLAIMS`, and `step(spec, state, t)`,
a ti.func that advances the state by state.dt[None], as thread t of those that share the work.
`begin(spec, state, t)`, where it has one, comes before its first step, and after every change of
the state from outside: forces that it keeps from step to step are computed there.
`VECTORS` names what it must remember of each particle: state.<name>, fields of packs; those in
`HALOED` are read by neighbours, those in `LOW_VECTORS` are there in compensated sums only.
`SCALARS` and `COUNTS` name 0-D fields of real and whole numbers, `SUMS` counts its sums over all
particles (`loops.add_up`). What it needs of the host beside the state is in `NEEDS`: "summed_springs" for
state.summed_k and state.summed_c, "spring_colours" or "particle_colours" for what
`kernels/colours.py` goes through.

A method whose rounds are not known beforehand has, instead of `step`, `PHASES`: a step is then
`PHASES[0]`, and whatever phases `go_to` leads to, until it leads to DONE (`kernels/phases.py`);
`LAUNCHES`, where there are too many of them for one kernel, says which ones share a launch, and
`LANES` how many lanes packs have at most.

Positions and velocities are changed by `compensated.add_to_position` and `compensated.add_to_velocity`, which are plain sums but in
the precision `compensated`.
Adding a method is adding a file.
"""

import importlib
import pkgutil

METHODS = tuple(sorted(m.name for m in pkgutil.iter_modules(__path__) if m.name != "contract"))


def load(name):
    """The module of the method `name`, out of `METHODS`. Importing it imports Taichi."""
    return importlib.import_module(f"{__name__}.{name}")
