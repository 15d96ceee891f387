"""Triangles, balls and lines put into the pixels of a tile: the nearest thing in each middle.

`names`: from a pixel's depth in `near` to its name, and from there to its colour. `spans`: where
the columns of the tile's first row stand in it.
"""

import taichi as ti

from taichi_cloth.kernels.render.frame import (
    BALL,
    CHUNK,
    GROUPS,
    KINDS,
    LAYERS,
    LENS,
    LINE,
    ROOM,
    TRIANGLE,
    WIDTHS,
    ZERO,
    bits,
    first_pixel,
    packed,
    real,
    rgb_of,
    three,
)
from taichi_cloth.kernels.render.sight import globe_reach, light

PARTS = 8192.0  # of a level of a channel, in which colours are counted along a row
CHANNEL = 21  # bits that a channel takes then, of which 13 are parts of a level


@ti.func
def globe_depth(s, u, v, number: ti.template(), globe: ti.template()):
    """The depth of a ball at a place of the picture; 0 where it is not."""
    x, y, z, radius = globe[4 * s], globe[4 * s + 1], globe[4 * s + 2], globe[4 * s + 3]
    way_x = (u - number[LENS + 1]) / number[LENS]
    way_y = (v - number[LENS + 2]) / number[LENS]
    size2 = way_x * way_x + way_y * way_y + 1.0
    nearest = (way_x * x + way_y * y + z) / size2  # where the line of sight is nearest
    off_x, off_y, off_z = nearest * way_x - x, nearest * way_y - y, nearest - z
    inside = radius * radius - off_x * off_x - off_y * off_y - off_z * off_z
    return ti.select(inside >= 0.0, nearest - ti.sqrt(ti.max(inside, 0.0) / size2), 0.0)


@ti.func
def line_depth(s, u, v, layer, line: ti.template(), number: ti.template(), vertex: ti.template()):
    """One over the depth of a line at a place of the picture; 0 where it is not."""
    p, q = 5 * line[3 * s], 5 * line[3 * s + 1]
    x, y, z = real(vertex[p]), real(vertex[p + 1]), real(vertex[p + 2])
    along, down = real(vertex[q]) - x, real(vertex[q + 1]) - y
    half = 0.5 * number[WIDTHS + 2 * layer]
    part = ((u - x) * along + (v - y) * down) / ti.max(along * along + down * down, 1e-12)
    part = ti.min(ti.max(part, 0.0), 1.0)
    off_x, off_y = u - x - part * along, v - y - part * down
    found = (z + part * (real(vertex[q + 2]) - z)) / (1.0 - number[WIDTHS + 2 * layer + 1])
    return ti.select(off_x * off_x + off_y * off_y <= half * half, found, 0.0)


@ti.func
def _widen(near: ti.template(), span, first, last):
    """Note that pixels of a row from `first` to before `last` have something. span: the row's."""
    if first < last:
        near[span], near[span + 1] = ti.min(near[span], first), ti.max(near[span + 1], last)


@ti.func
def _fine(code):
    """The channels of a vertex's lit colour, from 0 to 255."""
    return ti.Vector([(code >> 20) & 1023, (code >> 10) & 1023, code & 1023]) * (255.0 / 1023.0)


@ti.func
def _side_by_side(channels):
    """Three numbers of parts of a level as one; sums of such are those of the numbers."""
    total = ti.cast(0, ti.i64)
    for k in ti.static(range(3)):
        total = (total << CHANNEL) + ti.cast(channels[k], ti.i64)
    return total


@ti.func
def _triangle(
    s, w, names, spans, x0, x1, y0, y1, corner: ti.template(), count: ti.template(),
    vertex: ti.template(), near: ti.template(),
):  # fmt: skip
    """Put a triangle into the pixels from x0 to before x1 and from y0 to before y1. w: the room's.

    Along a row its colour is counted in whole parts of a level, all channels in one number. They
    begin at the room's side, so they are the same in every tile.
    """
    x, y, z = ti.Vector([0.0] * 3), ti.Vector([0.0] * 3), ti.Vector([0.0] * 3)
    v = ti.Vector([0] * 3)
    for k in ti.static(range(3)):
        v[k] = 5 * corner[3 * s + k]
        x[k], y[k], z[k] = real(vertex[v[k]]), real(vertex[v[k] + 1]), real(vertex[v[k] + 2])
    j0, j1 = first_pixel(y.min(), y0, y1), first_pixel(y.max(), y0, y1)
    if z.min() > 0.0 and j0 < j1 and first_pixel(x.min(), x0, x1) < first_pixel(x.max(), x0, x1):
        area = (x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0])
        by_area = ti.select(area != 0.0, 1.0 / area, 0.0)
        # One over the depth, and colours, are linear on the screen.
        right_1, right_2 = (y[2] - y[0]) * by_area, (y[0] - y[1]) * by_area
        down_1, down_2 = (x[0] - x[2]) * by_area, (x[1] - x[0]) * by_area
        z_x = (z[1] - z[0]) * right_1 + (z[2] - z[0]) * right_2
        z_y = (z[1] - z[0]) * down_1 + (z[2] - z[0]) * down_2
        color, right, down = ti.Vector([0.0] * 3), ti.Vector([0.0] * 3), ti.Vector([0.0] * 3)
        is_colored = False  # the smallest triangles cover no pixel's middle
        # Each side from its upper end down, in both triangles that share it: no gap, no overlap.
        top_x, top_y, low_y = ti.Vector([0.0] * 3), ti.Vector([0.0] * 3), ti.Vector([0.0] * 3)
        way = ti.Vector([0.0] * 3)
        for k in ti.static(range(3)):
            m = (k + 1) % 3
            over = y[k] < y[m] or (y[k] == y[m] and x[k] < x[m])
            top_x[k], top_y[k] = ti.select(over, x[k], x[m]), ti.select(over, y[k], y[m])
            low_x = ti.select(over, x[m], x[k])
            low_y[k] = ti.select(over, y[m], y[k])
            way[k] = (low_x - top_x[k]) / ti.max(low_y[k] - top_y[k], 1e-12)
        for j in range(j0, j1):
            middle = j + 0.5
            low, high = 1e9, -1e9
            for k in ti.static(range(3)):
                at = top_x[k] + (middle - top_y[k]) * way[k]
                meets = top_y[k] <= middle and middle < low_y[k]
                low = ti.select(meets, ti.min(low, at), low)
                high = ti.select(meets, ti.max(high, at), high)
            begin, end = first_pixel(low, 0, w), first_pixel(high, 0, w)
            first, last = ti.max(begin, x0), ti.min(end, x1)
            if first < last:
                _widen(near, spans + 2 * (j - y0), first, last)
                if not is_colored:
                    seen = ti.select(area < 0.0, 3, 4)  # the front, as y points down
                    color = _fine(vertex[v[0] + seen])
                    one = _fine(vertex[v[1] + seen]) - color
                    two = _fine(vertex[v[2] + seen]) - color
                    right, down = one * right_1 + two * right_2, one * down_1 + two * down_2
                    is_colored = True
                at_first = color + (begin + 0.5 - x[0]) * right + (middle - y[0]) * down
                at_first = ti.min(ti.max(at_first, 0.0), 255.0)
                at_last = at_first + (end - 1 - begin) * right
                at_last = ti.min(ti.max(at_last, 0.0), 255.0)
                by_length = PARTS / ti.max(end - 1.0 - begin, 1.0)
                step = _side_by_side(ti.cast((at_last - at_first) * by_length, ti.i32))
                code = _side_by_side(ti.cast((at_first + 0.5) * PARTS, ti.i32))
                code += (first - begin) * step
                depth, here = (
                    z[0] + (middle - y[0]) * z_y + (0.5 - x[0]) * z_x,
                    (j + 1) * (w + 2) + 1,
                )
                i = first
                while i < last:
                    at, deep = here + i, depth + i * z_x
                    if deep > real(near[at]):
                        near[at], near[at + names] = bits(deep), 4 * s + TRIANGLE
                        rgb = (
                            ((code >> 39) & 0xFF0000)
                            | ((code >> 26) & 0xFF00)
                            | ((code >> 13) & 255)
                        )
                        near[at + 2 * names] = ti.cast(rgb, ti.i32)
                    code += step
                    i += 1 + count[ZERO]


@ti.func
def _ball(
    s, w, names, spans, x0, x1, y0, y1, ball: ti.template(), number: ti.template(),
    count: ti.template(), vertex: ti.template(), globe: ti.template(), near: ti.template(),
):  # fmt: skip
    """Put a ball into pixels, as `_triangle` does."""
    p = 5 * ball[3 * s]
    if real(vertex[p + 2]) > 0.0:
        reach, x, y = globe_reach(s, number, globe), real(vertex[p]), real(vertex[p + 1])
        own = rgb_of(ball[3 * s + 1])
        for j in range(first_pixel(y - reach, y0, y1), first_pixel(y + reach, y0, y1)):
            first, last = first_pixel(x - reach, x0, x1), first_pixel(x + reach, x0, x1)
            _widen(near, spans + 2 * (j - y0), first, last)
            i = first
            while i < last:
                z, at = globe_depth(s, i + 0.5, j + 0.5, number, globe), (j + 1) * (w + 2) + i + 1
                if z > number[LENS + 3] and 1.0 / z > real(near[at]):
                    across = (i + 0.5 - number[LENS + 1]) / number[LENS]
                    down = (j + 0.5 - number[LENS + 2]) / number[LENS]
                    normal = z * ti.Vector([across, down, 1.0]) - three(globe, 4 * s)
                    lit = light(number, normal / ti.max(normal.norm(), 1e-20))
                    near[at], near[at + names] = bits(1.0 / z), 4 * s + BALL
                    near[at + 2 * names] = packed(lit * own, 256)
                i += 1 + count[ZERO]


@ti.func
def _line(
    s, w, names, spans, x0, x1, y0, y1, layer, line: ti.template(), number: ti.template(),
    count: ti.template(), vertex: ti.template(), near: ti.template(),
):  # fmt: skip
    """Put a line with round ends into pixels, as `_triangle` does."""
    p, q = 5 * line[3 * s], 5 * line[3 * s + 1]
    if ti.min(real(vertex[p + 2]), real(vertex[q + 2])) > 0.0:
        x, y = real(vertex[p]), real(vertex[p + 1])
        along, down = real(vertex[q]) - x, real(vertex[q + 1]) - y
        half = 0.5 * number[WIDTHS + 2 * layer]
        # A flat line is near its rows as a whole. Without branches: loops would be written twice.
        steep = ti.select(ti.abs(down) > 1e-3, 1.0 / down, 0.0)
        flat = ti.select(ti.abs(down) > 1e-3, 0.0, 1.0)
        for j in range(
            first_pixel(ti.min(y, y + down) - half, y0, y1),
            first_pixel(ti.max(y, y + down) + half, y0, y1),
        ):
            # Only this part of the line, from one share of it to another, is so near the row.
            one, other = (j + 0.5 - y - half) * steep, (j + 0.5 - y + half) * steep
            part0 = ti.min(ti.max(ti.min(one, other) - flat, 0.0), 1.0)
            part1 = ti.min(ti.max(ti.max(one, other) + flat, 0.0), 1.0)
            a, b = x + part0 * along, x + part1 * along
            first = first_pixel(ti.min(a, b) - half, x0, x1)
            last = first_pixel(ti.max(a, b) + half, x0, x1)
            _widen(near, spans + 2 * (j - y0), first, last)
            i = first
            while i < last:
                z = line_depth(s, i + 0.5, j + 0.5, layer, line, number, vertex)
                at = (j + 1) * (w + 2) + i + 1
                if z > real(near[at]):
                    near[at], near[at + names] = bits(z), 4 * s + LINE
                    near[at + 2 * names] = line[3 * s + 2]
                i += 1 + count[ZERO]


@ti.func
def fill(
    kinds: ti.template(), layer, names, spans, i0, i1, j0, j1, tiles, corner: ti.template(),
    ball: ti.template(), line: ti.template(), number: ti.template(), count: ti.template(),
    vertex: ti.template(), globe: ti.template(), box: ti.template(), near: ti.template(),
):  # fmt: skip
    """Put all things of a layer into the pixels of a tile."""
    for kind in ti.static(range(KINDS)):
        if ti.static(kinds[kind]):
            group = GROUPS + 3 * (KINDS * layer + kind)
            begin, end, w = count[group], count[group + 1], count[ROOM + 2]
            for c in range((end - begin + CHUNK - 1) // CHUNK):
                k = LAYERS * tiles + count[group + 2] + c
                if box[k, 2] < j1 and box[k, 3] > j0 and box[k, 0] < i1 and box[k, 1] > i0:
                    for s in range(begin + c * CHUNK, ti.min(begin + (c + 1) * CHUNK, end)):
                        if ti.static(kind == TRIANGLE):
                            _triangle(
                                s, w, names, spans, i0, i1, j0, j1, corner, count, vertex, near
                            )
                        elif ti.static(kind == BALL):
                            _ball(
                                s, w, names, spans, i0, i1, j0, j1, ball, number, count, vertex,
                                globe, near,
                            )  # fmt: skip
                        else:
                            _line(
                                s, w, names, spans, i0, i1, j0, j1, layer, line, number, count,
                                vertex, near,
                            )  # fmt: skip
