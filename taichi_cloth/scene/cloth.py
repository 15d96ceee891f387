"""Rectangular cloths: a grid of particles and the links between neighbours.

One builder for the built-in scene and for ``[[cloths]]`` in scene files.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from taichi_cloth.errors import InputError, nearest
from taichi_cloth.scene.material import Material
from taichi_cloth.scene.model import (
    UPWARD,
    ParticleDefaults,
    Particles,
    SpringDefaults,
    Springs,
)
from taichi_cloth.scene.palette import CLOTH_COLOR, FABRIC_COLOR, FIXED_COLOR
from taichi_cloth.scene.properties import SPRING_PROPERTIES
from taichi_cloth.scene.stencils import Stencils
from taichi_cloth.scene.triangles import masses
from taichi_cloth.settings import accepted

# Kind of link: (column, row) offsets to the neighbours a particle is tied to. The order here is
# the order in which the links of one particle are numbered.
LINKS = {
    "structural": ((-1, 0), (0, -1)),
    "shear": ((-1, -1), (1, -1)),
    "bend": ((-2, 0), (0, -2)),
}
# More particles than this do not fit in the memory of the machines we know (about 200 bytes each).
LARGEST_GRID = 2**24


def grid(
    origin: Sequence[float],
    columns: int,
    rows: int,
    spacing: float,
    *,
    pinned: Iterable[Sequence[int]] = (),
    links: Sequence[str] = ("structural",),
    across: Sequence[float] | None = None,
    down: Sequence[float] | None = None,
    up: str = "",
    material: Material | None = None,
    particle_defaults: ParticleDefaults | None = None,
    spring_defaults: SpringDefaults | None = None,
    **per_kind: Mapping[str, Any] | float | str | None,
) -> tuple[Particles, Springs]:
    """Particles and springs of a `columns` x `rows` cloth, numbered row by row from 0.

    origin: position of the first particle, 2 or 3 numbers: the cloth's dimension.
    spacing: distance between neighbours in a row and in a column.
    pinned: (column, row) pairs of the particles that never move.
    links: kinds out of `LINKS`. Springs are numbered particle by particle: left, upper; then
        upper left, upper right (shear); then two left, two up (bend).
    across, down: directions of a row and of a column, any length (default: x, and downwards).
    up: "y" where y points up, as in `World`: rows then go down to smaller y; "": to larger ones.
    material: what the cloth is made of, in the place of masses, radii and stiffness; None: each
        particle and link has its own. It needs two rows and columns.
    per_kind: stiffness, rest_length and the others of `SpringProperties`, each as one value for all
        links or as values by kind; a kind that is absent takes `spring_defaults` (whose absent rest
        length is the distance at the start).

    Raises InputError for a grid, pin, direction or kind that makes no sense; `checks.validate`
    checks the numbers.
    """
    columns = accepted.whole_number("grid: columns", columns, None)
    rows = accepted.whole_number("grid: rows", rows, None)
    spacing = accepted.number("grid: spacing", spacing)
    _check_size(columns, rows, spacing)
    start = accepted.numbers("grid: origin", origin)
    if start.shape not in ((2,), (3,)):
        raise InputError(f"grid: origin must be 2 or 3 numbers, has shape {start.shape}")
    if up not in UPWARD:
        raise InputError(f"grid: up must be 'y', or '' where y points down, is {up!r}")
    if up and down is None:
        down = (0.0, -1.0, 0.0)[: len(start)]
    step_across, step_down = (spacing * of for of in _directions(across, down, len(start)))
    fixed = np.zeros((rows, columns), bool)
    fixed[_pinned_rows_and_columns(pinned, columns, rows)] = True
    links = accepted.listed("grid: links", links, "a list of kinds")
    of_kinds = _values_by_kind(links, per_kind)
    defaults: Any = SpringDefaults() if spring_defaults is None else spring_defaults
    if not isinstance(defaults, SpringDefaults):
        shown = accepted.shown(defaults)
        raise InputError(f"grid: spring_defaults must be of type SpringDefaults, is {shown}")

    of = Material.given("grid", material, links, of_kinds)
    if of != Material() and min(columns, rows) < 2:
        raise InputError("columns and rows: a cloth of a material needs at least two of both")
    row, column = np.divmod(np.arange(rows * columns), columns)
    position = start + column[:, None] * step_across + row[:, None] * step_down
    mass = None
    if of.density is not None:
        mass = masses(position, grid_triangles(columns, rows), of.density)
    particles = Particles.build(
        position,
        defaults=particle_defaults,
        mass=mass,
        radius=None if of.thickness is None else of.thickness / 2,
        thickness=of.thickness,
        fixed=fixed.ravel(),
        color=np.where(
            fixed.reshape(-1, 1), FIXED_COLOR, CLOTH_COLOR if len(start) == 2 else FABRIC_COLOR
        ),
    )

    springs = _links(columns, rows, links, step_across, step_down, of_kinds, defaults, of)
    return particles, springs


def _links(
    columns: int,
    rows: int,
    links: Sequence[str],
    step_across: np.ndarray,
    step_down: np.ndarray,
    of_kinds: Mapping[str, Mapping[str, Any]],
    defaults: SpringDefaults,
    material: Material,
) -> Springs:
    """The springs of a grid, in the order of their numbers.

    step_across, step_down: from a particle to the next in its row and its column, (dim,). of_kinds:
    values of springs by kind, by name; material: has some of them in their place.
    """
    # One slot per particle and possible link; those whose neighbour exists are the springs.
    slots = [(kind, offset) for kind in LINKS if kind in links for offset in LINKS[kind]]
    if not slots:
        return Springs.none()
    row, column = np.divmod(np.arange(rows * columns), columns)
    between, slot = _ties(row, column, columns, [offset for _, offset in slots])
    # The distance at the start depends on the slot alone, as all other numbers do.
    at_start = [float(np.linalg.norm(c * step_across + r * step_down)) for _, (c, r) in slots]
    spring_columns = {}
    for name, about in SPRING_PROPERTIES.items():
        default = getattr(defaults, name)
        values = about.filled([of_kinds[name].get(kind, default) for kind, _ in slots], at_start)
        spring_columns[name] = about.column(values, len(slots))[slot]
    if material.stretch is not None:
        for n, (kind, (columns_away, _)) in enumerate(slots):
            mine = slot == n
            at, last = (row, rows - 1) if columns_away else (column, columns - 1)
            beside = at[between[mine, 0]]  # the row of a link in a row, else the column
            width = np.where((beside == 0) | (beside == last), 0.5, 1.0)
            for name, numbers in material.of_links(kind, width, at_start[n]).items():
                spring_columns[name][mine] = numbers
    return Springs(between=between, **spring_columns)


def grid_triangles(columns: int, rows: int, first: int = 0) -> np.ndarray:
    """The triangles of a `columns` x `rows` cloth, two a cell, (m, 3) int64, for `Scene`.

    All cells are cut along the same diagonal, from the upper left to the lower right, so that every
    particle inside the cloth has the same share of its area. Normals point along across x down.
    first: the number of the cloth's first particle. Raises InputError as `grid` does.
    """
    columns = accepted.whole_number("grid_triangles: columns", columns, None)
    rows = accepted.whole_number("grid_triangles: rows", rows, None)
    first = accepted.whole_number("grid_triangles: first", first)
    _check_size(columns, rows, 1.0)
    at = first + np.arange(rows * columns, dtype=np.int64).reshape(rows, columns)
    left, right, below = at[:-1, :-1], at[:-1, 1:], at[1:, :-1]
    across = at[1:, 1:]
    cells = np.stack([left, right, across, left, across, below], axis=-1)
    return cells.reshape(-1, 3)


def grid_stencils(
    columns: int,
    rows: int,
    spacing: float,
    bending: float,
    *,
    across: Sequence[float] | None = None,
    down: Sequence[float] | None = None,
    first: int = 0,
) -> Stencils:
    """Bending of a `columns` x `rows` cloth, for `Scene`: second differences.

    Those along rows come first, then those along columns, each row by row. An inner row stands for
    a strip as wide as the rows are apart, an outer one for half of it, a single one for a whole
    spacing; columns likewise. So the cloth is as stiff however finely it is divided.

    spacing, across, down: as of `grid`. bending: rigidity B [force * length]. first: the number of
    the cloth's first particle. Raises InputError as `grid` does, and for a negative rigidity.
    """
    what = "grid_stencils"
    columns = accepted.whole_number(f"{what}: columns", columns, None)
    rows = accepted.whole_number(f"{what}: rows", rows, None)
    spacing = accepted.number(f"{what}: spacing", spacing)
    first = accepted.whole_number(f"{what}: first", first)
    _check_size(columns, rows, spacing)
    stiff = accepted.number("bending", bending, minimum=0)
    given = across if across is not None else down
    dim = 2 if given is None else accepted.numbers(f"{what}: across, down", given).size
    if dim not in (2, 3):
        raise InputError(f"{what}: across and down must be 2 or 3 numbers, are {dim}")
    along, beside = _directions(across, down, dim)
    cosine = along @ beside
    apart = math.sqrt(max(1.0 - float(cosine) ** 2, 0.0))  # of rows, in spacings
    at = first + np.arange(rows * columns, dtype=np.int64).reshape(rows, columns)
    found = Stencils.none()
    for lines in (at, at.T):
        width = np.full(len(lines), apart)
        width[[0, -1]] = apart / 2 if len(lines) > 1 else 1.0
        before, middle, after = lines[:, :-2], lines[:, 1:-1], lines[:, 2:]
        shape = middle.shape if lines.shape[1] > 2 else (len(lines), 0)
        unit = np.broadcast_to(np.sqrt(width)[:, None] / spacing, shape)
        triples = np.stack([of.reshape(shape) for of in (middle, before, after)], axis=2)
        weights = np.stack([-2 * unit, unit, unit], axis=2)
        if lines is not at:  # those of columns, too, in the order of the particles
            triples, weights = triples.transpose(1, 0, 2), weights.transpose(1, 0, 2)
        found = found.joined(Stencils.build(triples.reshape(-1, 3), weights.reshape(-1, 3), stiff))
    return found


def _ties(
    row: np.ndarray, column: np.ndarray, columns: int, offsets: Sequence[tuple[int, int]]
) -> tuple[np.ndarray, np.ndarray]:
    """Each particle tied to its neighbours at `offsets`: the pairs (s, 2), and of which offset."""
    neighbour_column = column[:, None] + np.array([across for across, _ in offsets])
    neighbour_row = row[:, None] + np.array([down for _, down in offsets])
    # All neighbours lie to the left, above, or both ways within a row above: no lower bound
    # besides 0 and no upper one besides the last column is ever crossed.
    present = (neighbour_column >= 0) & (neighbour_column < columns) & (neighbour_row >= 0)
    particle, slot = np.nonzero(present)
    between = np.stack([particle, (neighbour_row * columns + neighbour_column)[present]], axis=1)
    return between.astype(np.int64, copy=False), slot


def _check_size(columns: int, rows: int, spacing: float) -> None:
    if min(columns, rows) < 1:
        raise InputError(f"columns and rows must be at least 1, are {columns} and {rows}")
    if columns * rows > LARGEST_GRID:
        raise InputError(
            f"{columns} columns x {rows} rows are more than {LARGEST_GRID} particles; use fewer"
        )
    if not (np.isfinite(spacing) and spacing > 0):
        raise InputError(f"spacing must be positive and finite, is {spacing:g}")


def _values_by_kind(
    links: Sequence[str], per_kind: Mapping[str, Mapping[str, Any] | float | str | None]
) -> dict[str, Mapping[str, Any]]:
    """Every property's values by kind of link; refuses kinds that there are not."""
    for name in per_kind:
        if name not in SPRING_PROPERTIES:
            raise TypeError(f"grid() got an unexpected keyword argument '{name}'")
    of_kinds: dict[str, Mapping[str, Any]] = {}
    for name in SPRING_PROPERTIES:
        given = per_kind.get(name)
        if given is None:
            given = {}
        elif not isinstance(given, Mapping):
            given = {kind: given for kind in links if isinstance(kind, str)}
        of_kinds[name] = _of_kinds(name, given)
    for name, kinds in (("links", links), *of_kinds.items()):
        for kind in kinds:
            if not isinstance(kind, str) or kind not in LINKS:
                kind = str(kind)
                raise InputError(f"{name}: unknown kind {kind!r}; {nearest(kind, LINKS)}")
            if name != "links" and kind not in links:
                raise InputError(f"{name}: this cloth has no {kind} links; add '{kind}' to links")
    return of_kinds


def _of_kinds(name: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """A property's values by kind of link, numbers as floats; None stands for what is absent."""
    if SPRING_PROPERTIES[name].words:
        for kind, value in given.items():
            if not (value is None or isinstance(value, str)):
                shown = accepted.shown(value)
                raise InputError(f"grid: {name} of {kind} links must be a word, is {shown}")
        return dict(given)
    numbers = {kind: accepted.as_float(value) for kind, value in given.items()}
    for kind, value in given.items():
        if value is not None and numbers[kind] is None:
            shown = accepted.shown(value)
            raise InputError(f"grid: {name} of {kind} links must be a number, is {shown}")
    return numbers


def _directions(
    across: Sequence[float] | None, down: Sequence[float] | None, dim: int
) -> tuple[np.ndarray, np.ndarray]:
    """The directions of a row and of a column at length 1, (dim,) each, which are not parallel."""
    along, beside = _direction("across", across, 0, dim), _direction("down", down, 1, dim)
    if np.linalg.matrix_rank(np.stack([along, beside]), tol=1e-9) < 2:
        raise InputError("across and down must not be parallel")
    return along, beside


def _direction(name: str, vector: Sequence[float] | None, axis: int, dim: int) -> np.ndarray:
    """`vector` at length 1, or the unit vector of `axis` if it is None; shape (dim,)."""
    if vector is None:
        unit: np.ndarray = np.eye(dim)[axis]
        return unit
    along = accepted.numbers(f"grid: {name}", vector)
    if along.shape != (dim,):
        raise InputError(f"{name} must have {dim} numbers like origin, has {along.size}")
    length = np.linalg.norm(along)
    if not (np.isfinite(length) and length > 0):
        raise InputError(f"{name} must be a finite direction other than zero")
    unit = along / length
    return unit


def _pinned_rows_and_columns(
    pinned: Iterable[Sequence[int]], columns: int, rows: int
) -> tuple[np.ndarray, np.ndarray]:
    listed = accepted.listed("grid: pinned", pinned, "a list of pairs (column, row)")
    pairs = accepted.pairs("grid: pinned", listed)
    column, row = pairs.T
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    if not inside.all():
        c, r = pairs[np.argmin(inside)]
        raise InputError(
            f"pinned [{c}, {r}] is outside the grid; columns are 0 to {columns - 1}, "
            f"rows 0 to {rows - 1}"
        )
    return row, column
