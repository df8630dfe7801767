"""Guard against decisions about objects that the user has not seen yet, such as a double Y."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from app.server.pointer_messages import ArtiworldShownMessage, set_page_state
from app.viewer.tab import Tab
from app.viewer.words import common as words

LOOK_SECONDS = 0.4
"""Between an object being on the screen and a decision about it."""
SILENT_SECONDS = 5.0
"""After which a page that says nothing counts as having shown it."""


class DecisionGuard:
    """Accepts decisions only once their subject has been visible long enough.

    Args:
        subject: the subject of a decision made now, as far as the user can see it.
    """

    def __init__(self, tab: Tab, subject: Callable[[], Any]) -> None:
        self._tab, self._subject = tab, subject
        self._sent: Any = None
        self._sent_at = 0.0
        self._number = 0
        self._shown_at: float | None = None
        endpoint = tab.client._websock_connection
        endpoint.register_handler(ArtiworldShownMessage, lambda _, m: self._shown(m.number))

    def decide(self, action: Callable[[], None]) -> None:
        """Carry out a decision, unless it was asked for before its subject could be seen."""
        pressed_at = time.monotonic()

        def carry_out() -> None:
            if self.long_enough(pressed_at):
                action()
            else:
                self._tab.notify(*words.TOO_FAST, "gray")

        self._tab.act(carry_out)

    def drawn(self) -> None:
        """Ask the page when it shows what was just sent."""
        what = self._subject()
        if what == self._sent:
            return
        self._sent, self._sent_at, self._shown_at = what, time.monotonic(), None
        self._number += 1
        set_page_state(self._tab.client, shown=self._number)

    def long_enough(self, pressed_at: float) -> bool:
        """True if the subject was visible for long enough at ``pressed_at`` (monotonic seconds)."""
        if self._sent != self._subject():
            return False
        since = self._shown_at
        if since is None:
            since = self._sent_at + SILENT_SECONDS
        return pressed_at - since >= LOOK_SECONDS

    def _shown(self, number: int) -> None:
        if number == self._number and self._shown_at is None:
            self._shown_at = time.monotonic()
