"""Convex bodies: k-DOPs, primitives, and the free space that they may cover.

Discrete oriented polytopes (k-DOPs) are bodies by their extent along fixed directions. They replace
convex hulls while thousands of candidates are compared (Klosowski et al., 1998): the union of two
is one ``maximum``. With the part's own face normals among the directions they equal the hulls of
boards and boxes, and are slightly larger for other bodies. At the end similar primitives replace
polyhedra, as simulators collide them faster. Free space of a part's box is its voxels that are
reachable from outside.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from model.core.geometry import Mesh, affine
from model.core.shapes import Hull, Kind, Primitive, coarse, thick_hull

VOXELS = 80_000
"""About how many the part's box has."""
LONGEST = 160
"""Most voxels along a side of it."""

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Occupancy:
    """Voxels of a part's box, with a border of one voxel.

    Attributes:
        low: (3,) lower corner of voxel (0, 0, 0), metres, object frame.
        size: edge of a voxel in metres.
        surface: (X, Y, Z) voxels that the surface passes through.
        outside: (X, Y, Z) voxels reachable from outside the box without crossing the surface.
            All others are sealed in, which counts as solid.
    """

    low: Floats
    size: float
    surface: npt.NDArray[np.bool_]
    outside: npt.NDArray[np.bool_]

    @cached_property
    def free(self) -> npt.NDArray[np.bool_]:
        """(X, Y, Z) reachable voxels of the box without the border."""
        out = self.outside.copy()
        for axis in range(3):
            np.moveaxis(out, axis, 0)[[0, -1]] = False
        return out

    @cached_property
    def solid(self) -> npt.NDArray[np.bool_]:
        """(X, Y, Z) voxels that are sealed in."""
        return ~self.surface & ~self.outside

    @property
    def free_count(self) -> int:
        """Number of free voxels."""
        return int(self.free.sum())

    def centers(self, mask: npt.NDArray[np.bool_]) -> Floats:
        """(N, 3) centres of the voxels of ``mask``."""
        return self.low + (np.argwhere(mask) + 0.5) * self.size

    def count_inside(self, mask: npt.NDArray[np.bool_], planes: Floats, bounds: Floats) -> float:
        """Count the voxels of ``mask`` whose centres are inside a convex body; of many on a coarser
        lattice.

        Args:
            planes: (P, 4) with ``n·x + d <= 0`` inside.
            bounds: (2, 3) of the body.
        """
        first = np.ceil((bounds[0] - self.low) / self.size - 0.5).astype(int)
        last = np.floor((bounds[1] - self.low) / self.size - 0.5).astype(int) + 1
        first, last = np.maximum(first, 0), np.minimum(last, mask.shape)
        extent = np.maximum(last - first, 0)
        total = int(np.prod(extent))
        if not total:
            return 0.0
        step = max(1, int(np.ceil((total / 4000) ** (1 / 3))))
        # The middle of each coarse cell represents it.
        begin = first + np.minimum((step - 1) // 2, extent - 1)
        part = mask[begin[0] : last[0] : step, begin[1] : last[1] : step, begin[2] : last[2] : step]
        if not part.any():
            return 0.0
        at = self.low + (begin + np.argwhere(part) * step + 0.5) * self.size
        inside = (at @ planes[:, :3].T + planes[:, 3] <= 0).all(axis=1)
        return float(inside.sum()) * total / part.size


def occupancy(triangles: Floats, voxels: int = VOXELS) -> Occupancy:
    """Voxelise (F, 3, 3) triangles; ``voxels`` is about how many the box has."""
    from scipy.ndimage import label

    corners = triangles.reshape(-1, 3)
    low, high = corners.min(axis=0), corners.max(axis=0)
    extent = np.maximum(high - low, 1e-3 * float((high - low).max()) + 1e-9)
    size = max(float(np.prod(extent) / voxels) ** (1 / 3), float(extent.max()) / LONGEST)
    shape = np.maximum(np.ceil(extent / size).astype(int), 1)
    start = (low + high) / 2 - shape * size / 2 - size
    at = np.floor((surface_lattice(triangles, size / 2)[0] - start) / size).astype(int)
    at = np.clip(at, 1, shape)
    surface = np.zeros(shape + 2, bool)
    surface[at[:, 0], at[:, 1], at[:, 2]] = True
    regions = label(~surface)[0]  # type: ignore[index]
    return Occupancy(start, size, surface, regions == regions[0, 0, 0])


def surface_lattice(triangles: Floats, spacing: float) -> tuple[Floats, npt.NDArray[np.int64]]:
    """Return (N, 3) points at most ``spacing`` apart on (F, 3, 3) triangles, and (N,) triangles."""
    edges = np.linalg.norm(np.roll(triangles, -1, axis=1) - triangles, axis=2)
    turn = (edges.argmax(axis=1)[:, None] + np.arange(3)) % 3
    a, b, c = np.moveaxis(np.take_along_axis(triangles, turn[:, :, None], axis=1), 1, 0)
    longest = edges.max(axis=1)
    twice_area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    height = np.divide(twice_area, longest, out=np.zeros_like(longest), where=longest > 0)
    rows = np.maximum(np.ceil(height / spacing).astype(np.int64), 1) + 1
    columns = np.maximum(np.ceil(longest / spacing).astype(np.int64), 1) + 1
    count = rows * columns
    face = np.repeat(np.arange(len(triangles)), count)
    number = np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count)
    t = (number // columns[face] / (rows[face] - 1))[:, None]
    u = (number % columns[face] / (columns[face] - 1))[:, None]
    return (1 - t) * ((1 - u) * a[face] + u * b[face]) + t * c[face], face


SAMPLES = 4000
"""Sampled free voxels."""
NORMALS = 10
"""Most face normals among the directions, beside the 13 of a cube."""
SAME = 0.996
"""Cosine above which two directions count as one: 5°."""


_CUBE = np.array([d for d in np.ndindex(3, 3, 3) if d > (1, 1, 1)], np.float64) - 1.0


class FaceExtents:
    """Extents of a part's faces with the solid beneath them, and samples of its free space.

    Attributes:
        mesh, space: of the part.
        directions: (K, 3) unit.
        points: (N, 3) lattice on the faces; ``point_face`` (N,) their faces.
        low, high: (F, K) extents of each face and of the sealed voxels nearest to it.
        beneath: (S, 3) centres of the sealed voxels; ``owner`` (S,) the nearest face of each.
    """

    def __init__(self, mesh: Mesh, space: Occupancy, rng: np.random.Generator) -> None:
        self.mesh, self.space = mesh, space
        self.directions = _directions(mesh)
        self.points, self.point_face = surface_lattice(mesh.triangles, space.size / 2)
        reach = mesh.vertices @ self.directions.T
        corners = reach[mesh.faces]
        self.low, self.high = corners.min(axis=1), corners.max(axis=1)
        self.beneath = space.centers(space.solid)
        self.owner = np.zeros(0, np.int64)
        if len(self.beneath):
            self._add_beneath()
        self._probe(rng)

    def _add_beneath(self) -> None:
        from scipy.ndimage import distance_transform_edt

        space = self.space
        cell = np.floor((self.points - space.low) / space.size).astype(np.int64)
        cell = np.clip(cell, 0, np.array(space.surface.shape) - 1)
        face_of = np.full(space.surface.shape, -1, np.int64)
        face_of[tuple(cell.T)] = self.point_face
        near = distance_transform_edt(face_of < 0, return_distances=False, return_indices=True)
        assert near is not None
        owner = face_of[tuple(near)][space.solid]
        order = np.argsort(owner, kind="stable")
        self.beneath, self.owner = self.beneath[order], owner[order]
        face, start = np.unique(self.owner, return_index=True)
        reach = self.beneath @ self.directions.T
        self.low[face] = np.minimum(self.low[face], np.minimum.reduceat(reach, start))
        self.high[face] = np.maximum(self.high[face], np.maximum.reduceat(reach, start))

    def _probe(self, rng: np.random.Generator) -> None:
        """Sample free voxels, half of them near the surface, where narrow hollows are."""
        from scipy.ndimage import binary_dilation

        free, space = self.space.free, self.space
        near = free & np.asarray(binary_dilation(space.surface, iterations=2), bool)
        chosen, weights = [], []
        for mask in (near, free & ~near):
            index = np.flatnonzero(mask)
            kept = rng.choice(index, min(len(index), SAMPLES // 2), replace=False)
            chosen.append(kept)
            weights.append(np.full(len(kept), len(index) / max(len(kept), 1)))
        at = np.stack(np.unravel_index(np.concatenate(chosen), free.shape), axis=1)
        self.weights = np.concatenate(weights)
        self.probes = self.directions @ (space.low + (at + 0.5) * space.size).T

    def extent(self, faces: npt.NDArray[np.int64]) -> Floats:
        """(2, K) extent of some faces, at least half a voxel thick."""
        extent = np.stack([self.low[faces].min(axis=0), self.high[faces].max(axis=0)])
        lack = np.maximum(0.5 * self.space.size - (extent[1] - extent[0]), 0.0) / 2
        return np.stack([extent[0] - lack, extent[1] + lack])

    def covers(self, extent: Floats) -> float:
        """Estimate the number of free voxels in a (2, K) body."""
        (low, high), (x, y, z) = extent, self.probes[:3]
        # The axes first: they exclude most, and contiguous rows compare fast.
        inside = (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1])
        index = np.flatnonzero(inside & (z >= low[2]) & (z <= high[2]))
        if not len(index):
            return 0.0
        here = self.probes[3:, index]
        within = (here >= low[3:, None]) & (here <= high[3:, None])
        return float(self.weights[index[within.all(axis=0)]].sum())

    def corners(self, faces: npt.NDArray[np.int64]) -> Floats:
        """(N, 3) vertices of some faces."""
        return self.mesh.vertices[np.unique(self.mesh.faces[faces])]

    def hull(self, faces: npt.NDArray[np.int64], corners: int) -> Hull:
        """The convex hull of some faces, with at most about ``corners`` vertices."""
        return coarse(thick_hull(self.corners(faces), 0.5 * self.space.size), corners)


def _directions(mesh: Mesh) -> Floats:
    """(K, 3) unit: the axes, a cube's diagonals, and the normals with the largest area."""
    cube = _CUBE[np.argsort(np.abs(_CUBE).sum(axis=1), kind="stable")]
    found = list(cube / np.linalg.norm(cube, axis=1, keepdims=True))
    normals, areas = mesh.face_normals, mesh.face_areas.copy()
    for direction in found:
        areas[np.abs(normals @ direction) > SAME] = 0.0
    # Faces with similar normals are grouped by rounding.
    key = np.round(normals * np.sign(normals.sum(axis=1, keepdims=True) + 1e-12) * 16)
    group = np.unique((key + 16) @ (33**2, 33, 1), return_inverse=True)[1]
    for _ in range(NORMALS):
        weight = np.bincount(group, areas)
        if not weight.max() > 0.005 * float(mesh.face_areas.sum()):
            break
        face = np.flatnonzero(group == weight.argmax())
        found.append(normals[face[areas[face].argmax()]])
        areas[np.abs(normals @ found[-1]) > SAME] = 0.0
    return np.array(found)


BOX = 0.97
"""Smallest share of its box that a box-like hull fills."""
ROUND = 0.03
"""Largest deviation of vertices from a round surface, over its radius."""
CORNERS = 20
"""Fewest vertices of a round hull."""


def primitive_of(hull: Hull) -> Primitive | None:
    """Fit a box, sphere, cylinder or capsule; None where none is similar enough."""
    found = _box(hull)
    if found is not None or len(hull.vertices) < CORNERS:
        return found
    found = _sphere(hull)
    if found is not None:
        return found
    for axis in _axes(hull):
        found = _cylinder(hull, axis) or _capsule(hull, axis)
        if found is not None:
            return found
    return None


def _box(hull: Hull) -> Primitive | None:
    a, b, c = np.moveaxis(hull.vertices[hull.faces], 1, 0)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    normals = hull.planes[:, :3]
    first = normals[_heaviest(normals, areas)]
    flat = normals - np.outer(normals @ first, first)
    length = np.linalg.norm(flat, axis=1)
    beside = areas * (length > 0.99)
    if not beside.any():
        return None
    second = flat[_heaviest(normals, beside)]
    second = second / np.linalg.norm(second)
    rotation = np.stack([first, second, np.cross(first, second)], axis=1)
    local = hull.vertices @ rotation
    low, high = local.min(axis=0), local.max(axis=0)
    if hull.volume < BOX * float(np.prod(high - low)):
        return None
    return _placed("box", rotation, rotation @ ((low + high) / 2), tuple(high - low))


def _heaviest(normals: Floats, areas: Floats) -> int:
    """Face whose normal, up to sign, has the largest total area."""
    same = np.abs(normals @ normals.T) > 0.999
    return int((same @ areas * (areas > 0)).argmax())


def _axes(hull: Hull) -> list[Floats]:
    """Candidate axes of revolution: of the largest flat faces, then the principal axes."""
    a, b, c = np.moveaxis(hull.vertices[hull.faces], 1, 0)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    flat = hull.planes[_heaviest(hull.planes[:, :3], areas), :3]
    centred = hull.vertices - hull.vertices.mean(axis=0)
    return [flat, *np.linalg.svd(centred, full_matrices=False)[2]]


def _sphere(hull: Hull) -> Primitive | None:
    at = hull.vertices
    system = np.column_stack([2 * at, np.ones(len(at))])
    answer = np.linalg.lstsq(system, (at**2).sum(axis=1), rcond=None)[0]
    center = answer[:3]
    radii = np.linalg.norm(at - center, axis=1)
    radius = float(radii.max())
    whole = hull.volume > 0.8 * 4 / 3 * np.pi * radius**3
    if not whole or np.ptp(radii) > ROUND * radius:
        return None
    return _placed("sphere", np.eye(3), center, (radius,))


def _along(hull: Hull, axis: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Frame (3, 3) with z along the axis, a point on it, and the vertices' heights and radii."""
    helper = np.eye(3)[np.abs(axis).argmin()]
    x = np.asarray(np.cross(axis, helper), np.float64)
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(axis, x), axis], axis=1)
    local = hull.vertices @ rotation
    system = np.column_stack([2 * local[:, :2], np.ones(len(local))])
    answer = np.linalg.lstsq(system, (local[:, :2] ** 2).sum(axis=1), rcond=None)[0]
    radii = np.linalg.norm(local[:, :2] - answer[:2], axis=1)
    return rotation, np.array([*answer[:2], 0.0]), local[:, 2], radii


def _cylinder(hull: Hull, axis: Floats) -> Primitive | None:
    rotation, middle, height, radii = _along(hull, axis)
    low, high, radius = float(height.min()), float(height.max()), float(radii.max())
    ends = np.minimum(height - low, high - height).max()
    whole = hull.volume > 0.9 * np.pi * radius**2 * (high - low)
    if np.ptp(radii) > ROUND * radius or ends > ROUND * (high - low) or not whole:
        return None
    middle[2] = (low + high) / 2
    return _placed("cylinder", rotation, rotation @ middle, (radius, high - low))


def _capsule(hull: Hull, axis: Floats) -> Primitive | None:
    rotation, middle, height, radii = _along(hull, axis)
    low, high, radius = float(height.min()), float(height.max()), float(radii.max())
    length = high - low - 2 * radius
    if length < 0.2 * radius:
        return None
    beyond = np.maximum(np.maximum(low + radius - height, height - (high - radius)), 0.0)
    away = np.hypot(beyond, radii)
    volume = np.pi * radius**2 * (length + 4 / 3 * radius)
    if np.ptp(away) > ROUND * radius or hull.volume < 0.8 * volume:
        return None
    middle[2] = (low + high) / 2
    return _placed("capsule", rotation, rotation @ middle, (radius, length))


def _placed(kind: Kind, rotation: Floats, center: Floats, sizes: tuple[float, ...]) -> Primitive:
    pose = affine(rotation, center)
    return Primitive(kind, pose, tuple(float(s) for s in sizes))
