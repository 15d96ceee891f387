"""Springs on both topologies: what they give the particles that they tie, summed without a race.

Whatever a spring between two particles contributes is a ti.func `between(spec, state, value, i, j,
numbers)`: what particle i gets from the spring to j, of which j gets the opposite. It reads fields
by `value(spec, field, i)`: of whole packs of a grid, or of single particles of a graph; `numbers`
are the spring's (`spring_numbers.py`). `accumulate` sums it over the springs of each pack and hands
the sum to `consume(spec, state, i, sum)`. Forces are one such contribution, a product with the
stiffness matrix is another. No atomics: the same bits on every run, for every number of threads.

What a spring pulls with is the sum of the terms along springs that the scene has (`forces/`); it is
composed here alone.
"""

import functools

import taichi as ti

from taichi_cloth.kernels import laws
from taichi_cloth.kernels.compensated import difference
from taichi_cloth.kernels.forces import load
from taichi_cloth.kernels.forces.contract import TENSION, has
from taichi_cloth.kernels.graph import sum_of_half_springs
from taichi_cloth.kernels.links import grid_share, move_row, pass_over_grids, sum_of_links
from taichi_cloth.kernels.loops import barrier, each, leave
from taichi_cloth.kernels.packs import dot, read, scaled, slot_value, zeros

# --- the terms along a spring --------------------------------------------------------------------


def _tensions(spec):
    found = [load(name) for name in spec.terms]
    return [term for term in found if term.adds == TENSION]


def reads_velocity(spec):
    """Whether what a spring gives depends on how fast its ends move: on neighbours' velocities."""
    return any(has(term.damping) for term in _tensions(spec))


def _parts(spec, part):
    """The ti.funcs that are a part of the terms along springs, of those that have it."""
    return [getattr(term, part) for term in _tensions(spec) if has(getattr(term, part))]


@ti.func
def pull(spec: ti.template(), d, dv, numbers: ti.template()):
    """(length, direction, tension) of springs.

    d: from one end to the other; dv: velocity of the other end relative to that one. Of ends that
    coincide there is no direction: it is zero.
    """
    length = laws.length(d)
    along = laws.unit(d, length)
    tensions = [law(length, along, dv, numbers) for law in ti.static(_parts(spec, "law"))]
    return length, along, sum_of(tensions)


@ti.func
def stiffness_along(spec: ti.template(), dt, numbers: ti.template()):
    """By how much the impulse of springs over dt grows with the speed at which they lengthen:
    dt times their stiffness, and their damping.
    """
    parts = [dt * part(numbers) for part in ti.static(_parts(spec, "stiffness"))]
    total = sum_of(parts)
    for damping in ti.static(_parts(spec, "damping")):
        total += damping(numbers)
    return total


@ti.func
def stiffness_across(spec: ti.template(), length, numbers: ti.template(), least):
    """Stiffness of springs across their axes, at least `least` times that along them."""
    parts = [across(length, numbers, least) for across in ti.static(_parts(spec, "across"))]
    return sum_of(parts)


@ti.func
def stiffness_product(
    spec: ti.template(), moved, length, along, tau, numbers: ti.template(), least
):
    """What springs, of that length and direction, give one end where the other one is `moved`
    relative to it, at the velocity moved / tau: their stiffness and damping matrices times it.
    """
    parts = [part(numbers) for part in ti.static(_parts(spec, "stiffness"))]
    across = stiffness_across(spec, length, numbers, least)
    product = laws.stiffness_product(moved, along, sum_of(parts), across)
    for damping in ti.static(_parts(spec, "damping")):
        product += scaled((1.0 / tau) * damping(numbers) * dot(moved, along), along)
    return product


@ti.func
def sum_of(parts: ti.template()):
    """The sum of a list, from its first to its last."""
    total = parts[0]
    for n in ti.static(range(1, len(parts))):
        total += parts[n]
    return total


@ti.func
def force_between(
    spec: ti.template(), state: ti.template(), value: ti.template(), i, j, numbers: ti.template()
):
    """Force of a spring, with its dashpot, on i."""
    d = difference(spec, state, value, i, j)
    dv = 0.0 * d
    if ti.static(reads_velocity(spec)):
        dv = value(spec, state.v, j) - value(spec, state.v, i)
    _, along, tension = pull(spec, d, dv, numbers)
    return scaled(tension, along)


# --- sums over the springs of each particle ------------------------------------------------------


@ti.func
def accumulate(
    spec: ti.template(),
    state: ti.template(),
    t,
    between: ti.template(),
    consume: ti.template(),
    consume_graph: ti.template(),
):
    """For every pack i: consume(spec, state, i, sum over its springs).

    In lanes `consume` may already move its pack (see `links.pass_over_rows`); elsewhere it must leave what others
    read. consume_graph(spec, state, slot, sum): for the springs that no grid holds, in scenes with
    grids; it comes after all `consume`.
    """
    if ti.static(spec.lanes > 1):
        pass_over_grids(spec, state, t, leave, between, consume)
    else:
        each(spec, state, t, state.n_packs[None], ti.static(_summing(between, consume)))
    if ti.static(spec.springs and spec.kinds > 0):
        each(
            spec, state, t, state.n_csr_rows[None], ti.static(_summing_more(between, consume_graph))
        )


@ti.func
def move_and_accumulate(
    spec: ti.template(),
    state: ti.template(),
    t,
    move: ti.template(),
    between: ti.template(),
    consume: ti.template(),
):
    """In lanes alone: move(spec, state, i) for every pack, then, in the same pass over memory, for
    each one that receives: consume(spec, state, i, sum over its springs), which may move it again.
    """
    for g in range(state.n_grids[None]):
        begin = grid_share(spec, state.grid[g, 1], t)
        end = grid_share(spec, state.grid[g, 1], t + 1)
        # What others' links reach, and what is behind the row that a pass moves first.
        for r in range(begin, ti.min(begin + spec.depth, end)):
            move_row(spec, state, g, r, move)
        for r in range(ti.max(begin + spec.depth, end - spec.depth), end):
            move_row(spec, state, g, r, move)
    barrier(spec, state)
    pass_over_grids(spec, state, t, move, between, consume)


@functools.cache
def _summing(between, consume):
    @ti.func
    def body(spec: ti.template(), state: ti.template(), i):
        consume(spec, state, i, sum_at_pack(spec, state, between, i))

    return body


@functools.cache
def _summing_more(between, consume_graph):
    @ti.func
    def body(spec: ti.template(), state: ti.template(), p):
        slot = state.csr_slot[p]
        total = sum_of_half_springs(spec, state, slot_value, between, p, slot)
        consume_graph(spec, state, slot, total)

    return body


@ti.func
def sum_at_pack(spec: ti.template(), state: ti.template(), between: ti.template(), i):
    """Sum over the springs of pack i, each computed from both of its ends."""
    if ti.static(spec.kinds > 0):
        return sum_of_links(spec, state, between, i)
    elif ti.static(spec.springs):
        return sum_of_half_springs(spec, state, read, between, i, i)
    else:
        return zeros(spec, state)
