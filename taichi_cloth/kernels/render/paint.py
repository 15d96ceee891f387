"""Flat shapes as pixels, one upon another as a painter would, with smooth edges.

A shape covers a share of each pixel at its edge: as much as it covers of a straight way through the
pixel's middle, across the edge and as long as the pixel is in that direction. That is exact for
edges along rows and columns, and right on the mean for others. That share of its colour is mixed
into what lies there. Each tile is painted as a whole by one thread, with all
shapes in their order: the picture has the same bits however many threads paint it. Only columns in
which something is painted, or was before, are touched.

Places are pixels, x right, y down, from the corner at the top left. A picture (h * w,) has a row of
pixels at a time from the top down, as 0xRRGGBB. Shapes are rows of `number` (k, 7) and `what`
(k, 2). `what` is their kind and their colour, 0xRRGGBB.

Of the kind `STROKE` are all places that are at most so far from a line. Its numbers: two ends, two
that are not used, and how far. A `DISC` is one whose ends are the same; its fifth number is how far
from its middle shapes above hide it. All other kinds are triangles: three corners, and a number
that is not used. The kind is the sum of 1, 2 and 4 for each of the sides between corners 0 and 1,
1 and 2, and 2 and 0 that is smooth. One that is not hides what is under it as far as a neighbour
may begin.
"""

import taichi as ti

from taichi_cloth.front_end.mending import kernel
from taichi_cloth.kernels.loops import PIECE
from taichi_cloth.kernels.render.frame import CHUNK, first_pixel, image, row, rows

STROKE, DISC = -1, -2
DIAGONAL = 0.7072  # from a pixel's middle to its corner
COMMON = -1.0 / 64  # pixels that triangles overlap at sides that are not smooth

PART = 16  # pixels of a row that a thread copies
# Of `count`: the room's left, top, width, height; a tile's rows and columns, tiles across, tiles;
# the picture's width; whether all is painted anew, and whether what lies behind is there to stay;
# the columns and rows to paint anew, from, to, from, to; the next tile; threads; chunks; and 0, as
# `frame.ZERO` has it.
ROOM, TILE, WIDTH, FRESH, OVER, AGAIN = 0, 4, 8, 9, 10, 11
NEXT, WORKERS, CHUNKS, ZERO, COUNTS = 15, 16, 17, 18, 19


@ti.func
def _beyond(place, low, high):
    """The first pixel from `low` to `high` whose middle lies after `place`."""
    return ti.cast(ti.floor(ti.min(ti.max(place + 0.5, low + 0.0), high + 0.0)), ti.i32)


@ti.func
def _mix(frame: ti.template(), at, color, share):
    """Mix this share of a colour into a pixel."""
    if share >= 1.0:
        frame[at] = color
    elif share > 0.0:
        under, part = frame[at], ti.cast(share * 256.0 + 0.5, ti.i32)
        ends = (under & 0xFF00FF) * (256 - part) + (color & 0xFF00FF) * part + 0x800080
        middle = (under & 0x00FF00) * (256 - part) + (color & 0x00FF00) * part + 0x008000
        frame[at] = ((ends >> 8) & 0xFF00FF) | ((middle >> 8) & 0x00FF00)


@ti.func
def _stroke(frame: ti.template(), number: ti.template(), s, width, color, top, bottom, left, right):
    """Paint what is near a line, from row `top` to before `bottom`, `left` to before `right`."""
    ax, ay, half = number[s, 0], number[s, 1], number[s, 6]
    along, down = number[s, 2] - ax, number[s, 3] - ay
    by_size2 = 1.0 / ti.max(along * along + down * down, 1e-12)
    by_size = ti.sqrt(by_size2)
    aside, upwards = down * by_size, along * by_size  # across the line
    side = ti.max(ti.abs(aside) + ti.abs(upwards), 1.0)  # how long a pixel is there
    by_side = 1.0 / side
    reach = half + DIAGONAL
    whole2 = ti.max(half - DIAGONAL, 0.0) ** 2  # so near, squared, all of a pixel is covered
    j0 = first_pixel(ti.min(ay, ay + down) - reach, top, bottom)
    j1 = _beyond(ti.max(ay, ay + down) + reach, top, bottom)
    for j in range(j0, j1):
        # Only this part of the line, from one share of it to another, is so near to the row.
        y = j + 0.5 - ay
        part0, part1 = 0.0, 1.0
        if ti.abs(down) > 1e-3:
            one, other = (y - reach) / down, (y + reach) / down
            part0 = ti.min(ti.max(ti.min(one, other), 0.0), 1.0)
            part1 = ti.min(ti.max(ti.max(one, other), 0.0), 1.0)
        x0, x1 = ax + part0 * along, ax + part1 * along
        i0 = first_pixel(ti.min(x0, x1) - reach, left, right)
        i1 = _beyond(ti.max(x0, x1) + reach, left, right)
        for i in range(i0, i1):
            x = i + 0.5 - ax
            part = (x * along + y * down) * by_size2
            if part > 0.0 and part < 1.0:  # beside the line, and not at an end
                away = ti.abs(x * aside - y * upwards)
                if away < reach:
                    near, far = away - 0.5 * side, away + 0.5 * side
                    common = ti.min(far, half) - ti.max(near, -half)
                    _mix(frame, j * width + i, color, common * by_side)
            else:
                part = ti.min(ti.max(part, 0.0), 1.0)
                off_x, off_y = x - part * along, y - part * down
                away2 = off_x * off_x + off_y * off_y
                if away2 < whole2:
                    frame[j * width + i] = color
                elif away2 < reach * reach:
                    away = ti.max(ti.sqrt(away2), 1e-3)
                    long = ti.max((ti.abs(off_x) + ti.abs(off_y)) / away, 1.0)  # 1 to sqrt 2
                    common = ti.min(away + 0.5 * long, half) - ti.max(away - 0.5 * long, -half)
                    _mix(frame, j * width + i, color, common / long)


@ti.func
def _disc(frame: ti.template(), number: ti.template(), s, width, color, top, bottom, left, right):
    """Paint a disc, as `_stroke` does a line."""
    ax, ay, half = number[s, 0], number[s, 1], number[s, 6]
    reach2, whole2 = (half + DIAGONAL) ** 2, ti.max(half - DIAGONAL, 0.0) ** 2
    hollow2 = ti.max(number[s, 4] - DIAGONAL, 0.0) ** 2
    for j in range(
        first_pixel(ay - half - DIAGONAL, top, bottom), _beyond(ay + half + DIAGONAL, top, bottom)
    ):
        y = j + 0.5 - ay
        # From `whole` to `end` all of each pixel is covered, from `hole` to `hole_end` for nothing.
        along = ti.sqrt(ti.max(reach2 - y * y, 0.0))
        inside, hidden = ti.sqrt(ti.max(whole2 - y * y, 0.0)), ti.sqrt(ti.max(hollow2 - y * y, 0.0))
        i, last = first_pixel(ax - along, left, right), _beyond(ax + along, left, right)
        whole, end = first_pixel(ax - inside, left, right), _beyond(ax + inside, left, right)
        hole, hole_end = first_pixel(ax - hidden, left, right), _beyond(ax + hidden, left, right)
        if inside == 0.0:
            end = whole
        if hidden == 0.0:
            hole_end = hole
        while i < last:
            if i >= hole and i < hole_end:
                i = hole_end
            else:
                if i >= whole and i < end:
                    frame[j * width + i] = color
                else:
                    x = i + 0.5 - ax
                    away = ti.max(ti.sqrt(x * x + y * y), 1e-3)
                    long = ti.max((ti.abs(x) + ti.abs(y)) / away, 1.0)  # 1 to sqrt 2
                    common = ti.min(away + 0.5 * long, half) - ti.max(away - 0.5 * long, -half)
                    _mix(frame, j * width + i, color, common / long)
                i += 1


@ti.func
def _triangle(
    frame: ti.template(), number: ti.template(), s, width, kind, color, top, bottom, left, right
):
    """Paint a triangle, from row `top` to before `bottom`, `left` to before `right`."""
    x = ti.Vector([number[s, 0], number[s, 2], number[s, 4]])
    y = ti.Vector([number[s, 1], number[s, 3], number[s, 5]])
    area = (x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0])
    if area != 0.0:
        # Of each side: how far a place is inside it is across * x + downwards * y + at.
        across, downwards, at = ti.Vector([0.0] * 3), ti.Vector([0.0] * 3), ti.Vector([0.0] * 3)
        least = ti.Vector([0.0] * 3)
        for k in ti.static(range(3)):
            to_x, to_y = x[(k + 1) % 3] - x[k], y[(k + 1) % 3] - y[k]
            size = ti.sqrt(to_x * to_x + to_y * to_y)
            least[k] = COMMON
            if (kind >> k) & 1:  # measured in how long a pixel is across the side
                size, least[k] = ti.abs(to_x) + ti.abs(to_y), -0.5
            way = ti.select(area > 0.0, 1.0, -1.0) / ti.max(size, 1e-12)
            across[k], downwards[k] = -way * to_y, way * to_x
            at[k] = -across[k] * x[k] - downwards[k] * y[k]
        for j in range(
            first_pixel(y.min() - DIAGONAL, top, bottom), _beyond(y.max() + DIAGONAL, top, bottom)
        ):
            # The row is inside all sides from `low` to `high`.
            low, high = x.min() - DIAGONAL, x.max() + DIAGONAL
            for k in ti.static(range(3)):
                free = least[k] - at[k] - downwards[k] * (j + 0.5)
                if across[k] > 1e-6:
                    low = ti.max(low, free / across[k])
                elif across[k] < -1e-6:
                    high = ti.min(high, free / across[k])
            for i in range(first_pixel(low - 0.01, left, right), _beyond(high + 0.01, left, right)):
                share = 1.0
                for k in ti.static(range(3)):
                    inside = across[k] * (i + 0.5) + downwards[k] * (j + 0.5) + at[k]
                    if (kind >> k) & 1:
                        share = ti.min(share, inside + 0.5)
                    elif inside < COMMON:
                        share = 0.0
                _mix(frame, j * width + i, color, share)


@ti.func
def _tile(
    triangles: ti.template(), tile, number: ti.template(), what: ti.template(),
    count: ti.template(), box: ti.template(), under: ti.template(), frame: ti.template(),
):  # fmt: skip
    """Paint a tile."""
    tiles, width = count[TILE + 3], count[WIDTH]
    down = tile // count[TILE + 2]
    top, left = count[ROOM + 1] + down * count[TILE], count[ROOM]
    left += (tile - down * count[TILE + 2]) * count[TILE + 1]
    bottom = ti.min(top + count[TILE], count[ROOM + 1] + count[ROOM + 3])
    right = ti.min(left + count[TILE + 1], count[ROOM] + count[ROOM + 2])
    chunks = (what.shape[0] + CHUNK - 1) // CHUNK
    low, high = right, left  # the columns in which anything may be painted
    for c in range(chunks):
        k = tiles + c
        if box[k, 2] < bottom and box[k, 3] > top:
            low, high = ti.min(low, ti.max(box[k, 0], left)), ti.max(high, ti.min(box[k, 1], right))
        if count[ZERO] != 0:
            break
    if count[OVER] == 0:
        first, last = ti.min(low, box[tile, 0]), ti.max(high, box[tile, 1])
        box[tile, 0], box[tile, 1] = low, high
        if count[AGAIN + 2] < bottom and count[AGAIN + 3] > top:
            first = ti.min(first, ti.max(count[AGAIN], left))
            last = ti.max(last, ti.min(count[AGAIN + 1], right))
        if count[FRESH] != 0:
            first, last = left, right
        for j in range(top, bottom):
            from_there = (j - count[ROOM + 1]) * count[ROOM + 2] - count[ROOM]
            i = first
            while i < last:
                frame[j * width + i] = under[from_there + i]
                i += 1 + count[ZERO]
    for c in range(chunks):
        k = tiles + c
        if box[k, 2] < bottom and box[k, 3] > top and box[k, 0] < right and box[k, 1] > left:
            for s in range(c * CHUNK, ti.min((c + 1) * CHUNK, what.shape[0])):
                if what[s, 0] == DISC:
                    _disc(frame, number, s, width, what[s, 1], top, bottom, low, high)
                elif what[s, 0] == STROKE:
                    _stroke(frame, number, s, width, what[s, 1], top, bottom, low, high)
                elif ti.static(triangles):
                    _triangle(
                        frame, number, s, width, what[s, 0], what[s, 1], top, bottom, low, high
                    )


@kernel
def paint(
    triangles: ti.template(),
    number: rows,
    what: image,
    count: row,
    box: image,
    under: row,
    frame: row,
):
    """Paint shapes, each upon those before it, over what lies behind them.

    triangles: whether there are any; compiled in, for most pictures of a plane have none.
    under: (h * w,), that of the room. box: (, 4), one row a tile: the columns painted last, from
    and to; then one row a chunk of shapes. count: as `painter.py` fills it in.
    """
    for c in range(count[CHUNKS]):
        tiles = count[TILE + 3]
        low_x, high_x, low_y, high_y = 1e9, -1e9, 1e9, -1e9
        for s in range(c * CHUNK, ti.min((c + 1) * CHUNK, what.shape[0])):
            reach = 1.0
            x0, y0, x1, y1 = number[s, 0], number[s, 1], number[s, 2], number[s, 3]
            if what[s, 0] < 0:
                reach += number[s, 6]
            else:
                low_x, high_x = (
                    ti.min(low_x, number[s, 4] - 1.0),
                    ti.max(high_x, number[s, 4] + 1.0),
                )
                low_y, high_y = (
                    ti.min(low_y, number[s, 5] - 1.0),
                    ti.max(high_y, number[s, 5] + 1.0),
                )
            low_x, high_x = (
                ti.min(low_x, x0 - reach, x1 - reach),
                ti.max(high_x, x0 + reach, x1 + reach),
            )
            low_y, high_y = (
                ti.min(low_y, y0 - reach, y1 - reach),
                ti.max(high_y, y0 + reach, y1 + reach),
            )
            if count[ZERO] != 0:
                break
        far = 1e8
        box[tiles + c, 0] = ti.cast(ti.floor(ti.min(ti.max(low_x, -far), far)), ti.i32)
        box[tiles + c, 1] = ti.cast(ti.ceil(ti.min(ti.max(high_x, -far), far)), ti.i32)
        box[tiles + c, 2] = ti.cast(ti.floor(ti.min(ti.max(low_y, -far), far)), ti.i32)
        box[tiles + c, 3] = ti.cast(ti.ceil(ti.min(ti.max(high_y, -far), far)), ti.i32)
    # A tile is a thread on GPUs. Of a loop whose end is not known when it is compiled Taichi asks a
    # GPU for 65536 blocks and more of one or two threads; some take 65535.
    if ti.static(ti.cfg.arch == ti.cpu):
        for worker in range(count[WORKERS] * PIECE):
            if worker % PIECE == 0:
                tile = ti.atomic_add(count[NEXT], 1)
                while tile < count[TILE + 3]:
                    _tile(triangles, tile, number, what, count, box, under, frame)
                    tile = ti.atomic_add(count[NEXT], 1)
    else:
        ti.loop_config(block_dim=8)
        for tile in range(count[TILE + 3]):
            _tile(triangles, tile, number, what, count, box, under, frame)


@kernel
def put(pixels: image, x: ti.i32, y: ti.i32, width: ti.i32, parts: ti.i32, frame: row):
    """Copy pixels (h, w) into a picture whose rows are `width` long, from (x, y) on.

    parts: pieces of PART pixels in all rows. A thread each: graphics drivers take 65535 blocks.
    """
    for k in range(parts):
        across = (pixels.shape[1] + PART - 1) // PART
        j, first = k // across, k % across * PART
        for i in range(first, ti.min(first + PART, pixels.shape[1])):
            frame[(y + j) * width + x + i] = pixels[j, i]


@kernel
def as_bytes(frame: row, width: ti.i32, height: ti.i32, parts: ti.i32, shown: ti.template()):
    """Copy a picture into a field (width, height) of four bytes each, from the bottom up.

    parts: as for `put`.
    """
    for k in range(parts):
        across = (width + PART - 1) // PART
        j, first = k // across, k % across * PART
        for i in range(first, ti.min(first + PART, width)):
            code = frame[(height - 1 - j) * width + i]
            shown[i, j] = ti.Vector([(code >> 16) & 255, (code >> 8) & 255, code & 255, 255])
