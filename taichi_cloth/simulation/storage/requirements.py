"""Requirements of a scene on the device: what is compiled for it, and room for how much."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence

import numpy as np

from taichi_cloth.kernels import forces
from taichi_cloth.kernels.fields import Capacity
from taichi_cloth.kernels.specialization import Specialization
from taichi_cloth.kernels.spring_numbers import NUMBERS
from taichi_cloth.kernels.state import STIFF_ON_GRAPH
from taichi_cloth.runtime import Device
from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.penetration import touches
from taichi_cloth.scene.solids import Solid, met_by_faces
from taichi_cloth.scene.stencils import Stencils
from taichi_cloth.simulation.snapshot import Snapshot
from taichi_cloth.simulation.storage.layouts import WORTH_SORTING
from taichi_cloth.simulation.storage.placement import Placement
from taichi_cloth.simulation.storage.sums import summed_springs

WORTH_BLOCKS = 256  # particles: products of fewer take less than what blocks need


def specialization(
    snapshot: Snapshot,
    solids: Sequence[Solid],
    placement: Placement,
    device: Device,
    *,
    topologies: Callable[[], Sequence[str]],
    needs: Collection[str],
    accounts_contacts: bool,
) -> Specialization:
    """Requirements of a state in a placement, with parallel loops in one launch per step.

    solids: what is in the way. topologies: says which ones the scene can be stored in, and is only
    asked where that matters. needs: what the method asks of the host. accounts_contacts: whether
    an account of contacts is asked for.
    """
    scene, layout = snapshot.scene, placement.layout
    features = dict(vars(scene.features()))
    spawns = scene.world.takes_clicks
    listed = len(placement.graph_stencils) > 0
    features["springs"] &= spawns or listed or len(placement.graph_springs) > 0
    # What was cut is gone where nothing else can break.
    features["fracture"] |= not snapshot.alive.all()
    terms = forces.present_in(scene)
    features["uniform_springs"] &= not any(number.changes(terms) for number in NUMBERS)
    features["uniform_springs"] &= layout.rows is None  # lanes without a spring have other ones
    return Specialization(
        **features,
        faces=bool(met_by_faces(scene, solids)),
        terms=terms,
        lanes=layout.lanes,
        links=layout.links,
        lines=layout.lines,
        stencils=listed,
        keeps_pulls="particle_colours" in needs and _are_large(scene.stencils, placement),
        rows_share_stiffness=layout.rows_share_stiffness and not features["fracture"],
        compensated=device.compensated,
        together=layout.rows is None
        and device.arch == "cpu"
        and _is_large_net(scene)
        and "lanes" not in topologies(),
        packed_rows=layout.rows is not None,
        blocks_on_graph="kept_stiffness" in needs
        and device.arch == "cpu"
        and not layout.links
        and not forces.act_on_triangles(scene)
        and _is_stiff(scene),
        accounts_contacts=accounts_contacts and touches(scene, solids),
        threads=device.threads,
        one_launch_per_step=True,
    )


def _are_large(stencils: Stencils, placement: Placement) -> bool:
    """True if any listed stencil has more than the three particles of those of grids, which are
    computed anew as soon as kept.
    """
    return bool((stencils.sizes[placement.graph_stencils] > 3).any())


def _is_large_net(scene: Scene) -> bool:
    """True if it is worth the while to compute several springs at once."""
    particles, springs = len(scene.particles), len(scene.springs)
    return particles >= WORTH_SORTING and springs >= 2 * particles


def _is_stiff(scene: Scene) -> bool:
    """True if springs of many particles are so stiff at the scene's step that blocks may pay.

    A step of a method, or a stage of it, may be shorter: kernels look again (`newton_cg._judge`).
    """
    particles = scene.particles
    if len(particles) < WORTH_BLOCKS:
        return False
    stiffness, _ = summed_springs(scene, np.ones(len(scene.springs), bool)).T
    bound = stiffness[~particles.fixed] / particles.mass[~particles.fixed]
    return bool(scene.world.dt**2 * bound.max(initial=0.0) > STIFF_ON_GRAPH)


def capacity(scene: Scene, solids: Sequence[Solid], placement: Placement) -> Capacity:
    """Room for a scene in a placement, with what is in its way, and none to spare."""
    layout, thick = placement.layout, scene.features().thick
    # What clicks put beside grids is in a block of rows of its own.
    clicked = layout.beside if scene.world.takes_clicks else 0
    return Capacity(
        particles=len(scene.particles),
        springs=len(placement.graph_springs),
        columns=0 if layout.rows is None else len(layout.rows.run),
        copies=0 if layout.rows is None else layout.rows.copies,
        packs=layout.n_packs,
        grids=len(layout.grid) + (clicked > 0 and bool(layout.grid[:, 3].all())),
        row=max(layout.row, clicked),
        obstacles=len(solids),
        nodes=sum(solid.nodes for solid in solids),
        triangles=len(scene.triangles) if forces.act_on_triangles(scene) else 0,
        elements=len(scene.elements) if met_by_faces(scene, solids) else 0,
        stencils=len(placement.graph_stencils),
        stencil_particles=int(scene.stencils.sizes[placement.graph_stencils].sum()),
        stencil_sides=len(scene.stencil_sides[0]),
        closer=len(scene.spheres.other) if thick else 0,
        patches=len(scene.spheres.patch_start) if thick else 0,
    )
