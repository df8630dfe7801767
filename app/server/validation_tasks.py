"""The gate in a worker process; what it said of the same parts and joints is kept on disk."""

from __future__ import annotations

import hashlib
import json
import secrets
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from app.server.part_tasks import PartSource, articulated_object
from model.core import codec
from model.core.progress import Progress, no_progress
from model.core.resources import static_assets
from model.core.tree import KinematicTree
from model.physics.collision.store import fingerprint
from model.validation.report import ValidationReport
from model.validation.runner import validate

PACKAGES = static_assets().parent
DECIDES = ("core", "geometry", "kinematics", "physics", "validation")
"""Packages of the model that an answer depends on, with their thresholds."""


def judge_joints(
    source: PartSource, tree: KinematicTree, progress: Progress = no_progress
) -> ValidationReport:
    """Ask the gate about every joint, or say again what it said of them before."""
    kept = _kept_at(source, tree)
    try:
        return codec.read(ValidationReport, json.loads(kept.read_text(encoding="utf-8")))
    except (OSError, ValueError):
        pass

    obj = articulated_object(source, tree)
    report = validate(obj, store=source.workspace / "collision", progress=progress)
    draft = kept.with_name(f".{kept.name}.{secrets.token_hex(4)}")
    try:
        kept.parent.mkdir(parents=True, exist_ok=True)
        draft.write_text(json.dumps(codec.write(report)), encoding="utf-8")
        draft.replace(kept)
    except (OSError, ValueError):  # it counts without being kept
        draft.unlink(missing_ok=True)
    return report


def _kept_at(source: PartSource, tree: KinematicTree) -> Path:
    key = fingerprint(
        "gate", judge_version(), source.folder.name, source.labels,
        sorted(source.names.items()), source.category, tree.links, tree.joints,
    )  # fmt: skip
    return source.workspace / "cache" / "gate" / f"{key}.json"


@cache
def judge_version(root: Path = PACKAGES) -> str:
    """Of the code that judges, its settings, the table of materials and the libraries behind it:
    an answer that was kept counts until one of them changes.

    Args:
        root: the folder that holds the packages.
    """
    digest = hashlib.sha256()
    for package in DECIDES:
        for path in sorted((root / "model" / package).rglob("*.py")):
            digest.update(f"{path.name}\0".encode() + path.read_bytes())
    digest.update((static_assets() / "physics" / "materials.json").read_bytes())
    for name in ("artiworld", "mujoco", "numpy", "open3d", "scipy"):
        try:
            digest.update(f"{name} {version(name)}\0".encode())
        except PackageNotFoundError:  # MuJoCo is an extra
            digest.update(f"no {name}\0".encode())
    return digest.hexdigest()
