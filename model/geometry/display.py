"""Level of detail for the browser: large meshes decimated, large clouds thinned."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.asset import Asset
from model.core.geometry import Material, Mesh, PointCloud
from model.geometry.sampling import vertex_colors

Array = npt.NDArray[Any]
WHITE = (255, 255, 255, 255)
_ROUNDS = 6


@dataclass(frozen=True, eq=False)
class DisplayAsset:
    """A light copy of an asset.

    Attributes:
        mesh, cloud: exactly one is given.
        element: (D,) int32 source face or point of each displayed face or point.
    """

    mesh: Mesh | None
    cloud: PointCloud | None
    element: npt.NDArray[np.int32]


def display_asset(asset: Asset, most: int = 150_000) -> DisplayAsset:
    """Reduce an asset to ``most`` faces or points, as a browser draws smoothly; deterministic."""
    if asset.mesh is not None:
        mesh = asset.mesh
        if len(mesh.faces) <= most:
            return DisplayAsset(mesh, None, np.arange(len(mesh.faces), dtype=np.int32))
        simple, element = decimate(mesh, most)
        return DisplayAsset(simple, None, element)
    cloud = asset.cloud
    assert cloud is not None
    element = thin(cloud.points, most)
    return DisplayAsset(None, cloud.take(element) if len(element) < len(cloud) else cloud, element)


def cell_index(points: Array, size: float, low: Array) -> npt.NDArray[np.int64]:
    """Return (N,) the cubic cell of each point, counted from corner ``low``."""
    index = np.floor((points - low) / size).astype(np.int64)
    ny, nz = (int(index[:, k].max(initial=0)) + 1 for k in (1, 2))
    return (index[:, 0] * ny + index[:, 1]) * nz + index[:, 2]


def thin(points: Array, max_points: int) -> npt.NDArray[np.int32]:
    """Return indices of at most ``max_points`` evenly spread points: the first of each cell."""
    count = len(points)
    if count <= max_points:
        return np.arange(count, dtype=np.int32)
    low = points.min(axis=0)
    extent = np.sort(np.maximum(np.ptp(points, axis=0).astype(np.float64), 1e-12))
    # A scan is a surface: about as many cells are filled as fit its two longest sides.
    size = float(np.sqrt(extent[2] * extent[1] / max_points))
    size = max(size, extent[2] * 1e-5)
    best = np.zeros(0, np.int64)
    for _ in range(_ROUNDS):
        first = np.unique(cell_index(points, size, low), return_index=True)[1]
        if len(best) < len(first) <= max_points:
            best = first
        if 0.8 * max_points <= len(first) <= max_points:
            break
        ratio = np.clip(len(first) / (0.9 * max_points), 0.05, 20.0)
        size = max(size * float(np.sqrt(ratio)), extent[2] * 1e-5)
    if len(best) < 0.3 * max_points:  # many points at few places
        best = np.random.default_rng(0).permutation(count)[:max_points]
    return np.sort(best).astype(np.int32)


def spacing(points: Array) -> float:
    """Estimate the distance between points in metres: points of this size close the surface."""
    from scipy.spatial import KDTree

    diagonal = float(np.linalg.norm(np.ptp(points, axis=0)))
    if len(points) < 10:
        return 0.01 * diagonal
    rng = np.random.default_rng(0)
    some = points[rng.choice(len(points), min(1500, len(points)), replace=False)]
    near = KDTree(points).query(some, k=4)[0][:, 2:].mean()
    return float(np.clip(1.1 * near, 1e-4 * diagonal, 0.02 * diagonal))


def decimate(mesh: Mesh, max_faces: int) -> tuple[Mesh, npt.NDArray[np.int32]]:
    """Decimate by clustering vertices on a grid (Rossignac and Borrel, 1993).

    Textures become vertex colours.

    Returns:
        The mesh, and the source face of each of its faces.
    """
    low = mesh.vertices.min(axis=0)
    longest = float(np.ptp(mesh.vertices, axis=0).max())
    # n vertices on a surface make 2n triangles.
    size = max(float(np.sqrt(2.0 * mesh.face_areas.sum() / max_faces)), longest * 1e-5)
    best: tuple[Array, Array, Array] | None = None
    for _ in range(_ROUNDS):
        vertex, keep, faces = _cluster(mesh, size, low)
        if len(keep) <= max_faces and (best is None or len(keep) > len(best[1])):
            best = vertex, keep, faces
        if 0.7 * max_faces <= len(keep) <= max_faces:
            break
        ratio = np.clip(len(keep) / (0.85 * max_faces), 0.02, 50.0)
        size = max(size * float(np.sqrt(ratio)), longest * 1e-5)
    if best is None or not len(best[1]):
        return _largest(mesh, max_faces)
    vertex, keep, faces = best
    count = int(vertex.max()) + 1
    weight = np.bincount(vertex, minlength=count).astype(np.float64)
    rgba = vertex_colors(mesh)
    position, color = (
        np.stack([np.bincount(vertex, v[:, k], count) for k in range(v.shape[1])], 1)
        / weight[:, None]
        for v in (mesh.vertices, rgba)
    )
    used, inverse = np.unique(faces, return_inverse=True)
    simple = Mesh(
        position[used],
        inverse.reshape(-1, 3).astype(np.int32),
        materials=(Material("decimated", WHITE),),
        vertex_colors=np.rint(color[used]).astype(np.uint8),
    )
    return simple, keep.astype(np.int32)


def _cluster(mesh: Mesh, size: float, low: Array) -> tuple[Array, Array, Array]:
    """Cluster of each vertex, source faces with three different ones, and these faces."""
    vertex = np.unique(cell_index(mesh.vertices, size, low), return_inverse=True)[1].reshape(-1)
    faces = vertex[mesh.faces]
    real = np.flatnonzero(
        (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    )
    corners = np.sort(faces[real], axis=1).astype(np.uint64)
    count = np.uint64(int(vertex.max(initial=0)) + 1)
    # Wraps around beyond 2^64, which may merge two faces of very many, never more.
    key = (corners[:, 0] * count + corners[:, 1]) * count + corners[:, 2]
    keep = real[np.sort(np.unique(key, return_index=True)[1])]
    return vertex, keep, faces[keep]


def _largest(mesh: Mesh, max_faces: int) -> tuple[Mesh, npt.NDArray[np.int32]]:
    """Keep the largest faces, where no grid works (many unconnected slivers)."""
    order = np.argsort(-mesh.face_areas, kind="stable")[:max_faces]
    keep = np.sort(order)
    taken = mesh.take_faces(keep)
    return taken, keep.astype(np.int32)
