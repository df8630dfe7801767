"""What other packages offer under our entry-point groups, right or wrong."""

from collections.abc import Callable
from typing import Any

import pytest

from model.core.errors import ConfigurationError
from model.io.export import registry as exporters
from model.io.export.glb import GlbExporter
from model.scenes import articulable_finders as finders
from model.scenes import registry as scene_readers
from model.scenes.articulable_finders import LexiconFinder
from model.scenes.native_format import OwnReader
from model.segmentation import registry as segmenters
from model.segmentation.default import DefaultSegmenter


class Point:
    """An entry point whose callable gives ``made``."""

    name, value = "theirs", "package:make"

    def __init__(self, made: Any) -> None:
        self._made = made

    def load(self) -> Callable[[], Any]:
        return lambda: self._made


@pytest.mark.parametrize(
    ("module", "load", "kind", "right"),
    [
        (segmenters, segmenters.load_segmenter, "segmenter", DefaultSegmenter),
        (exporters, exporters.load_exporter, "export format", GlbExporter),
        (finders, finders.load_finder, "finder", LexiconFinder),
        (scene_readers, scene_readers.load_reader, "scene format", OwnReader),
    ],
)
def test_a_plug_in_that_does_not_fit_is_named_with_what_it_needs(
    module: Any, load: Any, kind: str, right: type, monkeypatch: pytest.MonkeyPatch
) -> None:
    def offered(made: Any) -> Any:
        monkeypatch.setattr("model.core.packages.entry_points", lambda group: [Point(made)])
        return load("theirs")

    told = rf"'theirs' \(package:make\) gives .*, which is no {kind}: it needs name"
    with pytest.raises(ConfigurationError, match=told):
        offered("words")
    with pytest.raises(ConfigurationError, match=f"gives the class {right.__name__}"):
        offered(right)
    made = right()
    assert offered(made) is made
