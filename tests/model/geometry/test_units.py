"""Sizes that no object has are asked about, others aren't."""

import numpy as np
import pytest

from model.geometry.units import odd_size


@pytest.mark.parametrize(
    ("size", "scale", "question", "unit"),
    [
        ((800, 565, 1000), 1.0, "1000 m tall: is the file in millimetres?", "millimetres"),
        ((80, 50, 60), 1.0, "80 m wide: is the file in centimetres?", "centimetres"),
        ((0.0008, 0.0005, 0.001), 0.001, "1 mm tall: is the file in metres?", "metres"),
        ((0.0008, 0.0005, 0.001), 1.0, "1 mm tall: is the file's unit right?", None),
    ],
)
def test_odd_sizes(size: tuple[float, ...], scale: float, question: str, unit: str | None) -> None:
    odd = odd_size(np.array([np.zeros(3), size]), scale)
    assert odd is not None and (odd.question, odd.unit) == (question, unit)


@pytest.mark.parametrize("size", [(0.4, 0.4, 1.0), (12, 8, 3), (0.01, 0.01, 0.01), (0, 0, 0)])
def test_likely_sizes(size: tuple[float, ...]) -> None:
    assert odd_size(np.array([np.zeros(3), size]), 1.0) is None
