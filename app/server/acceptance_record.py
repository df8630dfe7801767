"""Acceptances: the asset takes its place with ``provenance.json``, and the decision counts."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from model.core.asset import Source
from model.core.errors import CommandError
from model.validation.report import ValidationReport
from sessions import commands as cmd
from sessions.live import LiveSession
from sessions.provenance import provenance
from sessions.state import SessionState
from sessions.store import Entry, ObjectRecord, now


def carry_out(
    live: LiveSession, asked: SessionState, command: cmd.Accept, who: str, draft: Path,
    record: dict[str, Any],
) -> str:  # fmt: skip
    """Let a draft take its place and accept the object, or neither; returns the asset's folder.

    Args:
        asked: the state that the decision was made for.
        record: the content of ``provenance.json``.

    Raises:
        CommandError: where the object moved on since.
        StoreError: where the storage doesn't take the asset.
    """
    if moved := live.moved_since(asked):
        raise CommandError(moved)
    at = record["review"]["at"] = now()
    folder = asset_folder(live.store.workspace, live.store.object(live.object_id))
    try:
        written = str(live.store.assets.publish(draft, folder, record))
        accepted = live.do(command, who, since=asked, at=at)
    except BaseException:
        live.settle()
        raise
    with suppress(CommandError):  # it is decided again already
        live.do(cmd.Saved(written), who, since=accepted)
    return written


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
    return workspace / "assets" / record.asset_name
