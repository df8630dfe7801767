"""Plug-ins load through the same table as the built-in segmenters."""

import pytest

from model.core.errors import ConfigurationError
from model.segmentation import registry
from model.segmentation.baselines import nearest_click


class _Entry:
    def __init__(self, name: str, target) -> None:
        self.name, self.value, self._target = name, f"somewhere:{name}", target

    def load(self):
        if isinstance(self._target, Exception):
            raise self._target
        return self._target


@pytest.fixture
def plug_ins(monkeypatch):
    entries = [
        _Entry("mine", nearest_click),
        _Entry("default", object),
        _Entry("wrong", object),
        _Entry("broken", ImportError("no torch")),
        _Entry("renamed", AttributeError("module 'mine' has no attribute 'Segmenter'")),
    ]
    monkeypatch.setattr("model.core.packages.entry_points", lambda group: entries)


def test_a_plug_in_is_listed_and_loads(plug_ins):
    assert "mine" in registry.segmenter_names()
    assert registry.segmenter_names()[0] == "default"
    assert registry.load_segmenter("mine").name == "nearest"


def test_a_plug_in_cannot_replace_the_default(plug_ins):
    assert registry.load_segmenter().name == "default"


def test_bad_plug_ins_are_named(plug_ins):
    with pytest.raises(ConfigurationError, match=r"wrong.*encode"):
        registry.load_segmenter("wrong")
    with pytest.raises(ConfigurationError, match=r"broken.*no torch"):
        registry.load_segmenter("broken")
    with pytest.raises(ConfigurationError, match=r"renamed.*no attribute"):
        registry.load_segmenter("renamed")
