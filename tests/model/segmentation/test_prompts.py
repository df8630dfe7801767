"""Prompts and labels: what they take, and the keys that recorded answers carry."""

import hashlib
from typing import Any

import numpy as np
import pytest

from model.core.errors import PromptError
from model.segmentation.prompts import MAX_PARTS, Click, PartSegmentation, Prompts, Region


def test_equal_clicks_have_equal_keys() -> None:
    plain = Click((0.0, 1.0, 0.5), 1, True, 7)
    same: list[Any] = [
        Click((0, 1, 0.5), 1, True, 7),
        Click(np.array([0, 1, 0.5]), np.int64(1), np.True_, np.int32(7)),  # type: ignore[arg-type]
        Click([np.float32(0), 1, 0.5], 1, True, 7),  # type: ignore[arg-type]
    ]
    # As it has always been: sessions on disk hold such keys.
    told = repr(("c", (0.0, 1.0, 0.5), 1, True, 7)).encode()
    assert Prompts((plain,)).key() == hashlib.sha256(told).hexdigest()[:24]
    for click in same:
        assert click == plain and hash(click) == hash(plain)
        assert Prompts((click,)).key() == Prompts((plain,)).key()


@pytest.mark.parametrize(
    "words",
    [
        {"position": ("a", 0, 0)},
        {"position": (0, 0)},
        {"position": (0, 0, float("nan"))},
        {"position": None},
        {"position": (True, 0, 0)},
        {"part": 1.5},
        {"part": True},
        {"part": "1"},
        {"part": MAX_PARTS},
        {"positive": 1},
        {"element": 2.0},
    ],
)
def test_what_is_no_click_is_said(words: dict[str, Any]) -> None:
    with pytest.raises(PromptError):
        Click(**{"position": (0, 0, 0), "part": 1, **words})


def test_regions_and_labels_take_whole_numbers_only() -> None:
    with pytest.raises(PromptError, match="whole numbers"):
        Region(1, np.array([0.5]))  # type: ignore[arg-type]
    with pytest.raises(PromptError, match="whole number"):
        Region(True, np.array([1]))
    assert Region(1, []).elements.dtype == np.int64  # type: ignore[arg-type]
    for labels in (np.array([0.0, 1.0]), np.array([True, False])):
        with pytest.raises(PromptError, match="integers"):
            PartSegmentation(labels)  # type: ignore[arg-type]
    for labels in ([0, 70_000], [-2, 0], [0, MAX_PARTS]):
        with pytest.raises(PromptError, match="labels must be -1"):
            PartSegmentation(np.array(labels))
    assert PartSegmentation(np.array([-1, 3], np.int64)).labels.dtype == np.int16
