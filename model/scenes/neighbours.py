"""Neighbouring objects: limits that would hit them are shortened, overlaps at rest resolved.

Collision shapes are convex, scans are noisy, and things are put down a little inside of others. A
simulator throws apart what overlaps at rest. So a link that a joint moves passes through what it
starts in, and a base that would be free stays where it is if it starts deep in something.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET  # only types; reading is defusedxml's

import numpy as np
from scipy.spatial import KDTree

from model.core.articulated_object import ArticulatedObject, Part
from model.core.geometry import Mesh, merged
from model.core.joint import Joint
from model.core.shapes import Hull, Primitive, hull_of, hull_of_shape
from model.io.assets.reader import load_object
from model.io.export.mjcf import COLLISION_GROUP
from model.io.robot_xml import parse
from model.kinematics.penetration import inverse
from model.kinematics.surface import surface_of
from model.kinematics.sweep import free_until, joint_poses, surfaces_of, sweep_tolerance
from model.physics.collision.narrow_phase import overlaps
from model.scenes.jobs import ASSETS, MJCF
from model.scenes.scene import FloatArray
from model.scenes.scene_xml import Pass, Stand
from model.scenes.values import pose, rotation_from_quaternion

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
        p.cloud is not None for s in standing if s.folder is not None for p in _load(s.folder).parts
    )


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
        for link_pose in poses[part.link]:
            at.append(corners @ link_pose[:3, :3].T + link_pose[:3, 3])
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
    mesh = mesh.moved(asset_from_world @ other.world_from_asset)
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


INSIDE = 1e-3
"""Metres inside of another object from which a link passes through it."""
SUNK = 0.01
"""Metres inside of another object from which a free base is held; what is put down a little too
deep is only lifted."""


@dataclass(frozen=True, eq=False)
class _Body:
    """A link's collision shapes at rest.

    Attributes:
        stand: number of its object.
        link: None of a plain box.
        hulls: in the object's frame.
        moves: whether a joint moves it.
        bounds: (2, 3) in the world.
    """

    stand: int
    link: str | None
    hulls: list[Hull]
    moves: bool
    bounds: FloatArray


def at_rest(stands: Sequence[Stand], out: Path) -> tuple[list[Stand], dict[str, str]]:
    """The stands with what passes through what, and with bases held that start deep in something.

    Args:
        stands: of assets that are written below ``out`` in MJCF; without collision shapes nothing
            changes.

    Returns:
        The stands in their order, and for each whose base is held its id and a readable reason.
    """
    read: dict[str, list[tuple[str, list[Hull], bool]]] = {}
    bodies: list[_Body] = []
    for k, stand in enumerate(stands):
        if stand.key is not None and stand.key not in read:
            read[stand.key] = _shapes(out / ASSETS / stand.key / MJCF / "object.xml")
        links = [(None, [_box(stand)], False)] if stand.key is None else read[stand.key]
        for link, hulls, moves in links:
            if hulls:
                bounds = _bounds(hulls, stand.world_from_asset)
                bodies.append(_Body(k, link, hulls, moves, bounds))
    found = _found(stands, bodies)
    held: dict[str, str] = {}
    for a, b, depth in sorted(found, key=lambda f: -f[2]):
        for one, other in ((a, b), (b, a)):
            stand = stands[one.stand]
            if stand.free and depth > SUNK and stand.id not in held:
                held[stand.id] = f"starts {100 * depth:.1f} cm inside {stands[other.stand].id}"
    passes: dict[int, list[Pass]] = {}
    for a, b, depth in found:
        if any(stands[x.stand].free and stands[x.stand].id not in held for x in (a, b)):
            continue  # resting objects must not fall through their support
        one, other = (a, b) if a.moves else (b, a)
        if one.moves and one.link is not None:
            passes.setdefault(one.stand, []).append(
                Pass(one.link, stands[other.stand].id, other.link, round(depth, 6))
            )
    return [
        replace(s, free=s.free and s.id not in held, passes=tuple(passes.get(k, ())))
        for k, s in enumerate(stands)
    ], held


def _found(stands: Sequence[Stand], bodies: Sequence[_Body]) -> list[tuple[_Body, _Body, float]]:
    """Pairs of bodies of different objects that overlap, and how deep; of those that could push
    each other away."""
    if not bodies:
        return []
    low, high = (np.stack([b.bounds[i] for b in bodies]) for i in (0, 1))
    stand = np.array([b.stand for b in bodies])
    loose = np.array([b.moves or stands[b.stand].free for b in bodies])
    out: list[tuple[_Body, _Body, float]] = []
    for i in np.flatnonzero(loose):
        near = ((low <= high[i] - INSIDE) & (high >= low[i] + INSIDE)).all(axis=1)
        near &= (stand != stand[i]) & ~(loose & (np.arange(len(bodies)) < i))
        for j in np.flatnonzero(near):
            a, b = bodies[int(i)], bodies[int(j)]
            poses = {k: stands[x.stand].world_from_asset for k, x in (("a", a), ("b", b))}
            touching = overlaps({"a": a.hulls, "b": b.hulls}, [("a", "b")], poses, INSIDE)
            if touching:
                out.append((a, b, max(t.depth for t in touching)))
    return out


def _shapes(path: Path) -> list[tuple[str, list[Hull], bool]]:
    """Link, collision shapes in the object's frame, and whether a joint moves it."""
    root = parse(path)
    compiler = root.find("compiler")
    folder = path.parent / ("." if compiler is None else compiler.get("meshdir", "."))
    files = {m.get("name", ""): folder / m.get("file", "") for m in root.iterfind("asset/mesh")}
    out: list[tuple[str, list[Hull], bool]] = []

    def go(body: ET.Element, at: FloatArray, moved: bool) -> None:
        at = at + _numbers(body.get("pos"), 3)
        moved = moved or body.find("joint") is not None
        geoms = (g for g in body.findall("geom") if g.get("group") == str(COLLISION_GROUP))
        hulls = [h for g in geoms if (h := _hull(g, at, files)) is not None]
        out.append((body.get("name", ""), hulls, moved))
        for child in body.findall("body"):
            go(child, at, moved)

    for body in root.findall("worldbody/body"):
        go(body, np.zeros(3), False)
    return out


def _hull(geom: ET.Element, at: FloatArray, files: dict[str, Path]) -> Hull | None:
    """A collision geom of a body whose frame is at ``at``; None where it has no volume."""
    kind, place = geom.get("type", ""), at + _numbers(geom.get("pos"), 3)
    if kind == "mesh":
        lines = files[geom.get("mesh", "")].read_text().splitlines()
        corners = [line.split()[1:4] for line in lines if line.startswith("v ")]
        return hull_of(np.array(corners, np.float64) + place)
    w, x, y, z = _numbers(geom.get("quat", "1 0 0 0"), 4)
    sizes = _numbers(geom.get("size"), 3)
    # MuJoCo's sizes are half edges, half lengths and radii.
    sizes = sizes * ((2.0, 2.0, 2.0) if kind == "box" else (1.0, 2.0, 0.0))
    turn = rotation_from_quaternion(np.array([x, y, z, w]))
    return hull_of_shape(Primitive(kind, pose(place, turn), tuple(sizes.tolist())))  # type: ignore[arg-type]


def _numbers(text: str | None, count: int) -> FloatArray:
    """A fixed number of values; missing ones are 0."""
    said = [float(v) for v in (text or "").split()]
    return np.array([*said, *[0.0] * (count - len(said))])


def _box(stand: Stand) -> Hull:
    assert stand.box is not None
    return hull_of_shape(Primitive("box", np.eye(4), stand.box))


def _bounds(hulls: Sequence[Hull], world: FloatArray) -> FloatArray:
    at = np.concatenate([h.vertices for h in hulls]) @ world[:3, :3].T + world[:3, 3]
    return np.stack([at.min(axis=0), at.max(axis=0)])
