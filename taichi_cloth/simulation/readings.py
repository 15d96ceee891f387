"""Readings of a simulation, as its users call them."""

from __future__ import annotations

import numpy as np

from taichi_cloth.limits.network import Network
from taichi_cloth.scene.penetration import deepest, touches
from taichi_cloth.scene.solids import Drawn, Inside, depths, inside_at_start, surface
from taichi_cloth.scene.spheres import too_near
from taichi_cloth.settings import accepted
from taichi_cloth.simulation import diagnostics, sixteen
from taichi_cloth.simulation.part import Part


class Readings(Part):
    """The part of a `Simulation` that reads its particles and springs back from the device.

    Arrays are float64 copies, one row per particle or spring in the order of creation.
    """

    @property
    def particle_count(self) -> int:
        """The number of particles."""
        return len(self.storage.scene.particles)

    @property
    def spring_count(self) -> int:
        """The number of springs, broken ones included."""
        return len(self.storage.scene.springs)

    @property
    def lanes(self) -> int:
        """The particles of a regular grid in a vector; 1 on the graph, and on GPUs."""
        return self.storage.specialization.lanes if self.topology == "lanes" else 1

    @property
    def wide(self) -> bool:
        """True if it has sixteen lanes, whose bits may differ from those of eight."""
        return self.lanes == sixteen.LANES

    @property
    def hurries(self) -> bool:
        """True if its kernels are those that compile soon, for want of faster ones."""
        return self._launcher.hurries

    @property
    def way(self) -> str:
        """The way it is run, in words: "parallel lanes", "serial graph", "serial lanes of 16"."""
        wide = f" of {self.lanes}" if self.wide else ""
        return f"{self.execution} {self.topology}{wide}"

    def positions(self) -> np.ndarray:
        """Positions, (n, dim)."""
        return self.storage.positions()

    def velocities(self) -> np.ndarray:
        """Velocities, (n, dim)."""
        return self.storage.velocities()

    def forces(self) -> np.ndarray:
        """The total force on each particle in the present state, (n, dim), in the scene's units.

        It is that of springs, dashpots, drag, gravity, air and a push that is held, but not of
        contacts, which are impulses; on fixed particles, too: what holds them gives the opposite.
        """
        return self.storage.forces(self.steps)

    def radii(self) -> np.ndarray:
        """Radii, (n,)."""
        radii: np.ndarray = self.storage.scene.particles.radius.copy()
        return radii

    def colors(self) -> np.ndarray:
        """Colours, (n, 3) uint8."""
        colors: np.ndarray = self.storage.scene.particles.color.copy()
        return colors

    def fixed(self) -> np.ndarray:
        """Which particles are held, (n,) bool."""
        fixed: np.ndarray = self.storage.scene.particles.fixed.copy()
        return fixed

    def springs(self) -> np.ndarray:
        """The particles each spring ties, (s, 2), broken springs included."""
        springs: np.ndarray = self.storage.scene.springs.between.copy()
        return springs

    def springs_alive(self) -> np.ndarray:
        """Which springs hold, (s,) bool: those whose force has not exceeded their break force."""
        return self.storage.springs_alive()

    def triangles(self) -> np.ndarray:
        """The particles at the corners of each triangle, (m, 3), torn ones included."""
        triangles: np.ndarray = self.storage.scene.triangles.copy()
        return triangles

    def triangles_alive(self) -> np.ndarray:
        """Which triangles are whole, (m,) bool: all springs along their sides hold."""
        return self.storage.triangles_alive()

    def normals(self) -> np.ndarray:
        """Unit normals of the surface at each particle, (n, 3), 0 where there is none.

        The triangles at a particle count by their areas. A triangle is gone from here and from the
        forces when a spring along its side is gone, which is a step after that broke.
        """
        return self.storage.drawn_normals().astype(np.float64)

    def drawn_normals(self) -> np.ndarray:
        """Those normals for a window, (n, 3) in the device's precision.

        Without a copy: the next call fills the same array anew.
        """
        return self.storage.drawn_normals()

    def drawn_positions(self) -> np.ndarray:
        """Positions for a window, (n, dim) in the device's precision.

        Without a copy: the next call fills the same array anew.
        """
        return self.storage.drawn_positions()

    def drawn_springs(self) -> np.ndarray:
        """The particles that each spring that holds ties, (alive, 2).

        The same array until a spring breaks, comes or is whole again.
        """
        return self.storage.drawn_springs()

    def drawn_triangles(self) -> np.ndarray:
        """The particles at the corners of each triangle that is whole, (whole, 3).

        The same array until a spring breaks, comes or is whole again.
        """
        return self.storage.drawn_triangles()

    def obstacles(self, time: float | None = None) -> list[Drawn]:
        """Obstacles in their order, then the ground, where they are at a time.

        Each has vertices (k, dim) and triangles (m, 3) to draw it by. Resting walls are left out.
        time: of the scene; None: now.
        """
        time = self.time if time is None else accepted.number("obstacles: time", time)
        world, found = self.storage.scene.world, []
        extent = float(np.linalg.norm(world.size))
        for solid in self.storage.solids:
            if not solid.name.endswith("wall"):
                shape = surface(solid, extent)
                found.append(Drawn(solid.name, solid.shape, *shape, *solid.pose(time)))
        return found

    def depths(self) -> np.ndarray:
        """The depth of each particle in what is in its way, (n,) [length].

        It is negative where it touches nothing: how far it is from all of it. It is infinitely far
        in a scene without obstacles, ground and resting walls.
        """
        return depths(self.storage.solids, self.positions(), self.radii(), self.time)

    def can_touch(self) -> bool:
        """True if there is anything that particles can touch."""
        return touches(self.storage.scene, self.storage.solids)

    def penetration(self) -> float:
        """The deepest penetration of a free particle into what is in its way, or past a wall, or of
        a pair that collides into each other [length]; 0 where there is none."""
        storage = self.storage
        return deepest(storage.scene, storage.solids, self.positions(), self.time)

    def inside_at_start(self) -> Inside:
        """Which free particles begin inside an obstacle, out of which the first step puts them."""
        scene = self.storage.scene
        return inside_at_start(scene, self.storage.solids)

    def through_at_start(self) -> int:
        """The faces and edges that begin, or were put, so far inside a sharp obstacle that its
        pushes leave them through it: there it keeps out their particles alone."""
        return self.storage.through()

    def unsettled(self) -> int:
        """The steps that ended with resting pairs that overlap by more than a hundredth of their
        reach: iterations were given up. They are counted since the start, or since `reset`."""
        return int(self._unsettled[0]) + self.storage.unsettled()

    def uncertified(self) -> int:
        """The pairs of particles of cloths with a thickness that are so near now that triangles at
        them might intersect (`scene.spheres.too_near`). 0 proves that none do but neighbours.
        """
        scene = self.storage.scene
        if not scene.thick:
            return 0
        whole = scene.triangles[self.storage.triangles_alive()]
        return len(too_near(self.positions(), whole, scene.spheres))

    def unguarded(self) -> int:
        """The pairs of particles of cloths with a thickness that began so near, as layers of a
        lining do, that triangles at them can go through each other (`scene.spheres`)."""
        scene = self.storage.scene
        return len(scene.spheres.unguarded) if scene.thick else 0

    def unsettled_faces(self) -> int:
        """The steps that ended with a face or an edge in an obstacle, or past where it met it, by
        half its radius and that of the particles or more. They are counted since the start, or
        since `reset`."""
        return int(self._unsettled[1]) + self.storage.unsettled_faces()

    def at_rest(self) -> bool:
        """Tell if all particles stand still, as what lies on sharp obstacles does once it has all
        but come to a stop (`kernels/rest.py`; never with `World.rest` False)."""
        return self.storage.at_rest()

    def network(self) -> Network:
        """The particles where they are, and the springs that pull."""
        return self.storage.snapshot().network()

    def energy(self) -> diagnostics.Energy:
        """Kinetic, gravitational and elastic energy."""
        now = self.storage.snapshot()
        return diagnostics.energy(now.scene, now.x, now.v, now.pulling)

    def momentum(self) -> np.ndarray:
        """Total momentum of the free particles, (dim,)."""
        particles = self.storage.scene.particles
        return diagnostics.momentum(self.velocities(), particles.mass, particles.fixed)
