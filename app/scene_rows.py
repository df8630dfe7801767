"""The objects of an open scene as the desk keeps them and as lists show them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from app.scene_shapes import DrawnParts
from app.scene_tasks import SceneItem
from sessions.document import Document
from sessions.live import LiveSession

Status = Literal["static", "todo", "predicted", "accepted", "rejected", "failed", "missing"]
STATUSES: tuple[Status, ...] = (
    "predicted", "todo", "rejected", "accepted", "static", "failed", "missing",
)  # fmt: skip
"""In the order in which a reviewer wants to see them."""


@dataclass(eq=False)
class Work:
    """One working copy and all the objects that it stands for.

    Attributes:
        id: of its session.
        item: the first object with it.
        ids: of the objects in the scene.
        live: its session.
        reason: why it is left for the annotator, or what failed, else "".
        prepared: whether it was looked at.
        drawn: its parts as the browser shows them, or None.
        undrawn: reference of labels whose parts couldn't be drawn, else "".
    """

    id: int
    item: SceneItem
    live: LiveSession
    ids: list[str] = field(default_factory=list)
    reason: str = ""
    prepared: bool = False
    drawn: DrawnParts | None = None
    undrawn: str = ""

    @property
    def document(self) -> Document:
        """What is decided now."""
        return self.live.state.present


@dataclass(frozen=True)
class Row:
    """One object as lists show it.

    Attributes:
        confidence: of the prediction's least sure joint; of the finder where there is none.
        refused: whether it was to be accepted, and the gate calls it broken as it is.
    """

    id: str
    status: Status
    confidence: float
    work: int | None
    refused: bool = False


def drawn_by(work: Work) -> str | None:
    """The labels that the drawn parts were cut by, or None."""
    return None if work.drawn is None else work.drawn.labels
