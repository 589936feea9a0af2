#!/usr/bin/env python3
"""Checks X3D and OBJ files with others' readers and with checks that those leave out.

    tools/validate_x3d.py FILES… [--scene SCENE.glb]
    tools/validate_x3d.py --self-test SCENE.x3d SCENE.obj

FILES are .x3d or .obj. With --scene, each must hold what that GLB holds: triangles drawn, and
bounds within 1 mm. Prints a line a check, `ok` or `FAIL`, and exits with 1 on any failure.
--self-test seeds defects in copies and proves that each is caught.

X3D is held against the object model of X3D 4 (the package x3d, made from the same source as the
XML schema): elements, attributes, their types and ranges, and which node may stand in which field.
OBJ is read by trimesh. Needs the modules of tools/requirements.txt.
"""

import argparse
import contextlib
import io
import re
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
from pathlib import Path

try:
    import numpy as np
    import trimesh
    from PIL import Image

    with contextlib.redirect_stdout(io.StringIO()):  # it greets
        import x3d.x3d as model
except ImportError as missing:
    sys.exit(f"the Python module {missing.name} is missing: pip install -r tools/requirements.txt")

BOUNDS_TOLERANCE_M = 1e-3
# Two places after the point: half a place in each of three directions.
UNIT_TOLERANCE = 8.7e-3
XML_NAMESPACE = "{http://www.w3.org/2001/XMLSchema-instance}"
# Of the tuples of a list.
WIDTHS = {"Vec2f": 2, "Vec3f": 3, "Vec3d": 3, "Color": 3, "Rotation": 4}


class Report:
    """Prints and remembers what was checked."""

    def __init__(self, quiet=False):
        self.quiet = quiet
        self.failed = []

    def check(self, name, faults, detail=""):
        faults = list(faults)
        if faults:
            self.failed.append(name)
        if not self.quiet:
            told = "; ".join(faults[:5]) + (f"; and {len(faults) - 5} more" if len(faults) > 5 else "")
            text = told if faults else detail
            print(f"{'FAIL' if faults else 'ok  '} {name}{': ' + text if text else ''}")


# X3D against its object model


def strings(text):
    return [re.sub(r"\\(.)", r"\1", s) for s in re.findall(r'"((?:[^"\\]|\\.)*)"', text)]


def value_of(kind, text):
    """An attribute as the object model takes it; ValueError where it is no such value."""
    if kind == "SFString":
        return text
    if kind == "MFString":
        if not re.fullmatch(r'\s*("(?:[^"\\]|\\.)*"[\s,]*)*', text):
            raise ValueError(f"{text[:40]!r} is no list of strings")
        return strings(text)
    if kind in ("SFBool", "MFBool"):
        if text not in ("true", "false"):
            raise ValueError(f"{text[:40]!r} is not true or false")
        return text == "true"
    whole = "Int32" in kind
    numbers = [(int if whole else float)(n) for n in text.replace(",", " ").split()]
    if not np.isfinite(numbers).all():
        raise ValueError("a number is not finite")
    width = WIDTHS.get(kind[2:], 1)
    if kind.startswith("SF"):
        if len(numbers) != width:
            raise ValueError(f"{len(numbers)} numbers for a {kind}")
        return numbers[0] if width == 1 else tuple(numbers)
    if len(numbers) % width:
        raise ValueError(f"{len(numbers)} numbers are no {kind}")
    return numbers if width == 1 else list(zip(*[iter(numbers)] * width))


def built(element, path, faults, defined):
    """The element as a node of the object model, its children first; None where it is none."""
    kind = getattr(model, element.tag, None)
    if kind is None or not hasattr(kind, "FIELD_DECLARATIONS"):
        faults.append(f"{path}: no node {element.tag}")
        return None
    declared = {f[0].rstrip("_"): (f[0], f[2].__name__) for f in kind.FIELD_DECLARATIONS()}
    values = {}
    for name, text in element.attrib.items():
        if name in ("containerField",) or name.startswith(XML_NAMESPACE):
            continue
        if name not in declared or declared[name][1] in ("SFNode", "MFNode"):
            faults.append(f"{path}: no attribute {name}")
            continue
        field, typed = declared[name]
        try:
            values[field] = value_of(typed, text)
        except ValueError as wrong:
            faults.append(f"{path}.{name}: {wrong}")
    use = element.attrib.get("USE")
    if use is not None:
        if defined.get(use) != element.tag:
            faults.append(f"{path}: USE {use} of {defined.get(use, 'nothing')} before it")
        # What it uses was checked where it was defined; a list or a colour beside USE would be lost.
        if set(element.attrib) - {"USE", "containerField"} or len(element):
            faults.append(f"{path}: more than USE")
    name = element.attrib.get("DEF")
    if name is not None:
        if name in defined:
            faults.append(f"{path}: DEF {name} twice")
        defined[name] = element.tag
    for number, child in enumerate(element):
        at = f"{path}/{child.tag}[{number}]"
        node = built(child, at, faults, defined)
        if node is None:
            continue
        default = node.CONTAINERFIELD_DEFAULT() if hasattr(node, "CONTAINERFIELD_DEFAULT") else child.tag
        field = child.attrib.get("containerField", default if child.tag not in ("head", "Scene", "component", "meta") else child.tag)
        if field not in declared or declared[field][1] not in ("SFNode", "MFNode"):
            if element.tag != "head":
                faults.append(f"{at}: {element.tag} has no field {field}")
                continue
            field = "children"
        if declared[field][1] == "MFNode" or element.tag == "head":
            values.setdefault(field, []).append(node)
        elif field in values:
            faults.append(f"{at}: a second {field}")
        else:
            values[field] = node
    try:
        return kind(**values)
    except Exception as wrong:  # the model raises kinds of its own
        faults.append(f"{path}: {str(wrong)[:200]}")
        return None


def numbers(element, name):
    return np.array(element.attrib[name].split(), float)


def rotation(axis, angle):
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


class Drawn:
    """What a file shows in its finest form: triangles, and corners of all of it, Y up."""

    def __init__(self):
        self.triangles = 0
        self.low, self.high = np.full(3, np.inf), np.full(3, -np.inf)

    def add(self, points, triangles):
        self.triangles += triangles
        self.low = np.minimum(self.low, points.min(0))
        self.high = np.maximum(self.high, points.max(0))


def check_geometry(label, geometry, has_pictures, faults):
    """Gives its corners and how many triangles it has."""
    points = numbers(geometry.find("Coordinate"), "point").reshape(-1, 3)
    normals = numbers(geometry.find("Normal"), "vector").reshape(-1, 3)
    places = geometry.find("TextureCoordinate")
    if (places is not None) != has_pictures:
        faults.append(f"{label}: texture coordinates and pictures, one without the other")
    uv = points if places is None else numbers(places, "point").reshape(-1, 2)
    if geometry.tag == "IndexedFaceSet":
        index = np.array(geometry.attrib["coordIndex"].split(), int)
        if len(index) % 4 or (index[3::4] != -1).any():
            faults.append(f"{label}: not triangles with -1 after each")
        index = index.reshape(-1, 4)[:, :3] if len(index) % 4 == 0 else np.zeros((0, 3), int)
    else:
        index = np.array(geometry.attrib["index"].split(), int)
        if len(index) % 3:
            faults.append(f"{label}: {len(index)} indices are no triangles")
        index = index[: len(index) // 3 * 3].reshape(-1, 3)
    if len(normals) != len(points) or len(uv) != len(points):
        faults.append(f"{label}: {len(points)} points, {len(normals)} normals, {len(uv)} texture coordinates")
    if not len(index) or index.min() < 0 or index.max() >= len(points):
        faults.append(f"{label}: indices not in 0…{len(points) - 1}")
    off = np.abs(np.linalg.norm(normals, axis=1) - 1).max(initial=0)
    if off > UNIT_TOLERANCE:
        faults.append(f"{label}: a normal's length is off by {off:.3f}")
    return points, len(index)


def draw(element, matrix, defined, shapes, drawn, faults):
    if "USE" in element.attrib:
        element = defined.get(element.attrib["USE"], element)
    if element.tag == "Transform":
        x, y, z, angle = numbers(element, "rotation")
        turn = rotation(np.array([x, y, z]), angle) * numbers(element, "scale")
        placed = np.eye(4)
        placed[:3, :3], placed[:3, 3] = turn, numbers(element, "translation")
        matrix = matrix @ placed
    elif element.tag == "Shape":
        points, triangles = shapes[element]
        drawn.add(points @ matrix[:3, :3].T + matrix[:3, 3], triangles)
        return
    elif element.tag == "LOD":
        ranges = numbers(element, "range")
        if len(ranges) != len(element) - 1 or (np.diff(ranges) <= 0).any() or (ranges <= 0).any():
            faults.append(f"{len(element)} levels at {ranges}")
        draw(element[0], matrix, defined, shapes, drawn, faults)
        return
    for child in element:
        draw(child, matrix, defined, shapes, drawn, faults)


def check_textures(report, label, folder, paths):
    faults = []
    for path in sorted(paths):
        try:
            Image.open(folder / path).load()
        except Exception as error:  # Pillow raises many kinds on broken files
            faults.append(f"{path}: {error}")
    report.check(f"{label} textures decode", faults, f"{len(paths)} pictures")


def check_x3d(report, path):
    label = path.name
    try:
        root = ElementTree.parse(path).getroot()
    except ElementTree.ParseError as wrong:
        report.check(f"{label} is XML", [str(wrong)])
        return None
    faults = []
    built(root, "X3D", faults, {})
    report.check(f"{label} object model of X3D {root.attrib.get('version')}", faults, f"{sum(1 for _ in root.iter())} elements")
    if faults:
        return None
    faults, defined, shapes = [], {}, {}
    for element in root.iter():
        if "DEF" in element.attrib:
            defined[element.attrib["DEF"]] = element
        if element.tag == "Shape":
            geometry = next(c for c in element if c.tag.startswith("Indexed"))
            look = element.find("Appearance")
            look = defined.get(look.attrib.get("USE"), look)
            has_pictures = any(e.tag == "ImageTexture" for e in look.iter())
            shapes[element] = check_geometry(f"shape {len(shapes)}", geometry, has_pictures, faults)
    drawn = Drawn()
    report.check(f"{label} meshes", faults, f"{len(shapes)} shapes, {sum(n for _, n in shapes.values())} triangles")
    if faults:
        return None
    draw(root.find("Scene"), np.eye(4), defined, shapes, drawn, faults)
    report.check(f"{label} levels", faults, f"{sum(1 for _ in root.iter('LOD'))} trees with levels")
    trees = list(root.iter("Transform"))
    ids, faults = set(), []
    for tree in trees:
        facts = {f.attrib["name"]: f.attrib["value"] for f in tree.find("MetadataSet")}
        missing = {"id", "species", "condition", "height_m", "stem_diameter_m"} - facts.keys()
        if missing or facts["id"] in ids:
            faults.append(f"{tree.attrib.get('DEF')}: {f'no {missing}' if missing else 'its id is taken'}")
        ids.add(facts.get("id"))
    report.check(f"{label} facts of trees", faults, f"{len(trees)} trees")
    place = {f.attrib["name"] for f in root.find("Scene/WorldInfo/MetadataSet")}
    report.check(f"{label} place on the map", [f"no {n}" for n in {"origin", "unit_m"} - place])
    urls = {strings(t.attrib["url"])[0] for t in root.iter("ImageTexture") if "url" in t.attrib}
    check_textures(report, label, path.parent, urls)
    return drawn


def check_obj(report, path):
    label = path.name
    lines = path.read_text().splitlines()
    counts = {key: sum(line.startswith(key + " ") for line in lines) for key in ("v", "vt", "vn", "o", "f")}
    libraries = [line.split(" ", 1)[1] for line in lines if line.startswith("mtllib ")]
    used = {line.split(" ", 1)[1] for line in lines if line.startswith("usemtl ")}
    faults, materials, paths = [], set(), set()
    for library in libraries:
        if not (path.parent / library).is_file():
            faults.append(f"{library} is missing")
            continue
        for line in (path.parent / library).read_text().splitlines():
            key, _, rest = line.partition(" ")
            if key == "newmtl":
                materials.add(rest)
            elif key.startswith("map_") or key == "norm":
                paths.add(rest)
    faults += [f"no material {name}" for name in sorted(used - materials)]
    report.check(f"{label} materials", faults, f"{len(materials)} materials")
    check_textures(report, label, path.parent, paths)
    # What no texture covers has no texture coordinate.
    numbers = lambda corner: [number or min(1, counts["vt"]) for number in corner.split("/")]
    corners = [numbers(c) for line in lines if line.startswith("f ") for c in line.split()[1:]]
    corners = np.array(corners, int)
    faults = [
        f"{key}: {corners[:, k].min()}…{corners[:, k].max()} of {counts[key]}"
        for k, key in enumerate(("v", "vt", "vn"))
        if corners[:, k].min() < min(1, counts[key]) or corners[:, k].max() > counts[key]
    ]
    report.check(f"{label} indices", faults, f"{counts['v']} vertices, {counts['vt']} texture coordinates")
    if faults:
        return None
    scene = trimesh.load(path, process=False, maintain_order=True, split_objects=True, group_material=False)
    meshes = list(scene.geometry.values()) if isinstance(scene, trimesh.Scene) else [scene]
    drawn = Drawn()
    for mesh in meshes:
        drawn.add(np.asarray(mesh.vertices), len(mesh.faces))
    faults = [] if drawn.triangles == counts["f"] else [f"{drawn.triangles} triangles of {counts['f']}"]
    if len({line for line in lines if line.startswith("o ")}) != counts["o"]:
        faults.append("two objects of one name")
    report.check(f"{label} as trimesh reads it", faults, f"{counts['o']} objects, {drawn.triangles} triangles")
    return drawn


def check(report, path):
    return check_x3d(report, path) if path.suffix == ".x3d" else check_obj(report, path)


def drawn_of_gltf(path):
    scene = trimesh.load(path, process=False)
    drawn = Drawn()
    for node in scene.graph.nodes_geometry:
        if "UCX_" in node or "UCP_" in node:
            continue
        matrix, name = scene.graph[node]
        mesh = scene.geometry[name]
        drawn.add(mesh.vertices @ matrix[:3, :3].T + matrix[:3, 3], len(mesh.faces))
    return drawn


def check_same(report, label, drawn, expected):
    faults = []
    if drawn.triangles != expected.triangles:
        faults.append(f"{drawn.triangles} triangles, not {expected.triangles}")
    off = max(np.abs(drawn.low - expected.low).max(), np.abs(drawn.high - expected.high).max())
    if not off <= BOUNDS_TOLERANCE_M:
        faults.append(f"bounds are off by {off:.4f} m")
    report.check(f"{label} holds what the GLB holds", faults, f"{drawn.triangles} triangles, bounds within {off * 1000:.3f} mm")


DEFECTS = {
    ".x3d": {
        "a node that is none": ("<NavigationInfo ", "<NavigationInfos "),
        "an attribute that is none": ("solid=", "solit="),
        "a word for a number": ('specularColor="0 0 0"', 'specularColor="none"'),
        "a share above 1": ('specularColor="0 0 0"', 'specularColor="2 0 0"'),
        "a node in a field that is not its own": ('containerField="texture"', 'containerField="geometry"'),
        "a USE of nothing": ('<Appearance USE="', '<Appearance USE="not_'),
        "a DEF twice": ('DEF="terrain-ground"', 'DEF="{material}"'),
        "an index too large": (r're:(oordIndex|ndex)="0 ', r'\1="99999999 '),
        "a normal of no length": (r're:vector="\S+ \S+ \S+', 'vector="0 0 0'),
        "a missing point": (r're:point="\S+ \S+ \S+', 'point="'),
        "a missing texture": ("textures/", "tekstures/"),
        "no texture coordinates": (r"re:<TextureCoordinate [^>]*>", ""),
        "a fact lost": ('name="height_m"', 'name="hight_m"'),
        "a mode that is none": ('alphaMode="MASK"', 'alphaMode="MASQUE"'),
        "no place": ('name="origin"', 'name="orgin"'),
    },
    ".obj": {
        "a missing library": ("mtllib ", "mtllib not_"),
        "a material that is none": ("usemtl ", "usemtl not_"),
        "an index too large": (r"re:\nf \d+/", "\nf 99999999/"),
        "an index of 0": (r"re:\nf \d+/", "\nf 0/"),
        "an object twice": (r"re:\no (\S+)\n((?:.|\n)*?)\no \S+\n", r"\no \1\n\2\no \1\n"),
    },
}


def self_test(files):
    """Every defect must be caught."""
    missed = []
    for path in files:
        quiet = Report(quiet=True)
        check(quiet, path)
        if quiet.failed:
            missed.append(f"{path.name} fails as it is: {quiet.failed}")
        text = path.read_text()
        for name, (old, new) in DEFECTS[path.suffix].items():
            material = re.search(r'DEF="(\S+-material)"', text)
            new = new.replace("{material}", material[1] if material else "")
            if old.startswith("re:"):
                broken = re.sub(old[3:], new, text, count=1)
            elif name == "a DEF twice":
                broken = text.replace(material[0], 'DEF="terrain-ground"', 1) if material else text
            else:
                broken = text.replace(old, new, 1)
            if broken == text:
                missed.append(f"{path.name}: {name} can't be seeded")
                continue
            with tempfile.TemporaryDirectory() as folder:
                folder = Path(folder)
                for beside in path.parent.iterdir():
                    if beside != path:
                        (folder / beside.name).symlink_to(beside.resolve())
                (folder / path.name).write_text(broken)
                report = Report(quiet=True)
                check(report, folder / path.name)
                print(f"{'ok  ' if report.failed else 'FAIL'} {path.suffix} {name}: {', '.join(report.failed) or 'not caught'}")
                if not report.failed:
                    missed.append(f"{path.name}: {name}")
    return missed


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--scene", type=Path)
    parser.add_argument("--self-test", action="store_true")
    parser.add_argument("--quiet", action="store_true")
    typed = parser.parse_args()
    if typed.self_test:
        missed = self_test(typed.files)
        sys.exit("\n".join(missed) if missed else 0)
    report = Report(typed.quiet)
    expected = drawn_of_gltf(typed.scene) if typed.scene else None
    for path in typed.files:
        drawn = check(report, path)
        if drawn and expected:
            check_same(report, path.name, drawn, expected)
    if report.failed:
        sys.exit(f"{len(report.failed)} checks failed: {', '.join(report.failed[:5])}")


if __name__ == "__main__":
    main()
