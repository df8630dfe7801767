"""The objects of an open scene: their working copies, and their rows in lists."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import chain, count
from pathlib import Path
from typing import Any, Literal

from app.server.part_tasks import PartSource
from app.server.scene_shapes import DrawnParts
from app.server.scene_tasks import SceneItem
from model.core.errors import InputFileError
from model.scenes.asset_parts import asset_digest
from sessions.document import Document
from sessions.live import LiveSession

Status = Literal["static", "todo", "predicted", "accepted", "rejected", "failed", "missing"]
HELD = "on hold"
"""Label of an object whose acceptance was refused."""
Shown = Status | Literal["validating", "on_hold"]
"""A status, or of an object to be accepted: being validated, or on hold."""
SHOWN: tuple[Shown, ...] = (
    "predicted", "on_hold", "todo", "validating", "rejected", "accepted", "static", "failed",
    "missing",
)  # fmt: skip
"""In the order of a reviewer's interest."""


@dataclass(eq=False)
class Work:
    """One working copy and the objects of the scene that share it.

    Attributes:
        id: id of its session.
        item: the first object with it.
        ids: the objects in the scene.
        live: its session.
        name: name of its session, and of the object in saved files.
        reason: why it is left for the annotator, or what failed, else "".
        prepared: whether its prediction was tried.
        drawn: its parts as the browser shows them, or None.
        undrawable: reference of labels whose parts couldn't be drawn, else "".
    """

    id: int
    item: SceneItem
    live: LiveSession
    name: str
    ids: list[str] = field(default_factory=list)
    reason: str = ""
    prepared: bool = False
    drawn: DrawnParts | None = None
    undrawable: str = ""

    @property
    def document(self) -> Document:
        """The present decisions."""
        return self.live.state.present

    def part_source(self, workspace: Path) -> PartSource | None:
        """Return its parts as workers cut them; None before they are drawn."""
        if self.drawn is None:
            return None
        doc = self.document
        return PartSource(
            self.drawn.folder, workspace, self.drawn.labels, doc.part_names, doc.category,
            self.name, doc.complete,
        )  # fmt: skip

    def source(self, scene: Path, workspace: Path) -> dict[str, Any]:
        """Return its source for ``provenance.json``: the asset, not the copy in the workspace.

        Args:
            scene: the scene's file.
            workspace: folder of the copies.
        """
        obj, path = self.item.obj, self.item.path
        assert path is not None
        if path.is_relative_to(workspace / "scenes"):  # geometry inside the scene's file
            path = scene
        sha256 = None
        with suppress(InputFileError):  # the file is gone
            sha256 = asset_digest(path)
        return {
            "path": str(path), "sha256": sha256, "scene": str(scene), "objects": list(self.ids),
            "asset": obj.asset or self.name, "scale": obj.scale.tolist(),
        }  # fmt: skip


def names_for(items: Iterable[SceneItem], works: Iterable[Work]) -> list[str]:
    """Return a name for each new working copy, after its asset; another size is ``kettle_2``."""
    taken, out = {work.name for work in works}, []
    for item in items:
        stem = "object" if item.copy is None else item.copy.name.rpartition("-")[0]
        new = chain([stem], (f"{stem}_{n}" for n in count(2)))
        out.append(next(name for name in new if name not in taken))
        taken.add(out[-1])
    return out


@dataclass(frozen=True)
class Row:
    """One object as lists show it.

    Attributes:
        status: its state by the decisions.
        confidence: of the prediction's least confident joint; of the finder where there is none.
        mark: "validating" while an acceptance is under way, "on_hold" after a refusal; else "".
    """

    id: str
    status: Status
    confidence: float
    work: int | None
    mark: Literal["", "validating", "on_hold"] = ""

    @property
    def shown(self) -> Shown:
        """The state as lists show it."""
        return self.mark or self.status

    @property
    def undecided(self) -> bool:
        """True while it waits for a person's decision."""
        return self.mark != "validating" and self.status in ("predicted", "todo")


def drawn_labels(work: Work) -> str | None:
    """Return the labels of the drawn parts, or None."""
    return None if work.drawn is None else work.drawn.labels


def decided_text(rows: Sequence[Row]) -> str:
    """Return how many of the articulable objects are decided."""
    rows = [r for r in rows if r.work is not None and r.status not in ("failed", "missing")]
    rejected = sum(r.status == "rejected" for r in rows)
    decided = sum(r.status == "accepted" for r in rows) + rejected
    return f"{decided} of {len(rows)} decided" + (f"; {rejected} rejected" if rejected else "")
