"""A closed mesh, by the distances of a grid's nodes from it (a signed distance field).

The distance of a point is interpolated between the nodes of its cell, and so is the normal, from
the slope of the distances at these nodes: a body's edges are as round as a cell is wide. Which side
a node is on: how often a line from it crosses the mesh. Jones, Baerentzen, Sramek, "3D distance
fields: a survey", 2006; near the mesh distances are exact (Ericson, Real-Time Collision Detection,
5.1.5), beyond it they are from the nearest points that other nodes have found.

The mesh is compared with its own field: at points all over it the distance must be 0 within a tenth
of its thickness there (`mesh_thickness.py`). Cells are made as small as its thickness asks, and
smaller until it is met; where they would be too many, or their width is given, it is refused. What
tapers off is as round as a cell that nobody asked to be smaller. Where all that is too thin for any
grid is a small part of the mesh, as the fingers of a body, it is lost, and its place is told of.
"""

import functools
from dataclasses import dataclass

import numpy as np
import taichi as ti

from taichi_cloth.kernels.mesh_thickness import (
    THINNEST,
    badly_met,
    expanded,
    sampled,
)
from taichi_cloth.kernels.obstacles.contract import (
    CELL,
    FACES,
    NUMBER,
    POINT,
    POINTS,
    TEXT,
    TURN,
    Key,
    Placed,
    Shape,
    turned,
)

MOST_NODES = 4_000_000
MOST_CHOSEN = 1_500_000  # of cells that nobody asked for: some ten seconds to compute
CELLS = 32  # along its longest side, where `cell` is absent
BAND = 2  # cells from the mesh within which distances are exact
PAIRS = 500_000  # of nodes and faces that are looked at together


@ti.func
def distance(spec: ti.template(), state: ti.template(), o, q):
    """Interpolated in the grid; outside of it at least the way to it and its margin."""
    cell = state.obstacle_numbers[o, CELL]
    first = state.obstacle_nodes[o, 0]
    at, past = 0.0 * q, 0.0 * q
    base = ti.Vector([0, 0, 0])
    for axis in ti.static(range(3)):
        count = state.obstacle_nodes[o, 1 + axis]
        place = (q[axis] - state.obstacle_low[o, axis]) / cell
        inside = ti.min(ti.max(place, 0.0), ti.cast(count - 1, state.real))
        past[axis] = (place - inside) * cell
        base[axis] = ti.min(ti.cast(inside, ti.i32), count - 2)
        at[axis] = inside - ti.cast(base[axis], state.real)
    d, n = 0.0 * q[0], 0.0 * q
    rows, columns = state.obstacle_nodes[o, 2], state.obstacle_nodes[o, 3]
    for corner in range(8):
        i, j, k = corner % 2, corner // 2 % 2, corner // 4
        node = first + ((base[0] + i) * rows + base[1] + j) * columns + base[2] + k
        weight = ti.select(i == 1, at[0], 1.0 - at[0])
        weight *= ti.select(j == 1, at[1], 1.0 - at[1])
        weight *= ti.select(k == 1, at[2], 1.0 - at[2])
        d += weight * state.obstacle_grid[node, 0]
        for axis in ti.static(range(3)):
            n[axis] += weight * state.obstacle_grid[node, 1 + axis]
    outside, length = ti.sqrt(past.dot(past)), ti.sqrt(n.dot(n))
    if outside > 0.0:
        d, n = outside + state.obstacle_sizes[o, 0], (1.0 / outside) * past
    elif length > 0.0:
        n = (1.0 / length) * n
    else:
        n[2] = 1.0
    return d, n


def refusal(values):
    """Either a file or its contents; what a file may not have, lists may not either."""
    given = [name for name in ("vertices", "faces") if values[name] is not None]
    if values["file"] is not None:
        if given:
            return given[0], f"{given[0]} and file exclude each other; give one of them"
        return "file", "file names a mesh: load the scene from a file, or give vertices and faces"
    for name in ("vertices", "faces"):
        if values[name] is None:
            return None, f"'{name}' is missing; give file, or vertices and faces"
    vertices = np.asarray(values["vertices"], np.float64)
    faces = np.asarray(values["faces"], np.int64)
    if len(faces) == 0:
        return "faces", "faces is empty; give three vertices for each"
    if faces.min() < 0 or faces.max() >= len(vertices):
        wrong = faces[(faces < 0) | (faces >= len(vertices))][0]
        return "faces", f"there is no vertex {wrong}; they are 0 to {len(vertices) - 1}"
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    if (edges[:, 0] == edges[:, 1]).any():
        return "faces", f"face {int((edges[:, 0] == edges[:, 1]).argmax()) // 3} has a corner twice"
    kinds, count = np.unique(edges, axis=0, return_counts=True)
    if (count != 2).any():
        a, b = kinds[(count != 2).argmax()]
        has = int(count[(count != 2).argmax()])
        words = f"{has} face{'s' * (has != 1)} at the edge from vertex {a} to {b}, a closed one 2"
        return "faces", f"the mesh is not closed: it has {words}"
    size = np.ptp(vertices[np.unique(faces)], axis=0) * values["scale"]
    if values["cell"] is not None:
        nodes = np.prod(np.ceil(size / values["cell"]) + 2 * BAND + 3)
        if nodes > MOST_NODES:
            least = values["cell"] * (nodes / MOST_NODES) ** (1 / 3)
            words = f"its grid would have {nodes:.3g} nodes, more than {MOST_NODES:g}"
            return (
                "cell",
                f"cell {values['cell']:g} is too small: {words}; give {least:.2g} or more",
            )
    if not size.min() > 0:
        return "vertices", "the mesh is flat: it has no inside"
    if _covers_itself(vertices, faces):
        return "faces", "the mesh has no inside: each face lies on another one; remove the doubles"
    return _lost(values)


def _lost(values):
    """A note on a mesh whose grid is too coarse for its thin parts."""
    fit = _fitted(*_of_fit(values))
    if fit.lost is None:
        return None
    centre = np.zeros(3) if values["centre"] is None else np.asarray(values["centre"], np.float64)
    place, thin = centre + turned(values["turn"], 3) @ fit.lost[0], fit.lost[1]
    where = ", ".join(f"{number:.4g}" for number in place)
    instead = "make that part an obstacle of its own, such as a box or a capsule, or thicker"
    grid = f"a grid of {MOST_CHOSEN:g} nodes has cells of {fit.cell:.2g}"
    if values["cell"] is not None:
        instead = "leave cell out, or give half of that"
        grid = f"cells of {fit.cell:g} lose what is so thin"
    return (
        "cell",
        f"the mesh is {thin:.2g} thick at ({where}), and {grid}; {instead}; "
        f"or say least = {fit.cell / THINNEST:.2g}, and parts thinner than that may be lost",
    )


def _covers_itself(vertices, faces):
    """Mark faces that lie on others, so that a line crosses the mesh an even number of times."""
    places, place = np.unique(vertices + 0.0, axis=0, return_inverse=True)
    if 2 * len(places) > len(vertices):
        return False
    rows = np.sort(place.ravel()[faces], axis=1)
    return (np.unique(rows, axis=0, return_counts=True)[1] % 2 == 0).all()


def place(values, dim, margin):
    """The mesh at time 0, with its grid."""
    vertices, faces = _scaled(values), np.asarray(values["faces"], np.int64)
    fit = _fitted(*_of_fit(values))
    cell = fit.cell
    low, distances = _widened(fit, float(margin), vertices[faces])
    slopes = np.stack(np.gradient(distances, cell), axis=3)
    nodes = np.concatenate([distances[..., None], slopes], axis=3)
    centre = np.zeros(3) if values["centre"] is None else np.asarray(values["centre"], np.float64)
    bound = float(np.linalg.norm(vertices, axis=1).max())
    clear = float(min(face.min() for axis in range(3) for face in _sides(distances, axis)))
    # It is no thinner than its cells are wide, but for what tapers off.
    return Placed(
        centre,
        turned(values["turn"], dim),
        (clear,),
        thin=cell,
        round=0.5 * cell,
        bound=bound,
        low=low,
        cell=cell,
        nodes=nodes,
        vertices=vertices,
        faces=faces,
        rounded=fit.rounded,
    )


def _sides(distances, axis):
    """The first and the last layer of nodes along an axis."""
    return np.take(distances, 0, axis), np.take(distances, -1, axis)


def _scaled(values):
    return np.asarray(values["vertices"], np.float64) * float(values["scale"])


def _of_fit(values):
    """The arguments of `_fitted`."""
    faces = np.asarray(values["faces"], np.int64)
    cell, least = float(values["cell"] or 0.0), float(values["least"])
    return _scaled(values).tobytes(), faces.tobytes(), cell, least


@dataclass(frozen=True)
class Fit:
    """A grid that a mesh is met by: its low corner (3,), cell, and signed distances at its nodes.

    quickly: whether it has more nodes than usual, none of them asked for. lost: a point (3,) of the
    mesh that it is not met at, and its thickness there; None: none. rounded: likewise where it is
    most rounded off, as it tapers there; and by how much.
    """

    low: np.ndarray
    cell: float
    distances: np.ndarray
    quickly: bool
    lost: tuple[np.ndarray, float] | None
    rounded: tuple[np.ndarray, float] | None


@functools.lru_cache(maxsize=4)
def _fitted(vertices, faces, cell, least):
    """The coarsest grid by which a mesh is met wherever it is as thick as `least`, as a `Fit`.

    Its check and its placing share it. vertices, faces: bytes of float64 and int64 arrays. cell:
    its width; 0: as is needed, first by the mesh's thickness alone.
    """
    corners = np.frombuffer(vertices).reshape(-1, 3)[np.frombuffer(faces, np.int64).reshape(-1, 3)]
    size = np.ptp(corners, axis=(0, 1))
    usual = float(size.max()) / CELLS
    finest = _finest(size)
    samples, now = sampled(corners), cell or usual
    samples = samples.among(samples.thickness >= least)
    grid, worst = None, None
    while True:
        field = None if grid is None else functools.partial(_distances_at, grid[0], now, grid[1])
        error, lost, rounded = badly_met(samples, field, now, max(usual, cell))
        if grid is not None and rounded.any():
            which = np.where(rounded, error, 0.0).argmax()
            worst = samples.points[which], float(error[which])
        quickly = now < usual and not cell
        if not lost.any():
            if grid is not None:
                return Fit(grid[0], now, *grid[1:], quickly, None, worst)
            grid = _grid(corners, now, 0.0, quickly)
            continue
        thin = samples.thickness[lost]
        if cell or now <= finest or THINNEST * np.median(thin) < finest:
            which = np.flatnonzero(lost)[thin.argmin()]
            place = samples.points[which], float(samples.thickness[which])
            none = np.zeros((0, 0, 0))
            return Fit(np.zeros(3), cell or finest, none, quickly, place, worst)
        now = max(finest, min(now / 1.5, max(now / 4.0, 0.5 * float(np.median(thin)))))
        grid, worst = None, None


def _widened(fit, margin, corners):
    """The low corner (3,) of a grid that leaves `margin` free around its mesh, (m, 3, 3), and
    distances at its nodes: those of its fit, if that does, or if a larger one had too many nodes.
    """
    size = np.ptp(corners, axis=(0, 1))
    if _room(size, fit.cell, margin) <= _room(size, fit.cell, 0.0):
        return fit.low, fit.distances
    if fit.quickly and _counts(size, fit.cell, margin).prod() > MOST_CHOSEN:
        return fit.low, fit.distances
    return _grid(corners, fit.cell, margin, fit.quickly)


def _finest(size):
    """The width of cells of which a grid around a mesh of this size (3,) has MOST_CHOSEN."""
    low, high = 0.0, float(size.max()) / CELLS
    for _ in range(40):
        middle = 0.5 * (low + high)
        room = _room(size, middle, 0.0)
        nodes = np.prod(np.ceil((size + 2.0 * room) / middle) + 1.0)
        low, high = (middle, high) if nodes > MOST_CHOSEN else (low, middle)
    return high


def _room(size, cell, margin):
    """The margin of a grid around a mesh of this size (3,)."""
    return max((BAND + 0.5) * cell, min(margin + cell, float(size.max())))


def _counts(size, cell, margin):
    """The nodes along each axis of a grid around a mesh of this size (3,), (3,)."""
    room = _room(size, cell, margin)
    return np.ceil((size + 2.0 * room) / cell).astype(np.int64) + 1


def _grid(corners, cell, margin, quickly):
    """The low corner (3,) of a mesh's grid, and signed distances at its nodes.

    corners: (m, 3, 3). quickly: as grids of many nodes need it (`_spread`).
    """
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    counts = _counts(high - low, cell, margin)
    low = 0.5 * (low + high) - 0.5 * cell * (counts - 1)
    # Not through a vertex or along an edge: a line there would cross two faces or none.
    low = low + cell * np.array([0.0, 1.37e-5, 2.71e-5])
    points = [low[axis] + cell * np.arange(counts[axis]) for axis in range(3)]
    nearest = _nearest_points(corners, low, cell, counts, quickly)
    at = np.stack(np.meshgrid(*points, indexing="ij"), axis=3)
    distances = np.linalg.norm(at - nearest, axis=3)
    distances[_inside(corners, points)] *= -1.0
    return low, distances


def _nearest_points(corners, low, cell, counts, quickly):
    """The point of the mesh nearest to each node (nx, ny, nz, 3); corners: (m, 3, 3).

    A face is looked at only where the ball around it is nearer than any face's middle so far.
    """
    nearest = np.full((*counts, 3), 1e30)
    best = np.full(counts.prod(), np.inf)
    reached = best.copy()
    middles = corners.mean(axis=1)
    radii = np.linalg.norm(corners - middles[:, None], axis=2).max(axis=1)
    flat = nearest.reshape(-1, 3)
    band = 1 if quickly else BAND
    first = np.maximum(np.floor((corners.min(axis=1) - low) / cell).astype(int) - band, 0)
    last = np.minimum(np.ceil((corners.max(axis=1) - low) / cell).astype(int) + band, counts - 1)
    sizes = last - first + 1
    pairs = sizes.prod(axis=1)
    begin = 0
    while begin < len(corners):
        many = np.searchsorted(np.cumsum(pairs[begin:]), PAIRS) + 1
        mine = np.arange(begin, min(begin + many, len(corners)))
        row, inner = expanded(pairs[mine])
        face = mine[row]
        ny, nz = sizes[face, 1], sizes[face, 2]
        node = first[face] + np.column_stack([inner // (ny * nz), inner // nz % ny, inner % nz])
        index = (node[:, 0] * counts[1] + node[:, 1]) * counts[2] + node[:, 2]
        at = low + cell * node
        away = np.linalg.norm(at - middles[face], axis=1)
        np.minimum.at(reached, index, away)
        near = away - radii[face] <= (1.0 + 1e-9) * reached[index]
        face, index, at = face[near], index[near], at[near]
        point = closest_points(at, corners[face])
        distance = np.linalg.norm(at - point, axis=1)
        order = np.argsort(-distance, kind="stable")  # the last of equal indices is what remains
        index, point, distance = index[order], point[order], distance[order]
        better = distance < best[index]
        best[index[better]], flat[index[better]] = distance[better], point[better]
        begin += many
    if quickly:
        _spread(nearest, best.reshape(counts) < np.inf)
    else:
        _pass_on(nearest, low, cell, counts)
    return nearest


def _spread(nearest, known):
    """Give each node the point of the nearest of those that are known, (nx, ny, nz) bool."""
    from scipy.ndimage import distance_transform_edt

    nodes = distance_transform_edt(~known, return_distances=False, return_indices=True)
    nearest[...] = nearest[tuple(nodes)]


def _pass_on(nearest, low, cell, counts):
    """Give each node the nearest of the points that its neighbours have (jump flooding).

    Rong, Tan, "Jump flooding in GPU", 2006.
    """
    at = low + cell * np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=3)
    own = np.linalg.norm(at - nearest, axis=3)
    step = 1 << int(counts.max() - 1).bit_length()
    steps = []
    while step > 1:
        step //= 2
        steps.append(step)
    for step in (*steps, 1):
        for axis in range(3):
            for side in (-1, 1):
                here, there = [slice(None)] * 3, [slice(None)] * 3
                here[axis] = slice(step, None) if side > 0 else slice(None, -step)
                there[axis] = slice(None, -step) if side > 0 else slice(step, None)
                if counts[axis] <= step:
                    continue
                passed = nearest[tuple(there)]
                distance = np.linalg.norm(at[tuple(here)] - passed, axis=3)
                nearer = distance < own[tuple(here)]
                nearest[tuple(here)][nearer] = passed[nearer]
                own[tuple(here)][nearer] = distance[nearer]


def closest_points(p, corners):
    """The point of each triangle (n, 3, 3) that is closest to a point of its own (n, 3).

    Ericson, Real-Time Collision Detection, 5.1.5: by the region of the triangle's plane.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, ac, bc = b - a, c - a, c - b
    best, found = np.full(len(p), np.inf), a.copy()
    normal = np.cross(ab, ac)
    area2 = np.einsum("ij,ij->i", normal, normal)
    with np.errstate(divide="ignore", invalid="ignore"):
        height = np.einsum("ij,ij->i", p - a, normal) / area2
        on = p - height[:, None] * normal
        inside = area2 > 0
        for from_, edge in ((a, ab), (b, bc), (c, -1.0 * ac)):
            inside &= np.einsum("ij,ij->i", np.cross(edge, on - from_), normal) >= 0
    for from_, edge in ((a, ab), (b, bc), (a, ac)):
        length2 = np.einsum("ij,ij->i", edge, edge)
        part = np.einsum("ij,ij->i", p - from_, edge) / np.where(length2 > 0, length2, 1.0)
        point = from_ + np.clip(part, 0.0, 1.0)[:, None] * edge
        distance = np.linalg.norm(p - point, axis=1)
        nearer = distance < best
        found[nearer], best[nearer] = point[nearer], distance[nearer]
    found[inside] = on[inside]
    return found


def _inside(corners, points):
    """Which nodes are inside the mesh (nx, ny, nz): those from which x crosses it an odd number.

    points: the nodes' coordinates along each axis.
    """
    x, y, z = points
    crossings = np.zeros((len(x) + 1, len(y), len(z)), np.int64)
    low, high = corners.min(axis=1), corners.max(axis=1)
    y0, y1 = np.searchsorted(y, low[:, 1]), np.searchsorted(y, high[:, 1])
    z0, z1 = np.searchsorted(z, low[:, 2]), np.searchsorted(z, high[:, 2])
    lines = (y1 - y0) * (z1 - z0)
    ends = np.cumsum(lines)
    begin = 0
    while begin < len(corners):
        end = max(begin + 1, int(np.searchsorted(ends, ends[begin] + PAIRS)))
        row, inner = expanded(lines[begin:end])
        face = begin + row
        column, layer = y0[face] + inner // (z1 - z0)[face], z0[face] + inner % (z1 - z0)[face]
        py, pz = y[column], z[layer]
        a, b, c = corners[face].transpose(1, 2, 0)
        area = (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1])
        with np.errstate(divide="ignore", invalid="ignore"):
            u = ((b[1] - py) * (c[2] - pz) - (b[2] - pz) * (c[1] - py)) / area
            v = ((c[1] - py) * (a[2] - pz) - (c[2] - pz) * (a[1] - py)) / area
            where = u * a[0] + v * b[0] + (1 - u - v) * c[0]
            hit = (area != 0.0) & (u >= 0) & (v >= 0) & (u + v <= 1)
        first = np.searchsorted(x, where[hit])
        np.add.at(crossings, (first, column[hit], layer[hit]), 1)
        begin = end
    odd: np.ndarray = np.cumsum(crossings, axis=0)[:-1] % 2 == 1
    return odd


def twin(placed, q):
    """The law in NumPy."""
    value, past = _interpolated(placed.low, placed.cell, placed.nodes, q)
    d, n = value[:, 0], value[:, 1:]
    length, outside = np.linalg.norm(n, axis=1), np.linalg.norm(past, axis=1)
    n = np.where(length[:, None] > 0, n / np.where(length, length, 1.0)[:, None], [0.0, 0.0, 1.0])
    far = outside > 0
    d[far] = outside[far] + placed.sizes[0]
    n[far] = past[far] / outside[far, None]
    return d, n


def _interpolated(low, cell, nodes, q):
    """Interpolate a grid's nodes (.., k), (n, k), at points (n, 3), and how far these are past it,
    (n, 3)."""
    count = np.array(nodes.shape[:3])
    at = (q - low) / cell
    inside = np.clip(at, 0.0, count - 1)
    base = np.minimum(inside.astype(np.int64), count - 2)
    part = inside - base
    value = np.zeros((len(q), nodes.shape[3]))
    for corner in np.ndindex(2, 2, 2):
        weight = np.where(np.array(corner) == 1, part, 1.0 - part).prod(axis=1)
        value += weight[:, None] * nodes[tuple((base + corner).T)]
    return value, (at - inside) * cell


def _distances_at(low, cell, distances, q):
    return _interpolated(low, cell, distances[..., None], q)[0][:, 0]


def surface(placed, extent):
    """The mesh itself."""
    return placed.vertices, placed.faces


SHAPE = Shape(
    keys=(
        Key("file", TEXT, "a mesh file, relative to the scene's", "", None),
        Key("vertices", POINTS, "its vertices, where there is no file", "length", None),
        Key("faces", FACES, "its triangles, by numbers of vertices", "", None),
        Key("centre", POINT, "where the mesh's origin is", "length", None),
        Key("turn", TURN, "about that, at time 0", "degrees", None),
        Key("scale", NUMBER, "by which vertices are multiplied", "1", 1.0, above=0.0),
        Key("cell", NUMBER, "width of the grid's cells", "length", None, above=0.0),
        Key("least", NUMBER, "thinner parts may be lost", "length", 0.0, minimum=0.0),
    ),
    dims=(3,),
    convex=False,
    refusal=refusal,
    place=place,
    distance=distance,
    twin=twin,
    surface=surface,
)
