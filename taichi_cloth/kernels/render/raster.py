"""A picture of triangles, balls and lines in space, with depth: a rasterizer in tiles.

`see` (`sight.py`) computes where things are seen and how they are lit. `draw` then finds the
nearest thing in the middle of each pixel, and its colour. One thread draws a whole tile, and passes
over what may touch it in a fixed order. Where neighbours then differ, one sees an edge, which is
smoothed. So a picture has the same bits for every number of threads. Pixels in which nothing
changed are left alone. `frame.py` says what the arrays are.
"""

import taichi as ti

from taichi_cloth.front_end.mending import kernel
from taichi_cloth.kernels.loops import PIECE
from taichi_cloth.kernels.render.edges import is_edge, smoothed
from taichi_cloth.kernels.render.fill import fill
from taichi_cloth.kernels.render.floor import behind
from taichi_cloth.kernels.render.frame import (
    ABSENT,
    AGAIN,
    CHUNKS,
    COUNTS,
    FRESH,
    LAYERS,
    NEXT,
    ROOM,
    STANDS,
    TILE,
    WIDTH,
    WORKERS,
    ZERO,
    image,
    numbers,
    row,
    rows,
)


@ti.func
def _half(a, b):
    """The mean of two colours."""
    return ((a >> 1) & 0x7F7F7F) + ((b >> 1) & 0x7F7F7F) + (a & b & 0x010101)


@ti.func
def _tile(
    kinds: ti.template(), tile, layer, corner: ti.template(), ball: ti.template(),
    line: ti.template(), number: ti.template(), count: ti.template(), vertex: ti.template(),
    globe: ti.template(), box: ti.template(), near: ti.template(), under: ti.template(),
    dark: ti.template(), out: ti.template(),
):  # fmt: skip
    """Find what is seen in a tile."""
    w, h, tiles = count[ROOM + 2], count[ROOM + 3], count[TILE + 3]
    names = (w + 2) * (h + 2)
    row = tile // count[TILE + 2]
    j0, i0 = row * count[TILE], (tile - row * count[TILE + 2]) * count[TILE + 1]
    j1, i1 = ti.min(j0 + count[TILE], h), ti.min(i0 + count[TILE + 1], w)
    low, high = i1, i0  # the columns in which anything may be drawn
    for c in range(count[CHUNKS]):
        k = LAYERS * tiles + c
        if box[k, 2] < j1 and box[k, 3] > j0:
            low, high = ti.min(low, ti.max(box[k, 0], i0)), ti.max(high, ti.min(box[k, 1], i1))
        if count[ZERO] != 0:
            break
    high = ti.max(low, high)
    # The columns that are written: also where something was drawn before, or the floor is shaded.
    first, last = low, high
    dark_row = count[COUNTS + 2 * row] < i1 and count[COUNTS + 2 * row + 1] > i0 and layer == 0
    if dark_row:
        first = ti.min(first, ti.max(count[COUNTS + 2 * row], i0))
        last = ti.max(last, ti.min(count[COUNTS + 2 * row + 1], i1))
    at, veiled = layer * tiles + tile, tiles + tile
    before = ti.Vector([box[at, 0], box[at, 1], box[at, 2], box[at, 3]])
    box[at, 0], box[at, 1], box[at, 2], box[at, 3] = first, last, low, high
    begin, end = low, high  # the columns that have nothing, until things are put into them
    if layer == 0:
        first = ti.min(first, before[0], box[veiled, 0])
        last = ti.max(last, before[1], box[veiled, 1])
        begin = ti.min(begin, before[2], box[veiled, 0])
        end = ti.max(end, before[3], box[veiled, 1])
        box[veiled, 0], box[veiled, 1] = ABSENT, -ABSENT
        if count[AGAIN + 2] < j1 and count[AGAIN + 3] > j0:
            first = ti.min(first, ti.max(count[AGAIN], i0))
            last = ti.max(last, ti.min(count[AGAIN + 1], i1))
        if count[FRESH] != 0:
            first, last, begin, end = i0, i1, i0, i1
    spans, to0 = 3 * names + 2 * tile * count[TILE], count[ROOM + 1] * count[WIDTH] + count[ROOM]
    if layer == 0 and count[STANDS] == 0:
        behind(first, last, j0, j1, dark_row, to0, h * w, w, number, count, dark, under, out)
    for j in range(j0, j1):
        here, span, to = (j + 1) * (w + 2) + 1, spans + 2 * (j - j0), to0 + j * count[WIDTH]
        near[span], near[span + 1] = ABSENT, -ABSENT
        i = begin
        while i < end:
            at = here + i
            near[at + names], near[at + 2 * names] = -1, out[to + i]
            if layer == 0 or i < box[tile, 2] or i >= box[tile, 3]:
                near[at] = under[j * w + i]
            i += 1 + count[ZERO]
    fill(
        kinds, layer, names, spans, i0, i1, j0, j1, tiles, corner, ball, line, number, count,
        vertex, globe, box, near,
    )  # fmt: skip
    if layer > 0:
        for j in range(j0, j1):
            here, to = (j + 1) * (w + 2) + 1, to0 + j * count[WIDTH]
            i = low
            while i < high:
                at = names + here + i
                if near[at] >= 0:
                    near[at + names] = _half(near[at + names], out[to + i])
                i += 1 + count[ZERO]


@ti.func
def _span(near: ti.template(), spans, across, j, h, low, high):
    """The columns, from and to, in which row j or one beside it has something.

    spans: of all rows, where a tile is as wide as the room. across: tiles in a row of them. low,
    high: of the whole tile, where others beside it have spans of their own.
    """
    first, last = low, high
    if across == 1:
        first, last = high, low
        for step in ti.static(range(-1, 2)):
            at = spans + 2 * ti.min(ti.max(j + step, 0), h - 1)
            first, last = ti.min(first, near[at] - 1), ti.max(last, near[at + 1] + 1)
        first, last = ti.max(first, low), ti.min(last, high)
    return first, ti.max(first, last)


@ti.func
def _finish(
    kinds: ti.template(), tile, layer, corner: ti.template(), beside: ti.template(),
    line: ti.template(), number: ti.template(), count: ti.template(), vertex: ti.template(),
    globe: ti.template(), box: ti.template(), near: ti.template(), under: ti.template(),
    out: ti.template(),
):  # fmt: skip
    """Write the pixels of a tile that have something, and smooth edges.

    All neighbours of a pixel that has something are up to date.
    """
    w, h, tiles = count[ROOM + 2], count[ROOM + 3], count[TILE + 3]
    names = (w + 2) * (h + 2)
    j0, at = tile // count[TILE + 2] * count[TILE], layer * tiles + tile
    low, high = box[at, 2], box[at, 3]
    for j in range(j0, ti.min(j0 + count[TILE], h)):
        to, this = (count[ROOM + 1] + j) * count[WIDTH] + count[ROOM], names + (j + 1) * (w + 2) + 1
        first, last = _span(near, 3 * names, count[TILE + 2], j, h, low, high)
        for i in range(first, last):
            code = near[this + i + names]
            if is_edge(this + i, w, names, near):
                code = smoothed(
                    kinds, count[ZERO], this + i, w, names, i, j, layer, corner, beside, line,
                    number, vertex, globe, near,
                )  # fmt: skip
            out[to + i] = code
            if count[STANDS] != 0 and near[this + i] >= 0:
                under[j * w + i] = near[this + i - names]


@kernel
def draw(
    kinds: ti.template(),
    layer: ti.i32,
    corner: row,
    beside: row,
    ball: row,
    line: row,
    number: numbers,
    count: row,
    vertex: row,
    globe: numbers,
    box: image,
    near: row,
    under: row,
    dark: rows,
    out: row,
):
    """Draw the things of a layer, which were seen, into a room of a picture `out` (h * w,).

    under: (2, h, w) in a row, one over the depth, as bits, of what lies behind, and its colours.
    What stands still is drawn into these colours, and its depths are kept.
    """
    if ti.static(ti.cfg.arch == ti.cpu):
        # Threads take one tile after another.
        for worker in range(count[WORKERS] * PIECE):
            if worker % PIECE == 0:
                tile = ti.atomic_add(count[NEXT], 1)
                while tile < count[TILE + 3]:
                    _tile(
                        kinds, tile, layer, corner, ball, line, number, count, vertex, globe, box,
                        near, under, dark, out,
                    )  # fmt: skip
                    tile = ti.atomic_add(count[NEXT], 1)
        for worker in range(count[WORKERS] * PIECE):
            if worker % PIECE == 0:
                tile = ti.atomic_add(count[NEXT + 1], 1)
                while tile < count[TILE + 3]:
                    _finish(
                        kinds, tile, layer, corner, beside, line, number, count, vertex, globe, box,
                        near, under, out,
                    )  # fmt: skip
                    tile = ti.atomic_add(count[NEXT + 1], 1)
    else:
        ti.loop_config(block_dim=8)
        for tile in range(count[TILE + 3]):
            _tile(
                kinds, tile, layer, corner, ball, line, number, count, vertex, globe, box, near,
                under, dark, out,
            )  # fmt: skip
        ti.loop_config(block_dim=8)
        for tile in range(count[TILE + 3]):
            _finish(
                kinds, tile, layer, corner, beside, line, number, count, vertex, globe, box, near,
                under, out,
            )  # fmt: skip
