"""The queue at the left: objects and their states."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import viser

from app.server.app_state import AppState
from app.server.pointer_messages import title_buttons
from app.viewer.panels.queue_names import clipped, queue_names
from app.viewer.panels.scene_list import page_buttons
from app.viewer.panels.user_name import UserName
from app.viewer.panels.widgets import put
from app.viewer.picture import palette
from app.viewer.tab import Tab
from app.viewer.text import plain
from app.viewer.words import common
from app.viewer.words import queue as words
from model.validation.report import Severity
from sessions.records import ObjectRecord

PAGE = 14
NAME_LENGTH = 22
_ICONS = {
    "todo": viser.Icon.CIRCLE,
    "in_progress": viser.Icon.PENCIL,
    "predicted": viser.Icon.SPARKLES,
    "accepted": viser.Icon.CIRCLE_CHECK,
    "rejected": viser.Icon.CIRCLE_X,
}


class QueuePanel:
    """A page of objects as buttons, a filter, and the person's name."""

    def __init__(
        self,
        tab: Tab,
        app_state: AppState,
        open_object: Callable[[int], None],
        step: Callable[[int], None],
        remember: Callable[[], None],
    ) -> None:
        """Make the panel.

        Args:
            open_object: gets the id of the object that was chosen.
            step: goes to the next object (1) or to the one before (-1).
            remember: is called once the user's name changed.
        """
        self._tab, self._app_state, self._open_object = tab, app_state, open_object
        self._first = 0
        self._shown: tuple[Any, ...] | None = None
        self._followed: int | None = None
        self._held = 0
        gui = tab.client.gui
        panel = gui.add_panel()
        with panel.add_tab(words.TITLE, viser.Icon.LIST_DETAILS):
            self._summary = gui.add_markdown("")
            self._bar = gui.add_progress_bar(0.0, color="green")
            options = (common.ALL, *common.STATES.values())
            self._filter = gui.add_dropdown(common.FILTER, options, initial_value=common.ALL)
            self._search = gui.add_text(common.SEARCH, "", hint=words.SEARCH_HINT)
            self._buttons = [gui.add_button("", visible=False) for _ in range(PAGE)]
            self._again = gui.add_button(
                "", icon=viser.Icon.ALERT_TRIANGLE, color=palette.SEVERITY_COLORS[Severity.WARNING],
                visible=False,
                hint=words.ON_HOLD_HINT,
            )  # fmt: skip
            self._back = gui.add_button(
                "", icon=viser.Icon.ARROW_BACK_UP, color="gray", visible=False
            )
            self._pages = gui.add_button_group(common.PAGE, ("◀", "1", "▶"))
            self._next = gui.add_button_group(common.NAVIGATE, common.PREVIOUS_NEXT)
            self._upload = gui.add_upload_button(
                words.UPLOAD,
                icon=viser.Icon.UPLOAD,
                color="gray",
                hint=words.UPLOAD_HINT,
            )
            self.user_name = UserName(tab, remember)
        panel.dock_left()
        panel.set_width(230)
        self._ids: list[int] = []
        for k, button in enumerate(self._buttons):
            button.on_click(lambda _, k=k: tab.act(lambda: self._open(k)))
        self._filter.on_update(lambda _: self._turn(None))
        self._search.on_update(lambda _: self._turn(None))
        self._pages.on_click(lambda e: self._turn({"◀": -1, "▶": 1}.get(e.target.value, 0)))
        self._next.on_click(
            lambda e: tab.act(lambda: step(1 if e.target.value == common.PREVIOUS_NEXT[1] else -1))
        )
        self._again.on_click(lambda _: tab.act(lambda: open_object(self._held)))
        self._back.on_click(lambda _: tab.act(lambda: open_object(app_state.queue.restore())))
        self._upload.on_upload(lambda e: self._uploaded(e.target.value))

    def _uploaded(self, file: Any) -> None:
        add = self._app_state.add_upload
        self._tab.act(lambda: self._open_object(add(file.name, file.content)))

    def _open(self, k: int) -> None:
        if k < len(self._ids):
            self._open_object(self._ids[k])

    def _turn(self, by: int | None) -> None:
        self._first = 0 if by is None else self._first + by * PAGE
        self._tab.invalidate()

    def draw(self) -> None:
        """Bring the page up to date; nothing is sent where nothing changed."""
        app_state, obj = self._app_state, self._tab.selection.object
        records = app_state.queue.records()
        current = None if obj is None else obj.record.id
        names = queue_names(records)
        chosen = [
            r
            for r in records
            if self._filter.value in (common.ALL, common.STATES[r.state])
            and self._search.value.lower() in names[r.id].lower()
        ]
        if current != self._followed:
            self._followed = current
            ids = [r.id for r in chosen]
            if current in ids:
                self._first = ids.index(current) // PAGE * PAGE
        self._first = min(max(self._first, 0), max(0, (len(chosen) - 1) // PAGE * PAGE))
        page = chosen[self._first : self._first + PAGE]

        at_it = {r.id: words.CHECKING for r in page if app_state.is_validating(r.id)}
        at_it |= {r.id: words.SAVING for r in page if app_state.is_saving(r.id)}
        held = [r.id for r in records if app_state.on_hold(r)]
        now = (
            tuple((r.id, names[r.id], r.state, self._alarm(r)) for r in page),
            current,
            len(chosen),
            self._first,
            tuple(r.state for r in records),
            app_state.queue.removed,
            at_it,
            held,
        )
        if now == self._shown:
            return
        self._shown = now

        def stands(record: ObjectRecord) -> str:
            return at_it.get(record.id) or self._alarm(record) or common.STATES[record.state]

        done = sum(r.state == "accepted" for r in records)
        self._summary.content = words.progress(done, len(records))
        self._bar.value = round(100 * done / max(len(records), 1), 1)
        self._ids = [r.id for r in page]
        off = app_state.queue.removed
        put(self._back, "visible", bool(off))
        if off:
            name = app_state.store.object(off[-1]).name
            put(self._back, "label", words.restore(clipped(name, NAME_LENGTH - 4)))
        self._draw_held([i for i in held if i != current], names)
        put(self._pages, "visible", len(chosen) > PAGE)
        put(self._pages, "options", page_buttons(self._first // PAGE, -(-len(chosen) // PAGE)))
        for k, button in enumerate(self._buttons):
            if k >= len(page):
                if button.visible:
                    button.visible = False
                continue
            record = page[k]
            here = record.id == current
            button.label = common.SELECTED * here + clipped(names[record.id], NAME_LENGTH)
            button.icon = viser.Icon.ALERT_TRIANGLE if self._alarm(record) else _ICONS[record.state]
            if record.id in at_it:
                button.icon = viser.Icon.DEVICE_FLOPPY
            button.color = palette.STATE_COLORS[record.state] if here else _pale(record.state)
            if record.id in held:
                button.color = palette.SEVERITY_COLORS[Severity.WARNING]
            button.hint = f"{plain(names[record.id])}: {stands(record)}"
            button.visible = True
        title_buttons(
            self._tab.client,
            {
                button._impl.uuid: f"{names[record.id]}: {stands(record)}"
                for button, record in zip(self._buttons, page, strict=False)
            },
        )

    def _alarm(self, record: ObjectRecord) -> str:
        """The reason for attention, or ""."""
        app_state = self._app_state
        if record.id in app_state.queue.unreadable:
            return common.UNREADABLE
        if why := app_state.on_hold(record):
            return words.on_hold_because(why)
        return words.INTERRUPTED if app_state.was_interrupted(record) else ""

    def _draw_held(self, held: list[int], names: Mapping[int, str]) -> None:
        """Show the button that opens the first object on hold."""
        put(self._again, "visible", bool(held))
        if held:
            name = clipped(names[held[0]], NAME_LENGTH - 10)
            put(self._again, "label", words.on_hold(name, len(held) - 1))
            self._held = held[0]


def _pale(state: str) -> palette.Rgb:
    r, g, b = palette.STATE_COLORS[state]
    grey = 0.45
    return tuple(int(c * (1 - grey) + 120 * grey) for c in (r, g, b))  # type: ignore[return-value]
