"""What `__init__.py` makes public, for type checkers, which run nothing."""

from taichi_cloth.comparison.compare import Comparison as Comparison
from taichi_cloth.comparison.compare import compare as compare
from taichi_cloth.errors import InputError as InputError
from taichi_cloth.errors import RunFailure as RunFailure
from taichi_cloth.errors import SimulationFailure as SimulationFailure
from taichi_cloth.files import trajectory as _trajectory
from taichi_cloth.files.trajectory import Trajectory as Trajectory
from taichi_cloth.render.camera import Camera as Camera
from taichi_cloth.runtime import start as start
from taichi_cloth.scene import library as _library
from taichi_cloth.scene import scenefile as _scenefile
from taichi_cloth.scene.checks import validate as validate
from taichi_cloth.scene.cloth import grid as grid
from taichi_cloth.scene.cloth import grid_stencils as grid_stencils
from taichi_cloth.scene.cloth import grid_triangles as grid_triangles
from taichi_cloth.scene.material import Material as Material
from taichi_cloth.scene.mesh import mesh as mesh
from taichi_cloth.scene.model import ParticleDefaults as ParticleDefaults
from taichi_cloth.scene.model import Particles as Particles
from taichi_cloth.scene.model import Scene as Scene
from taichi_cloth.scene.model import SpringDefaults as SpringDefaults
from taichi_cloth.scene.model import Springs as Springs
from taichi_cloth.scene.model import World as World
from taichi_cloth.scene.obstacles import Obstacle as Obstacle
from taichi_cloth.scene.stencils import Stencils as Stencils
from taichi_cloth.scene.stencils import mesh_stencils as mesh_stencils
from taichi_cloth.simulation.checkpoint import Checkpoint as Checkpoint
from taichi_cloth.simulation.simulation import Simulation as Simulation
from taichi_cloth.ui import interaction as _interaction
from taichi_cloth.ui.framing import camera_of as camera_of
from taichi_cloth.ui.showing import picture as picture
from taichi_cloth.ui.showing import show as show
from taichi_cloth.ui.summary import Summary as Summary

__version__: str
scenes = _library
load_scene, save_scene = _scenefile.load, _scenefile.save
load_events, load_trajectory = _interaction.load, _trajectory.load
