"""Simplified geometry of a scene's assets for the browser, made in a worker process and cached."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from app.server.tasks import ReadOptions, arrays_of, stamp, working_copy
from model.core.articulated_object import Part
from model.core.asset import Source
from model.core.errors import ArtiworldError
from model.core.files import draft_of
from model.core.progress import Progress, no_progress
from model.geometry.display import decimate, spacing, thin
from model.geometry.sampling import face_colors
from model.geometry.splitting import split
from model.scenes.asset_parts import bounds_of, whole

BATCH_SECONDS = 0.4
"""Time after which a job returns the shapes it has, so that the scene fills up."""

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Shape:
    """The drawn geometry of a rigid object, in its own frame, metres.

    Attributes:
        bounds: (2, 3) of the whole geometry, not of the drawn one; of a scan without outliers.
        vertices: (V, 3), or the points of a cloud.
        faces: (F, 3); None for a cloud.
        colors: (F, 3) of a mesh, (V, 3) of a cloud; None where the source has none.
        spacing: approximate distance between a cloud's points, metres.
    """

    bounds: FloatArray
    vertices: npt.NDArray[np.float32]
    faces: npt.NDArray[np.uint32] | None
    colors: npt.NDArray[np.uint8] | None = None
    spacing: float = 0.0


@dataclass(frozen=True, eq=False)
class DrawnParts:
    """The parts of a working copy as the browser draws them.

    Attributes:
        labels: reference of their labels.
        folder: the arrays of the working copy.
        source: the working copy's source.
        shapes: link → shape.
    """

    labels: str
    folder: Path
    source: Source
    shapes: dict[str, Shape]


def shapes(
    paths: Sequence[Path], workspace: Path, max_faces: int, progress: Progress = no_progress
) -> dict[Path, Shape | str]:
    """Return the shapes of as many assets as there is time for; the error of unreadable ones."""
    end = time.perf_counter() + BATCH_SECONDS
    out: dict[Path, Shape | str] = {}
    for path in paths:
        # A message of its own for each: the fraction then says at which one it stands.
        progress(len(out) / len(paths), f"{path.name} ({len(out) + 1} of {len(paths)})")
        try:
            out[path] = _shape_of(path, workspace, max_faces)
        except ArtiworldError as error:
            out[path] = str(error)
        if time.perf_counter() > end:
            break
    return out


def _shape_of(path: Path, workspace: Path, max_faces: int) -> Shape:
    identity = ("without strays", str(path.resolve()), stamp(path), max_faces)
    key = hashlib.sha256(repr(identity).encode()).hexdigest()[:24]
    kept = workspace / "cache" / "shapes" / f"{key}.npz"
    try:
        with np.load(kept, allow_pickle=False) as data:
            return Shape(
                data["bounds"], data["vertices"], data.get("faces"), data.get("colors"),
                float(data["spacing"]),
            )  # fmt: skip
    except (OSError, ValueError, KeyError, EOFError):
        pass
    part = whole(path)
    shape = replace(shape_of_part(part, max_faces), bounds=bounds_of((part,)))
    arrays = {k: v for k, v in vars(shape).items() if v is not None}
    with draft_of(kept) as draft:
        np.savez(draft, **arrays)
    return shape


def shape_of_part(part: Part, max_faces: int) -> Shape:
    """Return a part with at most ``max_faces`` faces, each of one colour."""
    bounds = np.asarray(part.bounds, np.float64)
    if part.mesh is None:
        assert part.cloud is not None
        cloud = part.cloud.take(thin(part.cloud.points, 2 * max_faces))
        points = np.asarray(cloud.points, np.float32)
        colors = None if cloud.colors is None else np.asarray(cloud.colors, np.uint8)[:, :3]
        return Shape(bounds, points, None, colors, spacing(points))
    mesh = part.mesh if len(part.mesh.faces) <= max_faces else decimate(part.mesh, max_faces)[0]
    used, faces = np.unique(mesh.faces, return_inverse=True)
    vertices = np.asarray(mesh.vertices[used], np.float32)
    colors = face_colors(mesh)[:, :3]
    return Shape(bounds, vertices, faces.reshape(-1, 3).astype(np.uint32), colors)


def drawn_parts(
    copy: Path, workspace: Path, labels: str, max_faces: int, options: ReadOptions
) -> DrawnParts:
    """Return the drawn parts of a working copy, cut by stored labels."""
    asset, folder = working_copy(copy, workspace, options)
    assert asset.source is not None
    cut = split(asset, arrays_of(workspace).get(labels))
    budget = max(200, max_faces // max(1, len(cut)))
    made = {part.link: shape_of_part(part, budget) for part in cut}
    return DrawnParts(labels, folder, asset.source, made)
