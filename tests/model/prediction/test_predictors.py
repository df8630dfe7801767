"""The table of predictors."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.cli.main import main
from model.core.articulated_object import SegmentedObject
from model.core.errors import ConfigurationError
from model.data.procedural.generate import make
from model.prediction import registry as predictors
from model.prediction.ablation import SWITCHES
from model.prediction.geometric import roles
from model.prediction.geometric.predictor import GeometricPredictor
from model.prediction.registry import Predictor


def test_every_name_loads_and_fits_the_port() -> None:
    assert "geometric" in predictors.predictor_names()
    for name in predictors.predictor_names():
        loaded = predictors.load_predictor(name)
        assert isinstance(loaded, Predictor) and loaded.name == name


def test_an_unknown_name_lists_those_that_are_there() -> None:
    with pytest.raises(ConfigurationError, match="geometric"):
        predictors.load_predictor("telepathic")


@pytest.mark.parametrize("mechanism", SWITCHES)
def test_a_predictor_without_a_mechanism_still_writes_a_tree(mechanism: str) -> None:
    obj = make("Laptop", 11, 0).object
    segmented = SegmentedObject(obj.name, obj.parts, obj.category)
    found = predictors.load_predictor(f"without:{mechanism}").predict(segmented)
    assert found.tree is not None and not found.problems
    assert f"without:{mechanism}" in found.backend


def test_what_is_left_out_is_there_again_afterwards_and_must_have_a_name() -> None:
    before = roles.named_mechanism
    test_a_predictor_without_a_mechanism_still_writes_a_tree("names")
    assert roles.named_mechanism is before
    with pytest.raises(ConfigurationError, match="no mechanism 'luck'"):
        predictors.load_predictor("without:luck")


class _Point:
    """An entry point that gives ``made``, or raises it."""

    def __init__(self, name: str, made: object) -> None:
        self.name, self.value, self._made = name, f"theirs:{name}", made

    def load(self):
        if isinstance(self._made, ImportError):
            raise self._made
        return self._call

    def _call(self):
        if isinstance(self._made, Exception):
            raise self._made
        return self._made


def test_plug_ins_load_and_cannot_replace_built_ins(monkeypatch: pytest.MonkeyPatch) -> None:
    mine = GeometricPredictor()
    points = [_Point("mine", mine), _Point("geometric", "theirs")]
    monkeypatch.setattr("model.core.packages.entry_points", lambda group: points)
    assert predictors.load_predictor("mine") is mine
    assert isinstance(predictors.load_predictor("geometric"), Predictor)


@pytest.mark.parametrize(
    ("made", "told"),
    [
        (ImportError("no module named 'theirs'"), "predictor 'bad' can't be loaded: no module"),
        (TypeError("needs a folder"), "predictor 'bad' can't be loaded: TypeError: needs a folder"),
        (ConfigurationError("set THEIR_KEY"), "^set THEIR_KEY$"),
        ("words", r"'bad' \(theirs:bad\) gives a str, .* no predictor: it needs name and predict"),
        (None, "gives a NoneType, which is no predictor"),
        (GeometricPredictor, "gives the class GeometricPredictor, which is no predictor"),
    ],
)
def test_bad_plug_ins_are_named(
    made: object, told: str, monkeypatch: pytest.MonkeyPatch, capsys, tmp_path: Path
) -> None:
    monkeypatch.setattr("model.core.packages.entry_points", lambda group: [_Point("bad", made)])
    with pytest.raises(ConfigurationError, match=told):
        predictors.load_predictor("bad")
    (tmp_path / "parts").mkdir()
    words = ["predict", str(tmp_path / "parts"), "--out", str(tmp_path / "out")]
    assert main([*words, "--predictor", "bad"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
