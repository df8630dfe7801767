"""Decisions about a scene as a whole; see :mod:`sessions.commands`.

The objects of a scene have sessions of their own, where they are annotated, accepted and rejected;
a scene's session holds which of them are articulable, and the decisions about several at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from model.core.errors import CommandError
from sessions.checks import NAME_LIMIT, PATH_LIMIT, check_count, check_pose, clean_text, put_field
from sessions.review import REJECT_REASONS, RejectReason

ID_LIMIT = 1000
MOST_OBJECTS = 100_000

Decided = Literal["accept", "reject"]
Position = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


@dataclass(frozen=True)
class SetArticulable:
    """Decide whether an object of this scene is articulable, whatever the finder decided.

    Attributes:
        object: its id in the scene.
        articulable: None: as the finder says.
    """

    object: str
    articulable: bool | None

    def __post_init__(self) -> None:
        if not 0 < len(self.object) <= ID_LIMIT:
            raise CommandError(f"an object's id must have 1 to {ID_LIMIT} characters")


@dataclass(frozen=True)
class DecideObjects:
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
    reason: RejectReason = "other"
    looked: bool = False

    def __post_init__(self) -> None:
        if self.decision not in ("accept", "reject"):
            raise CommandError(f"decision must be accept or reject, got {self.decision!r}")
        if self.reason not in REJECT_REASONS:
            raise CommandError(f"reason must be one of {', '.join(REJECT_REASONS)}")
        if not 0 < len(self.objects) <= MOST_OBJECTS or len(set(self.objects)) < len(self.objects):
            raise CommandError("objects must be different ones, and at least one")
        if self.above is not None and not (math.isfinite(self.above) and 0 <= self.above <= 1):
            raise CommandError(f"above must be 0..1, got {self.above}")


@dataclass(frozen=True)
class PickOut:
    """Make a piece of an object of this scene an object of its own; the rest stays.

    Attributes:
        object: the object's id in the scene.
        id: of the new object, which no other has.
        name: display name.
        path: file of the new object.
        rest: file of the rest of the old one.
        count: elements of the new one, for display.
        position, wxyz: pose of the new file's origin in the scene; metres, a unit quaternion.
        rest_position, rest_wxyz: of the rest's.
    """

    object: str
    id: str
    name: str
    path: str
    rest: str
    count: int
    position: Position
    wxyz: Quaternion
    rest_position: Position
    rest_wxyz: Quaternion

    def __post_init__(self) -> None:
        for id in (self.object, self.id):
            if not 0 < len(id) <= ID_LIMIT:
                raise CommandError(f"an object's id must have 1 to {ID_LIMIT} characters")
        if self.object == self.id:
            raise CommandError(f"the new object needs an id of its own, not {self.id!r}")
        put_field(self, "name", clean_text(self.name, NAME_LIMIT, "the object's name"))
        for field in ("path", "rest"):
            put_field(self, field, clean_text(getattr(self, field), PATH_LIMIT, "the path"))
        check_count(self.count)
        check_pose(self.position, self.wxyz)
        check_pose(self.rest_position, self.rest_wxyz)
