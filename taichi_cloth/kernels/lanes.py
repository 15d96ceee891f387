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
"""

import taichi as ti


def lanes_of(a):
    """How many vectors the value `a` holds; settled when a kernel is compiled."""
    shape = a.get_shape()
    return 1 if len(shape) == 1 else shape[1]


@ti.func
def dot(a, b):
    """Scalar product, for each lane."""
    if ti.static(lanes_of(a) == 1):
        return a.dot(b)
    else:
        product = component(a, 0) * component(b, 0)
        for axis in ti.static(range(1, a.n)):
            product += component(a, axis) * component(b, axis)
        return product


@ti.func
def scaled(s, d):
    """The vectors d times a number for each lane."""
    if ti.static(lanes_of(d) == 1):
        return s * d
    else:
        return ti.Matrix(
            [[s[lane] * d[axis, lane] for lane in range(lanes_of(d))] for axis in range(d.n)]
        )


@ti.func
def where(condition, a, b):
    """a where the condition of the lane holds, else b; a, b: vectors."""
    if ti.static(lanes_of(a) == 1):
        return ti.select(condition, a, b)
    else:
        return ti.Matrix(
            [
                [
                    ti.select(condition[lane], a[axis, lane], b[axis, lane])
                    for lane in range(lanes_of(a))
                ]
                for axis in range(a.n)
            ]
        )


@ti.func
def any_lane(plan: ti.template(), condition):
    """Whether the condition holds in any lane."""
    if ti.static(plan.lanes > 1):
        holds = condition[0]
        for lane in ti.static(range(1, plan.lanes)):
            holds |= condition[lane]
        return holds
    else:
        return condition


@ti.func
def over_lanes(plan: ti.template(), a):
    """Sum of the numbers in all lanes."""
    if ti.static(plan.lanes > 1):
        return a.sum()
    else:
        return a


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
    b = a
    if ti.static(lanes_of(a) == 1):
        b[axis] = value
    else:
        for lane in ti.static(range(lanes_of(a))):
            b[axis, lane] = value[lane]
    return b


@ti.func
def cell_value(plan: ti.template(), of: ti.template(), c):
    """The values of a cell: for code that runs on whole cells."""
    return of[c]


@ti.func
def site_value(plan: ti.template(), of: ti.template(), site):
    """The vector of one particle, by its site: for code that runs particle by particle."""
    if ti.static(plan.lanes == 1):
        return of[site]
    else:
        cell, lane = site // plan.lanes, site % plan.lanes
        return ti.Vector([of[cell][axis, lane] for axis in range(plan.dim)])


@ti.func
def site_number(plan: ti.template(), of: ti.template(), site):
    """The number of one particle, by its site."""
    if ti.static(plan.lanes == 1):
        return of[site]
    else:
        return of[site // plan.lanes][site % plan.lanes]


@ti.func
def set_site_value(plan: ti.template(), of: ti.template(), site, value):
    """Store the vector of one particle."""
    for axis in ti.static(range(plan.dim)):
        if ti.static(plan.lanes == 1):
            of[site][axis] = value[axis]
        else:
            of[site // plan.lanes][axis, site % plan.lanes] = value[axis]


@ti.func
def set_site_number(plan: ti.template(), of: ti.template(), site, value):
    """Store the number of one particle."""
    if ti.static(plan.lanes == 1):
        of[site] = value
    else:
        of[site // plan.lanes][site % plan.lanes] = value


@ti.func
def pitch_of(plan: ti.template(), state: ti.template(), g):
    """Cells from a row of grid g to the next."""
    return state.grid[g][2] + 2 * plan.halo


@ti.func
def far_end(plan: ti.template(), s: ti.template(), c, pitch):
    """The cell at the other end of cell c's links of kind s."""
    return c + plan.links[s][0] + plan.links[s][1] * pitch


@ti.func
def renew_left_halo(plan: ti.template(), of: ti.template(), first, width, reach: ti.template()):
    """Left of a row that begins at cell `first`: the columns before each strip's first one."""
    for h in ti.static(range(1, reach + 1)):
        for axis in ti.static(range(plan.dim)):
            of[first - h][axis, 0] = 0.0
            for lane in ti.static(range(1, plan.lanes)):
                of[first - h][axis, lane] = of[first + width - h][axis, lane - 1]


@ti.func
def renew_right_halo(plan: ti.template(), of: ti.template(), first, width, reach: ti.template()):
    """Right of it: the columns after each strip's last one."""
    for h in ti.static(range(reach)):
        for axis in ti.static(range(plan.dim)):
            of[first + width + h][axis, plan.lanes - 1] = 0.0
            for lane in ti.static(range(plan.lanes - 1)):
                of[first + width + h][axis, lane] = of[first + h][axis, lane + 1]
