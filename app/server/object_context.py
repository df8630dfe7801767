"""Surroundings of an open object: the server's services, and what it shares with its segmentation
and its validation.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from app.server.acceptances import AssetDrafts, PendingAcceptances
from app.server.config import ServeConfig
from app.server.display_tasks import OpenedAsset
from app.server.job import Job
from app.server.object_queue import ObjectQueue
from app.server.observable import Observable, RunningJobs
from app.server.part_tasks import PartSource, source_of
from app.server.tasks import ReadOptions
from app.server.workers import Lane, Workers
from model.core.asset import Source
from model.core.errors import CommandError
from model.prediction import DEFAULT
from model.prediction.experience import in_use
from model.segmentation.prompts import BASE
from sessions import command_log
from sessions import commands as cmd
from sessions.document import Document
from sessions.live import LiveSession, SessionHub
from sessions.state import SessionState
from sessions.store import ObjectRecord, Store


@dataclass(frozen=True, eq=False)
class Services:
    """Settings, store, workers and queue of one server.

    Attributes:
        checked: object id → number of the state that was checked last, and whether nothing was
            found.
    """

    config: ServeConfig
    store: Store
    hub: SessionHub
    workers: Workers
    drafts: AssetDrafts
    queue: ObjectQueue
    acceptances: PendingAcceptances
    checked: dict[int, tuple[int, bool]] = field(default_factory=dict)

    @property
    def workspace(self) -> Path:
        """Folder of sessions, working copies and accepted assets."""
        return Path(self.config.workspace)

    @property
    def predictor(self) -> str:
        """Name of the predictor: the default one knows what the workspace has learned."""
        name = self.config.predictor
        learned = in_use(self.workspace.resolve()) if name == DEFAULT else None
        return name if learned is None else f"learned:{learned}"


def read_options(config: ServeConfig, doc: Document) -> ReadOptions:
    """Options for reading the source of a document as that has it."""
    return ReadOptions(
        doc.up_axis or config.up_axis,
        doc.unit_scale * config.unit_scale,
        None if doc.left_out is None else doc.left_out.elements,
        doc.face_cuts,
        doc.frame,
    )


class ObjectContext(Observable):
    """An object's session, its asset once it is read, and the jobs under way.

    Attributes:
        live: the session with all commands.
        asset: None until it is read.
        jobs: the jobs under way, by their kind.
        lane: the processes that answer clicks on it.
    """

    def __init__(self, record: ObjectRecord, services: Services) -> None:
        super().__init__()
        self.services = services
        self.record = record
        self.live: LiveSession = services.hub.session(record.id)
        self.asset: OpenedAsset | None = None
        self.lane: Lane = services.workers.lanes.first
        self.jobs = RunningJobs(f"object {record.id}", self.changed, self._record_job)
        self._lock = threading.RLock()
        self._stored: tuple[str, npt.NDArray[np.integer]] | None = None

    @property
    def state(self) -> SessionState:
        """The session's state."""
        return self.live.state

    @property
    def document(self) -> Document:
        """The present decisions."""
        return self.live.state.present

    def do(self, command: cmd.Command, who: str) -> SessionState:
        """Carry out one user decision; it is on disk when this returns."""
        return self.live.do(command, who)

    def read_options(self, doc: Document) -> ReadOptions:
        """Options for reading the source as a document has it."""
        return read_options(self.services.config, doc)

    def need_asset(self) -> OpenedAsset:
        """Return the asset.

        Raises:
            CommandError: where it is still being read.
        """
        if self.asset is None:
            raise CommandError("the object is still being read")
        return self.asset

    def read_source(self, document: Document) -> tuple[Path, Source] | None:
        """Return the folder of the asset's arrays and its source, once the document's parts can be
        cut."""
        asset = self.asset
        ready = asset is not None and document.segmentation is not None
        return (asset.folder, asset.source) if asset is not None and ready else None

    def source(self, document: Document | None = None) -> PartSource:
        """Return the parts of the document as the workers cut them.

        Raises:
            CommandError: where nothing is segmented yet.
        """
        doc = document or self.document
        read = self.read_source(doc)
        if read is None:
            raise CommandError("no part is there yet: click on a part that moves")
        # A working copy's folder is named after its content, too.
        return source_of(doc, read[0], self.services.workspace, self.record.name)

    def part_of(self, element: int) -> int | None:
        """Return the part of a source element, displayed or not; None before segmentation."""
        record = self.document.segmentation
        if record is None:
            return None
        stored = self._stored
        if stored is None or stored[0] != record.labels:
            # Reading those of millions of points takes a tenth of a second.
            stored = self._stored = record.labels, self.services.store.get_array(record.labels)
        return max(int(stored[1][element]), BASE)

    def _record_job(self, kind: str, at: float, seconds: float) -> None:
        """Keep how long a job took that began at ``at`` (seconds since 1970), where it counts."""
        if command_log.counts(kind, seconds):
            job = command_log.TimedJob(self.record.id, kind, at, seconds)
            command_log.record_job(self.services.workspace, job)

    def start(self, kind: str, job: Job[Any], keep: Callable[[Any], None]) -> None:
        """Follow a job; ``keep`` gets its result. Failures are shown in all tabs."""
        self.jobs.add(kind, job, lambda ended: self._ended(kind, ended, keep))

    def _ended(self, kind: str, job: Job[Any], keep: Callable[[Any], None]) -> None:
        raise NotImplementedError
