"""A filtered list of objects, a page of buttons at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from app.viewer.panels.widgets import put
from app.viewer.picture import palette
from app.viewer.tab import Tab
from app.viewer.words import common as words


@dataclass(frozen=True)
class Entry:
    """An object in the list.

    Attributes:
        id: what a click gives.
        state: its state as the filter names it.
        text: what the search finds.
    """

    id: Any
    state: str
    text: str


@dataclass(frozen=True)
class ButtonLook:
    """Appearance of an object's button."""

    label: str
    icon: Any
    color: palette.Rgb
    hint: str


class ObjectList:
    """Filter, search, buttons and pages.

    Args:
        states: of the filter.
        size: objects on a page.
        chosen: gets the id of the object that was clicked.

    Attributes:
        buttons: one for each place of a page.
    """

    def __init__(
        self,
        tab: Tab,
        states: Iterable[str],
        search_hint: str,
        size: int,
        chosen: Callable[[Any], None],
    ) -> None:
        self._tab, self._size, self._chosen = tab, size, chosen
        self._first, self._count, self._ids = 0, 0, []
        self._followed: Any = None
        gui = tab.client.gui
        options = (words.ALL, *states)
        self._filter = gui.add_dropdown(words.FILTER, options, initial_value=words.ALL)
        self._search = gui.add_text(words.SEARCH, "", hint=search_hint)
        self.buttons = [gui.add_button("", visible=False) for _ in range(size)]
        self._pages = gui.add_button_group(words.PAGE, ("◀", "1", "▶"))
        for k, button in enumerate(self.buttons):
            button.on_click(lambda _, k=k: tab.act(lambda: self._clicked(k)))
        self._filter.on_update(lambda _: self._turn(None))
        self._search.on_update(lambda _: self._turn(None))
        self._pages.on_click(lambda e: self._turn({"◀": -1, "▶": 1}.get(e.target.value, 0)))

    def _clicked(self, k: int) -> None:
        if k < len(self._ids):
            self._chosen(self._ids[k])

    def _turn(self, by: int | None) -> None:
        self._first = 0 if by is None else self._first + by * self._size
        self._tab.invalidate()

    @property
    def place(self) -> tuple[int, int]:
        """Index of the page's first object, and how many there are."""
        return self._first, self._count

    def page(self, entries: Iterable[Entry], current: Any) -> list[Any]:
        """Ids of the objects on the page; a new ``current`` one turns to its page."""
        search, state = self._search.value.lower(), self._filter.value
        ids = [e.id for e in entries if state in (words.ALL, e.state) and search in e.text.lower()]
        if current != self._followed:
            self._followed = current
            if current in ids:
                self._first = ids.index(current) // self._size * self._size
        last = max(0, (len(ids) - 1) // self._size * self._size)
        self._first, self._count = min(max(self._first, 0), last), len(ids)
        self._ids = ids[self._first : self._first + self._size]
        return self._ids

    def draw(self, looks: Sequence[ButtonLook]) -> None:
        """Show the page; ``looks`` of its objects."""
        pages = -(-self._count // self._size)
        put(self._pages, "visible", pages > 1)
        put(self._pages, "options", page_buttons(self._first // self._size, pages))
        for k, button in enumerate(self.buttons):
            put(button, "visible", k < len(looks))
            for name, value in vars(looks[k]).items() if k < len(looks) else ():
                put(button, name, value)


def page_buttons(page: int, count: int) -> tuple[str, str, str]:
    """The page's number between arrows to its neighbors; ``page`` counts from 0."""
    return ("◀" if page > 0 else "·", f"{page + 1}/{count}", "▶" if page + 1 < count else "· ")


def muted(color: palette.Rgb) -> palette.Rgb:
    """A grayer color, for objects that aren't selected."""
    gray = 0.45
    return tuple(int(c * (1 - gray) + 120 * gray) for c in color)  # type: ignore[return-value]
