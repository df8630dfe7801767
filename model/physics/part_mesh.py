"""A triangle mesh of every part: its own, or a surface through its cloud.

Reconstructing a scanned part takes seconds and several processes ask for the same one, so surfaces
are cached by the cloud's content: in memory, and on disk where a folder is given.
"""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import Part
from model.core.errors import GeometryError
from model.core.geometry import Mesh, PointCloud
from model.geometry.reconstruct import mesh_from_cloud, mesh_of_scan
from model.physics.collision.store import fingerprint, load_arrays, save_arrays

MAX_FILES = 48
"""Surfaces on disk, the least recently used go first; one of a whole scan has some megabytes."""
VERSION = 2
"""Counted up when the same cloud gets another surface."""

_SURFACES: WeakKeyDictionary[PointCloud, Mesh] = WeakKeyDictionary()


def part_mesh(part: Part, store: Path | None = None) -> Mesh:
    """The part's mesh, or a surface through its cloud, made once.

    Args:
        store: folder that keeps such surfaces between runs and for other processes.

    Raises:
        GeometryError: where the part has neither a face nor a point.
    """
    if part.mesh is not None and len(part.mesh.faces):
        return part.mesh
    if part.cloud is not None and len(part.cloud):
        if part.cloud not in _SURFACES:
            _SURFACES[part.cloud] = _surface_of(part.cloud, store)
        return _SURFACES[part.cloud]
    raise GeometryError(f"part {part.link!r} has no face and no point; give it some or remove it")


def _surface_of(cloud: PointCloud, store: Path | None) -> Mesh:
    """A reconstructed surface; a box where the points span none."""
    mesh = None if store is None else _load(store, cloud)
    if mesh is None:
        with contextlib.suppress(GeometryError):
            mesh = mesh_from_cloud(cloud)
            if store is not None:
                _save(store, cloud, mesh)
    return mesh if mesh is not None and len(mesh.faces) else _box_around(cloud)


def _box_around(cloud: PointCloud) -> Mesh:
    import trimesh

    low, high = cloud.bounds
    size = np.maximum(high - low, max(0.01 * float((high - low).max()), 1e-3))
    box = trimesh.creation.box(extents=size)
    box.apply_translation((low + high) / 2)
    colors = None
    if cloud.colors is not None:
        mean = np.rint(cloud.colors.mean(axis=0))
        colors = np.tile(np.array([*mean, 255], np.uint8), (len(box.vertices), 1))
    return Mesh(np.asarray(box.vertices), np.asarray(box.faces), vertex_colors=colors)


def _path(folder: Path, cloud: PointCloud) -> Path:
    key = fingerprint("surface", VERSION, cloud.points, cloud.normals, cloud.colors)
    return folder / f"surface-{key}.npz"


def _load(folder: Path, cloud: PointCloud) -> Mesh | None:
    """The cached surface of ``cloud``; None where there is none or its file is damaged."""
    path = _path(folder, cloud)
    arrays = load_arrays(path)
    if arrays is None:
        return None
    with contextlib.suppress(OSError):  # a read-only folder, or another process removed it
        os.utime(path)
    try:
        return mesh_of_scan(arrays["vertices"], arrays["faces"], arrays.get("colors"))
    except (ValueError, KeyError):
        return None


def _save(folder: Path, cloud: PointCloud, mesh: Mesh) -> None:
    arrays: dict[str, npt.NDArray[Any]] = {"vertices": mesh.vertices, "faces": mesh.faces}
    if mesh.vertex_colors is not None:
        arrays["colors"] = mesh.vertex_colors
    save_arrays(_path(folder, cloud), arrays)
    found: list[tuple[float, Path]] = []
    for path in folder.glob("surface-*.npz"):
        with contextlib.suppress(FileNotFoundError):  # another process removes them, too
            found.append((path.stat().st_mtime, path))
    for _, old in sorted(found)[:-MAX_FILES]:
        with contextlib.suppress(OSError):
            old.unlink(missing_ok=True)
