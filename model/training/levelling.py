"""Fits the weights of levelling: ``python -m model.training.levelling --help``.

Objects are scanned as phones do, with and without the table they stand on; the candidate nearest to
the true up is the right one. A logistic model over the candidates' features learns to choose it.
Another learns from the scans without table and from whole surfaces whether an object stands, or
lies on its back or front.
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
from scipy.special import softmax

from model.core.articulated_object import ArticulatedObject
from model.core.errors import ArtiworldError
from model.core.files import static_assets
from model.core.geometry import uniform_scale
from model.core.pool import robust_map
from model.data.registry import DatasetOptions, open_dataset
from model.data.simulated.depth_camera import ReconstructionSettings, reconstruct_scan
from model.geometry.cleaning import SUPPORT
from model.geometry.levelling import BARE_FEATURES, FEATURES, bare_features, candidates_of, sampled
from model.geometry.sampling import sample_surface

Array = npt.NDArray[np.float64]

POINTS = 60_000
RIDGE = 0.01
"""Weight of the squared coefficients in the loss; chosen by us, not tuned."""


POSES = ((0, 2, 3), (3, 0, 1), (2, 1, 0))
"""Sides along z, y and -y of a file that stands, or lies on its back or front: 0 is the object's
top, 1 its bottom, 2 its back, 3 its front."""


@dataclass(frozen=True)
class Sample:
    """The candidates of one scan.

    Attributes:
        features: (C, F).
        error: (C,) radians between each refined candidate and the true up.
        table: whether the object stands on one.
        bare: (4, F) features of top, bottom, back and front, where there is none.
    """

    features: Array
    error: Array
    table: bool
    bare: Array | None = None


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
            features = np.array([c.described.features for c in found])
            turn = scan.source_from_object[:3, :3]
            sides = None if table else _sides(*sampled(points.astype(float), None), turn)
            out.append(Sample(features, error, table, sides))
        out.append(_whole(obj, rng))
    except ArtiworldError:
        return []
    return out


def _sides(points: Array, normals: Array, turn: Array) -> Array:
    """(4, F) features of top, bottom, back and front under a (3, 3) scaled rotation."""
    turn = turn / uniform_scale(turn)
    ups = ((0, 0, 1), (0, 0, -1), (0, 1, 0), (0, -1, 0))
    return np.array([bare_features(points, normals, turn @ up) for up in ups])


def _whole(obj: ArticulatedObject, rng: np.random.Generator) -> Sample:
    """All surfaces of an object."""
    meshes = [p.mesh for p in obj.parts if p.mesh is not None and p.mesh.face_areas.sum() > 0]
    area = sum(float(m.face_areas.sum()) for m in meshes)
    clouds = [
        sample_surface(m, 1 + int(20_000 * m.face_areas.sum() / area), rng)[0] for m in meshes
    ]
    points, normals = (
        np.concatenate([np.asarray(v, np.float64) for v in values])
        for values in zip(*((c.points, c.normals) for c in clouds), strict=True)
    )
    sides = _sides(*sampled(points, normals), np.eye(3))
    return Sample(np.empty((0, len(FEATURES))), np.empty(0), False, sides)


def fitted(chosen: Sequence[tuple[Array, int]]) -> dict[str, list[float]]:
    """Mean, scale and weight of each feature, from (C, F) features and which of them is right."""
    every = np.concatenate([features for features, _ in chosen])
    mean, scale = every.mean(0), every.std(0) + 1e-9
    rows = [((features - mean) / scale, right) for features, right in chosen]

    def loss(weight: Array) -> tuple[float, Array]:
        value, gradient = RIDGE * float(weight @ weight), 2 * RIDGE * weight
        for features, right in rows:
            odds = softmax(features @ weight)
            value -= float(np.log(odds[right] + 1e-12)) / len(rows)
            gradient = gradient + (odds @ features - features[right]) / len(rows)
        return value, gradient

    weight = minimize(loss, np.zeros(len(mean)), jac=True, method="L-BFGS-B").x
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
    scans = [s for s in samples if len(s.error)]
    weights = fitted([(s.features, int(s.error.argmin())) for s in scans])
    posed = [
        (s.bare[list(pose)], right)
        for s in samples
        if s.bare is not None
        for right, pose in enumerate(POSES)
    ]
    on_table = [s for s in scans if s.table]
    bare = [s for s in scans if not s.table]
    scores = {
        "scans": len(scans),
        "within 2 degrees on a table": round(within(on_table, weights, 2), 3),
        "within 2 degrees without": round(within(bare, weights, 2), 3),
    }
    standing = {"features": list(BARE_FEATURES), **fitted(posed), "fitted on": {}}
    standing["fitted on"] = {"surfaces, each in three poses": len(posed) // len(POSES)}
    report = {"format": 1, "features": list(FEATURES), **weights, "fitted on": scores}
    report["bare"] = standing
    args.out.write_text(json.dumps(report, indent=1) + "\n")
    print(json.dumps(scores))


if __name__ == "__main__":
    main()
