"""The sampled parts of one object in the working frame, with their distances and contacts.

Working frame: origin at the centre of the object's bounding box, +z up, the main horizontal
directions along x and y, the bounding box's diagonal is 1.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from model.core.articulated_object import Part, SegmentedObject
from model.prediction.geometric.shape import PartShape, rotation
from model.prediction.geometric.surface import Noise, denoised, dominant_yaw, part_surface

Array = npt.NDArray[np.float64]

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
        name, category: of the object. parts: as given, object frame.
        shapes: of the parts, in their order. frame: the working frame.
    """

    name: str
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

    def union(self, members: tuple[int, ...]) -> Array:
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
        rest = self.union(others) @ e
        if not len(rest):
            return 0.0
        low, high = own.min(0), own.max(0)
        cell = max(0.02, float(max(high[u] - low[u], high[v] - low[v])) / 14, 1e-6)
        nu = max(1, int((high[u] - low[u]) / cell))
        nv = max(1, int((high[v] - low[v]) / cell))

        def index(p: Array) -> npt.NDArray[np.int64]:
            a = np.clip(
                ((p[:, u] - low[u]) / (high[u] - low[u] + 1e-9) * nu).astype(int), 0, nu - 1
            )
            b = np.clip(
                ((p[:, v] - low[v]) / (high[v] - low[v] + 1e-9) * nv).astype(int), 0, nv - 1
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
    return SampledObject(segmented.name, segmented.category, shapes, frame, parts)


def _common_noise(each: list[Noise]) -> float:
    """The scanner's noise, for small parts and rods on which it can't be measured."""
    measured = sorted(n.sigma for n in each if n.measured)
    found = measured or sorted(n.sigma for n in each if n.sigma)
    return found[len(found) // 2] if found else 0.0


def _rough_area(bounds: Array) -> float:
    a, b, c = bounds[1] - bounds[0]
    return float(a * b + b * c + c * a)
