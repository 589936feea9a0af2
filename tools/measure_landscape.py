#!/usr/bin/env python3
"""Voxel size against bytes, seconds and the error of pictures.

Usage: measure_landscape.py LARIX SCAN… [--across 2,4,8,16] [--out FOLDER]

Draws the scan's landscape at voxels of so many across its mean crown (by `larix inventory`) and
compares each picture with that of the finest: RMSE of 8-bit sRGB by pixel and of means of 8 × 8, and
SSIM by scikit-image. Contrast is how far pixels are from the mean of their 8 × 8 (RMS): two pictures
whose leaves lie elsewhere differ by more, the more contrast either has. Needs numpy, pillow and
scikit-image.
"""
import argparse
import csv
import json
import pathlib
import subprocess
import tempfile

import numpy as np
from PIL import Image
from skimage.metrics import structural_similarity


def run(larix, *args):
    out = subprocess.run([larix, *map(str, args), "--json", "--quiet"], check=True, capture_output=True)
    return json.loads(out.stdout)


def means(picture, side=8):
    rows, cols = (n // side * side for n in picture.shape[:2])
    blocks = picture[:rows, :cols].astype(float).reshape(rows // side, side, cols // side, side, 3)
    means = blocks.mean(axis=(1, 3))
    return means, np.sqrt(np.mean((blocks - means[:, None, :, None]) ** 2))


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("larix")
    parser.add_argument("scan", nargs="+")
    parser.add_argument("--across", default="2,4,8,16")
    parser.add_argument("--out")
    a = parser.parse_args()
    out = pathlib.Path(a.out or tempfile.mkdtemp())
    out.mkdir(parents=True, exist_ok=True)
    trees = out / "trees.csv"
    run(a.larix, "inventory", *a.scan, "-o", trees)
    with open(trees, newline="") as file:
        crowns = [float(row["crown_diameter_m"]) for row in csv.DictReader(file)]
    mean_m = float(np.mean(crowns))
    print(f"mean crown {mean_m:.2f} m, of {len(crowns)} trees")
    rows = []
    for across in map(int, a.across.split(",")):
        picture, saved = out / f"{across}.png", out / f"{across}.voxels"
        report = run(a.larix, "landscape", *a.scan, "--voxel", mean_m / across, "--save", saved,
                     "-o", picture, "--effort", 16)
        seconds = {stage["stage"]: stage["seconds"] for stage in report["stages"]}
        rows.append((across, mean_m / across, report["landscape"], seconds, np.asarray(Image.open(picture).convert("RGB"))))
    finest = rows[-1][4].astype(float)
    finest_means, _ = means(rows[-1][4])
    print("| voxels a crown | edge m | MB | file MB | build s | draw s | RMSE | of 8 × 8 means | contrast | SSIM |")
    print("|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|")
    for across, edge, told, seconds, picture in rows:
        rmse = np.sqrt(np.mean((picture.astype(float) - finest) ** 2))
        ssim = structural_similarity(picture, rows[-1][4], channel_axis=2)
        own, contrast = means(picture)
        coarse = np.sqrt(np.mean((own - finest_means) ** 2))
        build = seconds["voxels"] + seconds["landscape"]
        print(f"| {across} | {edge:.2f} | {told['bytes'] / 1e6:.2f} | {told['file_bytes'] / 1e6:.2f} "
              f"| {build:.2f} | {seconds['picture']:.1f} | {rmse:.1f} | {coarse:.1f} "
              f"| {contrast:.1f} | {ssim:.3f} |")


if __name__ == "__main__":
    main()
