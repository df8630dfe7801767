"""Fit of the predictors' confidence to the outcome of joints of procedural objects.

It trains no network and reads no data set. ``artiworld train --preset confidence`` runs it.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from model.core.errors import ArtiworldError, ConfigurationError
from model.core.pool import robust_map
from model.core.progress import Progress, no_progress
from model.data.procedural.corruption import MIXED, corrupted, sometimes
from model.data.procedural.generate import family_names, make
from model.data.registry import GroundTruth
from model.evaluation.joint_metrics import score_object
from model.evaluation.summary import compared
from model.prediction.arti4urdf.structure import read_structure
from model.prediction.builder import FORMAT, SHIPPED, ConfidenceModel, fit
from model.prediction.registry import load_predictor

PREDICTORS = ("hybrid", "arti4urdf", "geometric")
TABLE = "joints.jsonl"
CLEAN = 0.7
"""Share of objects that are clean meshes; the others are corrupted as in training."""
PENALTY = 5.0
"""On the squared weights, as if that many joints contradicted each."""
MAX_WEIGHT = 6.0
"""Largest weight of an object in joints: the fifty keys of a keyboard are one decision."""
TEST_EVERY = 4
"""Every fourth object of each family is for testing."""
MIN_JOINTS = 50
"""Fewest joints of a fit."""


@dataclass(frozen=True)
class JointRow:
    """A predicted joint.

    Attributes:
        predictor: its name. object_id: of the procedural object. evidence: by name.
        right: whether the joint is usable, see :class:`~model.evaluation.joint_metrics.JointScore`.
    """

    predictor: str
    object_id: str
    evidence: dict[str, float]
    right: bool


def fit_confidence(
    out: Path,
    weights: Path | None,
    *,
    samples: int,
    seed: int = 0,
    jobs: int = 1,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Predict procedural objects with every predictor, and fit each one's confidence.

    Args:
        out: folder of the run; a stopped run resumes.
        weights: folder for another copy of ``confidence.json``, or None.
        samples: number of objects, families in turn, half of them with names.
        seed: random seed of the objects; the networks must not have been trained on them.
        jobs: processes.

    Returns:
        The written values: format, a regression per predictor, and its record.

    Raises:
        ConfigurationError: if there are too few objects or joints.
    """
    families = family_names()
    if samples <= len(families):  # the first of each family is for testing
        raise ConfigurationError(
            f"--samples {samples} is too few: the first {len(families)} objects, one of each "
            "family, test the fit"
        )
    out.mkdir(parents=True, exist_ok=True)
    ids = [f"{families[k % len(families)]}_{seed}_{k}" for k in range(samples)]
    place = {i: k for k, i in enumerate(ids)}
    rows = _collect(out / TABLE, ids, jobs, progress)
    fitted = {"format": FORMAT, "predictors": {}, "record": {"samples": samples, "seed": seed}}
    for predictor in PREDICTORS:
        own = [r for r in rows if r.predictor == predictor]
        if len(own) < MIN_JOINTS:
            raise ConfigurationError(f"{len(own)} joints are too few to fit; raise --samples")
        tested = [place[r.object_id] // len(families) % TEST_EVERY == 0 for r in own]
        # The written fit uses all joints; a fit without the tested ones shows its quality.
        fitted["predictors"][predictor] = asdict(_fitted(own))
        part = _fitted([r for r, t in zip(own, tested, strict=True) if not t])
        left = [r for r, t in zip(own, tested, strict=True) if t]
        fitted["record"][predictor] = {"joints": len(own), **reliability(left, part)}
    text = json.dumps(fitted, indent=1) + "\n"
    for folder in filter(None, (out, weights)):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / SHIPPED.name).write_text(text, encoding="utf-8")
    return fitted


def _fitted(rows: Sequence[JointRow]) -> ConfidenceModel:
    names = tuple(rows[0].evidence)
    values = np.array([[r.evidence[n] for n in names] for r in rows])
    right = np.array([float(r.right) for r in rows])
    weights = _row_weights(rows)
    full = fit(names, values, right, weights, PENALTY)
    if rows[0].predictor != "hybrid":
        return full
    # The network was trained on most of these families and is less reliable on new ones: take the
    # mean of this fit and one without the network's evidence.
    ruled = np.array([not n.endswith("network") for n in names])
    rules = fit(names, np.where(ruled, values, 0.0), right, weights, PENALTY)
    halves = tuple(round((a + b) / 2, 5) for a, b in zip(full.weights, rules.weights, strict=True))
    return replace(full, weights=halves, bias=round((full.bias + rules.bias) / 2, 5))


def _row_weights(rows: Sequence[JointRow]) -> np.ndarray:
    """(N,) weights, so that no object counts more than :data:`MAX_WEIGHT` joints."""
    counts: dict[str, int] = {}
    for r in rows:
        counts[r.object_id] = counts.get(r.object_id, 0) + 1
    return np.array([min(1.0, MAX_WEIGHT / counts[r.object_id]) for r in rows])


def reliability(rows: Sequence[JointRow], model: ConfidenceModel) -> dict[str, Any]:
    """Calibration error and Brier score of joints outside the fit, and the Brier score of their
    mean."""
    if not rows:
        return {"tested": 0}
    predicted = np.array([model.confidence(r.evidence) for r in rows])
    right = np.array([float(r.right) for r in rows])
    weights = _row_weights(rows)
    found = compared(predicted, right, weights)
    base = np.average(right, weights=weights)
    return {
        "tested": len(rows),
        "right": round(float(base), 4),
        "calibration_error": round(found.ece, 4),
        "brier": round(found.brier, 4),
        "brier_of_the_mean": round(float(base * (1 - base)), 4),
    }


def _collect(path: Path, ids: Sequence[str], jobs: int, progress: Progress) -> list[JointRow]:
    rows: dict[str, list[JointRow]] = {}
    if path.exists():
        for line in path.read_text(encoding="utf-8").splitlines():
            data = json.loads(line)
            rows[data["id"]] = [JointRow(**r) for r in data["rows"]]
    todo = [i for i in ids if i not in rows]
    with path.open("a", encoding="utf-8") as log:
        for i, found in robust_map(partial(joint_rows, PREDICTORS), todo, jobs):
            rows[i] = found or []
            log.write(json.dumps({"id": i, "rows": [asdict(r) for r in rows[i]]}) + "\n")
            log.flush()
            progress(len(rows) / len(ids), f"{len(rows)} of {len(ids)} objects")
    return [r for i in ids for r in rows.get(i, [])]


def joint_rows(predictors: Sequence[str], object_id: str) -> list[JointRow]:
    """Evidence and outcome of all joints of one procedural object; none if it is unusable."""
    family, seed, index = object_id.rsplit("_", 2)
    rng = np.random.default_rng([int(seed), int(index), 13])
    try:
        made = make(family, int(seed), int(index))
        named = bool(rng.random() < 0.5)
        truth = GroundTruth(object_id, made.object)
        if rng.random() > CLEAN:
            truth = corrupted(made, sometimes(MIXED, rng), rng, name=object_id)
        segmented = truth.segmented(names=named)
        structure = read_structure(segmented)
        out = []
        for name in predictors:
            given = {} if name == "geometric" else {"structure": structure}
            predictor: Any = load_predictor(name)
            answer, known = predictor.predict_with_evidence(segmented, **given)
            score = score_object(truth.object, answer.tree, confidence=answer.confidence)
            for j in score.joints:
                if j.present and j.child in known:
                    out.append(JointRow(name, object_id, dict(known[j.child]), j.usable))
    except ArtiworldError:
        return []
    return out
