"""Notes of one tab: few at a time, none twice, and none longer than its reason holds."""

from __future__ import annotations

from typing import Any

import viser

MOST = 3
"""Notes at a time: what fits below the queue."""


class Notes:
    """Shows notes in the corner of a page, below the queue and not over the object."""

    def __init__(self, client: viser.ClientHandle) -> None:
        self._client = client
        self._shown: list[tuple[Any, Any, Any]] = []  # title and colour, reason, handle

    def show(
        self, title: str, body: str, color: Any, seconds: float | None, reason: Any = None
    ) -> None:
        """Show a note in place of an earlier one of the same title and colour: a hint doesn't hide
        the question that it is about.

        Args:
            seconds: how long it stays at most; None until somebody closes it.
            reason: the state that it is about, see :meth:`end_others`; None where it is an event.
        """
        same = [n for n in self._shown if n[0] == (title, color)]
        for note in same or self._shown[: max(len(self._shown) - MOST + 1, 0)]:
            self._end(note)
        handle = self._client.add_notification(title, body, auto_close_seconds=seconds, color=color)
        self._shown = [*self._shown, ((title, color), reason, handle)]

    def end_others(self, reason: Any) -> None:
        """End the notes that are about another state than ``reason``."""
        for note in [n for n in self._shown if n[1] not in (None, reason)]:
            self._end(note)

    def _end(self, note: tuple[Any, Any, Any]) -> None:
        self._shown = [n for n in self._shown if n is not note]
        note[2].remove()
