"""Validation in a worker process, with its reports cached on disk."""

from __future__ import annotations

import hashlib
import json
from contextlib import suppress
from functools import cache
from pathlib import Path

from app.server.part_tasks import PartSource, articulated_object
from model.core import codec
from model.core.files import draft_of, static_assets
from model.core.packages import installed_versions
from model.core.progress import Progress, no_progress, scaled_progress
from model.core.tree import KinematicTree
from model.physics.collision.store import fingerprint
from model.validation.report import ValidationReport
from model.validation.runner import validate

PACKAGES = static_assets().parent
DEPENDENCIES = ("core", "geometry", "kinematics", "physics", "validation")
"""Packages of the model that a report depends on, with their thresholds."""


def validate_joints(
    source: PartSource, tree: KinematicTree, progress: Progress = no_progress
) -> ValidationReport:
    """Validate all joints, or return the cached report."""
    cached = _cache_file(source, tree)
    try:
        return codec.read(ValidationReport, json.loads(cached.read_text(encoding="utf-8")))
    except (OSError, ValueError):
        pass

    obj = articulated_object(source, tree, scaled_progress(progress, 0.0, 0.2))
    progress = scaled_progress(progress, 0.2, 1.0)
    report = validate(obj, store=source.workspace / "collision", progress=progress)
    with suppress(OSError, ValueError), draft_of(cached) as draft:  # it counts without the cache
        draft.write_text(json.dumps(codec.write(report)), encoding="utf-8")
    return report


def _cache_file(source: PartSource, tree: KinematicTree) -> Path:
    key = fingerprint(
        "gate", validation_version(), source.folder.name, source.labels,
        sorted(source.names.items()), source.category, source.complete, tree.links, tree.joints,
    )  # fmt: skip
    return source.workspace / "cache" / "gate" / f"{key}.json"


@cache
def validation_version(root: Path = PACKAGES) -> str:
    """Return a key of the code, its settings, the material table and the libraries.

    Cached reports count until it changes.

    Args:
        root: folder of the packages.
    """
    digest = hashlib.sha256()
    for package in DEPENDENCIES:
        for path in sorted((root / "model" / package).rglob("*.py")):
            digest.update(f"{path.name}\0".encode() + path.read_bytes())
    digest.update((static_assets() / "physics" / "materials.json").read_bytes())
    versions = installed_versions("artiworld", "mujoco", "numpy", "open3d", "scipy")
    digest.update(repr(versions).encode())
    return digest.hexdigest()
