#!/usr/bin/env python3
"""Imports a GLB, glTF or USD file into Blender and renders it headless with Cycles.

    tools/render_blender.py output/demo/forest.glb -o forest.png
    tools/render_blender.py output/demo/forest.usda -o usd.png --view close --samples 64

Prints what Blender made of the file: objects, instances, triangles, missing images. Exits with 1
if the import printed a warning or an error, an image is missing or nothing can be seen; with 2 if
Blender itself is missing. A USD PointInstancer comes in as a point cloud with geometry nodes: its
instances are counted as Blender evaluates them.
"""

import argparse
import contextlib
import math
import os
import re
import sys
import tempfile
from pathlib import Path

REMEDY = (
    "Blender is missing: python3.11 -m venv venv && venv/bin/pip install 'bpy==4.5.*', then run "
    "this with venv/bin/python (on Debian also: apt-get install libgl1 libxi6 libxrender1 "
    "libxkbcommon0 libsm6 libxxf86vm1 libxfixes3 libgomp1)"
)
SUSPECT = re.compile(r"\b(warn(ing)?|error|traceback|failed|invalid)\b", re.IGNORECASE)
# azimuth clockwise from north and elevation of the eye in degrees, share of the scene shown
VIEWS = {"overview": (148.0, 30.0, 1.0), "portrait": (148.0, 7.0, 1.0), "close": (148.0, 12.0, 0.3)}


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("file", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="PNG")
    parser.add_argument("--size", default="1280x720", help="WIDTHxHEIGHT in pixels")
    parser.add_argument("--samples", type=int, default=32, help="paths a pixel")
    parser.add_argument("--view", choices=sorted(VIEWS), default="overview")
    args = parser.parse_args()
    match = re.fullmatch(r"(\d+)x(\d+)", args.size)
    if not match:
        parser.error("--size is WIDTHxHEIGHT, such as 1280x720")
    args.width, args.height = int(match[1]), int(match[2])
    if not args.file.is_file():
        parser.error(f"{args.file}: no such file")
    return args


@contextlib.contextmanager
def captured():
    """Collects what Python and C++ print to both streams, and shows it afterwards."""
    lines = []
    with tempfile.TemporaryFile() as file:
        sys.stdout.flush()
        sys.stderr.flush()
        saved = [os.dup(1), os.dup(2)]
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
        try:
            yield lines
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            for stream, copy in zip((1, 2), saved):
                os.dup2(copy, stream)
                os.close(copy)
            file.seek(0)
            lines.extend(file.read().decode(errors="replace").splitlines())


def load(bpy, path):
    """Imports the file into an empty scene; gives the lines that look like complaints."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    importers = {
        bpy.ops.import_scene.gltf: (".glb", ".gltf"),
        bpy.ops.wm.usd_import: (".usd", ".usda", ".usdc", ".usdz"),
    }
    suitable = [f for f, suffixes in importers.items() if path.suffix.lower() in suffixes]
    if not suitable:
        return ["not a .glb, .gltf, .usd, .usda, .usdc or .usdz file"]
    with captured() as lines:
        try:
            suitable[0](filepath=str(path))
        except RuntimeError as error:
            # The operator's own message; a traceback goes to the captured streams.
            return [" ".join(str(error).split())[-200:]]
    return [line.strip() for line in lines if SUSPECT.search(line)]


def missing_images(bpy):
    missing = []
    for image in bpy.data.images:
        if image.source == "FILE" and not image.packed_file:
            if not Path(bpy.path.abspath(image.filepath)).is_file():
                missing.append(image.name)
        elif image.source == "FILE" and image.size[0] == 0:
            missing.append(image.name)
    return sorted(missing)


def survey(bpy):
    """Counts what the evaluated scene shows; gives the corners of all bounding boxes too."""
    from mathutils import Vector

    depsgraph = bpy.context.evaluated_depsgraph_get()
    points = []
    count = {"objects": len(bpy.context.scene.objects), "instances": 0, "triangles": 0}
    triangles = {}
    for item in depsgraph.object_instances:
        thing = item.object
        if thing.type != "MESH":
            continue
        mesh = thing.data
        if mesh.name not in triangles:
            mesh.calc_loop_triangles()
            triangles[mesh.name] = len(mesh.loop_triangles)
        if triangles[mesh.name] == 0:
            continue
        count["instances"] += item.is_instance
        count["triangles"] += triangles[mesh.name]
        points.extend(item.matrix_world @ Vector(corner) for corner in thing.bound_box)
    return count, points


def light(bpy):
    scene = bpy.context.scene
    world = bpy.data.worlds.new("sky")
    scene.world = world
    world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    nodes.clear()
    sky = nodes.new("ShaderNodeTexSky")
    sky.sky_type = "NISHITA" if "NISHITA" in sky_types(sky) else sky_types(sky)[0]
    sky.sun_disc = False
    sky.sun_elevation = math.radians(39)
    sky.sun_rotation = math.radians(243)
    # Light comes from the sky; the camera sees a plain pale ground behind everything.
    background = nodes.new("ShaderNodeBackground")
    background.inputs["Strength"].default_value = 0.35
    plain = nodes.new("ShaderNodeBackground")
    plain.inputs["Color"].default_value = (0.52, 0.62, 0.70, 1.0)
    path = nodes.new("ShaderNodeLightPath")
    mix = nodes.new("ShaderNodeMixShader")
    output = nodes.new("ShaderNodeOutputWorld")
    links.new(sky.outputs[0], background.inputs[0])
    links.new(path.outputs["Is Camera Ray"], mix.inputs[0])
    links.new(background.outputs[0], mix.inputs[1])
    links.new(plain.outputs[0], mix.inputs[2])
    links.new(mix.outputs[0], output.inputs[0])
    sun = bpy.data.lights.new("sun", "SUN")
    sun.energy, sun.angle = 5.0, math.radians(0.6)
    sun.color = (1.0, 0.93, 0.82)
    lamp = bpy.data.objects.new("sun", sun)
    # The same sun as in the program's own previews: west-south-west, 39 degrees high.
    lamp.rotation_euler = (math.radians(51), 0.0, math.radians(-63))
    scene.collection.objects.link(lamp)


def sky_types(sky):
    return [item.identifier for item in sky.bl_rna.properties["sky_type"].enum_items]


def aim(bpy, points, view, aspect):
    """A camera that frames the points tightly; `share` below 1 keeps to the middle of the box."""
    from mathutils import Vector

    azimuth, elevation, share = VIEWS[view]
    if share < 1.0:
        low, high = Vector(map(min, *points)), Vector(map(max, *points))
        middle, half = (low + high) / 2, (high - low) / 2
        points = [
            middle + Vector((x * half.x * share, y * half.y * share, z * half.z))
            for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)
        ]
    a, e = math.radians(azimuth), math.radians(elevation)
    back = Vector((math.sin(a) * math.cos(e), math.cos(a) * math.cos(e), math.sin(e)))
    right = Vector((0, 0, 1)).cross(back).normalized()
    up = back.cross(right)
    tan_y = math.tan(math.radians(15)) * 0.95
    tan_x = tan_y * aspect
    # Each side of the frustum touches a point; two opposite sides fix the eye's place across the
    # view and its least distance along it.
    reach = {"right": -math.inf, "left": -math.inf, "up": -math.inf, "down": -math.inf}
    for p in points:
        x, y, z = p.dot(right), p.dot(up), p.dot(back)
        reach["right"] = max(reach["right"], x + z * tan_x)
        reach["left"] = max(reach["left"], -x + z * tan_x)
        reach["up"] = max(reach["up"], y + z * tan_y)
        reach["down"] = max(reach["down"], -y + z * tan_y)
    depth = max(
        (reach["right"] + reach["left"]) / (2 * tan_x), (reach["up"] + reach["down"]) / (2 * tan_y)
    )
    eye = (
        right * ((reach["right"] - reach["left"]) / 2)
        + up * ((reach["up"] - reach["down"]) / 2)
        + back * depth
    )
    data = bpy.data.cameras.new("camera")
    data.sensor_fit = "VERTICAL"
    data.angle = math.radians(30)
    data.clip_end = 2.0 * max((eye - p).length for p in points) + 1000.0
    camera = bpy.data.objects.new("camera", data)
    camera.location = eye
    camera.rotation_euler = back.to_track_quat("Z", "Y").to_euler()
    bpy.context.scene.collection.objects.link(camera)
    bpy.context.scene.camera = camera


def render(bpy, args):
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = max(args.samples, 1)
    scene.cycles.use_denoising = False
    # Leaf cards lie behind one another: with too few transparent bounces crowns turn black.
    scene.cycles.transparent_max_bounces = 64
    scene.cycles.max_bounces = 6
    scene.cycles.seed = 0
    scene.view_settings.exposure = 0.4
    scene.render.resolution_x, scene.render.resolution_y = args.width, args.height
    scene.render.resolution_percentage = 100
    scene.render.image_settings.file_format = "PNG"
    scene.render.filepath = str(args.output.resolve())
    args.output.parent.mkdir(parents=True, exist_ok=True)
    with captured():
        bpy.ops.render.render(write_still=True)


def main():
    args = arguments()
    try:
        import bpy
    except ImportError as error:
        print(f"{REMEDY} [{error}]", file=sys.stderr)
        return 2
    complaints = load(bpy, args.file.resolve())
    missing = missing_images(bpy)
    count, points = survey(bpy)
    print(
        f"{args.file}: {count['objects']} objects, {count['instances']} instances, "
        f"{count['triangles']} triangles, {len(bpy.data.images)} images, {len(missing)} missing"
    )
    for line in complaints:
        print(f"{args.file}: Blender says: {line}", file=sys.stderr)
    for name in missing:
        print(f"{args.file}: image `{name}` is missing", file=sys.stderr)
    if count["triangles"] == 0:
        print(f"{args.file}: nothing to be seen was imported", file=sys.stderr)
        return 1
    light(bpy)
    aim(bpy, points, args.view, args.width / args.height)
    render(bpy, args)
    print(f"{args.output}: {args.width}x{args.height}, {args.samples} samples, {args.view}")
    return 1 if complaints or missing else 0


if __name__ == "__main__":
    sys.exit(main())
