#!/usr/bin/env python3
"""Stands the trees of several files in rows before a camera and renders them with Cycles.

    tools/contact_sheet.py birch.glb birch_LOD1.glb birch_impostor.glb -o sheet.png --columns 3
    tools/contact_sheet.py birch.glb pine.glb -o bark.png --window 1.5 --at 0.05

Every file is one tree with its root at the origin. All of a row are to one scale. With --window a
square of so many metres is shown of each, with its middle in the tree's axis at a share --at of the
height, or beside it by --aside metres. Needs Blender as tools/render_blender.py does.
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
    parser.add_argument("--window", type=float, metavar="M", help="side of what is shown of a tree")
    parser.add_argument("--at", type=float, default=0.5, metavar="SHARE", help="height of its middle")
    parser.add_argument("--aside", type=float, default=0.0, metavar="M", help="east of the axis")
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
    if path.stem.endswith("_impostor"):
        # As engines show them: the sheets of a cross would darken each other.
        for o in new:
            o.visible_shadow = False
    bpy.context.view_layer.update()
    corners = [o.matrix_world @ Vector(c) for o in new if o.type == "MESH" for c in o.bound_box]
    low, high = Vector(map(min, *corners)), Vector(map(max, *corners))
    holder = bpy.data.objects.new(path.stem, None)
    bpy.context.scene.collection.objects.link(holder)
    for o in new:
        if o.parent is None:
            o.parent = holder
    return holder, low, high


def sky(bpy):
    """The light of tools/render_blender.py before a bright, plain sky."""
    blender.light(bpy)
    for node in bpy.context.scene.world.node_tree.nodes:
        if node.type == "BACKGROUND" and not node.inputs["Color"].is_linked:
            node.inputs["Color"].default_value = (0.62, 0.76, 0.92, 1.0)


def ground(bpy, reach):
    bpy.ops.mesh.primitive_plane_add(size=reach)
    material = bpy.data.materials.new("ground")
    material.use_nodes = True
    shader = material.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (0.20, 0.21, 0.13, 1.0)
    shader.inputs["Roughness"].default_value = 1.0
    bpy.context.object.data.materials.append(material)
    return bpy.context.object


def eye(bpy, middle, side, distance, tilt_deg):
    """An orthographic camera south of a place; `side`: metres across the longer side."""
    from mathutils import Vector

    camera = bpy.data.cameras.new("camera")
    camera.type, camera.ortho_scale, camera.clip_end = "ORTHO", side, 1e5
    holder = bpy.data.objects.new("camera", camera)
    tilt = math.radians(tilt_deg)
    holder.location = Vector(middle) + Vector((0, -math.cos(tilt), math.sin(tilt))) * distance
    holder.rotation_euler = (math.radians(90) - tilt, 0, 0)
    bpy.context.scene.collection.objects.link(holder)
    bpy.context.scene.camera = holder


def shoot(bpy, args, width_px, height_px):
    """The picture as an array, first row at the bottom."""
    import numpy as np

    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.samples = args.samples
    # Denoising smears leaves into blades.
    scene.cycles.use_denoising = False
    scene.cycles.max_bounces, scene.cycles.diffuse_bounces = 5, 2
    scene.cycles.transparent_max_bounces = 40
    scene.view_settings.view_transform = "AgX"
    scene.view_settings.look = "AgX - Medium High Contrast"
    scene.view_settings.exposure = 0.0
    scene.render.resolution_x, scene.render.resolution_y = width_px, height_px
    scene.render.filepath = str(args.output.resolve())
    with blender.captured():
        bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(args.output.resolve()))
    width, height = image.size
    return np.array(image.pixels[:], np.float32).reshape(height, width, 4)


def row_of_trees(bpy, args, files):
    """Trees side by side on a plane, seen from the south."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    placed = [stand(bpy, f) for f in files]
    tallest = max(high.z for _, _, high in placed)
    left, gap = 0.0, 0.06 * tallest
    for holder, low, high in placed:
        width = max(high.x - low.x, high.y - low.y)
        holder.location.x = left + gap + 0.5 * width - 0.5 * (low.x + high.x)
        left += width + gap
    width, height = left + gap, 1.1 * tallest
    ground(bpy, 4 * max(width, height)).location.x = 0.5 * left
    sky(bpy)
    side = max(width, height)
    eye(bpy, (0.5 * (left + gap), 0.0, 0.47 * height), side, 10 * side, 4)
    return shoot(bpy, args, int(args.height * width / height), args.height)


def window(bpy, args, file):
    """A part of one tree."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    _, _, high = stand(bpy, file)
    ground(bpy, 400.0)
    sky(bpy)
    eye(bpy, (args.aside, 0.0, max(args.at * high.z, 0.47 * args.window)), args.window, 100.0, 4)
    return shoot(bpy, args, args.height, args.height)


def main():
    args = arguments()
    try:
        import bpy
        import numpy as np
    except ImportError:
        sys.exit(blender.REMEDY)
    rows = [args.files[k : k + args.columns] for k in range(0, len(args.files), args.columns)]
    if args.window:
        rows = [np.hstack([window(bpy, args, f) for f in row]) for row in rows]
    else:
        rows = [row_of_trees(bpy, args, row) for row in rows]
    width = max(row.shape[1] for row in rows)
    sheet = np.ones((sum(row.shape[0] for row in rows), width, 4), np.float32)
    bottom = sheet.shape[0]
    for row in rows:
        bottom -= row.shape[0]
        sheet[bottom : bottom + row.shape[0], : row.shape[1]] = row
    out = bpy.data.images.new("sheet", width, sheet.shape[0])
    out.pixels = sheet.ravel()
    out.filepath_raw, out.file_format = str(args.output.resolve()), "PNG"
    out.save()


if __name__ == "__main__":
    main()
