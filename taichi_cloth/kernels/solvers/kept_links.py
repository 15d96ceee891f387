"""Numbers kept of the links of grids (`newton_matrix.keep_springs`), as whole rows read them."""

import taichi as ti

from taichi_cloth.kernels.grids import link_index, renew_left_halo, renew_right_halo
from taichi_cloth.kernels.packs import read, write


@ti.func
def renew_kept(spec: ti.template(), state: ti.template(), begin, width):
    """Renew the halos of what is kept of the links of a row."""
    for s in range(spec.kinds):
        first, columns = link_index(state, s, begin), state.link[s, 0]
        renew_left_halo(spec, state.link_axis, first, width, columns)
        renew_right_halo(spec, state.link_axis, first, width, -columns)
        for h in range(1, columns + 1):
            a = read(spec, state.link_across, first + width - h)
            write(spec, state.link_across, first - h, from_lane(spec, state, a, -1))
        for h in range(-columns):
            a = read(spec, state.link_across, first + h)
            write(spec, state.link_across, first + width + h, from_lane(spec, state, a, 1))


@ti.func
def from_lane(spec: ti.template(), state: ti.template(), a, shift):
    """The numbers a, of each lane those of the lane `shift` farther; 0 where there is none."""
    later = ti.Vector([a[lane] for lane in range(1, spec.lanes)] + [0.0])
    earlier = ti.Vector([0.0] + [a[lane] for lane in range(spec.lanes - 1)])
    to = 0.0 * a + ti.cast(shift, state.real)
    return ti.select(to > 0.0, later, ti.select(to < 0.0, earlier, a))
