"""The record of an acceptance: the asset's folder and its ``provenance.json``."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from model.core.asset import Source
from model.validation.report import ValidationReport
from sessions.provenance import provenance
from sessions.state import SessionState
from sessions.store import Entry, ObjectRecord


def acceptance_record(
    after: SessionState,
    history: list[Entry],
    source: Source,
    report: ValidationReport | None,
    override: str = "",
    *,
    warnings_seen: bool = False,
    scene: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return the content of an accepted asset's ``provenance.json``, validation included.

    Args:
        override: reason for accepting it despite errors, else "".
        warnings_seen: whether the person had been shown the warnings.
        scene: source of an object that was annotated in a scene.
    """
    record = provenance(after, history, source)
    record["source"].update(scene or {})
    decision = {"override": override, "looked_at": warnings_seen}
    record["gate"] = None if report is None else {**report.to_json(), **decision}
    return record


def asset_folder(workspace: Path, record: ObjectRecord) -> Path:
    """Return the folder of an object's accepted asset."""
    plain = re.sub(r"[^A-Za-z0-9._-]+", "_", record.name).strip("._") or "object"
    return workspace / "assets" / f"{plain[:60]}-{record.id}"
