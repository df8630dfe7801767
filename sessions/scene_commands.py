"""Decisions about a scene as a whole; see :mod:`sessions.commands`.

The objects of a scene have sessions of their own, where they are annotated, accepted and rejected;
a scene's session holds which of them are articulable, and the decisions about several at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from model.core.errors import CommandError
from sessions import review
from sessions.checks import NAME_LIMIT, PATH_LIMIT, check_count, check_pose, clean_field
from sessions.document import Decided, DecisionRecord, Document, Picked, as_record
from sessions.state import Command, Context

ID_LIMIT = 1000
MOST_OBJECTS = 100_000


@dataclass(frozen=True)
class SetArticulable(Command, kind="set_articulable", action="adjust"):
    """Decide whether an object of this scene is articulable, whatever the finder decided.

    Attributes:
        object: its id in the scene.
        articulable: None: as the finder says.
    """

    object: str
    articulable: bool | None

    def __post_init__(self) -> None:
        _check_id(self.object)

    def describe(self) -> str:
        words = {True: "is", False: "is not", None: "may be"}[self.articulable]
        return f"{self.object} {words} articulable"

    def edit(self, document: Document, context: Context) -> Document:
        if document.articulable.get(self.object) is self.articulable:
            return document
        decided = {k: v for k, v in document.articulable.items() if k != self.object}
        if self.articulable is not None:
            decided[self.object] = self.articulable
        return replace(document, articulable=decided)


@dataclass(frozen=True)
class DecideObjects(Command, kind="decide_objects", action="adjust"):
    """Accept or reject objects from the scene; undo reverts each of them.

    Attributes:
        decision: "accept" or "reject".
        objects: ids of their sessions in the workspace.
        above: the confidence, 0..1, from which all were selected; None for single ones.
        reason: why they are rejected; unused where they are accepted.
        looked: whether the person was shown their warnings.
    """

    decision: Decided
    objects: tuple[int, ...]
    above: float | None = None
    reason: review.RejectReason = "other"
    looked: bool = False

    def __post_init__(self) -> None:
        if self.decision not in ("accept", "reject"):
            raise CommandError(f"decision must be accept or reject, got {self.decision!r}")
        if self.reason not in review.REJECT_REASONS:
            raise CommandError(f"reason must be one of {', '.join(review.REJECT_REASONS)}")
        if not 0 < len(self.objects) <= MOST_OBJECTS or len(set(self.objects)) < len(self.objects):
            raise CommandError("objects must be different ones, and at least one")
        if self.above is not None and not (math.isfinite(self.above) and 0 <= self.above <= 1):
            raise CommandError(f"above must be 0..1, got {self.above}")

    def describe(self) -> str:
        count = len(self.objects)
        above = "" if self.above is None else f" above {100 * self.above:.0f} %"
        return f"{self.decision} {count} object{'s'[: count != 1]}{above}"

    def edit(self, document: Document, context: Context) -> Document:
        if context.role == "annotator":
            raise CommandError("only a reviewer may accept and reject objects")
        record = DecisionRecord(
            self.decision, self.objects, self.above, self.reason, context.who, context.at,
            self.looked,
        )  # fmt: skip
        return replace(document, decided=(*document.decided, record))


@dataclass(frozen=True)
class PickOut(
    Picked, Command, kind="pick_out", action="adjust", words="pick {name} out of {object}"
):
    """Make a piece of an object of this scene an object of its own; the rest stays."""

    def __post_init__(self) -> None:
        _check_id(self.object)
        _check_id(self.id)
        if self.object == self.id:
            raise CommandError(f"the new object needs an id of its own, not {self.id!r}")
        clean_field(self, "name", NAME_LIMIT, "the object's name")
        for field in ("path", "rest"):
            clean_field(self, field, PATH_LIMIT, "the path")
        check_count(self.count)
        check_pose(self.position, self.wxyz)
        check_pose(self.rest_position, self.rest_wxyz)

    def edit(self, document: Document, context: Context) -> Document:
        if any(p.id == self.id for p in document.picked):
            raise CommandError(f"{self.id} was picked out already")
        return replace(document, picked=(*document.picked, as_record(Picked, self)))


def _check_id(id: str) -> None:
    if not 0 < len(id) <= ID_LIMIT:
        raise CommandError(f"an object's id must have 1 to {ID_LIMIT} characters")
