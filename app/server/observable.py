"""Something that several tabs show: who looks, and what they are told."""

from __future__ import annotations

from collections.abc import Callable

Listener = Callable[[], None]
Notice = Callable[[str, str, str], None]


class Observable:
    """Tabs that redraw on a change and show notes."""

    def __init__(self) -> None:
        self._listeners: list[Listener] = []
        self._notices: list[Notice] = []
        self._told_of_others = False

    @property
    def watched(self) -> bool:
        """Whether any tab shows it."""
        return bool(self._listeners)

    def watch(self, listener: Listener, notice: Notice) -> Callable[[], None]:
        """Call ``listener`` on every change, ``notice(title, body, colour)`` with news."""
        self._listeners.append(listener)
        self._notices.append(notice)

        def stop() -> None:
            if listener in self._listeners:
                self._listeners.remove(listener)
                self._notices.remove(notice)

        return stop

    def changed(self) -> None:
        """Redraw in all the tabs."""
        for listener in list(self._listeners):
            listener()

    def tell(self, title: str, body: str, color: str = "blue") -> None:
        """Show a note in all the tabs."""
        for notice in list(self._notices):
            notice(title, body, color)

    def tell_of_others(self) -> None:
        """Say once that what changes here by itself is decided in another server."""
        if self._listeners and not self._told_of_others:
            self._told_of_others = True
            self.tell("Changed elsewhere", "Another server is at work on this, too", "yellow")
