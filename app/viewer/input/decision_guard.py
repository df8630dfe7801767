"""Whether the person has seen what a decision is about: a double Y decides once."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from app.server.pointer_messages import ArtiworldShownMessage, tell_page

if TYPE_CHECKING:
    from app.viewer.client_app import ClientApp

LOOK_SECONDS = 0.4
"""Between an object being on the screen and a decision about it."""
SILENT_SECONDS = 5.0
"""After which a page that says nothing counts as having shown it."""


class Seen:
    """What one tab shows, and since when: its page says when it has drawn it."""

    def __init__(self, app: ClientApp) -> None:
        self._app = app
        self._sent: Any = None
        self._sent_at = 0.0
        self._number = 0
        self._shown_at: float | None = None
        endpoint = app.client._websock_connection
        endpoint.register_handler(ArtiworldShownMessage, lambda _, m: self._shown(m.number))

    def drawn(self) -> None:
        """Everything about what is on the screen now was sent: ask the page when it is there."""
        what = self._what()
        if what == self._sent:
            return
        self._sent, self._sent_at, self._shown_at = what, time.monotonic(), None
        self._number += 1
        tell_page(self._app.client, shown=self._number)

    def long_enough(self, pressed_at: float) -> bool:
        """Whether what is there now was seen when a key was pressed, by the monotonic clock."""
        if self._sent != self._what():
            return False
        since = self._shown_at
        if since is None:
            since = self._sent_at + SILENT_SECONDS
        return pressed_at - since >= LOOK_SECONDS

    def _shown(self, number: int) -> None:
        if number == self._number and self._shown_at is None:
            self._shown_at = time.monotonic()

    def _what(self) -> Any:
        """What a decision made now would be about, as far as a person can see it."""
        app = self._app
        scene = app.overview
        if scene is not None:
            work = None if scene.selected is None else scene.desk.work(scene.selected)
            if work is None:
                return scene.selected
            held = scene.desk.accepting.why_refused(work)
            return scene.selected, work.document.review, held
        obj = app.object
        if obj is None:
            return None
        looked_at = app.review_panel.gate.looked_at(obj) is not None
        there = app.drawn or bool(obj.problem)
        return obj.record.id, there, obj.document.review, looked_at
