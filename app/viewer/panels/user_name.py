"""The name that signs decisions: the account's, or a box where nobody has to log in."""

from __future__ import annotations

from collections.abc import Callable

from app.viewer.panels.widgets import put
from app.viewer.tab import Tab
from app.viewer.text import plain
from app.viewer.words import common as words
from sessions import commands as cmd


class UserName:
    """The user's name; ``remember`` is called once it changed."""

    def __init__(self, tab: Tab, remember: Callable[[], None]) -> None:
        self._tab, self._remember = tab, remember
        if tab.account is not None:
            about = words.account(plain(tab.user), tab.account.role)
            tab.client.gui.add_markdown(about)
            self._box = None
            return
        self._box = tab.client.gui.add_text(words.USER_NAME, tab.user, hint=words.USER_NAME_HINT)
        tab.on_update(self._box, self._renamed)

    def show(self) -> None:
        """Put the name that the browser remembered into its box."""
        if self._box is not None:
            put(self._box, "value", self._tab.user)

    def _renamed(self) -> None:
        if self._box is None:
            return
        user = cmd.clean_text(self._box.value, 60, "your name")
        if user:
            self._tab.user = user
            self._remember()
