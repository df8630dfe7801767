"""The sampled parts of one object in the working frame, with their distances and contacts.

Samples of surfaces are deterministic; there are less noisy versions of them. Working frame: origin
at the centre of the object's bounding box, +z up, the main horizontal directions along x and y, the
bounding box's diagonal is 1.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from model.core.articulated_object import Part, SegmentedObject
from model.prediction.geometric.shape import NOTHING, TINY, PartShape, rotation

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Noise:
    """Distance of points from their surface.

    Attributes:
        sigma: standard deviation across the surface (m), curvature included; only an upper bound
            unless ``measured``.
        measured: the points lie along a surface, so that noise and shape can be separated.
        coarse: the noise is larger than the spacing of the points.
    """

    sigma: float = 0.0
    measured: bool = False
    coarse: bool = False


@dataclass(frozen=True, eq=False)
class SurfaceSample:
    """A sampled surface in metres, object frame.

    Attributes:
        points: (N, 3). normals: (N, 3) unit, sign unknown.
        outline: (M, 3) points that give the extents.
        area: m²; an estimate for clouds.
        noise: 0 for meshes.
    """

    points: Array
    normals: Array
    outline: Array
    area: float
    noise: Noise


def part_surface(part: Part, count: int, seed: int) -> SurfaceSample:
    """Sample a part's mesh, or its cloud if it has no mesh.

    Args:
        part: to sample. count: requested points; a small cloud gives fewer.
        seed: random seed of the sampling.
    """
    rng = np.random.default_rng(seed)
    mesh = part.mesh
    if mesh is not None and len(mesh.faces):
        area = mesh.face_areas
        total = float(area.sum())
        if total <= 0:
            points = mesh.vertices[np.unique(mesh.faces)][:count]
            return SurfaceSample(points, np.zeros_like(points), points, 0.0, Noise())
        # Stratified along the cumulated area: even coverage from few points.
        at = (np.arange(count) + rng.random(count)) / count * total
        face = np.minimum(np.searchsorted(np.cumsum(area), at), len(area) - 1)
        s, t = np.sqrt(rng.random(count)), rng.random(count)
        w = np.stack([1 - s, s * (1 - t), s * t], 1)
        points = np.einsum("nk,nkd->nd", w, mesh.triangles[face])
        used = mesh.vertices[np.unique(mesh.faces[area > 0])]
        return SurfaceSample(points, mesh.face_normals[face], used, total, Noise())
    assert part.cloud is not None
    cloud = part.cloud
    points = cloud.points.astype(np.float64)
    index = np.arange(len(points))
    if len(points) > count:
        index = np.sort(rng.choice(len(points), count, replace=False))
    index = index[~outliers(points[index])]
    kept = points[index]
    outline = points if len(points) <= 20000 else points[:: len(points) // 20000]
    outline = outline[~outliers(outline)]
    normals, spacing, noise = cloud_normals(kept)
    if cloud.normals is not None:
        normals = cloud.normals[index].astype(np.float64)
    return SurfaceSample(kept, normals, outline, float(len(kept) * spacing**2), noise)


OUTLIER_DISTANCE = 4.0
"""Multiple of the median distance to the neighbours beyond which a point is an outlier."""
MAX_OUTLIER_SHARE = 0.1
"""A larger share of distant points is a sparsely sampled region of the part."""


def outliers(points: Array) -> npt.NDArray[np.bool_]:
    """(N,) mask of isolated points (statistical outlier removal, Rusu et al., 2008)."""
    if len(points) < 50:
        return np.zeros(len(points), bool)
    distance = KDTree(points).query(points, k=7)[0][:, 1:].mean(1)
    found = distance > OUTLIER_DISTANCE * np.median(distance)
    return found if found.mean() <= MAX_OUTLIER_SHARE else np.zeros(len(points), bool)


NEIGHBOURS = (14, 40, 100)
"""Sizes of the neighbourhoods in which noise is measured, smallest first."""
ISOTROPIC = (0.62, 0.35)
"""Smallest over middle and over largest spread of a neighbourhood above which it is noise rather
than surface (pure noise has .74 and .55, surfaces below .55, also at edges)."""


def cloud_normals(points: Array) -> tuple[Array, float, Noise]:
    """(N, 3) normals of planes through the nearest neighbours, point spacing (m), and noise."""
    if len(points) < 4:
        return np.zeros_like(points), 0.0, Noise()
    tree = KDTree(points)
    k = min(NEIGHBOURS[0], len(points))
    distance, index = tree.query(points, k=k)
    spreads, vectors = _spreads(points[index])
    spacing = float(np.median(distance[:, min(2, k - 1)]))
    return vectors[:, :, 0], spacing, _noise(points, tree, spreads)


def _spreads(neighbours: Array) -> tuple[Array, Array]:
    """(N, K, 3) → standard deviations (N, 3), smallest first, and their directions (N, 3, 3)."""
    local = neighbours - neighbours.mean(1, keepdims=True)
    values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", local, local) / local.shape[1])
    return np.sqrt(np.maximum(values, 0.0)), vectors


TWO_FACES = 2.2
"""Kurtosis of the offsets across a surface below which they lie on the two faces of a thin board:
that of Gaussian noise is 3, that of two faces 1."""


def _noise(points: Array, tree: KDTree, spreads: Array) -> Noise:
    """Smallest spread of the smallest neighbourhoods that are flat."""
    some = points[:: max(1, len(points) // 300)]
    for step, k in enumerate(NEIGHBOURS):
        across = None
        if step:
            if k > len(points) // 3:
                break
            near = points[tree.query(some, k=k)[1]]
            spreads, directions = _spreads(near)
            across = np.einsum("nki,ni->nk", near - near.mean(1, keepdims=True), directions[..., 0])
        thin, middle, long = np.median(spreads, axis=0)
        flat, round_ = thin <= ISOTROPIC[0] * middle, thin > ISOTROPIC[1] * long
        if flat and across is not None:
            return _flat_noise(across)
        if flat or not round_:
            return Noise(float(thin), bool(flat), step > 0)
    return Noise(float(np.median(spreads[:, 0])), False, True)


def _flat_noise(across: Array) -> Noise:
    """Noise from offsets (N, K) across flat neighbourhoods: on one face, or on a board's two."""
    variance = float(np.median((across**2).mean(1)))
    fourth = float(np.median((across**4).mean(1)))
    if variance <= 0 or fourth > TWO_FACES * variance**2:
        return Noise(variance**0.5, True, True)
    # Two faces 2 a apart: variance a² + sigma², fourth cumulant -2 a⁴.
    apart = np.sqrt((3 * variance**2 - fourth) / 2)
    return Noise(float(np.sqrt(max(variance - apart, 0.0))), True, False)


REMAINING = {True: 0.5, False: 0.6}
"""Share of the noise left after denoising, by whether it was measured."""


def denoised(sample: SurfaceSample, sigma: float) -> SurfaceSample:
    """The same part with less noise; one without noise (a mesh) is returned unchanged.

    Points along a surface are projected onto the plane of their neighbours. A part hardly larger
    than the noise shrinks to its extents without noise.

    Args:
        sample: of a part. sigma: standard deviation of the scanner's noise (m); a larger noise of
            the part itself takes precedence.
    """
    noise = sample.noise
    if not noise.sigma:
        return sample
    worst = max(noise.sigma, sigma)
    if not noise.coarse or len(sample.points) < NEIGHBOURS[1]:
        return replace(sample, noise=replace(noise, sigma=worst))
    move = _flattened if noise.measured else _shrunk
    points = move(sample.points, sample.points, sigma)
    outline = points
    if len(sample.outline) != len(sample.points):
        outline = move(sample.outline, sample.points, sigma)
    normals, _, _ = cloud_normals(points)
    left = replace(noise, sigma=REMAINING[noise.measured] * worst)
    return replace(sample, points=points, outline=outline, normals=normals, noise=left)


def _shrunk(points: Array, reference: Array, sigma: float) -> Array:
    """Points scaled so that the variance along each principal axis loses that of the noise."""
    center = reference.mean(0)
    variance, axes = np.linalg.eigh(np.cov((reference - center).T))
    kept = np.maximum(variance - sigma**2, 0.05 * variance)
    return (
        center + (points - center) @ (axes * np.sqrt(kept / np.maximum(variance, 1e-12))) @ axes.T
    )


def _flattened(points: Array, reference: Array, sigma: float) -> Array:
    """Each point projected onto the plane of its neighbours within three sigma."""
    tree = KDTree(reference)
    k = min(NEIGHBOURS[-1], len(reference))
    distance, index = tree.query(points, k=k)
    reach = np.maximum(3 * sigma, distance[:, min(NEIGHBOURS[0], k) - 1])[:, None]
    weights = np.exp(-0.5 * (2 * distance / reach) ** 2)
    weights /= weights.sum(1, keepdims=True)
    near = reference[index]
    middle = np.einsum("nk,nki->ni", weights, near)
    local = near - middle[:, None]
    _, vectors = np.linalg.eigh(np.einsum("nk,nki,nkj->nij", weights, local, local))
    normal = vectors[:, :, 0]
    return points - normal * np.einsum("ni,ni->n", points - middle, normal)[:, None]


def dominant_yaw(normals: Array, weights: Array, points: list[Array]) -> float:
    """Angle about +z of the object's main directions to x and y: rad, in (-pi/4, pi/4].

    Args:
        normals: (N, 3) of all parts. weights: (N,) area of each sample.
        points: per part; they decide for round objects, whose normals favour no direction.
    """
    flat = np.linalg.norm(normals[:, :2], axis=1)
    kept = flat > 0.7
    yaw = 0.0
    sharp = 0.0
    if kept.any():
        angle = np.arctan2(normals[kept, 1], normals[kept, 0]) % (np.pi / 2)
        mass = weights[kept] * flat[kept]
        bins = 180
        histogram, _ = np.histogram(angle, bins=bins, range=(0, np.pi / 2), weights=mass)
        smooth = sum(
            np.roll(histogram, s) * w for s, w in ((-2, 1), (-1, 2), (0, 3), (1, 2), (2, 1))
        )
        peak = (int(np.argmax(smooth)) + 0.5) / bins * (np.pi / 2)
        off = (angle - peak + np.pi / 4) % (np.pi / 2) - np.pi / 4
        near = np.abs(off) < np.deg2rad(2.5)
        if near.any() and mass[near].sum() > 0:
            sharp = float(mass[near].sum() / mass.sum())
            yaw = peak + float(np.average(off[near], weights=mass[near]))
    if sharp < 0.2:
        yaw = _footprint_yaw(points)
    return (yaw + np.pi / 4) % (np.pi / 2) - np.pi / 4


def _footprint_yaw(points: list[Array]) -> float:
    """Angle at which the parts' upright boxes are smallest."""

    def cost(angles: Array) -> Array:
        c, s = np.cos(angles)[:, None], np.sin(angles)[:, None]
        total = np.zeros(len(angles))
        for p in points:
            q = p[:: max(1, len(p) // 300)]
            a, b = c * q[:, 0] + s * q[:, 1], -s * q[:, 0] + c * q[:, 1]
            total += np.sqrt(np.ptp(a, axis=1) * np.ptp(b, axis=1) + 1e-12)
        return total

    coarse = np.deg2rad(np.arange(-45, 45, 3.0))
    values = cost(coarse)
    if values.min() > 0.97 * cost(np.zeros(1))[0]:
        return 0.0  # a round object: any yaw fits
    fine = coarse[np.argmin(values)] + np.deg2rad(np.arange(-3, 3.01, 0.25))
    return float(fine[np.argmin(cost(fine))])


CONTACT_GAP = 0.012
"""Gap (diagonals) below which two sampled surfaces are in contact."""
SAMPLE_BUDGET = 26000
"""Surface points per object."""


@dataclass(frozen=True)
class WorkingFrame:
    """Transforms between the object's frame (metres) and the working frame (diagonals)."""

    center: Array
    yaw: float
    diagonal: float

    @cached_property
    def object_from_working(self) -> Array:
        """(3, 3) rotation."""
        return rotation(np.array([0.0, 0.0, 1.0]), self.yaw)

    def to_working(self, points: Array) -> Array:
        """Points of the object's frame, (N, 3) → (N, 3)."""
        return (points - self.center) @ self.object_from_working / self.diagonal

    def point_in_object(self, point: Array) -> Array:
        """A point of the working frame, (3,) → (3,)."""
        return self.object_from_working @ point * self.diagonal + self.center

    def direction_in_object(self, direction: Array) -> Array:
        """A direction of the working frame, (3,) → (3,)."""
        return self.object_from_working @ direction


@dataclass(eq=False)
class SampledObject:
    """The parts of one object with their shapes.

    Attributes:
        category: of the object. parts: as given, object frame.
        shapes: of the parts, in their order. frame: the working frame.
    """

    category: str | None
    shapes: tuple[PartShape, ...]
    frame: WorkingFrame
    parts: tuple[Part, ...]
    _trees: dict[int, KDTree] = field(default_factory=dict)
    _distances: dict[tuple[int, int], Array] = field(default_factory=dict)
    _covers: dict[tuple[int, bytes, tuple[int, ...], bytes], float] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.shapes)

    def tree(self, i: int) -> KDTree:
        """KD-tree of part ``i``'s points."""
        if i not in self._trees:
            self._trees[i] = KDTree(self.shapes[i].points)
        return self._trees[i]

    def distances(self, i: int, j: int) -> Array:
        """(N_i,) distance of each point of part ``i`` to part ``j``."""
        key = (i, j)
        if key not in self._distances:
            self._distances[key] = self.tree(j).query(self.shapes[i].points)[0]
        return self._distances[key]

    @cached_property
    def gap(self) -> Array:
        """(P, P) gap between surfaces, symmetric; of distant parts that between bounding boxes."""
        n = len(self)
        low = np.stack([s.low for s in self.shapes])
        high = np.stack([s.high for s in self.shapes])
        apart = np.maximum(0.0, np.maximum(low[:, None] - high[None], low[None] - high[:, None]))
        out = np.linalg.norm(apart, axis=2)
        for i in range(n):
            for j in range(i + 1, n):
                if out[i, j] < 0.05:
                    a, b = (i, j) if self.shapes[i].size <= self.shapes[j].size else (j, i)
                    d = self.distances(a, b)
                    k = min(len(d) - 1, max(2, len(d) // 200))
                    near = float(np.partition(d, k)[k])
                    # Samples of surfaces in contact are half a spacing apart.
                    out[i, j] = out[j, i] = max(0.0, near - 0.5 * self.spacing(b))
        return out

    @cached_property
    def noise(self) -> float:
        """Largest noise of a part (diagonals); 0 for meshes."""
        return max(s.noise for s in self.shapes)

    def spacing(self, i: int) -> float:
        """Typical distance between neighbouring points of part ``i``."""
        s = self.shapes[i]
        return float(np.sqrt(s.area / max(1, len(s.points)))) if s.area > 0 else 0.0

    def contact(self, i: int, j: int, share: float = 0.06) -> Array:
        """(K, 3) points of part ``i`` nearest to part ``j``."""
        d = self.distances(i, j)
        k = min(len(d), max(6, int(share * len(d))))
        limit = max(float(d.min()) + 0.008, CONTACT_GAP)
        near = np.argpartition(d, k - 1)[:k]
        close = near[d[near] <= limit]
        return self.shapes[i].points[close if len(close) >= 4 else near]

    def _union(self, members: tuple[int, ...]) -> Array:
        """(N, 3) points of several parts."""
        if not members:
            return np.zeros((0, 3))
        return np.concatenate([self.shapes[m].points for m in members])

    def others(self, i: int) -> tuple[int, ...]:
        """All parts but ``i``."""
        return tuple(j for j in range(len(self)) if j != i)

    @cached_property
    def low(self) -> Array:
        """(3,) lowest corner of the object."""
        return np.stack([s.low for s in self.shapes]).min(0)

    @cached_property
    def high(self) -> Array:
        """(3,) highest corner of the object."""
        return np.stack([s.high for s in self.shapes]).max(0)

    @cached_property
    def scanned(self) -> bool:
        """True if most parts are clouds."""
        return sum(s.scanned for s in self.shapes) * 2 > len(self)

    def cover(
        self, i: int, direction: Array, others: tuple[int, ...], axes: Array | None = None
    ) -> float:
        """Share of part ``i`` that other parts cover, seen from ``direction``.

        1: the part can't move that way; 0: nothing is in front of it.

        Args:
            axes: (3, 3) columns: directions of the grid in which parts are compared; the working
                axes by default.
        """
        # All mechanisms ask about the same few sides.
        key = (i, direction.tobytes(), others, b"" if axes is None else axes.tobytes())
        if key not in self._covers:
            self._covers[key] = self._cover(i, direction, others, axes)
        return self._covers[key]

    def _cover(
        self, i: int, direction: Array, others: tuple[int, ...], axes: Array | None
    ) -> float:
        e = np.eye(3) if axes is None else axes
        k = int(np.argmax(np.abs(e.T @ direction)))
        sign = np.sign(e[:, k] @ direction)
        u, v = (x for x in range(3) if x != k)
        own = self.shapes[i].points @ e
        rest = self._union(others) @ e
        if not len(rest):
            return 0.0
        low, high = own.min(0), own.max(0)
        cell = max(0.02, float(max(high[u] - low[u], high[v] - low[v])) / 14, TINY)
        nu = max(1, int((high[u] - low[u]) / cell))
        nv = max(1, int((high[v] - low[v]) / cell))

        def index(p: Array) -> npt.NDArray[np.int64]:
            a = np.clip(
                ((p[:, u] - low[u]) / (high[u] - low[u] + NOTHING) * nu).astype(int), 0, nu - 1
            )
            b = np.clip(
                ((p[:, v] - low[v]) / (high[v] - low[v] + NOTHING) * nv).astype(int), 0, nv - 1
            )
            return a * nv + b

        mine = np.full(nu * nv, -np.inf)
        np.maximum.at(mine, index(own), own[:, k] * sign)
        inside = (
            (rest[:, u] >= low[u])
            & (rest[:, u] <= high[u])
            & (rest[:, v] >= low[v])
            & (rest[:, v] <= high[v])
        )
        theirs = np.full(nu * nv, -np.inf)
        if inside.any():
            np.maximum.at(theirs, index(rest[inside]), rest[inside, k] * sign)
        hit = np.isfinite(mine)
        return float((theirs[hit] > mine[hit] + 0.004).mean())


def sample_object(
    segmented: SegmentedObject, seed: int = 0, *, budget: int = SAMPLE_BUDGET
) -> SampledObject:
    """Sample the parts (``budget`` points in all) and transform them to the working frame.

    A part's sample depends on its geometry alone, not on the order of the parts.
    """
    bounds = segmented.bounds
    diagonal = float(np.linalg.norm(bounds[1] - bounds[0])) or 1.0
    center = bounds.mean(0)
    parts = segmented.parts
    rough = np.array([_rough_area(p.bounds) for p in parts])
    share = np.sqrt(rough + 1e-12)
    counts = np.clip(budget * share / share.sum(), 160, 6000).astype(int)
    samples = [part_surface(p, int(c), seed) for p, c in zip(parts, counts, strict=True)]
    noise = _common_noise([s.noise for s in samples])
    samples = [denoised(s, noise) for s in samples]
    normals = np.concatenate([s.normals for s in samples])
    weights = np.concatenate(
        [np.full(len(s.points), s.area / max(1, len(s.points))) for s in samples]
    )
    yaw = dominant_yaw(normals, weights, [s.points for s in samples])
    frame = WorkingFrame(center, yaw, diagonal)
    shapes = tuple(
        PartShape(
            part.link,
            part.name,
            frame.to_working(s.points),
            s.normals @ frame.object_from_working,
            frame.to_working(s.outline),
            s.area / diagonal**2,
            part.mesh is None or not len(part.mesh.faces),
            s.noise.sigma / diagonal,
        )
        for part, s in zip(parts, samples, strict=True)
    )
    return SampledObject(segmented.category, shapes, frame, parts)


def _common_noise(each: list[Noise]) -> float:
    """The scanner's noise, for small parts and rods on which it can't be measured."""
    measured = sorted(n.sigma for n in each if n.measured)
    found = measured or sorted(n.sigma for n in each if n.sigma)
    return found[len(found) // 2] if found else 0.0


def _rough_area(bounds: Array) -> float:
    a, b, c = bounds[1] - bounds[0]
    return float(a * b + b * c + c * a)
