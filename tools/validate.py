#!/usr/bin/env python3
"""Checks scene files with others' readers and with checks that those leave out.

    tools/validate.py FILES… [--inventory inventory.geojson]
    tools/validate.py FILES… --three FOLDER
    tools/validate.py --self-test SCENE.glb SCENE.usda [ENGINE.glb WEB.glb]
    tools/validate.py PARTS.glb… --parts-of WHOLE [--self-test]

FILES are .glb, .gltf, .usda, .usdc or .usdz; several are taken to be one scene in several
formats and must agree. --three has three.js in headless Chromium read and draw the glTF files, and
leaves its pictures in FOLDER. --blender PYTHON has Blender import the files, too. Prints a line a check, `ok` or `FAIL`, and exits with 1 on any failure.
--self-test seeds defects in copies and proves that each is caught; take a small scene with
terrain and textures. --parts-of has the files be, together, what WHOLE is: a split GLB against the scene in
one file, which is a .gltf where no GLB holds it.

Needs the modules of tools/requirements.txt, and node with the package of tools/package.json in
$LARIX_NODE_MODULES or in node_modules beside this file.
"""

import argparse
import io
import json
import os
import shutil
import struct
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from urllib.parse import unquote

try:
    import numpy as np
    import trimesh
    from PIL import Image
    from pxr import Ar, Gf, Sdf, Usd, UsdGeom, UsdShade, UsdValidation, Vt
except ImportError as missing:
    sys.exit(f"the Python module {missing.name} is missing: pip install -r tools/requirements.txt")

COLLIDERS = ("UCX_", "UCP_")
UNIT_TOLERANCE = 2e-4
ROOT_TOLERANCE_M = 0.5
OFF_TERRAIN_M = 2.0
MOST_LOST = 0.005
BOUNDS_TOLERANCE_M = 1e-3
OUTLINE_TOLERANCE_M = 1.0
PHOTO_TOLERANCE_PX = 0.1
PHOTO_BORDER_PX = 16
"""Of 255, at most and on average, by the coding of both."""
PHOTO_LEVELS = {"PNG": (1, 0.1), "JPEG": (4, 0.5), "WEBP": (60, 6)}
"""Larger files are not given to readers that hold them several times over."""
MOST_KHRONOS_BYTES = 2**31
MOST_TRIMESH_BYTES = 2**30

KHRONOS = """
const fs = require('fs'), path = require('path'), file = process.argv[1];
// Node reads no file of 2 GiB and more at once.
const read = file => {
  const size = fs.statSync(file).size, bytes = new Uint8Array(size), handle = fs.openSync(file);
  for (let at = 0; at < size; ) at += fs.readSync(handle, bytes, at, Math.min(size - at, 2 ** 30), at);
  fs.closeSync(handle);
  return bytes;
};
const beside = async uri => read(path.join(path.dirname(file), decodeURIComponent(uri)));
require('gltf-validator')
  .validateBytes(read(file), {maxIssues: 0, externalResourceFunction: beside})
  .then(report => console.log(JSON.stringify(report.issues)));
"""


class Report:
    """Prints and remembers what was checked."""

    def __init__(self, quiet=False, failures_alone=False):
        self.quiet = quiet
        self.failures_alone = failures_alone
        self.checks = 0
        self.failed = []

    def check(self, name, faults, detail=""):
        """`faults`: what is wrong, one text each; empty for a check that passed."""
        faults = list(faults)
        self.checks += 1
        if faults:
            self.failed.append(name)
        if not self.quiet and (faults or not self.failures_alone):
            told = "; ".join(faults[:5]) + (f"; and {len(faults) - 5} more" if len(faults) > 5 else "")
            text = told if faults else detail
            print(f"{'FAIL' if faults else 'ok  '} {name}{': ' + text if text else ''}")


@dataclass
class Mesh:
    """One surface as a file holds it, Z up, before it is put in its place."""

    name: str
    points: np.ndarray
    normals: np.ndarray
    uv: np.ndarray
    index: np.ndarray

    def triangles(self):
        return len(self.index) // 3


@dataclass
class Scene:
    """What a file holds, in scene metres, Z up."""

    meshes: list = field(default_factory=list)
    """(number of a mesh, 4×4 matrix for column vectors), one a mesh drawn."""
    drawn: list = field(default_factory=list)
    """Colliders: what physics sees and no one draws, and where each stands."""
    bodies: list = field(default_factory=list)
    bodies_placed: list = field(default_factory=list)
    terrain: list = field(default_factory=list)
    """id → (root, facts)."""
    trees: dict = field(default_factory=dict)
    tree_count: int = 0
    """origin and metres per unit, where the file tells them."""
    place: tuple = None
    """south-western corner and side of the ground that the file says it is of, metres."""
    square: tuple = None
    """Triangles drawn whose meshes are not held any more."""
    triangles_left_out: int = 0
    """Share of the triangles that may be left out, as they have no area where positions have 16 bits."""
    lost_share: float = 0.0

    def unique_triangles(self):
        return sum(self.meshes[number].triangles() for number in {number for number, _ in self.drawn})

    def drawn_triangles(self):
        return self.triangles_left_out + sum(self.meshes[number].triangles() for number, _ in self.drawn)

    @cached_property
    def bounds(self):
        """Of everything drawn; to be asked for when all of it is there."""
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        columns = [np.ascontiguousarray(mesh.points.T, float) for mesh in self.meshes]
        for number, matrix in self.drawn:
            points = matrix[:3, :3] @ columns[number]
            if points.size:
                low = np.minimum(low, points.min(1) + matrix[:3, 3])
                high = np.maximum(high, points.max(1) + matrix[:3, 3])
        return low, high


def body(name, points, index):
    count = len(points)
    return Mesh(name, points, np.tile([0.0, 0.0, 1.0], (count, 1)), np.zeros((count, 2)), index)


def check_bodies(report, label, bodies):
    """Colliders are closed and convex."""
    faults = []
    for mesh in bodies:
        shape = trimesh.Trimesh(mesh.points, mesh.index.reshape(-1, 3), process=True)
        if not (shape.is_watertight and shape.is_winding_consistent and shape.volume > 0):
            faults.append(f"{mesh.name} is not closed")
        a = mesh.points[mesh.index[0::3]].astype(float)
        normal = np.cross(mesh.points[mesh.index[1::3]] - a, mesh.points[mesh.index[2::3]] - a)
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        outside = np.einsum("pfk,fk->pf", mesh.points[:, None, :] - a[None], normal).max()
        if outside > BOUNDS_TOLERANCE_M:
            faults.append(f"{mesh.name} is not convex: a corner {outside:.4f} m outside a face")
    if bodies:
        report.check(f"{label} colliders closed and convex", faults, f"{len(bodies)} bodies")


def check_meshes(report, label, meshes):
    """What every surface must be, whatever the format."""
    wrong = {kind: [] for kind in ("finite", "indices in range", "normals unit", "no degenerate triangles")}
    for mesh in meshes:
        count = len(mesh.points)
        columns = {"positions": mesh.points, "normals": mesh.normals, "texture coordinates": mesh.uv}
        for what, column in columns.items():
            if len(column) != count:
                wrong["indices in range"].append(f"{mesh.name}: {len(column)} {what} for {count} vertices")
            bad = np.flatnonzero(~np.isfinite(column).all(axis=1))
            if len(bad):
                wrong["finite"].append(f"{mesh.name}: {what} of {len(bad)} vertices, first {bad[0]}")
        length = np.linalg.norm(mesh.normals, axis=1)
        bad = np.flatnonzero(~(np.abs(length - 1) <= UNIT_TOLERANCE))
        if len(bad):
            wrong["normals unit"].append(f"{mesh.name}: {len(bad)} normals, first {bad[0]} of length {length[bad[0]]:.4g}")
        beyond = np.flatnonzero((mesh.index < 0) | (mesh.index >= count))
        if len(beyond) or len(mesh.index) % 3 or not len(mesh.index):
            text = f"index {mesh.index[beyond[0]]} of {count} vertices" if len(beyond) else f"{len(mesh.index)} indices"
            wrong["indices in range"].append(f"{mesh.name}: {text}")
            continue
        a, b, c = (mesh.points[mesh.index[k::3]] for k in range(3))
        exact = np.cross(b.astype(float) - a, c.astype(float) - a)
        single = np.cross(b - a, c - a)
        flat = np.flatnonzero((exact == 0).all(axis=1) | (single == 0).all(axis=1))
        if len(flat):
            wrong["no degenerate triangles"].append(f"{mesh.name}: {len(flat)}, first {flat[0]}")
    triangles = sum(mesh.triangles() for mesh in meshes)
    for kind, faults in wrong.items():
        report.check(f"{label} meshes: {kind}", faults, f"{len(meshes)} meshes, {triangles} triangles")


def check_pictures(report, label, pictures):
    """`pictures`: name → bytes, or None where missing."""
    faults = []
    for name, data in pictures.items():
        try:
            if data is None:
                raise OSError("missing")
            Image.open(io.BytesIO(data)).load()
        except Exception as error:  # Pillow raises many kinds on broken files
            faults.append(f"{name}: {error}")
    report.check(f"{label} textures decode", faults, f"{len(pictures)} pictures")


def height_gaps(triangles, roots):
    """Root minus terrain height, NaN where no triangle lies above or below."""
    gaps = np.full(len(roots), np.nan)
    order = np.argsort(triangles[:, :, 0].min(1))
    triangles = triangles[order]
    low, high = triangles.min(1), triangles.max(1)
    widest = (high[:, 0] - low[:, 0]).max(initial=0)
    for number, root in enumerate(roots):
        first = np.searchsorted(low[:, 0], root[0] - widest)
        last = np.searchsorted(low[:, 0], root[0], "right")
        near = slice(first, last)
        hit = (high[near, 0] >= root[0]) & (low[near, 1] <= root[1]) & (high[near, 1] >= root[1])
        a, b, c = np.moveaxis(triangles[near][hit], 1, 0)
        u, v, w = (b - a), (c - a), (root - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
            s = (w[:, 0] * v[:, 1] - w[:, 1] * v[:, 0]) / area
            t = (u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0]) / area
            inside = (s >= -1e-9) & (t >= -1e-9) & (s + t <= 1 + 1e-9)
        if inside.any():
            height = (a[:, 2] + s * u[:, 2] + t * v[:, 2])[inside]
            gaps[number] = min(root[2] - height, key=abs)
    return gaps


def plan_distance(triangles, root):
    a = triangles[:, [0, 1, 2], :2].reshape(-1, 2)
    b = triangles[:, [1, 2, 0], :2].reshape(-1, 2)
    along, to = b - a, root[:2] - a
    squared = np.maximum((along**2).sum(1), 1e-30)
    t = np.clip((along * to).sum(1) / squared, 0, 1)
    return np.sqrt(((to - along * t[:, None]) ** 2).sum(1).min())


def check_standing(report, label, scene):
    name = f"{label} trees stand on the terrain"
    if not scene.terrain:
        report.check(name, [], "no terrain in the file")
        return
    parts = []
    for number, matrix in scene.drawn:
        if number in scene.terrain:
            mesh = scene.meshes[number]
            if mesh.index.max(initial=0) >= len(mesh.points):
                report.check(name, ["the terrain's indices are out of range"])
                return
            points = mesh.points.astype(float) @ matrix[:3, :3].T + matrix[:3, 3]
            parts.append(points[mesh.index].reshape(-1, 3, 3))
    triangles = np.concatenate(parts)
    ids = list(scene.trees)
    roots = np.array([scene.trees[i][0] for i in ids]).reshape(-1, 3)
    gaps = height_gaps(triangles, roots)
    faults = []
    for tree, root, gap in zip(ids, roots, gaps):
        if np.isnan(gap):
            distance = plan_distance(triangles, root)
            if not distance <= OFF_TERRAIN_M:
                faults.append(f"{tree} is {distance:.2f} m beside the terrain")
        elif abs(gap) > ROOT_TOLERANCE_M + 1e-3:
            faults.append(f"{tree} is {abs(gap):.2f} m {'below' if gap < 0 else 'above'} it")
    worst = np.nanmax(np.abs(gaps), initial=0) if np.isfinite(gaps).any() else 0
    report.check(name, faults, f"{len(ids)} trees, at most {worst:.3f} m off")


# glTF


def read_gltf(path):
    """The document, and its one buffer; compressed views decoded by meshoptimizer's own decoder."""
    data = np.memmap(path, np.uint8, "r")
    if path.suffix == ".glb":
        length = struct.unpack_from("<I", data, 12)[0]
        document = json.loads(bytes(data[20 : 20 + length]))
    else:
        document = json.loads(bytes(data))
    if "EXT_meshopt_compression" in document.get("extensionsUsed", []):
        with tempfile.TemporaryDirectory() as folder:
            decoded = Path(folder) / "decoded.glb"
            readers("decode", path, decoded)
            return read_gltf(decoded)
    if path.suffix == ".glb":
        return document, data[28 + length :]
    return document, np.memmap(path.parent / unquote(document["buffers"][0]["uri"]), np.uint8, "r")


def write_glb(path, document, binary):
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    with open(path, "wb") as out:
        out.write(struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(binary)))
        out.write(struct.pack("<I4s", len(text), b"JSON") + text)
        out.write(struct.pack("<I4s", len(binary), b"BIN\0") + binary)


def accessor_place(document, number):
    """Element type, offset, stride and shape of an accessor."""
    accessor = document["accessors"][number]
    view = document["bufferViews"][accessor["bufferView"]]
    kinds = {5126: "<f4", 5125: "<u4", 5123: "<u2", 5122: "<i2", 5121: "u1", 5120: "i1"}
    kind = np.dtype(kinds[accessor["componentType"]])
    width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[accessor["type"]]
    offset = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    return kind, offset, view.get("byteStride", kind.itemsize * width), (accessor["count"], width)


def accessor_array(document, binary, number):
    kind, offset, stride, shape = accessor_place(document, number)
    return np.ndarray(shape, kind, binary, offset, (stride, kind.itemsize))


def numbers(document, binary, number):
    """The elements of an accessor as they are meant: whole numbers that stand for 0…1 or −1…1 divided."""
    stored = accessor_array(document, binary, number)
    if not document["accessors"][number].get("normalized"):
        return stored
    return stored.astype(np.float32) / np.iinfo(stored.dtype).max


def z_up(vectors):
    """(x, y, z) of glTF to (x, −z, y)."""
    return np.stack([vectors[:, 0], -vectors[:, 2], vectors[:, 1]], axis=1)


def unit(normals, document, number):
    """8 bits do not hold unit vectors to a ten-thousandth: those that are nearly so are made so."""
    if document["accessors"][number]["componentType"] == 5126:
        return normals
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(np.abs(length - 1) < 0.02, normals / np.maximum(length, 1e-9), normals)


def node_matrix(node):
    """In glTF's own axes."""
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    x, y, z, w = node.get("rotation", (0, 0, 0, 1))
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    matrix = np.eye(4)
    matrix[:3, :3] = turn * np.array(node.get("scale", (1, 1, 1)))
    matrix[:3, 3] = node.get("translation", (0, 0, 0))
    return matrix


def instance_matrices(document, binary, node):
    """One for a node without instances."""
    placed = node.get("extensions", {}).get("EXT_mesh_gpu_instancing")
    if not placed:
        return [np.eye(4)]
    get = lambda name: numbers(document, binary, placed["attributes"][name]).astype(float)
    columns = zip(get("TRANSLATION"), get("ROTATION"), get("SCALE"), strict=True)
    turned = lambda q: q / np.linalg.norm(q)
    return [node_matrix({"translation": t, "rotation": turned(q), "scale": s}) for t, q, s in columns]


def gltf_scene(document, binary):
    scene, of_mesh, bodies = Scene(), {}, {}
    for number, mesh in enumerate(document.get("meshes", [])):
        of_mesh[number] = []
        if mesh["name"].startswith(COLLIDERS):
            get = lambda name: numbers(document, binary, mesh["primitives"][0]["attributes"][name])
            index = accessor_array(document, binary, mesh["primitives"][0]["indices"])[:, 0].astype(np.int64)
            bodies[number] = len(scene.bodies)
            scene.bodies.append(body(mesh["name"], z_up(get("POSITION")), index))
            continue
        for part, primitive in enumerate(mesh["primitives"]):
            get = lambda name: numbers(document, binary, primitive["attributes"][name])
            of_mesh[number].append(len(scene.meshes))
            if document["accessors"][primitive["attributes"]["POSITION"]]["componentType"] == 5122:
                scene.lost_share = MOST_LOST
            index = accessor_array(document, binary, primitive["indices"])[:, 0].astype(np.int64)
            scene.meshes.append(
                Mesh(
                    f"{mesh['name']}[{part}]",
                    z_up(get("POSITION")),
                    unit(z_up(get("NORMAL")), document, primitive["attributes"]["NORMAL"]),
                    get("TEXCOORD_0") if "TEXCOORD_0" in primitive["attributes"] else nowhere(get("POSITION")),
                    index,
                )
            )
    axes = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]], float)
    waiting = [(root, np.eye(4)) for root in document["scenes"][document.get("scene", 0)]["nodes"]]
    while waiting:
        number, parent = waiting.pop()
        node = document["nodes"][number]
        matrix = parent @ node_matrix(node)
        ours = [axes @ matrix @ place @ axes.T for place in instance_matrices(document, binary, node)]
        for mesh in of_mesh.get(node.get("mesh"), []):
            scene.drawn += [(mesh, place) for place in ours]
        if node.get("mesh") in bodies:
            scene.bodies_placed += [(bodies[node["mesh"]], place) for place in ours]
        facts = node.get("extras", {})
        if "id" in facts:
            scene.tree_count += 1
            scene.trees[facts["id"]] = (ours[0][:3, 3], facts)
        elif "trees" in facts:
            scene.tree_count += len(ours)
            columns = facts["trees"]
            for k, place in enumerate(ours):
                one = {name: column[k] for name, column in columns.items()}
                scene.trees[one["id"]] = (place[:3, 3], {**one, "species": facts["species"]})
        elif "mesh" in node and node["name"] == "terrain":
            scene.terrain += of_mesh[node["mesh"]]
        waiting += [(child, matrix) for child in node.get("children", [])]
    extras = document["asset"].get("extras", {})
    if "origin" in extras:
        scene.place = (np.array(extras["origin"]), np.array(extras["unit_m"]))
        if "square" in extras:
            scene.square = (np.array(extras["square"]["south_west_m"]), extras["square"]["side_m"])
    return scene


def gltf_pictures(path, document, binary):
    pictures = {}
    for image in document.get("images", []):
        if "bufferView" in image:
            view = document["bufferViews"][image["bufferView"]]
            start = view.get("byteOffset", 0)
            pictures[image["name"]] = binary[start : start + view["byteLength"]]
        else:
            file = path.parent / unquote(image["uri"])
            pictures[image["name"]] = file.read_bytes() if file.is_file() else None
    return pictures


def node_modules():
    modules = os.environ.get("LARIX_NODE_MODULES") or str(Path(__file__).resolve().parent / "node_modules")
    if not shutil.which("node"):
        sys.exit("node is missing: install Node.js 18 or later")
    if not (Path(modules) / "gltf-validator").is_dir():
        sys.exit(f"gltf-validator is not in {modules}: npm install --prefix tools, or set LARIX_NODE_MODULES")
    return modules


def node(*arguments):
    modules = node_modules()
    env = {**os.environ, "NODE_PATH": modules, "LARIX_NODE_MODULES": modules}
    return subprocess.run(["node", *map(str, arguments)], env=env, capture_output=True, text=True)


def readers(*arguments):
    """What tools/readers.mjs found."""
    run = node(Path(__file__).resolve().parent / "readers.mjs", *arguments)
    if run.returncode:
        raise OSError(run.stderr.strip()[-500:])
    return json.loads(run.stdout)


def check_khronos(report, path):
    run = node("-e", KHRONOS, path.resolve())
    if run.returncode:
        report.check(f"{path.name} Khronos validator", [run.stderr.strip() or "no answer"])
        return
    issues = json.loads(run.stdout)
    faults = [f"{m['code']} at {m.get('pointer', '?')}" for m in issues["messages"] if m["severity"] <= 1]
    report.check(f"{path.name} Khronos validator", faults, "0 errors, 0 warnings")


def check_trimesh(report, path, scene):
    try:
        loaded = trimesh.load_scene(path, process=False)
        nodes = [loaded.graph[node] for node in loaded.graph.nodes_geometry]
        triangles = sum(len(loaded.geometry[name].faces) for _, name in nodes)
        faults = []
        if (len(nodes), triangles) != (len(scene.drawn), scene.drawn_triangles()):
            faults.append(f"{len(nodes)} meshes drawn with {triangles} triangles, not {len(scene.drawn)} with {scene.drawn_triangles()}")
        bounds = np.sort(z_up(np.array(loaded.bounds)), axis=0)
        if not np.allclose(bounds, scene.bounds, atol=BOUNDS_TOLERANCE_M, rtol=0):
            faults.append(f"bounds {bounds.tolist()}")
    except Exception as error:  # a reader that falls over has not read the file
        faults = [f"{type(error).__name__}: {error}"]
    report.check(f"{path.name} trimesh reads the same", faults, f"{len(scene.drawn)} meshes drawn")


def check_extensions(report, path, document, binary, scene):
    """What the Khronos validator passes by: instances, levels, textures of its unknown kinds."""
    used, required = (set(document.get(key, [])) for key in ("extensionsUsed", "extensionsRequired"))
    found = set()

    def gather(item):
        if isinstance(item, dict):
            found.update(item.get("extensions", {}))
            for child in item.values():
                gather(child)
        elif isinstance(item, list):
            for child in item:
                gather(child)

    gather(document)
    stored = {"KHR_mesh_quantization", "EXT_meshopt_compression"}
    faults = [f"{name} is used but not listed" for name in found - used]
    faults += [f"{name} is listed but not used" for name in used - found - stored]
    faults += [f"{name} is required but not listed" for name in required - used]
    small = any(
        document["accessors"][primitive["attributes"][name]]["componentType"] != 5126
        for mesh in document.get("meshes", [])
        for primitive in mesh["primitives"]
        for name in ("POSITION", "NORMAL")
        if name in primitive["attributes"]
    )
    if small and "KHR_mesh_quantization" not in required:
        faults.append("numbers of fewer bits without KHR_mesh_quantization")
    report.check(f"{path.name} extensions as listed", faults, ", ".join(sorted(used)) or "none")

    nodes, faults, placed = document["nodes"], [], 0
    for node in nodes:
        instances = node.get("extensions", {}).get("EXT_mesh_gpu_instancing")
        if not instances:
            continue
        placed += 1
        counts = {name: document["accessors"][number]["count"] for name, number in instances["attributes"].items()}
        if len(set(counts.values())) != 1:
            faults.append(f"{node['name']}: {counts}")
            continue
        turns = numbers(document, binary, instances["attributes"]["ROTATION"]).astype(float)
        if not (np.abs(np.linalg.norm(turns, axis=1) - 1) < 1e-3).all():
            faults.append(f"{node['name']}: a rotation is no unit quaternion")
        if not (numbers(document, binary, instances["attributes"]["SCALE"]) > 0).all():
            faults.append(f"{node['name']}: a scale is not positive")
        columns = node.get("extras", {}).get("trees", {})
        if any(len(column) != next(iter(counts.values())) for column in columns.values()):
            faults.append(f"{node['name']}: facts of another number of trees")
    report.check(f"{path.name} instances", faults, f"{placed} nodes of instances")

    faults, levels = [], 0
    reached, waiting = set(), list(document["scenes"][document.get("scene", 0)]["nodes"])
    while waiting:
        number = waiting.pop()
        reached.add(number)
        waiting += nodes[number].get("children", [])
    for node in nodes:
        ids = node.get("extensions", {}).get("MSFT_lod", {}).get("ids")
        if ids is None:
            continue
        covers = node.get("extras", {}).get("MSFT_screencoverage", [])
        levels += len(ids)
        if any(not 0 <= number < len(nodes) for number in ids):
            faults.append(f"{node['name']}: a level that is not there")
            continue
        if reached & set(ids):
            faults.append(f"{node['name']}: a level is drawn on top of it")
        if len(covers) != len(ids) + 1 or any(a <= b for a, b in zip(covers, covers[1:])):
            faults.append(f"{node['name']}: screen coverage {covers} for {len(ids) + 1} levels")
        places = lambda one: (one.get("translation"), one["extensions"]["EXT_mesh_gpu_instancing"])
        if any(places(nodes[number]) != places(node) for number in ids):
            faults.append(f"{node['name']}: a level stands elsewhere")
        drawn = lambda one: sum(
            document["accessors"][p["indices"]]["count"] for p in document["meshes"][one["mesh"]]["primitives"]
        )
        counts = [drawn(one) for one in (node, *(nodes[number] for number in ids))]
        if counts != sorted(counts, reverse=True):
            faults.append(f"{node['name']}: levels of {counts} indices")
    report.check(f"{path.name} levels", faults, f"{levels} levels")


def check_transform(report, path, scene):
    """glTF-Transform reads the same."""
    try:
        found = readers("transform", path)[str(path)]
        drawn = len(scene.drawn) + len(scene.bodies_placed)
        triangles = scene.drawn_triangles() + sum(scene.bodies[n].triangles() for n, _ in scene.bodies_placed)
        faults = []
        if (found["drawn"], found["triangles"]) != (drawn, triangles):
            faults.append(f"{found['drawn']} drawn with {found['triangles']} triangles, not {drawn} with {triangles}")
    except OSError as error:
        faults = [str(error)]
    report.check(f"{path.name} glTF-Transform reads the same", faults, f"{len(scene.drawn)} meshes drawn")


def check_three(report, paths, folder):
    """three.js in headless Chromium reads the same; what it drew is left in `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    pictures = {path: folder / f"{path.parent.name}_{path.stem}.png" for path in paths}
    try:
        found = readers("three", *(f"{path}={picture}" for path, picture in pictures.items()))
    except OSError as error:
        report.check("three.js in Chromium", [str(error)])
        return
    for path, picture in pictures.items():
        one = found[str(path)]
        scene = gltf_scene(*read_gltf(path))
        drawn = len(scene.drawn) + len(scene.bodies_placed)
        triangles = scene.drawn_triangles() + sum(scene.bodies[n].triangles() for n, _ in scene.bodies_placed)
        faults = list(one["said"])
        if (one["drawn"], one["triangles"]) != (drawn, triangles):
            faults.append(f"{one['drawn']} drawn with {one['triangles']} triangles, not {drawn} with {triangles}")
        off = np.abs(np.sort(z_up(np.array(one["bounds"])), axis=0) - scene.bounds).max()
        if not off <= BOUNDS_TOLERANCE_M:
            faults.append(f"bounds {off:.4f} m apart")
        if not one["textures"]:
            faults.append("no textures")
        if len(np.unique(np.array(Image.open(picture).convert("RGB")).reshape(-1, 3), axis=0)) < 100:
            faults.append(f"nothing to be seen in {picture}")
        told = f"{one['objects']} objects, {one['calls']} draw calls, {one['seconds']:.2f} s to load"
        report.check(f"{path.name} three.js reads the same", faults, told)


def needs_meshopt(path):
    return path.suffix in (".glb", ".gltf") and b'"EXT_meshopt_compression"' in path.read_bytes()


def check_blender(report, scenes, python):
    """Blender's importers read the same, or name what they do not know: meshopt."""
    script = Path(__file__).resolve().parent / "blender_reader.py"
    run = subprocess.run([python, str(script), *map(str, scenes)], capture_output=True, text=True)
    lines = [json.loads(line[6:]) for line in run.stdout.splitlines() if line.startswith("FOUND ")]
    if len(lines) != len(scenes):
        report.check("Blender", [run.stderr.strip()[-300:] or "no answer"])
    for found in lines:
        path = Path(found["file"])
        scene = scenes[path]
        label = f"{path.name} Blender {found['blender']} reads the same"
        if needs_meshopt(path):
            is_named = "EXT_meshopt_compression is not available" in found.get("error", "")
            report.check(label, [] if is_named else [str(found)], "refused: no meshopt in Blender")
            continue
        if "error" in found:
            report.check(label, [found["error"]])
            continue
        faults = [f"{name} is not found" for name in found["missing"]]
        if found["triangles"] != scene.drawn_triangles():
            faults.append(f"{found['triangles']} triangles, not {scene.drawn_triangles()}")
        if found["bodies"] and found["bodies"] != len(scene.bodies_placed):
            faults.append(f"{found['bodies']} colliders, not {len(scene.bodies_placed)}")
        off = np.abs(np.array(found["bounds"]) - np.array(scene.bounds)).max()
        if not off <= BOUNDS_TOLERANCE_M:
            faults.append(f"bounds {off:.4f} m apart")
        told = f"{found['objects']} objects, {found['drawn']} drawn, {found['seconds']:.1f} s to load"
        report.check(label, faults, told)


def check_gltf(report, path):
    document, binary = read_gltf(path)
    size = len(binary)
    if size < MOST_KHRONOS_BYTES:
        check_khronos(report, path)
    else:
        report.check(f"{path.name} Khronos validator", [], f"not asked: {size} bytes")
    scene = gltf_scene(document, binary)
    if size >= MOST_TRIMESH_BYTES:
        report.check(f"{path.name} another reader", [], f"not asked: {size} bytes")
    elif document.get("extensionsRequired"):
        # trimesh knows none of them.
        check_transform(report, path, scene)
    else:
        first = len(scene.meshes)
        placed = [(first + body, matrix) for body, matrix in scene.bodies_placed]
        check_trimesh(report, path, Scene(meshes=scene.meshes + scene.bodies, drawn=scene.drawn + placed))
    check_extensions(report, path, document, binary, scene)
    check_bodies(report, path.name, scene.bodies)
    check_meshes(report, path.name, scene.meshes)
    check_pictures(report, path.name, gltf_pictures(path, document, binary))
    return scene


# USD


def check_usd(report, path):
    stage = Usd.Stage.Open(str(path))
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    found = UsdValidation.ValidationContext(validators).Validate(stage)
    faults = [f"{error.GetName()}: {error.GetMessage()}" for error in found]
    report.check(f"{path.name} UsdValidation", faults, f"{len(validators)} validators")

    root = stage.GetDefaultPrim()
    faults = [] if root and UsdGeom.Imageable(root) else ["no defaultPrim that can be shown"]
    if UsdGeom.GetStageUpAxis(stage) != "Z":
        faults.append(f"upAxis {UsdGeom.GetStageUpAxis(stage)}, not Z")
    if UsdGeom.GetStageMetersPerUnit(stage) != 1 or not UsdGeom.StageHasAuthoredMetersPerUnit(stage):
        faults.append(f"metersPerUnit {UsdGeom.GetStageMetersPerUnit(stage)}, not 1")
    if root and not Usd.ModelAPI(root).GetKind():
        faults.append("the defaultPrim has no kind")
    report.check(f"{path.name} up axis, unit, default prim", faults)

    scene = usd_scene(report, path, stage)
    check_forms(report, path, stage)
    check_looks(report, path, stage)
    check_hints(report, path, stage)
    check_bodies(report, path.name, scene.bodies)
    check_meshes(report, path.name, scene.meshes)
    check_pictures(report, path.name, usd_pictures(stage))
    return scene


def nowhere(points):
    """Texture coordinates of a mesh that has none, as no texture covers it."""
    return np.zeros((len(points), 2), np.float32)


def usd_scene(report, path, stage):
    scene, at, extents, instancers = Scene(), {}, [], []
    cache = UsdGeom.XformCache()
    drawn = lambda prims: [p for p in prims if not p.GetName().startswith(COLLIDERS)]
    hidden = lambda prim: UsdGeom.Imageable(prim).ComputePurpose() == UsdGeom.Tokens.proxy
    below = lambda prim, kind: [p for p in usd_below(prim) if p.IsA(kind) and not hidden(p)]
    arrays = lambda attribute, width: np.array(attribute.Get() or [], np.float32).reshape(-1, width)
    unbound = []
    for prim in below(stage.GetPseudoRoot(), UsdGeom.Mesh):
        mesh = UsdGeom.Mesh(prim)
        if prim.GetName().startswith(COLLIDERS):
            index = np.array(mesh.GetFaceVertexIndicesAttr().Get() or [], np.int64)
            scene.bodies.append(body(prim.GetName(), arrays(mesh.GetPointsAttr(), 3), index))
            if UsdGeom.Imageable(prim).GetPurposeAttr().Get() != "guide":
                extents.append(f"{prim.GetName()}: a collider that renderers would draw")
            continue
        points = arrays(mesh.GetPointsAttr(), 3)
        st = UsdGeom.PrimvarsAPI(prim).GetPrimvar("st")
        uv = arrays(st, 2) if st.HasValue() else nowhere(points)
        index = np.array(mesh.GetFaceVertexIndicesAttr().Get() or [], np.int64)
        counts = np.array(mesh.GetFaceVertexCountsAttr().Get() or [])
        name = f"{prim.GetParent().GetName()}/{prim.GetName()}"
        if (counts != 3).any() or counts.sum() != len(index):
            extents.append(f"{name}: face counts do not add up to triangles")
        extents += extent_faults(name, mesh, points)
        if not UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]:
            unbound.append(name)
        at[prim.GetPath()] = len(scene.meshes)
        scene.meshes.append(Mesh(name, points, arrays(mesh.GetNormalsAttr(), 3), uv, index))

    all_instancers = below(stage.GetPseudoRoot(), UsdGeom.PointInstancer)
    is_within = lambda prim, others: any(prim.GetPath().HasPrefix(o.GetPath()) for o in others if o != prim)
    time = Usd.TimeCode.Default()

    def each(prim):
        """What an instancer draws: number of the instance, path of a mesh, its place in the instancer's space."""
        instancer = UsdGeom.PointInstancer(prim)
        protos = [list(within(stage.GetPrimAtPath(t), prim)) for t in instancer.GetPrototypesRel().GetTargets()]
        matrices = np.array(instancer.ComputeInstanceTransformsAtTime(time, time, instancer.ExcludeProtoXform))
        for number, (proto, matrix) in enumerate(zip(instancer.GetProtoIndicesAttr().Get(), matrices)):
            for mesh_path, inner in protos[proto]:
                yield number, mesh_path, inner @ matrix

    def within(target, prim):
        """What a prototype draws, twigs by instancers of its own too, in its instancer's space."""
        inner = [i for i in below(target, UsdGeom.PointInstancer) if not is_within(i, below(target, UsdGeom.PointInstancer))]
        for mesh in drawn(below(target, UsdGeom.Mesh)):
            if not is_within(mesh, inner):
                yield mesh.GetPath(), np.array(cache.ComputeRelativeTransform(mesh, prim)[0])
        for one in inner:
            outer = np.array(cache.ComputeRelativeTransform(one, prim)[0])
            for _, mesh_path, matrix in each(one):
                yield mesh_path, matrix @ outer

    instanced = set()
    for prim in all_instancers:
        instancer = UsdGeom.PointInstancer(prim)
        targets = instancer.GetPrototypesRel().GetTargets()
        is_tree = not is_within(prim, all_instancers)
        faults = instancer_faults(prim, instancer, len(targets), is_tree)
        instancers += faults
        for target in targets:
            instanced |= {mesh.GetPath() for mesh in drawn(below(stage.GetPrimAtPath(target), UsdGeom.Mesh))}
        if faults:
            continue
        world = np.array(cache.GetLocalToWorldTransform(prim))
        here = Scene(meshes=scene.meshes)
        for _, mesh_path, matrix in each(prim):
            here.drawn.append((at[mesh_path], matrix.T))
            if is_tree:
                scene.drawn.append((at[mesh_path], (matrix @ world).T))
        if is_tree:
            primvar = lambda name: UsdGeom.PrimvarsAPI(prim).GetPrimvar(name).Get()
            matrices = np.array(instancer.ComputeInstanceTransformsAtTime(time, time, instancer.ExcludeProtoXform))
            ids, species = primvar("tree_id") or [], primvar("species")
            scene.tree_count += len(matrices)
            for tree, matrix, height in zip(ids, matrices, primvar("height_m")):
                scene.trees[tree] = ((matrix @ world)[3, :3], {"height_m": height, "species": species})
        extents += extent_faults(prim.GetName(), instancer, np.array(here.bounds))
    for mesh_path, number in at.items():
        if mesh_path not in instanced:
            prim = stage.GetPrimAtPath(mesh_path)
            scene.drawn.append((number, np.array(cache.GetLocalToWorldTransform(prim)).T))
            if prim.GetName() == "terrain":
                scene.terrain.append(number)
    report.check(f"{path.name} instancers: array lengths, prototype indices, ids", instancers, f"{scene.tree_count} instances")
    report.check(f"{path.name} extents contain their points", extents)
    report.check(f"{path.name} materials bound", unbound)
    about = stage.GetRootLayer().customLayerData.get("larix", {})
    if "origin" in about:
        scene.place = (np.array(about["origin"]), np.array(about["unit_m"]))
    return scene


def usd_below(prim):
    """All that a renderer could be told to draw, also of prototypes that are shown only in their places."""
    return Usd.PrimRange(prim, Usd.PrimIsActive & Usd.PrimIsLoaded & ~Usd.PrimIsAbstract)


def check_forms(report, path, stage):
    """Coarser forms of prototypes: what each variant draws, alone, and what viewports draw instead."""
    owners = [prim for prim in usd_below(stage.GetPseudoRoot()) if prim.GetVariantSets().HasVariantSet("LOD")]
    if not owners:
        return
    faults, sizes = [], {}
    names = owners[0].GetVariantSets().GetVariantSet("LOD").GetVariantNames()
    stage.SetEditTarget(stage.GetSessionLayer())
    for name in names:
        for prim in owners:
            prim.GetVariantSets().SetSelection("LOD", name)
        for prim in owners:
            meshes = [UsdGeom.Mesh(p) for p in usd_below(prim) if p.IsA(UsdGeom.Mesh)]
            of = lambda purpose: [m for m in meshes if m.ComputePurpose() == purpose]
            triangles = lambda purpose: sum(len(m.GetFaceVertexCountsAttr().Get() or []) for m in of(purpose))
            label = f"{prim.GetName()} as {name}"
            if prim.GetVariantSets().GetVariantSet("LOD").GetVariantNames() != names:
                faults.append(f"{label}: other variants than {names}")
            if not triangles("render") or not triangles("proxy") or triangles("default"):
                faults.append(f"{label}: triangles {[triangles(p) for p in ('render', 'proxy', 'default')]} to render, as proxy, always")
            unbound = [m for m in of("render") + of("proxy") if not UsdShade.MaterialBindingAPI(m.GetPrim()).ComputeBoundMaterial()[0]]
            faults += [f"{label}: {m.GetPrim().GetName()} has no material" for m in unbound]
            for mesh in of("render"):
                targets = UsdGeom.Imageable(mesh).GetProxyPrimRel().GetTargets()
                if len(targets) != 1 or not stage.GetPrimAtPath(targets[0]):
                    faults.append(f"{label}: {mesh.GetPrim().GetName()} has no proxy")
            sizes.setdefault(prim.GetName(), []).append(triangles("render"))
    stage.GetSessionLayer().Clear()
    stage.SetEditTarget(stage.GetRootLayer())
    faults += [f"{name}: {counts} triangles, not from fine to coarse" for name, counts in sizes.items() if counts != sorted(counts, reverse=True)]
    report.check(f"{path.name} forms", faults, f"{len(names)} of {len(owners)} prototypes")


def check_looks(report, path, stage):
    """Seasons and conditions, chosen for the whole scene: each shows leaves in colours of its own."""
    root = stage.GetDefaultPrim()
    if not root or not root.GetVariantSets().HasVariantSet("look"):
        return
    looks = root.GetVariantSets().GetVariantSet("look")
    faults, shown, own = [], {}, looks.GetVariantSelection()
    stage.SetEditTarget(stage.GetSessionLayer())
    for name in [own, *looks.GetVariantNames()]:
        looks.SetVariantSelection(name)
        for prim in usd_below(stage.GetPseudoRoot()):
            if not prim.IsA(UsdGeom.Mesh) or prim.GetName().startswith(COLLIDERS):
                continue
            label = f"{prim.GetPath()} as {name}"
            material = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
            surface = material and material.ComputeSurfaceSource()[0]
            if not surface:
                faults.append(f"{label}: no surface")
                continue
            source = surface.GetInput("diffuseColor").GetConnectedSources()[0]
            if not source:
                shown[label] = str(surface.GetInput("diffuseColor").Get())
                continue
            texture = UsdShade.Shader(source[0].source)
            file, tint = (texture.GetInput(key) for key in ("file", "scale"))
            if not file or not file.Get().resolvedPath:
                faults.append(f"{label}: {file and file.Get().path} is not there")
                continue
            shown[label] = f"{file.Get().path} {tint and tint.Get()}"
    stage.GetSessionLayer().Clear()
    stage.SetEditTarget(stage.GetRootLayer())
    for name in set(looks.GetVariantNames()) - {own}:
        ending = f" as {name}"
        pairs = [(now, shown.get(label.replace(ending, f" as {own}"))) for label, now in shown.items() if label.endswith(ending)]
        if all(now == before for now, before in pairs):
            faults.append(f"{name}: nothing looks other than as {own}")
    report.check(f"{path.name} looks", faults, ", ".join(looks.GetVariantNames()))


def check_hints(report, path, stage):
    """Bounds told by models hold what is in them, purpose by purpose, whichever level is chosen; told once for all
    levels they are no wider than these, told for each as wide as it."""
    faults = []
    models = [p for p in usd_below(stage.GetPseudoRoot()) if p.HasAttribute("extentsHint")]
    purposes = UsdGeom.Imageable.GetOrderedPurposeTokens()
    stage.SetEditTarget(stage.GetSessionLayer())
    for prim in models:
        is_whole = prim == stage.GetDefaultPrim()
        levels = prim.GetVariantSet("LOD")
        boxes = {purpose: [] for purpose in purposes}
        tells = []
        for level in levels.GetVariantNames() or [None]:
            if level:
                levels.SetVariantSelection(level)
            tells.append(np.array(UsdGeom.ModelAPI(prim).GetExtentsHint() or []).reshape(-1, 2, 3))
            for purpose, ends in zip(purposes, tells[-1]):
                cache = UsdGeom.BBoxCache(Usd.TimeCode.Default(), [purpose], useExtentsHint=False)
                box = cache.ComputeUntransformedBound(prim).ComputeAlignedRange()
                if is_whole and purpose != "default":
                    continue
                if box.IsEmpty() != bool((ends[0] > ends[1]).any()):
                    faults.append(f"{prim.GetName()}: bounds of purpose {purpose} told for nothing, or not told")
                elif not box.IsEmpty() and not is_whole:
                    boxes[purpose].append(np.array([box.GetMin(), box.GetMax()]))
        is_told_once = all(np.array_equal(told, tells[0]) for told in tells)
        for k, purpose in enumerate(purposes):
            held = boxes[purpose]
            if is_told_once and held:
                held = [np.array([np.min([b[0] for b in held], axis=0), np.max([b[1] for b in held], axis=0)])]
            for told, box in zip(tells, held):
                if (off := np.abs(box - told[k]).max()) > BOUNDS_TOLERANCE_M:
                    faults.append(f"{prim.GetName()}: bounds of purpose {purpose} off by {off:.4f} m")
    stage.GetSessionLayer().Clear()
    stage.SetEditTarget(stage.GetRootLayer())
    report.check(f"{path.name} bounds told by models", faults, f"{len(models)} models")


def same(a, b):
    """Equal to the last bit but for the sign of zero; files by their path within the scene."""
    if type(a) is not type(b):
        return False
    if isinstance(a, Sdf.AssetPath):
        return a.path.removeprefix("../") == b.path.removeprefix("../")
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[k], b[k]) for k in a)
    if hasattr(a, "__len__") and len(a) > 64 and not isinstance(a, str):
        return np.array_equal(np.array(a), np.array(b))
    return a == b


def stage_differences(first, other):
    """Between two composed stages, prim by prim."""
    a, b = ({prim.GetPath(): prim for prim in stage.TraverseAll()} for stage in (first, other))
    found = [f"{path} is in one only" for path in sorted(a.keys() ^ b.keys(), key=str)]
    arcs = ("payload", "references")

    def metadata(thing):
        return {k: v for k, v in thing.GetAllAuthoredMetadata().items() if k not in arcs}

    pairs = [(first.GetPseudoRoot(), other.GetPseudoRoot())] + [(a[path], b[path]) for path in a.keys() & b.keys()]
    for one, two in pairs:
        path = one.GetPath()
        if not same(metadata(one), metadata(two)):
            found.append(f"{path}: metadata")
        if (one.GetTypeName(), one.GetSpecifier()) != (two.GetTypeName(), two.GetSpecifier()):
            found.append(f"{path}: {two.GetSpecifier()} {two.GetTypeName()}")
        names = one.GetAuthoredPropertyNames()
        if names != two.GetAuthoredPropertyNames():
            found.append(f"{path}: properties {sorted(set(names) ^ set(two.GetAuthoredPropertyNames()))}")
            continue
        for p, q in zip(one.GetAuthoredProperties(), two.GetAuthoredProperties()):
            if not same(metadata(p), metadata(q)) or type(p) is not type(q):
                found.append(f"{p.GetPath()}: metadata")
            elif isinstance(p, Usd.Relationship):
                if p.GetTargets() != q.GetTargets():
                    found.append(f"{p.GetPath()}: targets")
            elif p.GetConnections() != q.GetConnections():
                found.append(f"{p.GetPath()}: connections")
            elif not same(p.Get(), q.Get()):
                found.append(f"{p.GetPath()}: value")
    return found, len(pairs)


def layer_differences(first, other):
    """Between two layers, spec by spec and field by field, variants with them."""

    def paths(layer):
        found = []
        layer.Traverse(Sdf.Path.absoluteRootPath, found.append)
        return found

    def plain(value):
        if isinstance(value, (Sdf.PayloadListOp, Sdf.ReferenceListOp)):
            return str(value).replace(".usdc", ".usda")
        return value

    a, b = paths(first), paths(other)
    found = [f"{path} is in one only" for path in sorted(set(a) ^ set(b), key=str)]
    fields = 0
    for path in set(a) & set(b):
        one, two = first.GetObjectAtPath(path), other.GetObjectAtPath(path)
        if one is None or two is None:
            continue
        keys = set(one.ListInfoKeys())
        fields += len(keys)
        if type(one) is not type(two) or keys != set(two.ListInfoKeys()):
            found.append(f"{path}: {sorted(keys ^ set(two.ListInfoKeys()))}")
            continue
        found += [f"{path}: {key}" for key in keys if not same(plain(one.GetInfo(key)), plain(two.GetInfo(key)))]
        if isinstance(one, Sdf.PrimSpec) and list(one.properties.keys()) != list(two.properties.keys()):
            found.append(f"{path}: order of properties")
    return found, fields


def check_same(report, path, other):
    """Two encodings of one scene."""
    stages = [Usd.Stage.Open(str(p)) for p in (path, other)]
    found, prims = stage_differences(*stages)
    report.check(f"{other.name} composes to the same as {path.name}", found, f"{prims} prims")
    if {path.suffix, other.suffix} == {".usda", ".usdc"}:
        by_stem = [{Path(l.realPath).stem: l for l in stage.GetUsedLayers() if l.realPath} for stage in stages]
        found = [f"{stem}: a layer of one only" for stem in by_stem[0].keys() ^ by_stem[1].keys()]
        fields = 0
        for stem in by_stem[0].keys() & by_stem[1].keys():
            wrong, count = layer_differences(by_stem[0][stem], by_stem[1][stem])
            found += wrong
            fields += count
        report.check(f"{other.name} has the same layers as {path.name}", found, f"{len(by_stem[0])} layers, {fields} fields")


def check_same_layers(report, folder):
    """Every `.usda` of a folder against the `.usdc` of its name, and that against what usd-core makes of it."""
    texts = sorted(folder.glob("*.usda"))
    wrong, fields, ours, theirs = [], 0, 0, 0
    with tempfile.TemporaryDirectory() as scratch:
        for text in texts:
            binary = text.with_suffix(".usdc")
            try:
                first, other = (Sdf.Layer.OpenAsAnonymous(str(p)) for p in (text, binary))
            except Exception as error:  # whatever a broken file makes of a reader
                wrong.append(f"{text.stem}: {error}")
                continue
            found, count = layer_differences(first, other)
            wrong += [f"{text.stem} {what}" for what in found]
            fields += count
            copy = Path(scratch) / "copy.usdc"
            first.Export(str(copy))
            ours += binary.stat().st_size
            theirs += copy.stat().st_size
    report.check("layers as text and as crate files", wrong if texts else ["no layers"], f"{len(texts)} layers, {fields} fields")
    much = [f"{ours} bytes, {theirs} by usd-core"] if ours > 1.1 * theirs else []
    report.check("crate files no larger than a tenth more than usd-core's", much, f"{ours} bytes, {theirs} by usd-core")


def extent_faults(name, boundable, points):
    extent = boundable.GetExtentAttr().Get()
    if not extent or len(extent) != 2:
        return [f"{name}: no extent"]
    low, high = np.array(extent)
    if len(points) and not ((points >= low - BOUNDS_TOLERANCE_M).all() and (points <= high + BOUNDS_TOLERANCE_M).all()):
        return [f"{name}: points outside {low.tolist()} … {high.tolist()}"]
    return []


def instancer_faults(prim, instancer, prototypes, is_tree):
    """`is_tree`: of trees, of which more is said than of twigs."""
    index = np.array(instancer.GetProtoIndicesAttr().Get() or [])
    faults = []
    if not len(index):
        faults.append(f"{prim.GetName()}: no instances")
    elif index.min() < 0 or index.max() >= prototypes:
        faults.append(f"{prim.GetName()}: protoIndices {index.min()}…{index.max()} of {prototypes} prototypes")
    required = ("positions", "orientations", "scales")
    required += ("ids", "primvars:tree_id", "primvars:height_m") if is_tree else ()
    for attribute in prim.GetAuthoredAttributes():
        name, value = attribute.GetName(), attribute.Get()
        per_instance = name in (*required, "orientationsf")
        if name.startswith("primvars:"):
            per_instance = UsdGeom.Primvar(attribute).GetInterpolation() == "vertex"
        if per_instance and len(value or []) != len(index):
            faults.append(f"{prim.GetName()}: {len(value or [])} {name} for {len(index)} instances")
        if name in ("positions", "scales") and value is not None and not np.isfinite(np.array(value)).all():
            faults.append(f"{prim.GetName()}: {name} not finite")
    faults += [f"{prim.GetName()}: no {name}" for name in required if not prim.GetAttribute(name).HasAuthoredValue()]
    ids = instancer.GetIdsAttr().Get() or []
    if len(set(ids)) != len(ids):
        faults.append(f"{prim.GetName()}: ids are not unique")
    return faults


def usd_pictures(stage):
    pictures = {}
    for prim in stage.TraverseAll():
        attribute = prim.GetAttribute("inputs:file")
        if attribute and attribute.Get():
            asset = attribute.Get()
            opened = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(asset.resolvedPath)) if asset.resolvedPath else None
            pictures[asset.path] = bytes(opened.GetBuffer()) if opened else None
    return pictures


# Agreement


def check_unique_ids(report, label, scene):
    faults = [] if len(scene.trees) == scene.tree_count else [f"{scene.tree_count} trees, {len(scene.trees)} ids"]
    report.check(f"{label} every tree has an id of its own", faults, f"{scene.tree_count} trees")


def check_agreement(report, first, scene, other, against, repeats_models=False):
    label = f"{other} agrees with {first}:"
    share = max(scene.lost_share, against.lost_share)
    counts = {"trees": (lambda s: s.tree_count, 0), "instanced triangles": (Scene.drawn_triangles, share)}
    if not repeats_models:
        counts["unique triangles"] = (Scene.unique_triangles, share)
    for what, (count, lost) in counts.items():
        a, b = count(scene), count(against)
        report.check(f"{label} {what}", [f"{b}, not {a}"] if abs(a - b) > lost * a else [], str(a))
    off = np.abs(np.array(scene.bounds) - np.array(against.bounds)).max()
    report.check(f"{label} bounds", [] if off <= BOUNDS_TOLERANCE_M else [f"{off:.4f} m apart"], f"{off * 1000:.3f} mm apart")
    faults = [f"{tree} is in one only" for tree in sorted(scene.trees.keys() ^ against.trees.keys())]
    for tree in scene.trees.keys() & against.trees.keys():
        (a, facts), (b, others) = scene.trees[tree], against.trees[tree]
        if not np.linalg.norm(a - b) <= BOUNDS_TOLERANCE_M or facts["species"] != others["species"]:
            faults.append(f"{tree} differs in place or species")
    report.check(f"{label} each tree", faults)


def check_inventory(report, inventory, label, scene):
    features = json.loads(inventory.read_text())["features"]
    by_id = {str(feature["properties"].get("id")): feature for feature in features}
    faults = [f"{len(features)} trees in the inventory, {scene.tree_count} in the file"] if len(features) != scene.tree_count else []
    faults += [f"{tree} is in one only" for tree in sorted(by_id.keys() ^ scene.trees.keys())]
    report.check(f"{label} agrees with {inventory.name}: trees", faults, f"{len(features)} trees")
    faults = []
    for tree in by_id.keys() & scene.trees.keys():
        (root, facts), feature = scene.trees[tree], by_id[tree]
        height = feature["properties"].get("height_m")
        if height is not None and not abs(height - facts["height_m"]) <= 0.01:
            faults.append(f"{tree}: height {facts['height_m']:.2f} m, not {height:.2f}")
        if scene.place and feature.get("geometry"):
            corners = np.array(list(plan_points(feature["geometry"]["coordinates"])))
            east_north = scene.place[0][:2] + root[:2] / scene.place[1][:2]
            margin = OUTLINE_TOLERANCE_M / scene.place[1][:2]
            if not ((east_north >= corners.min(0) - margin) & (east_north <= corners.max(0) + margin)).all():
                faults.append(f"{tree}: its root is outside its outline")
    report.check(f"{label} agrees with {inventory.name}: heights, places", faults)


def plan_points(coordinates):
    """Every [x, y, …] of a geometry, however deep."""
    waiting = [coordinates]
    while waiting:
        item = waiting.pop()
        if item and isinstance(item[0], (int, float)):
            yield item[:2]
        else:
            waiting += item


def check_file(report, path):
    read = check_gltf if path.suffix in (".glb", ".gltf") else check_usd
    try:
        scene = read(report, path)
    except Exception as error:  # whatever a broken file makes of a reader
        report.check(f"{path.name} can be read", [f"{type(error).__name__}: {error}"])
        return None
    report.check(f"{path.name} can be read", [])
    check_unique_ids(report, path.name, scene)
    check_standing(report, path.name, scene)
    return scene


def check_all(report, paths, inventory=None, blender=None):
    read = {path: scene for path in paths if (scene := check_file(report, path))}
    if blender:
        check_blender(report, read, blender)
    scenes = [(path.name, scene) for path, scene in read.items()]
    for other, against in scenes[1:]:
        check_agreement(report, *scenes[0], other, against)
    usd = [path for path in paths if path.suffix.startswith(".usd")]
    for other in usd[1:]:
        check_same(report, usd[0], other)
    for label, scene in scenes if inventory else []:
        check_inventory(report, inventory, label, scene)


def without_trees(scene):
    """The same without the surfaces of trees, of which many files hold more than memory does."""
    if scene is None:
        return None
    slim = Scene(trees=scene.trees, tree_count=scene.tree_count, place=scene.place, square=scene.square)
    slim.meshes = [scene.meshes[number] for number in scene.terrain]
    slim.terrain = list(range(len(slim.meshes)))
    slim.drawn = [(scene.terrain.index(number), matrix) for number, matrix in scene.drawn if number in scene.terrain]
    slim.triangles_left_out = scene.drawn_triangles() - slim.drawn_triangles()
    slim.lost_share = scene.lost_share
    slim.bounds = scene.bounds
    return slim


def joined(scenes):
    whole = Scene()
    for scene in scenes:
        first = len(whole.meshes)
        whole.meshes += scene.meshes
        whole.drawn += [(first + number, matrix) for number, matrix in scene.drawn]
        whole.terrain += [first + number for number in scene.terrain]
        whole.trees |= scene.trees
        whole.tree_count += scene.tree_count
        whole.triangles_left_out += scene.triangles_left_out
        whole.lost_share = max(whole.lost_share, scene.lost_share)
    low, high = zip(*(scene.bounds for scene in scenes))
    whole.bounds = np.min(low, axis=0), np.max(high, axis=0)
    return whole


def terrain_corners(scene):
    """Places and normals of the corners of the terrain's triangles, (triangles, 3, 6)."""
    found = [np.zeros((0, 3, 6), np.float32)]
    for number, matrix in scene.drawn:
        if number in scene.terrain:
            mesh = scene.meshes[number]
            points = mesh.points.astype(float) @ matrix[:3, :3].T + matrix[:3, 3]
            # Adding nothing takes the sign off a zero.
            found.append((np.hstack([points, mesh.normals]) + 0.0).astype(np.float32)[mesh.index].reshape(-1, 3, 6))
    return np.concatenate(found)


def terrain_differences(scene, together):
    """Whether both have the same triangles, each once, whichever their order: then parts have no seam."""
    a, b = terrain_corners(scene), terrain_corners(together)
    if a.shape != b.shape:
        return [f"{len(b)} triangles, not {len(a)}"]
    _, corner = np.unique(np.concatenate([a, b]).reshape(-1, 6), axis=0, return_inverse=True)
    corner = corner.reshape(-1, 3)
    turn = (corner.argmin(axis=1)[:, None] + np.arange(3)) % 3
    corner = np.take_along_axis(corner, turn, axis=1)
    first, second = (half[np.lexsort(half.T)] for half in np.split(corner, 2))
    apart = int((first != second).any(axis=1).sum())
    return [f"{apart} triangles differ"] if apart else []


def check_squares(report, paths, scenes):
    """Trees, and middles of the terrain's triangles, are in the square that their file tells."""
    faults = []
    for path, scene in zip(paths, scenes):
        if scene.square is None:
            continue
        corner, side_m = scene.square
        places = {tree: root[:2] for tree, (root, _) in scene.trees.items()}
        middles = terrain_corners(scene)[:, :, :2].astype(float).mean(axis=1)
        places |= {f"triangle {number} of the terrain": middle for number, middle in enumerate(middles)}
        for name, place in places.items():
            from_corner = place - corner
            if not ((from_corner >= -BOUNDS_TOLERANCE_M) & (from_corner <= side_m + BOUNDS_TOLERANCE_M)).all():
                faults.append(f"{name} is outside that of {path.name}")
    report.check(f"{len(paths)} parts keep to their squares", faults)


@dataclass
class Photo:
    """The terrain's picture in a file, and where its vertices have it, in pixels from the top left."""

    pixels: np.ndarray
    coding: str
    index: np.ndarray
    """Vertices by their place in the scene, for all files alike."""
    places: list
    shown: np.ndarray

    def sample(self, at):
        """As readers draw it: between the middles of pixels, held at the edges."""
        most = np.array(self.pixels.shape[1::-1]) - 1
        at = np.clip(at - 0.5, 0, most)
        low = np.floor(at).astype(int)
        high, (u, v) = np.minimum(low + 1, most), (at - low).T[:, :, None]
        row = lambda y: self.pixels[y, low[:, 0]] * (1 - u) + self.pixels[y, high[:, 0]] * u
        return row(low[:, 1]) * (1 - v) + row(high[:, 1]) * v


def terrain_photo(path):
    """`None` where there is no terrain or no picture on it."""
    document, binary = read_gltf(path)
    scene = gltf_scene(document, binary)
    nodes = [node for node in document["nodes"] if node["name"] == "terrain" and "mesh" in node]
    if not nodes:
        return None
    material = document["materials"][document["meshes"][nodes[0]["mesh"]]["primitives"][0]["material"]]
    reference = material["pbrMetallicRoughness"].get("baseColorTexture")
    if reference is None:
        return None
    texture = document["textures"][reference["index"]]
    source = texture.get("extensions", {}).get("EXT_texture_webp", texture)["source"]
    data = list(gltf_pictures(path, document, binary).values())[source]
    with Image.open(io.BytesIO(data)) as image:
        pixels, coding = np.asarray(image.convert("RGB"), np.float32), image.format
    (number, matrix), = ((number, matrix) for number, matrix in scene.drawn if number in scene.terrain)
    mesh = scene.meshes[number]
    transform = reference.get("extensions", {}).get("KHR_texture_transform", {})
    uv = mesh.uv.astype(float) * transform.get("scale", (1, 1)) + transform.get("offset", (0, 0))
    points = (mesh.points.astype(float) @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32) + np.float32(0)
    return Photo(pixels, coding, mesh.index, [point.tobytes() for point in points], uv * pixels.shape[1::-1])


def check_photos(report, paths, whole):
    """Parts of a terrain show what the whole shows; those that have a crop of its picture have a border about it."""
    expected = terrain_photo(whole)
    if expected is None:
        return
    at = dict(zip(expected.places, expected.shown))
    size = np.array(expected.pixels.shape[1::-1])
    faults, pixels, worst = [], 0, 0.0
    for path in paths:
        photo = terrain_photo(path)
        if photo is None:
            continue
        own_size = np.array(photo.pixels.shape[1::-1])
        pixels += own_size.prod()
        of_whole = np.array([at.get(place, (np.nan, np.nan)) for place in photo.places])
        corner = np.round(np.nanmedian(of_whole - photo.shown, axis=0))
        off = np.abs(photo.shown + corner - of_whole).max()
        if not off <= PHOTO_TOLERANCE_PX or (corner < 0).any() or (corner + own_size > size).any():
            faults.append(f"{path.name} shows other places of the picture, by {off:.2f} pixels")
            continue
        low, high = photo.shown.min(0), own_size - photo.shown.max(0)
        bare = ((low < PHOTO_BORDER_PX) & (corner > 0)) | ((high < PHOTO_BORDER_PX) & (corner + own_size < size))
        if bare.any():
            faults.append(f"{path.name} has no border about its crop")
        middles = photo.shown[photo.index].reshape(-1, 3, 2).mean(1)
        apart = np.abs(photo.sample(middles) - expected.sample(middles + corner))
        worst = max(worst, apart.max())
        most, mean = PHOTO_LEVELS[photo.coding]
        if not (apart.max() <= most and apart.mean() <= mean):
            faults.append(f"{path.name} has other colours, by {apart.mean():.2f} levels, {apart.max():.0f} at most")
    report.check(
        f"{len(paths)} parts show the photo of the whole",
        faults,
        f"{pixels / size.prod():.2f} times its pixels, colours off by {worst:.0f} levels at most",
    )


def check_parts(report, paths, whole):
    """Whether files are, together, what one file is."""
    scenes = [without_trees(check_file(report, path)) for path in [*paths, whole]]
    if None in scenes:
        return
    together = joined(scenes[:-1])
    label = f"{len(paths)} parts"
    places = {str([column.tolist() for column in scene.place or ()]) for scene in scenes}
    report.check(f"{label} have one origin", [f"{len(places)} origins"] if len(places) > 1 else [])
    check_squares(report, paths, scenes)
    check_unique_ids(report, label, together)
    check_standing(report, label, together)
    check_agreement(report, whole.name, scenes[-1], label, together, repeats_models=True)
    report.check(f"{label} have the terrain of the whole, without a seam", terrain_differences(scenes[-1], together))
    check_photos(report, paths, whole)


# Seeded defects


def glb_defects():
    """Name → (part of the name of the check that must fail, change of document and buffer)."""

    def array(d, b, attribute):
        primitive = d["meshes"][-1]["primitives"][0]
        return accessor_array(d, b, primitive["attributes"].get(attribute, primitive["indices"]))

    def put(attribute, element, value):
        return lambda d, b: array(d, b, attribute).__setitem__(element, value)

    def lead_nowhere(d, b):
        index = array(d, b, "indices")
        index[0] = np.iinfo(index.dtype).max - 1

    def flatten(d, b):
        index = array(d, b, "indices")
        index[1] = index[0]

    def break_picture(d, b):
        view = d["bufferViews"][d["images"][0]["bufferView"]]
        start = view.get("byteOffset", 0)
        b[start : start + view["byteLength"]] = bytes(view["byteLength"])

    tree = lambda d: next(node for node in d["nodes"] if "id" in node.get("extras", {}))
    group = lambda d: next(node for node in d["nodes"] if node.get("children") and "id" in d["nodes"][node["children"][0]].get("extras", {}))

    def sink(d, b):
        tree(d)["translation"][1] -= 3

    def same_id(d, b):
        two = [d["nodes"][child] for child in group(d)["children"][:2]]
        two[1]["extras"]["id"] = two[0]["extras"]["id"]

    def move(d, b):
        tree(d)["translation"][0] += 0.3

    return {
        "an index too large": ("indices in range", lead_nowhere),
        "a NaN position": ("finite", put("POSITION", (0, 0), np.nan)),
        "a long normal": ("normals unit", put("NORMAL", 0, 0.6)),
        "a flat triangle": ("no degenerate triangles", flatten),
        "a broken picture": ("textures decode", break_picture),
        "wrong bounds of positions": ("Khronos validator", lambda d, b: d["accessors"][0]["max"].__setitem__(0, 1e4)),
        "a tree below the ground": ("stand on the terrain", sink),
        "two trees of one id": ("id of its own", same_id),
        "a dropped tree": (": trees", lambda d, b: group(d)["children"].pop()),
        "a moved tree": ("each tree", move),
    }


def engine_defects():
    """The same of a .glb with instances and levels."""

    def cell(d):
        levels = lambda node: len(node.get("extensions", {}).get("MSFT_lod", {}).get("ids", []))
        return max(d["nodes"], key=levels)

    level = lambda d: d["nodes"][cell(d)["extensions"]["MSFT_lod"]["ids"][0]]

    def put(attribute, element, change):
        def seed(d, b):
            number = cell(d)["extensions"]["EXT_mesh_gpu_instancing"]["attributes"][attribute]
            array = accessor_array(d, b, number)
            array[element] = change(array[element])

        return seed

    def draw_level(d, b):
        d["nodes"][0]["children"].append(cell(d)["extensions"]["MSFT_lod"]["ids"][0])

    return {
        "a tree below the ground": ("stand on the terrain", put("TRANSLATION", (0, 1), lambda y: y - 3)),
        "a moved tree": ("each tree", put("TRANSLATION", (0, 0), lambda x: x + 0.3)),
        "a turn that is none": ("instances", put("ROTATION", 0, lambda q: q // 2)),
        "a size of nothing": ("instances", put("SCALE", 0, lambda s: s * 0)),
        "facts of too few trees": ("can be read", lambda d, b: cell(d)["extras"]["trees"]["height_m"].pop()),
        "a level drawn on top": ("levels", draw_level),
        "a level that comes too early": ("levels", lambda d, b: cell(d)["extras"]["MSFT_screencoverage"].reverse()),
        "a level elsewhere": ("levels", lambda d, b: level(d).update(translation=[1, 2, 3])),
        "levels from coarse to fine": ("levels", lambda d, b: cell(d)["extensions"]["MSFT_lod"]["ids"].reverse()),
        "an extension not listed": ("extensions as listed", lambda d, b: d["extensionsUsed"].remove("MSFT_lod")),
        "an extension not required": ("extensions as listed", lambda d, b: d["extensionsRequired"].remove("KHR_mesh_quantization")),
    }


def usd_defects():
    """Name → (part of the name of the check that must fail, change of the stage)."""

    def prims(stage, kind):
        return [prim for prim in stage.TraverseAll() if prim.IsA(kind)]

    def put(kind, name, element, value):
        def change(stage):
            attribute = prims(stage, kind)[-1].GetAttribute(name)
            values = list(attribute.Get())
            values[element] = value(values[element])
            attribute.Set(values)

        return change

    def flatten(stage):
        attribute = prims(stage, UsdGeom.Mesh)[-1].GetAttribute("faceVertexIndices")
        values = list(attribute.Get())
        attribute.Set([values[0]] + values[:1] + values[2:])

    def drop(stage):
        prim = prims(stage, UsdGeom.PointInstancer)[0]
        count = len(prim.GetAttribute("protoIndices").Get())
        for attribute in prim.GetAttributes():
            value = attribute.Get()
            if attribute.GetName() != "extent" and hasattr(value, "__len__") and len(value) == count:
                attribute.Set(type(value)(list(value)[:-1]))

    def lose_picture(stage):
        asset = next(p.GetAttribute("inputs:file").Get() for p in stage.TraverseAll() if p.GetAttribute("inputs:file"))
        Path(asset.resolvedPath).unlink()

    def lose_look(stage):
        folder = Path(stage.GetRootLayer().realPath).parent / "textures"
        next(folder.glob("*_autumn.png")).unlink()

    def shorten(stage):
        attribute = prims(stage, UsdGeom.PointInstancer)[0].GetAttribute("scales")
        attribute.Set(Vt.Vec3fArray(list(attribute.Get())[:-1]))

    mesh, instancer = UsdGeom.Mesh, UsdGeom.PointInstancer
    nan = Gf.Vec3f(float("nan"), 0, 0)
    return {
        "an index too large": ("indices in range", put(mesh, "faceVertexIndices", 0, lambda _: 10**8)),
        "a NaN position": ("finite", put(mesh, "points", 0, lambda _: nan)),
        "a long normal": ("normals unit", put(mesh, "normals", 0, lambda n: n * 1.5)),
        "a flat triangle": ("no degenerate triangles", flatten),
        "a missing picture": ("textures decode", lose_picture),
        "a look without its picture": ("looks", lose_look),
        "a tree below the ground": ("stand on the terrain", put(instancer, "positions", 0, lambda p: p - Gf.Vec3f(0, 0, 3))),
        "a prototype index too large": ("instancers", put(instancer, "protoIndices", 0, lambda _: 10**6)),
        "arrays of different lengths": ("instancers", shorten),
        "a small extent": ("extents", put(instancer, "extent", 1, lambda p: p * 0.5)),
        "Y up": ("up axis", lambda stage: UsdGeom.SetStageUpAxis(stage, "Y")),
        "no default prim": ("default prim", lambda stage: stage.ClearDefaultPrim()),
        "a binding without its schema": ("UsdValidation", lambda stage: prims(stage, UsdGeom.Mesh)[0].RemoveAPI(UsdShade.MaterialBindingAPI)),
        "a dropped tree": (": trees", drop),
        "a moved tree": ("each tree", put(instancer, "positions", 0, lambda p: p + Gf.Vec3f(0.3, 0, 0))),
    }


def same_defects():
    """Name → change of a stage that is otherwise the same as another."""
    mesh = lambda stage: next(p for p in usd_below(stage.GetPseudoRoot()) if p.IsA(UsdGeom.Mesh))

    def nudge(stage):
        attribute = mesh(stage).GetAttribute("points")
        values = list(attribute.Get())
        values[-1] += Gf.Vec3f(0, 0, 1e-4)
        attribute.Set(values)

    def rename_file(stage):
        prim = next(p for p in stage.TraverseAll() if p.GetAttribute("inputs:file"))
        prim.GetAttribute("inputs:file").Set(Sdf.AssetPath("textures/other.png"))

    return {
        "a point a little off": nudge,
        "an order of triangles": lambda stage: mesh(stage).GetAttribute("orientation").Set("leftHanded"),
        "another file": rename_file,
        "another kind": lambda stage: Usd.ModelAPI(stage.GetDefaultPrim()).SetKind("component"),
        "another binding": lambda stage: mesh(stage).GetRelationship("material:binding").SetTargets(["/elsewhere"]),
        "another place on the map": lambda stage: stage.GetRootLayer().__setattr__("customLayerData", {}),
    }


def check_broken_sameness(report, usda):
    for defect, change in same_defects().items():
        stage = Usd.Stage.Open(str(usda))
        with tempfile.TemporaryDirectory() as folder:
            copy = copied(usda, Path(folder))
            changed = Usd.Stage.Open(str(copy))
            change(changed)
            found, _ = stage_differences(stage, changed)
            del changed
        report.check(f"self-test: {defect} in a copy of {usda.name}", [] if found else ["no difference found"], "caught")


def copied(path, folder):
    """With what it refers to."""
    for beside in ("textures", "assets"):
        if (path.parent / beside).is_dir():
            shutil.copytree(path.parent / beside, folder / beside)
    return Path(shutil.copy(path, folder))


def check_broken_compression(report, path):
    """A compressed view whose first byte is another is not taken for sound."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(shutil.copy(path, folder))
        data = bytearray(copy.read_bytes())
        start = 20 + struct.unpack_from("<I", data, 12)[0] + 8
        document = json.loads(data[20 : start - 8])
        views = (view.get("extensions", {}).get("EXT_meshopt_compression") for view in document["bufferViews"])
        data[start + next(view for view in views if view).get("byteOffset", 0)] ^= 0xFF
        copy.write_bytes(data)
        seeded = Report(quiet=True)
        check_file(seeded, copy)
    faults = [] if any("can be read" in name for name in seeded.failed) else [f"only {seeded.failed} failed"]
    report.check(f"self-test: a broken view in {path.name}", faults, "caught")


def parts_defects():
    """Name → (part of the name of the check that must fail, change of the parts: path → [document, buffer])."""
    tree = lambda document: next(node for node in document["nodes"] if "id" in node.get("extras", {}))
    has_trees = lambda document: any("id" in node.get("extras", {}) for node in document["nodes"])
    of_trees = lambda parts: [path for path, (document, _) in parts.items() if has_trees(document)]

    def of_terrain(parts):
        return [path for path, (document, _) in parts.items() if any(node["name"] == "terrain" for node in document["nodes"])]

    def lose(paths):
        return lambda parts: parts.pop(paths(parts)[0])

    def put_twice(parts):
        one, other = (tree(parts[path][0]) for path in of_trees(parts)[:2])
        other.update(extras=one["extras"], translation=one["translation"])

    def stand_elsewhere(parts):
        """In the file of another square, where it is in the whole."""
        one, other = (tree(parts[path][0]) for path in of_trees(parts)[:2])
        for key in ("extras", "translation"):
            one[key], other[key] = other[key], one[key]

    def move_origin(parts):
        parts[of_trees(parts)[0]][0]["asset"]["extras"]["origin"][0] += 0.001

    def all_of_terrain(attribute, by):
        def change(parts):
            document, binary = parts[of_terrain(parts)[0]]
            primitive = next(mesh for mesh in document["meshes"] if mesh["name"] == "terrain")["primitives"][0]
            numbers = accessor_array(document, binary, primitive["attributes"][attribute])
            numbers[:] = by(numbers)

        return change

    def corner_of_terrain(attribute, by):
        return all_of_terrain(attribute, lambda numbers: np.concatenate([[by(numbers[0])], numbers[1:]]))

    def tilted(normal):
        normal = normal + np.float32([0.01, 0, 0])
        return normal / np.linalg.norm(normal)

    def photo_of(parts):
        """The picture of a part of the terrain, and what puts another in its place."""
        path = of_terrain(parts)[0]
        document, binary = parts[path]
        picture = document["images"][0]
        image = Image.open(io.BytesIO(gltf_pictures(path, document, bytes(binary))[picture["name"]]))

        def put(other):
            coded = io.BytesIO()
            other.save(coded, image.format)
            coded = coded.getvalue()
            document["bufferViews"][picture["bufferView"]].update(byteOffset=len(binary), byteLength=len(coded))
            binary.extend(coded + bytes(-len(coded) % 4))
            document["buffers"][0]["byteLength"] = len(binary)

        return image, put

    def darken_photo(parts):
        image, put = photo_of(parts)
        put(Image.eval(image, lambda level: level * 9 // 10))

    def crop_closely(parts):
        """Without the border: what is shown fills the picture."""
        image, put = photo_of(parts)

        def closer(uv):
            low, high = np.floor(uv.min(0) * image.size), np.ceil(uv.max(0) * image.size)
            put_later.append(image.crop([*map(int, low), *map(int, high)]))
            return (uv * image.size - low) / (high - low)

        put_later = []
        all_of_terrain("TEXCOORD_0", closer)(parts)
        put(put_later[0])

    photo = "show the photo of the whole"
    return {
        "a photo that has slid": (photo, all_of_terrain("TEXCOORD_0", lambda uv: uv + np.float32([0.002, 0]))),
        "a darker photo": (photo, darken_photo),
        "a photo without a border": (photo, crop_closely),
        "a part of trees missing": (": trees", lose(of_trees)),
        "a part of the terrain missing": ("without a seam", lose(of_terrain)),
        "a tree in two parts": ("parts every tree has an id of its own", put_twice),
        "a tree in the part of another square": ("keep to their squares", stand_elsewhere),
        "an origin that differs": ("one origin", move_origin),
        "a corner of the terrain a little off": ("without a seam", corner_of_terrain("POSITION", lambda p: p + np.float32([0, 1e-4, 0]))),
        "a normal at a seam of the terrain that differs": ("without a seam", corner_of_terrain("NORMAL", tilted)),
    }


def parts_self_test(report, paths, whole):
    sound = Report(quiet=True)
    check_parts(sound, paths, whole)
    report.check("self-test: the parts as they are", sound.failed, f"{sound.checks} checks pass")
    if sound.failed:
        return
    is_cut = any("_terrain_x" in path.name for path in paths)
    for defect, (expected, change) in parts_defects().items():
        if "border" in defect and not is_cut:
            continue
        with tempfile.TemporaryDirectory() as folder:
            parts = {}
            for path in paths:
                document, binary = read_gltf(path)
                parts[Path(folder) / path.name] = [document, bytearray(binary)]
            change(parts)
            for path, (document, binary) in parts.items():
                write_glb(path, document, bytes(binary))
            seeded = Report(quiet=True)
            check_parts(seeded, list(parts), whole)
        report_caught(report, f"self-test: {defect}, of {whole.name}", expected, seeded)


def report_caught(report, name, expected, seeded):
    caught = [check for check in seeded.failed if expected in check]
    faults = [] if caught else [f"no check named `{expected}` failed, only {seeded.failed}"]
    report.check(name, faults, f"caught by `{caught[0]}`" if caught else "")


def self_test(report, glb, usda, engine=None, web=None):
    sound = Report(quiet=True)
    given = [path for path in (glb, usda, engine, web) if path]
    scenes = {path: check_file(sound, path) for path in given}
    report.check("self-test: the files as they are", sound.failed, f"{sound.checks} checks pass")
    if sound.failed:
        return
    suites = [(glb, glb_defects()), (usda, usd_defects())]
    suites += [(engine, engine_defects())] if engine else []
    check_broken_sameness(report, usda)
    if web:
        check_broken_compression(report, web)
    for path, defects in suites:
        for defect, (expected, change) in defects.items():
            with tempfile.TemporaryDirectory() as folder:
                copy = copied(path, Path(folder))
                if path.suffix == ".glb":
                    document, binary = read_gltf(copy)
                    binary = bytearray(binary)
                    change(document, binary)
                    write_glb(copy, document, bytes(binary))
                else:
                    stage = Usd.Stage.Open(str(copy))
                    change(stage)
                    stage.GetRootLayer().Save()
                    del stage
                seeded = Report(quiet=True)
                scene = check_file(seeded, copy)
                if scene and "indices in range" not in expected:
                    check_agreement(seeded, "the sound file", scenes[path], copy.name, scene)
                report_caught(report, f"self-test: {defect} in {path.name}", expected, seeded)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", type=Path)
    parser.add_argument("--same", type=Path, metavar="FOLDER", help="compare every .usda with the .usdc of its name")
    parser.add_argument("--inventory", type=Path, help="GeoJSON with one feature a tree")
    parser.add_argument("--parts-of", type=Path, metavar="FILE", help="the files are, together, what this one is")
    parser.add_argument("--quiet", action="store_true", help="tell failures and the count alone")
    parser.add_argument("--three", type=Path, metavar="FOLDER", help="pictures by three.js go here")
    parser.add_argument("--blender", metavar="PYTHON", help="an interpreter with bpy, to import the files too")
    parser.add_argument("--self-test", action="store_true", help="seed defects in copies of a .glb and a .usda, or of parts")
    options = parser.parse_args()
    known = (".glb", ".gltf", ".usda", ".usdc", ".usdz")
    for path in [*options.files, *filter(None, [options.inventory, options.parts_of])]:
        if not path.is_file():
            parser.error(f"{path}: no such file")
    for path in options.files:
        if path.suffix not in known:
            parser.error(f"{path}: not one of {', '.join(known)}")
    report = Report(failures_alone=options.quiet)
    if not options.files and not options.same:
        parser.error("no files")
    if options.same:
        check_same_layers(report, options.same)
    if options.self_test and options.parts_of:
        parts_self_test(report, options.files, options.parts_of)
    elif options.self_test:
        if [path.suffix for path in options.files] not in ([".glb", ".usda"], [".glb", ".usda", ".glb", ".glb"]):
            parser.error("--self-test takes a .glb and a .usda, then one .glb of profile engine and one of web")
        self_test(report, *options.files)
    elif options.parts_of:
        check_parts(report, options.files, options.parts_of)
    else:
        check_all(report, options.files, options.inventory, options.blender)
        if options.three:
            check_three(report, [p for p in options.files if p.suffix in (".glb", ".gltf")], options.three)
    print(f"{report.checks - len(report.failed)} passed, {len(report.failed)} failed")
    sys.exit(1 if report.failed else 0)


if __name__ == "__main__":
    main()
