"""Surface reconstruction: a mesh through a cloud, which simulators need."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.errors import GeometryError
from model.core.mesh import Material, Mesh
from model.core.point_cloud import PointCloud
from model.core.progress import Progress, no_progress
from model.geometry.display import WHITE, thin
from model.geometry.normals import estimate_normals

Array = npt.NDArray[Any]

MAX_POINTS = 100_000
_FEW = 300  # below, Poisson's smoothing eats the shape
_VERY_FEW = 100  # below, neighbours don't determine the surface
_REACH = 3.0  # largest distance of the surface from the points, in spacings
_CELL = 3.0
"""Size of Poisson's cells in spacings. With 2 it takes twice the time for twice the faces, which
lie 1.3 to 3.1 thousandths of the object's diagonal from the truth instead of 1.4 to 3.4 (parts of
36 objects, by simulated depth cameras and drifting ones)."""


def mesh_from_cloud(
    cloud: PointCloud, *, max_points: int = MAX_POINTS, progress: Progress = no_progress
) -> Mesh:
    """Reconstruct a surface with the cloud's colours.

    Screened Poisson reconstruction (Kazhdan and Hoppe, 2013), trimmed to the points; ball pivoting
    (Bernardini et al., 1999) below 300 points; the convex hull below 100, which suits knobs and
    handles; a planar triangulation for flat clouds.

    Args:
        cloud: normals are estimated where it has none.
        max_points: larger clouds are thinned first, which bounds the time.
        progress: called between the steps.

    Raises:
        GeometryError: for fewer than 4 points, and for points on one line.
    """
    if len(cloud) < 4:
        raise GeometryError(f"a surface needs 4 points or more, this cloud has {len(cloud)}")
    progress(0.0, "thinning")
    small = cloud.take(thin(cloud.points, max_points))
    spread = np.linalg.svd(_centred(small.points), compute_uv=False)
    if spread[0] == 0 or spread[1] < 1e-6 * spread[0]:
        raise GeometryError("all points are on one line, which spans no surface")
    progress(0.1, "normals")
    if small.normals is None:
        small = estimate_normals(small)
    spacing = spacing_of(small.points)
    found = None
    if spread[2] > 1e-4 * spread[0]:
        if len(small) >= _FEW:
            progress(0.3, "Poisson reconstruction")
            found = poisson(small, spacing)
        elif len(small) < _VERY_FEW:
            found = _hull(small.points)
        if found is None:
            progress(0.6, "ball pivoting")
            found = _ball_pivoting(small, spacing)
    if found is None:
        found = _flat(small.points)
    progress(0.9, "colours")
    return _colored(*found, small)


def mesh_of_scan(vertices: Array, faces: Array, rgba: Array | None) -> Mesh:
    """Make a mesh with optional vertex colours (V, 4) uint8."""
    if rgba is None:
        return Mesh(vertices, faces)
    return Mesh(vertices, faces, materials=(Material("scan", WHITE),), vertex_colors=rgba)


def _centred(points: Array) -> Array:
    out = points.astype(np.float64)
    out = out - out.mean(axis=0)
    return out[:: max(1, len(out) // 20_000)]


def spacing_of(points: Array) -> float:
    """Metres between neighbours: the median distance to the fourth nearest, halved."""
    from scipy.spatial import KDTree

    k = min(5, len(points))
    distance = KDTree(points).query(points[:: max(1, len(points) // 5000)], k=k)[0][:, -1]
    apart = distance[distance > 0]
    return float(np.median(apart)) / 2 if len(apart) else 1e-6


def _open3d_cloud(cloud: PointCloud, shift: Array, scale: float) -> Any:
    import open3d as o3d

    out = o3d.geometry.PointCloud()
    out.points = o3d.utility.Vector3dVector((cloud.points - shift) / scale)
    assert cloud.normals is not None
    out.normals = o3d.utility.Vector3dVector(cloud.normals.astype(np.float64))
    return out


def poisson(
    cloud: PointCloud, spacing: float, reach: float = _REACH, margin: float = 1.1
) -> tuple[Array, Array] | None:
    """Screened Poisson reconstruction (Kazhdan and Hoppe, 2013), with the cloud's normals.

    Args:
        spacing: metres between neighbours.
        reach: largest distance of the surface from the points, in spacings.
        margin: size of the cube of cells, in that of the points' box.

    Returns:
        Vertices (V, 3) and faces (F, 3); None where there is no surface.
    """
    import open3d as o3d
    from scipy.spatial import KDTree

    low, high = cloud.bounds
    shift, scale = (low + high) / 2, float((high - low).max())
    depth = int(np.clip(np.rint(np.log2(margin * scale / (_CELL * spacing))), 5, 9))
    mesh, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(
        _open3d_cloud(cloud, shift, scale), depth=depth, scale=margin, n_threads=1
    )
    vertices = np.asarray(mesh.vertices) * scale + shift
    faces = np.asarray(mesh.triangles)
    if not len(faces):
        return None
    if np.isfinite(reach):
        away = KDTree(cloud.points).query(vertices)[0]
        good = away <= max(reach * spacing, 1.5 * scale / 2**depth)
        faces = faces[good[faces].all(axis=1)]
    return (vertices, faces) if len(faces) >= 4 else None


def _ball_pivoting(cloud: PointCloud, spacing: float) -> tuple[Array, Array] | None:
    import open3d as o3d

    low, high = cloud.bounds
    shift, scale = (low + high) / 2, float((high - low).max())
    radii = o3d.utility.DoubleVector([f * spacing / scale for f in (1.5, 3.0, 6.0, 12.0)])
    mesh = o3d.geometry.TriangleMesh.create_from_point_cloud_ball_pivoting(
        _open3d_cloud(cloud, shift, scale), radii
    )
    faces = np.asarray(mesh.triangles)
    return (np.asarray(mesh.vertices) * scale + shift, faces) if len(faces) else None


def _hull(points: Array) -> tuple[Array, Array] | None:
    """The convex hull, wound outwards; None where it has no volume."""
    from scipy.spatial import ConvexHull, QhullError

    p = points.astype(np.float64)
    try:
        hull = ConvexHull(p)
    except QhullError:
        return None
    faces = hull.simplices.copy()
    t = p[faces]
    cross = np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])
    inward = np.einsum("ij,ij->i", cross, hull.equations[:, :3]) < 0
    faces[inward] = faces[inward][:, ::-1]
    return p, faces


def _flat(points: Array) -> tuple[Array, Array]:
    """Triangulation in the plane of largest variance."""
    from scipy.spatial import Delaunay, QhullError

    p = points.astype(np.float64)
    middle = p - p.mean(axis=0)
    axes = np.linalg.svd(middle[:: max(1, len(p) // 20_000)], full_matrices=False)[2]
    try:
        faces = Delaunay(middle @ axes[:2].T).simplices
    except QhullError:
        raise GeometryError("all points are on one line, which spans no surface") from None
    t = p[faces]
    edge = np.linalg.norm(t - np.roll(t, 1, axis=1), axis=2).max(axis=1)
    short = edge <= 6.0 * np.median(edge)  # long edges bridge gaps
    return p, faces[short]


def _colored(vertices: Array, faces: Array, cloud: PointCloud) -> Mesh:
    used, inverse = np.unique(faces, return_inverse=True)
    vertices, faces = vertices[used], inverse.reshape(-1, 3).astype(np.int32)
    if cloud.colors is None:
        return Mesh(vertices, faces)
    return mesh_of_scan(vertices, faces, colored_by(vertices, cloud))


def colored_by(vertices: Array, cloud: PointCloud) -> npt.NDArray[np.uint8]:
    """(V, 4) colours of the cloud's nearest points, weighted by distance."""
    from scipy.spatial import KDTree

    assert cloud.colors is not None
    k = min(3, len(cloud))
    distance, index = KDTree(cloud.points).query(vertices, k=k)
    weight = 1.0 / np.maximum(distance, 1e-9)
    weight /= weight.sum(axis=1, keepdims=True)
    rgb = np.einsum("nk,nkc->nc", weight, cloud.colors[index].astype(np.float64))
    return np.column_stack([np.rint(rgb), np.full(len(rgb), 255)]).astype(np.uint8)
