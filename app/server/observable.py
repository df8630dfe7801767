"""Something that several tabs show: it tells them when to redraw, and what to announce."""

from __future__ import annotations

from collections.abc import Callable

Listener = Callable[[], None]
Notice = Callable[[str, str, str], None]


class Observable:
    """Keeps the tabs that show it."""

    def __init__(self) -> None:
        self._listeners: list[Listener] = []
        self._notices: list[Notice] = []
        self._announced_remote = False

    @property
    def is_shown(self) -> bool:
        """True while any tab shows it."""
        return bool(self._listeners)

    def watch(self, listener: Listener, notice: Notice) -> Callable[[], None]:
        """Call ``listener`` on every change and ``notice(title, body, color)`` with news.

        Returns:
            The function that ends it.
        """
        self._listeners.append(listener)
        self._notices.append(notice)

        def stop() -> None:
            if listener in self._listeners:
                self._listeners.remove(listener)
                self._notices.remove(notice)
                if not self._listeners:
                    self.left()

        return stop

    def left(self) -> None:
        """The last tab shows something else."""

    def changed(self) -> None:
        """Have all tabs redraw."""
        for listener in list(self._listeners):
            listener()

    def notify(self, title: str, body: str, color: str = "blue") -> None:
        """Show a note in all tabs."""
        for notice in list(self._notices):
            notice(title, body, color)

    def notify_remote_change(self) -> None:
        """Say once that another server changes this, too."""
        if self._listeners and not self._announced_remote:
            self._announced_remote = True
            self.notify("Changed elsewhere", "Another server works on this, too", "yellow")
