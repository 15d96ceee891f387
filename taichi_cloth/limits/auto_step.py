"""The step of a run: `--dt auto`, which takes as many substeps a frame as its springs need while
they break and are spawned, and the warning where a step that was asked for is too long.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from taichi_cloth.errors import InputError
from taichi_cloth.kernels import methods
from taichi_cloth.kernels.methods.contract import Method
from taichi_cloth.limits import tractions
from taichi_cloth.limits.bounds import (
    AnyGeometry,
    Bounds,
    gershgorin,
    gershgorin_here,
    grows_within,
    step_within,
)
from taichi_cloth.limits.eigenmodes import Limit, stable_step
from taichi_cloth.limits.network import Network
from taichi_cloth.scene.model import Scene

SAFETY = 0.9  # of the limit: what `--dt auto` takes, and remedies propose
MOST = 1_000_000  # substeps a frame


def substeps_needed(dt: float, limit: float) -> int:
    """Substeps that a frame of `dt` takes with each at most `SAFETY` of the limit."""
    if math.isinf(limit):
        return 1
    # A quotient that is whole but for round-off is whole.
    return max(1, math.ceil(min(dt / SAFETY / limit * (1 - 1e-12), 1e18)))


class SubstepController:
    """Chooses the substeps of frames of length `dt` for a method, by a limit that holds in every
    geometry, since springs turn during a run.

    The same states in the same order give the same answers, so that a replay has the same bits.
    Raises InputError where no number of substeps will do.

    name, method: of the method, and its module.
    """

    def __init__(self, name: str, method: Method, dt: float):
        self._name, self._method, self._dt = name, method, dt
        self.reset()

    def reset(self) -> None:
        """Forget all states: the scene is at its start again."""
        self._geometry = AnyGeometry()
        self._substeps = 1
        self._moving: Bounds | None = None

    def memory(self) -> dict[str, Any]:
        """Its memory of the states before, numbers and arrays; `recall` takes it."""
        moving = None if self._moving is None else list(vars(self._moving).values())
        vectors = self._geometry.memory()
        return {"substeps": self._substeps, "moving": moving, "vectors": vectors}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Go on from such a memory: the same states give the same answers as then."""
        moving = memory["moving"]
        self._substeps = memory["substeps"]
        self._moving = None if moving is None else Bounds(*moving)
        self._geometry.recall(memory["vectors"])

    def expect_faster(self) -> None:
        """Let no last answer stand: what comes may have faster modes than rough bounds tell."""
        self._moving = None

    def choose(self, network: Network) -> int:
        """The substeps of a frame of this network."""
        rough = gershgorin(network)
        # Mostly one look says that they allow no single step, so what they allow is not asked.
        if grows_within(self._method, rough, 0.99 * self._dt / SAFETY):
            needed = 2
        else:
            limit = step_within(self._method, rough)
            needed = substeps_needed(self._dt, limit) if limit > 0 else 1
        if needed > 1:
            limit = step_within(self._method, self._geometry.bounds(network))
        if limit == 0 and not (math.isfinite(rough.omega2) and math.isfinite(rough.damping)):
            raise InputError(
                "--dt auto: these springs are too stiff, or damped too much, for their masses to "
                "compute a step; use softer springs or larger masses"
            )
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

    def choose_in_motion(self, network: Network) -> int:
        """The substeps of a frame where forces depend on speeds, which may double meanwhile.

        The last answer stands while Gershgorin's bounds are about what they were: they may grow by
        less than `SAFETY` leaves open.
        """
        doubled = network.moved(network.position, 2.0 * network.velocity)
        now, before = gershgorin(doubled), self._moving
        if before is not None:
            stiff = 0.9 * before.omega2 <= now.omega2 <= 1.05 * before.omega2
            damped = 0.7 * before.damping <= now.damping <= 1.05 * before.damping
            if stiff and damped:
                return self._substeps
        self._moving = now
        return self.choose(doubled)

    def choose_after_breaks(self, network: Network) -> int:
        """The substeps of a frame after some of the springs have gone, which are never more.

        Where those that went hardly took part in the fastest mode, no eigenvalue is needed.
        """
        if self._substeps == 1:
            return 1
        longer = self._dt / (self._substeps - 1) / SAFETY
        if grows_within(self._method, self._geometry.at_least(network), longer):
            return self._substeps
        return self.choose(network)


def above_limit(method: str, scene: Scene, dt: float, substeps: int) -> str | None:
    """One line where a step is too long for a scene's start: by how much, why, what to do.

    None where it is not, or where the air alone makes it so: see `above_limit_in_air`.

    method: its name; dt: time of a frame; substeps: steps a frame is cut into.
    """
    module, network = methods.load(method), Network.from_scene(scene)
    step = dt / substeps
    limit = limit_below(step, module, network)
    if limit is None or _only_by_air(step, module, scene):
        return None
    what = "step" if substeps == 1 else "substep"
    if limit.dt == 0:
        return (
            f"no {what} of {method} is stable here: {limit.describe()}, is the first to "
            f"grow; use --method {_stable_method()}"
        )
    return (
        f"a {what} of {step:.4g} is above {limit.dt:.4g}, the stable limit of {method} here, "
        f"set by {limit.describe()}; use {_or(_remedies(method, module, network, dt))}"
    )


def above_limit_in_air(method: str, scene: Scene, dt: float, substeps: int) -> str | None:
    """One line where a step is too long by the air's drag alone; None where it is not.

    That drag is of the strongest wind on the scene's start. It fades as a cloth goes with the
    wind, so that such a step may do: it is no reason to warn.
    """
    module, step = methods.load(method), dt / substeps
    if not _only_by_air(step, module, scene):
        return None
    network = Network.from_scene(scene)
    limit = limit_below(step, module, network)
    if limit is None:
        return None
    return (
        f"a {'step' if substeps == 1 else 'substep'} of {step:.4g} is above {limit.dt:.4g}, the "
        f"limit of {method} by the air's drag on the scene as it starts, in the strongest wind; "
        "cloth that goes with the wind has less drag. If it fails, use "
        f"{_or(_remedies(method, module, network, dt))}"
    )


def _only_by_air(step: float, method: Method, scene: Scene) -> bool:
    """True if a scene has forces on triangles, and a step is stable without them."""
    if len(scene.triangles) == 0 or not tractions.present(scene.world):
        return False
    calm = replace(scene, world=tractions.without(scene.world))
    return limit_below(step, method, Network.from_scene(calm)) is None


def _remedies(method: str, module: Method, network: Network, dt: float) -> list[str]:
    remedies = []
    with contextlib.suppress(InputError):  # where there are more than there may be
        needed = SubstepController(method, module, dt).choose(network)
        remedies = [f"--substeps {needed}", "--dt auto"]
    return remedies + [f"--method {name}" for name in [_stable_method()] if name != method]


def limit_below(step: float, method: Method, network: Network) -> Limit | None:
    """The stable limit of a network, where a step is above it; None where it is not.

    The cheapest bound that settles it is all that is computed.
    """
    for bounds in (gershgorin, gershgorin_here):
        if step <= step_within(method, bounds(network)):
            return None
    limit = stable_step(method, network)
    return None if step <= limit.dt else limit


def _stable_method() -> str:
    """An implicit method that is stable at every step, or what there is instead."""
    for name in methods.METHODS:
        claims = methods.load(name).claims
        if claims.implicit and math.isinf(claims.stability_limit):
            return name
    return "symplectic_euler"


def _or(words: Sequence[str]) -> str:
    return " or ".join(filter(None, [", ".join(words[:-1]), *words[-1:]]))
