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
from tests.app.api_server import CAMERA
from tests.builders import wait_until


def camera_message(**changed) -> Any:
    return SimpleNamespace(**{**CAMERA, **changed})


@pytest.mark.parametrize("height", [0, -5, float("nan"), float("inf"), None, "ten"])
def test_a_picture_without_height_gets_one(height) -> None:
    message = camera_message(image_height=height, image_width=0)
    assert make_possible(message)
    assert message.image_height == message.image_width == 1


WRONG = [("position", (float("nan"), 0.0, 0.0)), ("look_at", (0.0, 1e300, 0.0)), ("fov", 0.0)]
WRONG += [("wxyz", (0.0, 0.0, 0.0, 0.0)), ("wxyz", (1.0, 0.0)), ("up_direction", "up")]


@pytest.mark.parametrize(("field", "value"), [*WRONG, ("fov", float("nan")), ("position", None)])
def test_a_camera_that_is_nowhere_is_passed_over(field, value) -> None:
    assert not make_possible(camera_message(**{field: value}))


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
