"""Acceptances beside the decision itself: the asset's folder and its ``provenance.json``; those
that were begun and aren't decided; drafts that are written before anybody accepts.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from app.server import part_tasks
from app.server.jobs import Job, WorkerProcess
from app.server.part_tasks import PartSource
from model.core.asset import Source
from model.core.errors import CommandError, StoreError
from model.core.progress import each
from model.core.tree import KinematicTree
from model.io.assets.reader import recover
from model.validation.report import ValidationReport
from sessions import commands as cmd
from sessions.live import LiveSession, SessionHub
from sessions.provenance import provenance
from sessions.state import SessionState
from sessions.store import Entry, ObjectRecord, PendingAcceptance, Store, now


def carry_out(
    live: LiveSession,
    asked: SessionState,
    command: cmd.Accept,
    who: str,
    draft: Path,
    record: dict[str, Any],
) -> str:
    """Let a draft take its place and accept the object, or neither; returns the asset's folder.

    Args:
        asked: the state that the decision was made for.
        record: the content of ``provenance.json``.

    Raises:
        CommandError: where the object moved on since.
        StoreError: where the storage doesn't take the asset.
    """
    if moved := live.moved_since(asked):
        raise CommandError(moved)
    at = record["review"]["at"] = now()
    folder = asset_folder(live.store.workspace, live.store.object(live.object_id))
    try:
        written = str(live.store.assets.publish(draft, folder, record))
        accepted = live.do(command, who, since=asked, at=at)
    except BaseException:
        live.settle()
        raise
    with suppress(CommandError):  # it is decided again already
        live.do(cmd.Saved(written), who, since=accepted)
    return written


def acceptance_record(
    after: SessionState,
    history: list[Entry],
    source: Source,
    report: ValidationReport | None,
    override: str = "",
    *,
    warnings_seen: bool = False,
    scene: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return the content of an accepted asset's ``provenance.json``, validation included.

    Args:
        override: reason for accepting it despite errors, else "".
        warnings_seen: whether the person had been shown the warnings.
        scene: source of an object that was annotated in a scene.
    """
    record = provenance(after, history, source)
    record["source"].update(scene or {})
    decision = {"override": override, "looked_at": warnings_seen}
    record["gate"] = None if report is None else {**report.to_json(), **decision}
    return record


def asset_folder(workspace: Path, record: ObjectRecord) -> Path:
    """Return the folder of an object's accepted asset."""
    return workspace / "assets" / record.asset_name


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
        self._over: set[int] = set()  # not stored yet
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
        self._over.discard(object_id)

    def end(self, object_id: int) -> None:
        """Store that the acceptance ended, decided or not; later, where there is no room now."""
        self._over.add(object_id)
        try:
            self._store.end_acceptance(object_id)
            self._over.discard(object_id)
        except StoreError as error:
            log.warning("the end of an acceptance can't be stored yet: %s", error)
        if self._pending.pop(object_id, None) is not None:
            self._notify()

    def is_over(self, object_id: int) -> bool:
        """True unless an acceptance of the object is under way."""
        return object_id in self._over or object_id not in self._store.pending_acceptances()

    def hold(self, object_id: int, pending: PendingAcceptance) -> None:
        """Put an acceptance on hold, also for later runs."""
        with self._lock:
            self.begin(object_id, pending)
            self._pending[object_id] = pending
        self._notify()

    def sync(self) -> None:
        """Drop what ended, here or in another server."""
        for object_id in tuple(self._over):
            self.end(object_id)
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
    every = store.pending_acceptances()

    def resume(object_id: int) -> None:
        pending = every[object_id]
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
                    "another server is at it",
                    record.name,
                )
            return
        doc = live.document
        if doc.review.state == "accepted" and doc.saved is None and folder.is_dir():
            live.do(cmd.Saved(str(folder)), doc.review.by)
        store.end_acceptance(object_id)

    each(every, resume, lambda object_id, _: waiting.setdefault(object_id, every[object_id]))
    return waiting


class AssetDrafts:
    """Writes the asset that will probably be accepted next."""

    def __init__(self, worker: WorkerProcess) -> None:
        self._worker = worker
        self._preparing: tuple[PartSource, KinematicTree, Job[Path]] | None = None

    def prepare(self, source: PartSource, tree: KinematicTree) -> None:
        """Start writing a draft; a failure is reported when it is accepted."""
        self.stop()
        job = self._worker.submit(part_tasks.prepare_asset, source, tree)
        self._preparing = (source, tree, job)

    def prepare_bodies(self, source: PartSource) -> None:
        """Compute the parts' collision shapes while their joints are predicted.

        Most of the time of a validation goes into them, and they don't depend on the joints.
        Saving comes first.
        """
        self._worker.submit(
            part_tasks.prepare_bodies, source, priority=-1, key="bodies", preempted_by=0
        )

    def stop(self) -> None:
        """Cancel the draft under way: the joints changed, or something else is saved."""
        preparing, self._preparing = self._preparing, None
        if preparing is not None:
            preparing[2].cancel()

    def finish(
        self, source: PartSource, tree: KinematicTree, on_progress: Callable[[float, str], None]
    ) -> Job[Path]:
        """Return the job that writes the draft to accept, after the one under way for it."""
        if self._preparing is not None and self._preparing[:2] != (source, tree):
            self.stop()
        preparing, self._preparing = self._preparing, None
        if preparing is not None:
            # No longer cancelled by `stop`; the job below waits for it, so its progress counts.
            preparing[2].listen(on_progress)
        return self._worker.submit(part_tasks.prepare_asset, source, tree, on_progress=on_progress)
