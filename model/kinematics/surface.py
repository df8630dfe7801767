"""Sampled and ray-traceable surface of a part, for contact and motion sweeps.

No inside is needed: thin shells, open and unoriented meshes, and clouds work.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from model.core.articulated_object import Part
from model.core.geometry import Mesh, PointCloud
from model.core.memory import LruCache

POINTS = 4096
"""Samples of a part."""
INSET = 1e-3
"""Distance of corner samples from their corner, in the part's diagonal."""
CACHED_PATHS, CACHED_ROWS = 4096, 30_000
"""Most paths against other surfaces whose penetrations are cached, and penetrations in all."""
COARSE = 384
"""Samples of them that represent the part's volume."""
SURFELS = 20_000
"""Most discs (surfels) of a cloud."""
NEIGHBOURS = (8, 16, 32)
"""Neighbours that a disc's plane is fitted to: few for thin boards, many for noise."""
PLANAR = 0.3
"""Largest ratio of a disc's two smallest variances: rims of thin boards have no normal."""
AGREEMENT = 0.88
"""Smallest mean cosine between a disc's normal and its neighbours'."""
SURFEL_RADIUS = 0.75
"""Radius of a disc in mean distances to the four nearest points: neighbours overlap."""

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Hits:
    """First hits of rays.

    Attributes:
        distance: (R,) in lengths of the ray's direction; infinite where nothing is hit.
        element: (R,) triangle of a mesh, disc of a cloud.
        normals: (R, 3) unit, by the triangle's winding.
    """

    distance: FloatArray
    normals: FloatArray
    element: npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Triangles:
    """Triangles that rays hit, whatever the number of samples.

    Attributes:
        vertices, faces: (V, 3) and (F, 3).
    """

    vertices: npt.NDArray[np.float32]
    faces: npt.NDArray[np.uint32]

    @cached_property
    def bounds(self) -> FloatArray:
        """(2, 3) lowest and highest corner of the faces."""
        corners = self.vertices[np.unique(self.faces)]
        return np.stack([corners.min(0), corners.max(0)])

    @cached_property
    def scene(self) -> Any:
        """The ray-casting scene of open3d."""
        import open3d as o3d

        scene = o3d.t.geometry.RaycastingScene()
        scene.add_triangles(
            o3d.core.Tensor.from_numpy(self.vertices), o3d.core.Tensor.from_numpy(self.faces)
        )
        return scene


@dataclass(frozen=True, eq=False)
class Surface:
    """Surface of one part at rest, metres, object frame.

    Attributes:
        link: the part's link.
        points: (N, 3) samples.
        normals: (N, 3) unit normals; a cloud's have no meaningful sign.
        triangles: the mesh, or a disc per point of a cloud.
        oriented: whether the triangles may be consistently wound (False for clouds).
        spacing: typical distance between neighbouring samples.
        resolution: limit of a cloud's precision: the spacing of its discs, or three times its noise
            if that is more. 0 for a mesh.
    """

    link: str
    points: FloatArray
    normals: FloatArray
    triangles: Triangles
    oriented: bool
    spacing: float
    resolution: float

    @cached_property
    def bounds(self) -> FloatArray:
        """(2, 3) lowest and highest corner of samples and triangles' vertices."""
        corners = self.triangles.bounds
        low = np.minimum(self.points.min(0), corners[0])
        return np.stack([low, np.maximum(self.points.max(0), corners[1])])

    @cached_property
    def diagonal(self) -> float:
        """Length of the box's diagonal."""
        return float(np.linalg.norm(self.bounds[1] - self.bounds[0]))

    @cached_property
    def tree(self) -> KDTree:
        """KD-tree of the samples."""
        return KDTree(self.points)

    @cached_property
    def cache(self) -> LruCache[tuple[int, bytes], Any]:
        """Penetrations of the samples, see :mod:`model.kinematics.penetration`."""
        return LruCache(CACHED_PATHS, CACHED_ROWS)

    @property
    def _scene(self) -> Any:
        return self.triangles.scene

    def cast(self, origins: FloatArray, directions: FloatArray) -> Hits:
        """Cast (R, 3) rays, whose directions need not be unit, to their first hits."""
        import open3d as o3d

        rays = np.concatenate([origins, directions], axis=1).astype(np.float32)
        found = self._scene.cast_rays(o3d.core.Tensor.from_numpy(rays))
        face = found["primitive_ids"].numpy().astype(np.int64)
        return Hits(
            found["t_hit"].numpy().astype(np.float64),
            found["primitive_normals"].numpy().astype(np.float64),
            face if self.oriented else face % (len(self.triangles.faces) // 2),
        )

    def count(self, origins: FloatArray, directions: FloatArray) -> npt.NDArray[np.int64]:
        """(R,) number of triangles that each ray hits."""
        import open3d as o3d

        rays = np.concatenate([origins, directions], axis=1).astype(np.float32)
        found = self._scene.count_intersections(o3d.core.Tensor.from_numpy(rays))
        return found.numpy().astype(np.int64)

    @cached_property
    def _solid(self) -> tuple[npt.NDArray[np.bool_], KDTree]:
        """Mask of the coarse samples that bound a solid, and the KD-tree of these samples."""
        points, normals = self.points[:COARSE], self.normals[:COARSE]
        out = np.zeros(len(points), bool)
        if self.oriented:
            gap = 1e-4 * self.diagonal * normals
            out = self._enclosed(points - gap) & ~self._enclosed(points + gap)
        return out, KDTree(points)

    def bounds_solid(self, points: FloatArray) -> npt.NDArray[np.bool_]:
        """(M,) whether the surface near points on it bounds a solid and is wound outwards.

        False for sheets of a scan, open boxes and clouds.
        """
        solid, tree = self._solid
        if not solid.any() or not len(points):
            return np.zeros(len(points), bool)
        return solid[tree.query(points)[1]]

    def _enclosed(self, points: FloatArray) -> npt.NDArray[np.bool_]:
        """(M,) whether points are inside, by the winding number along rays in all directions."""
        import open3d as o3d

        directions = np.array([d for d in np.ndindex(3, 3, 3) if d != (1, 1, 1)]) - 1.0
        # 14 directions, off the edges of boxes
        directions = directions[np.abs(directions).sum(1) != 2] + 1e-3
        out = np.ones(len(points), bool)
        for direction in directions:
            left = np.flatnonzero(out)
            if not len(left):
                break
            same = np.broadcast_to(direction, (len(left), 3))
            rays = np.concatenate([points[left], same], axis=1).astype(np.float32)
            found = self._scene.list_intersections(o3d.core.Tensor.from_numpy(rays))
            winding = np.zeros(len(left))
            face, ray = found["primitive_ids"].numpy(), found["ray_ids"].numpy()
            corners = self.triangles.vertices[self.triangles.faces[face]]
            a, b, c = np.moveaxis(corners.astype(np.float64), 1, 0)
            np.add.at(winding, ray, np.sign(np.cross(b - a, c - a) @ direction))
            out[left] = winding >= 1
        return out

    def distance(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(M,) distance of points to the triangles, and (M, 3) the closest points on them."""
        import open3d as o3d

        query = points.astype(np.float32)
        closest = self._scene.compute_closest_points(o3d.core.Tensor.from_numpy(query))[
            "points"
        ].numpy()
        return np.linalg.norm(points - closest, axis=1), closest.astype(np.float64)


_CACHE: WeakKeyDictionary[Part, dict[int, Surface | None]] = WeakKeyDictionary()
_MESHES: WeakKeyDictionary[Mesh, Triangles] = WeakKeyDictionary()


def surface_of(part: Part, count: int = POINTS) -> Surface | None:
    """Return the surface of ``part``, computed once; None where it has no face and no point.

    A mesh is preferred to a cloud. Sampling is deterministic.
    """
    known = _CACHE.setdefault(part, {})
    if count not in known:
        known[count] = _build(part, count)
    return known[count]


def _build(part: Part, count: int) -> Surface | None:
    if part.mesh is not None and len(part.mesh.faces):
        found = _of_mesh(part.link, part.mesh, count)
        if part.completed and part.cloud is not None and len(part.cloud):
            # Completed, it is no more precise than its scan.
            found = replace(found, resolution=_of_cloud(part.link, part.cloud, count).resolution)
        return found
    if part.cloud is not None and len(part.cloud):
        return _of_cloud(part.link, part.cloud, count)
    return None


def _of_mesh(link: str, mesh: Mesh, count: int) -> Surface:
    rng = np.random.default_rng(0)
    areas = mesh.face_areas
    total = float(areas.sum())
    # Vertices touch first, and random samples miss them. Moved slightly into a face, rays from
    # them don't run along adjacent faces.
    used, corner = np.unique(mesh.faces, return_index=True)
    if len(used) > count // 4:
        corner = rng.choice(corner, count // 4, replace=False)
    face = corner // 3
    at = mesh.vertices[mesh.faces.reshape(-1)[corner]]
    inward = mesh.triangles[face].mean(axis=1) - at
    length = np.maximum(np.linalg.norm(inward, axis=1, keepdims=True), 1e-30)
    low, high = mesh.bounds
    points = at + inward * np.minimum(INSET * float(np.linalg.norm(high - low)) / length, 0.3)
    normals = mesh.face_normals[face]
    if total > 0:
        drawn, face = _on_triangles(mesh, areas, count - len(points), rng)
        points = np.concatenate([points, drawn])
        normals = np.concatenate([normals, mesh.face_normals[face]])
    order = rng.permutation(len(points))
    spacing = float(np.sqrt(total / max(len(points), 1)))
    if mesh not in _MESHES:
        _MESHES[mesh] = Triangles(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32))
    return Surface(link, points[order], normals[order], _MESHES[mesh], True, spacing, 0.0)


def _on_triangles(
    mesh: Mesh, areas: FloatArray, count: int, rng: np.random.Generator
) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """Area-weighted points, one in each of ``count`` equal shares of the area."""
    cumulated = np.cumsum(areas)
    share = (np.arange(count) + rng.random(count)) / count * cumulated[-1]
    face = np.minimum(np.searchsorted(cumulated, share), len(areas) - 1)
    root, v = np.sqrt(rng.random(count))[:, None], rng.random(count)[:, None]
    a, b, c = np.moveaxis(mesh.triangles[face], 1, 0)
    return (1 - root) * a + root * (1 - v) * b + root * v * c, face


@dataclass(frozen=True, eq=False)
class _Discs:
    """Discs of a cloud, whatever the number of samples.

    Attributes:
        points, normals: (N, 3) in random order: the first ones are the samples.
        apart: median spacing. resolution: see :class:`Surface`.
    """

    points: FloatArray
    normals: FloatArray
    triangles: Triangles
    apart: float
    resolution: float


_DISCS: WeakKeyDictionary[PointCloud, _Discs] = WeakKeyDictionary()


def _of_cloud(link: str, cloud: PointCloud, count: int) -> Surface:
    if cloud not in _DISCS:
        _DISCS[cloud] = _discs_of(cloud)
    made = _DISCS[cloud]
    points, normals = made.points[:count], made.normals[:count]
    spacing = made.apart * float(np.sqrt(len(made.points) / len(points)))
    return Surface(link, points, normals, made.triangles, False, spacing, made.resolution)


def _discs_of(cloud: PointCloud) -> _Discs:
    rng = np.random.default_rng(0)
    everything = cloud.points.astype(np.float64)
    chosen = np.arange(len(everything))
    if len(chosen) > SURFELS:
        chosen = np.sort(rng.choice(len(everything), SURFELS, replace=False))
    points = everything[chosen]
    distance, index = KDTree(points).query(points, k=min(NEIGHBOURS[-1], len(points)))
    distance, index = distance.reshape(len(points), -1), index.reshape(len(points), -1)
    centers, normals, flat, noise = _planes(points, index)
    agreement = np.abs(np.einsum("ni,nki->nk", normals, normals[index[:, : NEIGHBOURS[0]]])).mean(
        axis=1
    )
    flat &= agreement > AGREEMENT
    flat[np.argmax(agreement)] = True
    if cloud.normals is not None:
        normals = cloud.normals[chosen].astype(np.float64)
    near = distance[:, 1:5]
    radius = near.mean(axis=1) if near.shape[1] else np.full(len(points), 1e-6)
    resolution = float(np.median(radius))
    # An outlier must not become a large disc.
    radius = SURFEL_RADIUS * np.minimum(radius, 3 * resolution + 1e-12)
    vertices, faces = _discs(centers[flat], normals[flat], radius[flat])
    order = rng.permutation(len(points))
    finest = max(resolution, 3 * float(np.median(noise[flat])))
    return _Discs(points[order], normals[order], Triangles(vertices, faces), resolution, finest)


def _planes(
    points: FloatArray, index: npt.NDArray[np.int64]
) -> tuple[FloatArray, FloatArray, npt.NDArray[np.bool_], FloatArray]:
    """Fit planes to the (N, k) neighbourhoods of points, at the flattest scale.

    Returns:
        (N, 3) points moved onto their planes, (N, 3) normals, (N,) whether they are flat, and
        (N,) spread about them.
    """
    best = np.full(len(points), np.inf)
    centers, normals, spread = points.copy(), np.zeros_like(points), np.zeros(len(points))
    for count in NEIGHBOURS:
        around = points[index[:, :count]]
        mean = around.mean(axis=1)
        centred = around - mean[:, None]
        values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", centred, centred))
        ratio = values[:, 0] / np.maximum(values[:, 1], 1e-30)
        better = ratio < best
        best[better], normal = ratio[better], vectors[:, :, 0]
        height = np.einsum("ni,ni->n", mean - points, normal)[:, None]
        centers[better], normals[better] = (points + height * normal)[better], normal[better]
        freedom = max(around.shape[1] - 3, 1)
        spread[better] = np.sqrt(np.maximum(values[:, 0], 0) / freedom)[better]
    return centers, normals, best <= PLANAR, spread


def _discs(
    points: FloatArray, normals: FloatArray, radius: FloatArray
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.uint32]]:
    """Squares of the discs' areas, centred at the points and normal to their normals."""
    helper = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    side = np.cross(normals, helper)
    side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-12)
    other = np.cross(normals, side)
    half = (radius * np.sqrt(np.pi) / 2)[:, None]
    u, v = half * side, half * other
    corners = np.stack([points - u - v, points + u - v, points + u + v, points - u + v], axis=1)
    first = 4 * np.arange(len(points))[:, None]
    faces = np.concatenate([first + np.array([0, 1, 2]), first + np.array([0, 2, 3])])
    return corners.reshape(-1, 3).astype(np.float32), faces.astype(np.uint32)
