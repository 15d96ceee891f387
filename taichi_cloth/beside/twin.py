"""The second of two runs: it goes along with the first, and has done to it what that one has."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from taichi_cloth.beside.given import OF_RUN, Given, steps_in, value_of
from taichi_cloth.beside.watch import Watch
from taichi_cloth.errors import InputError, SimulationFailure, nearest
from taichi_cloth.simulation import live
from taichi_cloth.simulation.acts import Listener
from taichi_cloth.simulation.numbers import checked_step

if TYPE_CHECKING:
    from collections.abc import Iterator

    from taichi_cloth.simulation.checkpoint import Checkpoint
    from taichi_cloth.simulation.simulation import Simulation

# Acts that both take or neither, whatever their settings; some come with every frame.
ALIKE = frozenset(("_push", "hold", "drag", "let_go", "restore"))
SELECTIONS = ("particles", "springs", "kind")  # what `Simulation.set` takes beside changes


@dataclass(frozen=True)
class Own:
    """A setting of the scene that the second run has for itself.

    name: of `simulation.live`. value: which. changes: what `Simulation.set` was given for it. now:
    whether these depend on what else is set now, as one part of a vector does. times: whether it
    is a factor of what each spring or particle has in the scene.
    """

    name: str
    value: live.Value
    changes: Mapping[str, Any]
    now: bool
    times: bool

    @property
    def names(self) -> set[str]:
        """Its changes, by the names of `Simulation.set`."""
        return set(self.changes) - set(SELECTIONS)


class Twin(Listener):
    """A second simulation of a scene that goes along with a first one, in other settings.

    Whatever is done to the first is done to it, just before, so that what one of them refuses
    neither has done; and it makes a frame where that one made one. What the two are given to differ
    in stays as it is. What one holds with the mouse is held in both by
    the same springs, and weighs in each what its own steps need. It fails for itself: then it
    stands still at its last good frame until a reset, and the first goes on.

    first: to which it listens until `close`. sim: the second, at its start. given: in what they
    differ. resumed: whether the first one was, so that the second begins from where that stands.
    restore: nothing is done with, as each run has checkpoints of its own.

    own: settings of the scene that it has for itself. watch: their distance, and what differs
    first. spent: seconds that its last frame took; took: with the watch. later: (spent, took) of
    all frames but the first, which compiles.
    """

    def __init__(
        self, first: Simulation, sim: Simulation, given: Given, resumed: bool = False
    ) -> None:
        self.first, self.sim, self.given = first, sim, given
        self.own = [_taken(sim, name, text) for name, text in given.scene.items()]
        if self.own:  # from the start, so that a reset goes there
            dt, substeps = (None, None) if sim.follows else (sim.dt, sim.substeps)
            with _told_as_beside():
                sim.load_scene(sim.storage.scene, dt, substeps)
        if resumed:
            self._join()
        self._failure: SimulationFailure | None = None
        self._undo: Checkpoint | None = None  # of this one, before an act that is not done yet
        self.spent = self.took = 0.0
        self.later = 0.0, 0.0
        self._compiled = False
        self.watch = Watch(first, sim)
        first.listeners += (self,)

    def _join(self) -> None:
        """Go to where the first one is; what is its own stays so."""
        with _told_as_beside():
            self.sim.go_on_from(self.first)
            self._keep_own({name for own in self.own for name in own.names})
            self.sim.weigh_hold()

    def close(self) -> None:
        """Listen no more."""
        others = (listener for listener in self.first.listeners if listener is not self)
        self.first.listeners = tuple(others)

    def check_differs(self) -> None:
        """InputError where it has the first one's settings in all that was given."""
        a, b = self.first, self.sim
        values: dict[str, list[Any]] = {
            "dt": [(sim.follows, sim.substeps) for sim in (a, b)],
            "substeps": [(sim.follows, sim.substeps) for sim in (a, b)],
            **{
                name: [sim.solver.get(name) for sim in (a, b)]
                for name in ("tolerance", "iterations")
            },
        }
        for name in self.given.run:
            left, right = values.get(name) or [getattr(sim, name) for sim in (a, b)]
            if left != right:
                return
        for own in self.own:
            if live.setting(a, own.name).read(a) != own.value:
                return
        raise InputError(
            f"--beside {self.given}: the first run has that, too; give another setting"
        )

    @property
    def failure(self) -> SimulationFailure | None:
        """Why it stands still; None: it does not."""
        return self._failure if self.sim.frame < self.first.frame else None

    # --- what the first one tells ----------------------------------------------------------

    def before_act(self, name: str, args: tuple[Any, ...], given: Mapping[str, Any]) -> None:
        """Do the same to this one first; InputError where it refuses, and then neither did it.

        A run that stands still refuses nothing: it has all of it anew after the next reset.
        """
        if name == "load_scene":
            raise InputError("a run that has another one beside it keeps its scene")
        self._undo = None if name in ALIKE else self.sim.checkpoint()
        try:
            with _told_as_beside():
                self._follow(name, args, given)
        except BaseException as error:
            self._go_back()
            if not (isinstance(error, InputError) and self.failure):
                raise

    def act_refused(self, name: str, args: tuple[Any, ...], given: Mapping[str, Any]) -> None:
        """Pass over what the first one did not do either."""
        self._go_back()

    def after_act(self, name: str, args: tuple[Any, ...], given: Mapping[str, Any]) -> None:
        """Both did it."""
        self._undo = None
        if name == "reset":
            self._failure = None
            self.watch.restart()

    def _go_back(self) -> None:
        """Be as before the act that was begun."""
        undo, self._undo = self._undo, None
        if undo is not None:
            self.sim.restore(undo)

    def _follow(self, name: str, args: tuple[Any, ...], given: Mapping[str, Any]) -> None:
        if name == "restore":  # whoever goes back takes both along
            return
        if name == "_hold":  # each has to weigh what its own steps need
            hold = args[0]
            self.sim.grab(hold.particles, hold.place, hold.stiffness, hold.damping)
        elif name == "set_step":
            self._set_step(*args, **given)
        elif name == "set_method":
            if "method" not in self.given.run:
                self.sim.set_method(*args, **given)
        elif name == "set_solver":
            self._set_solver(*args, **given)
        else:
            getattr(self.sim, name)(*args, **given)
            changed = {"collisions"} if name in ("prepare_balls", "reset") else set(given)
            if name in ("set", "prepare_balls", "reset"):  # balls switch it on for good
                self._keep_own(changed - set(SELECTIONS))

    def _set_step(self, dt: float | None = None, substeps: int | None = None) -> None:
        frame = self.first.dt if dt is None else checked_step(dt, 1)[0]
        if self.sim.follows:
            if frame != self.first.dt and not self.first.follows:
                raise InputError("it has dt auto, so the frame time cannot be set")
            return
        longest = self.given.run.get("dt")
        if longest is not None:
            substeps = steps_in(frame, longest)
        elif "substeps" in self.given.run:
            substeps = None
        self.sim.set_step(dt, substeps)

    def _set_solver(self, tolerance: float | None = None, iterations: int | None = None) -> None:
        given: dict[str, Any] = {"tolerance": tolerance, "iterations": iterations}
        mine = set(self.sim.claims.settings) - set(self.given.run)
        self.sim.set_solver(**{name: given[name] for name in mine})

    def _keep_own(self, changed: set[str]) -> None:
        """Give it its own settings again, of which the first one's were changed."""
        for own in self.own:
            if own.now and own.names & changed:
                live.apply(self.sim, own.name, own.value)
            elif own.names & changed:
                self.sim.set(**own.changes)

    def after_frame(self) -> None:
        """Make a frame, too, and look how far the two are apart."""
        begin = time.perf_counter()
        if self.sim.frame == self.first.frame - 1:
            try:
                self.sim.advance(1)
            except SimulationFailure as failure:
                self._failure = failure
        self.spent = time.perf_counter() - begin
        if self.sim.frame == self.first.frame:
            self.watch.note()
        self.took = time.perf_counter() - begin
        if self._compiled:
            self.later = self.later[0] + self.spent, self.later[1] + self.took
        self._compiled = True


def _taken(sim: Simulation, name: str, text: str) -> Own:
    """Give a simulation at its start a setting of its own; InputError where that cannot be."""
    known = {one.name: one for one in live.settings_of(sim)}
    if name not in known:
        hint = nearest(name, [*OF_RUN, *known])
        raise InputError(f"--beside {name}: '{sim.scene.name}' has no such setting; {hint}")
    setting = known[name]
    try:
        if setting.changes is None:
            raise InputError(setting.fixed or "cannot be set")
        value = value_of(setting, text)
        changes = dict(setting.changes(sim, value))
        sim.set(**changes)
    except InputError as error:
        raise InputError(f"--beside {name}={text}: {error}") from None
    times = setting.unit == live.TIMES
    return Own(name, value, changes, now=setting.group == "world", times=times)


@contextmanager
def _told_as_beside() -> Iterator[None]:
    """Have what the second run refuses say that it was that one."""
    try:
        yield
    except InputError as error:
        raise InputError(f"the run beside: {error}") from None
