"""Buttons that name a part: joints are predicted better for parts that have a name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from app.viewer.panels.widgets import put
from app.viewer.tab import Tab
from app.viewer.words.annotate import quick_names
from app.viewer.words.common import CHOSEN

ROWS: Final[tuple[tuple[str, ...], ...]] = (("door", "drawer", "lid"), ("knob", "button", "wheel"))
"""What most parts are; the list beside them has the rest."""
NUMBERED: Final[tuple[str, ...]] = tuple(name for row in ROWS for name in row)
"""Names by their digit, from 1, pressed with Shift."""


class QuickNames:
    """One click or key names a part."""

    def __init__(self, tab: Tab, named: Callable[[str], None]) -> None:
        """Put the buttons where the panel is; ``named`` gets the name that was clicked."""
        first = [1 + NUMBERED.index(names[0]) for names in ROWS]
        self._rows = [
            tab.client.gui.add_button_group(quick_names(k, k + len(names) - 1), names)
            for k, names in zip(first, ROWS, strict=True)
        ]
        for row in self._rows:
            row.on_click(lambda e: tab.act(lambda: named(e.target.value.removeprefix(CHOSEN))))

    def show(self, visible: bool, chosen: str | None = None) -> None:
        """Show or hide them; the ``chosen`` name is marked."""
        for row, names in zip(self._rows, ROWS, strict=True):
            put(row, "visible", visible)
            put(row, "options", tuple(CHOSEN * (name == chosen) + name for name in names))
