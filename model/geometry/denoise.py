"""Take the noise off scans: points move onto the planes of their neighbourhoods.

Reconstructions from photos or LiDAR see a surface several times, a little apart. Their points are
then farther from the surface than from each other, and normals and creases drown in that.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

NEIGHBORS, NOISE_NEIGHBORS = 16, 12
NOISY = 0.32
"""Noise level above which points are as far from their surface as from each other. Simulated depth
cameras give up to 0.29, reconstructions from many views 0.33 and more."""
_PASSES = 2
_SAMPLE = 2000
_CHUNK = 20_000

Float32 = npt.NDArray[np.float32]


def noise_level(points: Float32, tree: KDTree | None = None) -> float:
    """Median distance of points from the planes of their neighbourhoods, in spacings.

    Args:
        points: (N, 3) any unit. tree: over ``points``, if there is one.
    """
    if len(points) <= NOISE_NEIGHBORS:
        return 0.0
    tree = tree or KDTree(points)
    some = points[:: max(len(points) // _SAMPLE, 1)]
    distance, near = tree.query(some, k=NOISE_NEIGHBORS)
    mean, normal = _planes(points, np.asarray(near), np.asarray(distance))
    spread = np.abs(np.einsum("nki,ni->nk", points[near] - mean[:, None], normal)).mean(1)
    spacing = np.asarray(distance)[:, 1:5].mean(1)
    return float(np.median(spread / np.maximum(spacing, 1e-12)))


def denoised(points: Float32, tree: KDTree | None = None, passes: int = _PASSES) -> Float32:
    """(N, 3) points moved along the normals of their neighbourhoods onto their planes.

    Each plane is fitted to the :data:`NEIGHBORS` nearest points, weighted by nearness. Rounds edges
    by about that radius, so it is for noisy scans alone: see :func:`noise_level`.
    """
    if len(points) <= NEIGHBORS:
        return points
    distance, near = (tree or KDTree(points)).query(points, k=NEIGHBORS, workers=2)
    near, distance = np.asarray(near), np.asarray(distance)
    out = points
    for _ in range(passes):
        moved = np.empty_like(points)
        for begin in range(0, len(points), _CHUNK):
            rows = slice(begin, begin + _CHUNK)
            mean, normal = _planes(out, near[rows], distance[rows])
            off = np.einsum("ni,ni->n", out[rows] - mean, normal)
            moved[rows] = out[rows] - off[:, None] * normal
        out = moved
    return out


def _planes(points: Float32, near: npt.NDArray, distance: npt.NDArray) -> tuple[Float32, Float32]:
    """(N, 3) weighted means of the neighbours and (N, 3) unit normals of their planes."""
    reach = np.maximum(distance[:, -1:], 1e-12)
    weight = np.exp(-2 * (distance / reach) ** 2).astype(np.float32)
    weight /= weight.sum(1, keepdims=True)
    local = points[near]
    mean = np.einsum("nk,nki->ni", weight, local)
    local = local - mean[:, None]
    covariance = np.matmul((local * weight[..., None]).transpose(0, 2, 1), local)
    _, vectors = np.linalg.eigh(covariance.astype(np.float64))
    return mean, vectors[:, :, 0].astype(np.float32)
