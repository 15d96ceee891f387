"""Device code: fields and Taichi kernels. Knows no scene, no file and no window.

Units are the scene's own: any that fit together, for example N/m for a stiffness, N s/m for a
damping and kg for a mass where lengths are in m and times in s.

These names mean the same in every file of this folder, and docstrings do not repeat them:

- spec: the `specialization.Specialization` that is compiled; state: the `state.State` with all
  device data; t: the number of the thread that runs a loop, 0 where one runs all of it.
- i, j: packs, the particles that one vector holds (`packs.py`); on a graph and on GPUs a pack is
  one particle. slot: the place of one particle, pack * lanes + lane.
- g: a grid of particles; s: a kind of link, which is a spring of a grid (`grids.py`), or a spring
  on the graph; h: a half-spring; p: a row of half-springs, those of one particle (`graph.py`).
- x position, v velocity, a acceleration, f force, w inverse mass (0 = fixed), k stiffness,
  c damping, dt the time of a step; of a pack, these are matrices (dim, lanes) or vectors (lanes,),
  on a graph a vector (dim,) or a number.
- value, number: functions that read a field of vectors or of numbers at i: `packs.read` where i is
  a pack, `packs.slot_value` or `packs.slot_number` where it is a slot.
- begin, first: the first pack of a row or of a grid; width: how many packs a row has without its
  halos; pitch: how many lie from the start of one row to the start of the next.
"""

import os

from taichi_cloth.front_end import mending

mending.imported()  # it would print a banner otherwise
for _folder, _, _files in os.walk(__path__[0]):
    if "__init__.py" in _files:
        mending.load_quickly(_folder)  # Taichi reads files for each function otherwise
