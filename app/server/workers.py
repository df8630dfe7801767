"""The worker processes of a server."""

from __future__ import annotations

from app.server.jobs import WorkerProcess
from app.server.lanes import READING, Lanes, in_background
from app.server.worker_template import WorkerTemplate
from model.core.progress import own_threads

READ_SECONDS = 600.0
"""Longest reading of a file; scans of 50 million points take one minute."""
READ_CANCELLED = "Reading it was cancelled"


def too_slow(name: str) -> str:
    """Timeout message for reading the file ``name``."""
    return f"Reading {name} took more than {READ_SECONDS / 60:g} minutes: simplify the file"


class Workers:
    """The worker processes.

    Attributes:
        template: all are forked from it, where the system can; else None.
        readers: read files, scenes and crops, which may take long or end them, so nobody's clicks
            wait for them.
        lanes: answer clicks on open objects.
        geometry: of the first lane; also cuts the parts of a scene.
        segmentation: of the first lane.
        prediction: predicts joints and validates them.
        saving: writes accepted assets.
        closing: whether the server ends and cuts jobs off.
    """

    def __init__(self) -> None:
        self.template = WorkerTemplate(own_threads()) if WorkerTemplate.possible() else None
        self.readers = tuple(
            WorkerProcess(
                name, initializer=in_background, arguments=(READING,), template=self.template
            )
            for name in ("reading", "reading 2")
        )
        self.lanes = Lanes(self.template)
        self.geometry, self.segmentation = self.lanes.first.geometry, self.lanes.first.segmentation
        self.prediction = WorkerProcess("prediction", template=self.template)
        self.saving = WorkerProcess("saving", template=self.template)
        self.closing = False

    @property
    def reading(self) -> WorkerProcess:
        """The reader to ask next: one that has nothing to do, if there is one."""
        return next((reader for reader in self.readers if not reader.busy), self.readers[0])

    def close(self) -> None:
        """End the processes."""
        self.closing = True
        workers = (*self.readers, *self.lanes.close(), self.prediction, self.saving)
        for worker in workers:
            worker.begin_to_close()
        for worker in workers:
            worker.close()
        if self.template is not None:
            self.template.close()
