"""The free space of a part's box: voxels that are reachable from outside."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

VOXELS = 80_000
"""About how many the part's box has."""
LONGEST = 160
"""Most voxels along a side of it."""

FloatArray = npt.NDArray[np.float64]


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

    low: FloatArray
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

    def centers(self, mask: npt.NDArray[np.bool_]) -> FloatArray:
        """(N, 3) centres of the voxels of ``mask``."""
        return self.low + (np.argwhere(mask) + 0.5) * self.size

    def count_inside(
        self, mask: npt.NDArray[np.bool_], planes: FloatArray, bounds: FloatArray, most: int = 4000
    ) -> float:
        """Count the voxels of ``mask`` whose centres are inside a convex body.

        Args:
            planes: (P, 4) with ``n·x + d <= 0`` inside.
            bounds: (2, 3) of the body.
            most: voxels of its box above which a coarser lattice is counted.
        """
        first = np.ceil((bounds[0] - self.low) / self.size - 0.5).astype(int)
        last = np.floor((bounds[1] - self.low) / self.size - 0.5).astype(int) + 1
        first, last = np.maximum(first, 0), np.minimum(last, mask.shape)
        extent = np.maximum(last - first, 0)
        total = int(np.prod(extent))
        if not total:
            return 0.0
        step = max(1, int(np.ceil((total / most) ** (1 / 3))))
        # The middle of each coarse cell represents it.
        begin = first + np.minimum((step - 1) // 2, extent - 1)
        part = mask[begin[0] : last[0] : step, begin[1] : last[1] : step, begin[2] : last[2] : step]
        if not part.any():
            return 0.0
        at = self.low + (begin + np.argwhere(part) * step + 0.5) * self.size
        inside = (at @ planes[:, :3].T + planes[:, 3] <= 0).all(axis=1)
        return float(inside.sum()) * total / part.size


def occupancy(triangles: FloatArray, voxels: int = VOXELS) -> Occupancy:
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


def surface_lattice(
    triangles: FloatArray, spacing: float
) -> tuple[FloatArray, npt.NDArray[np.int64]]:
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
