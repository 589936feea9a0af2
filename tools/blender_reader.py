#!/usr/bin/env python3
"""Scene files as Blender sees them. Prints a line of JSON a file, behind the word FOUND.

    PYTHON tools/blender_reader.py FILES…

PYTHON has bpy (Blender as a Python module). FILES are .glb, .gltf, .usda, .usdc, .usdz or .obj. Told are
seconds, objects, what is drawn (meshes, triangles, bounds in metres, Z up; colliders apart) and
pictures that were not found.
"""

import json
import os
import sys
import time

import bpy
import numpy as np

COLLIDERS = ("UCX_", "UCP_")


def importer(file):
    kind = os.path.splitext(file)[1]
    if kind in (".glb", ".gltf"):
        return bpy.ops.import_scene.gltf
    return bpy.ops.wm.obj_import if kind == ".obj" else bpy.ops.wm.usd_import


def look(file):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    start = time.time()
    importer(file)(filepath=file)
    found = {"seconds": time.time() - start, "objects": len(bpy.data.objects)}
    found.update(drawn=0, triangles=0, bodies=0)
    low, high, corners = np.full(3, np.inf), np.full(3, -np.inf), {}
    for one in bpy.context.evaluated_depsgraph_get().object_instances:
        mesh = one.object.data
        if one.object.type != "MESH" or not one.show_self or not len(mesh.polygons):
            continue
        if mesh.name.startswith(COLLIDERS) or one.object.name.startswith(COLLIDERS):
            found["bodies"] += 1
            continue
        found["drawn"] += 1
        found["triangles"] += len(mesh.polygons)
        if mesh.name not in corners:
            points = np.empty(3 * len(mesh.vertices), np.float32)
            mesh.vertices.foreach_get("co", points)
            used = np.empty(len(mesh.loops), np.int32)
            mesh.loops.foreach_get("vertex_index", used)
            corners[mesh.name] = points.reshape(-1, 3)[np.unique(used)].astype(float)
        matrix = np.array(one.matrix_world)
        placed = corners[mesh.name] @ matrix[:3, :3].T + matrix[:3, 3]
        low, high = np.minimum(low, placed.min(0)), np.maximum(high, placed.max(0))
    found["bounds"] = [low.tolist(), high.tolist()]
    files = [i for i in bpy.data.images if i.source == "FILE"]
    there = lambda i: i.packed_file or os.path.exists(bpy.path.abspath(i.filepath)) or tuple(i.size) != (0, 0)
    found["pictures"] = len(files)
    found["missing"] = [i.name for i in files if not there(i)]
    return found


for file in sys.argv[1:]:
    try:
        found = look(file)
    except Exception as error:  # what a file makes of an importer
        found = {"error": str(error).strip()[-300:]}
    print("FOUND", json.dumps({"file": file, "blender": bpy.app.version_string, **found}), flush=True)
