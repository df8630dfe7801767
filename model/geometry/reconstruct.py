"""Surface reconstruction: a mesh through a cloud, open or closed.

A closed surface goes through points that were seen from some sides only. Space in front of a
surface is free, as somebody looked through it; what surfaces enclose along two of the three axes is
solid, also where nobody saw the third; elsewhere a surface is a board. Points on the border of the
solid that no real point covers close the surface, which is then reconstructed as a whole. Booleans
of solids are those of the library Manifold.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from model.core.errors import GeometryError
from model.core.geometry import Material, Mesh, PointCloud
from model.geometry.display import WHITE, thin
from model.geometry.sampling import estimate_normals

if TYPE_CHECKING:
    from manifold3d import Manifold


Array = npt.NDArray[Any]

MAX_POINTS = 100_000
_FEW = 300  # below, Poisson's smoothing eats the shape
_VERY_FEW = 100  # below, neighbours don't determine the surface
_REACH = 3.0  # largest distance of the surface from the points, in spacings
_CELL = 3.0
"""Size of Poisson's cells in spacings. With 2 it takes twice the time for twice the faces, which
lie 1.3 to 3.1 thousandths of the object's diagonal from the truth instead of 1.4 to 3.4 (parts of
36 objects, by simulated depth cameras and drifting ones)."""


def mesh_from_cloud(cloud: PointCloud) -> Mesh:
    """Reconstruct a surface with the cloud's colours.

    Screened Poisson reconstruction (Kazhdan and Hoppe, 2013), trimmed to the points; ball pivoting
    (Bernardini et al., 1999) below 300 points; the convex hull below 100, which suits knobs and
    handles; a planar triangulation for flat clouds.

    Args:
        cloud: normals are estimated where it has none.

    Raises:
        GeometryError: for fewer than 4 points, and for points on one line.
    """
    if len(cloud) < 4:
        raise GeometryError(f"a surface needs 4 points or more, this cloud has {len(cloud)}")
    small = cloud.take(thin(cloud.points, MAX_POINTS))
    spread = np.linalg.svd(_centred(small.points), compute_uv=False)
    if spread[0] == 0 or spread[1] < 1e-6 * spread[0]:
        raise GeometryError("all points are on one line, which spans no surface")
    if small.normals is None:
        small = estimate_normals(small)
    spacing = spacing_of(small.points)
    found = None
    if spread[2] > 1e-4 * spread[0]:
        if len(small) >= _FEW:
            found = poisson(small, spacing)
        elif len(small) < _VERY_FEW:
            found = _hull(small.points)
        if found is None:
            found = _ball_pivoting(small, spacing)
    if found is None:
        found = _flat(small.points)
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


CELLS = 112
"""Voxels along the longest side: a wall of 2 cm has two in furniture of a metre."""
DENSE = 2.5
"""Size of a voxel in spacings, so that a surface has no gaps."""
GROOVE = 7
"""Voxels; gaps up to this wide at which nothing was seen were not scanned."""
ALIKE = 0.5
"""Cosine above which a point nearby is of the same surface: the border's normals are coarse."""
TRIES = ((0.8, 1.1), (0.8, 1.17), (1.6, 1.1))
"""Factors of the spacing, and margins of the cube of cells: some surfaces leak, or touch
themselves."""
SMALL = 0.002
"""Loose pieces below this share of the largest one's volume are noise."""


def closed_solid(
    cloud: PointCloud, wall: float, front: npt.NDArray[np.float64] | None = None
) -> Manifold | None:
    """Reconstruct a solid whose surface goes through the points.

    Args:
        cloud: with normals that point outwards.
        wall: metres behind the points that are solid where nobody saw what is there.
        front: (4,) a plane whose positive side was seen: n · x + d > 0. Nothing is added there.

    Returns:
        A solid within the points' box, grown by the wall; None where there is none.
    """
    if cloud.normals is None or len(cloud) < 4:
        return None
    made, normals = closing_points(cloud.points, cloud.normals, wall)
    if front is not None:
        hidden = made @ front[:3] + front[3] < 0
        made, normals = made[hidden], normals[hidden]
    points = np.concatenate([cloud.points, made]).astype(np.float32)
    whole = PointCloud(points, np.concatenate([cloud.normals, normals]).astype(np.float32))
    low, high = cloud.bounds
    for coarse, margin in TRIES:
        found = poisson(whole, coarse * spacing_of(cloud.points), np.inf, margin)
        solid = None if found is None else manifold(*found)
        if solid is not None and not solid.is_empty():
            return largest(solid ^ box(low - wall, high + wall))
    return None


def manifold(vertices: Array, faces: Array) -> Manifold:
    """Return a mesh as a solid; an empty one where its edges don't close it."""
    from manifold3d import Manifold, Mesh

    mesh = Mesh(np.ascontiguousarray(vertices, np.float32), np.ascontiguousarray(faces, np.uint32))
    mesh.merge()
    return Manifold(mesh)


def box(low: Array, high: Array) -> Manifold:
    """An upright box between two corners."""
    from manifold3d import Manifold

    return Manifold.cube(np.asarray(high - low, float)).translate(np.asarray(low, float))


def largest(solid: Manifold) -> Manifold | None:
    """Leave loose pieces that are :data:`SMALL` out; None where nothing has a volume."""
    from manifold3d import Manifold, OpType

    pieces = [(p.volume(), p) for p in solid.decompose()]
    most = max((v for v, _ in pieces), default=0.0)
    if not most > 0:
        return None
    return Manifold.batch_boolean([p for v, p in pieces if v > SMALL * most], OpType.Add)


def closing_points(points: Array, normals: Array, wall: float) -> tuple[Array, Array]:
    """Return points (K, 3) and normals where nothing was seen of the border of the solid."""
    from scipy.ndimage import gaussian_filter

    low, extent = points.min(axis=0), np.ptp(points, axis=0)
    size = max(float(extent.max()) / CELLS, DENSE * spacing_of(points))
    deep = int(np.ceil(wall / size))
    corner = low - (deep + 3) * size
    index = np.floor((points - corner) / size).astype(np.int64)
    shape = index.max(axis=0) + deep + 4
    surface = np.zeros(shape, bool)
    surface[tuple(index.T)] = True
    cells = (points - corner) / size
    seen, unknown = _free(surface, cells, normals)
    # Without what single wrong normals saw, and without tunnels and grooves of missing points.
    seen, unknown = _opened(seen, 3), _opened(unknown, GROOVE)
    solid = ~unknown
    for step in range(1, deep + 1):
        behind = np.floor((points - normals * step * size - corner) / size).astype(np.int64)
        solid[tuple(np.clip(behind, 0, shape - 1).T)] = True
    solid = (solid & ~seen) | surface
    level = gaussian_filter(solid.astype(np.float32), 1.0)
    slope = np.stack(list(np.gradient(level)), axis=-1)
    steep = np.linalg.norm(slope, axis=-1)
    border = np.argwhere((level > 0.5) & (steep > 0.1))
    at = tuple(border.T)
    outward = -slope[at] / steep[at][:, None]
    ahead = np.minimum((level[at] - 0.5) / steep[at], 2.0)
    border, outward, ahead = (v[ahead < 1.2] for v in (border, outward, ahead))
    found = corner + (border + 0.5 + outward * ahead[:, None]) * size
    behind = _unseen(found, outward, points, normals, size)
    return _spread(found[behind], outward[behind], size)


def _unseen(found: Array, outward: Array, points: Array, normals: Array, size: float) -> Array:
    """(K,) whether points of the border are behind scanned ones and face elsewhere, or far away."""
    from scipy.spatial import KDTree

    near = KDTree(points).query(found, k=min(4, len(points)), distance_upper_bound=2.5 * size)[1]
    near = near.reshape(len(found), -1)
    there = near < len(points)
    near = np.where(there, near, 0)
    alike = (np.einsum("nkc,nc->nk", normals[near], outward) > ALIKE) & there
    depth = np.einsum("nkc,nkc->nk", points[near] - found[:, None], normals[near])
    beside = np.where(there, depth, 0).sum(axis=1) < 0.3 * size * there.sum(axis=1)
    return ~alike.any(axis=1) & ~(beside & there.any(axis=1))


def _opened(mask: Array, width: int) -> Array:
    """A mask without what is narrower than some voxels; it goes on beyond its border."""
    from scipy.ndimage import binary_opening

    padded = np.pad(mask, width, mode="edge")
    wide: Array = np.array(binary_opening(padded, np.ones((width,) * 3)))
    return wide[(slice(width, -width),) * 3]


def _spread(points: Array, normals: Array, size: float) -> tuple[Array, Array]:
    """Four points in the plane of each one, as dense as scanned ones: sparse ones let leaks be."""
    first = np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(normals, first)
    steps = [size / 4 * (a * first + b * second) for a in (-1, 1) for b in (-1, 1)]
    return np.concatenate([points + step for step in steps]), np.tile(normals, (4, 1))


def _free(surface: Array, cells: Array, normals: Array) -> tuple[Array, Array]:
    """Voxels in front of a surface up to the next one, and those that nothing encloses.

    Args:
        surface: voxels with points.
        cells: (N, 3) points in voxels.
        normals: (N, 3).
    """
    seen = np.zeros_like(surface)
    at = cells + 2.0 * normals  # not the second layer of a scan that drifted
    while len(at):
        index = np.floor(at).astype(np.int64)
        inside = np.asarray(((index >= 0) & (index < surface.shape)).all(axis=1), bool)
        index[~inside] = 0
        free = inside & ~surface[tuple(index.T)]
        seen[tuple(index[free].T)] = True
        at, normals = at[free] + normals[free], normals[free]
    hit = [np.broadcast_to(surface.any(axis=k, keepdims=True), surface.shape) for k in range(3)]
    return seen, np.sum(hit, axis=0) <= 1
