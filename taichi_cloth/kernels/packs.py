"""Cells of lanes: how the particles of a regular grid lie in memory, and arithmetic on cells.

A grid of `columns` is cut into L vertical strips, each W = ceil(columns / L) wide. A cell holds
the particles at one place of all strips, one per lane, so a neighbour in the grid is the same lane
of a neighbouring cell, and straight-line code on cells becomes vector instructions:

      columns of the grid, L = 4, W = 3             cells of a row, each |lane 0 1 2 3|

       strip 0   strip 1   strip 2   strip 3        halo          W cells           halo
      +---------+---------+---------+-------+     +-------+-------+-------+-------+-------+
      | 0  1  2 | 3  4  5 | 6  7  8 | 9  .  |     |-2 5 8 |0 3 6 9|1 4 7 .|2 5 8 .|3 6 9 -|
      +---------+---------+---------+-------+     +-------+-------+-------+-------+-------+
                                                    first-1 first                 first+W

Column c of a row is lane c // W of the cell first + c % W. What is right of a strip's last column
is the next strip's first one: the halo cells beside a row hold the row's other end, one lane on,
and are renewed when a row has moved. Places marked . have no particle (inverse mass and stiffness
0), those marked - no neighbour. A cell's values are stored component by component, a matrix of
dim x L: |x x x x|y y y y|. Rows follow each other at a pitch of W plus both halos; empty rows above
and below let every link's neighbour be read.

With L = 1, on GPUs and for particles on a graph, a cell is one particle, its value a vector of
`dim`, and there are no halos. The functions below do the same on both, so physics is written once.
A *site* is a place for one particle: its cell times L, plus its lane.

Kernels that run on cells of lanes are compiled with vectors kept whole (`runtime.whole_vectors`),
which Taichi 1.7 does only in part. In them
- fields are read and written number by number, as `read` and `write` do: fields of vectors crash;
- vectors take + - * /, min, max, sqrt, comparisons and select; not unary minus (-1.0 * a), -=
  (a = a - b), abs, nor casts;
- conditions are used at once, in a select: vectors of them cannot be taken apart (`largest`,
  `where_positive`).
"""

import taichi as ti


def lanes_of(a):
    """How many vectors the value `a` holds; settled when a kernel is compiled."""
    shape = a.get_shape()
    return 1 if len(shape) == 1 else shape[1]


def rows_of(plan, of):
    """How many numbers a field of cells holds for each particle."""
    return of.shape[1] // plan.lanes


@ti.func
def read(plan: ti.template(), of: ti.template(), c):
    """What a field holds for cell c: vectors, or a number for each lane; 0-D fields hold the same
    number for all.
    """
    if ti.static(of.shape == ()):
        return everywhere(plan, of[None])
    elif ti.static(plan.lanes == 1):
        return of[c]
    elif ti.static(rows_of(plan, of) == 1):
        return ti.Vector([of[c, lane] for lane in range(plan.lanes)])
    else:
        return ti.Matrix(
            [
                [of[c, axis * plan.lanes + lane] for lane in range(plan.lanes)]
                for axis in range(rows_of(plan, of))
            ]
        )


@ti.func
def everywhere(plan: ti.template(), number):
    """One number for all lanes."""
    if ti.static(plan.lanes == 1):
        return number
    else:
        return ti.Vector([number for _ in range(plan.lanes)])


@ti.func
def zeros(plan: ti.template(), state: ti.template()):
    """Zero vectors, for a cell."""
    if ti.static(plan.lanes == 1):
        return ti.Vector.zero(state.real, plan.dim)
    else:
        return ti.Matrix.zero(state.real, plan.dim, plan.lanes)


@ti.func
def write(plan: ti.template(), of: ti.template(), c, value):
    """Store what a field holds for cell c."""
    if ti.static(plan.lanes == 1):
        of[c] = value
    else:
        for axis in ti.static(range(rows_of(plan, of))):
            for lane in ti.static(range(plan.lanes)):
                if ti.static(rows_of(plan, of) == 1):
                    of[c, lane] = value[lane]
                else:
                    of[c, axis * plan.lanes + lane] = value[axis, lane]


@ti.func
def dot(a, b):
    """Scalar product, for each lane."""
    if ti.static(lanes_of(a) == 1):
        return a.dot(b)
    else:
        products = a * b
        total = component(products, 0)
        for axis in ti.static(range(1, a.n)):
            total += component(products, axis)
        return total


@ti.func
def for_each_axis(s, a: ti.template()):
    """A number for each lane, repeated for every component of the vectors a."""
    return ti.Matrix([[s[lane] for lane in range(lanes_of(a))] for _ in range(a.n)])


@ti.func
def scaled(s, d):
    """The vectors d times a number for each lane."""
    if ti.static(lanes_of(d) == 1):
        return s * d
    else:
        return for_each_axis(s, d) * d


@ti.func
def where_positive(s, a, b):
    """The vectors a in lanes where the number s is positive, else b."""
    if ti.static(lanes_of(a) == 1):
        return ti.select(s > 0.0, a, b)
    else:
        return ti.select(for_each_axis(s, a) > 0.0, a, b)


@ti.func
def largest(plan: ti.template(), a):
    """Largest number in any lane."""
    if ti.static(plan.lanes == 1):
        return a
    else:
        return folded(ti.max, a)


@ti.func
def over_lanes(plan: ti.template(), a):
    """Sum of the numbers in all lanes."""
    if ti.static(plan.lanes == 1):
        return a
    else:
        return folded(plus, a)


@ti.func
def plus(a, b):
    return a + b


@ti.func
def folded(op: ti.template(), a):
    """The numbers in all lanes joined by `op`, half of them with the other half."""
    if ti.static(a.n == 1):
        return a[0]
    else:
        half = ti.static(a.n // 2)
        return folded(
            op,
            op(
                ti.Vector([a[i] for i in range(half)]),
                ti.Vector([a[half + i] for i in range(half)]),
            ),
        )


@ti.func
def component(a, axis: ti.template()):
    """One component of the vectors a, for each lane."""
    if ti.static(lanes_of(a) == 1):
        return a[axis]
    else:
        return ti.Vector([a[axis, lane] for lane in range(lanes_of(a))])


@ti.func
def with_component(a, axis: ti.template(), value):
    """The vectors a with one component replaced."""
    if ti.static(lanes_of(a) == 1):
        b = a
        b[axis] = value
        return b
    else:
        b = a
        for lane in ti.static(range(lanes_of(a))):
            b[axis, lane] = value[lane]
        return b


@ti.func
def site_value(plan: ti.template(), of: ti.template(), site):
    """The vector of one particle, by its site: for code that runs particle by particle."""
    if ti.static(plan.lanes == 1):
        return of[site]
    else:
        cell, lane = site // plan.lanes, site % plan.lanes
        return ti.Vector([of[cell, axis * plan.lanes + lane] for axis in range(plan.dim)])


@ti.func
def site_number(plan: ti.template(), of: ti.template(), site):
    """The number of one particle, by its site."""
    if ti.static(of.shape == ()):
        return of[None]
    elif ti.static(plan.lanes == 1):
        return of[site]
    else:
        return of[site // plan.lanes, site % plan.lanes]


@ti.func
def set_site_value(plan: ti.template(), of: ti.template(), site, value):
    """Store the vector of one particle."""
    for axis in ti.static(range(plan.dim)):
        if ti.static(plan.lanes == 1):
            of[site][axis] = value[axis]
        else:
            of[site // plan.lanes, axis * plan.lanes + site % plan.lanes] = value[axis]


@ti.func
def set_site_number(plan: ti.template(), of: ti.template(), site, value):
    """Store the number of one particle; in 0-D fields, that of all."""
    if ti.static(of.shape == ()):
        of[None] = value
    elif ti.static(plan.lanes == 1):
        of[site] = value
    else:
        of[site // plan.lanes, site % plan.lanes] = value


@ti.func
def pitch_of(plan: ti.template(), state: ti.template(), g):
    """Cells from a row of grid g to the next."""
    return state.grid[g, 2] + 2 * plan.halo


@ti.func
def link_offset(state: ti.template(), s, pitch):
    """Cells from a cell to the other end of its links of kind s."""
    return state.link[s, 0] + state.link[s, 1] * pitch


@ti.func
def of_kind(state: ti.template(), s, c):
    """Where the fields of links keep those of kind s that begin at cell c."""
    return s * state.cells + c


@ti.func
def renew_left_halo(plan: ti.template(), of: ti.template(), first, width, reach):
    """Left of a row that begins at cell `first`: the columns before each strip's first one."""
    for h in range(1, reach + 1):
        a = read(plan, of, first + width - h)
        rows = [[0.0] + [a[i, lane] for lane in range(plan.lanes - 1)] for i in range(plan.dim)]
        write(plan, of, first - h, ti.Matrix(rows))


@ti.func
def renew_right_halo(plan: ti.template(), of: ti.template(), first, width, reach):
    """Right of it: the columns after each strip's last one."""
    for h in range(reach):
        a = read(plan, of, first + h)
        rows = [[a[i, lane] for lane in range(1, plan.lanes)] + [0.0] for i in range(plan.dim)]
        write(plan, of, first + width + h, ti.Matrix(rows))


@ti.func
def return_left_halo(plan: ti.template(), of: ti.template(), first, width, reach):
    """The other way: what was changed in the left halo goes to where its particles are."""
    for h in range(1, reach + 1):
        a, b = read(plan, of, first - h), read(plan, of, first + width - h)
        last = ti.static(plan.lanes - 1)
        rows = [[a[i, lane + 1] for lane in range(last)] + [b[i, last]] for i in range(plan.dim)]
        write(plan, of, first + width - h, ti.Matrix(rows))


@ti.func
def return_right_halo(plan: ti.template(), of: ti.template(), first, width, reach):
    """The same of the right halo."""
    for h in range(reach):
        a, b = read(plan, of, first + width + h), read(plan, of, first + h)
        rows = [[b[i, 0]] + [a[i, lane] for lane in range(plan.lanes - 1)] for i in range(plan.dim)]
        write(plan, of, first + h, ti.Matrix(rows))
