"""Springs, as links of grids or on a graph: what they give the particles that they tie, summed.

What a spring between two particles contributes is a ti.func `between(spec, state, value, i, j,
numbers)`: what i gets from the spring to j; j gets the opposite. It reads fields by
`value(spec, field, i)`, of whole packs of a grid or of single particles of a graph; `numbers` is
the list of the spring's (`spring_numbers.py`). `accumulate` sums `between` over the springs of each
pack and hands the sum to `consume(spec, state, i, sum)`. Forces are one such contribution, a
product with the stiffness matrix is another, for which a solver keeps what it takes of each spring
(`spring_numbers.OfStiffness`). There are no races and no atomics, so that a sum has
the same bits on every run, for every number of threads.

What a spring pulls with is the sum of those terms of the scene that act along springs (`forces/`);
it is put together here alone.
"""

import functools

import taichi as ti

from taichi_cloth.kernels import laws
from taichi_cloth.kernels.compensated import difference
from taichi_cloth.kernels.forces import load
from taichi_cloth.kernels.forces.contract import TENSION, has
from taichi_cloth.kernels.graph import copy_ends, sum_of_columns, sum_of_half_springs
from taichi_cloth.kernels.links import Pass, pass_over_grids, sum_of_links
from taichi_cloth.kernels.loops import each, each_pack, each_pack_moving, join, join_parts
from taichi_cloth.kernels.packs import read, slot_value, zeros
from taichi_cloth.kernels.stencils import pull_listed, sum_of_lines, sum_of_listed

# --- the terms along a spring --------------------------------------------------------------------


def _tensions(spec):
    """The terms of a specialization that act along springs."""
    found = [load(name) for name in spec.terms]
    return [term for term in found if term.adds == TENSION]


def reads_velocity(spec):
    """True if springs have damping: a particle's force then depends on neighbours' velocities."""
    return any(has(term.damping) for term in _tensions(spec))


def _parts(spec, part):
    """The functions that are one part ("law", "damping", ...) of the terms that have this part."""
    return [getattr(term, part) for term in _tensions(spec) if has(getattr(term, part))]


@ti.func
def pull(spec: ti.template(), d, dv, numbers: ti.template()):
    """The length, direction and tension of springs; the direction is zero where the ends coincide.

    d: vectors from one end to the other; dv: velocity of the other end relative to the first.
    """
    length = laws.length(d)
    along = laws.unit(d, length)
    tensions = [law(length, along, dv, numbers) for law in ti.static(_parts(spec, "law"))]
    return length, along, sum_of(tensions)


@ti.func
def stiffness_along(spec: ti.template(), dt, numbers: ti.template()):
    """The sum of dt times the stiffness of springs along their axes, and of their damping.

    It is by how much a spring's tension at the end of dt grows with the speed at which the spring
    lengthens [force / velocity].
    """
    parts = [dt * part(numbers) for part in ti.static(_parts(spec, "stiffness"))]
    total = sum_of(parts)
    for damping in ti.static(_parts(spec, "damping")):
        total += damping(numbers)
    return total


@ti.func
def stiffness_across(spec: ti.template(), length, numbers: ti.template(), least):
    """The stiffness of springs across their axes, at least `least` times that along them."""
    parts = [across(length, numbers, least) for across in ti.static(_parts(spec, "across"))]
    return sum_of(parts)


@ti.func
def stiffness_of_springs(spec: ti.template(), d, tau, numbers: ti.template(), least):
    """The axis of springs' stiffness matrices, and the stiffness across it [force / length].

    These make the matrix (`laws.stiffness_axis`) whose product with a movement of the other end is
    the change of the force on one end.
    d: vectors from one end to the other; tau: the time of the movement, in which a velocity changes
    by it over tau, so that dashpots count as stiffness, too; least: what the stiffness across is at
    least, times that along.
    """
    length = laws.length(d)
    stiffness = sum_of([part(numbers) for part in ti.static(_parts(spec, "stiffness"))])
    for damping in ti.static(_parts(spec, "damping")):
        stiffness += (1.0 / tau) * damping(numbers)
    across = stiffness_across(spec, length, numbers, least)
    return [laws.stiffness_axis(laws.unit(d, length), stiffness, across), across]


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
    """The force on i of the spring to j, with its dashpot: a contribution for `accumulate`."""
    return force_along(spec, state, value, i, j, difference(spec, state, value, i, j), numbers)


@ti.func
def force_along(
    spec: ti.template(), state: ti.template(), value: ti.template(), i, j, d, numbers: ti.template()
):
    """The same, where d are the vectors from i to j."""
    dv = 0.0 * d
    if ti.static(reads_velocity(spec)):
        dv = value(spec, state.v, j) - value(spec, state.v, i)
    _, along, tension = pull(spec, d, dv, numbers)
    return tension * along


# --- sums over the springs of each particle ------------------------------------------------------


@ti.func
def accumulate(
    spec: ti.template(),
    state: ti.template(),
    t,
    between: ti.template(),
    apart: ti.template(),
    consume: ti.template(),
    consume_graph: ti.template(),
):
    """Run consume(spec, state, i, sum over its springs and stencils) for every pack i.

    between: see the head of this file. apart: the vectors that stencils sum (`stencils.py`). With
    several lanes on grids `consume` may already move its pack (see `links.pass_over_rows`); else it
    must leave what others read.
    consume_graph(spec, state, slot, sum): takes the sum over what a particle has on the graph, in
    scenes with grids; it comes after all `consume`.
    """
    pull_listed(spec, state, t, apart)
    if ti.static(spec.passes_over_rows):
        pass_over_grids(spec, state, t, ti.static(Pass(between, apart, consume)))
    elif ti.static(spec.packed_rows):
        each(spec, state, t, state.n_copies[None], copy_ends)
        each_pack(spec, state, t, ti.static(_summing(between, apart, consume)))
    else:
        each(spec, state, t, state.n_packs[None], ti.static(_summing(between, apart, consume)))
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
    apart: ti.template(),
    consume: ti.template(),
):
    """Run move(spec, state, i) for every pack i, then consume(spec, state, i, sum over its links).

    Both are done in one pass over memory, which only packs of several lanes allow. `consume` may
    move its pack again. Springs on the graph are left out.
    """
    pass_over_grids(spec, state, t, ti.static(Pass(between, apart, consume, move)))


@ti.func
def accumulate_and_join(
    spec: ti.template(), state: ti.template(), t, of: ti.template(), consume_graph: ti.template()
):
    """Move all packs as the pass `of` does, accumulate as it does, then join its numbers.

    of: a `links.Pass`, whose `consume` may store what neighbours do not read, and whose numbers end
    in state.sums[k, 0]. consume_graph: as for `accumulate`. With several lanes, and no springs on
    the graph, all of it is one pass over memory.
    """
    if ti.static(spec.lanes > 1 and not spec.springs):
        pass_over_grids(spec, state, t, of)
        join_parts(spec, state, t, ti.static(of.ops))
    else:
        each_pack_moving(spec, state, t, ti.static(of.move))
        accumulate(spec, state, t, of.between, of.apart, of.consume, consume_graph)
        join(spec, state, t, of.numbers, ti.static(of.ops))


@functools.cache
def _summing(between, apart, consume):
    """The body of a loop over packs that hands each pack's sum to `consume`."""

    @ti.func
    def body(spec: ti.template(), state: ti.template(), i):
        consume(spec, state, i, sum_at_pack(spec, state, between, apart, i))

    return body


@functools.cache
def _summing_more(between, consume_graph):
    """The body of a loop over compressed rows that hands each row's sum to `consume_graph`."""

    @ti.func
    def body(spec: ti.template(), state: ti.template(), p):
        slot = state.csr_slot[p]
        total = sum_of_half_springs(spec, state, slot_value, between, p, slot)
        if ti.static(spec.stencils):
            total += sum_of_listed(spec, state, p)
        consume_graph(spec, state, slot, total)

    return body


@ti.func
def sum_at_pack(
    spec: ti.template(), state: ti.template(), between: ti.template(), apart: ti.template(), i
):
    """The sum over springs and stencils of pack i, with each computed from all of its particles."""
    total = zeros(spec, state)
    if ti.static(spec.kinds > 0):
        total = sum_of_links(spec, state, between, i)
        if ti.static(spec.line_kinds > 0):
            total += sum_of_lines(spec, state, apart, i)
    elif ti.static(spec.packed_rows):
        total = sum_of_columns(spec, state, between, i)
    elif ti.static(spec.springs):
        total = sum_of_half_springs(spec, state, read, between, i, i)
        if ti.static(spec.stencils):
            total += sum_of_listed(spec, state, i)
    return total
