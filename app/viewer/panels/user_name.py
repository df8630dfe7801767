"""The box for the name that signs decisions."""

from __future__ import annotations

from collections.abc import Callable

from app.viewer.panels.widgets import put
from app.viewer.tab import Tab
from app.viewer.words import common as words
from sessions import commands as cmd


class UserName:
    """The user's name; ``remember`` is called once it changed."""

    def __init__(self, tab: Tab, remember: Callable[[], None]) -> None:
        self._tab, self._remember = tab, remember
        self._box = tab.client.gui.add_text(words.USER_NAME, tab.user, hint=words.USER_NAME_HINT)
        tab.on_update(self._box, self._renamed)

    def show(self) -> None:
        """Put the name that the browser remembered into its box."""
        put(self._box, "value", self._tab.user)

    def _renamed(self) -> None:
        user = cmd.clean_text(self._box.value, 60, "your name")
        if user:
            self._tab.user = user
            self._remember()
