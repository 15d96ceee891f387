"""The point of a face that is deepest in an obstacle, against looking everywhere in the face."""

import inside
import numpy as np
import pytest
import taichi as ti
from cloths import loose_sheet

from taichi_cloth.front_end.mending import kernel
from taichi_cloth.kernels.face_distance import nearest
from taichi_cloth.scene.obstacles import Obstacle
from taichi_cloth.simulation.simulation import Simulation

HALF = np.array([0.3, 0.2, 0.25])
FOUND = 6  # least, three shares, whether it is held, the bound


@kernel
def find_nearest(
    spec: ti.template(), state: ti.template(), faces: ti.types.ndarray(), found: ti.types.ndarray()
):
    for m in range(faces.shape[0]):
        a, b, c = (
            ti.Vector.zero(state.real, 3),
            ti.Vector.zero(state.real, 3),
            ti.Vector.zero(state.real, 3),
        )
        for axis in ti.static(range(3)):
            a[axis], b[axis], c[axis] = faces[m, 0, axis], faces[m, 1, axis], faces[m, 2, axis]
        one = 0.0 * a + 1.0
        side = ti.max((b - a).norm(), (c - b).norm(), (a - c).norm())
        least, share, _, held, low = nearest(spec, state, 0, a, b, c, 0.0 * one, one, side)
        found[m, 0], found[m, 4], found[m, 5] = least, held, low
        for k in ti.static(range(3)):
            found[m, 1 + k] = share[k]


def distances(x):
    """Of points (..., 3) from the box around 0."""
    past = np.abs(x) - HALF
    return np.linalg.norm(np.maximum(past, 0.0), axis=-1) + np.minimum(past.max(axis=-1), 0.0)


def least_of(face):
    """The least distance of a face (3, 3), on ever finer grids around the best place so far."""
    part = np.linspace(-1.0, 1.0, 21)
    window = np.column_stack([of.ravel() for of in np.meshgrid(part, part)])
    best, width = np.full(2, 1.0 / 3.0), 1.0
    for _ in range(45):
        two = np.maximum(best + width * window, 0.0)
        two /= np.maximum(two.sum(axis=1, keepdims=True), 1.0)
        shares = np.column_stack([1.0 - two.sum(axis=1), two])
        at = distances(shares @ face)
        best, width = two[at.argmin()], 0.75 * width
    return at.min()


def faces_over_corners(count):
    """Faces that lie over corners of the box, from level to steep, none of whose corners is the
    deepest, (count, 3, 3).
    """
    draws = np.random.default_rng(57)
    made = []
    while len(made) < count:
        steep = draws.choice([0.02, 0.1, 1.0])
        face = draws.normal(size=(3, 3)) * 0.06 * np.array([1.0, steep, 1.0])
        face += HALF + [0.0, 0.006 * draws.random(), 0.0] - draws.dirichlet([1.0, 1.0, 1.0]) @ face
        sides = np.linalg.norm(face - np.roll(face, 1, axis=0), axis=1)
        if np.linalg.norm(np.cross(face[1] - face[0], face[2] - face[0])) > 0.1 * sides.max() ** 2:
            made.append(face)
    return np.array(made) * draws.choice([-1.0, 1.0], size=(count, 1, 3))


@pytest.mark.usefixtures("device", "few_lanes")
def test_the_deepest_point_of_a_face_over_a_corner_is_found():
    """It was up to 0.7 mm off, so a cloth at rest on a corner fell in and was put out again."""
    box = Obstacle.build("box", centre=[5.0, 0.5, 0.0], half=HALF.tolist())
    sim = Simulation(loose_sheet(box), topology="graph", execution="serial")
    faces = faces_over_corners(200)
    found = np.zeros((len(faces), FOUND))
    find_nearest(inside.spec_of(sim), inside.state_of(sim), faces, found)
    least = np.array([least_of(face) for face in faces])
    assert (found[:, 4] == 0.0).all()
    shares = found[:, 1:4]
    assert (shares >= 0.0).all() and shares.sum(axis=1) == pytest.approx(1.0)
    at = np.einsum("mk,mkd->md", shares, faces)
    assert distances(at) == pytest.approx(found[:, 0], abs=1e-7)
    assert found[:, 0] == pytest.approx(least, abs=1e-6)
    assert (found[:, 5] <= least + 1e-7).all()
