"""Acceptances that were begun and aren't decided: cut off with their server, or on hold."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from pathlib import Path

from app.server.acceptance_record import asset_folder
from model.io.assets.reader import recover
from sessions import commands as cmd
from sessions.live import SessionHub
from sessions.store import ObjectRecord, PendingAcceptance, Store

log = logging.getLogger(__name__)


class PendingAcceptances:
    """The pending acceptances of earlier servers, and those that validation put on hold.

    Args:
        notify: called when one is added or ends.
    """

    def __init__(
        self, store: Store, hub: SessionHub, workspace: Path, notify: Callable[[], None]
    ) -> None:
        self._store, self._notify = store, notify
        self._lock = threading.RLock()
        self._pending = _resume(store, hub, workspace)

    def __contains__(self, object_id: int) -> bool:
        return object_id in self._pending

    @property
    def ids(self) -> list[int]:
        """Ids of objects that have or had one."""
        return list(self._pending)

    def of(self, record: ObjectRecord) -> PendingAcceptance | None:
        """Return the pending acceptance of an object, unless the object changed since."""
        pending = self._pending.get(record.id)
        return pending if pending is not None and pending.seq == record.seq else None

    def begin(self, object_id: int, pending: PendingAcceptance) -> None:
        """Store that an acceptance begins, for the case that this server dies."""
        self._store.begin_acceptance(object_id, pending)

    def end(self, object_id: int) -> None:
        """Store that the acceptance ended, decided or not."""
        self._store.end_acceptance(object_id)

    def hold(self, object_id: int, pending: PendingAcceptance) -> None:
        """Put an acceptance on hold, also for later runs."""
        with self._lock:
            self.begin(object_id, pending)
            self._pending[object_id] = pending
        self._notify()

    def sync(self) -> None:
        """Drop what ended, here or in another server."""
        if not self._pending:
            return
        stored = self._store.pending_acceptances()
        over = [i for i in self._pending if i not in stored]
        for object_id in over:
            del self._pending[object_id]
        if over:
            self._notify()


def _resume(store: Store, hub: SessionHub, workspace: Path) -> dict[int, PendingAcceptance]:
    """Finish the acceptances of a dead server that were decided; return those that weren't.

    The latter need a person: what validation reported and showed is lost. They are pending until
    the object's next command.
    """
    waiting: dict[int, PendingAcceptance] = {}
    for object_id, pending in store.pending_acceptances().items():
        record = store.object(object_id)
        folder = asset_folder(workspace, record)
        recover(folder)
        live = hub.session(object_id)
        live.settle()
        if record.seq == pending.seq:
            waiting[object_id] = pending
            if not pending.hold_reason:
                log.warning(
                    "%s: its acceptance was begun and not finished; accept it again, unless "
                    "another server is at it", record.name,
                )  # fmt: skip
            continue
        doc = live.document
        if doc.review.state == "accepted" and doc.saved is None and folder.is_dir():
            live.do(cmd.Saved(str(folder)), doc.review.by)
        store.end_acceptance(object_id)
    return waiting
