"""The part of a storage that puts scenes on the device, into fields that have room for them."""

from __future__ import annotations

import weakref
from dataclasses import replace

import numpy as np

from taichi_cloth.kernels import forces
from taichi_cloth.kernels.fields import Capacity
from taichi_cloth.kernels.forces import blow
from taichi_cloth.kernels.specialization import Specialization
from taichi_cloth.runtime import refuse_other_threads
from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.solids import goes_through, held, met_by_faces, solids
from taichi_cloth.simulation.numbers import Numbers
from taichi_cloth.simulation.snapshot import Grips, Judged, Snapshot, same_but_own
from taichi_cloth.simulation.storage import containers, requirements
from taichi_cloth.simulation.storage.containers import Container
from taichi_cloth.simulation.storage.device_state import DeviceState, Loaded
from taichi_cloth.simulation.storage.placement import Placement


class Loading(DeviceState):
    """Puts a state on the device: `take` says which, `load` puts it there."""

    def take(self, snapshot: Snapshot) -> None:
        """Hold another state from the next load on, without a push."""
        if not _same_solids(self._taken.scene, snapshot.scene):
            self.solids = solids(snapshot.scene)
        fits = self._placements.packs == self._may_pack(snapshot.scene)
        if not fits or not _same_places(self._taken.scene, snapshot.scene):
            self._placements = self._placements_of(snapshot.scene)
        self._taken = snapshot
        self.pushed = False

    def move(self, now: np.ndarray, x: np.ndarray, v: np.ndarray) -> None:
        """From the next load on, have the particles at x with v; now: where they are, (n, dim)."""
        self._taken = replace(self._taken, x=now).moved(x, v)

    def judge(self, time: float) -> None:
        """Before a load, at a time: find what was put where it is since the last one is in there.

        That is which faces and edges go through an obstacle, and what takes fixed particles along.
        """
        self._taken = self.judged(self._taken, time)

    def judged(self, taken: Snapshot, time: float) -> Snapshot:
        """The state with all of its elements and grips known; self.solids are in its way."""
        return self._with_grips(self._with_faces(taken, time), time)

    def _with_grips(self, taken: Snapshot, time: float) -> Snapshot:
        """The state with what its fixed particles go with."""
        if not any(solid.grip is not None and solid.moving for solid in self.solids):
            return taken
        count, grips = len(taken.x), taken.grips
        if grips is None:
            grips = Grips(np.full(count, Grips.UNKNOWN), np.zeros(taken.x.shape))
        asked = grips.by == Grips.UNKNOWN
        if not asked.any() and taken.grips is not None:
            return taken
        by, at = held(taken.scene, self.solids, taken.x, time)
        by, at = np.where(asked, by, grips.by), np.where(asked[:, None], at, grips.at)
        return replace(taken, grips=Grips(by, at))

    def _with_faces(self, taken: Snapshot, time: float) -> Snapshot:
        """The state with all of its elements known."""
        if not met_by_faces(taken.scene, self.solids):
            return taken
        elements, judged = taken.scene.elements, taken.judged
        known, through = judged.of(elements)
        if known.all() and len(elements) == len(judged.elements):
            return taken
        new = goes_through(taken.scene, self.solids, taken.x, time, ~known)
        every = np.ones(len(elements), bool)
        return replace(taken, judged=Judged(elements, every, through | new))

    def topologies(self) -> list[str]:
        """The topologies that the scene can be stored in."""
        return self._placements.topologies()

    def is_simple(self) -> bool:
        """True if particles have nothing but springs, walls and terms of their own."""
        return self._placements.is_simple()

    def kind(self, topology: str, path: str) -> str:
        """Which kernels a first load would need (`compiled.kind`); nothing is made."""
        placement, topology = self._find_placement(topology)
        spec = self._needed(placement)
        capacity = self._capacity(placement, spec)
        return self._launcher.kind(self._launcher.specialize(spec, path, capacity.packs), capacity)

    def load(self, topology: str, path: str, numbers: Numbers) -> None:
        """Put the state that was taken on the device.

        topology: "lanes" or "graph"; the graph where there is no regular grid any more. path:
        "serial" or "parallel". InputError where a number does not fit the device's precision.
        """
        placement, topology = self._find_placement(topology)
        self._fill(self._make_room(placement, topology), placement, path, numbers)

    def fits(self, snapshot: Snapshot) -> bool:
        """True if a state could be loaded without compiling anything anew."""
        before = self._taken, self._placements, self.solids, self.pushed
        container = self._now.container
        try:
            self.take(snapshot)
            placement, topology = self._find_placement(self.topology)
            needed = requirements.capacity(snapshot.scene, self.solids, placement)
            spec = self._needed(placement)
            room = container.state.capacity.holds(needed)
            return bool(room and container.fits(spec, topology))
        finally:
            self._taken, self._placements, self.solids, self.pushed = before

    def _find_placement(self, topology: str) -> tuple[Placement, str]:
        """The placement of the scene in a topology, or else on the graph, and which it is in."""
        placement = self._placements.find(topology)
        if placement is None:  # what was spawned may have undone the last grid
            topology = "graph"
            placement = self._placements.find(topology)
            assert placement is not None  # it takes any springs
        return placement, topology

    def _fill(
        self, container: Container, placement: Placement, path: str, numbers: Numbers
    ) -> None:
        """Put the state that was taken into a container."""
        self.topology, self.path, self.loads = container.topology, path, self.loads + 1
        specialization = self._launcher.specialize(container.spec, path, container.state.packs)
        self._launcher.expect(specialization, container.state.capacity)
        self._loaded = Loaded(
            number=self.loads,
            of=weakref.ref(self),
            container=container,
            placement=placement,
            specialization=specialization,
            numbers=numbers,
            placements=self._placements,
            solids=self.solids,
        )
        upload = self._upload()
        upload.numbers(numbers)
        upload.all()
        self._end_load(container)

    def _end_load(self, container: Container) -> None:
        """Forget what was before a load: accounts, pushes, what is drawn and what methods keep."""
        self._drawn_springs = None
        if container.spec.accounts_contacts:
            container.state.accounting[None] = 0
        if "blow" in container.spec.terms and self._held and not self.pushed:
            self._launcher.launch(blow.clear_push, container.state)
            self._held = False
        self._altered = True

    def change_particles(
        self, now: Snapshot, edited: Snapshot, numbers: Numbers, time: float
    ) -> bool:
        """Go from `now`, what is on the device, to an edited state with the same bits as by a load,
        where nothing differs but the motion of particles and their numbers that are `snapshot.OWN`,
        and the same faces meet obstacles. time: of the clock.

        False, with nothing done, where more does. InputError as in `load`.
        """
        if edited.scene.springs is not self.scene.springs or not same_but_own(now, edited):
            return False
        edited = self.judged(edited, time)
        if not np.array_equal(edited.judged.through, now.judged.through):
            return False
        self._taken, self.pushed, self.loads = edited, False, self.loads + 1
        self._loaded = replace(self._now, number=self.loads, numbers=numbers)
        upload = self._upload()
        upload.numbers(numbers)
        upload.particles_again()
        self._end_load(self._now.container)
        return True

    def _make_room(
        self, placement: Placement, topology: str, like: Specialization | None = None
    ) -> Container:
        """A container that fits particles, springs and spec: the one there is, or an empty one.

        A new container compiles every kernel again, so it is made with room to spare.
        like: a specialization that it is to have, if that can run what is needed.
        """
        needed = requirements.capacity(self.scene, self.solids, placement)
        spec = self._needed(placement)
        if like is not None and like.can_run(spec):
            spec = like
        factor = 1
        if self._loaded is not None:
            old = self._loaded.container
            fits = old.fits(spec, topology) and (like is None or old.spec == spec)
            if fits and old.state.capacity.holds(needed):
                return old
            refuse_other_threads()  # while there is something to go back to
            factor = 2 if fits else 1
            self._loaded = None  # its memory goes with `old`, unless a checkpoint holds it
            del old
        refuse_other_threads()
        capacity = self._capacity(placement, spec, factor)
        return Container.make(spec, topology, capacity, self._method, self.device, self.real)

    def _capacity(self, placement: Placement, spec: Specialization, factor: int = 1) -> Capacity:
        """The room that fields are made with. factor: as in `containers.with_room_to_spare`."""
        scene = self.scene
        return containers.with_room_to_spare(
            requirements.capacity(scene, self.solids, placement),
            factor,
            takes_clicks=scene.world.takes_clicks,
            thick=spec.thick,
        )

    def _needed(self, placement: Placement) -> Specialization:
        """Requirements of the state that was taken, in a placement."""
        return requirements.specialization(
            self._taken,
            self.solids,
            placement,
            self._launcher.device,
            topologies=self.topologies,
            needs=self._needs,
            accounts_contacts=self.accounts_contacts,
        )


def _same_solids(one: Scene, other: Scene) -> bool:
    """True if the same is in the way in two scenes."""
    radius = [scene.particles.radius.max(initial=0.0) for scene in (one, other)]
    return one.obstacles is other.obstacles and one.world is other.world and radius[0] == radius[1]


def _same_places(one: Scene, other: Scene) -> bool:
    """True if the particles and springs of two scenes are placed alike, whatever else differs."""
    return (
        one.springs is other.springs
        and one.stencils is other.stencils
        and one.particles.position is other.particles.position
        and one.triangles is other.triangles
        and bool(one.features().obstacles) == bool(other.features().obstacles)
        and one.features().collisions == other.features().collisions
        and forces.present_in(one) == forces.present_in(other)
    )
