#!/usr/bin/env python3
"""Checks maps, inventories and inputs against others' readers and writers.

    tools/validate_maps.py LARIX DEMO

LARIX is the program, DEMO the folder of a `larix demo`. Its terrain and photo must be Cloud
Optimized GeoTIFFs without a warning; its trees must be the same in every format; its scan and
photo, written anew by others in every point format and packing, must give the same trees. Prints a
line a check, `ok` or `FAIL`, and exits with 1 on any failure.
"""

import argparse
import csv
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

import laspy
import numpy as np
import pyogrio.raw
import rasterio
from rio_cogeo.cogeo import cog_validate

warnings.filterwarnings("ignore", category=rasterio.errors.NotGeoreferencedWarning)
failed = []


def check(name, faults):
    faults = list(faults)
    failed.extend(faults)
    print(f"{'FAIL' if faults else 'ok  '} {name}{': ' + '; '.join(faults[:3]) if faults else ''}")


def check_cog(path):
    is_valid, errors, told = cog_validate(path, strict=True, quiet=True)
    faults = [*errors, *told] or ([] if is_valid else ["not valid"])
    with rasterio.open(path) as file:
        if file.dtypes[0] == "float32":
            values = file.read(1)
            faults += [] if np.isfinite(values).all() else ["a height is not finite"]
            faults += [] if file.nodata == -9999 else [f"nodata is {file.nodata}"]
        faults += [] if file.transform.a > 0 > file.transform.e else ["is not north-up"]
        longest = max(file.shape)
        faults += [] if longest <= 512 or file.overviews(1) else ["has no overviews"]
    check(f"{path.name} is a Cloud Optimized GeoTIFF", faults)


def table(path):
    """CRS, columns by name, and geometry, by id."""
    meta, _, geometry, columns = pyogrio.raw.read(path)
    named = dict(zip(meta["fields"], columns))
    order = np.argsort(named["id"].astype(str))
    return meta["crs"], {name: column[order] for name, column in named.items()}, geometry[order]


def check_tables(geojson, fgb, text):
    first, second = table(geojson), table(fgb)
    faults = [f"{first[0]} in one, {second[0]} in the other"] if first[0] != second[0] else []
    if list(first[1]) != list(second[1]):
        faults.append(f"columns {list(first[1])} and {list(second[1])}")
    else:
        for name, column in first[1].items():
            a, b = column, second[1][name]
            # A column without any value is read as objects from text, as numbers from binary.
            is_none = lambda v: v is None or v != v
            same = all(x == y or is_none(x) and is_none(y) for x, y in zip(a, b, strict=True))
            faults += [] if same else [f"column {name} differs"]
    faults += [] if np.array_equal(first[2], second[2]) else ["outlines differ"]
    with open(text, newline="") as file:
        rows = list(csv.DictReader(file))
    if [*first[1], "outline_wkt"] != list(rows[0]) or len(rows) != len(first[2]):
        faults.append("the CSV has other columns or rows")
    check(f"{len(first[2])} trees are the same as GeoJSON, FlatGeobuf and CSV", faults)


def scans(source, folder):
    """The scan in every point format, plain and packed."""
    scan = laspy.read(source)
    for point_format in range(11):
        for suffix in ("las", "laz"):
            if suffix == "laz" and point_format in (4, 5, 9, 10):
                continue  # lazrs does not write waveforms
            changed = laspy.convert(scan, point_format_id=point_format)
            path = folder / f"format_{point_format}.{suffix}"
            changed.write(path)
            yield path


def photos(source, folder):
    """The photo in every packing that loses nothing."""
    with rasterio.open(source) as file:
        pixels, profile = file.read(), file.profile
    for key in ("blockxsize", "blockysize", "tiled", "compress", "interleave", "driver"):
        profile.pop(key, None)
    for compress in ("lzw", "deflate", "packbits", "none"):
        for tiled in ({}, {"tiled": True, "blockxsize": 128, "blockysize": 64}):
            for interleave in ("pixel", "band"):
                path = folder / f"{compress}_{'tiled' if tiled else 'striped'}_{interleave}.tif"
                with rasterio.open(path, "w", driver="GTiff", compress=compress, interleave=interleave, **tiled, **profile) as out:
                    out.write(pixels)
                yield path
    path = folder / "world.png"
    with rasterio.open(path, "w", driver="PNG", WORLDFILE="YES", **profile) as out:
        out.write(pixels)
    Path(f"{path}.aux.xml").unlink(missing_ok=True)
    yield path


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("larix", type=Path)
    parser.add_argument("demo", type=Path)
    options = parser.parse_args()
    scan, photo = options.demo / "scan.laz", options.demo / "photo.tif"
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)

        def trees(output, scan, photo=None):
            extra = ["--photo", photo] if photo else []
            subprocess.run([options.larix, "inventory", scan, *extra, "-o", output, "--quiet"], check=True)
            return output.read_bytes()

        check_cog(options.demo / "terrain.tif")
        check_cog(photo)
        subprocess.run([options.larix, "terrain", scan, "--cell", "0.25", "-o", folder / "fine.tif", "--quiet"], check=True)
        check_cog(folder / "fine.tif")
        paths = [folder / f"trees.{suffix}" for suffix in ("geojson", "fgb", "csv")]
        for path in paths:
            trees(path, scan, photo)
        check_tables(*paths)
        expected = trees(folder / "plain.geojson", scan)
        faults = [path.name for path in scans(scan, folder) if trees(folder / "again.geojson", path) != expected]
        check("the scan gives the same trees in every point format", faults)
        expected = paths[0].read_bytes()
        faults = [path.name for path in photos(photo, folder) if trees(folder / "again.geojson", scan, path) != expected]
        check("the photo gives the same trees in every packing", faults)
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
