"""Learns from accepted objects in a process of its own, one run at a time, and offers their parts
to objects that are like them.
"""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from app.server.acceptances import asset_folder
from app.server.job import Job
from app.server.jobs import PREVIEWS, WorkerProcess
from app.server.object_context import ObjectContext
from app.server.tool_tasks import LIKE, PROPOSE, LikeOffer, find_alike
from app.server.worker import WorkerTemplate
from app.server.workers import READING, in_background
from model.core.errors import CommandError, ConfigurationError
from model.core.progress import Progress, no_progress
from model.prediction.experience import LEAST, chosen_by_person, in_use
from sessions import commands as cmd
from sessions.command_log import open_database
from sessions.document import Document, RegionRef
from sessions.quality import seconds_in
from sessions.releases import accepted_assets
from sessions.store import ObjectRecord, Store
from sessions.tool_commands import ToolRegion

MOST = 60
"""Accepted objects that are compared: those of its category first, then the newest."""


class Likeness:
    """Similarity of an open object to the workspace's accepted ones.

    Attributes:
        offer: the parts of the one of the same shape, or parts like those of its category; None
            where there are none, or not yet.
        likely: category that is guessed for an object without one.
    """

    def __init__(self, obj: ObjectContext) -> None:
        self.offer: LikeOffer | None = None
        self.likely: str | None = None
        self._obj = obj
        self._asked: tuple[object, ...] = ()
        self._encoded: Path | None = None

    def encoded(self) -> None:
        """Look for an object like the one that was encoded."""
        self._encoded = None if self._obj.asset is None else self._obj.asset.folder
        self.update()

    def update(self) -> None:
        """Look for an object like it, as long as nobody worked on it, when it is encoded."""
        obj = self._obj
        asset, doc = obj.asset, obj.document
        if asset is None or asset.folder != self._encoded:
            return
        if not _untouched(doc):
            if "like" in obj.jobs:
                obj.jobs.cancel("like")
                self._asked = ()  # again once that work is undone
            return
        assets = self._accepted(doc)
        category = doc.category or self.likely
        asked = asset.folder, assets, category, in_use(obj.services.workspace)
        if not assets or asked == self._asked:
            return
        self._asked, self.offer = asked, None
        job = obj.lane.segmentation.submit(
            find_alike,
            asset.folder,
            obj.services.workspace,
            assets,
            category,
            priority=PREVIEWS - 1,  # after the encoding, which it needs
            preempted_by=PREVIEWS,
        )

        def keep(offer: LikeOffer | None) -> None:
            if obj.asset is asset:
                self.offer = offer

        obj.start("like", job, keep)

    @property
    def wanted(self) -> LikeOffer | None:
        """The offer, as long as nobody worked on the object."""
        return self.offer if _untouched(self._obj.document) else None

    def take(self, who: str) -> int:
        """Take the offered parts with their names, as one step; returns their number.

        Raises:
            CommandError: where nothing is offered.
        """
        offer = self.wanted
        if offer is None:
            raise CommandError("no accepted object is like this one")
        regions = tuple(
            ToolRegion(part, region.elements, True, region.count, region.name)
            for part, region in enumerate(offer.regions, start=1)
        )
        tool = f"{LIKE} {offer.folder}" if offer.folder else PROPOSE
        self._obj.do(cmd.ApplyTool(tool, regions), who)
        if offer.category and self._obj.document.category is None:
            self._obj.do(cmd.SetCategory(offer.category), who)
        return len(regions)

    def source_of_joints(self, doc: Document) -> Path | None:
        """Return the accepted asset whose parts were taken; None where it is gone."""
        for prompt in doc.prompts:
            if isinstance(prompt, RegionRef) and prompt.tool.startswith(f"{LIKE} "):
                name = prompt.tool[len(LIKE) + 1 :]
                folder = self._obj.services.workspace / "assets" / name
                # Scripts write commands, too: the name may lead nowhere else.
                inside = folder.name == name and name not in (".", "..")
                return folder if inside and folder.is_dir() else None
        return None

    def _accepted(self, doc: Document) -> tuple[Path, ...]:
        services, own = self._obj.services, self._obj.record.id
        records = [r for r in services.queue.records() if r.state == "accepted" and r.id != own]
        records.sort(key=lambda r: (r.category == (doc.category or ""), r.updated), reverse=True)
        folders = (asset_folder(services.workspace, r) for r in records[:MOST])
        return tuple(folder for folder in folders if folder.is_dir())


def _untouched(doc: Document) -> bool:
    return not doc.prompts and doc.tree is None and doc.review.state != "accepted"


def learn_from(
    workspace: Path,
    database: str | None,
    without: Sequence[str] = (),
    jobs: int = 1,
    progress: Progress = no_progress,
    *,
    automatic: bool = False,
) -> dict[str, Any]:
    """Learn from the accepted objects of a workspace, but for second annotations and those
    whose asset is gone, which are recorded as left out.

    Returns:
        The record of the version, see :class:`model.training.experience.Learned`.

    Args:
        without: names of objects that are left out. automatic: nobody asked for it.

    Raises:
        ConfigurationError: for an unknown object, or too few accepted ones.
    """
    from model.training.experience import learn  # needs torch, which the server does without

    opened, store = open_database(workspace, database), Store(workspace, database)
    try:
        broken: list[str] = []
        found = accepted_assets(store, {second.object for second in seconds_in(opened)}, broken)
    finally:
        store.close()
        opened.close()
    unknown = [name for name in without if name not in {a.name for a in found}]
    if unknown:
        raise ConfigurationError(f"no accepted object is called {', '.join(unknown)}")
    folders = [a.folder for a in found if a.name not in without]
    left_out = (*without, *broken)
    settings: dict[str, Any] = {"automatic": automatic, "jobs": jobs, "progress": progress}
    return asdict(learn(workspace, folders, left_out, **settings))


class Learning:
    """One run at a time for a server.

    Args:
        template: its process is forked from it.
    """

    def __init__(
        self, workspace: Path, database: str | None, template: WorkerTemplate | None
    ) -> None:
        self._workspace, self._database, self._template = workspace, database, template
        self._worker: WorkerProcess | None = None
        self._lock = threading.Lock()
        self._accepted: frozenset[tuple[int, str]] | None = None

    def follow(self, records: Sequence[ObjectRecord]) -> None:
        """Learn again when enough other objects are accepted, unless a person chose a version."""
        accepted = [r for r in records if r.state == "accepted"]
        now = frozenset((r.id, r.updated) for r in accepted)
        before = self._accepted
        if before is not None and self._worker is not None:
            return
        self._accepted = now
        most = max(Counter(r.category for r in accepted).values(), default=0)
        if before in (None, now) or chosen_by_person(self._workspace):
            return
        if most >= LEAST or in_use(self._workspace) is not None:
            self.start(lambda _: None, automatic=True)

    def start(
        self, done: Callable[[Job[dict[str, Any]]], None], *, automatic: bool = False
    ) -> None:
        """Begin; ``done`` gets the ended job on another thread.

        Raises:
            CommandError: where it runs already.
        """
        with self._lock:
            if self._worker is not None:
                raise CommandError("it is learning already")
            worker = self._worker = WorkerProcess(
                "learning",
                initializer=in_background,
                arguments=(READING,),
                template=self._template,
            )
        job = worker.submit(learn_from, self._workspace, self._database, automatic=automatic)

        def ended(job: Job[dict[str, Any]]) -> None:
            done(job)
            threading.Thread(target=self.close, name="learning ends").start()

        job.add_done_callback(ended)

    def close(self) -> None:
        """End it, whether it is done or not."""
        with self._lock:
            worker, self._worker = self._worker, None
        if worker is not None:
            worker.close()
