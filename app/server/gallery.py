"""The queue as the page asks for it: a piece of the sorted list, and thumbnails; and the order of
review: the least confident prediction first, skipped objects last.
"""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Callable, Collection, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from threading import Lock
from typing import Any, Final

from app.server.display_tasks import draw_thumbnail
from app.server.job import Job
from app.server.names import queue_names
from app.server.object_context import Services, read_options
from app.server.tasks import ReadOptions, stamp_if_there
from model.core.memory import LruCache
from model.core.progress import attempt
from sessions.database import ObjectRecord
from sessions.document import Document

UNKNOWN = 0.5
"""Confidence of a prediction without one."""


def confidence(document: Document) -> float:
    """Return the least confidence of the moving joints, 0..1; edited joints count as 1."""
    tree, prediction = document.tree, document.prediction
    if tree is None or prediction is None:
        return UNKNOWN
    edited = set(document.edited_joints)
    values = [
        1.0 if j.child in edited else prediction.confidence.get(j.child, UNKNOWN)
        for j in tree.joints
        if j.moves
    ]
    return min(values, default=UNKNOWN)


class ReviewOrder:
    """Finds the next object to review; caches the confidences.

    Args:
        document: returns the document of an object, by its id.
    """

    def __init__(self, document: Callable[[int], Document]) -> None:
        self._document = document
        self._known: dict[int, tuple[int, float]] = {}

    def next(
        self,
        records: Sequence[ObjectRecord],
        current: int,
        skipped: Collection[int] = (),
        again: Collection[int] = (),
    ) -> int | None:
        """Return the id of the next object, or None where all others are decided.

        First those on hold, then the least confident one that was submitted, then the least
        confident predicted one, then the next unfinished one after ``current``.

        Args:
            records: the queue.
            current: id of the object that was decided.
            skipped: ids that a person skipped; they come last.
            again: ids whose acceptance is on hold or was interrupted; they come first.
        """
        ids = [r.id for r in records]
        at = ids.index(current) + 1 if current in ids else 0
        ahead = [r for r in (*records[at:], *records[:at]) if r.id != current]
        for some in (
            [r for r in ahead if r.id not in skipped],
            [r for r in ahead if r.id in skipped],
        ):
            for record in some:
                if record.id in again:
                    return record.id
            for state in ("submitted", "predicted"):
                waiting = [r for r in some if r.state == state]
                if waiting:
                    return min(waiting, key=self.confidence).id
            for record in some:
                if record.state in ("todo", "in_progress"):
                    return record.id
        return None

    def confidence(self, record: ObjectRecord) -> float:
        """The least confidence of an object's moving joints, 0..1, read once a change."""
        known = self._known.get(record.id)
        if known is None or known[0] != record.seq:
            of = attempt([], record.name, lambda: confidence(self._document(record.id)), UNKNOWN)
            known = (record.seq, of)
            self._known[record.id] = known
        return known[1]


MOST_ROWS = 200
"""In one answer."""
MOST_WAITING = 60
"""Thumbnails to draw: those that were asked for before are off the screen by now."""
DRAW_SECONDS = 120.0
"""Longest drawing of one."""
MOST_LOOKS = 200
"""Orders of lists that pages look at."""
_STATES = ("rejected", "in_progress", "todo", "predicted", "on_hold", "validating", "submitted")
"""In the order of their sorting; what is decided or static comes after them."""
SORTS: Final[tuple[str, ...]] = tuple("order name category state who confidence recent".split())


class Gallery:
    """Queue data for the page; its methods may be called on any thread.

    Args:
        confidence: returns that of a predicted object, 0..1.
        shown: gives the state of an object with what runs on it, and why it needs attention.
        exceptions: gives these of the few objects whose record doesn't say it all, by id.
    """

    def __init__(
        self,
        services: Services,
        confidence: Callable[[ObjectRecord], float],
        shown: Callable[[ObjectRecord], tuple[str, str]],
        exceptions: Callable[[], Mapping[int, tuple[str, str]]],
    ) -> None:
        self._services, self._confidence, self.shown = services, confidence, shown
        self.exceptions = exceptions
        self._lock = Lock()
        self._names: tuple[tuple[int, ...], dict[int, str]] = ((), {})
        self._drawn: dict[tuple[int, str], tuple[Any, Path | None]] = {}
        self._drawing: OrderedDict[tuple[int, str], Job[Path]] = OrderedDict()
        self._looks: LruCache[str, dict[int, int]] = LruCache(MOST_LOOKS)

    # --- the list

    def records(self) -> list[ObjectRecord]:
        """All objects, in their own order."""
        return self._services.queue.records()

    def sessions(self, ids: Sequence[int]) -> list[int]:
        """The sessions of objects; several may share one."""
        return list(ids)

    def rows(self, query: Mapping[str, str]) -> dict[str, Any]:
        """A piece of the list.

        Args:
            query: "first" and "count" of the piece; "search", "state" and "sort" of the list;
                "look" names a look at it, during which its order stays; "current" is the id of an
                object whose place is asked for; "ids" for all ids, of predictions with a
                confidence of at least "above" percent those in which the checks found nothing, and
                those that nobody checked.
        """
        records = self.records()
        names = self.names(records)
        fresh = self._chosen(records, names, query)
        chosen = self._as_looked_at(query.get("look", ""), fresh)
        if query.get("ids"):
            above = whole_number(query.get("above"), -1)
            sure = [r for r in chosen if above < 0 or 100 * (self.confidence(r) or -1) >= above]
            if above < 0:
                return {"ids": [r.id for r in sure]}
            found = {r.id: self.passed(r) for r in sure}
            names_of = ((True, "ids"), (None, "unchecked"))
            return {name: [i for i, ok in found.items() if ok is is_ok] for is_ok, name in names_of}
        first = max(whole_number(query.get("first"), 0), 0)
        count = min(max(whole_number(query.get("count"), 60), 1), MOST_ROWS)
        current = whole_number(query.get("current"), -1)
        today = datetime.now(UTC).date().isoformat()
        assigned = self._services.store.people.work.assigned()
        return {
            "total": len(chosen),
            "stale": chosen != fresh,
            "all": len(records),
            "states": Counter(r.state for r in records),
            "today": sum(r.state == "accepted" and r.updated[:10] == today for r in records),
            "at": next((i for i, r in enumerate(chosen) if r.id == current), -1),
            "rows": [
                self._row(r, names[r.id]) | {"assigned": self._assigned(r, assigned)}
                for r in chosen[first : first + count]
            ],
        }

    def _as_looked_at(self, look: str, fresh: list[ObjectRecord]) -> list[ObjectRecord]:
        """The objects in the order in which a look at them began, new ones last."""
        if not look:
            return fresh
        with self._lock:
            places = self._looks.get(look, dict)
            for record in fresh:
                places.setdefault(record.id, len(places))
            return sorted(fresh, key=lambda r: places[r.id])

    def names(self, records: Sequence[ObjectRecord]) -> dict[int, str]:
        """Id → name of all objects."""
        ids = tuple(r.id for r in records)
        if ids != self._names[0]:
            self._names = ids, queue_names(records)
        return self._names[1]

    def _chosen(
        self, records: Sequence[ObjectRecord], names: dict[int, str], query: Mapping[str, str]
    ) -> list[ObjectRecord]:
        """The objects whose name or category holds the words, in order."""
        words, state = query.get("search", "").lower().split(), query.get("state", "")
        sort = query.get("sort", "")
        found = [
            r
            for r in records
            if (not state or r.state == state)
            and all(w in self.text(r, names.get(r.id, "")).lower() for w in words)
        ]
        key = self._key(sort, names)
        return found if key is None else sorted(found, key=key, reverse=sort == "recent")

    def text(self, record: ObjectRecord, name: str) -> str:
        """The text that a search looks through."""
        return f"{name} {record.category or ''}"

    def _key(self, sort: str, names: dict[int, str]) -> Callable[[ObjectRecord], Any] | None:
        return {
            "order": lambda r: r.state != "rejected",  # what came back comes first
            "name": lambda r: names.get(r.id, "").lower(),
            "category": lambda r: (r.category is None, r.category or ""),
            "state": lambda r: (*_STATES, r.state).index(r.state),
            "who": lambda r: (not r.who, r.who),
            "confidence": lambda r: (r.state != "predicted", self.confidence(r) or 0.0),
            "recent": lambda r: r.updated,
        }.get(sort)

    def confidence(self, record: ObjectRecord) -> float | None:
        """Confidence of an undecided prediction, 0..1; None if there is none."""
        if record.state != "predicted":
            return None
        return self._confidence(record)

    def passed(self, record: ObjectRecord) -> bool | None:
        """True if the checks found nothing in the present state of an object; None where they
        haven't run."""
        for session in self.sessions([record.id]):
            seq, ok = self._services.checked.get(session, (-1, False))
            return ok if seq == record.seq else None
        return None

    def _assigned(self, record: ObjectRecord, assigned: Mapping[int, str]) -> str:
        found = [assigned[i] for i in self.sessions([record.id]) if i in assigned]
        return found[0] if found else record.assigned_to or ""

    def _row(self, record: ObjectRecord, name: str) -> dict[str, Any]:
        shown, why = self.shown(record)
        return {
            "id": record.id,
            "name": name,
            "state": record.state,
            "shown": shown,
            "why": why,
            "category": record.category or "",
            "who": record.who,
            "confidence": self.confidence(record),
        }

    # --- thumbnails

    def thumbnail(self, object_id: int) -> bytes | None:
        """The picture of an object; None while it is drawn, or where it can't be."""
        record = next((r for r in self.records() if r.id == object_id), None)
        if record is None or record.path == Path():
            return None
        key, now = (object_id, record.state), stamp_if_there(record.path)
        with self._lock:
            known, path = self._drawn.get(key, (None, None))
            if known != now:
                self._ask(key, record, now)
                return None
        try:
            return None if path is None else path.read_bytes()
        except OSError:  # the folder was cleared
            self._drawn.pop(key, None)
            return None

    def _ask(self, key: tuple[int, str], record: ObjectRecord, now: Any) -> None:
        """Have it drawn, before those that were asked for earlier."""
        if key in self._drawing:
            self._drawing.move_to_end(key)
            return
        workers = self._services.workers
        if workers.closing:
            return
        options = attempt([], f"picture of {record.name}", lambda: self._options(record), None)
        if options is None:
            self._drawn[key] = now, None
            return
        job = workers.read(
            draw_thumbnail,
            record.path,
            self._services.workspace,
            options,
            priority=-1,  # reading what somebody opens goes first
            most_seconds=DRAW_SECONDS,
        )
        self._drawing[key] = job
        job.add_done_callback(lambda job: self._ended(key, now, job))
        while len(self._drawing) > MOST_WAITING:
            self._drawing.popitem(last=False)[1].cancel()

    def _ended(self, key: tuple[int, str], now: Any, job: Job[Path]) -> None:
        with self._lock:
            self._drawing.pop(key, None)
            if job.state in ("done", "failed"):
                self._drawn[key] = now, job.result() if job.state == "done" else None

    def _options(self, record: ObjectRecord) -> ReadOptions:
        """Reading options of the object, as far as they affect its thumbnail."""
        sessions = self.sessions([record.id]) if record.seq else []
        doc = self._services.store.load(sessions[0]).present if sessions else Document()
        return read_options(self._services.config, doc)


def whole_number(text: str | None, otherwise: int) -> int:
    """The number that a page sent, or ``otherwise`` where it is none."""
    try:
        return int(text or otherwise)
    except ValueError:
        return otherwise
