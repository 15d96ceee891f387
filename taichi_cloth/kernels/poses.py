"""Poses of obstacles at both ends of a step, and the motion of their points.

A pose is a centre and a matrix, whose columns are the axes of the obstacle's own frame: a local
point q is at centre + matrix q. Obstacles move with constant velocities along and about their
centres, from where they are at time 0, for a span of time. Their poses are computed once a step, in
f64 also where the state is in f32 (`clock.py`), so that they go smoothly and what lies on them does
not tremble.
"""

import taichi as ti

from taichi_cloth.kernels.clock import time_at_end, time_at_start, wide
from taichi_cloth.kernels.loops import each
from taichi_cloth.kernels.obstacles import load
from taichi_cloth.kernels.sine import sine_and_cosine

START, END, NEXT = range(3)  # of a step; mean rates in the next one, where particles are held


def spins(dim):
    """The size of an angular velocity."""
    return 1 if dim == 2 else 3


def pose_size(dim):
    """The size of a pose: the centre, then the matrix row by row."""
    return dim + dim * dim


def start_size(dim):
    """The size of a row of state.obstacle_start: pose at time 0, velocity, spin, span."""
    return pose_size(dim) + dim + spins(dim) + 2


def poses_size(spec):
    """The size of a row of state.obstacle_pose: the poses at both ends, and rates."""
    return (3 if spec.held else 2) * pose_size(spec.dim)


@ti.func
def place_obstacles(spec: ti.template(), state: ti.template(), t):
    """Compute the poses of all obstacles at both ends of the present step."""
    each(spec, state, t, state.n_obstacles[None], _place)


@ti.func
def _place(spec: ti.template(), state: ti.template(), o):
    start = moved_for(spec, state, o, time_at_start(state))
    end = moved_for(spec, state, o, time_at_end(state))
    dt = wide(state, state.dt[None]) + wide(state, state.dt_low[None])
    at_start, at_end = pose_after(spec, state, o, start), pose_after(spec, state, o, end)
    size = ti.static(pose_size(spec.dim))
    for k in ti.static(range(pose_size(spec.dim))):
        state.obstacle_pose[o, k] = ti.cast(at_start[k], state.real)
        state.obstacle_pose[o, size + k] = ti.cast(at_end[k], state.real)
    span = ti.static(start_size(spec.dim) - 2)
    part = 1.0 + 0.0 * dt
    if time_at_start(state) < wide(state, state.obstacle_start[o, span]) or time_at_end(
        state
    ) > wide(state, state.obstacle_start[o, span + 1]):
        part = (end - start) / dt
    state.obstacle_part[o] = ti.cast(part, state.real)


@ti.func
def place_next(spec: ti.template(), state: ti.template(), o):
    """Compute the mean rates at which the pose of obstacle o changes in the next step."""
    dt = wide(state, state.dt[None]) + wide(state, state.dt_low[None])
    now = pose_after(spec, state, o, moved_for(spec, state, o, time_at_end(state)))
    then = pose_after(spec, state, o, moved_for(spec, state, o, time_at_end(state) + dt))
    first = ti.static(NEXT * pose_size(spec.dim))
    for k in ti.static(range(pose_size(spec.dim))):
        state.obstacle_pose[o, first + k] = ti.cast((then[k] - now[k]) / dt, state.real)


@ti.func
def moved_for(spec: ti.template(), state: ti.template(), o, time):
    """For how long obstacle o has moved at a time."""
    span = ti.static(start_size(spec.dim) - 2)
    begin = wide(state, state.obstacle_start[o, span])
    return ti.min(ti.max(time, begin), wide(state, state.obstacle_start[o, span + 1])) - begin


@ti.func
def pose_after(spec: ti.template(), state: ti.template(), o, time):
    """The pose of obstacle o after it has moved for a time, (pose_size,) in f64."""
    dim = ti.static(spec.dim)
    size = ti.static(pose_size(spec.dim))
    pose = ti.Vector.zero(state.wide, ti.static(pose_size(spec.dim)))
    for axis in ti.static(range(dim)):
        moved = wide(state, state.obstacle_start[o, size + axis]) * time
        pose[axis] = wide(state, state.obstacle_start[o, axis]) + moved
    spin = [state.obstacle_start[o, size + dim + k] for k in ti.static(range(spins(spec.dim)))]
    x, y, z = wide(state, 0.0), wide(state, 0.0), wide(state, spin[0])
    if ti.static(spec.dim == 3):
        x, y, z = wide(state, spin[0]), wide(state, spin[1]), wide(state, spin[-1])
    rate = ti.sqrt(x * x + y * y + z * z)
    if rate > 0.0:
        x, y, z = x / rate, y / rate, z / rate
    s, c = sine_and_cosine(state.wide, rate * time)
    d = 1.0 - c
    # Rodrigues' matrix, row by row (`contract.about`); in 2-D only its first two rows and columns.
    turn = [
        [c + d * x * x, d * x * y - s * z, d * x * z + s * y],
        [d * x * y + s * z, c + d * y * y, d * y * z - s * x],
        [d * x * z - s * y, d * y * z + s * x, c + d * z * z],
    ]
    for a in ti.static(range(spec.dim)):
        for b in ti.static(range(spec.dim)):
            total = wide(state, 0.0)
            for k in ti.static(range(spec.dim)):
                column = ti.static(spec.dim * (k + 1)) + b
                total += turn[a][k] * wide(state, state.obstacle_start[o, column])
            pose[ti.static(spec.dim * (a + 1) + b)] = total
    return pose


def _first(spec, end):
    """The place of a pose among an obstacle's numbers; one at rest is read at one end alone."""
    return pose_size(spec.dim) * (END if end == START and not spec.moving else end)


@ti.func
def _vector(
    spec: ti.template(), state: ti.template(), o, first: ti.template(), stride: ti.template()
):
    """Every stride-th number of obstacle o's poses from `first`, (dim,)."""
    return ti.Vector([state.obstacle_pose[o, first + k * stride] for k in range(spec.dim)])


@ti.func
def centre_of(spec: ti.template(), state: ti.template(), o, end: ti.template()):
    """The centre (dim,) of obstacle o at one end of the step."""
    return _vector(spec, state, o, ti.static(_first(spec, end)), 1)


@ti.func
def to_local(spec: ti.template(), state: ti.template(), o, end: ti.template(), d):
    """A vector d (dim,) of the world in the frame of obstacle o at one end of the step."""
    first = ti.static(_first(spec, end) + spec.dim)
    q = d[0] * _vector(spec, state, o, first, 1)
    for row in ti.static(range(1, spec.dim)):
        q += d[row] * _vector(spec, state, o, ti.static(first + row * spec.dim), 1)
    return q


@ti.func
def to_world(spec: ti.template(), state: ti.template(), o, end: ti.template(), q):
    """A vector q (dim,) of the frame of obstacle o at one end of the step, in the world."""
    first = ti.static(_first(spec, end) + spec.dim)
    d = q[0] * _vector(spec, state, o, first, spec.dim)
    for column in ti.static(range(1, spec.dim)):
        d += q[column] * _vector(spec, state, o, ti.static(first + column), spec.dim)
    return d


@ti.func
def velocity_at(spec: ti.template(), state: ti.template(), o, r):
    """The velocity of the point of obstacle o that is at r (dim,) from its centre."""
    at = ti.static(pose_size(spec.dim))
    v = 0.0 * r
    if ti.static(spec.moving):
        for axis in ti.static(range(spec.dim)):
            v[axis] = state.obstacle_start[o, at + axis]
        first = ti.static(at + spec.dim)
        if ti.static(spec.dim == 2):
            spin = state.obstacle_start[o, first]
            v[0] += -1.0 * spin * r[1]
            v[1] += spin * r[0]
        else:
            for axis in ti.static(range(3)):
                b, c = ti.static((axis + 1) % 3), ti.static((axis + 2) % 3)
                v[axis] += state.obstacle_start[o, first + b] * r[c]
                v[axis] += -1.0 * state.obstacle_start[o, first + c] * r[b]
        v = state.obstacle_part[o] * v
    return v


@ti.func
def signed_distance(spec: ti.template(), state: ti.template(), o, q):
    """The distance of obstacle o's surface from the local point q, and its normal there."""
    d, n = q[0], 0.0 * q
    for s in ti.static(range(len(spec.obstacles))):
        if state.obstacle_shape[o] == s:
            new_d, new_n = ti.static(load(spec.obstacles[s]).distance)(spec, state, o, q)
            d, n = new_d, new_n
    return d, n
