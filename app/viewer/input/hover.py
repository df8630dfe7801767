"""The preview of a click, under the pointer."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable

from app.server.open_object import OpenObject
from app.server.pointer_messages import ArtiworldHoverMessage
from app.viewer.input.queries import PointerQueries
from app.viewer.picture import palette
from app.viewer.picture.object_picture import ObjectPicture
from app.viewer.tab import Tab
from model.core.errors import ArtiworldError
from model.core.progress import Cancelled
from model.segmentation.prompts import Click

log = logging.getLogger(__name__)
_AGAIN = 0.25
"""Seconds until a place that could not be answered yet is asked again; the pointer may rest."""


class Hover:
    """The preview of one tab, on a thread of its own: only the newest place counts.

    Args:
        clicking: whether a click now would be a prompt.

    Attributes:
        on: whether previews are shown.
        seconds: from the message to the preview, of the last one; for measuring.
    """

    def __init__(
        self,
        tab: Tab,
        picture: ObjectPicture,
        queries: PointerQueries,
        clicking: Callable[[], bool],
    ) -> None:
        self._tab, self._picture, self._queries = tab, picture, queries
        self._clicking = clicking
        self.on = True
        self.seconds: float | None = None
        self._place: tuple[float, float] | None = None
        self._came = 0.0
        self._news = threading.Event()
        self._closed = False
        self._shown: tuple[int, int, str] | None = None
        self._thread: threading.Thread | None = None

    def moved(self, message: ArtiworldHoverMessage) -> None:
        """The pointer rests elsewhere. Called on the event loop: it only takes a note."""
        inside = message.inside and math.isfinite(message.x) and math.isfinite(message.y)
        self._place = (message.x, message.y) if inside else None
        self._came = time.perf_counter()
        if self._thread is None and not self._closed:
            self._thread = threading.Thread(target=self._loop, name="hover", daemon=True)
            self._thread.start()
        self._news.set()

    def forget(self) -> None:
        """Show nothing until the pointer moves again."""
        self._place = None
        self._news.set()

    def close(self) -> None:
        """The tab is gone."""
        self._closed = True
        self._news.set()

    def _loop(self) -> None:
        settled = True
        while not self._closed:
            self._news.wait(None if settled else _AGAIN)
            self._news.clear()
            settled = True
            try:
                settled = self._show()
            except Cancelled:
                pass  # something newer came
            except TimeoutError:
                settled = False  # the workers have more urgent things to do
            except ArtiworldError as error:
                log.debug("no preview: %s", error)
            except Exception:  # a preview that fails must not end the previews
                if not self._closed:
                    log.exception("the preview failed")

    def _show(self) -> bool:
        """Answer the newest place; False where that has to wait for the object."""
        selection, place, came = self._tab.selection, self._place, self._came
        obj = selection.object
        if obj is None or obj.asset is None or place is None or not self._ready(obj):
            self._clear()
            return not (self.on and place is not None and obj is not None and obj.busy)
        hit = self._queries.pick_preview(obj.asset, place)
        if hit is None:
            self._clear()
            return True
        element, part, doc = int(hit.element), selection.part, obj.document
        wanted = (element, part, doc.key)
        if wanted == self._shown:
            return True
        x, y, z = (float(v) for v in hit.position)
        preview = self._queries.preview(obj.asset, doc, Click((x, y, z), part, True, element))
        if self._place is None or obj is not selection.object or obj.document.key != doc.key:
            return True  # clicked or left meanwhile
        self._shown = wanted
        self._picture.overlays.show_hover(preview.gained, preview.lost, palette.part_color(part))
        self.seconds = time.perf_counter() - came
        return True

    def _ready(self, obj: OpenObject) -> bool:
        """True if a click here and now would be a prompt that is answered at once."""
        busy = {"open", "encode", "segment", "room", "tool"} & set(obj.busy)
        return self.on and self._clicking() and not busy

    def _clear(self) -> None:
        if self._shown is not None:
            self._shown = None
            self._picture.overlays.show_hover(None, None, palette.BASE_COLOR)
