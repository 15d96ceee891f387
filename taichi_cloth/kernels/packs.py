"""Packs: how the particles of a regular grid lie in memory, and arithmetic on packs.

A grid of `columns` is cut into L vertical strips, each W = ceil(columns / L) wide or somewhat more.
A *pack* is the particles at one place of all strips, one in each of its L *lanes*, which one vector
holds: so a neighbour in the grid is the same lane of a neighbouring pack, and straight-line code on
packs becomes vector instructions:

      columns of the grid, L = 4, W = 3             packs of a row, each |lane 0 1 2 3|

       strip 0   strip 1   strip 2   strip 3        halo          W packs           halo
      +---------+---------+---------+-------+     +-------+-------+-------+-------+-------+
      | 0  1  2 | 3  4  5 | 6  7  8 | 9  .  |     |-2 5 8 |0 3 6 9|1 4 7 .|2 5 8 .|3 6 9 -|
      +---------+---------+---------+-------+     +-------+-------+-------+-------+-------+
                                                    first-1 first                 first+W

The column with number n in its row is in lane n // W of the pack first + n % W. Right of a strip's
last column is the next strip's first one: the *halo* packs beside a row hold the row's other end,
one lane on, and are renewed when a row has moved. Places marked . have no particle (inverse mass
and stiffness 0), those marked - no neighbour. A pack's vectors lie component by component,
|x x x x|y y y y|, and are computed with so (`vectors.py`). Rows follow each other at a pitch of W
plus both halos; empty rows above and below let every link's neighbour be read.

Where rows of a graph are packed (`graph.py`), a pack is L particles that follow each other, and all
packs together are one array for each component: the particles from any place on are read at once.

With L = 1, on GPUs and for most particles on a graph, a pack is one particle, its value a vector of
`dim`, and there are no halos. The functions below work on both, so physics is written once.
A *slot* is a place for one particle: its pack times L, plus its lane.

Methods on packs of several lanes are compiled with vectors kept whole (`runtime.whole_vectors`),
which Taichi 1.7 does only in part. In their kernels
- fields hold numbers, which `read` and `write` make vectors of: fields of vectors crash;
- what has a number for each lane takes + - * /, min, max, sqrt, comparisons and select; not unary
  minus (-1.0 * a), -= (a = a - b), abs, nor casts;
- conditions are used at once, in a select: vectors of them cannot be taken apart (`largest`,
  `where_positive`).
"""

import taichi as ti

from taichi_cloth.kernels.lane_memory import rows_at, seen, sees
from taichi_cloth.kernels.vectors import Vectors

# Packs and slots of packed rows, and vectors of lanes, are below these. Compilers that know it see
# that no sum of them is too large for a whole number, hence that lanes lie side by side, and read
# them all at once.
PACKS, SLOTS, VECTORS = 0x00FFFFFF, 0x07FFFFFF, 0x0FFFFFFF


def in_lanes(a):
    """True if `a` are vectors in several lanes, and not one vector: known as kernels are read."""
    return isinstance(a, Vectors)


def rows_of(spec, field):
    """The numbers that a field of packs holds for each particle."""
    return field.shape[1] // spec.lanes


def is_by_component(spec, field):
    """True if a field holds vectors, all first components before all second ones: packed rows."""
    return spec.packed_rows and len(field.shape) == 1


def ats_of(spec, field):
    """The places of the components of a pack's lanes, from its first slot on."""
    room = field.shape[0] // spec.dim
    return [[k * room + lane for lane in range(spec.lanes)] for k in range(spec.dim)]


def epsilon(state):
    """The distance from 1 to the next number that the device's precision holds."""
    return 2.0**-52 if state.real == ti.f64 else 2.0**-23


@ti.func
def read(spec: ti.template(), field: ti.template(), i):
    """The value of a field at pack i: vectors (`vectors.py`), or a number for each lane.

    With one lane it is a vector (dim,) or a number. A 0-D field holds one number for all lanes.
    """
    if ti.static(field.shape == ()):
        return everywhere(spec, field[None])
    elif ti.static(spec.lanes == 1):
        return field[i]
    elif ti.static(is_by_component(spec, field)):
        return lanes_from(spec, field, (i & PACKS) * spec.lanes)
    else:
        return _read_lanes(spec, field, i)


@ti.func
def lanes_from(spec: ti.template(), field: ti.template(), slot):
    """The vectors of a field at a slot and those that follow it, if `is_by_component`."""
    return vectors(
        [ti.Vector([field[slot + at] for at in ats]) for ats in ti.static(ats_of(spec, field))]
    )


@ti.func
def number_in_pack(spec: ti.template(), field: ti.template(), i, k):
    """Number k of all of pack i's, component by component; k: also one known only at run time."""
    return _number(spec, field, i, k // spec.lanes, k % spec.lanes)


@ti.func
def set_number_in_pack(spec: ti.template(), field: ti.template(), i, k, value):
    """Store number k of all of pack i's, as `number_in_pack` reads it."""
    _set_number(spec, field, i, k // spec.lanes, k % spec.lanes, value)


# --- a field's numbers in packs of several lanes: by `lane_memory.py`, or from the field ----------
#
# To Taichi a vector in the memory of lanes and a number in it are different memory: what it has
# read of the one it does not read again after a store to the other. So only vectors are read, also
# for one number, and beside each store of a number stands one of a vector, to a place that Taichi
# does not know, which never happens.


@ti.func
def _read_lanes(spec: ti.template(), field: ti.template(), i):
    """The value of a field at a pack of several lanes."""
    rows = _rows(spec, field, i)
    if ti.static(rows_of(spec, field) == 1):
        return rows[0]
    else:
        return vectors(rows)


@ti.func
def _rows(spec: ti.template(), field: ti.template(), i):
    """A list of the numbers that a field holds for each lane of a pack, row by row."""
    if ti.static(sees(field)):
        at = _first_vector(spec, field, i)
        return ti.static(rows_at(at, rows_of(spec, field)))
    else:
        return [
            ti.Vector([field[i, k * spec.lanes + lane] for lane in range(spec.lanes)])
            for k in ti.static(range(rows_of(spec, field)))
        ]


@ti.func
def _number(spec: ti.template(), field: ti.template(), i, k, lane):
    """The component k of a lane of pack i of a field; both also ones known only at run time."""
    if ti.static(sees(field)):
        row = ti.static(seen())[_first_vector(spec, field, i) + k]
        return row[lane]
    else:
        return field[i, k * spec.lanes + lane]


@ti.func
def _set_number(spec: ti.template(), field: ti.template(), i, k, lane, value):
    """Store the component k of a lane of pack i of a field."""
    if ti.static(sees(field)):
        at = _first_vector(spec, field, i) + k
        ti.static(seen())[at][lane] = value
        size = ti.static(seen()).shape[0]
        if size < 0:
            ti.static(seen())[at + size] = everywhere(spec, value)
    else:
        field[i, k * spec.lanes + lane] = value


@ti.func
def _first_vector(spec: ti.template(), field: ti.template(), i):
    """The place of pack i of a field in the memory of lanes."""
    return (ti.static(field.first_vector) + i * ti.static(rows_of(spec, field))) & VECTORS


@ti.func
def everywhere(spec: ti.template(), number):
    """A value for a pack that holds the same number in all lanes."""
    if ti.static(spec.lanes == 1):
        return number
    else:
        return ti.Vector([number for _ in range(spec.lanes)])


@ti.func
def zeros(spec: ti.template(), state: ti.template()):
    """Zero vectors for a pack."""
    if ti.static(spec.lanes == 1):
        return ti.Vector.zero(state.real, spec.dim)
    else:
        none = everywhere(spec, ti.cast(0.0, state.real))
        return vectors([none for _ in ti.static(range(spec.dim))])


@ti.func
def write(spec: ti.template(), field: ti.template(), i, value):
    """Store the value of a field at pack i: vectors, or a number for each lane."""
    if ti.static(spec.lanes == 1):
        field[i] = value
    elif ti.static(is_by_component(spec, field)):
        first = (i & PACKS) * spec.lanes
        for axis, ats in ti.static(enumerate(ats_of(spec, field))):
            for lane, at in ti.static(enumerate(ats)):
                field[first + at] = component(value, axis)[lane]
    else:
        _write_lanes(spec, field, i, value)


@ti.func
def _write_lanes(spec: ti.template(), field: ti.template(), i, value):
    """Store the value of a field at a pack of several lanes."""
    rows = ti.static(components_of(value))
    if ti.static(sees(field)):
        at = _first_vector(spec, field, i)
        to = ti.static(rows_at(at, rows_of(spec, field)))
        for k in ti.static(range(rows_of(spec, field))):
            to[k] = rows[k]
    else:
        for k, lane in ti.static(ti.ndrange(rows_of(spec, field), spec.lanes)):
            field[i, k * spec.lanes + lane] = rows[k][lane]


def components_of(value):
    """A list of the components of a pack's vectors, or of its numbers alone."""
    return value.components if isinstance(value, Vectors) else [value]


@ti.func
def vectors(components: ti.template()):
    """The vectors of a pack with these components, each a number for each lane."""
    return ti.static(_joined(components))[0]


def _joined(components):
    """The same in a tuple, as `ti.static` wants it."""
    return (Vectors(components),)


@ti.func
def dot(a, b):
    """The scalar product of the vectors a and b, for each lane."""
    if ti.static(not in_lanes(a)):
        return a.dot(b)
    else:
        total = component(a, 0) * component(b, 0)
        for axis in ti.static(range(1, a.n)):
            total += component(a, axis) * component(b, axis)
        return total


@ti.func
def where_positive(s, a, b):
    """The vectors a in lanes where the number s is positive, else b."""
    if ti.static(not in_lanes(a)):
        return ti.select(s > 0.0, a, b)
    else:
        return vectors(
            [
                ti.select(s > 0.0, component(a, axis), component(b, axis))
                for axis in ti.static(range(a.n))
            ]
        )


@ti.func
def largest(spec: ti.template(), a):
    """The largest of the numbers in all lanes."""
    if ti.static(spec.lanes == 1):
        return a
    else:
        return folded(ti.max, a)


@ti.func
def over_lanes(spec: ti.template(), a):
    """The sum of the numbers in all lanes."""
    if ti.static(spec.lanes == 1):
        return a
    else:
        return folded(plus, a)


@ti.func
def plus(a, b):
    """The sum of a and b, for `folded`."""
    return a + b


@ti.func
def folded(op: ti.template(), a):
    """The numbers in all lanes joined by op(a, b): half with the other half, until one is left.

    There must be a power of two of them.
    """
    if ti.static(a.n == 1):
        return a[0]
    else:
        half = ti.static(a.n // 2)
        return folded(op, op(a[0:half], a[half : 2 * half]))


@ti.func
def component(a, axis: ti.template()):
    """One component of the vectors a: a number for each lane."""
    if ti.static(not in_lanes(a)):
        return a[axis]
    else:
        return ti.static(a.components)[axis]


@ti.func
def with_component(a, axis: ti.template(), value):
    """The vectors a with one component replaced by `value`, a number for each lane."""
    b = a
    if ti.static(not in_lanes(a)):
        b[axis] = value
    else:
        ti.static(b.components)[axis] = value
    return b


@ti.func
def vectors_of(spec: ti.template(), components: ti.template()):
    """The vectors with these components: one vector, or those of a pack of several lanes."""
    if ti.static(spec.lanes == 1):
        return ti.Vector(components)
    else:
        return vectors(components)


@ti.func
def turned(spec: ti.template(), u):
    """The vectors u with each component where the one before it was."""
    return vectors_of(spec, [component(u, (k + 1) % spec.dim) for k in ti.static(range(spec.dim))])


@ti.func
def lane_of(spec: ti.template(), a, lane: ti.template()):
    """The number in one lane of a pack's numbers a."""
    if ti.static(spec.lanes == 1):
        return a
    else:
        return a[lane]


@ti.func
def vector_of_lane(a: ti.template(), lane):
    """The vector (dim,) in one lane of the vectors a; lane: also one known only at run time.

    `a` is kept in memory for it, so it should be a copy, of what is otherwise in registers.
    """
    return ti.Vector([a.components[axis][lane] for axis in range(a.n)])


@ti.func
def set_vector_of_lane(a: ti.template(), lane, value):
    """Set the vector in one lane of the vectors a, which `vector_of_lane` reads."""
    for axis in ti.static(range(a.n)):
        ti.static(a.components)[axis][lane] = value[axis]


@ti.func
def slot_value(spec: ti.template(), field: ti.template(), slot):
    """The vector (dim,) of the particle at a slot, for code that runs particle by particle."""
    if ti.static(spec.lanes == 1):
        return field[slot]
    elif ti.static(is_by_component(spec, field)):
        return ti.Vector([field[slot + ats[0]] for ats in ti.static(ats_of(spec, field))])
    else:
        cell, lane = slot // spec.lanes, slot % spec.lanes
        return ti.Vector([_number(spec, field, cell, k, lane) for k in range(spec.dim)])


@ti.func
def slot_number(spec: ti.template(), field: ti.template(), slot):
    """The number of the particle at a slot; of a 0-D field, the one that all share."""
    if ti.static(field.shape == ()):
        return field[None]
    elif ti.static(spec.lanes == 1):
        return field[slot]
    else:
        return _number(spec, field, slot // spec.lanes, 0, slot % spec.lanes)


@ti.func
def set_slot_value(spec: ti.template(), field: ti.template(), slot, value):
    """Store the vector `value` (dim,) of the particle at a slot."""
    for axis in ti.static(range(spec.dim)):
        if ti.static(spec.lanes == 1):
            field[slot][axis] = value[axis]
        elif ti.static(is_by_component(spec, field)):
            field[slot + ti.static(ats_of(spec, field)[axis][0])] = value[axis]
        else:
            _set_number(spec, field, slot // spec.lanes, axis, slot % spec.lanes, value[axis])


@ti.func
def set_slot_number(spec: ti.template(), field: ti.template(), slot, value):
    """Store the number of the particle at a slot; in a 0-D field, the one that all share."""
    if ti.static(field.shape == ()):
        field[None] = value
    elif ti.static(spec.lanes == 1):
        field[slot] = value
    else:
        _set_number(spec, field, slot // spec.lanes, 0, slot % spec.lanes, value)
