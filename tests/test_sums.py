"""What methods are built of: sums over a particle's springs, over springs, over particles."""

import numpy as np
import pytest
import taichi as ti
from cloths import LINKS, cloth, mixed
from inside import add_sums, add_vectors, move_to, spec_of, state_of, take_step
from selection import mostly_thorough

from taichi_cloth.front_end.mending import kernel
from taichi_cloth.kernels import laws
from taichi_cloth.kernels.compensated import difference
from taichi_cloth.kernels.graph import number
from taichi_cloth.kernels.grids import link_index, link_offset, pitch_of
from taichi_cloth.kernels.links import link_stiffness, link_value
from taichi_cloth.kernels.loops import add_up, each_pack_moving
from taichi_cloth.kernels.packs import dot, read, set_slot_value, slot_value, write
from taichi_cloth.kernels.spring_numbers import REST, K, fields_of
from taichi_cloth.kernels.springs import accumulate, force_between
from taichi_cloth.simulation.simulation import Simulation


@ti.func
def stiffness_between(
    spec: ti.template(), state: ti.template(), value: ti.template(), i, j, numbers: ti.template()
):
    """Change of a spring's force on i where the particles move by state.u (no dashpots).

    On the graph the far end of a spring that is gone is i itself, so the length may be zero.
    """
    d = value(spec, state.x, j) - value(spec, state.x, i)
    du = value(spec, state.u, j) - value(spec, state.u, i)
    length = laws.length(d)
    along = laws.unit(d, length)
    k, slack = numbers[K], ti.select(length > 0.0, numbers[REST] / length, 0.0 * length)
    return k * (1.0 - slack) * du + k * slack * dot(along, du) * along


@ti.func
def keep_sum(spec: ti.template(), state: ti.template(), c, total):
    write(spec, state.sum, c, total)


@ti.func
def add_to_sum(spec: ti.template(), state: ti.template(), slot, total):
    before = slot_value(spec, state.sum, slot)
    set_slot_value(spec, state.sum, slot, before + total)


@ti.func
def leave(spec: ti.template(), state: ti.template(), c):
    """Nothing: each_pack renews the halos."""


@kernel
def sum_springs(
    spec: ti.template(),
    state: ti.template(),
    between: ti.template(),
    u: ti.types.ndarray(),
    out: ti.types.ndarray(),
):
    """out = sum over each particle's springs of `between`, which reads state.u = u."""
    for i in range(u.shape[0]):
        u_i = ti.Vector.zero(state.real, spec.dim)
        for axis in ti.static(range(spec.dim)):
            u_i[axis] = u[i, axis]
        set_slot_value(spec, state.u, state.slot[i], u_i)
    each_pack_moving(spec, state, 0, leave)
    accumulate(spec, state, 0, between, difference, keep_sum, add_to_sum)
    for i in range(u.shape[0]):
        sum_i = slot_value(spec, state.sum, state.slot[i])
        for axis in ti.static(range(spec.dim)):
            out[i, axis] = sum_i[axis]


@pytest.mark.parametrize("lanes", mostly_thorough([4, 2, 1], default=[2]))
def test_a_product_with_the_stiffness_matrix_can_be_written(lanes, device):
    scene = mixed(damping=0.0, drag=0.0, walls=(), break_force=None)
    x, v = scene.particles.position, scene.particles.velocity
    u, out = np.random.default_rng(0).normal(size=x.shape), np.empty_like(x)
    products = []
    for name in ("lanes", "graph"):
        sim = Simulation(scene, topology=name, execution="parallel", lanes=lanes)
        add_vectors(sim, "u", haloed=True)
        add_vectors(sim, "sum")
        of = spec_of(sim), state_of(sim)
        sum_springs(*of, stiffness_between, u, out)
        products.append(out.copy())
        forces, h = [], 1e-6
        for sign in (1, -1):
            move_to(sim, name, "parallel", x + sign * h * u, v)
            sum_springs(*of, force_between, u, out)
            forces.append(out.copy())
        difference = (forces[0] - forces[1]) / (2 * h)
        np.testing.assert_allclose(products[-1], difference, rtol=0, atol=1e-7)
    np.testing.assert_allclose(*products, rtol=0, atol=1e-12)


@ti.func
def energy_between(
    spec: ti.template(), state: ti.template(), value: ti.template(), i, j, numbers: ti.template()
):
    """Elastic energy of a spring."""
    length = laws.length(value(spec, state.x, j) - value(spec, state.x, i))
    stretch = length - numbers[REST]
    return 0.5 * numbers[K] * stretch * stretch


@ti.func
def links_energy(spec: ti.template(), state: ti.template(), c):
    """Energy of the links of pack c to later particles: each spring once."""
    g, total = state.grid_of[c], 0.0 * read(spec, state.w, c)
    if g >= 0:
        for s in ti.static(range(spec.kinds)):
            far = c + link_offset(state, s, pitch_of(spec, state, g))
            k = link_stiffness(spec, state, s, c)
            at = link_index(state, s, c)
            total += link_value(spec, state, energy_between, s, g, c, far, k, at)
    return total


@kernel
def elastic_energy(spec: ti.template(), state: ti.template()) -> ti.f64:
    """Sum over links, then over the graph's half-springs, half of each."""
    if ti.static(spec.kinds > 0):
        add_up(spec, state, 0, links_energy, 0)
    total = 0.0
    if ti.static(spec.kinds > 0):
        for _ in range(1):
            total += state.sums[0, 0]
    if ti.static(spec.springs):
        for p in range(state.n_csr_rows[None]):
            i = state.csr_slot[p]
            for h in range(state.csr_start[p], state.csr_start[p + 1]):
                numbers = [
                    number(spec, field, h) for field in ti.static(fields_of(spec, state, "csr"))
                ]
                j = state.csr_other[h]
                if j != i:  # else it is gone
                    total += 0.5 * energy_between(spec, state, slot_value, i, j, numbers)
    return total


@pytest.mark.parametrize("topology", mostly_thorough(["lanes", "graph"], default=["lanes"]))
def test_the_energy_of_springs_can_be_summed(topology, device):
    sim = Simulation(mixed(2), topology=topology, execution="parallel", lanes=2)
    sim.advance(30)  # some springs are gone
    alive = sim.springs_alive()
    assert alive.any() and not alive.all()
    add_sums(sim, 1)
    energy = elastic_energy(spec_of(sim), state_of(sim))
    assert energy == pytest.approx(sim.energy().elastic, rel=1e-12)


@ti.func
def kinetic_energy_of(spec: ti.template(), state: ti.template(), c):
    w, v = read(spec, state.w, c), read(spec, state.v, c)
    return ti.select(w > 0.0, 0.5 * dot(v, v) / w, 0.0 * w)


@ti.func
def sum_kinetic_energy(spec: ti.template(), state: ti.template(), t):
    """A method that moves nothing and adds up over all packs, in the middle of a step."""
    add_up(spec, state, t, kinetic_energy_of, 0)


def test_sums_over_packs_are_the_same_on_every_way(topology, device):
    sums = []
    for path in ("serial", "parallel"):
        scene = cloth(9, 7, LINKS[:2], speed=1.0)
        sim = Simulation(scene, topology=topology, execution=path, lanes=4)
        add_sums(sim, 1)
        take_step(sim, sum_kinetic_energy)
        sums.append(state_of(sim).sums[0, 0])
        assert sums[-1] == pytest.approx(sim.energy().kinetic, rel=1e-13)
    assert sums[0] == sums[1]
