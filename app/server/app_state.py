"""The state of one server that all tabs share: the queue, the open objects, the scene, and who has
which object open, in this server's tabs and in those of others.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Hashable, Iterable
from pathlib import Path
from typing import BinaryIO

from app.server.acceptances import AssetDrafts, PendingAcceptances
from app.server.bulk import BulkWork
from app.server.config import ServeConfig
from app.server.ending import WorkspaceLease
from app.server.export_tasks import DOWNLOAD_BYTES
from app.server.gallery import Gallery, ReviewOrder
from app.server.learning import Learning
from app.server.network import Room
from app.server.object_context import Services
from app.server.object_queue import ObjectQueue
from app.server.open_object import OpenObject
from app.server.scene_workspace import SceneGallery, SceneWorkspace
from app.server.uploads import keep_upload
from app.server.workers import Workers
from model.core.progress import StoredWork
from model.io.model_files import find_assets
from model.prediction import DEFAULT
from sessions.accounts import Account
from sessions.live import LiveSession, SessionHub
from sessions.people import HEARTBEAT_SECONDS, Work
from sessions.store import ObjectRecord, Store


class PresenceBoard:
    """Keeps presence alive for the tabs of this server, and tells objects who else is there.

    Args:
        work: of the workspace.
        stored: keeps what fails.
    """

    def __init__(self, work: Work, stored: StoredWork) -> None:
        self._work, self._stored = work, stored
        self._lock = threading.Lock()
        self._here: dict[Hashable, tuple[int, Account]] = {}
        self._said = -HEARTBEAT_SECONDS

    def enter(self, tab: Hashable, object_id: int, account: Account | None) -> None:
        """Note that a tab shows an object, and no longer the one before."""
        self.leave(tab)
        if account is None:
            return
        with self._lock:
            self._here[tab] = object_id, account
        self._work.enter(object_id, account)

    def leave(self, tab: Hashable) -> None:
        """Note that a tab shows no object; a lease ends with the person's last tab."""
        with self._lock:
            left = self._here.pop(tab, None)
            gone = left is not None and left not in self._here.values()
        if left is not None and gone:
            self._work.leave(*left)

    def sync(self, shown: Iterable[OpenObject]) -> None:
        """Say again who is here, and bring ``present`` of the objects up to date."""
        with self._lock:
            here = set(self._here.values())
        if not here:
            return
        now = time.monotonic()
        if now - self._said >= HEARTBEAT_SECONDS:
            self._said = now
            self._stored.each("presence", here, lambda one: self._work.enter(*one))

        of_id = {obj.record.id: obj for obj in shown}

        def show(object_id: int) -> None:
            obj = of_id[object_id]
            present = tuple(self._work.present(obj.record.id))
            if present != obj.present:
                obj.present = present
                obj.changed()

        self._stored.each("who is there", of_id, show)


log = logging.getLogger(__name__)
SYNC_SECONDS = 2.0
"""Period of taking in what other servers of the workspace did."""
RECENT_SESSIONS = 64
"""Sessions that scripts used last, which needn't be loaded again: a few per person."""
OPEN_KEPT = 4
"""Objects that stay open though no tab shows them, so that going back to them is quick."""


class AppState:
    """Workers, store, queue and open objects of one server.

    Attributes:
        scene: the open scene; None where single objects are open.
        gallery: what the page shows of the queue.
        stored: work for stored items that failed.
        bulk: work on many objects.
        learning: from accepted objects.
        presence: who has which object open.
        room: for what is uploaded and downloaded.
    """

    def __init__(self, config: ServeConfig, store: Store, paths: list[Path]) -> None:
        self.config, self.store = config, store
        self._lease = WorkspaceLease(store.workspace)
        self.room = Room(2 * max(config.max_upload_mb * 1_000_000, DOWNLOAD_BYTES))
        self.hub = SessionHub(store)
        self.workers = Workers()
        self.acceptances = PendingAcceptances(
            store, self.hub, Path(config.workspace), self._queue_changed
        )
        self.queue = ObjectQueue(
            store,
            paths,
            self.acceptances.__contains__,
            None if config.scene is not None else Path(config.workspace),
        )
        self.scene: SceneWorkspace | None = None
        self.stored = StoredWork()
        self.review_order = ReviewOrder(lambda i: store.load(i).present)
        self._recent: deque[LiveSession] = deque(maxlen=RECENT_SESSIONS)
        self._services = Services(
            config,
            store,
            self.hub,
            self.workers,
            AssetDrafts(self.workers.saving),
            self.queue,
            self.acceptances,
        )
        self._lock = threading.RLock()
        self._open: OrderedDict[int, OpenObject] = OrderedDict()  # the one used last is last
        self._closed = threading.Event()
        self.gallery = Gallery(
            self._services, self.review_order.confidence, self.shown_state, self._exceptions
        )
        self.bulk = BulkWork(self._services, self.object)
        self.learning = Learning(self.workspace, config.database, self.workers.template)
        self.presence = PresenceBoard(store.people.work, self.stored)
        threading.Thread(target=self._sync_loop, name="sync", daemon=True).start()

    @property
    def workspace(self) -> Path:
        """Folder of sessions, working copies and accepted assets."""
        return self._services.workspace

    def open_scene(
        self, path: Path, folders: tuple[Path, ...], format: str | None = None
    ) -> SceneWorkspace:
        """Open a scene with the assets in ``folders``; it is read in the background."""
        self.scene = SceneWorkspace(self._services, path, folders, format)
        self.gallery = SceneGallery(self.scene)
        return self.scene

    def _queue_changed(self) -> None:
        self.queue.changed()

    def add_upload(self, name: str, content: bytes | BinaryIO) -> int:
        """Add an uploaded file, or the content of a zip; returns the first object's id.

        Raises:
            InputFileError: where nothing in it can be opened, or a zip is hostile.
        """
        max_bytes = 4 * self.config.max_upload_mb * 1_000_000
        kept = keep_upload(self.workspace / "uploads", name, content, max_bytes)
        return self.queue.add(find_assets([kept]))[0]

    def object(self, object_id: int, keep: float = 0.0, who: str = "") -> OpenObject:
        """Return the shared view of an object; opens it on first use.

        Args:
            keep: seconds for which it stays in use from now on, where no tab shows it.
            who: the person that opens it.
        """
        with self._lock:
            opened = self._known(object_id)
            if opened is None:
                opened = OpenObject(self.store.object(object_id), self._services)
            self._open[object_id] = opened
            opened.asked_by = who or opened.asked_by
            opened.kept_until = max(opened.kept_until, time.monotonic() + keep)
            self._open.move_to_end(object_id)
            self._release_unused()
        opened.reopen()
        return opened

    def open_ahead(self, object_id: int, beside: OpenObject) -> None:
        """Read an object that a person opens next, by the processes of the one they work on."""
        with self._lock:
            if object_id in self._open:
                return
            opened = self._open[object_id] = OpenObject(
                self.store.object(object_id), self._services
            )
            self._open.move_to_end(object_id, last=False)
        self.workers.lanes.share(opened, beside.lane)
        opened.ensure_open()

    def session(self, object_id: int) -> LiveSession:
        """Return an object's session without reading its asset, and keep it for a while."""
        session = self.hub.session(object_id)
        self._recent.append(session)
        return session

    def _release_unused(self) -> None:
        """Release unused objects, except those that were used last."""
        for i in list(self._open)[:-OPEN_KEPT]:
            if not self._open[i].in_use:
                self._open.pop(i).release()

    def _known(self, object_id: int) -> OpenObject | None:
        """Return an object that was opened, or belongs to the scene."""
        in_scene = None if self.scene is None else self.scene.works.get(object_id)
        return self._open.get(object_id, in_scene)

    def display_name(self, record: ObjectRecord) -> str:
        """Return an object's name; in a scene the one it has there."""
        opened = self._known(record.id)
        return record.name if opened is None else opened.display_name

    def is_predicting(self, object_id: int) -> bool:
        """True while the joints of an object are predicted here."""
        opened = self._known(object_id)
        return opened is not None and "predict" in opened.jobs

    def is_accepting(self, object_id: int) -> bool:
        """True while an object is being accepted here."""
        opened = self._known(object_id)
        return opened is not None and opened.being_accepted

    def was_interrupted(self, record: ObjectRecord) -> bool:
        """True if an acceptance of the present object began before this server started and is
        undecided: its server ended, or still works on it."""
        pending = self.acceptances.of(record)
        return pending is not None and not pending.hold_reason

    def on_hold(self, record: ObjectRecord) -> str:
        """Why validation put the acceptance of the present object on hold after the person went
        on, or ""."""
        pending = self.acceptances.of(record)
        return "" if pending is None or self.is_accepting(record.id) else pending.hold_reason

    def shown_state(self, record: ObjectRecord) -> tuple[str, str]:
        """Return an object's state or what runs on it, and why it needs attention, or ""."""
        held, opened = self.on_hold(record), self._open.get(record.id)
        if record.id in self.queue.unreadable:
            return "unreadable", held
        if opened is not None:
            return opened.shown_state, held
        if held:
            return "on_hold", held
        return ("interrupted" if self.was_interrupted(record) else record.state), ""

    def _exceptions(self) -> dict[int, tuple[str, str]]:
        """Return the shown states of the few objects whose record doesn't say it all."""
        few = {*self.queue.unreadable, *self.acceptances.ids, *list(self._open)}
        return {r.id: self.shown_state(r) for r in self.queue.records() if r.id in few}

    def sync_remote(self) -> None:
        """Take in what other servers of the workspace did."""
        last = self.store.last_commands()
        behind = self.hub.behind(last)
        self.stored.each("commands of others", behind, lambda i: self.hub.session(i).refresh())
        self.acceptances.sync()
        self.queue.sync(last, self.stored)
        if self.config.predictor == DEFAULT:
            self.learning.follow(self.queue.records())
        if self.store.project.refresh():
            self.queue.changed()
        self.presence.sync([obj for obj in list(self._open.values()) if obj.is_shown])

    def _sync_loop(self) -> None:
        while not self._closed.wait(SYNC_SECONDS):
            try:
                self.sync_remote()
            except Exception:  # a thread's boundary; it is tried again
                if not self._closed.is_set():
                    log.exception("reading the commands of other servers failed")

    def close(self) -> None:
        """End the workers."""
        self._closed.set()
        self.workers.closing = True
        self.hub.store_announced()
        self.bulk.cancel()
        self.learning.close()
        if self.scene is not None:
            self.scene.close()
        self.workers.close()
        self._lease.close()
