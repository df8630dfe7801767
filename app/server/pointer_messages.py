"""Messages between the page's own scripts and the server; see ``scripts/pointer.js``."""

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
    """The pointer rests at (x, y), (0, 0) top left to (1, 1), or has left the picture."""

    x: float
    y: float
    inside: bool


@dataclass
class ArtiworldStrokeMessage(_messages.Message, include_in_scene_serialization=False):
    """A lasso or a brush stroke was drawn; ``radius`` as a share of the picture's height."""

    tool: str
    path: tuple[tuple[float, float], ...]
    radius: float
    positive: bool


@dataclass
class ArtiworldToolMessage(_messages.Message, include_in_scene_serialization=False):
    """A key of the page's scripts was pressed: "lasso", "brush", "click" (Escape) or "help"."""

    tool: str


@dataclass
class ArtiworldAnswerMessage(_messages.Message, include_in_scene_serialization=False):
    """Shift and a digit of the upper row were pressed."""

    number: int


@dataclass
class ArtiworldPressMessage(_messages.Message, include_in_scene_serialization=False):
    """A control of the page's own markup was used; see :mod:`app.viewer.panels.markup`."""

    action: str
    value: str


@dataclass
class ArtiworldShownMessage(_messages.Message, include_in_scene_serialization=False):
    """Everything sent before ``set_page_state(shown=number)`` is on the screen."""

    number: int


# viser caches its message classes; it may have done so before these were defined.
_messages.Message._subclass_from_type_string.cache_clear()  # type: ignore[attr-defined]


def set_page_state(client: viser.ClientHandle, **state: Any) -> None:
    """Set fields of the page script's state."""
    _run(client, f"window.__artiworld?.set({json.dumps(state)})")


def show_markup(client: viser.ClientHandle, place: str, html: str) -> None:
    """Show HTML in a place of the page: "steps", "progress", "tools" or "tour"; "" hides it."""
    _run(client, f"window.__artiworldMarkup?.show({json.dumps(place)}, {json.dumps(html)})")


def call_page(client: viser.ClientHandle, function: str, *values: Any) -> None:
    """Call a function of the page's scripts, such as "Queue.changed"."""
    arguments = ", ".join(json.dumps(v) for v in values)
    owner, name = function.split(".")
    _run(client, f"window.__artiworld{owner}?.{name}({arguments})")


def hide_on_page(client: viser.ClientHandle, out: npt.NDArray[np.bool_] | None) -> None:
    """Leave elements out of the drawn scan.

    Args:
        out: (D,) for each triangle of its GLB, or each of its points; None leaves out nothing.
    """
    if out is None:
        _run(client, "window.__artiworld?.hide()")
        return
    bits = base64.b64encode(np.packbits(out, bitorder="little").tobytes()).decode()
    _run(client, f"window.__artiworld?.hide({len(out)}, '{bits}')")


def _run(client: viser.ClientHandle, source: str) -> None:
    client._websock_connection.queue_message(_messages.RunJavascriptMessage(source))
