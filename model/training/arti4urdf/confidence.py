"""Fit how sure the predictors may be: to made objects and what became of each joint.

No network is trained here and no data set is read. ``artiworld train --preset confidence`` runs it.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from model.core.errors import ArtiworldError, ConfigurationError
from model.core.progress import Progress, no_progress
from model.data.procedural.corruption import MIXED, corrupted, sometimes
from model.data.procedural.generate import family_names, make
from model.data.protocol import GroundTruth
from model.evaluation.calibration import compared
from model.evaluation.joint_metrics import score_object
from model.evaluation.pool import robust_map
from model.prediction.arti4urdf.structure import read_structure
from model.prediction.confidence import FORMAT, SHIPPED, ConfidenceModel, fit

PREDICTORS = ("hybrid", "arti4urdf", "geometric")
TABLE = "joints.jsonl"
CLEAN = 0.7
"""Share of the objects that stay clean meshes; the others are corrupted as in training."""
PENALTY = 5.0
"""On the squared weights, as if that many joints spoke against each."""
MOST_OF_ONE = 6.0
"""Joints that an object with many counts as: fifty keys of a keyboard are one decision."""
TEST_EVERY = 4
"""Every fourth object of each family tells how good a fit without them is."""


@dataclass(frozen=True)
class JointRow:
    """One true joint that got a joint.

    Attributes:
        predictor: whose. object_id: of the procedural object. evidence: by name.
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
    """Predict made objects with every predictor, and fit each one's confidence to the outcome.

    Args:
        out: folder of the run; a run that was stopped goes on.
        weights: the folder that gets ``confidence.json`` as well, or None.
        samples: objects, families in turn, half of them with names.
        seed: of the objects; never one that the networks were trained on.
        jobs: processes.

    Returns:
        What is written: format, the regression of each predictor, and the record of its making.

    Raises:
        ConfigurationError: where the objects are too few, or too few joints came out.
    """
    families = family_names()
    if samples <= len(families):  # the first of each family test the fit, and nothing is left
        raise ConfigurationError(
            f"--samples {samples} is too few: the first {len(families)} objects, one of each "
            "family, test the fit"
        )
    out.mkdir(parents=True, exist_ok=True)
    ids = [f"{families[k % len(families)]}_{seed}_{k}" for k in range(samples)]
    rows = _collect(out / TABLE, ids, jobs, progress)
    found = {"format": FORMAT, "predictors": {}, "record": {"samples": samples, "seed": seed}}
    for predictor in PREDICTORS:
        own = [r for r in rows if r.predictor == predictor]
        if len(own) < 50:
            raise ConfigurationError(f"{len(own)} joints are too few to fit; raise --samples")
        place = {i: k for k, i in enumerate(ids)}
        tested = np.array([place[r.object_id] // len(families) % TEST_EVERY == 0 for r in own])
        # What is written has seen them all; how good it is, a fit without the tested ones tells.
        found["predictors"][predictor] = asdict(_fitted(own))
        part = _fitted([r for r, t in zip(own, tested, strict=True) if not t])
        left = [r for r, t in zip(own, tested, strict=True) if t]
        found["record"][predictor] = {"joints": len(own), **reliability(left, part)}
    text = json.dumps(found, indent=1) + "\n"
    for folder in (out, weights):
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
            (folder / SHIPPED.name).write_text(text, encoding="utf-8")
    return found


def _fitted(rows: Sequence[JointRow]) -> ConfidenceModel:
    names = tuple(rows[0].evidence)
    values = np.array([[r.evidence[n] for n in names] for r in rows])
    right = np.array([float(r.right) for r in rows])
    weights = _row_weights(rows)
    whole = fit(names, values, right, weights, PENALTY)
    if rows[0].predictor != "hybrid":
        return whole
    # The network was trained on most of these kinds. Of a new kind its word is worth less, and the
    # rules decide without it: halfway to a fit that doesn't hear it.
    heard = np.array([not n.endswith("network") for n in names])
    deaf = fit(names, np.where(heard, values, 0.0), right, weights, PENALTY)
    halves = tuple(round((a + b) / 2, 5) for a, b in zip(whole.weights, deaf.weights, strict=True))
    return replace(whole, weights=halves, bias=round((whole.bias + deaf.bias) / 2, 5))


def _row_weights(rows: Sequence[JointRow]) -> np.ndarray:
    """(N,) so that no object counts more than :data:`MOST_OF_ONE` joints."""
    counts: dict[str, int] = {}
    for r in rows:
        counts[r.object_id] = counts.get(r.object_id, 0) + 1
    return np.array([min(1.0, MOST_OF_ONE / counts[r.object_id]) for r in rows])


def reliability(rows: Sequence[JointRow], confidence_model: ConfidenceModel) -> dict[str, Any]:
    """Of joints that were left out of the fit: calibration error, Brier score, and what they would
    be if all were as sure as they are on average."""
    if not rows:
        return {"tested": 0}
    sure = np.array([confidence_model.confidence(r.evidence) for r in rows])
    right = np.array([float(r.right) for r in rows])
    weights = _row_weights(rows)
    found = compared(sure, right, weights)
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
    """What the predictors know and make of one made object; none where it can't be made."""
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
            answer, known = _loaded(name).predict_with_evidence(segmented, **given)
            score = score_object(truth.object, answer.tree, confidence=answer.confidence)
            for j in score.joints:
                if j.present and j.child in known:
                    out.append(JointRow(name, object_id, dict(known[j.child]), j.usable))
    except ArtiworldError:
        return []
    return out


@lru_cache
def _loaded(name: str) -> Any:
    from model.prediction.registry import load_predictor

    return load_predictor(name)
