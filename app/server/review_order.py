"""The order of review: the least confident prediction first, skipped objects last."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence

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
            known = (record.seq, confidence(self._document(record.id)))
            self._known[record.id] = known
        return known[1]
