"""Points of a noisy cloud, moved back towards the surface that they came from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from model.prediction.geometric.surface import NEIGHBOURS, Sampled, cloud_normals

Array = npt.NDArray[np.float64]

LEFT = {True: 0.5, False: 0.6}
"""Share of the noise that is left, where the surface told it and where it didn't."""


def denoised(sampled: Sampled, sigma: float) -> Sampled:
    """The same part with less noise.

    Where the points lie along a surface, each goes onto its neighbours' plane; a part that is
    hardly larger than the noise only shrinks to the extents that it has without it.

    Args:
        sampled: any part; one without noise (a mesh) stays as it is.
        sigma: standard deviation of the scanner's noise (m); the part's own counts where it is
            larger.
    """
    noise = sampled.noise
    if not noise.sigma:
        return sampled
    worst = max(noise.sigma, sigma)
    if not noise.coarse or len(sampled.points) < NEIGHBOURS[1]:
        return replace(sampled, noise=replace(noise, sigma=worst))
    move = _flattened if noise.told else _shrunk
    points = move(sampled.points, sampled.points, sigma)
    outline = points
    if len(sampled.outline) != len(sampled.points):
        outline = move(sampled.outline, sampled.points, sigma)
    normals, _, _ = cloud_normals(points)
    left = replace(noise, sigma=LEFT[noise.told] * worst)
    return replace(sampled, points=points, outline=outline, normals=normals, noise=left)


def _shrunk(points: Array, reference: Array, sigma: float) -> Array:
    """Smaller along each principal axis, by what the noise adds to the variance there."""
    center = reference.mean(0)
    variance, axes = np.linalg.eigh(np.cov((reference - center).T))
    kept = np.maximum(variance - sigma**2, 0.05 * variance)
    return (
        center + (points - center) @ (axes * np.sqrt(kept / np.maximum(variance, 1e-12))) @ axes.T
    )


def _flattened(points: Array, reference: Array, sigma: float) -> Array:
    """Each point on the plane of its neighbours, which reach three times as far as the noise."""
    from scipy.spatial import KDTree

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
