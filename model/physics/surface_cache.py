"""Surfaces through clouds on disk, named by the cloud: several processes ask for the same ones, and
one of a scan takes seconds."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy.typing as npt

from model.core.mesh import Mesh
from model.core.point_cloud import PointCloud
from model.geometry.reconstruct import mesh_of_scan
from model.physics.collision.store import fingerprint, load_arrays, save_arrays

KEPT = 48
"""Files; those that were asked for last. One of a whole scan has some megabytes."""
VERSION = 1
"""Counted up when the same cloud gets another surface."""


def load_surface(folder: Path, cloud: PointCloud) -> Mesh | None:
    """The surface that was kept of ``cloud``, or None; what is damaged counts as not there."""
    path = _path(folder, cloud)
    arrays = load_arrays(path)
    if arrays is None:
        return None
    with suppress(OSError):  # a folder that can't be written; another process drops files, too
        os.utime(path)
    try:
        return mesh_of_scan(arrays["vertices"], arrays["faces"], arrays.get("colors"))
    except (ValueError, KeyError):
        return None


def save_surface(folder: Path, cloud: PointCloud, mesh: Mesh) -> None:
    """Keep it; a folder that can't be written is let be."""
    arrays: dict[str, npt.NDArray[Any]] = {"vertices": mesh.vertices, "faces": mesh.faces}
    if mesh.vertex_colors is not None:
        arrays["colors"] = mesh.vertex_colors
    save_arrays(_path(folder, cloud), arrays)
    with suppress(OSError):
        _drop_oldest(folder)


def _path(folder: Path, cloud: PointCloud) -> Path:
    key = fingerprint("surface", VERSION, cloud.points, cloud.normals, cloud.colors)
    return folder / f"surface-{key}.npz"


def _drop_oldest(folder: Path) -> None:
    found: list[tuple[float, Path]] = []
    for path in folder.glob("surface-*.npz"):
        with suppress(FileNotFoundError):  # another process drops them, too
            found.append((path.stat().st_mtime, path))
    for _, old in sorted(found)[:-KEPT]:
        old.unlink(missing_ok=True)
