"""Fits the chance that a region of the canopy is one tree (src/crown/hierarchy.rs) to annotated crowns.

    REGIONS_IN=../shared/data/idtrees/las REGIONS_OUT=/tmp/regions \
        cargo test --lib write_regions -- --ignored
    python tools/fit_crowns.py /tmp/regions ../shared/data/idtrees/boxes.csv

Prints the constants as the Rust code holds them, and F1 (boxes that overlap to 0.4 of their union)
with the model fitted on all plots, cross-validated over plots, and fitted on one site and scored on
the other. Needs numpy and scipy.
"""

import argparse
import csv
import pathlib

import numpy as np
from scipy.optimize import linear_sum_assignment, minimize

OVERLAP, FOLDS, LEAST_CHANCE = 0.4, 6, 0.2


def measures(table, low, high):
    """Columns: nine shape measures, three products of size, logarithm of the drop."""
    m = np.clip(table[:, 8:17], low, high)
    size = [m[:, 0] ** 2, m[:, 0] * m[:, 1], m[:, 1] ** 2]
    return np.column_stack([m, *size, table[:, 17]])


def overlap(a, b):
    low = np.maximum(a[:, None, :2], b[None, :, :2])
    high = np.minimum(a[:, None, 2:], b[None, :, 2:])
    both = np.clip(high - low, 0, None).prod(2)
    area = lambda q: (q[:, 2:] - q[:, :2]).prod(1)
    return both / (area(a)[:, None] + area(b)[None] - both)


def fitted(tables, boxes, plots, limits, penalty):
    """Intercept and weights of the measures as they stand, by penalised likelihood."""
    x = np.concatenate([measures(tables[p], *limits) for p in plots])
    y = np.concatenate([overlap(tables[p][:, 4:8], boxes[p]).max(1) >= OVERLAP for p in plots])
    mean, scale = x.mean(0), x.std(0) + 1e-9
    z = (x - mean) / scale
    weight = penalty * len(y)

    def loss(t):
        s = z @ t[1:] + t[0]
        g = 1 / (1 + np.exp(-s)) - y
        value = (np.logaddexp(0, s) - y * s).sum() + 0.5 * weight * (t[1:] ** 2).sum()
        return value, np.r_[g.sum(), z.T @ g + weight * t[1:]]

    t = minimize(loss, np.zeros(z.shape[1] + 1), jac=True, method="L-BFGS-B", options={"maxiter": 5000}).x
    return np.r_[t[0] - (t[1:] * mean / scale).sum(), t[1:] / scale]


def chosen(table, chance, price):
    parts, worth = table[:, 1:3].astype(int), chance - price
    value, is_own = worth.copy(), np.ones(len(table), bool)
    for i, (a, b) in enumerate(parts):
        if a >= 0:
            best = max(value[a], 0) + max(value[b], 0) if max(value[a], value[b]) > 0 else value[a] + value[b]
            is_own[i], value[i] = worth[i] >= best, max(worth[i], best)
    out, stack = [], list(np.flatnonzero(table[:, 3] > 0))
    while stack:
        i = stack.pop()
        if parts[i, 0] >= 0 and not is_own[i]:
            stack += list(parts[i])
        elif chance[i] >= LEAST_CHANCE:
            out.append(i)
    return out


def tally(table, boxes, model, limits, price):
    chance = 1 / (1 + np.exp(-(measures(table, *limits) @ model[1:] + model[0])))
    found = chosen(table, chance, price)
    if not found:
        return 0, len(boxes), 0
    hit = (overlap(table[found][:, 4:8], boxes) >= OVERLAP).astype(float)
    rows, cols = linear_sum_assignment(-hit)
    return hit[rows, cols].sum(), len(boxes), len(found)


def f1(tallies):
    matched, true, found = np.sum(tallies, 0)
    return 2 * matched / (true + found)


def main():
    args = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    args.add_argument("regions", type=pathlib.Path)
    args.add_argument("boxes", type=pathlib.Path)
    args.add_argument("--penalty", type=float, default=3e-4)
    args.add_argument("--price", type=float, default=0.38)
    args = args.parse_args()

    boxes = {}
    with open(args.boxes) as f:
        for row in csv.DictReader(f):
            boxes.setdefault(row["plot"], []).append([float(row[k]) for k in ("xmin", "ymin", "xmax", "ymax")])
    boxes = {plot: np.array(b) for plot, b in boxes.items()}
    tables = {p: np.loadtxt(args.regions / f"{p}.csv", delimiter=",", ndmin=2) for p in sorted(boxes)}
    plots = sorted(tables)
    every = np.concatenate([tables[p][:, 8:17] for p in plots])
    limits = np.percentile(every, 1, axis=0).round(3), np.percentile(every, 99, axis=0).round(3)
    fit = lambda some: fitted(tables, boxes, some, limits, args.penalty)
    score = lambda some, model: [tally(tables[p], boxes[p], model, limits, args.price) for p in some]

    model = fit(plots).round(3)
    print("LOWEST", limits[0].tolist(), "\nHIGHEST", limits[1].tolist())
    print("BIAS", model[0], "\nWEIGHT", model[1:10].tolist())
    print("WEIGHT_SIZE", model[10:13].tolist(), "\nWEIGHT_DROP", model[13])
    print(f"F1 fitted on all plots {f1(score(plots, model)):.3f}")
    order = np.random.default_rng(0).permutation(plots)
    folds = [set(order[k::FOLDS]) for k in range(FOLDS)]
    held_out = [t for fold in folds for t in score(sorted(fold), fit([p for p in plots if p not in fold]))]
    print(f"F1 cross-validated over plots {f1(held_out):.3f}")
    sites = sorted({p.split("_")[0] for p in plots})
    for site in sites:
        there = [p for p in plots if p.startswith(site)]
        elsewhere = [p for p in plots if not p.startswith(site)]
        print(f"F1 on {site}: {f1(score(there, model)):.3f}, fitted elsewhere {f1(score(there, fit(elsewhere))):.3f}")


if __name__ == "__main__":
    main()
