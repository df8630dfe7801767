"""Rejecting with a reason: X, then a number."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import viser

from app.viewer.panels.widgets import put
from app.viewer.tab import Tab
from app.viewer.words import review as words
from model.core.errors import CommandError
from sessions.review import RejectReason

_ROWS = (words.reason_buttons()[:4], words.reason_buttons()[4:])


class Rejecting:
    """The question for a reason in one tab.

    Args:
        about: what would be rejected now; a question about something else is off.
        reject: gets the reason.
    """

    def __init__(
        self, tab: Tab, about: Callable[[], Any], reject: Callable[[RejectReason], None]
    ) -> None:
        self._tab, self._about, self._reject = tab, about, reject
        self._asked: Any = None
        self._note: Any = None

    @property
    def asking(self) -> bool:
        """True while the next number is a reason."""
        self.end_elsewhere()
        return self._asked is not None

    def end_elsewhere(self) -> None:
        """End a question about something that isn't shown any more."""
        if self._asked is not None and self._asked != self._about():
            self.cancel()

    def ask(self, name: str) -> None:
        """Ask why the object of that name is rejected; a second call cancels."""
        if self.asking:
            self.cancel()
            return
        self._asked = self._about()
        self._note = self._tab.client.add_notification(
            words.ask_reason(name), words.reason_keys(), color="red"
        )
        self._tab.invalidate()

    def answer(self, number: int) -> None:
        """Reject for the reason with that number, from 1.

        Raises:
            CommandError: where no reason has that number.
        """
        if not 1 <= number <= len(words.REASONS):
            raise CommandError(words.bad_reason())
        self.cancel()
        self._reject(tuple(words.REASONS)[number - 1])

    def cancel(self) -> None:
        """Cancel the rejection."""
        note, self._note, self._asked = self._note, None, None
        if note is not None:
            note.remove()
            self._tab.invalidate()


class RejectButtons:
    """A button that asks for a reason, then one for each reason."""

    def __init__(self, tab: Tab, rejecting: Rejecting, clicked: Callable[[], None]) -> None:
        """Make the buttons; ``clicked`` toggles the question."""
        self._tab, self._rejecting = tab, rejecting
        gui = tab.client.gui
        self._reject = gui.add_button(words.REJECT, icon=viser.Icon.X, color="red")
        self._rows = [
            gui.add_button_group(words.REASON_LABEL if k == 0 else "", row, visible=False)
            for k, row in enumerate(_ROWS)
        ]
        self._reject.on_click(lambda _: clicked())
        for row in self._rows:
            row.on_click(lambda e: self._chosen(e.target.value))

    def _chosen(self, label: str) -> None:
        rejecting, number = self._rejecting, int(label.partition(" ")[0])
        self._tab.act(lambda: rejecting.answer(number) if rejecting.asking else None)

    def draw(self, visible: bool) -> None:
        """Bring them up to date; ``visible`` where there is something to reject."""
        asking = visible and self._rejecting.asking
        put(self._reject, "visible", visible)
        put(self._reject, "label", words.CANCEL_REJECTION if asking else words.REJECT)
        for row in self._rows:
            put(row, "visible", asking)
