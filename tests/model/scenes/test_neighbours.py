"""Limits that end at what stands around."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from model.scenes import convert
from model.scenes.jobs import PREDICTED
from model.scenes.neighbours import Standing
from model.scenes.scene import Decision, SceneObject


def test_of_many_objects_the_near_ones_are_found_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A metre apart, half a metre large: two diagonals reach to the neighbour after the next."""
    outcomes = []
    for i in range(100):
        pose = np.eye(4)
        pose[0, 3] = i
        obj = SceneObject(f"o{i}", f"o{i}", pose, np.ones(3), box=(0.5, 0.5, 0.5))
        outcomes.append(convert.Outcome(obj, Decision(True, (), ""), state=PREDICTED))
    seen: dict[str, list[str]] = {}
    bounds, calls = Standing.world_bounds, []

    def counted(standing: Standing) -> Any:
        calls.append(standing.id)
        return bounds(standing)

    def shortened(me: Standing, others: tuple[Standing, ...]) -> list[dict[str, Any]]:
        seen[me.id] = [s.id for s in others]
        return []

    monkeypatch.setattr(Standing, "world_bounds", counted)
    monkeypatch.setattr(convert, "shortened", shortened)
    convert.shorten_limits(outcomes, tmp_path, lambda *_: None)
    assert seen["o0"] == ["o1", "o2"] and seen["o50"] == ["o48", "o49", "o51", "o52"]
    assert len(calls) <= 2 * len(outcomes)  # every pair took minutes for thousands
