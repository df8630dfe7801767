"""Accepting one open object: its asset is written, read back, and only then the decision counts.

The asset is a draft until nothing can speak against the decision any more; then it takes the place
of the one that was accepted before.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from model.errors import CommandError
from model.exporters.asset_folder import publish
from model.gate.report import GateReport
from model.geometry.asset import Source
from sessions import commands as cmd
from sessions.provenance import provenance
from sessions.state import Context, SessionState, acceptance_problems, apply
from sessions.store import Entry, ObjectRecord

if TYPE_CHECKING:
    from app.open_object import OpenObject


def accept(obj: OpenObject, comment: str, who: str, at: str, override: str = "") -> None:
    """Write the asset, read it back, and only then record the decision.

    Args:
        override: why it is right although the gate calls a joint broken.

    Raises:
        CommandError: where something is missing, or the gate needs a reason.
    """
    if "save" in obj.jobs:
        return
    state = obj.state
    doc = state.present
    problems = acceptance_problems(doc)
    if problems:
        raise CommandError("; ".join(problems))
    assert doc.tree is not None
    if not obj.judging.admits(comment, who, at, override):
        return
    gate = obj.judging.report
    command = cmd.Accept(comment, obj.judging.doubts(), override)
    after = apply(state, command, Context(who, at))
    record = acceptance_record(
        after, obj.bench.store.history(obj.record.id), _source_record(obj), gate, override
    )
    folder = asset_folder(obj.bench.workspace, obj.record)
    source = obj.source(doc)
    job = obj.bench.draft_asset(source, doc.tree, obj.jobs.progress("save"))

    def keep(draft: Path) -> None:
        now = obj.document
        if now.segmentation is None or (now.tree, obj.source(now)) != (doc.tree, source):
            obj.tell("Not accepted", "It was edited meanwhile: accept it again", "yellow")
            return
        # Only now: an asset that was accepted before stays until this one is to take its place.
        written = str(publish(draft, folder, record).folder)
        obj.do(command, who)
        obj.do(cmd.Saved(written), who)
        obj.tell("Accepted", f"Saved in {written}", "green")

    obj.start("save", job, keep)
    obj.changed()


def _source_record(obj: OpenObject) -> Source:
    asset = obj.asset
    assert asset is not None
    return Source(asset.path, asset.sha256, asset.up_axis, asset.unit_scale)


def acceptance_record(
    after: SessionState,
    history: list[Entry],
    source: Source,
    gate: GateReport | None,
    override: str = "",
) -> dict[str, Any]:
    """What ``provenance.json`` of an accepted asset holds, the gate's answer included."""
    record = provenance(after, history, source)
    record["gate"] = None if gate is None else {**gate.to_json(), "override": override}
    return record


def asset_folder(workspace: Path, record: ObjectRecord) -> Path:
    """Where the accepted asset of an object goes."""
    plain = re.sub(r"[^A-Za-z0-9._-]+", "_", record.name).strip("._") or "object"
    return workspace / "assets" / f"{plain[:60]}-{record.id}"
