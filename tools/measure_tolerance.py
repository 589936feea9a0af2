#!/usr/bin/env python3
"""What `larix tree --tolerance M` makes of every built-in species, as a table for docs/levels.md.

    tools/measure_tolerance.py target/release/larix

Of each tolerance: triangles, the silhouette error reached (RMS, metres), and the processor seconds of
the whole run, textures cached.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

ASKED_M = [0.025, 0.05, 0.1, 0.2]
TRIANGLES = 100_000


def run(larix, name, asked_m, folder):
    """Triangles, error reached, processor seconds."""
    command = [larix, "tree", name, "--triangles", TRIANGLES, "--tolerance", asked_m, "--json"]
    before = os.times()
    done = subprocess.run(
        [*map(str, command), "-o", str(folder / "tree.glb")], capture_output=True, check=True
    )
    after = os.times()
    seconds = after.children_user + after.children_system
    seconds -= before.children_user + before.children_system
    stages = {s["stage"]: s for s in json.loads(done.stdout)["stages"]}
    reached_m = stages["tolerance"]["error"]["value"]
    return stages["mesh"]["items_out"]["count"], reached_m, seconds


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    larix = Path(sys.argv[1])
    listed = subprocess.run([larix, "species", "list", "--quiet"], capture_output=True, check=True)
    names = [n for n in listed.stdout.decode().split() if not n.startswith("table3/")]
    print("| | " + " | ".join(f"{m} m" for m in ASKED_M) + " |")
    print("|---|" + "---:|" * len(ASKED_M))
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            subprocess.run([larix, "tree", name, "-q", "-o", Path(folder) / "tree.glb"], check=True)
            cells = [run(larix, name, m, Path(folder)) for m in ASKED_M]
            told = [f"{n:,} · {m:.3f} m · {s:.1f} s" for n, m, s in cells]
            print(f"| {name} | " + " | ".join(told) + " |", flush=True)


if __name__ == "__main__":
    main()
