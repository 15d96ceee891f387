"""Accounts of a simulation's steps: work, contacts, and how solutions converged."""

from __future__ import annotations

from taichi_cloth.errors import InputError, RunFailure
from taichi_cloth.kernels.solvers.stages import HIDDEN, OUTCOMES
from taichi_cloth.limits.precision import STIFFEST, stiffness_in_loads
from taichi_cloth.simulation import diagnostics
from taichi_cloth.simulation.part import Part


class Accounts(Part):
    """The part of a `Simulation` that says what its steps have done."""

    def work(self) -> diagnostics.Work:
        """Its work since the start, or since `reset`."""
        forces, sweeps, unconverged = (int(count) for count in self._work)
        before, steps = self._counted  # evaluations, until the method was changed
        forces = before + ((self.steps - steps) * self.claims.forces or forces)
        return diagnostics.Work(self.steps - self._first, forces, sweeps, unconverged)

    def account_contacts(self) -> None:
        """Begin an account of what contacts do, which lasts until the next reset or change.

        It stays empty unless the simulation was made with `accounts_contacts`.
        """
        self.storage.account_contacts()

    def contact_account(self) -> diagnostics.ContactAccount | None:
        """The account of contacts since `account_contacts`; None: none is kept."""
        account = self.storage.contact_account()
        if account is None:
            return None
        gained, balance, step = account
        _, time, steps = self._since
        first = None if step is None else time + (step - steps) * self.dt / self.substeps
        return diagnostics.ContactAccount(gained, balance, first)

    def check_converged(self) -> None:
        """Raise RunFailure where most steps since the start missed the tolerance of their solution.

        Such a run does not show the scene; `advance` leaves that to be judged at its end.
        """
        if self.work().mostly_unconverged:
            raise RunFailure(self.describe_convergence())

    def describe_convergence(self) -> str:
        """The steps that missed their tolerance, how the last one did, and what to change.

        InputError where the method has no tolerance to meet.
        """
        last = self.solution()
        work, tolerance = self.work(), self.solver["tolerance"]
        ended = "" if last.converged else f" (the last one: {last.outcome})"
        remedy = "use softer springs, more --substeps or a larger --tolerance"
        if last.outcome == OUTCOMES[HIDDEN]:  # which no step and no tolerance changes
            loads = stiffness_in_loads(self.scene)
            better = bool(loads.max(initial=0.0) < STIFFEST["f64"])
            wider = better and self._launcher.device.precision != "f64"
            remedy = "use softer springs" + " or --precision f64" * wider
        return (
            f"{work.unconverged} of {work.steps} steps of {self.method} did not converge to a "
            f"relative residual of {tolerance:g}{ended}; remedy: {remedy}"
        )

    def solution(self) -> diagnostics.Solution:
        """The solution of the last step; InputError where the method has no tolerance to meet."""
        if "tolerance" not in self.claims.settings:
            raise InputError(f"{self.method} solves no equations to a tolerance")
        return self.storage.solution()
