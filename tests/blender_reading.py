"""Reads exports in Blender, as the page on exports says: run by the Python of the module `bpy`.

python blender_reading.py FOLDER: the exports of `test_blender.py`; what Blender shows of each at
each frame, in its world, goes to FOLDER/shown.npz.
"""

import sys
from pathlib import Path

import bpy
import numpy as np

FRAMES = range(1, 7)


def begun():
    """Blender's scene, emptied."""
    bpy.ops.wm.read_factory_settings(use_empty=True)


def shown():
    """The vertices of the one mesh there is, in the world, as its modifiers leave them."""
    (found,) = (thing for thing in bpy.context.scene.objects if thing.type == "MESH")
    mesh = found.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
    x = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", x)
    place = np.array(found.matrix_world)
    return x.reshape(-1, 3) @ place[:3, :3].T + place[:3, 3]


def cache(folder, name, every):
    """A point cache on the mesh beside it."""
    begun()
    bpy.ops.wm.obj_import(filepath=str(folder / f"{name}.obj"))
    (found,) = bpy.context.scene.objects
    played = found.modifiers.new("cache", "MESH_CACHE")
    played.cache_format, played.filepath = "PC2", str(folder / f"{name}.pc2")
    played.frame_start, played.frame_scale = 1.0, 1 / every
    return played_frames()


def stage(folder, name):
    begun()
    bpy.ops.wm.usd_import(filepath=str(folder / f"{name}.usda"))
    return played_frames()


def played_frames():
    by_frame = {}
    for frame in FRAMES:
        bpy.context.scene.frame_set(frame)
        by_frame[frame] = shown()
    return by_frame


def sequence(folder, suffix):
    by_frame = {}
    for frame in FRAMES:
        begun()
        file = str(folder / f"cloth_{frame:05d}.{suffix}")
        if suffix == "ply":
            bpy.ops.wm.ply_import(filepath=file, forward_axis="NEGATIVE_Z", up_axis="Y")
        else:
            bpy.ops.wm.obj_import(filepath=file)
        by_frame[frame] = shown()
    return by_frame


def main(folder):
    found = {
        "cache": cache(folder, "cloth", 1),
        "second": cache(folder, "second", 2),
        "stage": stage(folder, "cloth"),
        "ply": sequence(folder, "ply"),
        "obj": sequence(folder, "obj"),
    }
    arrays = {f"{name} {n}": x for name, frames in found.items() for n, x in frames.items()}
    np.savez(folder / "shown.npz", version=bpy.app.version_string, **arrays)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
