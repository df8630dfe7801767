"""State of an open scene: its objects, their displayed assets, their working copies."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from app.server.job import Job
from app.server.observable import Observable
from app.server.running_jobs import RunningJobs
from app.server.scene_rows import Work
from app.server.scene_shapes import Shape
from app.server.scene_tasks import OpenedScene, SceneItem
from app.server.services import Services
from sessions.document import Document


class SceneState(Observable):
    """The scene as its saving, accepting and picking see it.

    Attributes:
        scene: None until it is read.
        read: the objects of the scene's file.
        items: id → object, those that were picked out of others among them.
        shapes: asset → its geometry as drawn, or why there is none.
        works: session id → working copy.
    """

    def __init__(self, services: Services, path: Path) -> None:
        super().__init__()
        self.services = services
        self.path = path
        self.record = services.store.open_object(path, None, path.stem)
        self.live = services.hub.session(self.record.id)
        self.scene: OpenedScene | None = None
        self.read: tuple[SceneItem, ...] = ()
        self.items: dict[str, SceneItem] = {}
        self.shapes: dict[Path, Shape | str] = {}
        self.works: dict[int, Work] = {}
        self.jobs = RunningJobs("the scene", self.changed)
        self._work_of: dict[Path, Work] = {}

    @property
    def document(self) -> Document:
        """The present decisions about the scene."""
        return self.live.state.present

    def articulable(self, item: SceneItem) -> bool:
        """True if the object is to be articulated, by a person's decision, else by the finder's."""
        decided = self.document.articulable.get(item.obj.id)
        return item.decision.articulable if decided is None else decided

    def work(self, id: str) -> Work | None:
        """Return the working copy of an object; None where it isn't articulated."""
        item = self.items.get(id)
        if item is None or item.copy is None or not self.articulable(item):
            return None
        return self._work_of.get(item.copy)

    def wanted(self) -> Iterable[Work]:
        """Return the working copies of the articulable objects, in the scene's order."""
        return [w for w in self.works.values() if any(self.work(i) is w for i in w.ids)]

    def twins(self, id: str) -> list[str]:
        """Return the objects that share a decision with ``id``: same asset and size; itself too."""
        work = self.work(id)
        if work is None:
            return [id]
        return [i for i in work.ids if self.articulable(self.items[i])]

    def missing_reason(self, item: SceneItem) -> str:
        """Return why an object isn't shown, or ""."""
        if item.obj.box is not None:
            return ""
        if item.problem:
            return item.problem
        if item.path is None:
            named = item.obj.asset
            return f"asset {named!r} is in none of the folders" if named else "it names no asset"
        shape = self.shapes.get(item.path)
        return shape if isinstance(shape, str) else ""

    def world_from_copy(self, item: SceneItem) -> npt.NDArray[np.float64] | None:
        """Return the (4, 4) pose of the working copy at its size; None before it is drawn."""
        shape = None if item.path is None else self.shapes.get(item.path)
        if not isinstance(shape, Shape):
            return None
        return item.obj.placed(shape.bounds).world_from_asset

    def start(
        self,
        kind: str,
        job: Any,
        keep: Callable[[Any], None],
        progress: tuple[float, str] = (0.0, ""),
        work: Work | None = None,
        files: Sequence[Path] = (),
    ) -> None:
        """Follow a job; ``keep`` gets its result. Failures are shown, and written into ``work``.

        Args:
            files: what it reads, one after the other: the one that it doesn't come to the end of
                is named.
        """
        self.jobs.add(
            kind, job, lambda ended: self._ended(kind, ended, keep, work, files), progress
        )

    def _ended(
        self, kind: str, job: Job[Any], keep: Callable[[Any], None], work: Work | None,
        files: Sequence[Path],
    ) -> None:  # fmt: skip
        raise NotImplementedError
