"""A confidence says how often such joints are right."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from model.core.errors import InputFileError
from model.prediction.confidence import SUREST, doubt, fit, log_odds, weighing_of
from model.prediction.registry import PREDICTORS


def test_the_fit_finds_how_often_it_is_right() -> None:
    """Scores that are three times too sure, and a cue that halves the odds."""
    rng = np.random.default_rng(0)
    odds = rng.normal(1.0, 1.5, 6000)
    scanned = (rng.random(6000) < 0.3).astype(float)
    right = (rng.random(6000) < 1 / (1 + np.exp(-(odds - 0.7 * scanned)))).astype(float)
    values = np.column_stack([3 * odds, scanned, np.full(6000, 2.0)])
    weighing = fit(("score", "scanned", "constant"), values, right, np.ones(6000))
    for score, told in ((0.0, 0.0), (3.0, 0.0), (6.0, 1.0)):
        sure = weighing.of({"score": score, "scanned": told, "constant": 2.0})
        assert sure == pytest.approx(1 / (1 + np.exp(-(score / 3 - 0.7 * told))), abs=0.03)
    assert weighing.of({"score": 1e6}) == SUREST
    assert weighing.of({}) == pytest.approx(right.mean(), abs=0.06)


@pytest.mark.parametrize("predictor", PREDICTORS.built_in)
def test_every_predictor_of_ours_has_one(predictor: str) -> None:
    weighing = weighing_of(predictor)
    # What the rules say less surely is never more often right.
    low, high = ({"slot rules": v, "type rules": v} for v in (-2.0, 4.0))
    assert weighing.of(low) < weighing.of(high)


def test_others_have_none() -> None:
    with pytest.raises(InputFileError, match=r"someone else"):
        weighing_of("someone else's")


def test_a_damaged_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "confidence.json"
    for text in ("", "{}", json.dumps({"format": 99, "predictors": {}}), '{"format": 1}'):
        path.write_text(text)
        weighing_of.cache_clear()
        with pytest.raises(InputFileError, match=r"confidence\.json"):
            weighing_of("hybrid", path)


def test_the_weakest_decision_is_told() -> None:
    sure = {"parent": 6.0, "type rules": 3.0, "slot rules": 5.0, "slot network": 4.0}
    assert doubt(sure) == ""
    assert doubt(sure | {"slot network": -1.0, "type rules": 0.5}) == "least sure of its axis"
    assert log_odds(1.0) == -log_odds(0.0) == 6.0
