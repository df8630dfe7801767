"""The objects of an open scene as the desk keeps them and as lists show them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import chain, count
from pathlib import Path
from typing import Any, Literal

from app.server.scene_shapes import DrawnParts
from app.server.scene_tasks import SceneItem
from model.core.errors import InputFileError
from model.scenes.assets import asset_digest
from sessions.document import Document
from sessions.live import LiveSession

Status = Literal["static", "todo", "predicted", "accepted", "rejected", "failed", "missing"]
HELD = "held back"
"""What lists call an object that was to be accepted and isn't."""
Shown = Status | Literal["judging", "held"]
"""Of what is to be accepted: the gate is at work on it, or holds it back."""
SHOWN: tuple[Shown, ...] = (
    "predicted", "held", "todo", "judging", "rejected", "accepted", "static", "failed", "missing",
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
        name: of its session, and of the object in saved files.
        reason: why it is left for the annotator, or what failed, else "".
        prepared: whether it was looked at.
        drawn: its parts as the browser shows them, or None.
        undrawn: reference of labels whose parts couldn't be drawn, else "".
    """

    id: int
    item: SceneItem
    live: LiveSession
    name: str
    ids: list[str] = field(default_factory=list)
    reason: str = ""
    prepared: bool = False
    drawn: DrawnParts | None = None
    undrawn: str = ""

    @property
    def document(self) -> Document:
        """What is decided now."""
        return self.live.state.present

    def source(self, scene: Path, workspace: Path) -> dict[str, Any]:
        """Where it comes from, for ``provenance.json``: what is worked on is a copy of the asset
        at its size in the scene, and its place in the workspace tells nobody anything.

        Args:
            scene: the scene's file.
            workspace: where the copies are.
        """
        obj, path = self.item.obj, self.item.path
        assert path is not None
        if path.is_relative_to(workspace / "scenes"):  # geometry that the scene's file holds
            path = scene
        sha256 = None
        with suppress(InputFileError):  # it went away meanwhile
            sha256 = asset_digest(path)
        return {
            "path": str(path), "sha256": sha256, "scene": str(scene), "objects": list(self.ids),
            "asset": obj.asset or self.name, "scale": obj.scale.tolist(),
        }  # fmt: skip


def names_for(items: Iterable[SceneItem], works: Iterable[Work]) -> list[str]:
    """A name for each new working copy, after its asset: another size of it is ``kettle_2``."""
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
        status: where it stands by what was decided.
        confidence: of the prediction's least sure joint; of the finder where there is none.
        mark: "judging" while an acceptance is under way, "held" where it was to be accepted and
            isn't, as it is now; else "".
    """

    id: str
    status: Status
    confidence: float
    work: int | None
    mark: Literal["", "judging", "held"] = ""

    @property
    def shown(self) -> Shown:
        """Where it stands as people see it."""
        return self.mark or self.status

    @property
    def undecided(self) -> bool:
        """Whether it waits for a person."""
        return self.mark != "judging" and self.status in ("predicted", "todo")


def drawn_by(work: Work) -> str | None:
    """The labels that the drawn parts were cut by, or None."""
    return None if work.drawn is None else work.drawn.labels


def decided_text(rows: Sequence[Row]) -> str:
    """How many of the objects that can be articulated are decided."""
    rows = [r for r in rows if r.work is not None and r.status not in ("failed", "missing")]
    rejected = sum(r.status == "rejected" for r in rows)
    decided = sum(r.status == "accepted" for r in rows) + rejected
    return f"{decided} of {len(rows)} decided" + (f"; {rejected} rejected" if rejected else "")
