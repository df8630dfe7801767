"""The table of predictors."""

from __future__ import annotations

import importlib.metadata

import pytest

from model import predictors
from model.errors import ConfigurationError
from model.predictor import Predictor


def test_every_name_loads_and_fits_the_port() -> None:
    assert "geometric" in predictors.predictor_names()
    for name in predictors.predictor_names():
        loaded = predictors.load_predictor(name)
        assert isinstance(loaded, Predictor) and loaded.name == name


def test_an_unknown_name_lists_those_that_are_there() -> None:
    with pytest.raises(ConfigurationError, match="geometric"):
        predictors.load_predictor("telepathic")


def test_plug_ins_load_and_cannot_replace_built_ins(monkeypatch: pytest.MonkeyPatch) -> None:
    class Point:
        def __init__(self, name: str) -> None:
            self.name = name

        def load(self):
            return lambda: f"plug-in {self.name}"

    class Broken(Point):
        def load(self):
            raise ImportError("no module named 'theirs'")

    points = [Point("mine"), Point("geometric"), Broken("broken")]
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: points)
    assert predictors.load_predictor("mine") == "plug-in mine"
    assert isinstance(predictors.load_predictor("geometric"), Predictor)
    with pytest.raises(ConfigurationError, match="'broken' can't be loaded: no module"):
        predictors.load_predictor("broken")
