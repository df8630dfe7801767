"""Overlaps at rest in a written scene, and their resolution.

Collision shapes are convex, scans are noisy, and things are put down a little inside of others. A
simulator throws apart what overlaps at rest. So a link that a joint moves passes through what it
starts in, and a base that would be free stays where it is if it starts deep in something.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree import ElementTree as ET  # only types; reading is defusedxml's

import numpy as np

from model.core.shapes import Hull, Primitive, hull_of, hull_of_shape
from model.io.export.mjcf import COLLISION_GROUP
from model.physics.collision.narrow_phase import overlaps
from model.scenes.jobs import ASSETS, MJCF
from model.scenes.poses import pose, rotation_from_quaternion
from model.scenes.readers.lisdf import parse_xml
from model.scenes.scene import FloatArray
from model.scenes.scene_mjcf import Pass, Stand

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
    root = parse_xml(path)
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
