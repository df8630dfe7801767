"""Drafts of assets, written in the background before anybody accepts them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from app.server import part_tasks, saving_tasks
from app.server.jobs import Job, WorkerProcess
from app.server.part_tasks import PartSource
from model.core.tree import KinematicTree


class AssetDrafts:
    """Writes the asset that will probably be accepted next."""

    def __init__(self, worker: WorkerProcess) -> None:
        self._worker = worker
        self._preparing: tuple[PartSource, KinematicTree, Job[Path]] | None = None

    def prepare(self, source: PartSource, tree: KinematicTree) -> None:
        """Start writing a draft; a failure is reported when it is accepted."""
        self.stop()
        job = self._worker.submit(saving_tasks.prepare_asset, source, tree)
        self._preparing = (source, tree, job)

    def prepare_bodies(self, source: PartSource) -> None:
        """Compute the parts' collision shapes while their joints are predicted.

        Most of the time of a validation goes into them, and they don't depend on the joints.
        Saving comes first.
        """
        self._worker.submit(
            part_tasks.prepare_bodies, source, priority=-1, key="bodies", preempted_by=0
        )

    def stop(self) -> None:
        """Cancel the draft under way: the joints changed, or something else is saved."""
        preparing, self._preparing = self._preparing, None
        if preparing is not None:
            preparing[2].cancel()

    def finish(
        self, source: PartSource, tree: KinematicTree, on_progress: Callable[[float, str], None]
    ) -> Job[Path]:
        """Return the job that writes the draft to accept, after the one under way for it."""
        if self._preparing is not None and self._preparing[:2] != (source, tree):
            self.stop()
        preparing, self._preparing = self._preparing, None
        if preparing is not None:
            # No longer cancelled by `stop`; the job below waits for it, so its progress counts.
            preparing[2].listen(on_progress)
        return self._worker.submit(
            saving_tasks.prepare_asset, source, tree, on_progress=on_progress
        )
