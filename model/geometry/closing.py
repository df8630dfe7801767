"""Closed surfaces through points that were seen from some sides only.

Space in front of a surface is free, as somebody looked through it; what surfaces enclose along two
of the three axes is solid, also where nobody saw the third; elsewhere a surface is a board.
Points on the border of the solid that no real point covers close the surface, which is then
reconstructed as a whole. Booleans of solids are those of the library Manifold.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from model.core.point_cloud import PointCloud
from model.geometry.reconstruct import poisson, spacing_of

if TYPE_CHECKING:
    from manifold3d import Manifold

Array = npt.NDArray[Any]

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
