"""`--dt auto`: as many substeps a frame as its springs need, while they break and are spawned."""

from __future__ import annotations

import math

from taichi_cloth import limits
from taichi_cloth.errors import InputError

MOST = 1_000_000  # substeps a frame


def substeps_needed(dt: float, limit: float) -> int:
    """Substeps that a frame of `dt` takes with each at most `limits.SAFETY` of the limit."""
    if math.isinf(limit):
        return 1
    # A quotient that is whole but for round-off is whole.
    return max(1, math.ceil(dt / (limits.SAFETY * limit) * (1 - 1e-12)))


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
        self._geometry = limits.AnyGeometry()
        self._substeps = 1

    def choose(self, network: limits.Network) -> int:
        """The substeps of a frame of this network."""
        rough = limits.step_within(self._method, limits.gershgorin(network))
        limit = rough
        if rough > 0 and substeps_needed(self._dt, rough) > 1:
            limit = limits.step_within(self._method, self._geometry.bounds(network))
        if limit == 0:
            raise InputError(
                f"--dt auto: {self._name} is unstable on these springs at every step; "
                "use --method symplectic_euler"
            )
        needed = substeps_needed(self._dt, limit)
        if needed > MOST:
            raise InputError(
                f"--dt auto: a stable step of {self._name} is {limit:.3g} here, and a frame of "
                f"{self._dt:g} would take {needed} of them; the most is {MOST}. "
                "Use a smaller --dt, or softer springs"
            )
        self._substeps = needed
        return needed

    def follow(self, network: limits.Network) -> int:
        """The same after some of the springs have gone, which can only make it fewer.

        Where those that went hardly took part in the fastest mode, no eigenvalue is needed.
        """
        if self._substeps == 1:
            return 1
        least = limits.step_within(self._method, self._geometry.at_least(network))
        if least > 0 and substeps_needed(self._dt, least) == self._substeps:
            return self._substeps
        return self.choose(network)
