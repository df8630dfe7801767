"""The services that open objects and the scene share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from app.server.config import ServeConfig
from app.server.drafts import AssetDrafts
from app.server.object_queue import ObjectQueue
from app.server.pending_acceptances import PendingAcceptances
from app.server.workers import Workers
from model.prediction import DEFAULT
from model.prediction.experience import in_use
from sessions.live import SessionHub
from sessions.store import Store


@dataclass(frozen=True, eq=False)
class Services:
    """Settings, store, workers and queue of one server."""

    config: ServeConfig
    store: Store
    hub: SessionHub
    workers: Workers
    drafts: AssetDrafts
    queue: ObjectQueue
    acceptances: PendingAcceptances

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
