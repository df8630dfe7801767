"""Buttons that name a part: joints are predicted better for parts that have a name."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Final

from app.viewer.panels.category_guess import category_in
from app.viewer.panels.widgets import put
from app.viewer.tab import Tab
from app.viewer.words.annotate import quick_names
from app.viewer.words.common import CHOSEN
from model.scenes.articulable_finders import read_lexicon

SHOWN, ROW = 6, 3
"""Names with a button, and buttons in a row."""
USUAL: Final[tuple[str, ...]] = ("door", "drawer", "lid", "knob", "button", "wheel")
"""Names of most parts; the list beside them has the rest."""


@lru_cache(maxsize=256)
def names_for(category: str | None) -> tuple[str, ...]:
    """The names with a button, in the order of their digits from 1: the usual ones, or for a
    category whose parts are others those first."""
    kinds = read_lexicon().kinds if category else ()
    parts = next((k.parts for k in kinds if category_in(k.name) == category), ())
    if set(parts) <= set(USUAL):
        return USUAL
    return tuple(dict.fromkeys((*parts, *USUAL)))[:SHOWN]


class QuickNames:
    """One click or key names a part."""

    def __init__(self, tab: Tab, named: Callable[[str], None]) -> None:
        """Put the buttons where the panel is; ``named`` gets the name that was clicked."""
        self._names = USUAL
        self._rows = [
            tab.client.gui.add_button_group(quick_names(k + 1, k + ROW), USUAL[k : k + ROW])
            for k in range(0, SHOWN, ROW)
        ]
        for row in self._rows:
            row.on_click(lambda e: tab.act(lambda: named(e.target.value.removeprefix(CHOSEN))))

    def name(self, number: int) -> str | None:
        """The name of a digit, None where it has none."""
        return self._names[number - 1] if 1 <= number <= len(self._names) else None

    def show(
        self,
        visible: bool,
        category: str | None,
        chosen: str | None = None,
        names: tuple[str, ...] = (),
    ) -> None:
        """Show or hide those of a category, or a project's ``names``; the chosen one is marked."""
        self._names = names[:SHOWN] or names_for(category)
        for k, row in zip(range(0, SHOWN, ROW), self._rows, strict=True):
            names = self._names[k : k + ROW]
            put(row, "visible", visible and bool(names))
            if not names:
                continue
            put(row, "options", tuple(CHOSEN * (name == chosen) + name for name in names))
