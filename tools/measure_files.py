#!/usr/bin/env python3
"""Sizes and load times of one forest in every profile and format, as a table.

    tools/measure_files.py LARIX FOLDER [--trees 5000] [--blender PYTHON]

LARIX is the program; it writes its demo stand of so many trees into FOLDER, once a row. Load seconds
are of three.js in headless Chromium (with tools/readers.mjs and its modules) and of Blender, where
PYTHON is an interpreter that has bpy. Objects are what Blender holds after the import, triangles
those drawn. Levels that stand in files beside count as bytes, and are not loaded.
"""

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path

ROWS = [
    ("glb dcc", "glb", ["--profile", "dcc"]),
    ("glb dcc, 2,000 triangles a model", "glb", ["--profile", "dcc", "--triangles", "2000"]),
    ("glb dcc, with the levels and bodies of engine", "glb", ["--profile", "dcc", "--lods", "3", "--impostor", "cross", "--collision", "convex"]),
    ("glb engine", "glb", ["--profile", "engine"]),
    ("glb engine, the finest level alone", "glb", ["--profile", "engine", "--lods", "0", "--impostor", "none", "--collision", "none", "--wind", "none"]),
    ("glb web", "glb", ["--profile", "web"]),
    ("usda", "usda", []),
    ("usdc", "usdc", []),
    ("usdz", "usdz", []),
    ("glb dcc, --unique all", "glb", ["--profile", "dcc", "--unique", "all", "--triangles", "2000"]),
]

def blender(python, file):
    script = Path(__file__).resolve().parent / "blender_reader.py"
    run = subprocess.run([python, str(script), str(file)], capture_output=True, text=True)
    lines = [line for line in run.stdout.splitlines() if line.startswith("FOUND ")]
    found = json.loads(lines[-1][6:]) if lines else {"error": run.stderr}
    if "error" in found:
        return "not read", ""
    return f"{found['seconds']:.1f}", f"{found['objects']:,} / {found['triangles']:,}"


def three(file):
    script = Path(__file__).resolve().parent / "readers.mjs"
    run = subprocess.run(["node", str(script), "three", f"{file}="], capture_output=True, text=True)
    if run.returncode:
        print(run.stderr, file=sys.stderr)
        return "not read"
    found = json.loads(run.stdout.splitlines()[-1])[str(file)]
    return f"{found['seconds']:.1f} ({found['calls']:,} calls)"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("larix", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--trees", type=int, default=5000)
    parser.add_argument("--blender", metavar="PYTHON")
    options = parser.parse_args()
    titles = ["", "MB", "kB a tree", "unique triangles", "drawn triangles", "written in s", "three.js s", "Blender s", "Blender objects / triangles"]
    print("| " + " | ".join(titles) + " |\n|" + "---|" * len(titles), flush=True)
    for title, extension, flags in ROWS:
        out = options.folder / title.replace(" ", "_").replace(",", "")
        command = [options.larix, "demo", "--trees", options.trees, "--format", extension, *flags, "-o", out, "--quiet"]
        run = subprocess.run([str(word) for word in command], capture_output=True, text=True)
        if run.returncode:
            sys.exit(run.stderr)
        report = json.loads((out / "report.json").read_text())
        scene = report["scene"]
        export = next(stage for stage in report["stages"] if stage["stage"] == "export")
        files = [out / f"forest.{extension}"]
        if extension == "glb":
            files += out.glob("forest_*.glb")
        if extension in ("usda", "usdc"):
            files += [*out.glob("assets/*"), *out.glob("textures/*")]
        size = sum(os.path.getsize(file) for file in files)
        cells = [
            title,
            f"{size / 1e6:.1f}",
            f"{size / 1e3 / max(scene['trees'], 1):.2f}",
            f"{scene['unique_triangles']:,}",
            f"{scene['instanced_triangles']:,}",
            f"{export['seconds']:.2f}",
            three(files[0]) if extension == "glb" else "",
        ]
        cells += blender(options.blender, files[0]) if options.blender else ["", ""]
        print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
