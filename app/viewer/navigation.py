"""Opening objects in a tab, and what its browser remembers."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace

from app.server.app_state import AppState
from app.server.names import display_text
from app.server.open_object import OpenObject
from app.viewer.tab import Step, Tab
from app.viewer.words import common as words
from app.viewer.words.queue import ALL_ACCEPTED, EMPTY
from app.viewer.words.review import about
from model.core.errors import ArtiworldError
from sessions import commands as cmd
from sessions.database import ObjectRecord
from sessions.people import queue_for

log = logging.getLogger(__name__)
_STORED = "artiworld"
_WAITING = ("todo", "in_progress", "rejected")


@dataclass(frozen=True)
class Memory:
    """State of a tab that its browser stores; each field is a line.

    Attributes:
        user: the name that signs decisions.
        object: id of the open object, or "".
        inside: the object of a scene that is worked on, or "".
        light: "plain" where there are no reflections.
        chosen: the selected object of a scene, or "".
        toured: "yes" once the tour was taken or skipped.
    """

    user: str = ""
    object: str = ""
    inside: str = ""
    light: str = ""
    chosen: str = ""
    toured: str = ""

    def store(self, tab: Tab) -> None:
        """Keep it in the browser."""
        lines = (self.user, self.object, self.inside, self.light, self.chosen, self.toured)
        tab.client.local_storage.set_item(_STORED, "\n".join(lines))

    @classmethod
    def load(cls, tab: Tab) -> Memory:
        """Get it from the browser; empty where that has none."""
        try:
            stored = tab.client.local_storage.get_item(_STORED, timeout=10.0)
        except (RuntimeError, TimeoutError):
            log.info("tab %s has no memory of its own", tab.client.client_id)
            return cls()
        memory = cls(*(stored or "").split("\n")[:6])
        try:
            return replace(memory, user=cmd.clean_text(memory.user, 60, "your name") or "")
        except ArtiworldError:
            return cls()


class Navigation:
    """Opens the objects of the queue or of a scene in one tab.

    Args:
        opened: gets the object that was just opened.
        remember: keeps in the browser which one that is.
    """

    def __init__(
        self,
        tab: Tab,
        app_state: AppState,
        opened: Callable[[OpenObject], None],
        remember: Callable[[], None],
    ) -> None:
        self._tab, self._app_state = tab, app_state
        self._opened, self._remember = opened, remember
        self._skipped: set[int] = set()
        self._heard: set[OpenObject] = set()
        self._unwatch: Callable[[], None] = lambda: None
        self._ahead_of: OpenObject | None = None

    def close(self) -> None:
        """End what belongs to the tab."""
        self._unwatch()
        self._app_state.presence.leave(self._tab)

    def start(self, wanted: str) -> None:
        """Open the object of that id, else the first one that isn't done."""
        records = self._app_state.queue.records()
        if not records:
            self._tab.notify(*EMPTY, "yellow")
            return
        ids = [r.id for r in records]
        if wanted.isdigit() and int(wanted) in ids:
            self.open(int(wanted))
        else:
            self.open(([r.id for r in records if r.state in _WAITING] or ids)[0])

    def open(self, object_id: int | None, *, review: bool = False) -> None:
        """Show another object, or none; for ``review`` where it has joints."""
        tab = self._tab
        if object_id is None:
            self._leave(tab.selection.object)
            self._app_state.presence.leave(tab)
            tab.selection.open(None)
            return
        self._skipped.discard(object_id)
        self._leave(tab.selection.object)
        obj = self._app_state.object(object_id, who=self._tab.user)
        joints: Step = "Review" if review else "Joints"
        with tab.selection.lock:  # its step comes with it
            tab.selection.open(obj)
            tab.selection.set_step(joints if obj.document.tree is not None else "Annotate")
        self._unwatch = obj.watch(tab.invalidate, tab.notify)
        self._app_state.presence.enter(tab, object_id, tab.account)
        self._opened(obj)
        self._remember()
        if obj.problem:
            tab.notify(words.CANNOT_OPEN, obj.problem, "red")

    def _leave(self, obj: OpenObject | None) -> None:
        self._unwatch()
        self._unwatch = lambda: None
        if (
            obj is not None
            and obj not in self._heard
            and self._app_state.is_accepting(obj.record.id)
        ):
            self._hear_out(obj)

    def _hear_out(self, obj: OpenObject) -> None:
        """Show the result of an acceptance also once another object is open."""
        tab = self._tab

        def over() -> bool:
            return not obj.validation.acceptance_waits and "save" not in obj.jobs

        def end() -> None:
            self._heard.discard(obj)
            stop()

        def tell(title: str, body: str, color: str) -> None:
            if over():
                end()
            if tab.selection.object is obj:  # its own subscription notifies
                return
            name = self._app_state.display_name(obj.record)
            text = display_text(obj.document, body).removeprefix(about(name, ""))
            tab.notify(title, about(name, text), color, elsewhere=True)

        def changed() -> None:
            tab.invalidate()
            if over() and obj.document.review.state != "accepted":
                end()  # the refusal is shown by its own callback

        self._heard.add(obj)
        stop = obj.watch(changed, tell, shows=False)

    def step(self, by: int) -> None:
        """Open the next object: first what came back to this person, then the next one of the
        queue that isn't accepted. With -1 the one before, whatever its state. Passing one skips
        it."""
        records = self._app_state.queue.records()
        obj = self._tab.selection.object
        if obj is None or not records:
            return
        ids, current = [r.id for r in records], obj.record.id
        at = ids.index(current) if current in ids else -1  # another tab took it off the list
        if by < 0:
            self.open(ids[max(at, 0) - 1])
            return
        self._skipped.add(current)
        ahead = [*records[at + 1 :], *records[: max(at, 0)]]
        following = next((r.id for r in self._returned(ahead)), None)
        if following is None:
            following = next((r.id for r in ahead if r.state != "accepted"), None)
        if following is None:
            self._tab.say(ALL_ACCEPTED)
        else:
            self.open(following)

    def _returned(self, records: list[ObjectRecord]) -> list[ObjectRecord]:
        """Objects that came back to this person and weren't passed since."""
        assigned = self._app_state.store.people.work.assigned()
        return [
            r
            for r in records
            if r.state == "rejected"
            and r.id not in self._skipped
            and assigned.get(r.id, r.assigned_to) == self._tab.user
        ]

    def remove(self) -> None:
        """Remove what can't be read from the queue, and go on with the next object."""
        ids = [r.id for r in self._app_state.queue.records()]
        current = self._tab.selection.need_object().record.id
        self._app_state.queue.remove(current)
        left = [i for i in ids if i != current]
        if left:
            self.open(left[ids.index(current) % len(left)] if current in ids else left[0])
        else:
            self.open(None)

    def go_on(self) -> None:
        """Open the next object to decide."""
        following = self._following(lease=True)
        if following is not None:
            self.open(following, review=not self._is_given)

    def look_ahead(self) -> None:
        """Read the next object to decide, once the open one has a prompt."""
        obj = self._tab.selection.object
        if obj is None or obj is self._ahead_of or obj.asset is None:
            return
        if {"open", "encode", "prepare"}.isdisjoint(obj.jobs.busy) and obj.document.prompts:
            self._ahead_of = obj
            self._tab.act(self._open_ahead)

    def _open_ahead(self) -> None:
        obj, following = self._tab.selection.object, self._following(lease=False)
        if obj is not None and following is not None:
            self._app_state.open_ahead(following, obj)

    @property
    def _is_given(self) -> bool:
        """True if the queue says what this person works on."""
        account = self._tab.account
        return account is not None and account.role == "annotator"

    def _following(self, *, lease: bool) -> int | None:
        """Id of the next object to decide; ``lease`` gives it to an annotator with an account."""
        app_state = self._app_state
        current = self._tab.selection.need_object().record
        waiting = [
            r
            for r in app_state.queue.records()
            if r.id == current.id or not app_state.is_accepting(r.id)
        ]
        account, work = self._tab.account, app_state.store.people.work
        if account is not None and self._is_given:
            others = [r for r in waiting if r.id != current.id]
            if lease:
                return work.next(account, others)
            return next(iter(queue_for(account, others, work.assigned())), None)
        again = {r.id for r in waiting if app_state.on_hold(r) or app_state.was_interrupted(r)}
        return app_state.review_order.next(waiting, current.id, self._skipped, again)
