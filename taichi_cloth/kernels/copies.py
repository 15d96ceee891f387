"""Copies of the state of particles: where a step or a frame began, to compare with or to return to.

A copy has a name and as many fields as its owner has declared: positions and velocities, such as
begun_x and begun_v, and in the precision `compensated` the low parts of one or both.
"""

import taichi as ti

from taichi_cloth.kernels.packs import read, set_slot_value, slot_value, write

COPIED = ("x", "v", "x_low", "v_low")


def _pairs(state, name):
    """Each field of the state that a copy has, with the copy's own."""
    return [
        (getattr(state, of), getattr(state, f"{name}_{of}"))
        for of in COPIED
        if hasattr(state, f"{name}_{of}")
    ]


@ti.func
def keep(spec: ti.template(), state: ti.template(), i, name: ti.template()):
    """Copy the state of pack i: to begun_x, begun_v and so on if the copy's name is "begun"."""
    for of, copy in ti.static(_pairs(state, name)):
        if ti.static(spec.packed_rows):  # one by one, which takes a tenth to compile
            for slot in range(i * spec.lanes, (i + 1) * spec.lanes):
                set_slot_value(spec, copy, slot, slot_value(spec, of, slot))
        else:
            write(spec, copy, i, read(spec, of, i))


@ti.func
def return_to(spec: ti.template(), state: ti.template(), i, name: ti.template()):
    """Put pack i back to a copy of its state."""
    for of, copy in ti.static(_pairs(state, name)):
        write(spec, of, i, read(spec, copy, i))
