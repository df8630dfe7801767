"""What the page's own script sends beside viser's messages; see ``scripts/pointer.js``."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import viser
from viser import _messages


@dataclass
class ArtiworldHoverMessage(_messages.Message, include_in_scene_serialization=False):
    """The pointer rests at (x, y), from (0, 0), top left, to (1, 1); or it has left the picture."""

    x: float
    y: float
    inside: bool


@dataclass
class ArtiworldStrokeMessage(_messages.Message, include_in_scene_serialization=False):
    """A lasso or a brush was drawn; ``radius`` in parts of the picture's height."""

    tool: str
    path: tuple[tuple[float, float], ...]
    radius: float
    positive: bool


@dataclass
class ArtiworldToolMessage(_messages.Message, include_in_scene_serialization=False):
    """A key of the page's own was pressed: "lasso", "brush", "click" (Escape) or "help"."""

    tool: str


# viser looks its message classes up once: where it did before these were known, a page that moves
# its pointer would lose its connection.
_messages.Message._subclass_from_type_string.cache_clear()  # type: ignore[attr-defined]


def tell_page(client: viser.ClientHandle, **state: Any) -> None:
    """Set fields of the script's state."""
    source = f"window.__artiworld?.set({json.dumps(state)})"
    client._websock_connection.queue_message(_messages.RunJavascriptMessage(source))
