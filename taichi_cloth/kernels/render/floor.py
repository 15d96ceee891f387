"""A floor of tiles behind everything, and the shade on it."""

import taichi as ti

from taichi_cloth.front_end.mending import kernel
from taichi_cloth.kernels.render.frame import (
    FLOOR,
    SHADE,
    WIDTH,
    ZERO,
    bits,
    numbers,
    packed,
    rgb_of,
    row,
    three,
)

LIT = 1 << 16  # all the light that a floor has
STRIDE = 8  # pixels between two places where the floor's shade is looked up
ROWS = 8  # iterations for one row of a floor: else a thread had 512 rows of them


@ti.func
def _between(dark: ti.template(), u, v):
    """Interpolate numbers at the corners of a grid's cells, (k, k); 0 beyond it."""
    found, most = 0.0, dark.shape[0] - 1.0
    if u >= 0.0 and v >= 0.0 and u < most and v < most:
        i, j = ti.cast(u, ti.i32), ti.cast(v, ti.i32)
        a, b = u - i, v - j
        found = (1.0 - b) * ((1.0 - a) * dark[i, j] + a * dark[i + 1, j])
        found += b * ((1.0 - a) * dark[i, j + 1] + a * dark[i + 1, j + 1])
    return found


@ti.func
def _floor_light(number: ti.template(), dark: ti.template(), i, j):
    """The floor's light in a pixel (i, j) of `LIT`, by a homography to the cells."""
    w = number[SHADE + 6] * i + number[SHADE + 7] * j + number[SHADE + 8]
    lit = 1.0
    if w > 0.0:
        u = (number[SHADE] * i + number[SHADE + 1] * j + number[SHADE + 2]) / w
        v = (number[SHADE + 3] * i + number[SHADE + 4] * j + number[SHADE + 5]) / w
        lit -= _between(dark, u, v)
    return ti.cast(lit * LIT, ti.i32)


@ti.func
def behind(
    first, last, j0, j1, is_dark, to, back, w, number: ti.template(), count: ti.template(),
    dark: ti.template(), under: ti.template(), out: ti.template(),
):  # fmt: skip
    """Write what lies behind everything in pixels from (first, j0) to before (last, j1).

    is_dark: whether the floor is shaded there. to, back: where row 0 begins in `out`, and its
    colours in `under`. w: the room's.
    """
    left0, top0 = first & -STRIDE, j0 & -STRIDE  # the same squares, whatever is written
    for square_row in range((j1 - top0 + STRIDE - 1) // STRIDE):
        top = top0 + square_row * STRIDE
        right_upper, right_lower = LIT, LIT
        for square in range(-1, (last - left0 + STRIDE - 1) // STRIDE):
            # Light is known at a square's corners, and linear between them.
            left, upper, lower = left0 + square * STRIDE, right_upper, right_lower
            if is_dark:
                right_upper = _floor_light(number, dark, left + STRIDE, top)
                right_lower = _floor_light(number, dark, left + STRIDE, top + STRIDE)
            begin, end = ti.max(left, first), ti.min(left + STRIDE, last)
            for j in range(ti.max(top, j0), ti.select(square < 0, top, ti.min(top + STRIDE, j1))):
                light = upper + (j - top) * ((lower - upper) // STRIDE)
                light_x = right_upper + (j - top) * ((right_lower - right_upper) // STRIDE) - light
                light_x = light_x // STRIDE
                light += (begin - left) * light_x
                i = begin
                while i < end:
                    code, share = under[back + j * w + i], light >> 8
                    ends = ((code & 0xFF00FF) * share + 0x800080) >> 8
                    middle = ((code & 0x00FF00) * share + 0x008000) >> 8
                    shaded = (ends & 0xFF00FF) | (middle & 0x00FF00)
                    out[to + j * count[WIDTH] + i] = ti.select(code >= FLOOR, shaded, code)
                    light += light_x
                    i += 1 + count[ZERO]


@ti.func
def _tiled(i, j, none, zero, floor: ti.template(), lens: ti.template()):
    """The colour of a floor in a pixel, and one over its depth; no bit `FLOOR` where it is not all.

    It is the mean of four samples. none: the background's channels. zero: as `frame.ZERO` is.
    """
    above, normal = floor[0], -1.0 * three(floor, 1)
    along, across = three(floor, 4), three(floor, 7)
    total, seen, depth = ti.Vector([0.0] * 3), 0, 0.0
    for q in range(4 + zero):
        x, y = i + 0.25 + 0.5 * (q & 1) - lens[1], j + 0.25 + 0.5 * (q >> 1) - lens[2]
        way = ti.Vector([x / lens[0], y / lens[0], 1.0])
        rgb, deep = none, normal.dot(way) / above
        if deep > 0.0:
            a, b = along.dot(way) / deep + floor[10], across.dot(way) / deep + floor[11]
            away2 = (a - floor[12]) ** 2 + (b - floor[13]) ** 2
            share = ti.min(1.25 * (1.0 - away2 / floor[15] ** 2), 1.0)
            if share > 0.0:
                column = ti.cast(ti.floor(a / floor[14]), ti.i32)
                odd = (column + ti.cast(ti.floor(b / floor[14]), ti.i32)) & 1
                rgb = none + share * (three(floor, 16 + 3 * odd) - none)
                seen += 1
                if share > 0.5:
                    depth = ti.max(depth, deep)
        total += rgb
    return packed(0.25 * total, 256) | ti.select(seen == 4, FLOOR, 0), depth


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

    lens: (4,), pixels per unit of slope, the pixel (x, y) looked at, and 0, as `frame.ZERO` is.
    floor: () for none, else (22,): how far the eye is above it; its unit normal and its two axes;
    where the eye is along these, and where the middle of what is looked at; the side of a tile, and
    the distance from the middle at which the floor ends; then the colours of both kinds of tile.
    iterations: h * ROWS.
    """
    for iteration in range(iterations):
        if iteration % ROWS == 0:
            j, none, zero = iteration // ROWS, rgb_of(background), ti.cast(lens[3], ti.i32)
            i = 0
            while i < w:
                code, depth = background, 0.0
                if floor.shape[0] > 0:
                    code, depth = _tiled(i, j, none, zero, floor, lens)
                under[j * w + i], under[(h + j) * w + i] = bits(depth), code
                i += 1 + ti.cast(lens[3], ti.i32)
