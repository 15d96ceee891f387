"""The layout of the arrays that kernels of drawing share, and colours.

Units: places in pixels of the picture's room, x right, y down, from its upper left corner. Depth is
kept as one over it. Colours are 0xRRGGBB, in `vertex` of ten bits each.

Vertices (n, 3) are places in the world. `vertex` (5 n,) int32 has what is seen of each: pixel x,
pixel y, one over the depth (0: not drawn; these three as bits of float32), the lit colours of its
front and of its back. `ball` (k, 3) int32: its vertex, colour, radius as bits of float32; `globe`
(4 k,): its middle in the camera's axes, and its radius. `line` (l, 3) int32: its two vertices and
its colour. `beside` (m, 3) int32: the triangles that share a triangle's sides, -1 where none does.

Things are in two layers: what is firm, and veils, through which half of what lies behind is seen.
They are taken in chunks of `CHUNK`. Of `box` (, 4) int32 the first rows, one for each tile of each
layer, have columns: those written last, from and to; those in which something may be drawn, from
and to. The others, one a chunk, have the pixels that it may touch: x from, to, y from, to.

`near` is three images with a rim of one pixel, in a row: depth, name and colour of what is nearest
in the middle of each pixel. A name is -1 where nothing is; on the rim the colour is, too. Then come
the columns, from and to, of each row of each tile that have something.

All of these but `box` are given in a row: Taichi reads the shape of an array of two dimensions at
each access.
"""

import taichi as ti

CHUNK = 32  # triangles, balls or lines of which one box is kept
FLOOR = 0x1000000  # a bit of the colours that lie behind: they are the floor's
FINE = 1024  # levels of a channel of a vertex's lit colour
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
# Is 0, which LLVM does not know. Where a loop's step adds it, or a loop that stores nothing would
# end by it, LLVM neither writes the loop eight times nor makes it one of vectors: as fast, and
# compiled in half the time.
ZERO, COUNTS = WIDTH + 1, WIDTH + 2

image = ti.types.ndarray(dtype=ti.i32, ndim=2)
rows = ti.types.ndarray(dtype=ti.f32, ndim=2)
numbers = ti.types.ndarray(dtype=ti.f32, ndim=1)
row = ti.types.ndarray(dtype=ti.i32, ndim=1)


@ti.func
def three(a: ti.template(), i):
    return ti.Vector([a[i], a[i + 1], a[i + 2]])


@ti.func
def real(bits):
    return ti.bit_cast(bits, ti.f32)


@ti.func
def bits(value):
    return ti.bit_cast(ti.cast(value, ti.f32), ti.i32)


@ti.func
def first_pixel(place, low, high):
    """The first pixel from `low` to `high` whose middle lies at `place` or after it."""
    return ti.cast(ti.ceil(ti.min(ti.max(place - 0.5, low + 0.0), high + 0.0)), ti.i32)


@ti.func
def rgb_of(code):
    """The channels of 0xRRGGBB, each from 0 to 1."""
    return ti.Vector([(code >> 16) & 255, (code >> 8) & 255, code & 255]) * (1.0 / 255.0)


@ti.func
def packed(rgb, levels: ti.template()):
    """Channels from 0 to 1 side by side in an integer: with 256 levels each, 0xRRGGBB."""
    code = 0
    for k in ti.static(range(3)):
        level = ti.min(ti.max(rgb[k], 0.0), 1.0) * (levels - 1.0) + 0.5
        code = code * levels + ti.cast(level, ti.i32)
    return code
