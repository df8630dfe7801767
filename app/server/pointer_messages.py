"""What the page's own script sends beside viser's messages; see ``scripts/pointer.js``."""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
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


@dataclass
class ArtiworldAnswerMessage(_messages.Message, include_in_scene_serialization=False):
    """Shift and a digit of the upper row were pressed."""

    number: int


@dataclass
class ArtiworldShownMessage(_messages.Message, include_in_scene_serialization=False):
    """Everything that was sent before ``tell_page(shown=number)`` is on the screen."""

    number: int


# viser looks its message classes up once: where it did before these were known, a page that moves
# its pointer would lose its connection.
_messages.Message._subclass_from_type_string.cache_clear()  # type: ignore[attr-defined]


def tell_page(client: viser.ClientHandle, **state: Any) -> None:
    """Set fields of the script's state."""
    _run(client, f"window.__artiworld?.set({json.dumps(state)})")


def title_buttons(client: viser.ClientHandle, titles: dict[str, str]) -> None:
    """Say what stands beside a button while the pointer rests on it.

    Args:
        titles: by the button's uuid; of all buttons that have one.
    """
    _run(client, f"window.__artiworldPanels?.titles({json.dumps(titles)})")


def hide_on_page(client: viser.ClientHandle, out: npt.NDArray[np.bool_] | None) -> None:
    """Leave elements out of the drawn scan.

    Args:
        out: (D,) for each triangle of its GLB, or each of its points; None leaves out none.
    """
    if out is None:
        _run(client, "window.__artiworld?.hide()")
        return
    bits = base64.b64encode(np.packbits(out, bitorder="little").tobytes()).decode()
    _run(client, f"window.__artiworld?.hide({len(out)}, '{bits}')")


def _run(client: viser.ClientHandle, source: str) -> None:
    client._websock_connection.queue_message(_messages.RunJavascriptMessage(source))
