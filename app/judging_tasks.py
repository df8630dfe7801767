"""The gate in a worker process; what it said of the same parts and joints is kept on disk."""

from __future__ import annotations

import json
import secrets
from importlib.metadata import version
from pathlib import Path

from app.tasks import PartSource, articulated_object
from model import codec
from model.gate.report import GateReport
from model.kinematics.tree import KinematicTree
from model.progress import Progress, no_progress


def judge_joints(
    source: PartSource, tree: KinematicTree, progress: Progress = no_progress
) -> GateReport:
    """Ask the gate about every joint, or say again what it said of them before."""
    kept = _kept_at(source, tree)
    try:
        return codec.read(GateReport, json.loads(kept.read_text(encoding="utf-8")))
    except (OSError, ValueError):
        pass
    from model.gate.gate import run_gate

    obj = articulated_object(source, tree)
    report = run_gate(obj, store=source.workspace / "collision", progress=progress)
    draft = kept.with_name(f".{kept.name}.{secrets.token_hex(4)}")
    try:
        kept.parent.mkdir(parents=True, exist_ok=True)
        draft.write_text(json.dumps(codec.write(report)), encoding="utf-8")
        draft.replace(kept)
    except (OSError, ValueError):  # it counts without being kept
        draft.unlink(missing_ok=True)
    return report


def _kept_at(source: PartSource, tree: KinematicTree) -> Path:
    from model.collision.store import fingerprint

    key = fingerprint(
        "gate", version("artiworld"), source.folder.name, source.labels,
        sorted(source.names.items()), source.category, tree.links, tree.joints,
    )  # fmt: skip
    return source.workspace / "cache" / "gate" / f"{key}.json"
