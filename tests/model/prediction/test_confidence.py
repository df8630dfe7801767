"""A confidence says how often such joints are right."""

import json
from pathlib import Path

import numpy as np
import pytest

from model.core.articulated_object import Part
from model.core.errors import InputFileError
from model.core.geometry import PointCloud
from model.core.joint import Joint
from model.prediction.builder import (
    MAX_CONFIDENCE,
    PredictionBuilder,
    fit,
    least_certain,
    load_confidence,
    log_odds,
)
from model.prediction.registry import PREDICTORS
from tests.builders import box, part, slide


def test_the_fit_is_calibrated() -> None:
    """Scores are three times too confident, and a second cue halves the odds."""
    rng = np.random.default_rng(0)
    odds = rng.normal(1.0, 1.5, 6000)
    scanned = (rng.random(6000) < 0.3).astype(float)
    right = (rng.random(6000) < 1 / (1 + np.exp(-(odds - 0.7 * scanned)))).astype(float)
    values = np.column_stack([3 * odds, scanned, np.full(6000, 2.0)])
    confidence_model = fit(("score", "scanned", "constant"), values, right, np.ones(6000))
    for score, seen in ((0.0, 0.0), (3.0, 0.0), (6.0, 1.0)):
        found = confidence_model.confidence({"score": score, "scanned": seen, "constant": 2.0})
        assert found == pytest.approx(1 / (1 + np.exp(-(score / 3 - 0.7 * seen))), abs=0.03)
    assert confidence_model.confidence({"score": 1e6}) == MAX_CONFIDENCE
    assert confidence_model.confidence({}) == pytest.approx(right.mean(), abs=0.06)


@pytest.mark.parametrize("predictor", PREDICTORS.built_in)
def test_every_built_in_predictor_has_a_model(predictor: str) -> None:
    confidence_model = load_confidence(predictor)
    # Higher odds of the rules never lower the confidence.
    low, high = ({"slot rules": v, "type rules": v} for v in (-2.0, 4.0))
    assert confidence_model.confidence(low) < confidence_model.confidence(high)


def test_other_predictors_have_none() -> None:
    with pytest.raises(InputFileError, match=r"someone else"):
        load_confidence("someone else's")


def test_a_damaged_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "confidence.json"
    for text in ("", "{}", json.dumps({"format": 99, "predictors": {}}), '{"format": 1}'):
        path.write_text(text)
        load_confidence.cache_clear()
        with pytest.raises(InputFileError, match=r"confidence\.json"):
            load_confidence("hybrid", path)


def test_the_least_certain_decision_is_named() -> None:
    evidence = {"parent": 6.0, "type rules": 3.0, "slot rules": 5.0, "slot network": 4.0}
    assert least_certain(evidence) == ""
    assert (
        least_certain(evidence | {"slot network": -1.0, "type rules": 0.5}) == "Least certain: axis"
    )
    assert log_odds(1.0) == -log_odds(0.0) == 6.0


@pytest.mark.parametrize("scanned", [False, True])
def test_what_one_of_a_row_shows_holds_for_its_equals(scanned: bool) -> None:
    """Two knobs in a row get one confidence; those that slide or are far larger keep theirs."""
    rows = {"knob 1": (0.0, 0.1), "knob 2": (0.3, 0.13), "knob 3": (0.6, 0.1), "knob 4": (0.8, 0.4)}
    parts = [part("link_0", box((0, 0, 0), (1.2, 1, 1)), name="body")]
    for k, (name, (x, size)) in enumerate(rows.items(), 1):
        parts.append(part(f"link_{k}", box((x, -0.1, 0.5), (x + size, 0, 0.5 + size)), name=name))
    for k, knob in enumerate(parts if scanned else ()):
        points = np.repeat(knob.mesh.vertices, 20, axis=0).astype(np.float32)  # type: ignore[union-attr]
        points[0] = (0.1 * k, -3.0, 0.0)  # on no surface
        parts[k] = Part(knob.link, cloud=PointCloud(points), name=knob.name)
    builder = PredictionBuilder(tuple(parts), (), load_confidence("hybrid"))
    for k, (x, size) in enumerate(rows.values(), 1):
        middle = (x + size / 2, -0.05, 0.5 + size / 2)
        turn = Joint(f"j{k}", "continuous", "link_0", f"link_{k}", (0.0, 1.0, 0.0), middle)
        moves = slide(f"j{k}", f"link_{k}", 0.01) if k == 3 else turn
        builder.add([moves], {"slot rules": (-5.0, 5.0, -3.0, -2.0)[k - 1]}, "")
    found = builder.build("rules", 0).confidence
    own = {k: builder.confidence_model.confidence(e) for k, e in builder.evidence.items()}
    assert found == own | {"link_1": own["link_2"]} and own["link_1"] < own["link_2"]
