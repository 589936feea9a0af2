#!/usr/bin/env python3
"""Stands the trees of several files in rows before a camera and renders them with Cycles.

    tools/contact_sheet.py birch.glb birch_LOD1.glb birch_impostor.glb -o sheet.png --columns 3

Every file is one tree with its root at the origin. All are to one scale; each column is as wide as
its widest tree. Needs Blender as tools/render_blender.py does.
"""

import argparse
import math
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))
import render_blender as blender


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("files", type=Path, nargs="+")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="PNG")
    parser.add_argument("--columns", type=int, default=6)
    parser.add_argument("--height", type=int, default=700, help="pixels of a row")
    parser.add_argument("--samples", type=int, default=48, help="paths a pixel")
    args = parser.parse_args()
    missing = [str(f) for f in args.files if not f.is_file()]
    if missing:
        parser.error(f"no such file: {', '.join(missing)}")
    return args


def stand(bpy, path):
    """Imports a tree; gives the empty that holds it and its bounds."""
    from mathutils import Vector

    before = set(bpy.data.objects)
    with blender.captured():
        bpy.ops.import_scene.gltf(filepath=str(path))
    new = [o for o in bpy.data.objects if o not in before]
    for collider in [o for o in new if o.name.startswith(("UCX_", "UCP_"))]:
        new.remove(collider)
        bpy.data.objects.remove(collider)
    bpy.context.view_layer.update()
    corners = [o.matrix_world @ Vector(c) for o in new if o.type == "MESH" for c in o.bound_box]
    low, high = Vector(map(min, *corners)), Vector(map(max, *corners))
    holder = bpy.data.objects.new(path.stem, None)
    bpy.context.scene.collection.objects.link(holder)
    for o in new:
        if o.parent is None:
            o.parent = holder
    return holder, low, high


def ground(bpy, reach):
    bpy.ops.mesh.primitive_plane_add(size=reach)
    material = bpy.data.materials.new("ground")
    material.use_nodes = True
    shader = material.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (0.20, 0.21, 0.13, 1.0)
    shader.inputs["Roughness"].default_value = 1.0
    bpy.context.object.data.materials.append(material)
    return bpy.context.object


def render(bpy, args, files):
    """One row: trees side by side on a plane, seen from the south."""
    from mathutils import Vector

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    left, top, gap = 0.0, 0.0, 0.0
    placed = [stand(bpy, f) for f in files]
    tallest = max(high.z for _, _, high in placed)
    gap = 0.06 * tallest
    for holder, low, high in placed:
        width = max(high.x - low.x, high.y - low.y)
        holder.location.x = left + gap + 0.5 * width - 0.5 * (low.x + high.x)
        left += width + gap
    width, height = left + gap, 1.1 * tallest
    ground(bpy, 40 * max(width, height)).location.x = 0.5 * left
    blender.light(bpy)
    camera = bpy.data.cameras.new("camera")
    camera.type = "ORTHO"
    pixels = int(args.height * width / height)
    camera.ortho_scale = max(width, height)
    eye = bpy.data.objects.new("camera", camera)
    middle = Vector((0.5 * (left + gap), 0.0, 0.47 * height))
    tilt = math.radians(4)
    eye.location = middle + Vector((0, -math.cos(tilt), math.sin(tilt))) * 10 * max(width, height)
    eye.rotation_euler = (math.radians(90) - tilt, 0, 0)
    camera.clip_end = 1e5
    scene.collection.objects.link(eye)
    scene.camera = eye
    scene.render.engine = "CYCLES"
    scene.cycles.samples = args.samples
    scene.cycles.use_denoising = True
    scene.cycles.transparent_max_bounces = 64
    scene.view_settings.view_transform = "AgX"
    scene.render.resolution_x, scene.render.resolution_y = pixels, args.height
    scene.render.filepath = str(args.output)
    with blender.captured():
        bpy.ops.render.render(write_still=True)


def main():
    args = arguments()
    try:
        import bpy
    except ImportError:
        sys.exit(blender.REMEDY)
    rows = [args.files[k : k + args.columns] for k in range(0, len(args.files), args.columns)]
    if len(rows) == 1:
        render(bpy, args, rows[0])
        return
    import numpy as np

    pictures = []
    for row in rows:
        render(bpy, args, row)
        image = bpy.data.images.load(str(args.output))
        width, height = image.size
        pictures.append(np.array(image.pixels[:], np.float32).reshape(height, width, 4))
    width = max(p.shape[1] for p in pictures)
    sheet = np.ones((sum(p.shape[0] for p in pictures), width, 4), np.float32)
    bottom = sheet.shape[0]
    for p in pictures:
        bottom -= p.shape[0]
        sheet[bottom : bottom + p.shape[0], : p.shape[1]] = p
    out = bpy.data.images.new("sheet", width, sheet.shape[0])
    out.pixels = sheet.ravel()
    out.filepath_raw, out.file_format = str(args.output), "PNG"
    out.save()


if __name__ == "__main__":
    main()
