"""Triangles, balls and lines as pixels, with depth: a rasterizer in tiles.

`see` computes where vertices are seen and how they are lit. `draw` finds the nearest thing in the
middle of each pixel, and its colour. One thread draws a whole tile, and passes over what may touch
it in a fixed order. Where neighbours then differ, one sees an edge. Such a pixel becomes the mean
of four samples: each shows what covers it of the surfaces, balls and lines that the pixel and its
neighbours show. So a picture has the same bits for every number of threads. Pixels in which
nothing changed are left alone.

Units: places in pixels of the picture's room, x right, y down, from its upper left corner. Depth is
kept as one over it. Colours are 0xRRGGBB, in `vertex` of ten bits each.

Vertices (n, 3) are places in the world. `vertex` (5 n,) int32 has what is seen of each: pixel x,
pixel y, one over the depth (0: not drawn; these three as bits of float32), the lit colours of its
front and of its back. `plane` (9 m,): the colour of each triangle's seen side at (0, 0), and how it
grows right and down. `ball` (k, 3) int32: its vertex, colour, radius as bits of float32; `globe`
(4 k,): its middle in the camera's axes, and its radius. `line` (l, 3) int32: its two vertices and
its colour. `beside` (m, 3) int32: the triangles that share a triangle's sides, -1 where none does.

Things are in two layers: what is firm, and veils, through which half of what lies behind is seen.
They are taken in chunks of `CHUNK`. Of `box` (, 4) int32 the first rows, one for each tile of each
layer, have columns: those written last, from and to; those in which something may be drawn, from
and to. The others, one a chunk, have the pixels that it may touch: x from, to, y from, to.

Arrays that inner loops use have one dimension: Taichi reads an array's shape at each access.
"""

import taichi as ti

from taichi_cloth.front_end.mending import kernel

CHUNK = 32  # triangles, balls or lines of which one box is kept
FLOOR = 0x1000000  # a bit of the colours that lie behind: they are the floor's
FINE = 1024  # levels of a channel of a particle's lit colour
SEEN = 8  # of 255: by so much neighbours differ where one sees an edge
EDGE = 1 << 26  # a bit of the colours in `near`: one sees an edge there
STRIDE = 8  # pixels between two places where the floor's shade is looked up
PIECE = 512  # iterations of a loop that Taichi gives a CPU's thread at a time, at least
STEPS = 12  # from triangle to triangle, to a place in a pixel
ROWS = 8  # iterations for one row of a floor: else a thread had 512 rows of them
ABSENT = 1 << 28  # no pixel is so far away
TRIANGLE, BALL, LINE, KINDS = 0, 1, 2, 3
LAYERS = 2

# Where things begin in `number`: the eye; the matrix that turns to the camera's axes; pixels per
# unit of slope, the pixel (x, y) looked at, the least depth; two lights (unit direction, strength),
# the ambient one and the sheen; of each layer how wide lines are, in pixels, and how far they are
# lifted; the homography from pixels to the cells of the floor's shade.
EYE, TURN, LENS, LIGHTS, WIDTHS, SHADE, NUMBERS = 0, 3, 12, 16, 26, 30, 39
# And in `count`: vertices and chunks; of each layer and kind the first, the end, the first chunk;
# then single numbers; then the columns of each row of tiles in which the floor is shaded.
VERTICES, CHUNKS, GROUPS = 0, 1, 2
ROOM = GROUPS + 3 * LAYERS * KINDS  # left, top, width, height of the room
TILE = ROOM + 4  # rows and columns of a tile, tiles across, tiles
STANDS, FRESH = TILE + 4, TILE + 5  # draw what stands still; write all pixels
AGAIN = FRESH + 1  # columns and rows to write again: from, to, from, to
NEXT, WORKERS, WIDTH = AGAIN + 4, AGAIN + 6, AGAIN + 7  # the next tile, twice; threads; of `out`
COUNTS = WIDTH + 1

image = ti.types.ndarray(dtype=ti.i32, ndim=2)
rows = ti.types.ndarray(dtype=ti.f32, ndim=2)
numbers = ti.types.ndarray(dtype=ti.f32, ndim=1)
row = ti.types.ndarray(dtype=ti.i32, ndim=1)


@ti.func
def _vector(a: ti.template(), i):
    return ti.Vector([a[i, 0], a[i, 1], a[i, 2]])


@ti.func
def _three(a: ti.template(), i):
    return ti.Vector([a[i], a[i + 1], a[i + 2]])


@ti.func
def _real(bits):
    return ti.bit_cast(bits, ti.f32)


@ti.func
def _bits(value):
    return ti.bit_cast(ti.cast(value, ti.f32), ti.i32)


@ti.func
def _first(place, low, high):
    """The first pixel from `low` to `high` whose middle lies at `place` or after it."""
    return ti.cast(ti.ceil(ti.min(ti.max(place - 0.5, low + 0.0), high + 0.0)), ti.i32)


@ti.func
def _rgb(code):
    """The channels of 0xRRGGBB, each from 0 to 1."""
    return ti.Vector([(code >> 16) & 255, (code >> 8) & 255, code & 255]) * (1.0 / 255.0)


@ti.func
def _packed(rgb, levels: ti.template()):
    """Channels from 0 to 1 side by side in an integer: with 256 levels each, 0xRRGGBB."""
    code = 0
    for k in ti.static(range(3)):
        level = ti.min(ti.max(rgb[k], 0.0), 1.0) * (levels - 1.0) + 0.5
        code = code * levels + ti.cast(level, ti.i32)
    return code


@ti.func
def _fine(code):
    return ti.Vector([(code >> 20) & 1023, (code >> 10) & 1023, code & 1023]) * (1.0 / 1023.0)


@ti.func
def _light(number: ti.template(), normal):
    """How bright a surface of a unit normal is under all lights, by Lambert's law."""
    bright = number[LIGHTS + 8]
    for k in ti.static(range(2)):
        along = normal.dot(_three(number, LIGHTS + 4 * k))
        bright += number[LIGHTS + 4 * k + 3] * ti.max(along, 0.0)
    return bright


@ti.func
def _sheen(number: ti.template(), normal, place):
    """What fabric adds where it is seen along its surface: its fibres stand out against light."""
    across = 1.0 - ti.abs(normal.dot(place)) / ti.max(place.norm(), 1e-20)
    return number[LIGHTS + 9] * across * across * across


@ti.func
def _turned(number: ti.template(), n):
    turned = ti.Vector([0.0, 0.0, 0.0])
    for k in ti.static(range(3)):
        turned[k] = _three(number, TURN + 3 * k).dot(n)
    return turned


@ti.func
def _project(
    v, x: ti.template(), normal: ti.template(), side: ti.template(), number: ti.template(),
    vertex: ti.template(),
):  # fmt: skip
    """Fill in what is seen of a vertex. normal: (0, 3) where there is no surface."""
    place = _turned(number, _vector(x, v) - _three(number, EYE))
    by_depth = 0.0
    # Written so that what is no number fails.
    if (
        place[2] > number[LENS + 3]
        and ti.abs(place[0]) < 1e6 * place[2]
        and ti.abs(place[1]) < 1e6 * place[2]
    ):
        by_depth = 1.0 / place[2]
    for k in ti.static(range(2)):
        vertex[5 * v + k] = _bits(number[LENS + 1 + k] + number[LENS] * place[k] * by_depth)
    vertex[5 * v + 2] = _bits(by_depth)
    if v < normal.shape[0]:
        n = _turned(number, _vector(normal, v))
        n = n / ti.max(n.norm(), 1e-20)
        sheen = _sheen(number, n, place)
        for k in ti.static(range(2)):
            lit = _light(number, n * (1.0 - 2.0 * k))
            own = _rgb(side[v, k])
            vertex[5 * v + 3 + k] = _packed(lit * own + sheen * (0.35 + 0.65 * own), FINE)


@ti.func
def _fill_globe(
    s, x: ti.template(), ball: ti.template(), number: ti.template(), globe: ti.template()
):
    """Find where a ball is, and how large it is, or the least of which one sees something."""
    place = _turned(number, _vector(x, ball[s, 0]) - _three(number, EYE))
    for k in ti.static(range(3)):
        globe[4 * s + k] = place[k]
    globe[4 * s + 3] = ti.max(_real(ball[s, 2]), 0.8 * place[2] / number[LENS])


@ti.func
def _globe_reach(s, number: ti.template(), globe: ti.template()):
    """How many pixels around its middle a ball reaches, at most."""
    x, y, z, radius = globe[4 * s], globe[4 * s + 1], globe[4 * s + 2], globe[4 * s + 3]
    near = ti.max(z - radius, number[LENS + 3])
    return number[LENS] * radius / near * (1.0 + (x * x + y * y) / (z * z)) + 1.0


@ti.func
def _globe_depth(s, u, v, number: ti.template(), globe: ti.template()):
    """How deep a ball is at a place of the picture; 0 where it is not."""
    x, y, z, radius = globe[4 * s], globe[4 * s + 1], globe[4 * s + 2], globe[4 * s + 3]
    way_x = (u - number[LENS + 1]) / number[LENS]
    way_y = (v - number[LENS + 2]) / number[LENS]
    size2 = way_x * way_x + way_y * way_y + 1.0
    nearest = (way_x * x + way_y * y + z) / size2  # where the line of sight is nearest
    off_x, off_y, off_z = nearest * way_x - x, nearest * way_y - y, nearest - z
    inside = radius * radius - off_x * off_x - off_y * off_y - off_z * off_z
    return ti.select(inside >= 0.0, nearest - ti.sqrt(ti.max(inside, 0.0) / size2), 0.0)


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
            v = corner[s, k]
        elif kind == BALL:
            v = ball[s, 0]
        else:
            v = line[s, ti.min(k, 1)]
        place = ti.Vector([_real(vertex[5 * v]), _real(vertex[5 * v + 1])])
        low, high = ti.min(low, place), ti.max(high, place)
        seen = ti.min(seen, _real(vertex[5 * v + 2]))
    if seen <= 0.0:
        low, high = ti.Vector([1e9, 1e9]), ti.Vector([-1e9, -1e9])
    elif kind == BALL:
        reach += _globe_reach(s, number, globe)
    elif kind == LINE:
        reach += 0.5 * number[WIDTHS + 2 * layer] + 1.0
    return ti.Vector([low[0] - reach, high[0] + reach, low[1] - reach, high[1] + reach])


@ti.func
def _fill_plane(s, corner: ti.template(), vertex: ti.template(), plane: ti.template()):
    """Compute how a triangle's seen side is coloured."""
    x, y, v = ti.Vector([0.0] * 3), ti.Vector([0.0] * 3), ti.Vector([0] * 3)
    for k in ti.static(range(3)):
        v[k] = 5 * corner[s, k]
        x[k], y[k] = _real(vertex[v[k]]), _real(vertex[v[k] + 1])
    area = (x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0])
    side = ti.select(area < 0.0, 3, 4)  # as y points down
    by_area = ti.select(area != 0.0, 1.0 / area, 0.0)
    first = _fine(vertex[v[0] + side])
    one, two = _fine(vertex[v[1] + side]) - first, _fine(vertex[v[2] + side]) - first
    right = (one * (y[2] - y[0]) - two * (y[1] - y[0])) * by_area
    down = (two * (x[1] - x[0]) - one * (x[2] - x[0])) * by_area
    at = first - x[0] * right - y[0] * down
    for k in ti.static(range(3)):
        plane[9 * s + k], plane[9 * s + 3 + k], plane[9 * s + 6 + k] = at[k], right[k], down[k]


@ti.func
def _widen(near: ti.template(), span, first, last):
    """Note that pixels of a row from `first` to before `last` have something. span: the row's."""
    if first < last:
        near[span], near[span + 1] = ti.min(near[span], first), ti.max(near[span + 1], last)


@ti.func
def _span(near: ti.template(), spans, across, j, tall, low, high):
    """The columns, from and to, in which row j of a tile, or one beside it, has something.

    spans: of the tile's rows. across: tiles in a row of them. low, high: of the whole tile, where
    its rows say nothing of those of other tiles.
    """
    first, last = low, high
    if across == 1 and j > 0 and j < tall - 1:
        first, last = high, low
        for k in ti.static(range(-1, 2)):
            at = spans + 2 * (j + k)
            first, last = ti.min(first, near[at] - 1), ti.max(last, near[at + 1] + 1)
        first, last = ti.max(first, low), ti.min(last, high)
    return first, ti.max(first, last)


@ti.func
def _keep(near: ti.template(), at, names, z, s):
    """Keep a thing in a pixel, if it is the nearest there so far. names: from there to its name."""
    if z > _real(near[at]):
        near[at] = _bits(z)
        near[at + names] = s


@ti.func
def _triangle(
    s, w, names, spans, x0, x1, y0, y1, corner: ti.template(), vertex: ti.template(),
    plane: ti.template(), near: ti.template(),
):  # fmt: skip
    """Put a triangle into the pixels from x0 to before x1 and from y0 to before y1.

    w: of the room. names: from a pixel's depth to its name in `near`. spans: of the tile's rows.
    """
    x, y, z = ti.Vector([0.0] * 3), ti.Vector([0.0] * 3), ti.Vector([0.0] * 3)
    for k in ti.static(range(3)):
        v = 5 * corner[s, k]
        x[k], y[k], z[k] = _real(vertex[v]), _real(vertex[v + 1]), _real(vertex[v + 2])
    j0, j1 = _first(y.min(), y0, y1), _first(y.max(), y0, y1)
    i0, i1 = _first(x.min(), x0, x1), _first(x.max(), x0, x1)
    if z.min() > 0.0 and j0 < j1 and i0 < i1:
        area = (x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0])
        by_area = ti.select(area != 0.0, 1.0 / area, 0.0)
        # One over the depth is linear on the screen.
        z_x = ((z[1] - z[0]) * (y[2] - y[0]) - (z[2] - z[0]) * (y[1] - y[0])) * by_area
        z_y = ((z[2] - z[0]) * (x[1] - x[0]) - (z[1] - z[0]) * (x[2] - x[0])) * by_area
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
        covers = False
        for j in range(j0, j1):
            middle = j + 0.5
            low, high = 1e9, -1e9
            for k in ti.static(range(3)):
                at = top_x[k] + (middle - top_y[k]) * way[k]
                meets = top_y[k] <= middle and middle < low_y[k]
                low = ti.select(meets, ti.min(low, at), low)
                high = ti.select(meets, ti.max(high, at), high)
            depth = z[0] + (middle - y[0]) * z_y + (0.5 - x[0]) * z_x
            first, last = _first(low, i0, i1), _first(high, i0, i1)
            covers = covers or first < last
            _widen(near, spans + 2 * (j - y0), first, last)
            for i in range(first, last):
                at = (j + 1) * (w + 2) + i + 1
                _keep(near, at, names, depth + i * z_x, 4 * s + TRIANGLE)
        if covers:  # other tiles do the same
            _fill_plane(s, corner, vertex, plane)


@ti.func
def _surface_depth(s, u, v, corner: ti.template(), beside: ti.template(), vertex: ti.template()):
    """One over the depth of a surface at a place of the picture near a triangle; 0 where it ends.

    It goes from triangle to triangle over the side beyond which the place lies, and ends where the
    surface does, or turns away: slivers at a silhouette cover no pixel's middle.
    """
    t, past, found, turned = s, -1, 0.0, 0.0
    for step in range(STEPS):
        if t >= 0:
            x, y, z = ti.Vector([0.0] * 3), ti.Vector([0.0] * 3), ti.Vector([0.0] * 3)
            for k in ti.static(range(3)):
                p = 5 * corner[t, k]
                x[k], y[k] = _real(vertex[p]) - u, _real(vertex[p + 1]) - v
                z[k] = _real(vertex[p + 2])
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
                        other = beside[t, k]
                        if side[k] < worst and (other != past or step == 0):
                            worst, over = side[k], other
                    past, t = t, over
    return found


@ti.func
def _ball(
    s, w, names, spans, x0, x1, y0, y1, ball: ti.template(), number: ti.template(),
    vertex: ti.template(), globe: ti.template(), near: ti.template(),
):  # fmt: skip
    """Put a ball into pixels, as `_triangle` does."""
    p = 5 * ball[s, 0]
    if _real(vertex[p + 2]) > 0.0:
        reach, x, y = _globe_reach(s, number, globe), _real(vertex[p]), _real(vertex[p + 1])
        for j in range(_first(y - reach, y0, y1), _first(y + reach, y0, y1)):
            first, last = _first(x - reach, x0, x1), _first(x + reach, x0, x1)
            _widen(near, spans + 2 * (j - y0), first, last)
            for i in range(first, last):
                z = _globe_depth(s, i + 0.5, j + 0.5, number, globe)
                if z > number[LENS + 3]:
                    _keep(near, (j + 1) * (w + 2) + i + 1, names, 1.0 / z, 4 * s + BALL)


@ti.func
def _line_depth(s, u, v, layer, line: ti.template(), number: ti.template(), vertex: ti.template()):
    """One over the depth of a line at a place of the picture; 0 where it is not."""
    p, q = 5 * line[s, 0], 5 * line[s, 1]
    x, y, z = _real(vertex[p]), _real(vertex[p + 1]), _real(vertex[p + 2])
    along, down = _real(vertex[q]) - x, _real(vertex[q + 1]) - y
    half = 0.5 * number[WIDTHS + 2 * layer]
    part = ((u - x) * along + (v - y) * down) / ti.max(along * along + down * down, 1e-12)
    part = ti.min(ti.max(part, 0.0), 1.0)
    off_x, off_y = u - x - part * along, v - y - part * down
    found = (z + part * (_real(vertex[q + 2]) - z)) / (1.0 - number[WIDTHS + 2 * layer + 1])
    return ti.select(off_x * off_x + off_y * off_y <= half * half, found, 0.0)


@ti.func
def _line(
    s, w, names, spans, x0, x1, y0, y1, layer, line: ti.template(), number: ti.template(),
    vertex: ti.template(), near: ti.template(),
):  # fmt: skip
    """Put a line with round ends into pixels, as `_triangle` does."""
    p, q = 5 * line[s, 0], 5 * line[s, 1]
    if ti.min(_real(vertex[p + 2]), _real(vertex[q + 2])) > 0.0:
        x, y = _real(vertex[p]), _real(vertex[p + 1])
        along, down = _real(vertex[q]) - x, _real(vertex[q + 1]) - y
        half = 0.5 * number[WIDTHS + 2 * layer]
        steep = ti.select(ti.abs(down) > 1e-3, 1.0 / down, 0.0)
        for j in range(
            _first(ti.min(y, y + down) - half, y0, y1), _first(ti.max(y, y + down) + half, y0, y1)
        ):
            # Only this part of the line, from one share of it to another, is so near the row.
            one, other = (j + 0.5 - y - half) * steep, (j + 0.5 - y + half) * steep
            part0 = ti.min(ti.max(ti.min(one, other), 0.0), 1.0)
            part1 = ti.min(ti.max(ti.max(one, other), 0.0), 1.0)
            if steep == 0.0:
                part0, part1 = 0.0, 1.0
            a, b = x + part0 * along, x + part1 * along
            first = _first(ti.min(a, b) - half, x0, x1)
            last = _first(ti.max(a, b) + half, x0, x1)
            _widen(near, spans + 2 * (j - y0), first, last)
            for i in range(first, last):
                z = _line_depth(s, i + 0.5, j + 0.5, layer, line, number, vertex)
                _keep(near, (j + 1) * (w + 2) + i + 1, names, z, 4 * s + LINE)


@ti.func
def _color(
    kinds: ti.template(), name, u, v, line: ti.template(), ball: ti.template(),
    number: ti.template(), plane: ti.template(), globe: ti.template(),
):  # fmt: skip
    """The colour of a thing at a place of the picture."""
    s, kind = name >> 2, name & 3
    rgb = ti.Vector([0.0] * 3)
    if kind == TRIANGLE:
        if ti.static(kinds[TRIANGLE]):
            for k in ti.static(range(3)):
                rgb[k] = plane[9 * s + k] + u * plane[9 * s + 3 + k] + v * plane[9 * s + 6 + k]
    elif kind == BALL:
        if ti.static(kinds[BALL]):
            z = _globe_depth(s, u, v, number, globe)
            normal = ti.Vector(
                [
                    z * (u - number[LENS + 1]) / number[LENS] - globe[4 * s],
                    z * (v - number[LENS + 2]) / number[LENS] - globe[4 * s + 1],
                    z - globe[4 * s + 2],
                ]
            )
            rgb = _light(number, normal / ti.max(normal.norm(), 1e-20)) * _rgb(ball[s, 1])
    elif ti.static(kinds[LINE]):
        rgb = _rgb(line[s, 2])
    return rgb


@ti.func
def _between(dark: ti.template(), u, v):
    """What is given at the corners of a grid's cells, (k, k), at a place between; 0 beyond it."""
    found, most = 0.0, dark.shape[0] - 1.0
    if u >= 0.0 and v >= 0.0 and u < most and v < most:
        i, j = ti.cast(u, ti.i32), ti.cast(v, ti.i32)
        a, b = u - i, v - j
        found = (1.0 - b) * ((1.0 - a) * dark[i, j] + a * dark[i + 1, j])
        found += b * ((1.0 - a) * dark[i, j + 1] + a * dark[i + 1, j + 1])
    return found


@ti.func
def _lit(number: ti.template(), dark: ti.template(), i, j):
    """The part of its light that the floor has in a pixel (i, j), by a homography to the cells."""
    w = number[SHADE + 6] * i + number[SHADE + 7] * j + number[SHADE + 8]
    lit = 1.0
    if w > 0.0:
        u = (number[SHADE] * i + number[SHADE + 1] * j + number[SHADE + 2]) / w
        v = (number[SHADE + 3] * i + number[SHADE + 4] * j + number[SHADE + 5]) / w
        lit -= _between(dark, u, v)
    return lit


@ti.func
def _shaded(code, lit):
    """A colour that lies behind, which has a part of its light where it is the floor's."""
    found = code & 0xFFFFFF
    if lit < 1.0 and code >= FLOOR:
        part = ti.cast(ti.max(lit, 0.0) * 256.0 + 0.5, ti.i32)
        ends = ((code & 0xFF00FF) * part + 0x800080) >> 8
        middle = ((code & 0x00FF00) * part + 0x008000) >> 8
        found = (ends & 0xFF00FF) | (middle & 0x00FF00)
    return found


@ti.func
def _half(a, b):
    """The mean of two colours."""
    return ((a >> 1) & 0x7F7F7F) + ((b >> 1) & 0x7F7F7F) + (a & b & 0x010101)


@ti.func
def _differ(a, b):
    """Whether one sees that two colours differ: by more than some `SEEN` in any channel."""
    # Of each channel SEEN plus the difference has but four bits, if it is small.
    ends = ((a & 0xFF00FF) - (b & 0xFF00FF) + SEEN * 0x010001) & ti.static(-0x000F0010)
    middle = ((a & 0x00FF00) - (b & 0x00FF00) + SEEN * 0x000100) & ti.static(-0x1000)
    return (ends | middle) != 0


@ti.func
def _put(
    kinds: ti.template(), layer, names, spans, i0, i1, j0, j1, tiles, corner: ti.template(),
    ball: ti.template(), line: ti.template(), number: ti.template(), count: ti.template(),
    vertex: ti.template(), plane: ti.template(), globe: ti.template(), box: ti.template(),
    near: ti.template(),
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
                                s, w, names, spans, i0, i1, j0, j1, corner, vertex, plane, near
                            )
                        elif ti.static(kind == BALL):
                            _ball(
                                s, w, names, spans, i0, i1, j0, j1, ball, number, vertex, globe,
                                near,
                            )  # fmt: skip
                        else:
                            _line(
                                s, w, names, spans, i0, i1, j0, j1, layer, line, number, vertex,
                                near,
                            )  # fmt: skip


@ti.func
def _tile(
    kinds: ti.template(), tile, layer, corner: ti.template(), ball: ti.template(),
    line: ti.template(), number: ti.template(), count: ti.template(), vertex: ti.template(),
    plane: ti.template(), globe: ti.template(), box: ti.template(), near: ti.template(),
    under: ti.template(), dark: ti.template(), out: ti.template(),
):  # fmt: skip
    """Draw what is seen in a tile, without smooth edges."""
    w, h, tiles, stands = count[ROOM + 2], count[ROOM + 3], count[TILE + 3], count[STANDS]
    names = (w + 2) * (h + 2)  # from a pixel's depth to its name, and from there to its colour
    row = tile // count[TILE + 2]
    j0, i0 = row * count[TILE], (tile - row * count[TILE + 2]) * count[TILE + 1]
    j1, i1 = ti.min(j0 + count[TILE], h), ti.min(i0 + count[TILE + 1], w)
    low, high = i1, i0  # the columns in which anything may be drawn
    for c in range(count[CHUNKS]):
        k = LAYERS * tiles + c
        if box[k, 2] < j1 and box[k, 3] > j0:
            low, high = ti.min(low, ti.max(box[k, 0], i0)), ti.max(high, ti.min(box[k, 1], i1))
    high = ti.max(low, high)
    # The columns that are written: also where something was drawn before, or the floor is shaded.
    first, last = low, high
    shaded = count[COUNTS + 2 * row] < i1 and count[COUNTS + 2 * row + 1] > i0 and layer == 0
    if shaded:
        first = ti.min(first, ti.max(count[COUNTS + 2 * row], i0))
        last = ti.max(last, ti.min(count[COUNTS + 2 * row + 1], i1))
    at, veiled = layer * tiles + tile, tiles + tile
    before_first, before_last = box[at, 0], box[at, 1]
    box[at, 0], box[at, 1], box[at, 2], box[at, 3] = first, last, low, high
    if layer == 0:
        first = ti.min(first, before_first, box[veiled, 0])
        last = ti.max(last, before_last, box[veiled, 1])
        box[veiled, 0], box[veiled, 1] = ABSENT, -ABSENT
        if count[AGAIN + 2] < j1 and count[AGAIN + 3] > j0:
            first = ti.min(first, ti.max(count[AGAIN], i0))
            last = ti.max(last, ti.min(count[AGAIN + 1], i1))
        if count[FRESH] != 0:
            first, last = i0, i1
    base = ti.select(stands != 0, 0, 2 * h)  # of the rows of what lies behind
    spans = 3 * names + 2 * tile * count[TILE]
    for j in range(j0, j1):
        here, at = (j + 1) * (w + 2) + 1, spans + 2 * (j - j0)
        near[at], near[at + 1] = ABSENT, -ABSENT
        for i in range(low, high):
            if layer == 0 or i < box[tile, 2] or i >= box[tile, 3]:
                near[here + i] = under[(base + j) * w + i]
        for i in range(low, high):
            near[names + here + i] = -1
    _put(
        kinds, layer, names, spans, i0, i1, j0, j1, tiles, corner, ball, line, number, count,
        vertex, plane, globe, box, near,
    )  # fmt: skip
    for j in range(j0, j1):
        to, back = (count[ROOM + 1] + j) * count[WIDTH] + count[ROOM], (base + h + j) * w
        lit1, here = 1.0, (j + 1) * (w + 2) + 1
        past_code = 0
        begin_row, end_row = _span(near, spans, count[TILE + 2], j - j0, j1 - j0, low, high)
        start = first & -STRIDE  # the same blocks, whatever is written
        for block in range(-1, (last - start + STRIDE - 1) // STRIDE):
            # The floor's shade is linear from here to there.
            left, lit0 = start + block * STRIDE, lit1
            if shaded:
                lit1 = _lit(number, dark, left + STRIDE, j)
            lit_x = (lit1 - lit0) * (1.0 / STRIDE)
            begin = ti.max(left, first)
            end = ti.select(block < 0, begin, ti.min(left + STRIDE, last))
            if stands == 0 and layer == 0 and (end <= begin_row or begin >= end_row):
                for i in range(begin, end):
                    near[names + here + i] = -1  # as wherever nothing is
                if ti.min(lit0, lit1) < 1.0:
                    for i in range(begin, end):
                        out[to + i] = _shaded(under[back + i], lit0 + (i - left) * lit_x)
                else:
                    for i in range(begin, end):
                        out[to + i] = under[back + i] & 0xFFFFFF
            else:
                for i in range(begin, end):
                    at = here + i
                    if i < low or i >= high:
                        near[names + at] = -1
                    name, code = near[names + at], 0
                    if layer > 0:
                        code = out[to + i]
                    elif name < 0 or stands != 0:
                        code = under[back + i]
                        if ti.min(lit0, lit1) < 1.0 and stands == 0:
                            code = _shaded(code, lit0 + (i - left) * lit_x)
                    if name >= 0:
                        own = _packed(
                            _color(kinds, name, i + 0.5, j + 0.5, line, ball, number, plane, globe),
                            256,
                        )
                        code = ti.select(layer > 0, _half(own, code), own)
                    if stands == 0:
                        out[to + i] = code & 0xFFFFFF
                    else:
                        z = under[j * w + i]
                        if name >= 0:
                            z = near[at]
                        under[(2 * h + j) * w + i], under[(3 * h + j) * w + i] = z, code
                    # Neighbours of this tile that one sees to differ.
                    code = code & 0xFFFFFF
                    mark = 0
                    if i > begin_row and _differ(code, past_code):
                        mark = EDGE
                        near[2 * names + at - 1] = near[2 * names + at - 1] | EDGE
                    past_code = code
                    if j > j0:
                        over = 2 * names + at - w - 2
                        if _differ(code, near[over] & 0xFFFFFF):
                            mark = EDGE
                            near[over] = near[over] | EDGE
                    near[2 * names + at] = code | mark


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
            z = _globe_depth(s, u, v, number, globe)
            found = ti.select(z > 0.0, 1.0 / z, 0.0)
    elif ti.static(kinds[LINE]):
        found = _line_depth(s, u, v, layer, line, number, vertex)
    return found


@ti.func
def _smooth(
    kinds: ti.template(), tile, layer, corner: ti.template(), beside: ti.template(),
    line: ti.template(), number: ti.template(), count: ti.template(), vertex: ti.template(),
    globe: ti.template(), box: ti.template(), near: ti.template(), under: ti.template(),
    out: ti.template(),
):  # fmt: skip
    """Smooth the edges in a tile. All neighbours of a pixel that has something are up to date."""
    w, h, tiles = count[ROOM + 2], count[ROOM + 3], count[TILE + 3]
    names = (w + 2) * (h + 2)
    row = tile // count[TILE + 2]
    j0, at = row * count[TILE], layer * tiles + tile
    i0 = (tile - row * count[TILE + 2]) * count[TILE + 1]
    j1, i1 = ti.min(j0 + count[TILE], h), ti.min(i0 + count[TILE + 1], w)
    for j in range(j0, j1):
        to, here = (count[ROOM + 1] + j) * count[WIDTH] + count[ROOM], (j + 1) * (w + 2) + 1
        beside_others = j == j0 or j == j1 - 1
        spans = 3 * names + 2 * tile * count[TILE]
        first, last = _span(near, spans, count[TILE + 2], j - j0, j1 - j0, box[at, 2], box[at, 3])
        for i in range(first, last):
            this = names + here + i
            marked = near[names + this]
            edge = marked & EDGE != 0
            if beside_others or i == i0 or i == i1 - 1:
                for step in ti.static(range(4)):
                    there = this + ti.select(step == 0, -1, ti.select(step == 1, 1, 0))
                    there += ti.select(step == 2, -w - 2, ti.select(step == 3, w + 2, 0))
                    if near[there] != near[this]:
                        code = near[names + there]
                        edge = edge or (code >= 0 and _differ(marked & 0xFFFFFF, code & 0xFFFFFF))
            name = near[this]
            if edge:
                edge = near[this - 1] != name or near[this + 1] != name
                edge = edge or near[this - w - 2] != name or near[this + w + 2] != name
            if edge:
                code = marked & 0xFFFFFF
                total = ti.Vector([0, 0, 0])
                for q in range(4):
                    best, shown, past = -1.0, code, -2
                    for n in range(5):
                        there = this + ti.select(n == 1, -1, ti.select(n == 2, 1, 0))
                        there += ti.select(n == 3, -w - 2, ti.select(n == 4, w + 2, 0))
                        other, z = near[there], 0.0
                        if (n == 0 or other != name) and other != past:
                            past = other
                            # What lies behind what is there already need not be looked at.
                            if other >= 0 and (best <= 0.0 or _real(near[there - names]) > best):
                                z = _depth(
                                    kinds, other, i + 0.25 + 0.5 * (q & 1),
                                    j + 0.25 + 0.5 * (q >> 1), layer, corner, beside, line, number,
                                    vertex, globe,
                                )  # fmt: skip
                            if z > best and (z > 0.0 or other < 0):
                                color = near[names + there]
                                if color >= 0:  # else it is beyond the room
                                    best, shown = z, color & 0xFFFFFF
                    total += ti.Vector([(shown >> 16) & 255, (shown >> 8) & 255, shown & 255])
                total = (total + 2) >> 2
                code = (total[0] << 16) | (total[1] << 8) | total[2]
                if count[STANDS] == 0:
                    out[to + i] = code
                else:
                    under[(3 * h + j) * w + i] = code


@kernel
def see(
    kinds: ti.template(),
    x: rows,
    normal: rows,
    side: image,
    corner: image,
    ball: image,
    line: image,
    number: numbers,
    count: row,
    vertex: row,
    globe: numbers,
    box: image,
):
    """Compute what is seen of vertices, and where things are; the module says what these are.

    kinds: which there are of triangles, balls, lines. side: (n, 2), colours of the vertices' fronts
    and backs. number, count: as `rasterizer.py` fills them in.
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


@kernel
def draw(
    kinds: ti.template(),
    layer: ti.i32,
    corner: image,
    beside: image,
    ball: image,
    line: image,
    number: numbers,
    count: row,
    vertex: row,
    plane: numbers,
    globe: numbers,
    box: image,
    near: row,
    under: row,
    dark: rows,
    out: row,
):
    """Draw the things of a layer, which were seen, into a room of a picture `out` (h * w,).

    under: (4, h, w) in a row, one over the depth, as bits, of what lies behind all, and its
    colours; then both of that with what stands still before it. Where that is drawn, this half is
    filled in, and not `out`. near: (3, h + 2, w + 2) in a row: depth, name and colour of what is
    seen, with a rim; -1 where nothing is. Then the columns of each row of each tile that have
    something, from and to.
    """
    if ti.static(ti.cfg.arch == ti.cpu):
        # Threads take one tile after another.
        for worker in range(count[WORKERS] * PIECE):
            if worker % PIECE == 0:
                tile = ti.atomic_add(count[NEXT], 1)
                while tile < count[TILE + 3]:
                    _tile(
                        kinds, tile, layer, corner, ball, line, number, count, vertex, plane,
                        globe, box, near, under, dark, out,
                    )  # fmt: skip
                    tile = ti.atomic_add(count[NEXT], 1)
        for worker in range(count[WORKERS] * PIECE):
            if worker % PIECE == 0:
                tile = ti.atomic_add(count[NEXT + 1], 1)
                while tile < count[TILE + 3]:
                    _smooth(
                        kinds, tile, layer, corner, beside, line, number, count, vertex, globe, box,
                        near, under, out,
                    )  # fmt: skip
                    tile = ti.atomic_add(count[NEXT + 1], 1)
    else:
        ti.loop_config(block_dim=8)
        for tile in range(count[TILE + 3]):
            _tile(
                kinds, tile, layer, corner, ball, line, number, count, vertex, plane, globe, box,
                near, under, dark, out,
            )  # fmt: skip
        ti.loop_config(block_dim=8)
        for tile in range(count[TILE + 3]):
            _smooth(
                kinds, tile, layer, corner, beside, line, number, count, vertex, globe, box, near,
                under, out,
            )  # fmt: skip


@ti.func
def _lay_row(j, w, h, background, floor: ti.template(), lens: ti.template(), under: ti.template()):
    """Fill in a row of what lies behind everything, as `lay` does."""
    none = _rgb(background)
    for i in range(w):
        under[j * w + i], under[(h + j) * w + i] = 0, background
    if floor.shape[0] > 0:
        above, normal = floor[0], -1.0 * _three(floor, 1)
        along, across = _three(floor, 4), _three(floor, 7)
        by_side, by_reach2, by_lens = 1.0 / floor[14], 1.0 / (floor[15] * floor[15]), 1.0 / lens[0]
        one, other = _three(floor, 16), _three(floor, 19)
        for i in range(w):
            total, seen, depth = ti.Vector([0.0] * 3), 0, 0.0
            for q in ti.static(range(4)):
                way = ti.Vector(
                    [
                        (i + (0.25 + 0.5 * (q % 2)) - lens[1]) * by_lens,
                        (j + (0.25 + 0.5 * (q // 2)) - lens[2]) * by_lens,
                        1.0,
                    ]
                )
                rgb, deep = none, normal.dot(way) / above
                if deep > 0.0:
                    z = 1.0 / deep
                    a, b = z * along.dot(way) + floor[10], z * across.dot(way) + floor[11]
                    away2 = (a - floor[12]) * (a - floor[12]) + (b - floor[13]) * (b - floor[13])
                    share = ti.min(1.25 * (1.0 - away2 * by_reach2), 1.0)
                    if share > 0.0:
                        odd = (
                            ti.cast(ti.floor(a * by_side), ti.i32)
                            + ti.cast(ti.floor(b * by_side), ti.i32)
                        ) & 1
                        rgb = none + share * (ti.select(odd == 1, other, one) - none)
                        seen += 1
                        if share > 0.5:
                            depth = ti.max(depth, deep)
                total += rgb
            if seen > 0:
                code = _packed(0.25 * total, 256)
                if seen == 4:
                    code = code | FLOOR
                under[j * w + i], under[(h + j) * w + i] = _bits(depth), code


@kernel
def lay(
    background: ti.i32,
    floor: numbers,
    lens: numbers,
    w: ti.i32,
    h: ti.i32,
    iterations: ti.i32,
    under: row,
):
    """Fill in what lies behind everything: a floor of tiles that fades out, or one colour.

    lens: (3,), pixels per unit of slope, the pixel (x, y) looked at. floor: () for none, else
    (22,): how far the eye is above it; its unit normal and its two axes; where the eye is along
    these, and where the middle of what is looked at; the side of a tile, and the distance from the
    middle at which the floor ends; then the colours of both kinds of tile. iterations: h * ROWS.
    """
    for j in range(iterations):
        if j % ROWS == 0:
            _lay_row(j // ROWS, w, h, background, floor, lens, under)
