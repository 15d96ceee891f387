"""What a method promises; tests and reports read it and hold the method to it."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Claims:
    """order: global order of accuracy; symplectic, implicit: as the words say;
    stability_limit: largest stable dt*omega for an undamped oscillator (0: none is stable, inf: all
    are). forces: force evaluations a step, 0 where they depend on the solution and are counted on
    the device. settings: those of `options.SOLVER_SETTINGS` that the method takes. choose: when to
    take it, in words for users.
    """

    order: int
    symplectic: bool
    implicit: bool
    stability_limit: float
    forces: int = 1
    settings: tuple[str, ...] = ()
    choose: str = ""


def backward_euler(z):
    """What a step of backward Euler makes of y' = mu y, where z = dt mu: its stability function."""
    return 1 / (1 - z)
