"""What is accepted is offered to objects that are like it: parts, names, category and joints."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.server import part_tasks
from app.server.accepting import accept
from app.server.app_state import AppState
from app.server.config import ServeConfig
from app.server.open_object import OpenObject
from model.core.errors import CommandError
from model.core.geometry import PointCloud
from model.io.write import write_cloud
from model.segmentation.prompts import Click
from sessions import commands as cmd
from sessions.document import Document, RegionRef
from sessions.store import Store
from tests.builders import cabinet_cloud, wait_until


def scan(path: Path, seed: int, degrees: float, size: float) -> Path:
    """The cabinet as another scan of it: turned, a little larger, other points and noise."""
    cloud = cabinet_cloud(20_000, seed, 0.001).asset.cloud
    assert cloud is not None
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = size * np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    points = (cloud.points @ turn.T).astype(np.float32)
    write_cloud(PointCloud(points, None, cloud.colors), path)
    return path


@pytest.fixture
def app_state(tmp_path: Path) -> Iterator[AppState]:
    paths = [scan(tmp_path / "first.ply", 0, 0, 1.0), scan(tmp_path / "second.ply", 1, 90, 1.05)]
    config = ServeConfig(workspace=tmp_path / "workspace")
    state = AppState(config, Store(tmp_path / "workspace"), paths)
    yield state
    state.close()


def annotated(obj: OpenObject) -> None:
    """Parts by the truth's clicks, names, and a joint that was corrected by hand."""
    labelled = cabinet_cloud(20_000, 0, 0.001)
    points = labelled.asset.element_centers
    for part, name in ((1, "door"), (2, "drawer")):
        own = np.flatnonzero(labelled.labels == part)
        middle = np.median(points[own], axis=0)
        place = points[own[np.linalg.norm(points[own] - middle, axis=1).argmin()]]
        obj.do(cmd.AddClick(Click(tuple(place.tolist()), part)), "tester")
        obj.do(cmd.NamePart(part, name), "tester")
    obj.do(cmd.SetCategory("StorageFurniture"), "tester")
    wait_until(lambda: obj.document.segmentation_current and not obj.busy, "parts", 60)
    obj.predict("tester")
    wait_until(lambda: obj.document.tree is not None, "joints")
    door = obj.document.tree.joint_of["link_1"]  # type: ignore[union-attr]
    obj.do(cmd.SetJoint(replace(door, lower=0.0, upper=1.23)), "tester")


def accepted(obj: OpenObject) -> None:
    wait_until(lambda: obj.validation.report is not None, "a verdict")
    report = obj.validation.report
    accept(obj, "", "tester", "as it is", seen=report)
    wait_until(lambda: obj.document.saved is not None, "it is saved")


def test_joints_come_from_accepted_assets_alone(app_state: AppState, tmp_path: Path) -> None:
    """Whatever folder a command names that a script wrote."""
    obj = app_state.object(app_state.queue.records()[0].id)
    assets = tmp_path / "workspace" / "assets"
    (assets / "good-1" / "inner").mkdir(parents=True)

    def source(name: str) -> Path | None:
        return obj.likeness.source_of_joints(
            Document(prompts=(RegionRef(1, "a", True, 1, f"like {name}"),))
        )

    assert source("good-1") == assets / "good-1"
    for name in ("..", ".", "../assets", "good-1/inner", "/etc", "good-1/..", "absent-2"):
        assert source(name) is None


def test_a_second_one_takes_parts_and_joints_of_the_first(app_state: AppState) -> None:
    first, second = (app_state.object(r.id) for r in app_state.queue.records())
    first.watch(lambda: None, lambda *note: None)
    wait_until(lambda: first.asset is not None, "the first is read")
    assert first.likeness.offer is None, "nothing is accepted yet"
    annotated(first)
    accepted(first)

    second.watch(lambda: None, lambda *note: None)
    offer: Any = wait_until(lambda: second.likeness.wanted, "an offer", 60)
    assert offer.folder.startswith("first") and len(offer.regions) == 2
    assert second.likeness.take("tester") == 2
    assert sorted(second.document.part_names.values()) == ["door", "drawer"]
    assert second.document.category == "StorageFurniture"
    assert second.likeness.wanted is None
    with pytest.raises(CommandError, match="like this one"):
        second.likeness.take("tester")

    wait_until(lambda: second.document.segmentation_current and not second.busy, "parts", 60)
    second.predict("tester")
    tree = wait_until(lambda: second.document.tree, "joints", 60)
    named = {name: f"link_{part}" for part, name in second.document.part_names.items()}
    assert tree.joint_of[named["door"]].upper == pytest.approx(1.23, abs=1e-3)
    prediction = second.document.prediction
    assert prediction is not None
    assert "Compared with 1 accepted object" in prediction.notes[named["door"]]
    assert prediction.confidence[named["door"]] < 1
    old = first.document.tree.joint_of["link_2"].axis  # type: ignore[union-attr]
    turned = (-old[1], old[0], old[2])
    np.testing.assert_allclose(tree.joint_of[named["drawer"]].axis, turned, atol=0.03)
    like = second.likeness.source_of_joints(second.document)
    other = part_tasks.predict(second.source(), "geometric", (), 0, like)
    assert other.tree is not None and "geometric follows no" in other.problems[-1]
    assert not prediction.problems
    # It is one step: undo takes all of it back, and the offer is there again.
    for _ in range(3):
        second.do(cmd.Undo(), "tester")
    assert not second.document.prompts and second.likeness.wanted is offer
