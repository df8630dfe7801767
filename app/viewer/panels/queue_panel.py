"""The queue at the left: objects and their states."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import viser

from app.server.app_state import AppState
from app.server.pointer_messages import title_buttons
from app.viewer.panels.object_list import ButtonLook, Entry, ObjectList, muted
from app.viewer.panels.queue_names import clipped, queue_names
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
    """The list of objects, uploads, and the user's name.

    Attributes:
        list: the objects.
        on_hold: the button that opens the first object on hold.
        user_name: the box for the user's name.
    """

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
        self._shown: tuple[Any, ...] | None = None
        self._on_hold = 0
        gui, warning = tab.client.gui, palette.SEVERITY_COLORS[Severity.WARNING]
        panel = gui.add_panel()
        with panel.add_tab(words.TITLE, viser.Icon.LIST_DETAILS):
            self._summary = gui.add_markdown("")
            self._bar = gui.add_progress_bar(0.0, color="green")
            self.list = ObjectList(
                tab, common.STATES.values(), words.SEARCH_HINT, PAGE, open_object
            )
            self.on_hold = gui.add_button(
                "", icon=viser.Icon.ALERT_TRIANGLE, color=warning, visible=False,
                hint=words.ON_HOLD_HINT,
            )  # fmt: skip
            self._restore = gui.add_button(
                "", icon=viser.Icon.ARROW_BACK_UP, color="gray", visible=False
            )
            navigate = gui.add_button_group(common.NAVIGATE, common.PREVIOUS_NEXT)
            upload = gui.add_upload_button(
                words.UPLOAD, icon=viser.Icon.UPLOAD, color="gray", hint=words.UPLOAD_HINT
            )
            self.user_name = UserName(tab, remember)
        panel.dock_left()
        panel.set_width(230)
        navigate.on_click(
            lambda e: tab.act(lambda: step(1 if e.target.value == common.PREVIOUS_NEXT[1] else -1))
        )
        self.on_hold.on_click(lambda _: tab.act(lambda: open_object(self._on_hold)))
        self._restore.on_click(lambda _: tab.act(lambda: open_object(app_state.queue.restore())))
        upload.on_upload(lambda e: self._uploaded(e.target.value))

    def _uploaded(self, file: Any) -> None:
        add = self._app_state.add_upload
        self._tab.act(lambda: self._open_object(add(file.name, file.content)))

    def draw(self) -> None:
        """Bring the page up to date; nothing is sent where nothing changed."""
        app_state, obj = self._app_state, self._tab.selection.object
        records = app_state.queue.records()
        current = None if obj is None else obj.record.id
        names = queue_names(records)
        ids = self.list.page(
            (Entry(r.id, common.STATES[r.state], names[r.id]) for r in records), current
        )
        page = [r for r in records if r.id in ids]
        running = {r.id: words.CHECKING for r in page if app_state.is_validating(r.id)}
        running |= {r.id: words.SAVING for r in page if app_state.is_saving(r.id)}
        on_hold = [r.id for r in records if app_state.on_hold(r)]
        now = (
            tuple((r.id, names[r.id], r.state, self._alarm(r)) for r in page), current,
            self.list.place, tuple(r.state for r in records), app_state.queue.removed, running,
            on_hold,
        )  # fmt: skip
        if now == self._shown:
            return
        self._shown = now
        done = sum(r.state == "accepted" for r in records)
        put(self._summary, "content", words.progress(done, len(records)))
        put(self._bar, "value", round(100 * done / max(len(records), 1), 1))
        removed = app_state.queue.removed
        put(self._restore, "visible", bool(removed))
        if removed:
            name = app_state.store.object(removed[-1]).name
            put(self._restore, "label", words.restore(clipped(name, NAME_LENGTH - 4)))
        self._draw_on_hold([i for i in on_hold if i != current], names)
        states = {r.id: running.get(r.id) or self._alarm(r) or common.STATES[r.state] for r in page}
        self.list.draw(
            [self._look(r, names[r.id], states[r.id], r.id == current, running) for r in page]
        )
        titles = (f"{names[r.id]}: {states[r.id]}" for r in page)
        uuids = (button._impl.uuid for button in self.list.buttons)
        title_buttons(self._tab.client, dict(zip(uuids, titles, strict=False)))

    def _look(
        self, record: ObjectRecord, name: str, state: str, here: bool, running: Mapping[int, str]
    ) -> ButtonLook:
        alarm = self._alarm(record)
        icon = viser.Icon.ALERT_TRIANGLE if alarm else _ICONS[record.state]
        color = palette.STATE_COLORS[record.state]
        color = color if here else muted(color)
        if self._app_state.on_hold(record):
            color = palette.SEVERITY_COLORS[Severity.WARNING]
        return ButtonLook(
            common.SELECTED * here + clipped(name, NAME_LENGTH),
            viser.Icon.DEVICE_FLOPPY if record.id in running else icon,
            color,
            f"{plain(name)}: {state}",
        )

    def _alarm(self, record: ObjectRecord) -> str:
        """The reason for attention, or ""."""
        app_state = self._app_state
        if record.id in app_state.queue.unreadable:
            return common.UNREADABLE
        if why := app_state.on_hold(record):
            return words.on_hold_because(why)
        return words.INTERRUPTED if app_state.was_interrupted(record) else ""

    def _draw_on_hold(self, ids: list[int], names: Mapping[int, str]) -> None:
        """Show the button that opens the first object on hold."""
        put(self.on_hold, "visible", bool(ids))
        if ids:
            name = clipped(names[ids[0]], NAME_LENGTH - 10)
            put(self.on_hold, "label", words.on_hold(name, len(ids) - 1))
            self._on_hold = ids[0]
