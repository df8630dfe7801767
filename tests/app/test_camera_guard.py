"""Cameras as browsers report them: impossible ones never reach the drawing."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
import viser
from websockets.sync.client import connect

from app.server.guard import guarded_server
from app.server.page import make_possible
from tests.builders import wait_until


def camera_message(**changed) -> Any:
    numbers = {
        "wxyz": (1.0, 0.0, 0.0, 0.0), "position": (0.0, 0.0, 1.0), "fov": 1.0, "near": 0.1,
        "far": 10.0, "image_height": 10, "image_width": 20, "look_at": (0.0, 0.0, 0.0),
        "up_direction": (0.0, 0.0, 1.0),
    }  # fmt: skip
    return SimpleNamespace(**{**numbers, **changed})


@pytest.mark.parametrize("height", [0, -5, float("nan"), float("inf"), None, "ten"])
def test_a_picture_without_height_gets_one(height) -> None:
    message = camera_message(image_height=height, image_width=0)
    assert make_possible(message)
    assert message.image_height == message.image_width == 1


@pytest.mark.parametrize(
    "wrong",
    [
        {"position": (float("nan"), 0.0, 0.0)}, {"look_at": (0.0, 1e300, 0.0)}, {"fov": 0.0},
        {"wxyz": (0.0, 0.0, 0.0, 0.0)}, {"wxyz": (1.0, 0.0)}, {"up_direction": "up"},
        {"fov": float("nan")}, {"position": None},
    ],
)  # fmt: skip
def test_a_camera_that_is_nowhere_is_passed_over(wrong) -> None:
    assert not make_possible(camera_message(**wrong))


def test_a_tab_of_height_zero_is_drawn() -> None:
    aspects: list[float] = []
    server = guarded_server(port=0)
    server.on_client_connect(lambda client: aspects.append(client.camera.aspect))
    try:
        with connect(
            f"ws://127.0.0.1:{server.get_port()}",
            subprotocols=[f"viser-v{viser.__version__}"],  # type: ignore[list-item]
        ) as websocket:
            for wrong in ({"fov": float("nan")}, {"image_height": 0}):
                fields = {**vars(camera_message()), **wrong, "type": "ViewerCameraMessage"}
                websocket.send(msgspec.msgpack.encode(fields))
            wait_until(lambda: aspects)
    finally:
        server.stop()
    assert aspects == [20.0]
