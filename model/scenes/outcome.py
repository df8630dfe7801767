"""The outcome of each object of a converted scene."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from model.scenes.jobs import MISSING
from model.scenes.protocol import Decision
from model.scenes.scene import SceneObject


@dataclass(eq=False)
class Outcome:
    """The outcome of one object; filled in step by step.

    Attributes:
        obj: the object.
        decision: of the finder.
        path: its asset, or None.
        truth: whether the asset is known to move; None where nobody knows.
        key: of its asset's job, or None.
        state, reason: what became of it.
        report: of its asset's job.
        changes: joints whose limits were shortened.
        by, at: who decided on it, and when (ISO 8601, UTC); "" where nobody did.
    """

    obj: SceneObject
    decision: Decision
    path: Path | None = None
    truth: bool | None = None
    key: str | None = None
    state: str = MISSING
    reason: str = ""
    report: dict[str, Any] = field(default_factory=dict)
    changes: list[dict[str, Any]] = field(default_factory=list)
    by: str = ""
    at: str = ""
