"""The objects of a run, in the order they were given."""

from __future__ import annotations

import hashlib
import os
import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from app.server.observable import Listener, Observable
from app.server.tasks import stamp_if_there
from model.core.errors import CommandError
from model.core.progress import StoredWork, attempt
from model.io.model_files import asset_name, refusal
from sessions.store import ObjectRecord, Store


class ObjectQueue(Observable):
    """The queue, shared by all tabs.

    Args:
        pending: whether an object has a pending acceptance, by id.
        workspace: whose objects of earlier runs are queued, too; None for none.

    Attributes:
        unreadable: objects whose file can't be opened, or couldn't be read at the last opening.
        removed: objects of this run that were removed from the queue, the last one last.
    """

    def __init__(
        self,
        store: Store,
        paths: list[Path],
        pending: Callable[[int], bool],
        workspace: Path | None = None,
    ) -> None:
        super().__init__()
        self._store, self._pending = store, pending
        self._lock = threading.RLock()
        self._ids: list[int] = []
        self._records: dict[int, ObjectRecord] = {}
        self._workspace = workspace
        self._looked_at: set[int] = set()  # ids that were queued, or are of another run
        self.unreadable: frozenset[int] = frozenset()
        self.removed: tuple[int, ...] = ()
        self._enter(paths)
        self._take_in(store.objects())
        self._leave_out_removed()

    def records(self) -> list[ObjectRecord]:
        """Return the objects of this run, in the order they were given."""
        with self._lock:
            return [self._records[i] for i in self._ids]

    def add(self, paths: list[Path]) -> list[int]:
        """Add files or folders; returns their object ids."""
        ids = self._enter(paths)
        with self._lock:
            back = [i for i in self.removed if i in ids]
            self.removed = tuple(i for i in self.removed if i not in ids)
        if back:
            self._store.mark_restored(back)
        self.changed()
        return ids

    def _enter(self, paths: list[Path]) -> list[int]:
        records = self._store.open_objects((p, None, asset_name(p)) for p in paths)
        ids = [r.id for r in records]
        refused = {
            i
            for i, p in zip(ids, paths, strict=True)
            if attempt([], p.name, partial(refusal, p), "it can't be examined") is not None
        }
        with self._lock:
            self.unreadable |= refused
            self._ids = list(dict.fromkeys([*self._ids, *ids]))
            self._records.update({r.id: r for r in records})
        return ids

    def _take_in(self, records: list[ObjectRecord]) -> None:
        """Queue those of other runs and servers that are to be listed."""
        self._looked_at |= {r.id for r in records}
        if self._workspace is not None:
            keeps = partial(_kept, workspace=self._workspace)
            kept = [r for r in records if attempt([], r.name, partial(keeps, r), False)]
            self._enter([r.path for r in kept])

    def _leave_out_removed(self) -> None:
        """Leave out what was removed in an earlier run, unless the file changed since.

        Where that is all there is, it stays: an empty queue would explain nothing.
        """
        removed = tuple(
            i
            for i, stamp in self._store.removed_objects().items()
            if i in self._ids and stamp == _stamp(self._records[i].path)
        )
        if len(removed) < len(self._ids):
            self._ids = [i for i in self._ids if i not in removed]
            self.removed = removed

    def remove(self, object_id: int) -> None:
        """Remove an unreadable object, for later runs, too, until its file changes.

        The file and all decisions stay.

        Raises:
            CommandError: where the object can be read.
        """
        with self._lock:
            if object_id not in self.unreadable:
                raise CommandError("only unreadable objects can be removed from the queue")
            self._ids = [i for i in self._ids if i != object_id]
            self.removed = (*(i for i in self.removed if i != object_id), object_id)
        self._store.mark_removed(object_id, _stamp(self._records[object_id].path))
        self.changed()

    def restore(self) -> int:
        """Put the object that was removed last at the end of the queue; returns its id.

        Raises:
            CommandError: where nothing was removed.
        """
        with self._lock:
            if not self.removed:
                raise CommandError("nothing was removed from the queue")
            *left, object_id = self.removed
            self.removed = tuple(left)
            self._ids = [*self._ids, object_id]
        self._store.mark_restored([object_id])
        self.changed()
        return object_id

    def set_unreadable(self, object_id: int, unreadable: bool) -> None:
        """Note whether an object's file can be read."""
        with self._lock:
            before = self.unreadable
            self.unreadable = before | {object_id} if unreadable else before - {object_id}
        if self.unreadable != before:
            self.changed()

    def refresh(self, object_id: int, fields: Mapping[str, Any] | None = None) -> None:
        """Update an object's record, and notify the tabs where its state changed.

        Args:
            fields: those of the record that changed; None: it is read again.
        """
        with self._lock:
            before = self._records.get(object_id)
            if before is None or fields is None:
                record = self._store.object(object_id)
            else:
                record = replace(before, **fields)
            self._records[object_id] = record
        if before is None or before.state != record.state or self._pending(object_id):
            self.changed()

    def sync(self, last: dict[int, int], stored: StoredWork) -> None:
        """Take in what other servers did, and what was imported meanwhile.

        Args:
            last: object id → number of its last command.
            stored: keeps what fails.
        """
        new = set(last) - self._looked_at
        if new:
            self._take_in([self._store.object(i) for i in sorted(new)])
            self.changed()
        with self._lock:
            stale = [i for i in self._ids if last.get(i, 0) > self._records[i].seq]
        stored.each("queue", stale, self.refresh)

    def subscribe(self, listener: Listener) -> Callable[[], None]:
        """Call ``listener`` when a state in the queue changes. Returns its removal."""
        return self.watch(listener, lambda *_: None)


def _kept(record: ObjectRecord, workspace: Path) -> bool:
    """True if the file of an uploaded, extracted or decided object still exists."""
    folder = Path(os.path.abspath(workspace))
    if record.path.is_relative_to(folder):  # the rest there belongs to scenes
        wanted = record.path.relative_to(folder).parts[:1] in (("uploads",), ("crops",))
    else:
        wanted = record.prompts > 0 or record.state != "todo"
    return wanted and record.path.exists()


def _stamp(path: Path) -> str:
    """Return a key that changes with a file or folder."""
    return hashlib.sha256(repr(stamp_if_there(path)).encode()).hexdigest()[:16]
