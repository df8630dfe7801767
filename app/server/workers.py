"""The worker processes of a server, one a kind of work."""

from __future__ import annotations

from app.server.jobs import WorkerProcess


class Workers:
    """The worker processes.

    Attributes:
        reading: reads files, which may take long or end it, so nobody's clicks wait for it.
        geometry: cuts parts, picks points.
        segmentation: encodes assets and answers clicks.
        prediction: predicts joints and validates them.
        saving: writes accepted assets.
        closing: whether the server ends and cuts jobs off.
    """

    def __init__(self) -> None:
        self.reading = WorkerProcess("reading")
        self.geometry = WorkerProcess("geometry")
        self.segmentation = WorkerProcess("segmentation")
        self.prediction = WorkerProcess("prediction")
        self.saving = WorkerProcess("saving")
        self.closing = False

    def close(self) -> None:
        """End the processes."""
        self.closing = True
        workers = (self.reading, self.geometry, self.segmentation, self.prediction, self.saving)
        for worker in workers:
            worker.begin_to_close()
        for worker in workers:
            worker.close()
