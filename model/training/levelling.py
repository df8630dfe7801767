"""Fits the weights of levelling: ``python -m model.training.levelling --help``.

Objects are scanned as phones do, with and without the table they stand on; the candidate nearest to
the true up is the right one. A logistic model over the candidates' features learns to choose it.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize

from model.core.errors import ArtiworldError
from model.core.resources import static_assets
from model.data.registry import DatasetOptions, open_dataset
from model.data.simulated.reconstruction import ReconstructionSettings, reconstruct_scan
from model.evaluation.pool import robust_map
from model.geometry.cleaning import SUPPORT
from model.geometry.levelling import FEATURES, candidates_of

Array = npt.NDArray[np.float64]

POINTS = 60_000
RIDGE = 0.01
"""Weight of the squared coefficients in the loss; chosen by us, not tuned."""


@dataclass(frozen=True)
class Sample:
    """The candidates of one scan.

    Attributes:
        features: (C, F).
        error: (C,) radians between each refined candidate and the true up.
        table: whether the object stands on one.
    """

    features: Array
    error: Array
    table: bool


def samples_of(data: DatasetOptions, seed: int, name: str) -> list[Sample]:
    """One object on a table and without it; none where it can't be read."""
    rng = np.random.default_rng([seed, *name.encode()])
    out: list[Sample] = []
    try:
        obj = open_dataset(data).load(name).object
        for table in (True, False):
            clutter = int(rng.integers(3)) if table else 0
            settings = ReconstructionSettings(points=POINTS, support=table, clutter=clutter)
            scan = reconstruct_scan(obj, settings, rng)
            points = scan.cloud.points if table else scan.cloud.points[scan.kind != SUPPORT]
            up = scan.source_from_object[:3, 2] / np.linalg.norm(scan.source_from_object[:3, 2])
            found = candidates_of(points)
            error = np.arccos(np.clip(np.array([c.refined @ up for c in found]), -1, 1))
            out.append(Sample(np.array([c.described.features for c in found]), error, table))
    except ArtiworldError:
        return []
    return out


def fitted(samples: Sequence[Sample]) -> dict[str, list[float]]:
    """Mean, scale and weight of each feature."""
    every = np.concatenate([s.features for s in samples])
    mean, scale = every.mean(0), every.std(0) + 1e-9
    rows = [((s.features - mean) / scale, int(s.error.argmin())) for s in samples]

    def loss(weight: Array) -> tuple[float, Array]:
        value, gradient = RIDGE * float(weight @ weight), 2 * RIDGE * weight
        for features, right in rows:
            score = features @ weight
            odds = np.exp(score - score.max())
            odds /= odds.sum()
            value -= float(np.log(odds[right] + 1e-12)) / len(rows)
            gradient = gradient + (odds @ features - features[right]) / len(rows)
        return value, gradient

    weight = minimize(loss, np.zeros(len(FEATURES)), jac=True, method="L-BFGS-B").x
    numbers = {"mean": mean, "scale": scale, "weight": weight}
    return {name: np.round(value, 5).tolist() for name, value in numbers.items()}


def within(samples: Sequence[Sample], weights: dict[str, list[float]], degrees: float) -> float:
    """Share of the scans whose chosen candidate is so near to the true up."""
    mean, scale, weight = (np.array(weights[k]) for k in ("mean", "scale", "weight"))
    chosen = [s.error[int(((s.features - mean) / scale @ weight).argmax())] for s in samples]
    return float(np.mean(np.array(chosen) <= np.radians(degrees)))


def main(arguments: Sequence[str] | None = None) -> None:
    """Fit and write ``levelling.json``."""
    parser = argparse.ArgumentParser(description="Fit the weights of levelling.")
    parser.add_argument("--urdf", type=Path, help="folder of URDF objects to scan beside our own")
    parser.add_argument("--limit", type=int, default=70, help="objects of each source")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=static_assets() / "levelling.json")
    args = parser.parse_args(arguments)
    sources = [DatasetOptions("procedural", seed=5, n=2)]
    if args.urdf is not None:
        sources.append(DatasetOptions("urdf", args.urdf))
    samples: list[Sample] = []
    for data in sources:
        ids = list(open_dataset(data).ids())
        np.random.default_rng(args.seed).shuffle(ids)
        work = partial(samples_of, data, args.seed)
        for _, found in robust_map(work, ids[: args.limit], args.jobs):
            samples += found or []
    weights = fitted(samples)
    on_table = [s for s in samples if s.table]
    bare = [s for s in samples if not s.table]
    scores = {
        "scans": len(samples),
        "within 2 degrees on a table": round(within(on_table, weights, 2), 3),
        "within 2 degrees without": round(within(bare, weights, 2), 3),
    }
    report = {"format": 1, "features": list(FEATURES), **weights, "fitted on": scores}
    args.out.write_text(json.dumps(report, indent=1) + "\n")
    print(json.dumps(scores))


if __name__ == "__main__":
    main()
