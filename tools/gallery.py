#!/usr/bin/env python3
"""Renders contact sheets: states.jpg, bark.jpg, twigs.jpg, lods.jpg, saplings.jpg and species.jpg of
output/gallery.

    tools/gallery.py -o output/gallery [--larix target/release/larix] [--only bark]

Of all species, states: three seeds in leaf and bare, autumn, and the conditions III and VI; bark: the
stem at its foot, at a quarter and at 0.7 of the height, as close as two metres; twigs: the edge of the
crown with every leaf and needle, as close as a metre; lods: LOD0 to LOD4 and the cross impostor;
saplings: of half a metre to four metres, each as large as the next. Of some, species: the program's own
sheets. Needs Pillow beside Blender, which tools/contact_sheet.py needs too.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

ROOT = Path(__file__).resolve().parent.parent
STATES = [
    ["--seed", "1"],
    ["--seed", "2"],
    ["--seed", "3"],
    ["--season", "winter", "--seed", "1"],
    ["--season", "winter", "--seed", "2"],
    ["--season", "winter", "--seed", "3"],
    ["--season", "autumn"],
    ["--condition", "III"],
    ["--condition", "VI"],
]
SHEETS = ["larix_sibirica", "picea_obovata", "betula_pendula", "quercus_robur"]
STATE_PX, BARK_PX, TWIGS_PX, LEVEL_PX, SHEET_PX = 240, 230, 400, 270, 600
SAPLINGS_M, SAPLING_PX = [0.5, 1, 2, 4], 300
BARK_AT, BARK_M = [0.02, 0.25, 0.7], 2.0
TWIGS_M = 1.0
WIDTH_PX = 1600
GAP_PX = 4


def run(*command):
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, command))}\n{done.stderr}")
    return done.stdout


def sheet(files, out, *options):
    tool = ROOT / "tools" / "contact_sheet.py"
    run(sys.executable, tool, *files, "-o", out, *options)
    return Image.open(out).convert("RGB")


def states(larix, name, folder):
    files = []
    for k, options in enumerate(STATES):
        files.append(folder / f"{name}_{k}.glb")
        run(larix, "tree", name, *options, "--texture", 512, "-o", files[-1], "--quiet")
    options = ["--columns", len(files), "--height", STATE_PX]
    return sheet(files, folder / f"{name}.png", *options)


def beside(pictures):
    """Pictures of one height left to right, without a gap."""
    whole = Image.new("RGB", (sum(p.width for p in pictures), pictures[0].height))
    x = 0
    for picture in pictures:
        whole.paste(picture, (x, 0))
        x += picture.width
    return whole


def bark(larix, name, folder):
    file = folder / f"{name}.glb"
    run(larix, "tree", name, "--bare", "--texture", 2048, "-o", file, "--quiet")
    options = ["--columns", 1, "--height", BARK_PX, "--window", BARK_M]
    places = [
        sheet([file], folder / f"{name}_{k}.png", *options, "--at", at)
        for k, at in enumerate(BARK_AT)
    ]
    return beside(places)


def facts(file):
    """What a GLB tells of its tree."""
    data = file.read_bytes()
    nodes = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])["nodes"]
    return next(n["extras"] for n in nodes if "height_m" in n.get("extras", {}))


def twigs(larix, name, folder):
    file = folder / f"{name}.glb"
    run(larix, "tree", name, "--foliage", "geometry", "--twigs", "instance", "-o", file, "--quiet")
    tree = facts(file)
    base, height = tree["crown_base_height_m"], tree["height_m"]
    place = ["--at", (base + 0.4 * (height - base)) / height, "--aside", 0.3 * tree["crown_diameter_m"]]
    options = ["--columns", 1, "--height", TWIGS_PX, "--window", TWIGS_M]
    return sheet([file], folder / f"{name}.png", *options, *place)


def levels(larix, name, folder):
    file = folder / f"{name}.glb"
    options = ["--lods", 4, "--impostor", "cross", "--texture", 512]
    run(larix, "tree", name, *options, "-o", file, "--quiet")
    steps = [f"LOD{k}" for k in range(1, 5)] + ["impostor"]
    files = [file] + [file.with_name(f"{name}_{step}.glb") for step in steps]
    return sheet(files, folder / f"{name}.png", "--columns", len(files), "--height", LEVEL_PX)


def saplings(larix, name, folder):
    parts = []
    for height in SAPLINGS_M:
        file = folder / f"{name}_{height}.glb"
        run(larix, "tree", name, "--height", height, "--texture", 512, "-o", file, "--quiet")
        options = ["--columns", 1, "--height", SAPLING_PX, "--samples", 24]
        parts.append(sheet([file], folder / f"{name}_{height}.png", *options))
    return beside(parts)


def own_sheet(larix, name, folder):
    file = folder / f"{name}.png"
    run(larix, "species", "show", name, "-o", file, "--quiet")
    picture = Image.open(file).convert("RGB")
    return picture.resize((round(picture.width * SHEET_PX / picture.height), SHEET_PX), Image.LANCZOS)


def label(picture, text):
    """A picture of any height with a name on light ground, of a size that goes with it."""
    draw, font = ImageDraw.Draw(picture), ImageFont.load_default(max(14, picture.height // 22))
    _, _, right, bottom = draw.textbbox((8, 5), text, font)
    draw.rectangle((0, 0, right + 8, bottom + 5), (240, 240, 238))
    draw.text((8, 5), text, (20, 20, 20), font)
    return picture


def rows(pictures):
    """Pictures left to right in rows, each row as wide as the page."""
    page, row = [], []
    for picture in pictures:
        row.append(picture)
        if sum(p.width for p in row) >= WIDTH_PX:
            page.append(row)
            row = []
    if row:
        page.append(row)
    lines = []
    for row in page:
        room = WIDTH_PX - GAP_PX * (len(row) - 1)
        scale = min(room / sum(p.width for p in row), 1.2)
        line = Image.new("RGB", (WIDTH_PX, round(scale * row[0].height)), "white")
        x = 0
        for p in row:
            p = p.resize((round(p.width * scale), line.height), Image.LANCZOS)
            line.paste(p, (x, 0))
            x += p.width + GAP_PX
        lines.append(line)
    height = sum(p.height for p in lines) + GAP_PX * (len(lines) - 1)
    whole = Image.new("RGB", (WIDTH_PX, height), "white")
    y = 0
    for line in lines:
        whole.paste(line, (0, y))
        y += line.height + GAP_PX
    return whole


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--larix", type=Path, default=ROOT / "target/release/larix")
    parser.add_argument("--only", choices=["states", "bark", "twigs", "lods", "saplings", "species"])
    args = parser.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    listed = run(args.larix, "species", "list", "--quiet").split()
    names = [name for name in listed if "/" not in name]
    kinds = [
        ("states", states, names),
        ("bark", bark, names),
        ("twigs", twigs, names),
        ("lods", levels, names),
        ("saplings", saplings, names),
        ("species", own_sheet, SHEETS),
    ]
    for kind, draw, of in kinds:
        if args.only in (None, kind):
            with tempfile.TemporaryDirectory() as folder:
                drawn = [draw(args.larix, n, Path(folder)) for n in of]
            if draw is not own_sheet:
                drawn = [label(p, n.replace("_", " ").capitalize()) for p, n in zip(drawn, of)]
            rows(drawn).save(args.output / f"{kind}.jpg", quality=82, optimize=True)


if __name__ == "__main__":
    main()
