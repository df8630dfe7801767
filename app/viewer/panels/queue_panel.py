"""The objects at the left, of queue or scene: progress, list or gallery, uploads, and the user."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any

import viser

from app.server.app_state import AppState
from app.server.names import clipped
from app.server.page import call_page
from app.viewer.panels.project_page import ProjectPage
from app.viewer.panels.widgets import Presses, UserName, icon, offered, put
from app.viewer.picture import palette
from app.viewer.tab import Tab
from app.viewer.words import common
from app.viewer.words import queue as words
from app.viewer.words.scene import NONE_ABOVE
from app.viewer.words.scene import TITLE as SCENE
from model.core.errors import CommandError
from model.validation.report import Severity
from sessions.accounts import Account
from sessions.scene_commands import DecideObjects

NAME_LENGTH = 22
_IN_TURN = "*"
"""Value of the list of people for all of them; no account has that name."""


class QueuePanel:
    """Panel of the queue; the page's script requests the objects that are visible.

    Attributes:
        on_hold: the button that opens the first object on hold.
        user_name: the box for the user's name.
        open: opens the object of an id.
        project: the page about all objects.
    """

    def __init__(
        self,
        tab: Tab,
        app_state: AppState,
        presses: Presses,
        open_object: Callable[[int], None],
        step: Callable[[int], None],
        remember: Callable[[], None],
        export: Callable[[list[int]], None],
        current: Callable[[], int | None],
    ) -> None:
        """Make the panel.

        Args:
            open_object: gets the id of the object that was chosen.
            current: returns the id of the chosen object.
            step: goes to the next object (1) or to the one before (-1).
            remember: is called once the user's name changed.
            export: gets the ids of objects to export.
        """
        self._tab, self._app_state, self.open = tab, app_state, open_object
        self._export, self._current = export, current
        self._shown: tuple[Any, ...] | None = None
        self._held: list[int] = []
        gui, warning = tab.client.gui, palette.SEVERITY_COLORS[Severity.WARNING]
        panel = gui.add_panel()
        title = SCENE if tab.in_scene else words.TITLE
        with panel.add_tab(title, viser.Icon.HOME if tab.in_scene else viser.Icon.LIST_DETAILS):
            self._summary = gui.add_markdown("")
            self._bar = gui.add_progress_bar(0.0, color="green")
            gui.add_html('<div id="artiworld-queue"></div>')
            self.on_hold = gui.add_button(
                "",
                icon=viser.Icon.ALERT_TRIANGLE,
                color=warning,
                visible=False,
                hint=words.ON_HOLD_HINT,
            )
            self._restore = gui.add_button(
                "", icon=viser.Icon.ARROW_BACK_UP, color="gray", visible=False
            )
            navigate = gui.add_button_group(common.NAVIGATE, common.PREVIOUS_NEXT)
            if app_state.scene is None:
                upload = gui.add_upload_button(
                    words.UPLOAD, icon=viser.Icon.UPLOAD, color="gray", hint=words.UPLOAD_HINT
                )
                upload.on_upload(lambda e: self._uploaded(e.target.value))
            self.user_name = UserName(tab, remember)
        panel.dock_left()
        panel.set_width(250)
        navigate.on_click(
            lambda e: tab.act(lambda: step(1 if e.target.value == common.PREVIOUS_NEXT[1] else -1))
        )
        self.on_hold.on_click(lambda _: tab.act(self.open_held))
        self._restore.on_click(lambda _: tab.act(lambda: open_object(app_state.queue.restore())))
        presses.on("open", lambda id: open_object(int(id)))
        presses.on("bulk", self._bulk)
        presses.on("people", lambda _: call_page(tab.client, "Queue.people", self._people()))
        self.project = ProjectPage(tab, app_state, presses, open_object)
        settings = app_state.store.project.settings
        names = offered(settings.categories, palette.CATEGORIES, settings.strict)
        page_words = _page_words(in_scene=tab.in_scene)
        call_page(tab.client, "Queue.start", page_words | {"categories": list(names)})

    def _uploaded(self, file: Any) -> None:
        add = self._app_state.add_upload
        self._tab.act(lambda: self.open(add(file.name, file.content)))

    def _bulk(self, message: str) -> None:
        """Begin what the gallery asks for about the selected objects."""
        asked = json.loads(message)
        gallery, bulk = self._app_state.gallery, self._app_state.bulk
        known = {r.id: r for r in gallery.records()}
        places = [i for i in map(int, asked["ids"]) if i in known]
        action, value, ids = asked["action"], str(asked["value"]), gallery.sessions(places)
        if action == "category":
            if not value.strip():
                raise CommandError(words.NO_CATEGORY)
            bulk.set_category(ids, value.strip(), self._tab.user, self._notify)
        elif action == "predict":
            bulk.predict(ids, self._tab.user, self._notify)
        elif action == "accept":
            least = _share(value)
            sure = [
                i
                for i in places
                if (gallery.confidence(known[i]) or -1) >= least and gallery.passed(known[i])
            ]
            self._accept(gallery.sessions(sure), least)
        elif action == "check":
            bulk.check(ids, self._notify)
        elif action == "export":
            self._export(ids)
        elif action == "assign":
            self._assign(ids, value)

    def _accept(self, ids: list[int], least: float) -> None:
        """Accept objects that have at least that confidence, 0..1; in a scene as one decision."""
        scene, user = self._app_state.scene, self._tab.user
        if not ids:
            raise CommandError(NONE_ABOVE)
        if scene is None:
            self._app_state.bulk.accept(ids, user, self._notify)
            return
        scene.do(DecideObjects("accept", tuple(ids), above=least), user, self._tab.notify)

    def _people(self) -> list[tuple[str, str]]:
        """Values and names of whom objects may be assigned to; empty for who may not do so."""
        account = self._tab.account
        if account is None or account.role != "manager":
            return []
        names = [a.name for a in self._active_accounts()]
        return [(n, n) for n in names] + [(_IN_TURN, words.IN_TURN), ("", words.NOBODY)]

    def _active_accounts(self) -> list[Account]:
        return [a for a in self._app_state.store.people.accounts.all() if a.status == "active"]

    def _assign(self, ids: list[int], to: str) -> None:
        """Assign objects to a person, to all in turn, or to nobody."""
        if to not in dict(self._people()):
            raise CommandError(words.ONLY_MANAGERS)
        chosen = [a for a in self._active_accounts() if to in (_IN_TURN, a.name)]
        self._app_state.store.people.work.assign(ids, chosen, self._tab.user)
        whom = {_IN_TURN: words.IN_TURN, "": words.NOBODY}.get(to, to)
        self._notify(words.TITLE, words.assigned(len(ids), whom), "green")
        self._app_state.queue.changed()
        call_page(self._tab.client, "Queue.changed", self._current())

    def _notify(self, title: str, text: str, color: str) -> None:
        self._tab.notify(title, text, color, elsewhere=True)

    def draw(self) -> None:
        """Bring the panel up to date; nothing is sent where nothing changed."""
        app_state, current, gallery = self._app_state, self._current(), self._app_state.gallery
        records = gallery.records()
        shown = tuple((r.id, r.state, r.category, gallery.passed(r)) for r in records)
        exceptions = gallery.exceptions()
        now = shown, exceptions, current, app_state.queue.removed, app_state.bulk.progress
        if now == self._shown:
            return
        self._shown = now
        pending = {i: s for i, (s, _) in exceptions.items() if s in words.PENDING}
        counts = Counter(pending.get(r.id, r.state) for r in records)
        today = datetime.now(UTC).date().isoformat()
        accepted = sum(r.state == "accepted" and r.updated[:10] == today for r in records)
        total = counts.total() - sum(counts[s] for s in words.UNDECIDABLE)
        held = [i for i, (state, _) in exceptions.items() if state == "on_hold"]
        put(self._summary, content=words.progress(dict(counts), accepted, len(held)))
        put(self._bar, value=round(100 * counts["accepted"] / max(total, 1), 1))
        removed = app_state.queue.removed
        put(self._restore, visible=bool(removed))
        if removed:
            name = app_state.store.object(removed[-1]).name
            put(self._restore, label=words.restore(clipped(name, NAME_LENGTH - 4)))
        self._held = [i for i in held if i != current]
        put(self.on_hold, visible=bool(self._held))
        if self._held:
            name = clipped(gallery.names(records)[self._held[0]], NAME_LENGTH - 10)
            put(self.on_hold, label=words.on_hold(name, len(self._held) - 1))
        call_page(self._tab.client, "Queue.changed", current)

    def open_held(self) -> None:
        """Open the first object on hold (Shift+Y)."""
        if self._held:
            self.open(self._held[0])
        else:
            self._tab.say(words.NONE_HELD)


def _page_words(*, in_scene: bool) -> dict[str, Any]:
    states = common.SCENE_STATES if in_scene else words.SHOWN
    colors = palette.SCENE_COLORS if in_scene else {}
    filters = palette.SCENE_COLORS if in_scene else words.STATE_ORDER
    return {
        **words.PAGE_WORDS,
        "acceptSure": str(words.accept_sure),
        "checkThem": str(words.check_them),
        "found": str(words.found),
        "because": str(words.on_hold_because),
        "states": [[s, states[s]] for s in filters],
        "sorts": list(words.SORTS.items()),
        "shown": states,
        "colors": {s: f"rgb{c}" for s, c in colors.items()},
        "icon": icon(viser.Icon.LAYOUT_GRID),
        "projectIcon": icon(viser.Icon.CHART_BAR),
    }


def _share(percent: str) -> float:
    try:
        share = float(percent) / 100
    except ValueError:
        share = -1.0
    if not 0 <= share <= 1:
        raise CommandError(words.NOT_A_SHARE)
    return share
