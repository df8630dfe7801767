"""The left side of a scene: what the colors mean, and its objects, lowest confidence first."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import viser

from app.server.scene_rows import SHOWN, Row, Shown
from app.server.scene_workspace import SceneWorkspace
from app.viewer.panels.user_name import UserName
from app.viewer.panels.widgets import put
from app.viewer.picture import palette
from app.viewer.picture.scene_picture import ScenePicture
from app.viewer.tab import Tab
from app.viewer.text import plain
from app.viewer.words import common
from app.viewer.words import scene as words
from app.viewer.words.joints import confidence

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
        self._tab, self._workspace, self._picture, self._choose_object = (
            tab,
            workspace,
            picture,
            choose,
        )
        self._first = 0
        self._shown: Any = None
        self._followed: str | None = None
        self._ids: list[str] = []
        gui = tab.client.gui
        panel = gui.add_panel()
        with panel.add_tab(words.TITLE, viser.Icon.HOME):
            self._title = gui.add_markdown("")
            self._legend = gui.add_html("")
            self._original = gui.add_checkbox(
                words.ORIGINAL_COLORS, False, hint=words.ORIGINAL_COLORS_HINT
            )
            self._filter = gui.add_dropdown(
                common.FILTER, (common.ALL, *common.SCENE_STATES.values()), initial_value=common.ALL
            )
            self._search = gui.add_text(common.SEARCH, "", hint=words.SEARCH_HINT)
            self._buttons = [gui.add_button("", visible=False) for _ in range(PAGE)]
            self._pages = gui.add_button_group(common.PAGE, ("◀", "1", "▶"))
            self.user_name = UserName(tab, remember)
        panel.dock_left()
        panel.set_width(250)
        for k, button in enumerate(self._buttons):
            button.on_click(lambda _, k=k: tab.act(lambda: self._choose(k)))
        self._original.on_update(lambda _: tab.act(self._recolor))
        self._filter.on_update(lambda _: self._turn(None))
        self._search.on_update(lambda _: self._turn(None))
        self._pages.on_click(lambda e: self._turn({"◀": -1, "▶": 1}.get(e.target.value, 0)))

    def _recolor(self) -> None:
        self._picture.original_colors = self._original.value

    def _choose(self, k: int) -> None:
        if k < len(self._ids):
            self._choose_object(self._ids[k])

    def _turn(self, by: int | None) -> None:
        self._first = 0 if by is None else self._first + by * PAGE
        self._tab.invalidate()

    def draw(self, rows: Sequence[Row], current: str | None) -> None:
        """Bring the list up to date; nothing is sent where nothing changed."""
        chosen = [r for r in rows if self._fits(r)]
        if current != self._followed:
            self._followed = current
            ids = [r.id for r in chosen]
            if current in ids:
                self._first = ids.index(current) // PAGE * PAGE
        self._first = min(max(self._first, 0), max(0, (len(chosen) - 1) // PAGE * PAGE))
        page = chosen[self._first : self._first + PAGE]
        counts = Counter(r.shown for r in rows)
        original_colors = self._picture.original_colors
        now = (
            tuple(page),
            current,
            len(chosen),
            self._first,
            tuple(counts.items()),
            original_colors,
        )
        if now == self._shown:
            return
        self._shown = now
        name = (
            self._workspace.record.name
            if self._workspace.scene is None
            else self._workspace.scene.name
        )
        put(self._title, "content", words.about(plain(name, 60), len(rows)))
        put(self._legend, "content", legend(counts, original_colors))
        self._ids = [r.id for r in page]
        put(self._pages, "visible", len(chosen) > PAGE)
        put(self._pages, "options", page_buttons(self._first // PAGE, -(-len(chosen) // PAGE)))
        for k, button in enumerate(self._buttons):
            put(button, "visible", k < len(page))
            if k < len(page):
                self._show(button, page[k], page[k].id == current)

    def _fits(self, row: Row) -> bool:
        item = self._workspace.items[row.id]
        text = f"{row.id} {item.obj.description} {item.category or ''}".lower()
        return (
            self._filter.value in (common.ALL, common.SCENE_STATES[row.shown])
            and self._search.value.lower() in text
        )

    def _show(self, button: Any, row: Row, here: bool) -> None:
        share = confidence(row.confidence) if row.status == "predicted" else ""
        put(button, "label", words.row(_short(row.id, 16 if share else 22), here, share))
        put(button, "icon", _ICONS[row.shown])
        color = palette.SCENE_COLORS[row.shown]
        put(button, "color", color if here else _deep(color))
        put(button, "hint", words.state(plain(row.id), row.shown))


def page_buttons(page: int, count: int) -> tuple[str, str, str]:
    """Where the list is, and the arrows that lead on from there; ``page`` counts from 0."""
    return ("◀" if page > 0 else "·", f"{page + 1}/{count}", "▶" if page + 1 < count else "· ")


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


def _deep(color: palette.Rgb) -> palette.Rgb:
    """A grayer color, for objects that aren't selected."""
    grey = 0.45
    return tuple(int(c * (1 - grey) + 120 * grey) for c in color)  # type: ignore[return-value]


def order(rows: Sequence[Row]) -> list[str]:
    """Ids in the order of a review: undecided ones, lowest confidence first."""
    return [r.id for r in rows if r.undecided]
