"""GLB: meshes where their scene, their skin and their morph targets have them."""

import numpy as np
import pytest
import trimesh
from gltf import CORNERS, GLTF, SQUARE_GLTF, glb, gltf, primitive

from taichi_cloth.errors import InputError
from taichi_cloth.files import meshes


def test_meshes_of_a_glb_are_joined_where_its_scene_has_them(tmp_path):
    apart = trimesh.transformations.translation_matrix([3, 0, 0]) @ np.diag([2.0, 2.0, 2.0, 1.0])
    beside = trimesh.transformations.translation_matrix([1, 0, 0])
    (tmp_path / "two.glb").write_bytes(glb(np.eye(4), beside, apart))
    surface = meshes.read(tmp_path / "two.glb")
    assert surface.parts() == 2 and len(surface.vertices) == 6 + 4  # an edge of two is shared
    np.testing.assert_array_equal(surface.vertices.max(axis=0), [5, 2, 0])


def test_parts_of_a_glb_have_one_order(tmp_path):
    """Nodes by their names, of each the primitives of its materials: numbers that pin vertices."""
    there = {**GLTF["accessors"][0], "bufferView": 2}
    content = gltf(
        (*SQUARE_GLTF, (CORNERS + [5, 0, 0]).astype("<f4")),
        accessors=[*GLTF["accessors"], there],
        meshes=[{"primitives": [
            *primitive()[0]["primitives"], *primitive(attributes={"POSITION": 2})[0]["primitives"]
        ]}],
        nodes=[
            {"name": "b", "mesh": 0},
            {"name": "up", "children": [2], "translation": [0, 0, 9], "scale": [2, 2, 2]},
            {"name": "a", "mesh": 0, "rotation": [0, 0, 1, 1]},
        ],
        scenes=[{"nodes": [0, 1]}],
    )  # fmt: skip
    (tmp_path / "parts.glb").write_bytes(content)
    found = meshes.read(tmp_path / "parts.glb")
    first = [[0, 0, 9], [0, 10, 9], [0, 0, 0], [5, 0, 0]]
    np.testing.assert_allclose(found.vertices[::4], first, atol=1e-12)
    assert found.parts() == 4


def read(path, content):
    path.write_bytes(content)
    return meshes.read(path).vertices


def by_columns(*matrices):
    """Matrices (4, 4) as a table of a file has them."""
    return np.stack([np.asarray(m, float).T.ravel() for m in matrices]).astype("<f4")


def skinned(tmp_path, joints, inverse, weights, nodes, numbers="u1", **about):
    """The vertices of a square with a skin: joints of node 0; weights and numbers, (4, 4)."""
    of, by = joints.astype(numbers), np.asarray(weights)
    kinds = {"<f4": 5126, "u1": 5121, "<u2": 5123}
    tables = (*SQUARE_GLTF, of, by, by_columns(*inverse))
    accessors = [
        *GLTF["accessors"],
        {"bufferView": 2, "componentType": kinds[numbers], "count": 4, "type": "VEC4"},
        {"bufferView": 3, "componentType": kinds[by.dtype.str.replace("|", "")], "count": 4,
         "type": "VEC4", "normalized": by.dtype.kind == "u"},
        {"bufferView": 4, "componentType": 5126, "count": len(inverse), "type": "MAT4"},
    ]  # fmt: skip
    attributes = {"POSITION": 0, "JOINTS_0": 2, "WEIGHTS_0": 3}
    content = gltf(
        tables,
        accessors=accessors,
        meshes=primitive(attributes=attributes),
        nodes=[{"mesh": 0, "skin": 0, "translation": [9, 9, 9], "scale": [5, 5, 5]}, *nodes],
        skins=[{"joints": list(range(1, 1 + len(inverse))), "inverseBindMatrices": 4}],
        **about,
    )
    return read(tmp_path / "skin.glb", content)


def test_a_skin_places_a_mesh_by_its_joints_and_not_by_its_node(tmp_path):
    """Each vertex by its weights; a joint's place is that of the nodes above it, too."""
    turn = [0, 0, np.sqrt(0.5), np.sqrt(0.5)]  # a quarter about z: x to y, y to -x
    nodes = [
        {"translation": [0, 0, 2], "scale": [2, 2, 2], "children": [2]},
        {"translation": [1, 0, 0], "rotation": turn},
    ]
    first, second = np.eye(4), np.eye(4)
    first[:3, 3], second[:3, 3] = (0, 0, -1), (0, 0, 3)
    weights = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [1, 1, 0, 0], [3, 1, 0, 0]], float)
    weights /= weights.sum(axis=1, keepdims=True)
    joints = np.tile([0, 1, 0, 0], (4, 1))
    one = 2 * (CORNERS + [0, 0, -1]) + [0, 0, 2]
    x, y, z = (CORNERS + [0, 0, 3]).T
    other = 2 * (np.stack([-y, x, z], axis=1) + [1, 0, 0]) + [0, 0, 2]
    expected = weights[:, :1] * one + weights[:, 1:2] * other
    scenes = [{"nodes": [0, 1]}]
    for kind, numbers in (("<f4", "u1"), ("u1", "<u2"), ("<u2", "u1")):
        parts = weights if kind == "<f4" else weights * np.iinfo(kind).max
        given = parts.astype(kind) if kind == "<f4" else np.rint(parts).astype(kind)
        found = skinned(tmp_path, joints, (first, second), given, nodes, numbers, scenes=scenes)
        np.testing.assert_allclose(found, expected, atol=2e-2 if kind == "u1" else 1e-4)


def test_a_skin_in_centimetres_keeps_the_size_of_its_mesh(tmp_path):
    """As rigs are exported: all joints a hundredth, and their inverse a hundredfold."""
    weights = np.tile([1, 0, 0, 0], (4, 1)).astype("<f4")
    nodes = [{"scale": [0.01] * 3}]
    joints = np.zeros((4, 4), int)
    found = skinned(tmp_path, joints, [np.diag([100, 100, 100, 1])], weights, nodes)
    np.testing.assert_allclose(found, CORNERS, atol=1e-7)


def test_a_skin_without_joints_is_refused_by_name(tmp_path):
    content = gltf(nodes=[{"mesh": 0, "skin": 0}, {}], skins=[{"joints": [1]}])
    with pytest.raises(InputError, match="it has a mesh with a skin, but without joints"):
        read(tmp_path / "none.glb", content)


def test_morph_targets_move_a_mesh_by_their_weights(tmp_path):
    """Those of the node, else those of the mesh; a target may be sparse, or move nothing."""
    moved = np.array([[0, 0, 1], [0, 0, 2], [0, 0, 3], [0, 0, 4]], "<f4")
    sparse = {
        "count": 4, "componentType": 5126, "type": "VEC3",
        "sparse": {
            "count": 1,
            "indices": {"bufferView": 3, "componentType": 5121},
            "values": {"bufferView": 4},
        },
    }  # fmt: skip
    tables = (*SQUARE_GLTF, moved, np.array([2], "u1"), np.array([[5, 0, 0]], "<f4"))
    of_mesh = primitive(targets=[{"POSITION": 2}, {"NORMAL": 2}, {"POSITION": 3}])
    accessors = [*GLTF["accessors"], {**GLTF["accessors"][0], "bufferView": 2}, sparse]
    for weights, node, expected in (
        (None, None, CORNERS),
        ([0.5, 1.0, 0.0], None, CORNERS + 0.5 * moved),
        ([0.5, 1.0, 0.0], [0.0, 0.0, 2.0], CORNERS + 10.0 * np.outer([0, 0, 1, 0], [1, 0, 0])),
    ):
        mesh = {**of_mesh[0], **({"weights": weights} if weights else {})}
        nodes = [{"mesh": 0, **({"weights": node} if node else {})}]
        found = read(
            tmp_path / "morph.glb", gltf(tables, accessors=accessors, meshes=[mesh], nodes=nodes)
        )
        np.testing.assert_allclose(found, expected)


def test_vertices_that_no_face_uses_are_left_out(tmp_path):
    """As of accessors that several primitives share."""
    points = np.concatenate([[[7, 7, 7]], CORNERS, [[8, 8, 8]]]).astype("<f4")
    content = gltf(
        (points, SQUARE_GLTF[1] + np.uint16(1)),
        accessors=[{**GLTF["accessors"][0], "count": 6}, GLTF["accessors"][1]],
    )
    np.testing.assert_array_equal(read(tmp_path / "shared.glb", content), CORNERS)
