"""Rows of fields of all shapes, copied between fields and flat arrays."""

import taichi as ti

# How a field is indexed: not at all, by rows, by rows and columns, by rows of vectors.
SINGLE, ROWS, COLUMNS, VECTORS = range(4)


def kind_of(field):
    """The index of a field."""
    if isinstance(field, ti.MatrixField):
        return VECTORS
    return (SINGLE, ROWS, COLUMNS)[len(field.shape)]


def width_of(field):
    """The numbers in a row of a field."""
    if kind_of(field) == VECTORS:
        return field.n
    return field.shape[1] if kind_of(field) == COLUMNS else 1


def is_whole(field):
    """True if a field has whole numbers."""
    return field.dtype == ti.i32


@ti.func
def copy_row(
    field: ti.template(),
    kind: ti.template(),
    width: ti.template(),
    back: ti.template(),
    r,
    array: ti.template(),
    at,
):
    """Copy row r of a field to an array, from `at` on; `back`: from it."""
    if ti.static(kind == SINGLE):
        if ti.static(back):
            field[None] = array[at]
        else:
            array[at] = field[None]
    elif ti.static(kind == ROWS):
        if ti.static(back):
            field[r] = array[at]
        else:
            array[at] = field[r]
    elif ti.static(kind == COLUMNS):
        for c in range(width):
            if ti.static(back):
                field[r, c] = array[at + c]
            else:
                array[at + c] = field[r, c]
    else:
        for c in ti.static(range(width)):
            if ti.static(back):
                field[r][c] = array[at + c]
            else:
                array[at + c] = field[r][c]
