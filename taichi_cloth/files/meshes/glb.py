"""GLB, the binary form of glTF 2.0: all meshes of its scene joined, each moved as the scene says.

Khronos Group, "glTF 2.0 Specification": 4.4 (12 bytes of header: 'glTF', version, length; then
chunks, the first of JSON, the second of bytes), 3.5 (the scene's nodes), 3.6 (buffers, accessors)
and 3.7 (primitives, skins and morph targets). A mesh is read as it is first shown: its morph
targets by their weights, then its skin by where its joints are; animations are passed over.

Read here and not by a library: trimesh 5 numbers the parts of a mesh of several materials in
another order each time, takes whole numbers that stand for fractions (KHR_mesh_quantization) as
they are, and passes over fans, sparse accessors, and what extensions compress or copy.
"""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from taichi_cloth.errors import InputError, clipped
from taichi_cloth.files.meshes.surface import Polygons, check_counts, merged

HEADER = 12
JSON, BYTES = 0x4E4F534A, 0x004E4942  # kinds of chunks
TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}
TRIANGLES, STRIP, FAN = 4, 5, 6  # other primitives are points and lines
# Extensions without which a file can still be read: what they hold is no geometry, by a word of
# their names, or is read here.
READ = ("KHR_mesh_quantization", "_materials_", "_texture_", "_lights_", "_image_")
INSTANCES = "EXT_mesh_gpu_instancing"

Part = tuple[np.ndarray, np.ndarray]  # vertices (n, 3) and triangles (m, 3)


def read(path: Path, data: bytes) -> Polygons:
    """The triangles of a GLB file's bytes. Raises InputError."""
    if data[:4] != b"glTF":
        raise InputError(f"{path}: is not a GLB file: it does not begin with 'glTF'")
    if len(data) < HEADER:
        raise InputError(f"{path}: is cut short: it has {len(data)} bytes")
    version, length = struct.unpack("<II", data[4:HEADER])
    if version != 2:
        raise InputError(f"{path}: is of glTF version {version}; export it as version 2")
    if length > len(data):
        raise InputError(f"{path}: is cut short: it says {length} bytes and has {len(data)}")
    try:
        parts = _File(path, data[HEADER:length]).parts()
    except InputError:
        raise
    except Exception as error:  # whatever Python and NumPy make of what somebody's file has
        what = clipped(f"{type(error).__name__}: {error}", 120)
        raise InputError(f"{path}: is damaged, or not a GLB file: {what}") from None
    if not parts:
        raise InputError(f"{path}: has no faces; a cloth's springs are the edges of faces")
    first = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    corners = [faces + begin for (_, faces), begin in zip(parts, first[:-1], strict=True)]
    joined = np.concatenate(corners)
    check_counts(path, int(first[-1]), len(joined))
    return merged(
        Polygons(
            vertices=np.concatenate([vertices for vertices, _ in parts]),
            corners=joined.ravel(),
            count=np.full(len(joined), 3, np.int64),
        )
    )


class _File:
    """A GLB file, and its bytes. Methods raise ValueError and others where it is damaged,
    and InputError for what is sound and not read here.
    """

    def __init__(self, path: Path, chunks: bytes):
        self.path, self.bytes = path, memoryview(b"")
        self.matrices: dict[int, np.ndarray] | None = None
        size, kind = struct.unpack_from("<II", chunks)
        if kind != JSON:
            raise ValueError("its first chunk is no JSON")
        self.about: dict[str, Any] = json.loads(chunks[8 : 8 + size])
        if len(chunks) >= 16 + size:
            length, kind = struct.unpack_from("<II", chunks, 8 + size)
            if kind == BYTES:
                self.bytes = memoryview(chunks)[16 + size : 16 + size + length]
        for name in self.about.get("extensionsRequired", ()):
            if not any(word in name for word in READ):
                self.refuse_extension(name)

    def refuse_extension(self, name: str) -> None:
        raise InputError(
            f"{self.path}: needs glTF's extension '{clipped(name)}', which is not read here; "
            "export it without"
        )

    def item(self, table: str, number: int) -> dict[str, Any]:
        """An entry of one of the file's tables."""
        entries = self.about.get(table, [])
        if not 0 <= number < len(entries):
            raise ValueError(f"it has {len(entries)} {table}, and none of number {number}")
        entry: dict[str, Any] = entries[number]
        return entry

    def parts(self) -> list[Part]:
        """The triangles of each primitive of the scene, in the scene's places.

        In the order of their nodes' names: the numbers that scene files pin vertices by.
        """
        nodes = self.about.get("nodes", [])
        found = []
        for number, matrix in sorted(
            self.placed().items(), key=lambda at: (str(nodes[at[0]].get("name", at[0])), at[0])
        ):
            node = nodes[number]
            if "mesh" not in node:
                continue
            if INSTANCES in node.get("extensions", ()):
                self.refuse_extension(INSTANCES)
            mesh = self.item("meshes", node["mesh"])
            weights = node.get("weights", mesh.get("weights", ()))
            for primitive in mesh["primitives"]:
                vertices, faces = self.primitive(primitive, weights)
                if not len(faces):
                    continue
                if "skin" in node:  # 3.7.3.3: joints place the mesh, and not its node
                    by = self.skinned(self.item("skins", node["skin"]), primitive, len(vertices))
                    vertices = np.einsum("nij,nj->ni", by[:, :, :3], vertices) + by[:, :, 3]
                    mirrored = 2 * (np.linalg.det(by[:, :, :3]) < 0).sum() > len(by)
                else:
                    vertices = vertices @ matrix[:3, :3].T + matrix[:3, 3]
                    mirrored = np.linalg.det(matrix[:3, :3]) < 0
                if mirrored:  # 3.7.4: a mirror turns the winding round
                    faces = faces[:, [0, 2, 1]]
                found.append((vertices, faces))
        return found

    def skinned(self, skin: dict[str, Any], primitive: dict[str, Any], count: int) -> np.ndarray:
        """By what each vertex of a primitive is placed, (count, 3, 4): its joints' matrices, by
        its weights.
        """
        if self.matrices is None:
            self.matrices = self.placed(whole=True)
        joints = np.stack([self.matrices[joint] for joint in skin["joints"]])
        if "inverseBindMatrices" in skin:
            inverse = self.accessor(skin["inverseBindMatrices"], "MAT4").astype(np.float64)
            joints = joints @ inverse[: len(joints)].reshape(-1, 4, 4).transpose(0, 2, 1)
        attributes = primitive["attributes"]
        sets = [n for n in range(len(attributes)) if f"JOINTS_{n}" in attributes]
        if not sets:
            raise ValueError("it has a mesh with a skin, but without joints")
        of, weight = (
            np.concatenate([self.accessor(attributes[f"{name}_{n}"], "VEC4") for n in sets], axis=1)
            for name in ("JOINTS", "WEIGHTS")
        )
        if of.shape != (count, 4 * len(sets)) or weight.shape != of.shape:
            raise ValueError(f"it has {count} vertices, and joints of {len(of)}")
        weight = weight.astype(np.float64)
        none = ~(weight.sum(axis=1) > 0)
        weight[none, 0] = 1.0  # as if the first joint had it alone
        weight /= weight.sum(axis=1, keepdims=True)
        matrices = np.zeros((count, 3, 4))
        for n in range(of.shape[1]):
            matrices += weight[:, n, None, None] * joints[of[:, n], :3]
        return matrices

    def placed(self, whole: bool = False) -> dict[int, np.ndarray]:
        """The matrices (4, 4) of the scene's nodes, by number; of all, where there are no scenes,
        or the whole file is asked for.
        """
        nodes = self.about.get("nodes", [])
        if "scenes" in self.about and not whole:
            roots = self.item("scenes", self.about.get("scene", 0)).get("nodes", [])
        else:
            below = {child for node in nodes for child in node.get("children", ())}
            roots = [number for number in range(len(nodes)) if number not in below]
        found: dict[int, np.ndarray] = {}
        ahead = [(root, np.eye(4)) for root in roots]
        while ahead:
            number, parent = ahead.pop()
            node = self.item("nodes", number)
            if number in found:
                raise ValueError(f"node {number} is in two places of its scene")
            found[number] = parent @ _matrix(node)
            ahead += [(child, found[number]) for child in node.get("children", ())]
        return found

    def primitive(self, primitive: dict[str, Any], weights: Sequence[float]) -> Part:
        """The vertices and triangles of a primitive; of points and lines no triangle.

        weights: how far its morph targets move its vertices.
        """
        kind = primitive.get("mode", TRIANGLES)
        if kind not in (TRIANGLES, STRIP, FAN):
            return np.zeros((0, 3)), np.zeros((0, 3), np.int64)
        vertices = self.accessor(primitive["attributes"]["POSITION"], "VEC3").astype(np.float64)
        for weight, target in zip(weights, primitive.get("targets", ()), strict=False):
            if weight and "POSITION" in target:
                vertices += weight * self.accessor(target["POSITION"], "VEC3")
        corners: np.ndarray = np.arange(len(vertices))
        if "indices" in primitive:
            corners = self.accessor(primitive["indices"], "SCALAR")[:, 0].astype(np.int64)
        if (corners >= len(vertices)).any():
            raise ValueError(f"a corner is vertex {corners.max()} of {len(vertices)}")
        if kind == TRIANGLES:
            return vertices, corners.reshape(-1, 3)
        ends = np.stack([corners[1:-1], corners[2:]], axis=1)
        if kind == FAN:
            return vertices, np.concatenate([np.full((len(ends), 1), corners[:1]), ends], axis=1)
        ends[1::2] = ends[1::2, ::-1]
        faces = np.concatenate([corners[:-2, None], ends], axis=1)
        # Strips go on elsewhere by way of triangles with a corner twice.
        return vertices, faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]

    def accessor(self, number: int, shape: str) -> np.ndarray:
        """A table of the file, (count, width): fractions that whole numbers stand for as such."""
        of = self.item("accessors", number)
        if of["type"] != shape:
            raise ValueError(f"accessor {number} is {clipped(str(of['type']))}, not {shape}")
        count, width = of["count"], WIDTHS[shape]
        kind: np.dtype = np.dtype(TYPES[of["componentType"]])
        check_counts(self.path, 0 if width == 1 else count, count // 3 if width == 1 else 0)
        rows: np.ndarray = np.zeros((count, width), kind)
        if "bufferView" in of:
            rows[:] = self.rows(of, kind, count, width)
        if sparse := of.get("sparse"):
            changed, there = sparse["count"], np.dtype(TYPES[sparse["indices"]["componentType"]])
            at = self.rows(sparse["indices"], there, changed, 1)[:, 0]
            rows[at] = self.rows(sparse["values"], kind, changed, width)
        if of.get("normalized") and kind.kind != "f":
            rows = np.maximum(rows / float(np.iinfo(kind).max), -1.0)
        return rows

    def rows(self, of: dict[str, Any], kind: np.dtype, count: int, width: int) -> np.ndarray:
        """Rows of numbers, (count, width), that stand in a view of a buffer."""
        view = self.item("bufferViews", of["bufferView"])
        begin = view.get("byteOffset", 0)
        data = self.buffer(view["buffer"])[begin : begin + view["byteLength"]]
        step = view.get("byteStride", width * kind.itemsize)
        offset = of.get("byteOffset", 0)
        table: np.ndarray = np.ndarray((count, width), kind, data, offset, (step, kind.itemsize))
        return table

    def buffer(self, number: int) -> memoryview:
        """The bytes of a buffer: the file's own, or written out in the JSON."""
        uri = self.item("buffers", number).get("uri")
        if uri is None and number == 0:
            return self.bytes
        if uri is None or not uri.startswith("data:"):
            raise InputError(
                f"{self.path}: its buffer {number} is in another file; export it as one GLB file"
            )
        return memoryview(base64.b64decode(uri.partition(",")[2]))


def _matrix(node: dict[str, Any]) -> np.ndarray:
    """The transform of a node, (4, 4); 3.5.3: by columns, or scaled, turned, moved."""
    if "matrix" in node:
        given: np.ndarray = np.array(node["matrix"], np.float64).reshape(4, 4).T
        return given
    x, y, z, w = node.get("rotation", (0, 0, 0, 1))
    turn = np.array((w, x, y, z), np.float64)
    squared = turn @ turn
    turn *= np.sqrt(2 / squared) if squared > 0 else 0
    q = np.outer(turn, turn)
    turned = np.array(
        [
            [1 - q[2, 2] - q[3, 3], q[1, 2] - q[3, 0], q[1, 3] + q[2, 0]],
            [q[1, 2] + q[3, 0], 1 - q[1, 1] - q[3, 3], q[2, 3] - q[1, 0]],
            [q[1, 3] - q[2, 0], q[2, 3] + q[1, 0], 1 - q[1, 1] - q[2, 2]],
        ]
    )
    matrix = np.eye(4)
    matrix[:3, :3] = turned * np.array(node.get("scale", (1, 1, 1)), np.float64)
    matrix[:3, 3] = node.get("translation", (0, 0, 0))
    return matrix
