"""The step of a run: `--dt auto`, which takes as many substeps a frame as its springs need while
they break and are spawned, and the warning where a step that was asked for is too long.
"""

from __future__ import annotations

import contextlib
import math

from taichi_cloth.errors import InputError
from taichi_cloth.kernels import methods
from taichi_cloth.limits import modes

MOST = 1_000_000  # substeps a frame


def substeps_needed(dt: float, limit: float) -> int:
    """Substeps that a frame of `dt` takes with each at most `limits.SAFETY` of the limit."""
    if math.isinf(limit):
        return 1
    # A quotient that is whole but for round-off is whole.
    return max(1, math.ceil(min(dt / modes.SAFETY / limit * (1 - 1e-12), 1e18)))


class Follower:
    """Chooses the substeps of frames of length `dt` for a method, by a limit that holds in every
    geometry, since springs turn during a run.

    The same states in the same order give the same answers, so that a replay has the same bits.
    InputError where no number of substeps will do.
    """

    def __init__(self, name: str, method, dt: float):
        self._name, self._method, self._dt = name, method, dt
        self.forget()

    def forget(self) -> None:
        """As new: the scene is at its start again."""
        self._geometry = modes.AnyGeometry()
        self._substeps = 1

    def choose(self, network: modes.Network) -> int:
        """The substeps of a frame of this network."""
        rough = modes.step_within(self._method, modes.gershgorin(network))
        limit = rough
        if rough > 0 and substeps_needed(self._dt, rough) > 1:
            limit = modes.step_within(self._method, self._geometry.bounds(network))
        if limit == 0:
            raise InputError(
                f"--dt auto: {self._name} is unstable on these springs at every step; "
                "use --method symplectic_euler"
            )
        needed = substeps_needed(self._dt, limit)
        if needed > MOST:
            raise InputError(
                f"--dt auto: a stable step of {self._name} is {limit:.3g} here, and a frame of "
                f"{self._dt:g} would take {needed:.3g} of them; the most is {MOST}. "
                "Use a smaller --dt, or softer springs"
            )
        self._substeps = needed
        return needed

    def follow(self, network: modes.Network) -> int:
        """The same after some of the springs have gone, which can only make it fewer.

        Where those that went hardly took part in the fastest mode, no eigenvalue is needed.
        """
        if self._substeps == 1:
            return 1
        longer = self._dt / (self._substeps - 1) / modes.SAFETY
        if modes.grows_within(self._method, self._geometry.at_least(network), longer):
            return self._substeps
        return self.choose(network)


def above_limit(sim) -> str | None:
    """One line where the step of a simulation is too long for its scene's start: by how much, why,
    what to do; else None.

    The cheapest bound that settles it is all that is computed; the device is asked for nothing.
    """
    method, network = methods.load(sim.method), modes.Network.of_scene(sim.scene)
    step = sim.dt / sim.substeps
    for bounds in (modes.gershgorin, modes.gershgorin_here):
        if step <= modes.step_within(method, bounds(network)):
            return None
    limit = modes.stable_step(method, network)
    if step <= limit.dt:
        return None
    what = "step" if sim.substeps == 1 else "substep"
    if limit.dt == 0:
        return (
            f"no {what} of {sim.method} is stable here: {limit.describe()}, is the first to "
            f"grow; use --method {_stable_method()}"
        )
    remedies = []
    with contextlib.suppress(InputError):  # where there are more than there may be
        needed = Follower(sim.method, method, sim.dt).choose(network)
        remedies = [f"--substeps {needed}", "--dt auto"]
    remedies += [f"--method {name}" for name in [_stable_method()] if name != sim.method]
    return (
        f"a {what} of {step:.4g} is above {limit.dt:.4g}, the stable limit of {sim.method} here, "
        f"set by {limit.describe()}; use {_or(remedies)}"
    )


def _stable_method() -> str:
    """An implicit method that is stable at every step, or what there is instead."""
    for name in methods.METHODS:
        claims = methods.load(name).claims
        if claims.implicit and math.isinf(claims.stability_limit):
            return name
    return "symplectic_euler"


def _or(words) -> str:
    return " or ".join(filter(None, [", ".join(words[:-1]), *words[-1:]]))
