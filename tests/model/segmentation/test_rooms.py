"""Objects picked out of whole rooms by clicks."""

from __future__ import annotations

import numpy as np
import pytest

from model.geometry.asset import Asset
from model.geometry.point_cloud import PointCloud
from model.segmentation.default import DefaultSegmenter, DefaultSession
from model.segmentation.prompts import Click, Prompts
from model.segmentation.scorers import read_scorers
from model.segmentation.simulate import deepest, iou, next_click
from model.segmentation.training.clicks import ClickTraining, train_room_scorers
from model.segmentation.training.rooms import NOTHING, scanned_room
from model.segmentation.training.scans import LabelledCloud, family_shape, scan

SEED = 90_001
"""Of a room that no scorer was trained on."""


@pytest.fixture(scope="module")
def room() -> LabelledCloud:
    return scanned_room(SEED)


@pytest.fixture(scope="module")
def session(room: LabelledCloud) -> DefaultSession:
    return DefaultSegmenter().encode(Asset("room", cloud=room.cloud))


def test_floor_and_walls_are_known_and_hold_nothing_together(
    room: LabelledCloud, session: DefaultSession
) -> None:
    found, cells = session.encoding.room, session.encoding.cells
    assert found is not None
    flat = found.border[cells.of_node][session.encoding.nodes.elements.node_of_element]
    nothing = room.labels == NOTHING
    assert flat[nothing].mean() > 0.9 and flat[~nothing].mean() < 0.2
    across = found.border[cells.links.a] != found.border[cells.links.b]
    assert (cells.links.strength[across] == 9 * cells.links.count[across]).all()
    assert -0.05 < np.percentile(found.position[found.border, 2], 1) < 0.05


@pytest.mark.parametrize("angle", [0.0, 0.4, 1.2])
def test_a_turned_room_is_seen_along_its_walls(room: LabelledCloud, angle: float) -> None:
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    points = (room.cloud.points @ turn.T + [3.0, -7.0, 1.5]).astype(np.float32)
    cloud = PointCloud(points[::4], colors=room.cloud.colors[::4])  # type: ignore[index]
    encoding = DefaultSegmenter().encode(Asset("room", cloud=cloud)).encoding
    assert encoding.room is not None
    plain = DefaultSegmenter().encode(Asset("room", cloud=room.cloud)).encoding.room
    assert plain is not None
    spread = np.ptp(encoding.room.position, axis=0)
    np.testing.assert_allclose(np.sort(spread), np.sort(np.ptp(plain.position, axis=0)), atol=0.15)


def test_a_lone_object_is_no_room() -> None:
    data = scan(family_shape("Refrigerator", 3), 20_000, "outside", 0.001, 0)
    asset = Asset("fridge", cloud=data.cloud)
    assert DefaultSegmenter().encode(asset).encoding.room is None


def test_few_clicks_pick_an_object(room: LabelledCloud, session: DefaultSession) -> None:
    ids, count = np.unique(room.labels[room.labels != NOTHING], return_counts=True)
    points = room.cloud.points
    reached = []
    for part in ids[np.argsort(-count)][:5]:
        truth = room.labels == part
        clicks = [(deepest(points, truth), True)]
        for _ in range(5):
            prompts = Prompts(
                tuple(Click(tuple(points[e].tolist()), 1, p, int(e)) for e, p in clicks)
            )
            answer = session.segment(prompts).labels == 1
            found = next_click(points, truth, answer)
            if found is None:
                break
            clicks.append(found)
        reached.append(iou(answer, truth))
    assert np.mean(reached) > 0.75, np.round(reached, 2)


def test_scorers_of_rooms_can_be_trained_again(tmp_path) -> None:
    config = ClickTraining(rooms=1, room_objects=2, held_out=2, first_clicks=2, clicks=3,
                           networks=2, room_seed=SEED)  # fmt: skip
    scores = train_room_scorers(config, tmp_path)
    assert 0 < scores["first_iou"] <= scores["first_best_possible"] <= 1
    first, later = read_scorers(tmp_path, rooms=True)
    assert first is not None and later is not None and first.names[-1] == "click_outside"
