"""The total force on each particle in the present state, for the host to read between frames."""

import taichi as ti

from taichi_cloth.front_end.mending import kernel
from taichi_cloth.kernels.accelerations import plus_force, terms_on_particles
from taichi_cloth.kernels.clock import time_at_end
from taichi_cloth.kernels.compensated import difference
from taichi_cloth.kernels.forces import has_tractions
from taichi_cloth.kernels.forces.contract import ACCELERATION, FORCE
from taichi_cloth.kernels.packs import read, set_slot_value, slot_value, write
from taichi_cloth.kernels.springs import accumulate, force_between
from taichi_cloth.kernels.surfaces import compute_tractions


@kernel
def compute_forces(spec: ti.template(), state: ti.template(), step: ti.i32):
    """Compute what acts on each particle, fixed ones too, from positions and velocities.

    step: the number of the last step, which tells the time.

    Forces go to state.saved_x, accelerations that do not depend on mass to state.saved_v: between
    frames the fields of the checkpoint are free, and all that the method keeps stays as it is.
    """
    state.step[None] = step
    compute_tractions(spec, state, 0, time_at_end, False)
    accumulate(spec, state, 0, force_between, difference, _store, _store_more)


@ti.func
def _store(spec: ti.template(), state: ti.template(), i, f):
    """Store the spring forces f on pack i with all other forces, and its accelerations."""
    total, a = f, 0.0 * f
    for term in ti.static(terms_on_particles(spec, ACCELERATION)):
        a += term.law(spec, state, i)
    for term in ti.static(terms_on_particles(spec, FORCE)):
        total = plus_force(spec, state, i, term, total, 1.0)
    if ti.static(has_tractions(spec)):
        total += read(spec, state.traction, i)
    write(spec, state.saved_x, i, total)
    write(spec, state.saved_v, i, a)


@ti.func
def _store_more(spec: ti.template(), state: ti.template(), slot, f):
    """Add the forces f of those springs of a particle that no grid holds."""
    set_slot_value(spec, state.saved_x, slot, slot_value(spec, state.saved_x, slot) + f)
