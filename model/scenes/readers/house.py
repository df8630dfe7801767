"""Floors and walls of an AI2-THOR house as closed solids, doors and windows left open.

A file gives planes: a room's ``floorPolygon``, and walls as ``polygon`` with four corners, low,
high, high, low. A door's or window's ``holePolygon`` holds two corners on ``wall0``, in metres from
the wall's first corner and from the floor; on ``wall1``, the same wall from behind, they count from
the other end. Outer faces (``exterior`` in the id) lie on the inner ones and are left out, as are
``empty`` walls between rooms that are open to each other.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from typing import Any

import mapbox_earcut
import numpy as np

from model.io.formats.loaded import Loaded, join
from model.scenes.scene import FloatArray, SceneObjectError, SceneProblem
from model.scenes.values import maybe_text, numbers, text

THICKNESS = 0.04
"""Metres that floors and walls are given."""
FLOOR_COLOR, WALL_COLOR = (164, 142, 118), (226, 222, 212)
_BOX = np.array([[i >> k & 1 for k in range(3)] for i in range(8)], float)
_BOX_FACES = np.array(
    [[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
     [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5]], np.int32,
)  # fmt: skip
Hole = tuple[float, float, float, float]
"""Along the wall from and to, up from and to."""


def structure_of(house: dict[str, Any]) -> tuple[Loaded | None, tuple[SceneProblem, ...]]:
    """Floors and walls in the scene's frame, metres, +z up; None where the house tells none.

    Returns:
        The geometry, and what of it couldn't be used.
    """
    solids: list[Loaded] = []
    problems: list[SceneProblem] = []
    holes = _holes(house, problems)
    for kind, entries, make in (
        ("floor", house.get("rooms"), _floor),
        ("wall", house.get("walls"), lambda e: _wall(e, holes)),
    ):
        for n, entry in enumerate(entries if isinstance(entries, list) else ()):
            try:
                solids += make(entry)
            except SceneObjectError as error:
                id = maybe_text(entry.get("id")) if isinstance(entry, dict) else None
                problems.append(SceneProblem(id or f"{kind} {n}", f"{kind}: {error}"))
    return (join(solids) if solids else None), tuple(problems)


def _floor(room: Any) -> list[Loaded]:
    polygon = room.get("floorPolygon") if isinstance(room, dict) else None
    if not polygon:
        return []
    corners = _points(polygon, "floorPolygon")
    flat = corners[:, :2]
    x, y = flat.T
    area = float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()) / 2
    if len(flat) < 3 or abs(area) < 1e-6:
        raise SceneObjectError("its floorPolygon has no area")
    if area < 0:
        flat = flat[::-1].copy()
    top = mapbox_earcut.triangulate_float64(flat, np.array([len(flat)], np.uint32))
    top = top.astype(np.int32).reshape(-1, 3)
    n, level = len(flat), float(corners[:, 2].mean())
    ring = np.stack([np.arange(n), np.roll(np.arange(n), -1)], 1).astype(np.int32)
    upright = _upward(flat, top)
    low = np.stack([ring[:, 0] + n, ring[:, 1] + n, ring[:, 1]], 1)
    high = np.stack([ring[:, 0] + n, ring[:, 1], ring[:, 0]], 1)
    vertices = np.concatenate([
        np.column_stack([flat, np.full(n, level)]),
        np.column_stack([flat, np.full(n, level - THICKNESS)]),
    ])  # fmt: skip
    faces = np.concatenate([upright, upright[:, ::-1] + n, low, high]).astype(np.int32)
    return [_solid(vertices, faces, FLOOR_COLOR)]


def _upward(flat: FloatArray, triangles: Any) -> Any:
    """Triangles counter-clockwise as seen from above."""
    a, b, c = (flat[triangles[:, k]] for k in range(3))
    ab, ac = b - a, c - a
    down = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0] < 0
    return np.where(down[:, None], triangles[:, ::-1], triangles)


def _wall(wall: Any, holes: dict[str, list[tuple[Hole, bool]]]) -> list[Loaded]:
    if not isinstance(wall, dict) or wall.get("empty") is True or not wall.get("polygon"):
        return []
    id = text(wall.get("id"), "id")
    if "exterior" in id:
        return []
    corners = _points(wall["polygon"], "polygon")
    if len(corners) != 4:
        raise SceneObjectError(f"its polygon has {len(corners)} corners; 4 are needed")
    start, end = corners[0], corners[3]
    low, high = float(corners[:, 2].min()), float(corners[:, 2].max())
    width = float(np.linalg.norm((end - start)[:2]))
    if width < 1e-6 or high - low < 1e-6:
        raise SceneObjectError("its polygon has no area")
    along = np.array([*((end - start)[:2] / width), 0.0])
    frame = np.stack([along, [-along[1], along[0], 0.0], [0.0, 0.0, 1.0]])
    origin = np.array([*start[:2], low])
    cut = [
        (width - b, width - a, c, d) if behind else (a, b, c, d)
        for (a, b, c, d), behind in holes.get(id, ())
    ]
    return [
        _solid(origin + (spot + _BOX * size) @ frame, _BOX_FACES, WALL_COLOR)
        for spot, size in _pieces(width, high - low, cut)
    ]


def _pieces(width: float, height: float, holes: list[Hole]) -> Iterable[tuple[Any, Any]]:
    """Lowest corner and size, in the wall's frame, of boxes that fill it but for the holes."""
    ends = sorted({0.0, width, *(min(max(v, 0.0), width) for h in holes for v in h[:2])})
    for a, b in pairwise(ends):
        middle = (a + b) / 2
        level = 0.0
        inside = sorted(h[2:] for h in holes if h[0] < middle < h[1])
        for bottom, top in [*inside, (height, height)]:
            if bottom > level:
                spot = np.array([a, -THICKNESS / 2, level])
                yield spot, np.array([b - a, THICKNESS, min(bottom, height) - level])
            level = max(level, top)


def _holes(
    house: dict[str, Any], problems: list[SceneProblem]
) -> dict[str, list[tuple[Hole, bool]]]:
    """Wall → its openings, and whether they are declared from behind."""
    out: dict[str, list[tuple[Hole, bool]]] = {}
    for kind in ("doors", "windows"):
        entries = house.get(kind)
        for n, entry in enumerate(entries if isinstance(entries, list) else ()):
            if not isinstance(entry, dict) or not entry.get("holePolygon"):
                continue
            try:
                corners = _points(entry["holePolygon"], "holePolygon")
            except SceneObjectError as error:
                id = maybe_text(entry.get("id")) or f"{kind} {n}"
                problems.append(SceneProblem(id, f"its wall has no opening: {error}"))
                continue
            (a, _, c), (b, _, d) = corners.min(0), corners.max(0)
            for key, behind in (("wall0", False), ("wall1", True)):
                wall = entry.get(key)
                if isinstance(wall, str):
                    out.setdefault(wall, []).append(((a, b, c, d), behind))
    return out


def _points(value: Any, what: str) -> FloatArray:
    """(N, 3) corners, of Unity's y up brought to +z up."""
    if not isinstance(value, list):
        raise SceneObjectError(f"its {what} is no list of corners")
    return np.array([numbers(v, 3, f"a corner of its {what}") for v in value])[:, [0, 2, 1]]


def box_solid(low: FloatArray, size: FloatArray, color: tuple[int, int, int]) -> Loaded:
    """The axis-parallel box from (3,) ``low`` of (3,) ``size``, in one colour."""
    return _solid(low + _BOX * size, _BOX_FACES, color)


def _solid(vertices: FloatArray, faces: Any, color: tuple[int, int, int]) -> Loaded:
    colors = np.tile(np.array([*color, 255], np.uint8), (len(vertices), 1))
    return Loaded(vertices, faces, colors=colors)
