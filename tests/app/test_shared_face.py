"""Two clicks on one triangle for different parts are told to the person, others are not."""

from __future__ import annotations

import pytest

from app.viewer.input.pointing import shares_face
from model.segmentation.prompts import Click

DOOR = Click((0.0, 0.0, 0.0), 1, True, 7)
NOT_DOOR = Click((0.0, 0.0, 0.0), 1, False, 7)


@pytest.mark.parametrize(
    ("earlier", "click", "told"),
    [
        (DOOR, Click((0.5, 0, 0), 2, True, 7), True),
        (DOOR, Click((0.5, 0, 0), 1, False, 7), True),
        (DOOR, Click((0.5, 0, 0), 1, True, 7), False),
        (DOOR, Click((0.5, 0, 0), 2, True, 8), False),
        (DOOR, Click((0.005, 0, 0), 2, True, 7), False),
        (NOT_DOOR, Click((0.5, 0, 0), 2, False, 7), False),
        (NOT_DOOR, Click((0.5, 0, 0), 2, True, 7), True),
        (Click((0, 0, 0), 1, True), Click((0.5, 0, 0), 2, True, 7), False),
    ],
)
def test_who_is_told(earlier: Click, click: Click, told: bool) -> None:
    assert shares_face(click, [earlier], 0.01) is told
