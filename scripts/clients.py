"""Opens the outputs of one run in real clients and compares every vertex of several frames with the PC2 of that run.

    clients.py FOLDER [FRAMES]

FOLDER holds a.glb, m.glb (morph targets), c.glb (a skin with corrective ones), a.pc2, a.mdd, a.usdc, a.usda, a.usdz, a.abc and f_####.obj of one take,
p.glb and p.pc2 of rigid parts (see clients.sh); bpy and usd-core are installed. Prints a row per format and client: whether the file opens, the frames
compared (first, last and between), the worst difference to the PC2 in the scan's unit, for GLB how far a vertex is half a frame after these from the mean of
its neighbours in time, in percent of the diagonal, and seconds to open and evaluate. Exits with 1 when a file does not open, a cache is not equal to
the PC2, or a vertex is farther off than 1 % half a frame between keys.
"""
import glob
import os
import struct
import sys
import time

import bpy
import numpy as np
from mathutils.kdtree import KDTree
from pxr import Usd, UsdGeom, UsdValidation


def read_pc2(path):
    with open(path, "rb") as file:
        assert file.read(12) == b"POINTCACHE2\0", path
        _, points, first, _, samples = struct.unpack("<iiffi", file.read(20))
        return int(first), np.fromfile(file, "<f4").reshape(samples, points, 3)


class Run:
    """What all files of one take tell alike."""

    def __init__(self, folder, cache, rate):
        self.folder = os.path.abspath(folder)
        self.first, self.points = read_pc2(self.path(cache))
        self.last = self.first + len(self.points) - 1
        self.rate = rate
        self.diagonal = float(np.linalg.norm(np.ptp(self.points[0], axis=0)))

    def path(self, name):
        return os.path.join(self.folder, name)


def empty_scene(run):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    render = bpy.context.scene.render
    render.fps = max(1, round(run.rate))
    render.fps_base = render.fps / run.rate


def evaluated(frame):
    """Vertices of the mesh of the scene at a frame, in its own coordinates."""
    bpy.context.scene.frame_set(frame)
    graph = bpy.context.evaluated_depsgraph_get()
    (item,) = [item for item in bpy.context.scene.objects if item.type == "MESH" and len(item.data.vertices) > 100]
    mesh = item.evaluated_get(graph).to_mesh()
    points = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", points)
    return points.reshape(-1, 3)


def y_up(points):
    """Back from Blender's Z up, exactly."""
    return np.stack([points[:, 0], points[:, 2], -points[:, 1]], axis=1)


def mesh_cache(run, name):
    """The OBJ of the first frame, moved by the modifier."""
    empty_scene(run)
    # Forward Y and up Z leave the coordinates as they are.
    bpy.ops.wm.obj_import(filepath=sorted(glob.glob(run.path("f_*.obj")))[0], forward_axis="Y", up_axis="Z")
    modifier = bpy.context.selected_objects[0].modifiers.new("cache", "MESH_CACHE")
    modifier.cache_format = name[2:].upper()
    modifier.filepath = run.path(name)
    modifier.forward_axis, modifier.up_axis = "POS_Y", "POS_Z"
    modifier.frame_start = run.first
    return evaluated


def alembic(run, name):
    """Blender takes every Alembic file for Y up and turns its vertices."""
    empty_scene(run)
    bpy.ops.wm.alembic_import(filepath=run.path(name), as_background_job=False)
    (item,) = bpy.context.scene.objects
    assert len(item.data.materials) > 1 and len(item.data.uv_layers) == 1, "face sets and uv"
    return lambda frame: y_up(evaluated(frame))


def usd_in_blender(run, name):
    empty_scene(run)
    bpy.ops.wm.usd_import(filepath=run.path(name))
    scene = bpy.context.scene
    assert (scene.frame_start, scene.frame_end) == (run.first, run.last)
    return evaluated


def usd_core(run, name):
    stage = Usd.Stage.Open(run.path(name))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/scan/mesh"))
    indices, counts = mesh.GetFaceVertexIndicesAttr().Get(), mesh.GetFaceVertexCountsAttr().Get()
    valid, reason = UsdGeom.Mesh.ValidateTopology(indices, counts, len(mesh.GetPointsAttr().Get(run.first)))
    assert valid, reason
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    errors = UsdValidation.ValidationContext(validators).Validate(stage)
    assert not errors, errors[0].GetMessage()
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (run.first, run.last)
    # The stage lives as long as somebody holds it.
    return lambda frame, stage=stage: np.array(mesh.GetPointsAttr().Get(frame), np.float32)


def glb(run, name):
    """A skin or morph targets, with vertices split at seams: each is paired with the vertex of the scan that is nearest at the first frame."""
    empty_scene(run)
    bpy.ops.import_scene.gltf(filepath=run.path(name))
    start = evaluated_in_world(0)
    tree = KDTree(len(run.points[0]))
    for k, point in enumerate(run.points[0]):
        tree.insert(point, k)
    tree.balance()
    pairs = np.array([tree.find(point)[1] for point in start])

    def at(frame):
        points = np.array(run.points[int(frame) - run.first])
        points[pairs] = evaluated_in_world(frame - run.first)
        return points

    return at


def evaluated_in_world(frame):
    bpy.context.scene.frame_set(int(frame), subframe=frame - int(frame))
    graph = bpy.context.evaluated_depsgraph_get()
    out = []
    for item in bpy.context.scene.objects:
        # Bones have a shape of a few vertices.
        if item.type == "MESH" and len(item.data.vertices) > 100:
            posed = item.evaluated_get(graph)
            mesh = posed.to_mesh()
            points = np.empty(3 * len(mesh.vertices), np.float32)
            mesh.vertices.foreach_get("co", points)
            place = np.array(posed.matrix_world, np.float64)
            out.append(points.reshape(-1, 3) @ place[:3, :3].T + place[:3, 3])
    return y_up(np.concatenate(out))


BLENDER = f"Blender {bpy.app.version_string}"
USD = f"usd-core {Usd.GetMinorVersion()}.{Usd.GetPatchVersion():02}"

# Format, client, file, how it is opened, whether it has to be equal.
CLIENTS = [
    (".pc2", BLENDER, "a.pc2", mesh_cache, True),
    (".mdd", BLENDER, "a.mdd", mesh_cache, True),
    (".abc", BLENDER, "a.abc", alembic, True),
    (".usdc", BLENDER, "a.usdc", usd_in_blender, True),
    (".usdc", USD, "a.usdc", usd_core, True),
    (".usda", BLENDER, "a.usda", usd_in_blender, True),
    (".usda", USD, "a.usda", usd_core, True),
    (".usdz", BLENDER, "a.usdz", usd_in_blender, True),
    (".usdz", USD, "a.usdz", usd_core, True),
    (".glb skin", BLENDER, "a.glb", glb, False),
    (".glb both", BLENDER, "c.glb", glb, False),
    (".glb morph", BLENDER, "m.glb", glb, False),
    (".glb parts", BLENDER, "p.glb", glb, False),
]

# How far a vertex may be from the mean of two frames in the middle between them, as a share of the diagonal.
BETWEEN = 0.01


def compare(run, frames, name, open_it, exact):
    """Worst differences at some frames and, where motion is interpolated, half a frame after them."""
    at = open_it(run, name)
    worst, between = 0.0, 0.0
    for k in frames:
        points = at(run.first + k)
        assert points.shape == run.points[k].shape, f"{len(points)} vertices"
        worst = max(worst, float(np.abs(points.astype(np.float64) - run.points[k]).max()))
        if not exact and k + 1 < len(run.points):
            mean = run.points[k : k + 2].astype(np.float64).mean(axis=0)
            between = max(between, float(np.linalg.norm(at(run.first + k + 0.5) - mean, axis=1).max()))
    return worst, between / run.diagonal


def main(folder, count):
    whole = Run(folder, "a.pc2", Usd.Stage.Open(os.path.join(folder, "a.usda")).GetTimeCodesPerSecond())
    parts = Run(folder, "p.pc2", 30.0)
    rows, failed = [], False
    for ending, client, name, open_it, exact in CLIENTS:
        run = parts if name == "p.glb" else whole
        frames = sorted({round(k) for k in np.linspace(0, len(run.points) - 1, count)})
        start = time.time()
        # A client that fails is a row, not the end of the table.
        try:
            worst, between = compare(run, frames, name, open_it, exact)
            opens, shown, half = "yes", f"{worst:.3g}", "" if exact else f"{100 * between:.3f} %"
            failed |= exact and worst != 0.0 or between > BETWEEN
        except Exception as reason:
            opens, shown, half, failed = "no", str(reason), "", True
        rows.append((ending, client, opens, len(frames), shown, half, f"{time.time() - start:.2f}"))
    layout = "{:10} {:15} {:5} {:>6} {:>17} {:>13} {:>8}"
    print(layout.format("format", "client", "opens", "frames", "worst difference", "between keys", "seconds"))
    for row in rows:
        print(layout.format(*row))
    return failed


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 5))
