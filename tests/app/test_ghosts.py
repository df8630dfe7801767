"""Ghosts around what is worked on never stand before it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from app.server.scene_tasks import Shape
from app.viewer.picture.ghosts import Ghosts, before
from app.viewer.picture.scene_nodes import Group, Placement, Scans
from tests.builders import wait_until

STAND = Placement(
    np.array([[0, -1, 0, 2], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]]), np.full(3, 2.0)
)
"""Turned by a quarter, twice as large, two metres along x."""
BOX = np.array([[-0.25, -0.5, 0], [0.25, 0.5, 0.5]])


def test_what_is_between_the_eye_and_the_object_is_told_from_what_is_beside_and_behind() -> None:
    # The object reaches from 1 to 3 along x, from -0.5 to 0.5 along y, from 0 to 1 along z.
    eye = np.array([2.0, -4.0, 0.5])
    points = np.array(
        [[2, -2, 0.5], [2.9, -0.7, 0.9], [3.5, -0.7, 0.5], [2, 2, 0.5], [2, -2, -0.4], [2, -5, 0.5]]
    )
    assert before(eye, points, BOX, STAND).tolist() == [True, True, False, False, False, False]
    inside = np.array([2.0, 0.0, 0.5])
    assert not before(inside, points, BOX, STAND).any()


class Client:
    """Keeps the clouds that are sent."""

    def __init__(self) -> None:
        self.sent: dict[str, Any] = {}
        self.moved: Any = None
        self.camera = SimpleNamespace(on_update=lambda call: setattr(self, "moved", call))
        self.scene = self

    def add_point_cloud(self, name: str, points: Any, *_: Any, **__: Any) -> Any:
        handle = SimpleNamespace(points=points, remove=lambda: self.sent.pop(name), visible=True)
        self.sent[name] = handle
        return handle


def test_they_follow_the_camera_and_leave_out_what_is_worked_on() -> None:
    client: Any = Client()
    eye = np.array([2.0, -4.0, 0.5])
    cloud = np.array([[2, -2, 0.5], [2, 2, 0.5], [8, 0, 0]], np.float32)
    shape = Shape(np.array([cloud.min(0), cloud.max(0)]), cloud, None, np.zeros((3, 3), np.uint8))
    placements = [Placement(np.eye(4), np.ones(3)), STAND]
    room = Scans(client, "room", Group(("room", "mine"), shape, placements))
    around = Ghosts(client, "ghosts", lambda: eye)
    at = Shape(BOX, cloud, None), STAND
    try:
        around.draw("mine", [room], at)
        np.testing.assert_allclose(client.sent["ghosts"].points, cloud[1:])
        eye[1] = 4.0  # on the other side
        client.moved(None)
        wait_until(lambda: np.array_equal(client.sent["ghosts"].points, cloud[[0, 2]]))
        around.draw(None, [room], None)
        assert "ghosts" not in client.sent
    finally:
        around.close()
