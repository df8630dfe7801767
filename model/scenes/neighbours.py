"""Shorten joint limits where the motion would hit neighbouring objects."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from model.core.articulated_object import ArticulatedObject, Part
from model.core.geometry import Mesh
from model.core.joint import Joint
from model.io.assets.reader import load_object
from model.io.urdf.meshes import merged, moved_mesh
from model.kinematics.penetration import inverse
from model.kinematics.surface import surface_of
from model.kinematics.sweep import free_until, joint_poses, surfaces_of, sweep_tolerance
from model.scenes.scene import FloatArray

SAMPLES = 13
"""Poses from which the reach of a joint is told."""
SCAN_BORDER = 0.05
"""Metres about a moving part where a scanned neighbour counts for nothing: labels and boxes end
somewhere near the border, so some of the door's own frame is always the neighbour's."""
LEAST = {True: math.radians(1.0), False: 0.002}
"""Radians and metres that a limit must lose to count as shortened."""


@dataclass(frozen=True, eq=False)
class Standing:
    """Something in the scene.

    Attributes:
        id: of the object.
        folder: its saved asset; None for a plain box.
        world_from_asset: (4, 4).
        bounds: (2, 3) metres in its own frame, at its size in the scene; a box is just that.
    """

    id: str
    folder: Path | None
    world_from_asset: FloatArray
    bounds: FloatArray

    def world_bounds(self) -> FloatArray:
        """(2, 3) in the world."""
        at = _corners(self.bounds) @ self.world_from_asset[:3, :3].T + self.world_from_asset[:3, 3]
        return np.stack([at.min(0), at.max(0)])


def shortened(me: Standing, others: tuple[Standing, ...]) -> list[dict[str, Any]]:
    """Range that each joint of ``me`` loses to its neighbours, the other joints at rest.

    Returns:
        For each shortened joint ``{"joint", "was", "limits", "hits"}``, radians or metres; a
        continuous joint that is in someone's way gets limits.
    """
    if me.folder is None:
        return []
    obj = _load(me.folder)
    own = surfaces_of(obj)
    if not own:
        return []
    tolerance = sweep_tolerance(own)
    asset_from_world = inverse(me.world_from_asset[None])[0]
    out: list[dict[str, Any]] = []
    for joint in obj.tree.joints:
        if not joint.moves or joint.mimic is not None:
            continue
        moving = obj.tree.descendants(joint.child)
        if not any(link in own for link in moving):
            continue
        reach = _reach(obj, joint)
        hit: dict[str, Any] = {}
        limits = list(_range(joint))
        for other in others:
            part = _near_part(other, asset_from_world, reach, me.world_from_asset)
            if part is not None and _scanned(me, other):
                part = _beyond_border(part, [p for p in obj.parts if p.link in moving])
            surface = None if part is None else surface_of(part)
            if surface is None:
                continue
            surfaces = {link: own[link] for link in moving if link in own}
            surfaces["neighbour"] = surface
            for side, end in enumerate(limits):
                if end == 0.0 or (end < 0) == bool(side):
                    continue
                free = free_until(obj.tree, joint, surfaces, end, tolerance)
                if abs(end) - abs(free) > LEAST[joint.rotates]:
                    limits[side] = free
                    hit[("lower", "upper")[side]] = other.id
        if hit:
            was = [joint.lower, joint.upper] if joint.limited else None
            out.append({"joint": joint.name, "was": was, "limits": limits, "hits": hit})
    return out


def _scanned(*standing: Standing) -> bool:
    return any(
        p.cloud is not None
        for s in standing if s.folder is not None for p in _load(s.folder).parts
    )  # fmt: skip


def _beyond_border(part: Part, moving: list[Part]) -> Part | None:
    """The faces of ``part`` that are further than :data:`SCAN_BORDER` from moving parts."""
    assert part.mesh is not None
    own = [_points(p) for p in moving]
    middle = part.mesh.triangles.mean(axis=1)
    near = KDTree(np.concatenate(own)).query(middle, distance_upper_bound=SCAN_BORDER)[0]
    far = ~np.isfinite(near)
    return Part(part.link, part.mesh.take_faces(far)) if far.any() else None


def _points(part: Part) -> FloatArray:
    if part.cloud is not None:
        return part.cloud.points.astype(np.float64)
    assert part.mesh is not None
    return part.mesh.vertices


@lru_cache(maxsize=8)
def _load(folder: Path) -> ArticulatedObject:
    return load_object(folder)


def _range(joint: Joint) -> tuple[float, float]:
    if joint.limited:
        return float(joint.lower or 0.0), float(joint.upper or 0.0)
    return -math.pi, math.pi


def _reach(obj: ArticulatedObject, joint: Joint) -> FloatArray:
    """(2, 3) box in the object's frame of all that the joint moves, wherever it moves it."""
    poses = joint_poses(obj.tree, joint, np.linspace(*_range(joint), SAMPLES))
    at: list[FloatArray] = []
    for part in obj.parts:
        if part.link not in poses:
            continue
        corners = _corners(part.bounds)
        for pose in poses[part.link]:
            at.append(corners @ pose[:3, :3].T + pose[:3, 3])
    every = np.concatenate(at)
    # Between two poses an arc goes beyond the corners of both, but not by more than this.
    margin = 0.05 * float(np.linalg.norm(np.ptp(every, axis=0))) if joint.rotates else 1e-3
    return np.stack([every.min(0) - margin, every.max(0) + margin])


def _near_part(
    other: Standing, asset_from_world: FloatArray, reach: FloatArray, world_from_asset: FloatArray
) -> Part | None:
    """The faces of ``other`` within ``reach``, in the object's frame."""
    at = _corners(reach) @ world_from_asset[:3, :3].T + world_from_asset[:3, 3]
    low, high = other.world_bounds()
    if (at.min(0) > high).any() or (at.max(0) < low).any():
        return None
    mesh = _box_mesh(other.bounds) if other.folder is None else _mesh(other.folder)
    if mesh is None:
        return None
    mesh = moved_mesh(mesh, asset_from_world @ other.world_from_asset)
    corners = mesh.triangles
    inside = (corners.min(1) <= reach[1]).all(1) & (corners.max(1) >= reach[0]).all(1)
    return Part("neighbour", mesh.take_faces(inside)) if inside.any() else None


@lru_cache(maxsize=8)
def _mesh(folder: Path) -> Mesh | None:
    meshes = [p.mesh for p in _load(folder).parts if p.mesh is not None]
    return merged(meshes) if meshes else None


def _corners(bounds: FloatArray) -> FloatArray:
    picks = np.array([[i >> k & 1 for k in range(3)] for i in range(8)])
    return np.asarray(bounds)[picks, np.arange(3)]


def _box_mesh(bounds: FloatArray) -> Mesh:
    faces = [[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
             [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5]]  # fmt: skip
    return Mesh(_corners(bounds), np.array(faces, np.int32))
