"""The worker processes of a server, one a kind of work."""

from __future__ import annotations

from app.server.jobs import WorkerProcess
from model.core.memory import limit_memory

READ_MEMORY = 0.75
"""Share of the machine's memory that reading one file may take."""

READ_SECONDS = 600.0
"""Longest reading of a file; scans of 50 million points take one minute."""
READ_CANCELLED = "Reading it was cancelled"


def too_slow(name: str) -> str:
    """What is said where reading the file ``name`` took longer."""
    return f"Reading {name} took more than {READ_SECONDS / 60:g} minutes: simplify the file"


class Workers:
    """The worker processes.

    Attributes:
        readers: read files, scenes and crops, which may take long or end them, so nobody's clicks
            wait for them.
        geometry: cuts parts, picks points.
        segmentation: encodes assets and answers clicks.
        prediction: predicts joints and validates them.
        saving: writes accepted assets.
        closing: whether the server ends and cuts jobs off.
    """

    def __init__(self) -> None:
        self.readers = tuple(
            WorkerProcess(name, initializer=limit_memory, arguments=(READ_MEMORY,))
            for name in ("reading", "reading 2")
        )
        self.geometry = WorkerProcess("geometry")
        self.segmentation = WorkerProcess("segmentation")
        self.prediction = WorkerProcess("prediction")
        self.saving = WorkerProcess("saving")
        self.closing = False

    @property
    def reading(self) -> WorkerProcess:
        """The reader to ask next: one that has nothing to do, if there is one."""
        return next((reader for reader in self.readers if not reader.busy), self.readers[0])

    def close(self) -> None:
        """End the processes."""
        self.closing = True
        workers = (*self.readers, self.geometry, self.segmentation, self.prediction, self.saving)
        for worker in workers:
            worker.begin_to_close()
        for worker in workers:
            worker.close()
