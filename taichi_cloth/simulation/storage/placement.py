"""Placements of a scene's particles and springs, in each topology that can hold it."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from taichi_cloth.kernels import forces
from taichi_cloth.kernels.forces.contract import CURVATURE
from taichi_cloth.kernels.spring_numbers import NUMBERS
from taichi_cloth.kernels.state import MOST_BLOCKS
from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.stencils import Stencils
from taichi_cloth.settings.options import TOPOLOGIES
from taichi_cloth.simulation.storage import adjacency, layouts, packing
from taichi_cloth.simulation.storage.layouts import Layout

LEAST_BLOCKS = 16
COLOURED = {"spring_colours", "particle_colours"}  # what methods need that take springs in turns


@dataclass(frozen=True)
class Placement:
    """Places of n particles and s springs, and the order in which the device has them.

    graph_springs: numbers of the springs that are on the graph, in the order of memory: those of
    one colour together, where they have colours. colours: theirs, 0 where the method wants none.
    links: numbers of the springs that are links of grids; link_places: (links, 2) int32, each
    one's kind and the slot of its earlier end. graph_stencils, stencil_colours, lines, line_places:
    the same of stencils, those on the graph and those along lines of grids.
    """

    layout: Layout
    graph_springs: np.ndarray
    colours: np.ndarray
    links: np.ndarray
    link_places: np.ndarray
    graph_stencils: np.ndarray
    stencil_colours: np.ndarray
    lines: np.ndarray
    line_places: np.ndarray


class Placements:
    """Finds the placements of one scene, each once.

    needs: what the method asks of the host (`kernels.methods`). lanes: particles in a pack. packs:
    whether rows of a graph may be packed, too.
    """

    def __init__(
        self, scene: Scene, needs: Collection[str], lanes: int, packs: bool = False
    ) -> None:
        self._scene, self._needs, self._lanes = scene, needs, lanes
        self.packs, self._wide = packs, lanes >= packing.LANES
        self._terms = forces.present_in(scene)
        bends = any(forces.load(name).adds == CURVATURE for name in self._terms)
        self._stencils = scene.stencils if bends else Stencils.none()
        self._layouts: dict[str, Layout | None] = {}
        self._placements: dict[str, Placement] = {}
        self._blocks: np.ndarray | None = None

    def topologies(self) -> list[str]:
        """The topologies that the scene can be stored in."""
        # The graph takes any springs: its layout is not looked for where nobody asks for it.
        return [name for name in TOPOLOGIES if name == "graph" or self._layout(name) is not None]

    def find(self, topology: str) -> Placement | None:
        """The placement in a topology; None for lanes, where the scene has no regular grid."""
        layout = self._layout(topology)
        if layout is None:
            return None
        if topology not in self._placements:
            self._placements[topology] = self._place(layout)
        return self._placements[topology]

    def particle_colours(self) -> np.ndarray:
        """The colour of each particle, (n,), whose springs tie none of the same colour."""
        scene = self._scene
        count, grids = len(scene.particles), self._layout("lanes")
        return layouts.particle_colours(scene.springs, grids, count, self._stencils)

    def blocks(self) -> np.ndarray:
        """The block of each particle, (n,), that solvers move as one (`solvers/two_levels.py`)."""
        if self._blocks is None:
            springs, count = self._scene.springs.between, len(self._scene.particles)
            self._blocks = adjacency.blocks(springs, count, _halvings(count))
        return self._blocks

    def is_simple(self) -> bool:
        """True if particles have nothing but springs, walls and terms of their own."""
        return self._may_be_packed() and not self._scene.features().obstacles

    def _may_be_packed(self) -> bool:
        """True if a scene has nothing that packed rows of a graph do not know, or gain nothing in.

        That is what acts on triangles, stencils and pairs, or changes numbers of springs.
        """
        scene, features = self._scene, self._scene.features()
        return not (
            len(self._stencils)
            or features.collisions
            or forces.act_on_triangles(scene)
            or any(number.changes(self._terms) for number in NUMBERS)
            or COLOURED & set(self._needs)
        )

    def _place(self, layout: Layout) -> Placement:
        links = np.flatnonzero(layout.kind >= 0)
        graph_springs, colours = self._sorted_springs(layout)
        graph_stencils, stencil_colours = self._sorted_stencils(layout)
        lines = np.flatnonzero(layout.line >= 0)
        return Placement(
            layout=layout,
            graph_springs=graph_springs,
            colours=colours,
            links=links,
            link_places=np.column_stack([layout.kind[links], layout.owner[links]]).astype(np.int32),
            graph_stencils=graph_stencils,
            stencil_colours=stencil_colours,
            lines=lines,
            line_places=np.column_stack([layout.line[lines], layout.line_owner[lines]]).astype(
                np.int32
            ),
        )

    def _layout(self, topology: str) -> Layout | None:
        if topology not in self._layouts:
            self._layouts[topology] = self._find_layout(topology)
        return self._layouts[topology]

    def _find_layout(self, topology: str) -> Layout | None:
        scene = self._scene
        count = len(scene.particles)
        if topology == "graph":
            # Collisions add up in the order of the particles, which is then that of memory too.
            sort = not scene.features().collisions
            packs = self.packs and self._wide and self._may_be_packed()
            return layouts.on_graph(scene.springs, count, sort, self._stencils, packs)
        period = layouts.any_period
        if "spring_colours" in self._needs:
            period = layouts.spring_period
        elif "particle_colours" in self._needs:
            period = layouts.particle_period
        return layouts.on_grids(
            scene.springs, count, self._lanes, period, self._terms, self._stencils
        )

    def _sorted_springs(self, layout: Layout) -> tuple[np.ndarray, np.ndarray]:
        """The springs that no grid holds, in the order of memory, and their colours."""
        springs = np.flatnonzero(layout.kind < 0)
        if "spring_colours" not in self._needs:
            return springs, np.zeros(len(springs), np.int64)
        scene, grids = self._scene, self._layout("lanes")
        colour = layouts.spring_colours(scene.springs, grids, len(scene.particles))[springs]
        # In the order of memory within a colour.
        near = layout.slot[scene.springs.between[springs]].min(axis=1)
        order = np.lexsort((near, colour))
        return springs[order], colour[order]

    def _sorted_stencils(self, layout: Layout) -> tuple[np.ndarray, np.ndarray]:
        """The stencils that lie along no line of a grid, in the order of memory; their colours."""
        stencils, count = self._stencils, len(self._scene.particles)
        mine = np.flatnonzero(layout.line < 0)
        if "spring_colours" not in self._needs:
            return mine, np.zeros(len(mine), np.int64)
        colour = layouts.stencil_colours(stencils, self._layout("lanes"), count)[mine]
        order = np.argsort(colour, kind="stable")
        return mine[order], colour[order]


def _halvings(particle_count: int) -> int:
    """The times that particles are cut in two to make blocks of them.

    There are half as many as the root of their number, to the nearest power of two.
    """
    least, most = int(math.log2(LEAST_BLOCKS)), int(math.log2(MOST_BLOCKS))
    return min(max(round(math.log2(max(particle_count, 1)) / 2) - 1, least), most)
