"""Procedural objects sampled into labelled clouds: clean, noisy, one-sided."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from model.geometry.point_cloud import PointCloud
from model.segmentation.normals import sphere_directions
from model.segmentation.training import furniture, gadgets
from model.segmentation.training.primitives import Builder

Mode = Literal["surface", "outside", "one-sided"]
FAMILIES = (*furniture.FAMILIES, *gadgets.FAMILIES)


@dataclass(frozen=True, eq=False)
class LabelledCloud:
    """A cloud with the true part of each point; ``family`` says what was built."""

    cloud: PointCloud
    labels: npt.NDArray[np.int16]
    family: str


@dataclass(frozen=True, eq=False)
class Solid:
    """(T, 3, 3) triangles, (T,) part of each, (T, 3) colour of each."""

    triangles: npt.NDArray[np.float64]
    part: npt.NDArray[np.int16]
    color: npt.NDArray[np.float64]
    family: str


def build(seed: int) -> Solid:
    """A random object of a random family, stretched and turned a little."""
    rng = np.random.default_rng(seed)
    family = FAMILIES[rng.integers(len(FAMILIES))]
    builder = Builder(rng)
    family(builder)
    triangles = np.concatenate([s[0] for s in builder.solids])
    counts = [len(s[0]) for s in builder.solids]
    part = np.repeat([s[1] for s in builder.solids], counts).astype(np.int16)
    color = np.repeat(np.array([s[2] for s in builder.solids]), counts, axis=0)
    stretch = np.exp(rng.normal(0, 0.12, 3))
    angle = rng.choice([0.0, rng.uniform(0, 2 * np.pi)])
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0],
                     [0, 0, 1]])  # fmt: skip
    return Solid(triangles * stretch @ turn.T, part, color, family.__name__)


def _sample(
    solid: Solid, count: int, rng: np.random.Generator
) -> tuple[npt.NDArray, npt.NDArray[np.int64], npt.NDArray]:
    t = solid.triangles
    cross = np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])
    area = np.linalg.norm(cross, axis=1)
    face = rng.choice(len(t), count, p=area / area.sum())
    u, v = rng.random((2, count, 1))
    flip = u + v > 1
    u, v = np.where(flip, 1 - u, u), np.where(flip, 1 - v, v)
    points = t[face, 0] + u * (t[face, 1] - t[face, 0]) + v * (t[face, 2] - t[face, 0])
    return points, face, (cross / np.maximum(area, 1e-300)[:, None])[face]


def visible_from(
    points: npt.NDArray, directions: npt.NDArray[np.float64], cell: float
) -> npt.NDArray[np.float64]:
    """(N,) how many of the directions see each point, by depth buffers."""
    seen = np.zeros(len(points))
    for w in directions:
        helper = np.array([1.0, 0, 0]) if abs(w[0]) < 0.8 else np.array([0, 1.0, 0])
        u = np.cross(w, helper)
        u /= np.linalg.norm(u)
        local = points @ np.stack([u, np.cross(w, u), w], axis=1)
        grid = np.floor((local[:, :2] - local[:, :2].min(0)) / cell).astype(np.int64)
        key = grid[:, 0] * (grid[:, 1].max() + 1) + grid[:, 1]
        top = np.full(int(key.max()) + 1, -np.inf)
        np.maximum.at(top, key, local[:, 2])
        seen += local[:, 2] > top[key] - 1.5 * cell
    return seen


def scan(solid: Solid, count: int, mode: Mode, noise: float, seed: int) -> LabelledCloud:
    """Sample ``solid``.

    Args:
        count: points wanted; fewer come back where little is visible.
        mode: all surfaces, those seen from around, or those seen from two near views.
        noise: standard deviation along all axes, in parts of the bounding box's diagonal.
    """
    rng = np.random.default_rng(seed)
    low, high = solid.triangles.reshape(-1, 3).min(0), solid.triangles.reshape(-1, 3).max(0)
    diagonal = float(np.linalg.norm(high - low))
    points, face, normal = _sample(solid, count if mode == "surface" else 3 * count, rng)
    if mode != "surface":
        if mode == "outside":
            directions = sphere_directions(32)
            directions = directions[directions[:, 2] > -0.5]
        else:
            azimuth = -np.pi / 2 + rng.uniform(-0.6, 0.6) + np.array([-0.4, 0.4])
            up = rng.uniform(0.2, 0.7)
            directions = np.stack([np.cos(azimuth), np.sin(azimuth), np.full(2, up)], axis=1)
            directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        area = diagonal**2 / len(points)
        seen = visible_from(points, directions, 1.2 * np.sqrt(area)) > 0
        if mode == "one-sided":
            facing = np.abs(normal @ directions.T).max(1)
            seen &= rng.random(len(points)) < facing
            for _ in range(int(rng.integers(0, 4))):
                hole = points[rng.integers(len(points))]
                seen &= np.linalg.norm(points - hole, axis=1) > rng.uniform(0.01, 0.05) * diagonal
        keep = np.nonzero(seen)[0][:count]
        points, face, normal = points[keep], face[keep], normal[keep]
    colors = _paint(solid, points, face, normal, diagonal, rng)
    points = points + rng.normal(0, noise * diagonal, points.shape)
    labels = solid.part[face]
    cloud = PointCloud(points.astype(np.float32), colors=None if rng.random() < 0.2 else colors)
    return LabelledCloud(cloud, labels, solid.family)


def _paint(
    solid: Solid,
    points: npt.NDArray,
    face: npt.NDArray[np.int64],
    normal: npt.NDArray,
    diagonal: float,
    rng: np.random.Generator,
) -> npt.NDArray[np.uint8]:
    """Colours with grain, shading and sensor noise, so that flat colour is no sure sign."""
    color = solid.color[face].copy()
    wave = rng.normal(0, 1, 3) * rng.choice([3, 15, 60]) / diagonal
    color *= 1 + rng.choice([0, 0.05, 0.15]) * np.sin(points @ wave)[:, None]
    light = rng.normal(size=3)
    light /= np.linalg.norm(light)
    color *= 1 - rng.choice([0, 0.2, 0.4]) * (0.5 - 0.5 * np.abs(normal @ light))[:, None]
    color += rng.normal(0, rng.choice([0, 3, 10]), color.shape)
    return np.clip(color, 0, 255).astype(np.uint8)


def random_scan(seed: int, count: int | None = None) -> LabelledCloud:
    """A random object in a random mode, 20k to 100k points."""
    rng = np.random.default_rng([seed, 1])
    mode: Mode = rng.choice(["surface", "surface", "outside", "one-sided"])  # type: ignore[assignment]
    noise = float(rng.choice([0, 0.0003, 0.001, 0.002]))
    count = int(rng.choice([20_000, 40_000, 80_000])) if count is None else count
    return scan(build(seed), count, mode, noise, seed)
