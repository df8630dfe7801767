"""A check of what browsers say of their cameras: viser takes any numbers, and drawing needs sound
ones."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from viser import _messages, infra

MOST_PIXELS = 100_000
"""Longest side of a picture."""
_FARTHEST = 1e9  # metres, as for what a file may say of a point
_VECTORS = {"wxyz": 4, "position": 3, "look_at": 3, "up_direction": 3}


def attach_camera_guard(connection: infra.WebsockClientConnection) -> None:
    """Let only possible cameras through to viser, before a browser's first message."""
    handlers: dict[Any, list[Any]] = connection._incoming_handlers
    (inner,) = handlers[_messages.ViewerCameraMessage]

    async def guarded(client: Any, message: _messages.ViewerCameraMessage) -> None:
        if make_possible(message):
            await inner(client, message)

    handlers[_messages.ViewerCameraMessage] = [guarded]


def make_possible(message: _messages.ViewerCameraMessage) -> bool:
    """Give a picture without height or width, as of a hidden tab, one pixel.

    Returns:
        Whether the camera stands somewhere and looks somewhere.
    """
    for side in ("image_height", "image_width"):
        value = getattr(message, side)
        number = value if isinstance(value, int | float) and math.isfinite(value) else 1
        setattr(message, side, int(min(max(number, 1), MOST_PIXELS)))
    try:
        vectors = {k: np.asarray(getattr(message, k), np.float64) for k in _VECTORS}
        fov = float(message.fov)
    except (TypeError, ValueError, OverflowError):
        return False
    sound = all(
        v.shape == (_VECTORS[k],) and (np.abs(v) <= _FARTHEST).all() for k, v in vectors.items()
    )
    return sound and bool(vectors["wxyz"].any()) and 0 < fov < math.pi
