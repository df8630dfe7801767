"""Parts as samples of their surface, the same every time for the same parts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import Part

if TYPE_CHECKING:
    from scipy.spatial import KDTree

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Noise:
    """How far points lie off their surface.

    Attributes:
        sigma: standard deviation across the surface (m), or no less than it where it isn't told.
        told: the points lie along a surface, so that ``sigma`` is their noise (and what is bent of
            the surface).
        coarse: the noise is larger than the spacing of the points.
    """

    sigma: float = 0.0
    told: bool = False
    coarse: bool = False


@dataclass(frozen=True, eq=False)
class Sampled:
    """A part's surface, metres, object frame.

    Attributes:
        points: (N, 3). normals: (N, 3) unit, sign unknown.
        outline: (M, 3) points that give the extents.
        area: m², of clouds an estimate.
        noise: see :class:`Noise` (m); of meshes 0 and not told.
    """

    points: Array
    normals: Array
    outline: Array
    area: float
    noise: Noise


def part_surface(part: Part, count: int, seed: int) -> Sampled:
    """Sample a part.

    Args:
        part: mesh (which leads) or cloud.
        count: points wanted; fewer where a cloud has fewer.
        seed: of the sampling.

    Returns:
        See :class:`Sampled`.
    """
    rng = np.random.default_rng(seed)
    mesh = part.mesh
    if mesh is not None and len(mesh.faces):
        area = mesh.face_areas
        total = float(area.sum())
        if total <= 0:
            points = mesh.vertices[np.unique(mesh.faces)][:count]
            return Sampled(points, np.zeros_like(points), points, 0.0, Noise())
        # Stratified along the cumulated area: even cover from few points.
        at = (np.arange(count) + rng.random(count)) / count * total
        face = np.minimum(np.searchsorted(np.cumsum(area), at), len(area) - 1)
        s, t = np.sqrt(rng.random(count)), rng.random(count)
        w = np.stack([1 - s, s * (1 - t), s * t], 1)
        points = np.einsum("nk,nkd->nd", w, mesh.triangles[face])
        used = mesh.vertices[np.unique(mesh.faces[area > 0])]
        return Sampled(points, mesh.face_normals[face], used, total, Noise())
    assert part.cloud is not None
    cloud = part.cloud
    points = cloud.points.astype(np.float64)
    index = np.arange(len(points))
    if len(points) > count:
        index = np.sort(rng.choice(len(points), count, replace=False))
    index = index[~strays(points[index])]
    kept = points[index]
    outline = points if len(points) <= 20000 else points[:: len(points) // 20000]
    outline = outline[~strays(outline)]
    normals, spacing, noise = cloud_normals(kept)
    if cloud.normals is not None:
        normals = cloud.normals[index].astype(np.float64)
    return Sampled(kept, normals, outline, float(len(kept) * spacing**2), noise)


STRAY = 4.0
"""Times the usual distance to its neighbours at which a point is no part of the surface."""
MOST_STRAYS = 0.1
"""A larger share of far points is a thinner piece of the part."""


def strays(points: Array) -> npt.NDArray[np.bool_]:
    """(N,) which points float about alone (statistical outlier removal, Rusu et al., 2008)."""
    from scipy.spatial import KDTree

    if len(points) < 50:
        return np.zeros(len(points), bool)
    distance = KDTree(points).query(points, k=7)[0][:, 1:].mean(1)
    found = distance > STRAY * np.median(distance)
    return found if found.mean() <= MOST_STRAYS else np.zeros(len(points), bool)


NEIGHBOURS = (14, 40, 100)
"""Neighbourhoods in which noise is sought, smallest first."""
ROUNDISH = (0.62, 0.35)
"""Thin over middle and over long spread of neighbourhoods above which they are more noise than
surface (of pure noise .74 and .55; of surfaces below .55, also at edges)."""


def cloud_normals(points: Array) -> tuple[Array, float, Noise]:
    """(N, 3) normals from the nearest neighbours' plane, the point spacing, and the noise."""
    from scipy.spatial import KDTree

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


BOARD = 2.2
"""Kurtosis of the places across a surface below which they lie on two faces of a board; of noise
it is 3, of two faces 1."""


def _noise(points: Array, tree: KDTree, spreads: Array) -> Noise:
    """The thin spread of the smallest neighbourhoods that are flat."""
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
        flat, round_ = thin <= ROUNDISH[0] * middle, thin > ROUNDISH[1] * long
        if flat and across is not None:
            return _flat_noise(across)
        if flat or not round_:
            return Noise(float(thin), bool(flat), step > 0)
    return Noise(float(np.median(spreads[:, 0])), False, True)


def _flat_noise(across: Array) -> Noise:
    """From the places (N, K) across flat neighbourhoods: noise on one face, or a board's two."""
    variance = float(np.median((across**2).mean(1)))
    fourth = float(np.median((across**4).mean(1)))
    if variance <= 0 or fourth > BOARD * variance**2:
        return Noise(variance**0.5, True, True)
    # Two faces at a distance of 2 a: variance a² + sigma², fourth cumulant -2 a⁴.
    apart = np.sqrt((3 * variance**2 - fourth) / 2)
    return Noise(float(np.sqrt(max(variance - apart, 0.0))), True, False)


def dominant_yaw(normals: Array, weights: Array, points: list[Array]) -> float:
    """Turn about +z (rad, in (-pi/4, pi/4]) that brings the object's main directions onto x and y.

    Args:
        normals: (N, 3) of all parts. weights: (N,) area of each sample.
        points: per part, for objects whose normals don't say (round ones).
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
    """Turn that makes the parts' upright boxes smallest."""

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
        return 0.0  # a round object: any yaw will do
    fine = coarse[np.argmin(values)] + np.deg2rad(np.arange(-3, 3.01, 0.25))
    return float(fine[np.argmin(cost(fine))])
