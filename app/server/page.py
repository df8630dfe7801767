"""viser's page: our title and scripts in it, the messages between these scripts and the server (see
``scripts/pointer.js``), and a check of what browsers say of their cameras.
"""

from __future__ import annotations

import base64
import gzip
import json
import logging
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import numpy as np
import numpy.typing as npt
import viser
from viser import _messages
from websockets.http11 import Response

_NAMES = "upload focus panels markup queue display view look tree pointer light account"
_SCRIPTS = tuple(f"{name}.js" for name in _NAMES.split())
_STYLES = ("style.css", "controls.css", "project.css")


def _script(max_upload_bytes: int) -> str:
    scripts = files("app.server") / "scripts"
    texts = [(scripts / name).read_text() for name in _SCRIPTS]
    style = "".join(f"<style>\n{(scripts / name).read_text()}</style>\n" for name in _STYLES)
    whole = style + "\n".join(f"<script>\n{text}</script>" for text in texts)
    return whole.replace("__LIMIT__", json.dumps(max_upload_bytes))


class Page:
    """Adds our title and scripts to viser's page, once for each encoding.

    Args:
        title: title of the browser's tab.
        max_upload_bytes: larger files are refused by the page itself.
    """

    def __init__(self, title: str, max_upload_bytes: int) -> None:
        self._title = title
        self._script = _script(max_upload_bytes)
        self._bodies: dict[str, bytes] = {}

    def prepare(self, response: Response) -> Response:
        """Return ``response`` with the title and the scripts; unchanged where it isn't the page."""
        headers = response.headers
        if response.status_code != 200 or "text/html" not in headers.get("Content-Type", ""):
            return response
        encoding = headers.get("Content-Encoding", "identity")
        if encoding not in self._bodies:
            body = bytes(response.body)
            packed = encoding == "gzip"
            text = (gzip.decompress(body) if packed else body).decode()
            text = text.replace("<title>Viser</title>", f"<title>{self._title}</title>", 1)
            text = text.replace("<head>", "<head>" + self._script, 1)
            self._bodies[encoding] = gzip.compress(text.encode()) if packed else text.encode()
        response.body = self._bodies[encoding]
        del headers["Content-Length"]
        headers["Content-Length"] = str(len(response.body))
        return response


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
    """A key of the page's scripts was pressed: "lasso", "brush", "click" (Escape), "help",
    "messages", or "next" and "previous" (arrows) of what a tool found."""

    tool: str


@dataclass
class ArtiworldAnswerMessage(_messages.Message, include_in_scene_serialization=False):
    """Shift and a digit of the upper row were pressed."""

    number: int


@dataclass
class ArtiworldPressMessage(_messages.Message, include_in_scene_serialization=False):
    """A control of the page's own markup was used; see :mod:`app.viewer.panels.widgets`."""

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


MOST_PIXELS = 100_000
"""Longest side of a picture."""
_FARTHEST = 1e9  # metres, as for what a file may say of a point
_VECTORS = {"wxyz": 4, "position": 3, "look_at": 3, "up_direction": 3}


_log = logging.getLogger(__name__)
MALFORMED = (AssertionError, AttributeError, LookupError, OverflowError, TypeError, ValueError)


@contextmanager
def excused(what: str) -> Iterator[None]:
    """Log one line where ``what`` a browser sent is malformed: the page sends what can be read."""
    try:
        yield
    except MALFORMED as error:
        _log.warning("%.120s of a browser can't be handled (%r)", what, error)


def guard_messages(connection: Any) -> None:
    """Carry out nothing of a browser's message that can't be handled; see :func:`excused`. Only
    possible cameras come through."""
    handle = connection._handle_incoming_message

    async def handle_if_sound(client_id: Any, message: Any) -> None:
        with excused(type(message).__name__):
            if not isinstance(message, _messages.ViewerCameraMessage) or make_possible(message):
                await handle(client_id, message)

    connection._handle_incoming_message = handle_if_sound


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
