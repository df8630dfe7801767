"""The workers, the queue of objects and those that are open: one :class:`Workbench` a server."""

from __future__ import annotations

import hashlib
import logging
import threading
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from app.server import part_tasks, saving_tasks
from app.server.accepting import take_up
from app.server.config import ServeConfig
from app.server.jobs import Job, WorkerProcess
from app.server.observable import Listener
from app.server.open_object import OpenObject
from app.server.part_tasks import PartSource
from app.server.review_order import ReviewOrder
from app.server.tasks import stamp_if_there
from model.core.errors import CommandError
from model.core.tree import KinematicTree
from sessions.live import SessionHub
from sessions.store import Begun, ObjectRecord, Store

if TYPE_CHECKING:
    from app.server.scene_workspace import SceneDesk

log = logging.getLogger(__name__)
FOLLOW_SECONDS = 2.0
"""How often what other servers of the workspace did is taken in."""
OPEN_KEPT = 4
"""Objects that stay open though no tab shows them, so that going back to them is quick."""


class Workbench:
    """Workers, store and open objects of one server.

    Attributes:
        broken: objects whose file can't be opened whatever is in it, or couldn't be read when
            somebody last wanted to see them.
        taken_off: objects of this run that were taken off the queue, the last one last.
    """

    def __init__(self, config: ServeConfig, store: Store, paths: list[Path]) -> None:
        self.config = config
        self.store = store
        self.hub = SessionHub(store)
        self.workspace = Path(config.workspace)
        self.geometry = WorkerProcess("geometry")
        self.segmentation = WorkerProcess("segmentation")
        self.prediction = WorkerProcess("prediction")
        self.saving = WorkerProcess("saving")
        self._preparing: tuple[PartSource, KinematicTree, Job[Path]] | None = None
        self._lock = threading.RLock()
        self._open: OrderedDict[int, OpenObject] = OrderedDict()  # the one asked for last is last
        self.review_order = ReviewOrder(lambda i: store.load(i).present)
        self.desk: SceneDesk | None = None
        self._queue_listeners: list[Listener] = []
        self._ids: list[int] = []
        self._records: dict[int, ObjectRecord] = {}
        self.broken: frozenset[int] = frozenset()
        self.taken_off: tuple[int, ...] = ()
        self._enter(paths)
        self._leave_off()
        self._interrupted = take_up(self)
        self._closed = threading.Event()
        threading.Thread(target=self._follow_loop, name="follow", daemon=True).start()

    def add_paths(self, paths: list[Path]) -> list[int]:
        """Put files or folders into the queue; returns their object ids."""
        ids = self._enter(paths)
        with self._lock:
            back = [i for i in self.taken_off if i in ids]
            self.taken_off = tuple(i for i in self.taken_off if i not in ids)
        if back:
            self.store.put_back(back)
        self.tell_queue()
        return ids

    def _enter(self, paths: list[Path]) -> list[int]:
        from model.io.find_assets import asset_name, refusal

        records = self.store.open_objects((p, None, asset_name(p)) for p in paths)
        ids = [r.id for r in records]
        with self._lock:
            self.broken |= {
                r.id for r, p in zip(records, paths, strict=True) if refusal(p) is not None
            }
            self._ids = list(dict.fromkeys([*self._ids, *ids]))
            self._records.update({r.id: r for r in records})
        return ids

    def _leave_off(self) -> None:
        """Leave out what was taken off in an earlier run, but for what changed since.

        Where that is all there is, it stays: a queue without anything would tell nobody why.
        """
        off = tuple(
            i for i, stamp in self.store.taken_off().items()
            if i in self._ids and stamp == _stamp(self._records[i].path)
        )  # fmt: skip
        if len(off) < len(self._ids):
            self._ids = [i for i in self._ids if i not in off]
            self.taken_off = off

    def take_off(self, object_id: int) -> None:
        """Take what can't be read off the queue, for later runs, too, until its file changes.

        The file and all that was decided stay.

        Raises:
            CommandError: where it can be read.
        """
        with self._lock:
            if object_id not in self.broken:
                raise CommandError("only what can't be read is taken off the list")
            self._ids = [i for i in self._ids if i != object_id]
            self.taken_off = (*(i for i in self.taken_off if i != object_id), object_id)
        self.store.take_off(object_id, _stamp(self._records[object_id].path))
        self.tell_queue()

    def put_back(self) -> int:
        """Put what was taken off the queue last back to its end; its id.

        Raises:
            CommandError: where nothing was taken off.
        """
        with self._lock:
            if not self.taken_off:
                raise CommandError("nothing was taken off the list")
            *left, object_id = self.taken_off
            self.taken_off = tuple(left)
            self._ids = [*self._ids, object_id]
        self.store.put_back([object_id])
        self.tell_queue()
        return object_id

    def add_upload(self, name: str, content: bytes) -> int:
        """Keep a file that a browser sent, or what a zip holds; the first object's id.

        Raises:
            InputFileError: where nothing in it can be opened, or a zip is hostile.
        """
        from app.server.uploads import keep_upload
        from model.io.find_assets import find_assets

        most = 4 * self.config.max_upload_mb * 1_000_000
        kept = keep_upload(self.workspace / "uploads", name, content, most)
        return self.add_paths(find_assets([kept]))[0]

    def records(self) -> list[ObjectRecord]:
        """The queue: objects of this run, in the order they were given."""
        with self._lock:
            return [self._records[i] for i in self._ids]

    def object(self, object_id: int) -> OpenObject:
        """The shared view of an object; opens it on first use."""
        with self._lock:
            if object_id not in self._open:
                self._open[object_id] = OpenObject(self, self.store.object(object_id))
            opened = self._open[object_id]
            self._open.move_to_end(object_id)
            self._let_go()
        opened.come_back()
        return opened

    def _let_go(self) -> None:
        """Keep of the objects that nobody uses only those that were asked for last."""
        for i in list(self._open)[:-OPEN_KEPT]:
            if not self._open[i].in_use:
                self._open.pop(i).let_go()

    def saving_now(self, object_id: int) -> bool:
        """Whether the asset of an object is being written here, to be accepted then."""
        opened = self._open.get(object_id)
        return opened is not None and "save" in opened.jobs

    def judging_now(self, object_id: int) -> bool:
        """Whether an object is to be accepted as soon as its joints are judged here."""
        opened = self._open.get(object_id)
        return opened is not None and opened.judging.waiting

    def called(self, record: ObjectRecord) -> str:
        """What people call an object: in a scene as it is called there."""
        work = None if self.desk is None else self.desk.works.get(record.id)
        return record.name if work is None else work.item.obj.id

    def under_way(self, object_id: int) -> bool:
        """Whether an object is being accepted here: nobody need do anything about it."""
        return self.judging_now(object_id) or self.saving_now(object_id)

    def was_interrupted(self, record: ObjectRecord) -> bool:
        """Whether an acceptance of the object as it is now was begun before this server started,
        and isn't decided: its server ended, or is still at it."""
        begun = self.begun(record)
        return begun is not None and not begun.held

    def held(self, record: ObjectRecord) -> str:
        """Why the gate held back the object as it is now after a person went on, or ""."""
        begun = self.begun(record)
        return "" if begun is None or self.under_way(record.id) else begun.held

    def hold(self, object_id: int, begun: Begun) -> None:
        """Keep that an object is to be looked at again, also for later runs."""
        with self._lock:
            self.store.accepting_begins(object_id, begun)
            self._interrupted[object_id] = begun
        self.tell_queue()

    def begun(self, record: ObjectRecord) -> Begun | None:
        """What was said for an acceptance that was cut off or held back; None where there is
        none."""
        begun = self._interrupted.get(record.id)
        return begun if begun is not None and begun.seq == record.seq else None

    def on_queue(self, listener: Listener) -> Callable[[], None]:
        """Call ``listener`` when a state in the queue changes. Returns its removal."""
        self._queue_listeners.append(listener)

        def stop() -> None:
            if listener in self._queue_listeners:
                self._queue_listeners.remove(listener)

        return stop

    def queue_changed(self, object_id: int) -> None:
        """Tell all tabs that an object stands elsewhere now."""
        record = self.store.object(object_id)
        with self._lock:
            before, self._records[object_id] = self._records.get(object_id), record
        if before is None or before.state != record.state or object_id in self._interrupted:
            self.tell_queue()

    def follow(self) -> None:
        """Take in what other servers of the workspace did."""
        last = self.store.last_commands()
        self.hub.follow(last)
        with self._lock:
            stale = [i for i in self._ids if last.get(i, 0) > self._records[i].seq]
        if self._interrupted:
            begun = self.store.accepting()
            over = [i for i in self._interrupted if i not in begun]
            for object_id in over:  # by another server that was at it, or again by this one
                del self._interrupted[object_id]
            if over:
                self.tell_queue()
        for object_id in stale:
            self.queue_changed(object_id)

    def _follow_loop(self) -> None:
        while not self._closed.wait(FOLLOW_SECONDS):
            try:
                self.follow()
            except Exception:  # a thread's boundary; it is tried again
                if not self._closed.is_set():
                    log.exception("what other servers did couldn't be read")

    def note_broken(self, object_id: int, broken: bool) -> None:
        """Whether an object's file couldn't be read, for the queue."""
        with self._lock:
            before = self.broken
            self.broken = before | {object_id} if broken else before - {object_id}
        if self.broken != before:
            self.tell_queue()

    def tell_queue(self) -> None:
        """Something in the queue stands elsewhere now."""
        for listener in list(self._queue_listeners):
            listener()

    def prepare_asset(self, source: PartSource, tree: KinematicTree) -> None:
        """Write the asset that will probably be accepted next; what fails is told on accepting."""
        self.stop_preparing()
        job = self.saving.submit(saving_tasks.prepare_asset, source, tree)
        self._preparing = (source, tree, job)

    def prepare_bodies(self, source: PartSource) -> None:
        """Make collision bodies of parts while their joints are predicted: most of what the gate
        waits for doesn't depend on the joints. What is being saved goes before."""
        self.saving.submit(
            part_tasks.prepare_bodies, source, priority=-1, key="bodies", gives_way=0
        )

    def stop_preparing(self) -> None:
        """The joints changed, or something else is saved."""
        preparing, self._preparing = self._preparing, None
        if preparing is not None:
            preparing[2].cancel()

    def draft_asset(
        self,
        source: PartSource,
        tree: KinematicTree,
        on_progress: Callable[[float, str], None],
    ) -> Job[Path]:
        """Write the draft of what is accepted, or wait for the one that is being written."""
        if self._preparing is not None and self._preparing[:2] != (source, tree):
            self.stop_preparing()
        preparing, self._preparing = self._preparing, None
        if preparing is not None:
            # It is waited for: its progress is what counts, and what is looked at next doesn't
            # stop it.
            preparing[2].listen(on_progress)
        return self.saving.submit(saving_tasks.prepare_asset, source, tree, on_progress=on_progress)

    @property
    def closing(self) -> bool:
        """Whether it ends: what is under way is cut off."""
        return self._closed.is_set()

    def close(self) -> None:
        """End the workers."""
        self._closed.set()
        if self.desk is not None:
            self.desk.close()
        for worker in (self.geometry, self.segmentation, self.prediction, self.saving):
            worker.close()


def _stamp(path: Path) -> str:
    """Tells whether a file or folder changed since an object was taken off the queue."""
    return hashlib.sha256(repr(stamp_if_there(path)).encode()).hexdigest()[:16]
