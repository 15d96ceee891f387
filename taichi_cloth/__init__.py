"""Interactive cloth and spring-mass simulator on Taichi.

Public names are imported when they are first used: importing this package starts nothing.
"""

from __future__ import annotations

import os
from typing import Any

from taichi_cloth import imports as _imports
from taichi_cloth.simulation import showing as _showing
from taichi_cloth.version import __version__

# NumPy's OpenBLAS keeps a processor busy for a tenth of a second after its start and each use, to
# be quick if more comes: 2**4 ticks of the clock have to do. It reads this once NumPy is imported.
os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", "4")

# Services and containers may name no home, and users there may have none: Taichi ends the process
# then, while it is imported.
if os.name == "posix":
    _home = os.path.expanduser("~")
    os.environ.setdefault("HOME", _home if os.path.isabs(_home) else os.sep)

# Public name: (module, name in it; None: the module itself). `__init__.pyi` tells type checkers.
_HOMES = {
    "InputError": ("errors", "InputError"),
    "RunFailure": ("errors", "RunFailure"),
    "SimulationFailure": ("errors", "SimulationFailure"),
    "Scene": ("scene.model", "Scene"),
    "World": ("scene.model", "World"),
    "Particles": ("scene.model", "Particles"),
    "ParticleDefaults": ("scene.model", "ParticleDefaults"),
    "Springs": ("scene.model", "Springs"),
    "SpringDefaults": ("scene.model", "SpringDefaults"),
    "Material": ("scene.material", "Material"),
    "Obstacle": ("scene.obstacles", "Obstacle"),
    "validate": ("scene.checks", "validate"),
    "grid": ("scene.cloth", "grid"),
    "grid_triangles": ("scene.cloth", "grid_triangles"),
    "mesh": ("scene.mesh", "mesh"),
    "grid_stencils": ("scene.cloth", "grid_stencils"),
    "mesh_stencils": ("scene.stencils", "mesh_stencils"),
    "Stencils": ("scene.stencils", "Stencils"),
    "load_scene": ("scene.scenefile", "load"),
    "save_scene": ("scene.scenefile", "save"),
    "load_events": ("ui.interaction", "load"),
    "load_trajectory": ("files.trajectory", "load"),
    "compare": ("comparison.compare", "compare"),
    "Comparison": ("comparison.compare", "Comparison"),
    "Trajectory": ("files.trajectory", "Trajectory"),
    "Simulation": ("simulation.simulation", "Simulation"),
    "show": ("ui.showing", "show"),
    "picture": ("ui.showing", "picture"),
    "Camera": ("render.camera", "Camera"),
    "camera_of": ("ui.framing", "camera_of"),
    "Summary": ("ui.summary", "Summary"),
    "Checkpoint": ("simulation.checkpoint", "Checkpoint"),
    "start": ("runtime", "start"),
    "scenes": ("scene.library", None),
}
# A simulation that shows itself is drawn by the floor above it, which comes once that is asked for.
_showing.drawn_by(lambda: _imports.module("taichi_cloth.ui.showing"))
_showing.examined_by(lambda: _imports.module("taichi_cloth.post_mortem.reporting"))
# So is it with the errors of what a window shows, and with why its run failed.
_showing.measured_by(lambda sim: _imports.module("taichi_cloth.cli.run_meter").of(sim))
_showing.explained_by(lambda sim: _imports.module("taichi_cloth.cli.run_report").Examining(sim))
__all__ = ["__version__", *_HOMES]  # noqa: PLE0604


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'taichi_cloth' has no attribute {name!r}")
    module_name, attribute = _HOMES[name]
    module = _imports.module(f"taichi_cloth.{module_name}")
    return module if attribute is None else getattr(module, attribute)


def __dir__() -> list[str]:
    return sorted(__all__)
