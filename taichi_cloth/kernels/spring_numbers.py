"""The numbers of a spring on the device: one table, from which they are stored, loaded and read.

`numbers`, in laws and wherever springs are summed, is a list in the order of this table; its length
and indices are known when a kernel is compiled: numbers[K] is the stiffness. A number is stored in
up to three fields, in each as it is best read there:

- state.csr_<letter>: for half-springs in compressed rows (`graph.py`), or one number for all where
  all springs of a scene share their numbers;
- state.link_<letter>: for the springs of grids (`grids.py`), one number for each kind of link and
  grid, or, where `per_link`, one for each link: such a number differs from link to link, or changes
  with time;
- state.spring_<letter>: for springs by colour (`solvers/colours.py`), if a method needs these.
"""

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class SpringNumber:
    """The declaration of a number that each spring has.

    letter: its name in kernels, as in state.link_<letter>.
    column: its name among a scene's springs (`scene.model.Springs`).
    needs: the name of the term without which it is not stored and reads as 0; "": it is always
        stored.
    per_link: whether each link of a grid has its own in every scene.
    changed_by: the name of the term that changes it after each step; in scenes with that each
        spring has its own. "": none does.
    void: whether it reads as 0 where a link is absent, which is where the stiffness is 0.
    """

    letter: str
    column: str
    needs: str = ""
    per_link: bool = False
    void: bool = False
    changed_by: str = ""

    def own(self, spec):
        """Mark links of a grid that have numbers of their own."""
        return self.per_link or self.changes(spec.terms)

    def changes(self, terms):
        """True if one of these terms changes it while a scene runs."""
        return bool(self.changed_by) and self.changed_by in terms

    def stored(self, spec):
        """True if the kernels of a specialization have this number."""
        return not self.needs or self.needs in spec.terms


NUMBERS = (
    SpringNumber("k", "stiffness", per_link=True),
    SpringNumber("rest", "rest_length"),
    SpringNumber("c", "damping", needs="dashpots", void=True),
)
K, REST, C = range(3)


def fields_of(spec, state, place):
    """The fields of `NUMBERS` at a place, "csr", "link" or "spring"; None for those not stored."""
    return [
        getattr(state, f"{place}_{number.letter}") if number.stored(spec) else None
        for number in NUMBERS
    ]


def stored_fields(spec, state, place):
    """The pairs (index in `NUMBERS`, field) of the numbers that are stored at a place."""
    found = enumerate(fields_of(spec, state, place))
    return [(column, field) for column, field in found if field is not None]


def own_columns(spec, state):
    """The pairs (index in `NUMBERS`, field) of the numbers that each link of a grid has itself."""
    return [
        (at, field) for at, field in stored_fields(spec, state, "link") if NUMBERS[at].own(spec)
    ]


def own_numbers(spec, state):
    """The fields of the numbers that each link of a grid has itself."""
    return [field for _, field in own_columns(spec, state)]


def shared_columns(spec, state):
    """The pairs (index in `NUMBERS`, field) of the numbers that links of a kind and grid share."""
    found = stored_fields(spec, state, "link")
    return [(at, field) for at, field in found if not NUMBERS[at].own(spec)]


def is_stored(field):
    """True if a field of `fields_of` is there."""
    return field is not None


# --- what solvers keep of each spring -----------------------------------------------------------


@dataclass(frozen=True)
class OfStiffness:
    """A contribution of springs (`springs.py`) that takes what a solver keeps of each spring.

    between(spec, state, value, i, j, kept): what i gets from the spring to j. kept: the axis of its
    stiffness matrix, and its stiffness across that (`springs.stiffness_of_springs`), which the
    solver has left in state.link_axis and link_across, csr_ likewise.
    """

    between: Callable


def takes_stiffness(between):
    """True if a contribution takes what is kept of each spring, in place of its numbers."""
    return isinstance(between, OfStiffness)
