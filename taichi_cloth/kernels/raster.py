"""Triangles, balls and lines as pixels: a rasterizer with a depth buffer.

Each is drawn twice. `stage` 0 keeps the least depth of each pixel, `stage` 1 the colour of what has
that depth, of several the largest. Both are minima and maxima over all that cover a pixel, which
have no order: the picture has the same bits however many threads draw it (integers of 32 bits,
which all backends can compare atomically; positive floats are ordered as their bits are).

Places are in the camera's axes: x right, y down, z away from the eye, which is their origin. A lens
(4,) is pixels per unit of slope, the pixel (x right, y down) at which the camera looks, the least
depth that is drawn. Pictures (h, w) have a row at a time from the top down. Colours are floats
0..1; in the picture they are 0xRRGGBB, and c of what lies behind everything is -1 - c, so that
whatever is drawn is larger; that of the floor, which is shaded last, has one more bit. Lights
(k + 1, 4): unit direction to each light and its strength; in the last row the ambient one's.

`touched` marks the tiles of `TILE` pixels in which something may have been drawn: only these are
taken from the pixels drawn, and emptied again; all others are what lies behind everything.
"""

import taichi as ti

from taichi_cloth.front_end.mending import kernel

FARTHEST = 0x7F000000  # the bits of a depth that nothing has
SAME_DEPTH = 1.0 + 4e-6  # both stages compute a depth, which compilers may round in two ways
TILE = (16, 64)  # rows and columns of a tile, in the pixels that are drawn
OF_FLOOR = 0x1000000  # a bit of the colours of what lies behind everything: it is the floor's
EDGE = -1e-5  # so far outside a triangle, in its own heights, pixels still belong to it

image = ti.types.ndarray(dtype=ti.i32, ndim=2)
rows = ti.types.ndarray(dtype=ti.f32, ndim=2)
numbers = ti.types.ndarray(dtype=ti.f32, ndim=1)
spans = ti.types.ndarray(dtype=ti.i32, ndim=1)
indices = ti.types.ndarray(dtype=ti.i32, ndim=2)


@ti.func
def _vector(a: ti.template(), i):
    return ti.Vector([a[i, 0], a[i, 1], a[i, 2]])


@ti.func
def _pixel(lens: ti.template(), place):
    """The pixel (x right, y down) of a place, and one over its depth."""
    slope = lens[0] / place[2]
    return ti.Vector([lens[1] + slope * place[0], lens[2] + slope * place[1], 1.0 / place[2]])


@ti.func
def _first(pixel, count):
    """The first of `count` pixels whose middle lies at `pixel` or after it."""
    return ti.cast(ti.ceil(ti.min(ti.max(pixel - 0.5, 0.0), count + 0.0)), ti.i32)


@ti.func
def _beyond(pixel, count):
    """The first of `count` pixels whose middle lies after `pixel`."""
    return ti.cast(ti.floor(ti.min(ti.max(pixel + 0.5, 0.0), count + 0.0)), ti.i32)


@ti.func
def _packed(rgb):
    code = ti.cast(0, ti.i32)
    for k in ti.static(range(3)):
        code = code * 256 + ti.cast(ti.min(ti.max(rgb[k], 0.0), 1.0) * 255.0 + 0.5, ti.i32)
    return code


@ti.func
def _lit(rgb, normal, lights: ti.template()):
    """A colour under all lights, by Lambert's law; normal: of any length."""
    last = lights.shape[0] - 1
    bright = lights[last, 3]
    n = normal / ti.max(normal.norm(), 1e-20)
    for k in range(last):
        light = _vector(lights, k)
        bright += lights[k, 3] * ti.max(n.dot(light), 0.0)
    return bright * rgb


@ti.func
def _depth_bits(z):
    return ti.bit_cast(ti.cast(z, ti.f32), ti.i32)


@ti.func
def _keep_least(depth: ti.template(), j, i, z):
    """Keep a pixel's least depth; what is not less costs no atomic operation."""
    bits = _depth_bits(z)
    if bits < depth[j, i]:
        ti.atomic_min(depth[j, i], bits)


@ti.func
def _row(along, at):
    """From where to where along a row the three shares `along` * x + `at` are at least `EDGE`."""
    low, high = -1e9, 1e9
    for k in ti.static(range(3)):
        if along[k] > 1e-12:
            low = ti.max(low, (EDGE - at[k]) / along[k])
        elif along[k] < -1e-12:
            high = ti.min(high, (EDGE - at[k]) / along[k])
    return low, high


@ti.func
def _is_seen(depth: ti.template(), j, i, z):
    return z <= ti.bit_cast(depth[j, i], ti.f32) * SAME_DEPTH


@ti.func
def _touch(touched: ti.template(), j0, j1, i0, i1):
    """Mark the tiles of the rows from j0 to before j1 in the columns from i0 to before i1."""
    if j0 < j1 and i0 < i1:
        for tile_j in range(j0 // TILE[0], (j1 - 1) // TILE[0] + 1):
            for tile_i in range(i0 // TILE[1], (i1 - 1) // TILE[1] + 1):
                touched[tile_j, tile_i] = 1


@ti.func
def _sight(lens: ti.template(), j, i):
    """The way (3,) from the eye through a pixel's middle, as long as it is deep 1."""
    return ti.Vector([(i + 0.5 - lens[1]) / lens[0], (j + 0.5 - lens[2]) / lens[0], 1.0])


@kernel
def triangles(
    stage: ti.template(),
    depth: image,
    color: image,
    touched: image,
    place: rows,
    normal: rows,
    corner: indices,
    front: rows,
    back: rows,
    lens: numbers,
    lights: rows,
):
    """Draw triangles (m, 3) of the vertices (n, 3), which have normals (n, 3).

    front, back: (n, 3) colours of the vertices, seen from the side that their normals look to
    (counterclockwise), and from the other one.
    """
    for t in range(corner.shape[0]):
        p, q, r = corner[t, 0], corner[t, 1], corner[t, 2]
        a, b, c = _vector(place, p), _vector(place, q), _vector(place, r)
        if ti.min(a[2], b[2], c[2]) > lens[3]:
            u, v, w = _pixel(lens, a), _pixel(lens, b), _pixel(lens, c)
            area = (v[0] - u[0]) * (w[1] - u[1]) - (v[1] - u[1]) * (w[0] - u[0])
            if area != 0.0:
                i0 = _first(ti.min(u[0], v[0], w[0]), depth.shape[1])
                i1 = _beyond(ti.max(u[0], v[0], w[0]), depth.shape[1])
                j0 = _first(ti.min(u[1], v[1], w[1]), depth.shape[0])
                j1 = _beyond(ti.max(u[1], v[1], w[1]), depth.shape[0])
                if ti.static(stage == 0):
                    _touch(touched, j0, j1, i0, i1)
                # The shares of the second and the third corner grow by so much from pixel to pixel.
                by_area = 1.0 / area
                second_x, second_y = (w[1] - u[1]) * by_area, (u[0] - w[0]) * by_area
                third_x, third_y = (u[1] - v[1]) * by_area, (v[0] - u[0]) * by_area
                for j in range(j0, j1):
                    y = j + 0.5 - u[1]
                    low, high = _row(
                        ti.Vector([-second_x - third_x, second_x, third_x]),
                        ti.Vector([1.0 - (second_y + third_y) * y, second_y * y, third_y * y]),
                    )
                    first_i = ti.max(i0, _first(u[0] + low - 0.01, depth.shape[1]))
                    for i in range(
                        first_i, ti.min(i1, _beyond(u[0] + high + 0.01, depth.shape[1]))
                    ):
                        x = i + 0.5 - u[0]
                        second, third = second_x * x + second_y * y, third_x * x + third_y * y
                        first = 1.0 - second - third
                        if ti.min(first, second, third) >= EDGE:
                            # One over the depth is linear on the screen.
                            z = 1.0 / (first * u[2] + second * v[2] + third * w[2])
                            if ti.static(stage == 0):
                                _keep_least(depth, j, i, z)
                            elif _is_seen(depth, j, i, z):
                                f, s, t3 = first * u[2], second * v[2], third * w[2]
                                n = (
                                    f * _vector(normal, p)
                                    + s * _vector(normal, q)
                                    + t3 * _vector(normal, r)
                                )
                                rgb = ti.Vector([0.0, 0.0, 0.0])
                                if area < 0.0:  # as y points down
                                    rgb = (
                                        f * _vector(front, p)
                                        + s * _vector(front, q)
                                        + t3 * _vector(front, r)
                                    )
                                else:
                                    n = -1.0 * n
                                    rgb = (
                                        f * _vector(back, p)
                                        + s * _vector(back, q)
                                        + t3 * _vector(back, r)
                                    )
                                code = _packed(_lit(z * rgb, n, lights))
                                ti.atomic_max(color[j, i], code)


@kernel
def balls(
    stage: ti.template(),
    depth: image,
    color: image,
    touched: image,
    centre: rows,
    radius: numbers,
    rgb: rows,
    lens: numbers,
    lights: rows,
):
    """Draw spheres: centre (k, 3), radius (k,), colour (k, 3)."""
    for s in range(centre.shape[0]):
        c = _vector(centre, s)
        if c[2] > lens[3]:
            least = 0.8 * c[2] / lens[0]  # of which one sees something
            r = ti.max(radius[s], least)
            u = _pixel(lens, c)
            slope = (c[0] * c[0] + c[1] * c[1]) / (c[2] * c[2])
            reach = lens[0] * r / ti.max(c[2] - r, lens[3]) * (1.0 + slope) + 1.0
            i0, i1 = _first(u[0] - reach, depth.shape[1]), _beyond(u[0] + reach, depth.shape[1])
            j0, j1 = _first(u[1] - reach, depth.shape[0]), _beyond(u[1] + reach, depth.shape[0])
            if ti.static(stage == 0):
                _touch(touched, j0, j1, i0, i1)
            for j in range(j0, j1):
                for i in range(i0, i1):
                    d = _sight(lens, j, i)
                    size2 = d.dot(d)
                    nearest = d.dot(c) / size2  # where the line of sight is nearest to the middle
                    away = nearest * d - c
                    inside = r * r - away.dot(away)
                    if inside >= 0.0:
                        z = nearest - ti.sqrt(inside / size2)
                        if z > lens[3]:
                            if ti.static(stage == 0):
                                _keep_least(depth, j, i, z)
                            elif _is_seen(depth, j, i, z):
                                own = _lit(_vector(rgb, s), z * d - c, lights)
                                ti.atomic_max(color[j, i], _packed(own))


@kernel
def lines(
    stage: ti.template(),
    depth: image,
    color: image,
    touched: image,
    end: rows,
    rgb: rows,
    width: numbers,
    lens: numbers,
    lift: ti.f32,
):
    """Draw lines from place 2 k of `end` (2 l, 3) to the next, of colour (l, 3) and width [pixels].

    lift: by this share of the way to the eye they are seen before where they are.
    """
    for s in range(rgb.shape[0]):
        a, b = _vector(end, 2 * s), _vector(end, 2 * s + 1)
        if ti.min(a[2], b[2]) > lens[3]:
            u, v = _pixel(lens, a), _pixel(lens, b)
            half = 0.5 * width[s]
            x, y = v[0] - u[0], v[1] - u[1]
            size2 = ti.max(x * x + y * y, 1e-12)
            j0 = _first(ti.min(u[1], v[1]) - half, depth.shape[0])
            j1 = _beyond(ti.max(u[1], v[1]) + half, depth.shape[0])
            for j in range(j0, j1):
                # Only this part of the line, from one share of it to another, is so near the row.
                from_y = j + 0.5 - u[1]
                part0, part1 = 0.0, 1.0
                if ti.abs(y) > 1e-3:
                    one, other = (from_y - half) / y, (from_y + half) / y
                    part0 = ti.min(ti.max(ti.min(one, other), 0.0), 1.0)
                    part1 = ti.min(ti.max(ti.max(one, other), 0.0), 1.0)
                x0, x1 = u[0] + part0 * x, u[0] + part1 * x
                i0 = _first(ti.min(x0, x1) - half, depth.shape[1])
                i1 = _beyond(ti.max(x0, x1) + half, depth.shape[1])
                if ti.static(stage == 0):
                    _touch(touched, j, j + 1, i0, i1)
                for i in range(i0, i1):
                    from_x = i + 0.5 - u[0]
                    part = ti.min(ti.max((from_x * x + from_y * y) / size2, 0.0), 1.0)
                    off_x, off_y = from_x - part * x, from_y - part * y
                    if off_x * off_x + off_y * off_y <= half * half:
                        z = (1.0 - lift) / (u[2] + part * (v[2] - u[2]))
                        if ti.static(stage == 0):
                            _keep_least(depth, j, i, z)
                        elif _is_seen(depth, j, i, z):
                            ti.atomic_max(color[j, i], _packed(_vector(rgb, s)))


@kernel
def lay_floor(depth: image, color: image, lens: numbers, background: numbers, floor: numbers):
    """Fill a picture with what lies behind everything: a floor of tiles that fades out, or none.

    background: (3,). floor: () for none, else (22,): how far the eye is above the floor; the unit
    normal of the floor and its two axes; where the eye is along these, and where the middle of what
    is looked at; the side of a tile, and the distance from the middle at which the floor ends; then
    the colours of both kinds of tile.
    """
    none = ti.Vector([background[0], background[1], background[2]])
    empty = -1 - _packed(none)
    for j in range(depth.shape[0]):
        for i in range(depth.shape[1]):
            depth[j, i], color[j, i] = FARTHEST, empty
        if floor.shape[0] > 0:
            above, start = floor[0], _sight(lens, j, 0)
            normal = -1.0 * ti.Vector([floor[1], floor[2], floor[3]])
            along = ti.Vector([floor[4], floor[5], floor[6]])
            across = ti.Vector([floor[7], floor[8], floor[9]])
            # Of the way of sight from pixel to pixel: how much it goes down, along, and across.
            down0, along0, across0 = normal.dot(start), along.dot(start), across.dot(start)
            down1, along1, across1 = normal[0] / lens[0], along[0] / lens[0], across[0] / lens[0]
            eye_x, eye_y, x0, y0 = floor[10], floor[11], floor[12], floor[13]
            by_side, by_reach2 = 1.0 / floor[14], 1.0 / (floor[15] * floor[15])
            one = ti.Vector([floor[16], floor[17], floor[18]])
            other = ti.Vector([floor[19], floor[20], floor[21]])
            for i in range(depth.shape[1]):
                down = down0 + i * down1
                if down * above > 0.0:
                    z = above / down
                    x = z * (along0 + i * along1) + eye_x
                    y = z * (across0 + i * across1) + eye_y
                    away2 = (x - x0) * (x - x0) + (y - y0) * (y - y0)
                    share = ti.min(1.25 * (1.0 - away2 * by_reach2), 1.0)
                    if share > 0.0:
                        u, v = ti.floor(x * by_side), ti.floor(y * by_side)
                        odd = (ti.cast(u, ti.i32) + ti.cast(v, ti.i32)) & 1
                        tile = ti.select(odd == 1, other, one)
                        rgb = _packed(none + share * (tile - none))
                        color[j, i] = -1 - (rgb | ti.static(OF_FLOOR))
                        if share > 0.5:
                            depth[j, i] = _depth_bits(z)


@kernel
def set_back(color: image, touched: image, under: image):
    """Have what is drawn so far lie behind what comes: take its colours (h, w) into `under`, and
    let whatever is drawn next be larger.

    Only tiles that are touched by then: of what comes, stage 0 has to be done.
    """
    for tile in range(touched.shape[0] * touched.shape[1]):
        tile_j, tile_i = tile // touched.shape[1], tile % touched.shape[1]
        if touched[tile_j, tile_i] != 0:
            j0, i0 = tile_j * TILE[0], tile_i * TILE[1]
            for j in range(j0, ti.min(j0 + TILE[0], color.shape[0])):
                for i in range(i0, ti.min(i0 + TILE[1], color.shape[1])):
                    code = ti.min(color[j, i], -1 - color[j, i])
                    color[j, i], under[j, i] = code, code


@kernel
def see_through(color: image, touched: image, under: image):
    """Make what was drawn since `set_back` half transparent."""
    for tile in range(touched.shape[0] * touched.shape[1]):
        tile_j, tile_i = tile // touched.shape[1], tile % touched.shape[1]
        if touched[tile_j, tile_i] != 0:
            j0, i0 = tile_j * TILE[0], tile_i * TILE[1]
            for j in range(j0, ti.min(j0 + TILE[0], color.shape[0])):
                for i in range(i0, ti.min(i0 + TILE[1], color.shape[1])):
                    over, below = color[j, i], -1 - under[j, i]
                    if over >= 0:  # half of each of the three bytes, rounded down
                        color[j, i] = ((over >> 1) & 0x7F7F7F) + ((below >> 1) & 0x7F7F7F)


@ti.func
def _between(values: ti.template(), u, v):
    """What is given at the corners of a grid's cells, (k, k), at a place between; 0 beyond it."""
    found, most = 0.0, values.shape[0] - 1.0
    if u >= 0.0 and v >= 0.0 and u < most and v < most:
        i, j = ti.cast(u, ti.i32), ti.cast(v, ti.i32)
        a, b = u - i, v - j
        found = (1.0 - b) * ((1.0 - a) * values[i, j] + a * values[i + 1, j])
        found += b * ((1.0 - a) * values[i, j + 1] + a * values[i + 1, j + 1])
    return found


@ti.func
def _lit_at(to_cells: ti.template(), dark: ti.template(), j, i):
    """The part of its light that the floor has in the pixel (j, i) of a picture: see `resolve`."""
    w = to_cells[6] * i + to_cells[7] * j + to_cells[8]
    lit = 1.0
    if w > 0.0:
        u = (to_cells[0] * i + to_cells[1] * j + to_cells[2]) / w
        v = (to_cells[3] * i + to_cells[4] * j + to_cells[5]) / w
        lit -= _between(dark, u, v)
    return lit


@ti.func
def _mean(samples: ti.template(), color: ti.template(), j, i, lit):
    """The mean colour 0xRRGGBB of samples x samples pixels, the pixel (j, i) of a picture.

    lit: the part of its light that the floor has there.
    """
    total = ti.Vector([0.0, 0.0, 0.0])
    for p in ti.static(range(samples)):
        for q in ti.static(range(samples)):
            code = color[j * samples + p, i * samples + q]
            code = ti.max(code, -1 - code)
            part = ti.select((code & ti.static(OF_FLOOR)) != 0, lit, 1.0)
            total += part * ti.Vector([(code >> 16) & 255, (code >> 8) & 255, code & 255])
    mean = ti.cast(total / ti.static(samples * samples) + 0.5, ti.i32)
    return (mean[0] << 16) | (mean[1] << 8) | mean[2]


@ti.func
def _is_of_floor(samples: ti.template(), color: ti.template(), j, i):
    """Whether all of the pixel (j, i) of a picture is the floor's."""
    found = 0 + ti.static(OF_FLOOR)
    for p in ti.static(range(samples)):
        for q in ti.static(range(samples)):
            found = found & ti.max(-1 - color[j * samples + p, i * samples + q], 0)
    return found != 0


@ti.func
def _darker(code, lit):
    """A colour, with or without the floor's bit, that has a part of its light."""
    part = ti.Vector([(code >> 16) & 255, (code >> 8) & 255, code & 255])
    rgb = ti.cast(lit * part + 0.5, ti.i32)
    return (rgb[0] << 16) | (rgb[1] << 8) | rgb[2]


@ti.func
def _resolved(samples: ti.template(), color: ti.template(), j, i, lit):
    """The colour of a pixel; of the floor's alone it is rounded before it gets darker, as where
    the floor is kept (`resolve`).
    """
    code = 0
    if lit < 1.0 and _is_of_floor(samples, color, j, i):
        code = _darker(_mean(samples, color, j, i, 1.0), lit)
    else:
        code = _mean(samples, color, j, i, lit)
    return code


@kernel
def lay(
    samples: ti.template(),
    depth: image,
    color: image,
    touched: image,
    behind: image,
    colored: image,
    laid: image,
):
    """Take what is drawn now as what lies behind everything: its depths, its colours.

    laid: (h, w), the picture of it; with one more bit where all of a pixel is the floor's.
    """
    for tile_j, tile_i in touched:
        touched[tile_j, tile_i] = 0
    for j in range(depth.shape[0]):
        for i in range(depth.shape[1]):
            code = ti.min(color[j, i], -1 - color[j, i])
            behind[j, i], colored[j, i] = depth[j, i], code
            color[j, i] = code
    for j in range(laid.shape[0]):
        for i in range(laid.shape[1]):
            laid[j, i] = _mean(samples, colored, j, i, 1.0)
            if _is_of_floor(samples, colored, j, i):
                laid[j, i] = laid[j, i] | ti.static(OF_FLOOR)


@kernel
def resolve(
    samples: ti.template(),
    depth: image,
    color: image,
    touched: image,
    behind: image,
    colored: image,
    laid: image,
    out: image,
    homography: numbers,
    dark: rows,
    room: spans,
):
    """Compute the picture `out` (h, w), each pixel the mean of samples x samples.

    What was drawn is gone then; what lies behind everything is as `lay` took it.

    dark: (k, k), the part of its light that the floor lacks at the corners of the cells of a shade.
    homography: (9,), by rows, takes (column, row, 1) of a pixel to w times its place there, in
    cells, and w, which is positive before us. room: (4,), the rows and columns of the picture, from
    and to, in which that is looked at; other pixels of the floor have all of their light.
    """
    tall, wide = ti.static(TILE[0] // samples), ti.static(TILE[1] // samples)
    h, w, across = out.shape[0], out.shape[1], touched.shape[1]
    for tile in range(touched.shape[0] * across):
        to_cells = ti.Vector([homography[k] for k in range(9)])
        tile_j, tile_i = tile // across, tile % across
        j0, i0 = tile_j * tall, tile_i * wide
        j1, i1 = ti.min(j0 + tall, h), ti.min(i0 + wide, w)
        if touched[tile_j, tile_i] == 0:
            for j in range(j0, j1):
                for i in range(i0, i1):
                    out[j, i] = laid[j, i] & 0xFFFFFF
            for j in range(ti.max(j0, room[0]), ti.min(j1, room[1])):
                for i in range(ti.max(i0, room[2]), ti.min(i1, room[3])):
                    lit = _lit_at(to_cells, dark, j, i)
                    if lit < 1.0 and laid[j, i] >= ti.static(OF_FLOOR):
                        out[j, i] = _darker(laid[j, i], lit)
                    elif lit < 1.0:
                        out[j, i] = _resolved(samples, colored, j, i, lit)
        else:
            touched[tile_j, tile_i] = 0
            for j in range(j0, j1):
                for i in range(i0, i1):
                    lit = 1.0
                    if j >= room[0] and j < room[1] and i >= room[2] and i < room[3]:
                        lit = _lit_at(to_cells, dark, j, i)
                    out[j, i] = _resolved(samples, color, j, i, lit)
            for j in range(j0 * samples, j1 * samples):
                for i in range(i0 * samples, i1 * samples):
                    depth[j, i] = behind[j, i]
                    color[j, i] = colored[j, i]
