from __future__ import annotations

import numpy as np
import pytest

from app.viewer.picture.stage import may_be_a_room


@pytest.mark.parametrize(
    ("size", "room"), [((4.1, 3.2, 2.5), True), ((3.2, 0.6, 2.2), False), ((0.6, 3.2, 2.2), False)]
)
def test_a_row_of_cabinets_is_no_room(size: tuple[float, ...], room: bool):
    assert may_be_a_room(np.array([(0.0, 0.0, 0.0), size])) is room
