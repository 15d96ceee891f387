"""Vertices projected and lit, before anything is drawn."""

import taichi as ti

from taichi_cloth.front_end.mending import kernel
from taichi_cloth.kernels.render.frame import (
    ABSENT,
    BALL,
    CHUNK,
    CHUNKS,
    EYE,
    FINE,
    GROUPS,
    KINDS,
    LAYERS,
    LENS,
    LIGHTS,
    LINE,
    ROOM,
    TILE,
    TRIANGLE,
    TURN,
    VERTICES,
    WIDTHS,
    bits,
    image,
    numbers,
    packed,
    real,
    rgb_of,
    row,
    three,
)


@ti.func
def light(number: ti.template(), normal):
    """The brightness of a surface of a unit normal under all lights, by Lambert's law."""
    bright = number[LIGHTS + 8]
    for k in ti.static(range(2)):
        along = normal.dot(three(number, LIGHTS + 4 * k))
        bright += number[LIGHTS + 4 * k + 3] * ti.max(along, 0.0)
    return bright


@ti.func
def _sheen(number: ti.template(), normal, place):
    """The sheen of fabric seen along its surface: its fibres stand out against light."""
    across = 1.0 - ti.abs(normal.dot(place)) / ti.max(place.norm(), 1e-20)
    return number[LIGHTS + 9] * across * across * across


@ti.func
def _turned(number: ti.template(), n):
    turned = ti.Vector([0.0, 0.0, 0.0])
    for k in ti.static(range(3)):
        turned[k] = three(number, TURN + 3 * k).dot(n)
    return turned


@ti.func
def _project(
    v, x: ti.template(), normal: ti.template(), side: ti.template(), number: ti.template(),
    vertex: ti.template(),
):  # fmt: skip
    """Fill in what is seen of a vertex. normal: of the first vertices, those of surfaces."""
    place = _turned(number, three(x, 3 * v) - three(number, EYE))
    by_depth = 0.0
    # Written so that what is no number fails.
    if (
        place[2] > number[LENS + 3]
        and ti.abs(place[0]) < 1e6 * place[2]
        and ti.abs(place[1]) < 1e6 * place[2]
    ):
        by_depth = 1.0 / place[2]
    for k in ti.static(range(2)):
        vertex[5 * v + k] = bits(number[LENS + 1 + k] + number[LENS] * place[k] * by_depth)
    vertex[5 * v + 2] = bits(by_depth)
    if 3 * v < normal.shape[0]:
        n = _turned(number, three(normal, 3 * v))
        sheen = _sheen(number, n, place)
        for k in ti.static(range(2)):
            lit = light(number, n * (1.0 - 2.0 * k))
            own = rgb_of(side[2 * v + k])
            vertex[5 * v + 3 + k] = packed(lit * own + sheen * (0.35 + 0.65 * own), FINE)


@ti.func
def _fill_globe(
    s, x: ti.template(), ball: ti.template(), number: ti.template(), globe: ti.template()
):
    """Find where a ball is, and how large it is, or the least of which one sees something."""
    place = _turned(number, three(x, 3 * ball[3 * s]) - three(number, EYE))
    for k in ti.static(range(3)):
        globe[4 * s + k] = place[k]
    globe[4 * s + 3] = ti.max(real(ball[3 * s + 2]), 0.8 * place[2] / number[LENS])


@ti.func
def globe_reach(s, number: ti.template(), globe: ti.template()):
    """The most pixels that a ball reaches around its middle."""
    x, y, z, radius = globe[4 * s], globe[4 * s + 1], globe[4 * s + 2], globe[4 * s + 3]
    near = ti.max(z - radius, number[LENS + 3])
    return number[LENS] * radius / near * (1.0 + (x * x + y * y) / (z * z)) + 1.0


@ti.func
def _bound(
    kind, s, layer, corner: ti.template(), ball: ti.template(), line: ti.template(),
    number: ti.template(), vertex: ti.template(), globe: ti.template(),
):  # fmt: skip
    """The pixels that a thing may touch: x from, to, y from, to; none where it is not drawn."""
    low, high = ti.Vector([1e9, 1e9]), ti.Vector([-1e9, -1e9])
    seen, reach = 1.0, 1.0  # neighbours become edges, too
    for k in range(3):
        v = 0
        if kind == TRIANGLE:
            v = corner[3 * s + k]
        elif kind == BALL:
            v = ball[3 * s]
        else:
            v = line[3 * s + ti.min(k, 1)]
        place = ti.Vector([real(vertex[5 * v]), real(vertex[5 * v + 1])])
        low, high = ti.min(low, place), ti.max(high, place)
        seen = ti.min(seen, real(vertex[5 * v + 2]))
    if seen <= 0.0:
        low, high = ti.Vector([1e9, 1e9]), ti.Vector([-1e9, -1e9])
    elif kind == BALL:
        reach += globe_reach(s, number, globe)
    elif kind == LINE:
        reach += 0.5 * number[WIDTHS + 2 * layer] + 1.0
    return ti.Vector([low[0] - reach, high[0] + reach, low[1] - reach, high[1] + reach])


@kernel
def see(
    kinds: ti.template(),
    x: numbers,
    normal: numbers,
    side: row,
    corner: row,
    ball: row,
    line: row,
    number: numbers,
    count: row,
    vertex: row,
    globe: numbers,
    box: image,
):
    """Compute what is seen of vertices, and where things are; `frame.py` says what these are.

    kinds: which there are of triangles, balls, lines. x, normal: (3 n,). side: (2 n,), colours of
    the vertices' fronts and backs. number, count: as `rasterizer.py` fills them in.
    """
    for v in range(count[VERTICES]):
        _project(v, x, normal, side, number, vertex)
    for c in range(count[CHUNKS]):
        layer, kind = 0, 0
        for g in range(LAYERS * KINDS):
            at = GROUPS + 3 * g
            if count[at + 1] > count[at] and c >= count[at + 2]:
                layer, kind = g // KINDS, g % KINDS
        group = GROUPS + 3 * (KINDS * layer + kind)
        first = count[group] + (c - count[group + 2]) * CHUNK
        x_low, x_high, y_low, y_high = 1e9, -1e9, 1e9, -1e9
        for s in range(first, ti.min(first + CHUNK, count[group + 1])):
            if kind == BALL:
                if ti.static(kinds[BALL]):
                    _fill_globe(s, x, ball, number, globe)
            own = _bound(kind, s, layer, corner, ball, line, number, vertex, globe)
            x_low, x_high = ti.min(x_low, own[0]), ti.max(x_high, own[1])
            y_low, y_high = ti.min(y_low, own[2]), ti.max(y_high, own[3])
        w, h, at = count[ROOM + 2] + 0.0, count[ROOM + 3] + 0.0, LAYERS * count[TILE + 3] + c
        box[at, 0], box[at, 1], box[at, 2], box[at, 3] = ABSENT, -ABSENT, ABSENT, -ABSENT
        if x_low < w and x_high > 0.0 and y_low < h and y_high > 0.0:
            box[at, 0] = ti.cast(ti.max(x_low, 0.0), ti.i32)
            box[at, 1] = ti.cast(ti.min(x_high + 1.0, w), ti.i32)
            box[at, 2] = ti.cast(ti.max(y_low, 0.0), ti.i32)
            box[at, 3] = ti.cast(ti.min(y_high + 1.0, h), ti.i32)
