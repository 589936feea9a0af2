#!/usr/bin/env python3
"""Fit the model that tells conifers from broadleaves (src/species/kind.rs).

usage: FEATURES_CSV=features.csv cargo test --release --test all species_plots::features
       tools/fit_kind.py features.csv

Linear discriminant analysis: means of the two kinds and their pooled covariance. Prints the
constants of kind.rs, and how well the model does on crowns it has not seen: each plot by the others,
and each site by the other. Crowns are weighted so that both kinds count alike; a quarter of the
weight is shared alike among the sites of a kind too, so that what differs between the sites does not
wholly pass for a difference between the kinds.
Needs numpy.
"""
import csv
import sys

import numpy as np

LIMITS = np.array([[0, 1], [0, 0.5], [-2, 2], [0, 1]])
BY_SITE = 0.25  # share of the weight
SHRINK = 0.1  # of the covariance towards its diagonal
SUBSETS = {
    "all": [0, 1, 2, 3],
    "without the photo": [0, 1, 2],
    "without intensity": [0, 1, 3],
    "shape alone": [0, 1],
    "intensity alone": [2],
}


def read(path):
    rows = list(csv.DictReader(open(path)))
    names = list(rows[0])[3 : 3 + len(LIMITS)]
    x = np.array([[float(r[n] or "nan") for n in names] for r in rows])
    y = np.array([int(r["is_conifer"]) for r in rows])
    plot = np.array([r["plot"] for r in rows])
    keep = ~np.isnan(x).any(1)
    return names, np.clip(x, *LIMITS.T)[keep], y[keep], plot[keep]


def print_order(path):
    """Of every column, in use or not: how often a conifer has the greater value than a broadleaf."""
    rows = list(csv.DictReader(open(path)))
    for name in list(rows[0])[3:]:
        line = f"  {name:21}"
        for site in sorted({r["plot"].split("_")[0] for r in rows}):
            here = [r for r in rows if r["plot"].startswith(site) and r[name]]
            broadleaf, conifer = (
                np.array([float(r[name]) for r in here if int(r["is_conifer"]) == kind]) for kind in (0, 1)
            )
            line += f" {site} {(conifer[:, None] > broadleaf).mean():.2f}"
        print(line)


def fit(x, y, site):
    weight = np.zeros(len(y))
    for kind in (0, 1):
        weight[y == kind] = (1 - BY_SITE) / (y == kind).sum()
        groups = [m for s in set(site) if (m := (site == s) & (y == kind)).any()]
        for group in groups:
            weight[group] += BY_SITE / len(groups) / group.sum()
    weight /= 2
    mean = [np.average(x[y == k], axis=0, weights=weight[y == k]) for k in (0, 1)]
    off = x - np.where(y[:, None] == 1, mean[1], mean[0])
    covariance = (off * weight[:, None]).T @ off
    return *mean, (1 - SHRINK) * covariance + SHRINK * np.diag(np.diag(covariance))


def score(model, x, columns):
    broadleaf, conifer, covariance = model
    b, c = broadleaf[columns], conifer[columns]
    w = np.linalg.solve(covariance[np.ix_(columns, columns)], c - b)
    return (x[:, columns] - (b + c) / 2) @ w


def right(y, z):
    part = lambda k: f"{((z[y == k] > 0) == k).mean():.2f}" if (y == k).any() else "none"
    return f"{((z > 0) == y).mean():.3f} (conifers {part(1)}, broadleaves {part(0)})"


def main(path):
    names, x, y, plot = read(path)
    site = np.array([p.split("_")[0] for p in plot])
    for s in sorted(set(site)):
        print(f"{s}: {((site == s) & (y == 1)).sum()} conifers, {((site == s) & (y == 0)).sum()} broadleaves")
    print("a conifer has the greater value")
    print_order(path)
    commoner = sum(max((y[site == s] == k).sum() for k in (0, 1)) for s in set(site))
    print(f"always the commoner kind of the site {commoner / len(y):.3f} of {len(y)}")
    for title, columns in SUBSETS.items():
        z = np.zeros(len(y))
        for p in set(plot):
            out = plot == p
            z[out] = score(fit(x[~out], y[~out], site[~out]), x[out], columns)
        print(f"{title}\n  each plot by the others {right(y, z)}")
        for s in sorted(set(site)):
            print(f"    {s} {right(y[site == s], z[site == s])}")
        for s in sorted(set(site)):
            out = site != s
            print(f"  {s} alone, on the other site {right(y[out], score(fit(x[~out], y[~out], site[~out]), x[out], columns))}")
        chance = 1 / (1 + np.exp(-np.abs(z)))
        for low, high in ((0.5, 0.7), (0.7, 0.9), (0.9, 0.99), (0.99, 1.01)):
            these = (chance >= low) & (chance < high)
            if these.any():
                print(f"  given {low} to {min(high, 1)}: {((z > 0) == y)[these].mean():.2f} right of {these.sum()}")
    broadleaf, conifer, covariance = fit(x, y, site)
    row = lambda v: "[" + ", ".join(f"{a:.5f}" for a in v) + "]"
    print(f"// {', '.join(names)}")
    print(f"const BROADLEAF: [f64; N] = {row(broadleaf)};")
    print(f"const CONIFER: [f64; N] = {row(conifer)};")
    print("const COVARIANCE: [[f64; N]; N] = [")
    for v in covariance:
        print(f"    {row(v)},")
    print("];")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    main(sys.argv[1])
