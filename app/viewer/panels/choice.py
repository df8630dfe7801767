"""A list of known words with a box for any other one."""

from __future__ import annotations

from collections.abc import Callable

from app.viewer.panels.widgets import put
from app.viewer.tab import Tab
from app.viewer.words.common import NONE, OTHER


class Choice:
    """A dropdown, and a text box that shows where its last entry, “Other…”, is chosen.

    Args:
        labels: of the dropdown and of the text box.
        known: the entries of the list.
        current: the value that holds now.
        chosen: gets another one; None where nothing is chosen.
    """

    def __init__(
        self,
        tab: Tab,
        labels: tuple[str, str],
        known: tuple[str, ...],
        current: Callable[[], str | None],
        chosen: Callable[[str | None], None],
    ) -> None:
        self._known, self._current, self._chosen = known, current, chosen
        gui = tab.client.gui
        self._list = gui.add_dropdown(labels[0], (NONE, *known, OTHER), initial_value=NONE)
        self._box = gui.add_text(labels[1], "", visible=False)
        tab.on_update(self._list, self._picked)
        tab.on_update(self._box, self._typed)

    def _picked(self) -> None:
        option = self._list.value
        self._box.visible = option == OTHER
        if option != OTHER and option != self._option(self._current()):
            self._chosen(None if option == NONE else option)

    def _typed(self) -> None:
        if self._box.value.strip():
            self._chosen(self._box.value)

    def _option(self, value: str | None) -> str:
        """The entry for ``value``: "washing machine" is WashingMachine."""
        if value is None:
            return NONE
        said = value.replace(" ", "").lower()
        return next((k for k in self._known if k.lower() == said), OTHER)

    def offer(self, known: tuple[str, ...]) -> None:
        """Have other entries in the list."""
        if known != self._known:
            self._known = known
            self._list.options = (NONE, *known, OTHER)

    def show(self, value: str | None, visible: bool) -> None:
        """Show ``value`` in the list, or in the box where the list hasn't got it."""
        option = self._option(value)
        if self._list.value != option and not (value is None and self._list.value == OTHER):
            self._list.value = option
        other = option == OTHER
        put(self._box, "visible", other and visible)
        if other:
            put(self._box, "value", value)
        put(self._list, "visible", visible)


def offered(own: tuple[str, ...], usual: tuple[str, ...], strict: bool) -> tuple[str, ...]:
    """A project's own names before the usual ones; those alone where no others are allowed."""
    return own if strict and own else tuple(dict.fromkeys((*own, *usual)))
