"""The numbers of a spring on the device: one table, from which they are stored, loaded and read.

`numbers`, in laws and wherever springs are summed, is a list in this order, known when a kernel is
compiled: numbers[K]. A number of a spring is stored three times, as each topology reads it best:

- state.csr_<letter>: of half-springs in compressed rows (`graph.py`), or one for all where all
  springs of a scene share their numbers;
- state.link_<letter>: of the springs of grids (`grids.py`), one for each kind of link and grid, or,
  where `per_link`, one for each link: what differs from spring to spring or changes with time;
- state.spring_<letter>: of springs by colour (`solvers/colours.py`), for methods that want them so.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class SpringNumber:
    """A number of each spring.

    letter: as in kernels; column: of a scene's springs. needs: the term without which it is not
    stored, and reads as 0; "" where all springs have it. per_link: whether each link of a grid has
    its own. void: whether it reads as 0 where a link is absent, whose stiffness is 0.
    """

    letter: str
    column: str
    needs: str = ""
    per_link: bool = False
    void: bool = False

    def stored(self, spec):
        """Whether kernels of a specialization have it."""
        return not self.needs or self.needs in spec.terms


NUMBERS = (
    SpringNumber("k", "stiffness", per_link=True),
    SpringNumber("rest", "rest_length"),
    SpringNumber("c", "damping", needs="dashpots", void=True),
)
K, REST, C = range(3)


def fields_of(spec, state, place):
    """The fields of `NUMBERS` at a place ("csr", "link" or "spring"); None where not stored."""
    return [
        getattr(state, f"{place}_{number.letter}") if number.stored(spec) else None
        for number in NUMBERS
    ]


def stored_fields(spec, state, place):
    """The fields of the numbers that are stored, each with its column in `NUMBERS`."""
    found = enumerate(fields_of(spec, state, place))
    return [(column, field) for column, field in found if field is not None]


def own_columns(spec, state):
    """Of the numbers that each link of a grid has of its own: (column, field)."""
    return [(at, field) for at, field in stored_fields(spec, state, "link") if NUMBERS[at].per_link]


def own_numbers(spec, state):
    """The fields of `own_columns`."""
    return [field for _, field in own_columns(spec, state)]


def shared_columns(spec, state):
    """Of the numbers that links of one kind and grid share: (column, field)."""
    found = stored_fields(spec, state, "link")
    return [(at, field) for at, field in found if not NUMBERS[at].per_link]


def is_stored(field):
    """Whether there is such a field."""
    return field is not None
