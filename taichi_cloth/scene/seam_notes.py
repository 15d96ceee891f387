"""Notes on meshes whose seams are open, and on parts of them that nothing holds."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from taichi_cloth.files.meshes.seams import gaps, usual_reach
from taichi_cloth.files.meshes.surface import Surface, components
from taichi_cloth.scene.model import Particles, Springs
from taichi_cloth.scene.reading import Sheet


def open_seams(surface: Surface, number: np.ndarray, index: int) -> Iterator[str]:
    """Clauses on vertices of borders near other borders that they are not joined to.

    surface: as it is placed; number: each vertex's own in its file; index: of its entry in
    [[meshes]]. Vertices at exactly the same place have a note of their own (`cli.run_notes`).
    """
    found = gaps(surface, usual_reach(surface))
    apart = found.apart > 0
    pairs, distance = number[found.pairs[apart]], found.apart[apart]
    for rows, off, where, of in (
        (pairs, distance, "near another one of a border", ""),
        (number[found.at_edges[:, :3]], found.off, "at an edge that does not end there", "edge "),
    ):
        if len(rows):
            count, to = len(np.unique(rows[:, 0])), " to ".join(map(str, rows[0, 1:]))
            lie = "1 vertex of a border lies" if count == 1 else f"{count} vertices of borders lie"
            most = f", the farthest {off.max():.3g}" if off.max() > off[0] else ""
            yield (
                f"{lie} {where}, and nothing joins them: the first is {rows[0, 0]}, {off[0]:.3g} "
                f"from {of}{to}{most}; {_remedy(surface, off, index)}"
            )


def _remedy(surface: Surface, off: np.ndarray, index: int) -> str:
    """The remedy that joins vertices so far apart, if that is less than the shortest edge."""
    corners = surface.vertices[surface.triangles]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    most = max(1.01 * float(off.max()), 1e-6 * float(edges.max()))
    digits = 10.0 ** (np.floor(np.log10(most)) - 1)
    length = float(np.ceil(most / digits) * digits)
    if length < edges.min():
        return f"--set meshes[{index}].weld={length:.2g}, or weld in [[meshes]], closes such seams"
    return "where that is a seam, merge the mesh's vertices by distance"


def loose_parts(sheet: Sheet, begin: int, particles: Particles, springs: Springs) -> Iterator[str]:
    """A clause on the parts of a mesh that nothing holds, where something in the scene is held.

    begin: the number of its first particle; particles, springs: the whole scene's.
    """
    number = sheet.number
    if number is None or not particles.fixed.any():
        return
    mine = slice(begin, begin + len(sheet.particles))
    count, part = components(springs.between, len(particles))
    held = np.bincount(part, particles.fixed, minlength=count) > 0
    of_mesh = np.unique(part[mine])
    loose = of_mesh[~held[of_mesh]]
    if not len(loose):
        return
    if len(loose) == len(of_mesh):
        yield "it has no pins, as other things of the scene have, and will fall"
        return
    from scipy.spatial import cKDTree

    first = int((~held[part[mine]]).argmax())
    x, in_part = particles.position, part == part[begin + first]
    own = begin + np.flatnonzero(in_part[mine])
    rest = begin + np.flatnonzero(~in_part[mine])
    distance, other = cKDTree(x[rest]).query(x[own])
    at = int(distance.argmin())
    here, there = number[own[at] - begin], number[rest[other[at]] - begin]
    yield (
        f"{len(loose)} of its {len(of_mesh)} parts {'hang' if len(loose) > 1 else 'hangs'} on "
        f"nothing and will fall: the first has vertex {number[first]}, and is {distance[at]:.3g} "
        f"from the rest, at vertices {here} and {there}"
    )
