"""Makes the shirt that is shipped: `python tests/shirt.py > taichi_cloth/scene/library/shirt.obj`.

Two panels of quads, front and back, are sewn along shoulders, sleeves and sides; open are the neck,
the cuffs and the hem. Metres, y up, x from the left sleeve to the right one.
"""

import numpy as np
from scipy.sparse import coo_array, diags
from scipy.sparse.linalg import spsolve

CELL = 0.02
BODY, SLEEVE = 14, 10  # columns from the middle to the side, and of a sleeve
BELOW, ABOVE = 23, 12  # rows below the armpit, and above
NECK = 5  # columns from the middle to the shoulder's beginning
ARMPIT, COLLAR = BELOW * CELL, 0.70
SHOULDER_SLOPE, SLEEVE_SLOPE, UNDERARM_SLOPE = 0.2, 0.7, 0.45
DIP = {"front": 0.09, "back": 0.025}  # of the neckline
BODY_DEPTH = 0.11  # from the middle plane to the chest


def top(column, panel):
    """The height of a panel's upper end in a column: neckline, shoulder, sleeve."""
    away = abs(column)
    if away < NECK:
        return COLLAR - DIP[panel] * (1 - (away / NECK) ** 2)
    shoulder = COLLAR - SHOULDER_SLOPE * CELL * (min(away, BODY) - NECK)
    return shoulder - SLEEVE_SLOPE * CELL * max(away - BODY, 0)


def height(column, row, panel):
    """The height of a vertex; row BELOW is that of the armpit."""
    if row < BELOW:
        return row * CELL
    low = ARMPIT - UNDERARM_SLOPE * CELL * max(abs(column) - BODY, 0)
    return low + (top(column, panel) - low) * (row - BELOW) / ABOVE


def places():
    """The (column, row) of a panel's vertices."""
    rows = range(BELOW + ABOVE + 1)
    columns = range(-BODY - SLEEVE, BODY + SLEEVE + 1)
    return [(c, r) for r in rows for c in columns if r >= BELOW or abs(c) <= BODY]


def on_seam(column, row):
    """Whether front and back are one there."""
    side = abs(column) == BODY and row <= BELOW
    underarm = abs(column) >= BODY and row == BELOW
    return side or underarm or (row == BELOW + ABOVE and abs(column) >= NECK)


def cells(at):
    """The quads of a panel as places, their corners counterclockwise seen from the front."""
    for c, r in at:
        corners = (c, r), (c + 1, r), (c + 1, r + 1), (c, r + 1)
        inside = r >= BELOW or (c >= -BODY and c + 1 <= BODY)
        if inside and all(corner in at for corner in corners):
            yield corners


def depths(at):
    """How far the cloth stands off the middle plane: the root of the height of a membrane blown up.

    The membrane is held at the seams; where it is a strip, its root is an ellipse.
    """
    number = {place: n for n, place in enumerate(at)}
    ends = {frozenset(e) for q in cells(number) for e in zip(q, q[1:] + q[:1], strict=True)}
    a, b = np.array(
        [[number[place] for place in sorted(end)] for end in sorted(map(sorted, ends))]
    ).T
    n = len(at)
    links = coo_array((np.ones(2 * len(a)), (np.r_[a, b], np.r_[b, a])), shape=(n, n)).tocsr()
    laplacian = (diags(links.sum(axis=1)) - links).tocsr()
    free = np.flatnonzero([not on_seam(*place) for place in at])
    u = np.zeros(n)
    u[free] = spsolve(laplacian[free][:, free].tocsc(), links.sum(axis=1)[free])
    depth = np.sqrt(np.maximum(u, 0))
    return BODY_DEPTH * depth / depth[number[0, 0]]


def shirt():
    """Vertices (n, 3) and quads (m, 4)."""
    at = places()
    depth = depths(at)
    vertices, quads, number = [], [], {}
    for panel, side in (("front", 1), ("back", -1)):
        for place, z in zip(at, depth, strict=True):
            key = place if on_seam(*place) else (*place, panel)
            if key not in number:
                number[key] = len(vertices)
                vertices.append((place[0] * CELL, height(*place, panel), side * z))
        for corners in cells(dict.fromkeys(at)):
            names = [c if on_seam(*c) else (*c, panel) for c in corners]
            quads.append([number[name] for name in names[::side]])
    return np.array(vertices), np.array(quads)


if __name__ == "__main__":
    vertices, quads = shirt()
    print("# A shirt, made by tests/shirt.py: metres, y up; open at neck, cuffs and hem")
    for vertex in vertices.round(5) + 0.0:  # no -0
        print("v", *(f"{c:.5f}" for c in vertex))
    for quad in quads + 1:
        print("f", *quad)
