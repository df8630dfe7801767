"""Simulated scans of ground truth: rotated, one-sided, noisy clouds."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject, Part
from model.core.geometry import PointCloud
from model.core.tree import KinematicTree
from model.data.protocol import GroundTruth
from model.geometry.sampling import sample_surface

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Corruption:
    """Changes of an object before it is predicted.

    Attributes:
        yaw: rotation about +z (rad); None draws one for each object.
        scan: replace the meshes by a cloud scanned from one side.
        view: azimuth of the scanner (rad, from +x), before the rotation; PartNet-Mobility's objects
            face -x, which is pi.
        elevation: of the scanner (rad).
        noise: standard deviation over the object's diagonal.
        points: of the whole cloud.
    """

    yaw: float | None = 0.0
    scan: bool = False
    view: float = math.pi - 0.5
    elevation: float = 0.45
    noise: float = 0.003
    points: int = 20000


def corrupt(truth: GroundTruth, how: Corruption, rng: np.random.Generator) -> GroundTruth:
    """Corrupt an object; its joints are rotated, too."""
    out = _scanned(truth, how, rng) if how.scan else truth
    yaw = float(rng.uniform(-math.pi, math.pi)) if how.yaw is None else how.yaw
    return _turned(out, yaw) if yaw else out


def _turned(truth: GroundTruth, yaw: float) -> GroundTruth:
    c, s = math.cos(yaw), math.sin(yaw)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

    def three(v: tuple[float, float, float]) -> tuple[float, float, float]:
        x, y, z = turn @ np.asarray(v)
        return float(x), float(y), float(z)

    parts = []
    for p in truth.object.parts:
        mesh = p.mesh and replace(p.mesh, vertices=p.mesh.vertices @ turn.T)
        cloud = p.cloud and replace(
            p.cloud,
            points=(p.cloud.points @ turn.T).astype(np.float32),
            normals=None
            if p.cloud.normals is None
            else (p.cloud.normals @ turn.T).astype(np.float32),
        )
        parts.append(replace(p, mesh=mesh, cloud=cloud))
    tree = truth.object.tree
    joints = tuple(replace(j, axis=three(j.axis), origin=three(j.origin)) for j in tree.joints)
    turned = ArticulatedObject(
        truth.object.name, tuple(parts), KinematicTree(tree.links, joints), truth.object.category
    )
    return replace(truth, object=turned)


def _scanned(truth: GroundTruth, how: Corruption, rng: np.random.Generator) -> GroundTruth:
    """Clouds of the visible points; a hidden part keeps a few of its points."""
    parts = truth.object.parts
    bounds = np.stack([p.bounds for p in parts])
    low, high = bounds[:, 0].min(0), bounds[:, 1].max(0)
    diagonal = float(np.linalg.norm(high - low)) or 1.0
    dense: list[Array] = []
    for p in parts:
        assert p.mesh is not None
        extent = np.ptp(p.bounds, axis=0)
        share = float(np.linalg.norm(extent)) / diagonal
        count = int(np.clip(6 * how.points * share**1.5, 600, 6 * how.points))
        dense.append(sample_surface(p.mesh, count, rng)[0].points.astype(np.float64))
    in_view = visible(np.concatenate(dense), (low + high) / 2, diagonal, how.view, how.elevation)
    split = np.split(in_view, np.cumsum([len(d) for d in dense])[:-1])
    keep = min(1.0, how.points / max(1, int(in_view.sum())))
    out = []
    for p, points, mask in zip(parts, dense, split, strict=True):
        shown = points[mask]
        shown = shown[rng.random(len(shown)) < max(keep, min(1.0, 120 / max(1, len(shown))))]
        if len(shown) < 12:
            shown = points[rng.choice(len(points), 12)]
        shown = shown + rng.normal(0.0, how.noise * diagonal, shown.shape)
        out.append(Part(p.link, cloud=PointCloud(shown.astype(np.float32)), name=p.name))
    scanned = ArticulatedObject(
        truth.object.name, tuple(out), truth.object.tree, truth.object.category
    )
    return replace(truth, object=scanned)


def visible(
    points: Array, center: Array, diagonal: float, azimuth: float, elevation: float
) -> npt.NDArray[np.bool_]:
    """(N,) points visible to a distant camera, by a coarse depth image."""
    ca, sa = math.cos(azimuth), math.sin(azimuth)
    ce, se = math.cos(elevation), math.sin(elevation)
    toward = np.array([ca * ce, sa * ce, se])
    right = np.array([-sa, ca, 0.0])
    up = np.cross(toward, right)
    local = (points - center) / diagonal
    cell = 1.0 / 160
    u = np.floor((local @ right + 0.6) / cell).astype(np.int64)
    v = np.floor((local @ up + 0.6) / cell).astype(np.int64)
    depth = local @ toward
    pixel = u * 4096 + v
    order = np.argsort(pixel, kind="stable")
    _, start = np.unique(pixel[order], return_index=True)
    nearest = np.maximum.reduceat(depth[order], start)
    of_point = np.empty(len(points), np.int64)
    of_point[order] = np.repeat(np.arange(len(start)), np.diff(np.append(start, len(points))))
    return depth >= nearest[of_point] - 1.5 * cell
