"""Keys, as the field's habits have them; W A S D Q E and the arrows belong to the camera. A guard
holds off decisions about objects that the user has not seen yet, such as a double Y.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from html import escape
from typing import Any

from app.server.page import ArtiworldShownMessage, set_page_state
from app.viewer.panels.widgets import Dialog
from app.viewer.tab import Tab, latest_messages
from app.viewer.words import common as common_words
from app.viewer.words import keys as words

_STYLE = (
    "display:grid;grid-template-columns:max-content 1fr;gap:0.05em 1.2em;"
    "font-size:0.82em;line-height:1.22"
)


@dataclass(frozen=True)
class Binding:
    """One command of the palette (Ctrl+K).

    Attributes:
        label: its name there.
        key: the key that triggers it too, or None.
        action: what it does.
        modifier: the keys that are held with it, or None.
        decides: whether it decides about what is on the screen.
    """

    label: str
    key: Any
    action: Callable[[], None]
    modifier: Any = None
    decides: bool = False


def add_keys(
    tab: Tab, bindings: Iterable[Binding], decide: Callable[[Callable[[], None]], None]
) -> None:
    """Register commands with their keys; ``decide`` carries out those that decide."""
    for binding in bindings:
        command = tab.client.gui.add_command(
            binding.label, hotkey=binding.key, modifier=binding.modifier
        )
        carry_out = decide if binding.decides else tab.act
        command.on_trigger(lambda _, run=carry_out, action=binding.action: run(action))


Rows = Iterable[tuple[str, str]]


class KeySheet(Dialog):
    """The sheet of keys, or of the latest messages, over the picture."""

    def toggle(self) -> None:
        """Show the keys, or close the sheet."""
        self._toggle(words.TITLE, words.SHEET)

    def toggle_messages(self) -> None:
        """Show the latest messages, newest first, or close the sheet."""
        self._toggle(words.MESSAGES, latest_messages(self._tab) or [(words.NO_MESSAGES, "")])

    def _toggle(self, title: str, sheet: Rows) -> None:
        if self.close():
            return
        gui = self._tab.client.gui
        with self._open(title):
            self._add_close(words.CLOSE)
            rows = "".join(f"<b>{escape(k)}</b><span>{escape(v)}</span>" for k, v in sheet)
            gui.add_html(f'<div style="{_STYLE}">{rows}</div>')


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
                self._tab.notify(*common_words.TOO_FAST, "gray")

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
