"""The parts of things above a floor, gathered on a grid by layers of height (`render/shadow.py`).

Parts are added up in whole numbers, `ONE` to a cell's area, which have no order: the same bits for
every number of threads.
"""

import taichi as ti

from taichi_cloth.front_end.mending import kernel

CELLS = 64  # of the grid, along each side
LAYERS = 9  # at heights of 1 to 64 cells,
STEP = 0.75  # so far apart, in powers of two: shares are right to 1.5 %
ONE = 1 << 16
FINEST = 64  # parts along a triangle's side, at most
DISC = 12  # parts of a ball, spread evenly over its projection (Vogel, 1979)
TURN = 2.399963229728653  # the golden angle

rows = ti.types.ndarray(dtype=ti.f32, ndim=2)
indices = ti.types.ndarray(dtype=ti.i32, ndim=2)
numbers = ti.types.ndarray(dtype=ti.f32, ndim=1)
row = ti.types.ndarray(dtype=ti.i32, ndim=1)


@ti.func
def _add(area, x, z, height, grid: ti.template()):
    """Add a part: its area, where it is, how high, all in cells.

    Two layers share it, and in each the four corners around it.
    """
    # Written so that what is no number fails.
    if x >= 0.0 and x < CELLS and z >= 0.0 and z < CELLS and height > -1.0 and height < 1e6:
        octaves = ti.log(ti.max(height, 1.0)) * 1.4426950408889634
        layer = ti.min(octaves / STEP, LAYERS - 1.0)
        k, i, j = ti.min(ti.cast(layer, ti.i32), LAYERS - 2), ti.cast(x, ti.i32), ti.cast(z, ti.i32)
        by_layer, by_x, by_z = layer - k, x - i, z - j
        for corner in ti.static(range(8)):
            a, b, c = ti.static(corner >> 2, (corner >> 1) & 1, corner & 1)
            weight = ti.select(a == 1, by_layer, 1.0 - by_layer)
            weight *= ti.select(b == 1, by_x, 1.0 - by_x) * ti.select(c == 1, by_z, 1.0 - by_z)
            at = ((k + a) * (CELLS + 1) + i + b) * (CELLS + 1) + j + c
            if weight > 0.0:
                ti.atomic_add(grid[at], ti.cast(ti.min(weight * area, 1e4) * ONE + 0.5, ti.i32))


@ti.func
def _cells(place: ti.template(), v, where: ti.template()):
    """A vertex in cells: x, height, z. where: the grid's low x and z, ground, cell, which is up."""
    by_cell = 1.0 / where[3]
    return ti.Vector(
        [
            (place[v, 0] - where[0]) * by_cell,
            where[4] * (place[v, 1] - where[2]) * by_cell,
            (place[v, 2] - where[1]) * by_cell,
        ]
    )


@kernel
def gather(
    balls: ti.template(),
    place: rows,
    corner: indices,
    ball: indices,
    share: ti.f32,
    of_balls: ti.f32,
    where: numbers,
    grid: row,
):
    """Add the projections of triangles and balls, a share of each kind, to a grid of all layers.

    balls: whether there are any. place: (n, 3) [world]. corner: (m, 3), vertices. ball: (k, 3), as
    `frame.py` has them.
    where: as `_cells` takes it. grid: (layers * (cells + 1)^2,).
    """
    # One thread of a processor: several would wait for each other's numbers.
    ti.loop_config(serialize=ti.static(ti.cfg.arch == ti.cpu))
    for t in range(corner.shape[0]):
        a, b = _cells(place, corner[t, 0], where), _cells(place, corner[t, 1], where)
        c = _cells(place, corner[t, 2], where)
        one, two = b - a, c - a
        area = 0.5 * ti.abs(one[0] * two[2] - one[2] * two[0])
        if area >= 0.0 and area < 1e9:
            fine = ti.cast(ti.min(ti.ceil(ti.sqrt(area)), FINEST + 0.0), ti.i32)
            fine = ti.max(fine, 1)
            for part in range(fine * fine):
                i, j = ti.raw_div(part, fine), part % fine
                # Parts of the other half of a parallelogram are turned over.
                u, v = i + 1.0 / 3.0, j + 1.0 / 3.0
                if i + j >= fine:
                    u, v = fine - u, fine - v
                at = a + (u / fine) * one + (v / fine) * two
                _add(share * area / (fine * fine), at[0], at[2], at[1], grid)
    if ti.static(balls):
        ti.loop_config(serialize=ti.static(ti.cfg.arch == ti.cpu))
        for k in range(ball.shape[0]):
            at = _cells(place, ball[k, 0], where)
            radius = ti.bit_cast(ball[k, 2], ti.f32) / where[3]
            for part in range(DISC):
                away, turn = radius * ti.sqrt((part + 0.5) / DISC), TURN * part
                area = of_balls * 3.141592653589793 * radius * radius / DISC
                _add(area, at[0] + away * ti.cos(turn), at[2] + away * ti.sin(turn), at[1], grid)
