"""The declaration of a method: a frozen contract, checked when its file is loaded."""

from collections.abc import Callable
from dataclasses import dataclass

SETTINGS = ("tolerance", "iterations")  # those that a method may take
# What a method may need of the host beside the state: sums of the stiffness and damping of each
# particle's springs (state.summed_k, summed_c), room for the stiffness that a solver keeps
# of each spring (`spring_numbers.OfStiffness`), and the colours of springs or particles that
# `solvers/colours.py` goes through.
NEEDS = ("summed_springs", "kept_stiffness", "spring_colours", "particle_colours")


@dataclass(frozen=True)
class Claims:
    """The claims of a method; tests and reports read them and hold the method to them.

    order: global order of accuracy, at least 1.
    symplectic: whether it is, without drag and dashpots; implicit: whether it solves equations.
    stability_limit: largest stable dt*omega for an undamped oscillator; 0: none is stable, inf: all
        are.
    choose: when to take it, in words for users.
    forces: force evaluations a step; 0 where they depend on the solution and are counted on the
        device.
    settings: those out of `SETTINGS` that it takes.

    Raises ValueError where a setting is unknown, or a claim says nothing.
    """

    order: int
    symplectic: bool
    implicit: bool
    stability_limit: float
    choose: str
    forces: int = 1
    settings: tuple[str, ...] = ()

    def __post_init__(self):
        _check_known("settings", self.settings, SETTINGS)
        if not (self.order >= 1 and self.stability_limit >= 0 and self.choose):
            raise ValueError("claims: order, stability_limit and choose must say something")


@dataclass(frozen=True, kw_only=True)
class Method:
    """The declaration of a time-integration method.

    claims: what it promises.

    It has either a step or phases:
    step(spec, state, t): a ti.func that advances the state by state.dt[None], as thread t of those
        that share the work.
    phases: a tuple of such functions, where it is not known beforehand how often each is run
        (`kernels/phases.py`): a step is the first one and then all phases that `go_to` leads to.
    launches: which phases share a kernel on packs of several lanes, where one kernel of all of them
        would be too large; empty: all do. Those of the first, which begin and end stages, go over
        all packs but once.
    position_weight: the part of dt^2 a that a constant acceleration a adds to the position in a
        step that begins at rest: 0, 1/2 or 1. Contacts that end a step change positions by it
        (`settling.py`).
    force_times: when its forces are taken, as parts of the step: pairs (stage, part), where
        state.stage tells the stages apart; a single pair stands for all of them. What blows or
        moves by itself is asked for these times (`clock.py`).
    begin(spec, state, t): what comes before the first step, and after every change of the state
        from outside: there a method computes the forces that it keeps from step to step.

    It has either a stability function or an amplification:
    stability_function(z): for a Runge-Kutta method, the factor by which a step multiplies the y of
        y' = mu y, where z = dt mu.
    amplification(h, omega2, d): the matrix of its step of h for x'' = -omega2 x - d x'.

    vectors: names of the fields state.<name> in which it keeps a vector for each particle, within a
        step or from step to step; haloed: those of them that neighbours read; low_vectors: further
        ones in the precision `compensated`.
    numbers: names of fields in which it keeps a number for each particle, within a step.
    traction_vectors: further vectors that it keeps only where forces act on triangles.
    scalars, counts: names of 0-D fields of real and of whole numbers; raised: of such of real ones
        as many threads raise at once (`loops.raise_to`).
    sums: how many sums over all particles it takes (`loops.add_up`).
    needs: what it needs of the host, out of `NEEDS`.
    lanes: how many lanes its packs have at most, in planes and in space; None: any number.

    Raises ValueError where something is missing, there twice, or unknown.
    """

    claims: Claims
    position_weight: float
    force_times: tuple[tuple[int, float], ...]
    step: Callable | None = None
    phases: tuple[Callable, ...] = ()
    launches: tuple[tuple[int, ...], ...] = ()
    begin: Callable | None = None
    stability_function: Callable | None = None
    amplification: Callable | None = None
    vectors: tuple[str, ...] = ()
    haloed: tuple[str, ...] = ()
    low_vectors: tuple[str, ...] = ()
    numbers: tuple[str, ...] = ()
    traction_vectors: tuple[str, ...] = ()
    scalars: tuple[str, ...] = ()
    raised: tuple[str, ...] = ()
    counts: tuple[str, ...] = ()
    sums: int = 0
    needs: tuple[str, ...] = ()
    lanes: tuple[int, int] | None = None

    def __post_init__(self):
        if bool(self.step) == bool(self.phases):
            raise ValueError("give either step or phases")
        if bool(self.stability_function) == bool(self.amplification):
            raise ValueError("give either stability_function or amplification")
        if self.position_weight not in (0.0, 0.5, 1.0):
            raise ValueError(f"position_weight is {self.position_weight}; it must be 0, 0.5 or 1")
        if not self.force_times or not all(0 <= part <= 1 for _, part in self.force_times):
            raise ValueError("force_times must be pairs of a stage and a part of the step, 0 to 1")
        _check_known("needs", self.needs, NEEDS)
        _check_known("haloed", self.haloed, self.vectors)
        if self.launches:
            launched = sorted(phase for these in self.launches for phase in these)
            if launched != list(range(len(self.phases))):
                raise ValueError("launches must name each phase once")
        names = [*self.vectors, *self.low_vectors, *self.traction_vectors, *self.numbers]
        names += [*self.scalars, *self.raised, *self.counts]
        for name in names:
            if not name.isidentifier() or names.count(name) > 1:
                raise ValueError(f"{name!r} is no name of a field, or names two")

    def most_lanes(self, dim):
        """The most lanes of its packs, in so many dimensions; None: any number."""
        return self.lanes and self.lanes[dim - 2]


def _check_known(what, words, known):
    """Raise ValueError where one of the words is not a known one."""
    for word in words:
        if word not in known:
            raise ValueError(f"{what}: unknown {word!r}; known: {', '.join(known)}")


def backward_euler(z):
    """The stability function of backward Euler: a step multiplies y of y' = mu y by it, z = dt mu.

    Hairer, Wanner, Solving Ordinary Differential Equations II, IV.3.
    """
    return 1 / (1 - z)
