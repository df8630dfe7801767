"""The left side of a scene: what the colors mean, and its objects, lowest confidence first, a page
of buttons at a time.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import viser

from app.server.scene_state import SHOWN, Row, Shown
from app.server.scene_workspace import SceneWorkspace
from app.viewer.panels.widgets import UserName, put
from app.viewer.picture import palette
from app.viewer.picture.scene_picture import ScenePicture
from app.viewer.tab import Tab, plain
from app.viewer.words import common
from app.viewer.words import scene as words
from app.viewer.words.joints import confidence


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
        options = (common.ALL, *states)
        self._filter = gui.add_dropdown(common.FILTER, options, initial_value=common.ALL)
        self._search = gui.add_text(common.SEARCH, "", hint=search_hint)
        self.buttons = [gui.add_button("", visible=False) for _ in range(size)]
        self._pages = gui.add_button_group(common.PAGE, ("◀", "1", "▶"))
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
        ids = [e.id for e in entries if state in (common.ALL, e.state) and search in e.text.lower()]
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


PAGE = 13
_ICONS = {
    "predicted": viser.Icon.SPARKLES,
    "on_hold": viser.Icon.ALERT_TRIANGLE,
    "validating": viser.Icon.HOURGLASS,
    "todo": viser.Icon.PENCIL,
    "rejected": viser.Icon.CIRCLE_X,
    "accepted": viser.Icon.CIRCLE_CHECK,
    "static": viser.Icon.LOCK,
    "failed": viser.Icon.ALERT_TRIANGLE,
    "missing": viser.Icon.QUESTION_MARK,
}


class SceneList:
    """Legend with counts, and a page of objects as buttons."""

    def __init__(
        self,
        tab: Tab,
        workspace: SceneWorkspace,
        picture: ScenePicture,
        choose: Callable[[str], None],
        remember: Callable[[], None],
    ) -> None:
        """Make the panel.

        Args:
            choose: gets the id of the object that was clicked.
            remember: is called once the user's name changed.
        """
        self._workspace, self._picture = workspace, picture
        self._shown: Any = None
        gui = tab.client.gui
        panel = gui.add_panel()
        with panel.add_tab(words.TITLE, viser.Icon.HOME):
            self._title = gui.add_markdown("")
            self._legend = gui.add_html("")
            self._original = gui.add_checkbox(
                words.ORIGINAL_COLORS, False, hint=words.ORIGINAL_COLORS_HINT
            )
            states = common.SCENE_STATES.values()
            self._list = ObjectList(tab, states, words.SEARCH_HINT, PAGE, choose)
            self.user_name = UserName(tab, remember)
        panel.dock_left()
        panel.set_width(250)
        self._original.on_update(lambda _: tab.act(self._recolor))

    def _recolor(self) -> None:
        self._picture.original_colors = self._original.value

    def draw(self, rows: Sequence[Row], current: str | None) -> None:
        """Bring the list up to date; nothing is sent where nothing changed."""
        ids = self._list.page(map(self._entry, rows), current)
        page = [r for r in rows if r.id in ids]
        counts = Counter(r.shown for r in rows)
        original_colors = self._picture.original_colors
        now = tuple(page), current, self._list.place, tuple(counts.items()), original_colors
        if now == self._shown:
            return
        self._shown = now
        scene = self._workspace.scene
        name = self._workspace.record.name if scene is None else scene.name
        put(self._title, "content", words.about(plain(name, 60), len(rows)))
        put(self._legend, "content", legend(counts, original_colors))
        self._list.draw([_look(row, row.id == current) for row in page])

    def _entry(self, row: Row) -> Entry:
        item = self._workspace.items[row.id]
        text = f"{row.id} {item.obj.description} {item.category or ''}"
        return Entry(row.id, common.SCENE_STATES[row.shown], text)


def _look(row: Row, here: bool) -> ButtonLook:
    share = confidence(row.confidence) if row.status == "predicted" else ""
    color = palette.SCENE_COLORS[row.shown]
    return ButtonLook(
        words.row(_short(row.id, 16 if share else 22), here, share),
        _ICONS[row.shown],
        color if here else muted(color),
        words.state(plain(row.id), row.shown),
    )


def legend(counts: Counter[Any], original_colors: bool) -> str:
    """Squares in the colors of the states, hollow where objects keep their own, with counts."""

    def square(state: Shown) -> str:
        if original_colors or state in ("static", "failed", "missing"):
            return "border:1.5px dashed #98a0a8"
        return f"background:rgb{palette.SCENE_COLORS[state]}"

    cells = "".join(
        f'<div style="display:flex;align-items:center;gap:6px">'
        f'<span style="width:12px;height:12px;border-radius:3px;flex:none;box-sizing:border-box;'
        f'{square(s)}"></span>'
        f"<span>{common.SCENE_STATES[s]}</span>"
        f'<b style="margin-left:auto;padding-right:10px">{counts[s]}</b></div>'
        for s in SHOWN
        if s not in ("failed", "missing", "on_hold", "validating") or counts[s]
    )
    return (
        '<div style="display:grid;grid-template-columns:1fr 1fr;gap:3px 4px;font-size:13px;'
        f'margin:2px 12px 6px">{cells}</div>'
    )


def _short(text: str, limit: int) -> str:
    """Beginning and end of a name, which may end in a number."""
    if len(text) <= limit:
        return text
    tail = limit // 3
    return f"{text[: limit - tail - 1]}…{text[-tail:]}"


def order(rows: Sequence[Row]) -> list[str]:
    """Ids in the order of a review: undecided ones, lowest confidence first."""
    return [r.id for r in rows if r.undecided]
