"""``artiworld prepare``: level, size and clean a scan."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from app.cli.output import check_output
from model.core.asset import Source
from model.core.files import write_json
from model.core.geometry import affine
from model.core.progress import Progress, no_progress, scaled_progress
from model.geometry.prepare import Prepared, PrepareSettings, Vector, prepare
from model.io.geometry_files import default_up_axis, turned_up
from model.io.open_asset import open_asset
from model.io.write import mesh_to_glb, write_cloud

FORMAT = 1
"""Version of ``prepare.json``."""


def prepare_files(
    scan: Path, out: Path, settings: PrepareSettings, progress: Progress = no_progress
) -> dict[str, Any]:
    """Write ``object.ply``, or ``object.glb`` for a mesh, ``kept.npy`` and ``prepare.json``.

    Returns:
        The content of ``prepare.json``.

    Raises:
        ArtiworldError: where the scan can't be read, nothing is left of it, or the folder can't be
            written.
    """
    check_output(out, scan, *([] if scan.is_dir() else [scan.parent]))
    axis = "z" if settings.up is not None or scan.is_dir() else default_up_axis(scan)
    asset = open_asset(scan, up_axis=axis, progress=scaled_progress(progress, 0.0, 0.4))
    turn = turned_up(axis)
    if settings.length is not None:
        a, b, metres = settings.length
        settings = replace(settings, length=(_turned(turn, a), _turned(turn, b), metres))
    found = prepare(asset, settings, scaled_progress(progress, 0.4, 0.5))
    progress(0.9, f"writing {out}")
    out.mkdir(parents=True, exist_ok=True)
    if found.asset.mesh is not None:
        target = out / "object.glb"
        target.write_bytes(mesh_to_glb(found.asset.mesh, y_up=True))
    else:
        assert found.asset.cloud is not None
        target = out / "object.ply"
        write_cloud(found.asset.cloud, target)
    np.save(out / "kept.npy", found.kept)
    report = {
        "format": FORMAT,
        "object": target.name,
        "object_from_source": _from_file(found, asset.source, turn),
        "up_in_source": _turned(turn.T, found.levelling.up),
        "confidence": round(found.levelling.confidence, 4),
        "tilt_degrees": round(float(np.degrees(found.levelling.tilt)), 2),
        "alternatives": [_turned(turn.T, v) for v in found.levelling.alternatives],
        "size": np.ptp(found.asset.bounds, axis=0).round(6).tolist(),
        "kept": "kept.npy",
        "elements": {"of": asset.element_kind, "kept": len(found.kept)},
        "removed": found.removed,
        "source": {"file": scan.name, "sha256": asset.source.sha256 if asset.source else None},
        "problems": list(found.asset.warnings),
    }
    write_json(out / "prepare.json", report)
    progress(1.0, "prepared")
    return report


def _from_file(
    found: Prepared, source: Source | None, turn: npt.NDArray[np.float64]
) -> list[list[float]]:
    """(4, 4) object_from_source of the file's own numbers, row by row."""
    taken = affine(shift=-np.asarray(source.shift if source else (0, 0, 0)))
    return (found.object_from_source @ taken @ turn).tolist()


def _turned(matrix: npt.NDArray[np.float64], vector: Vector) -> Vector:
    x, y, z = (matrix[:3, :3] @ vector).tolist()
    return x, y, z
