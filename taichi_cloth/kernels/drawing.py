"""What a window reads at every frame: positions alone, and whether a spring broke."""

import taichi as ti

from taichi_cloth.kernels.lanes import site_number, site_value
from taichi_cloth.kernels.state import ALIVE


@ti.kernel
def read_positions(plan: ti.template(), state: ti.template(), x: ti.types.ndarray()):
    """Copy positions out, (n, dim)."""
    for i in range(x.shape[0]):
        x_i = site_value(plan, state.x, state.site[i])
        for axis in ti.static(range(plan.dim)):
            x[i, axis] = x_i[axis]


@ti.kernel
def count_broken(plan: ti.template(), state: ti.template()) -> ti.i32:
    """How many springs are not alive."""
    count = 0
    if ti.static(plan.fracture and plan.springs):
        for s in range(state.n_springs[None]):
            count += ti.cast(state.status[s] != ALIVE, ti.i32)
    if ti.static(plan.fracture and len(plan.links) > 0):
        for c in range(state.n_cells[None]):
            for lane in ti.static(range(plan.lanes)):
                for s in ti.static(range(len(plan.links))):
                    status = site_number(plan, state.link_status[s], c * plan.lanes + lane)
                    count += ti.cast(status != ALIVE, ti.i32)
    return count
