"""What the pointer does to particles."""

import taichi as ti

from taichi_cloth.kernels import laws


@ti.kernel
def compute_push(state: ti.template(), numbers: ti.types.ndarray()):
    """push[i]: the pointer's force on particle i, by its distance to the pointer's line.

    numbers: per axis a point of the line, its unit direction (zero: the line is a point, as in
    2-D), the pointer's displacement; then reach and strength.
    """
    dim = ti.static(state.x.n)
    for _ in range(1):
        state.pushing[None] = 1
    for i in range(state.n[None]):
        x = state.x[i]
        d, ray, displacement = 0.0 * x, 0.0 * x, 0.0 * x
        for axis in ti.static(range(dim)):
            d[axis] = x[axis] - numbers[axis]
            ray[axis] = numbers[dim + axis]
            displacement[axis] = numbers[2 * dim + axis]
        d -= d.dot(ray) * ray
        distance = ti.sqrt(d.dot(d))
        state.push[i] = laws.blow_force(
            distance, displacement, numbers[3 * dim], numbers[3 * dim + 1]
        )


@ti.kernel
def clear_push(state: ti.template()):
    """No pointer force."""
    for _ in range(1):
        state.pushing[None] = 0
