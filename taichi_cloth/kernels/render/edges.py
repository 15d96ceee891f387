"""Smooth edges: where neighbours differ, a pixel is the mean of four samples.

A sample shows what covers it of the surfaces, balls and lines that the pixel and its neighbours
show. `names`: from a pixel's name in `near` to its colour, and back to its depth.
"""

import taichi as ti

from taichi_cloth.kernels.render.fill import globe_depth, line_depth
from taichi_cloth.kernels.render.frame import BALL, LINE, TRIANGLE, real

SEEN = 8  # of 255: by so much neighbours differ where one sees an edge
STEPS = 12  # from triangle to triangle, to a place in a pixel


@ti.func
def _surface_depth(s, u, v, corner: ti.template(), beside: ti.template(), vertex: ti.template()):
    """One over the depth of a surface at a place of the picture near a triangle; 0 where it ends.

    It goes from triangle to triangle over the side beyond which the place lies, and ends where the
    surface does, or turns away: slivers at a silhouette cover no pixel's middle.
    """
    t, past, found, turned = s, -1, 0.0, 0.0
    step = 0
    while step < STEPS and t >= 0:
        x, y, z = ti.Vector([0.0] * 3), ti.Vector([0.0] * 3), ti.Vector([0.0] * 3)
        for k in ti.static(range(3)):
            p = 5 * corner[3 * t + k]
            x[k], y[k] = real(vertex[p]) - u, real(vertex[p + 1]) - v
            z[k] = real(vertex[p + 2])
        # How far the place is inside of each side, from corner k to the next.
        side = ti.Vector([0.0] * 3)
        for k in ti.static(range(3)):
            side[k] = x[k] * y[(k + 1) % 3] - y[k] * x[(k + 1) % 3]
        area = side.sum()
        way = ti.select(area < 0.0, -1.0, 1.0)
        if step > 0 and way != turned or area == 0.0 or z.min() <= 0.0:
            t = -1
        else:
            turned, side = way, way * side
            if side.min() >= 0.0:
                found = (side[1] * z[0] + side[2] * z[1] + side[0] * z[2]) * way / area
                t = -1
            else:
                worst, over = 0.0, -1
                for k in ti.static(range(3)):
                    other = beside[3 * t + k]
                    if side[k] < worst and (other != past or step == 0):
                        worst, over = side[k], other
                past, t = t, over
        step += 1
    return found


@ti.func
def _depth(
    kinds: ti.template(), name, u, v, layer, corner: ti.template(), beside: ti.template(),
    line: ti.template(), number: ti.template(), vertex: ti.template(), globe: ti.template(),
):  # fmt: skip
    """One over the depth of a thing at a place of the picture; 0 where it is not."""
    s, kind, found = name >> 2, name & 3, 0.0
    if kind == TRIANGLE:
        if ti.static(kinds[TRIANGLE]):
            found = _surface_depth(s, u, v, corner, beside, vertex)
    elif kind == BALL:
        if ti.static(kinds[BALL]):
            z = globe_depth(s, u, v, number, globe)
            found = ti.select(z > 0.0, 1.0 / z, 0.0)
    elif ti.static(kinds[LINE]):
        found = line_depth(s, u, v, layer, line, number, vertex)
    return found


@ti.func
def _differ(a, b):
    """Other than 0 where one sees that two colours differ: by some `SEEN` in any channel."""
    # Of each channel SEEN plus the difference has but four bits, if it is small.
    ends = ((a & 0xFF00FF) - (b & 0xFF00FF) + SEEN * 0x010001) & ti.static(-0x000F0010)
    middle = ((a & 0x00FF00) - (b & 0x00FF00) + SEEN * 0x000100) & ti.static(-0x1000)
    return ends | middle


@ti.func
def is_edge(this, w, names, near: ti.template()):
    """True if a pixel is an edge. this: where its name stands in `near`."""
    name, code, found = near[this], near[this + names], False
    for step in ti.static(range(4)):
        there = this + ti.static((-1, 1, 0, 0)[step]) + ti.static((0, 0, -1, 1)[step]) * (w + 2)
        if near[there] != name:
            other = near[there + names]
            found = found or (other >= 0 and _differ(code, other) != 0)  # else beyond the room
    return found


@ti.func
def smoothed(
    kinds: ti.template(), zero, this, w, names, i, j, layer, corner: ti.template(),
    beside: ti.template(), line: ti.template(), number: ti.template(), vertex: ti.template(),
    globe: ti.template(), near: ti.template(),
):  # fmt: skip
    """The mean of a pixel's four samples.

    zero: 0, as `frame.ZERO` has it. this: where the pixel's name stands in `near`.
    """
    name, code, total = near[this], near[this + names] & 0xFFFFFF, ti.Vector([0, 0, 0])
    for q in range(4 + zero):
        best, shown, past = -1.0, code, -2
        for n in range(5 + zero):
            there = this + ti.select(n == 1, -1, ti.select(n == 2, 1, 0))
            there += ti.select(n == 3, -w - 2, ti.select(n == 4, w + 2, 0))
            other, z = near[there], 0.0
            if (n == 0 or other != name) and other != past:
                past = other
                # What lies behind what is there already need not be looked at.
                if other >= 0 and (best <= 0.0 or real(near[there - names]) > best):
                    z = _depth(
                        kinds, other, i + 0.25 + 0.5 * (q & 1), j + 0.25 + 0.5 * (q >> 1), layer,
                        corner, beside, line, number, vertex, globe,
                    )  # fmt: skip
                if z > best and (z > 0.0 or other < 0):
                    color = near[there + names]
                    if color >= 0:  # else it is beyond the room
                        best, shown = z, color & 0xFFFFFF
        total += ti.Vector([(shown >> 16) & 255, (shown >> 8) & 255, shown & 255])
    total = (total + 2) >> 2
    return (total[0] << 16) | (total[1] << 8) | total[2]
