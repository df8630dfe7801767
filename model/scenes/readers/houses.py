"""Houses and rooms with floor and walls: Holodeck and ProcTHOR (AI2-THOR), PhyScene.

AI2-THOR houses are JSON: metres, degrees, y up, left-handed as Unity has it; the middle of an
object's bounding box is at its position. Floors and walls become one static object, ``building``,
of closed solids, doors and windows left open. A file gives planes: a room's ``floorPolygon``, and
walls as ``polygon`` with four corners, low, high, high, low. A door's or window's ``holePolygon``
holds two corners on ``wall0``, in metres from the wall's first corner and from the floor; on
``wall1``, the same wall from behind, they count from the other end. Outer faces (``exterior`` in
the id) lie on the inner ones and are left out, as are ``empty`` walls between rooms that are open
to each other.

PhyScene rooms are retrieved models with their places, or boxes beside the room's floor plan. Both
forms are those of PhyScene's public code (``utils/utils.py``, ``scripts/generate``), metres, Y up,
radians about y. With row vectors a vertex of a retrieved model stands at
``(v * scale - centroid) · R + t``, ``position = t - centroid``. 3D-FUTURE models are found by
their ``jid``, articulated ones by their PartNet-Mobility id, whose URDF turns the OBJ's frame. A
box is the asset called after its label, stretched to it, or stays a box without such an asset.
Floor plan and doors become ``building``. ``door_box`` tells the square that a door needs to open
in; the door is a panel in its middle, along the nearest edge of the floor.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import mapbox_earcut
import numpy as np

from model.core.errors import InputFileError
from model.core.geometry import affine
from model.io.formats.loaded import DEFAULT_MAX_BYTES, Loaded, join
from model.io.geometry_files import load_geometry, turned_up
from model.scenes.readers.lisdf import readable
from model.scenes.scene import (
    FloatArray,
    Scene,
    SceneFrame,
    SceneObject,
    SceneObjectError,
    SceneProblem,
    upright,
)
from model.scenes.unpacking import Unpacked, Unpacker
from model.scenes.values import (
    BOX_CORNERS,
    BOX_FACES,
    JsonReader,
    Place,
    about_z,
    collect,
    from_unity,
    maybe_text,
    numbers,
    pose,
    read_json,
    shown,
    table,
    text,
)

THICKNESS = 0.04
"""Metres that floors and walls are given."""
FLOOR_COLOR, WALL_COLOR = (164, 142, 118), (226, 222, 212)
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
        ("floor", house.get("rooms"), _room_floor),
        ("wall", house.get("walls"), lambda e: _wall(e, holes)),
    ):
        for n, entry in enumerate(entries if isinstance(entries, list) else ()):
            try:
                solids += make(entry)
            except SceneObjectError as error:
                id = maybe_text(entry.get("id")) if isinstance(entry, dict) else None
                problems.append(SceneProblem(id or f"{kind} {n}", f"{kind}: {error}"))
    return (join(solids) if solids else None), tuple(problems)


def _room_floor(room: Any) -> list[Loaded]:
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
    vertices = np.concatenate(
        [
            np.column_stack([flat, np.full(n, level)]),
            np.column_stack([flat, np.full(n, level - THICKNESS)]),
        ]
    )
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
        _solid(origin + (spot + BOX_CORNERS * size) @ frame, BOX_FACES, WALL_COLOR)
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


def _solid(vertices: FloatArray, faces: Any, color: tuple[int, int, int]) -> Loaded:
    colors = np.tile(np.array([*color, 255], np.uint8), (len(vertices), 1))
    return Loaded(vertices, faces, colors=colors)


_MAX_DEPTH = 16
BUILDING = "building"


class HolodeckReader(JsonReader):
    """``objects`` with ``assetId``, ``position`` and ``rotation``, and what stands on them."""

    name = "holodeck"
    description = "Holodeck and ProcTHOR houses (AI2-THOR JSON)"
    marks = (b'"proceduralParameters"', b'"assetId"', b'"roomType"')

    def read(self, path: Path) -> Scene:
        """See :class:`~model.scenes.scene.SceneReader`."""
        house = read_json(path)
        if not isinstance(house, dict) or not isinstance(house.get("objects"), list):
            raise InputFileError(path, "has no list 'objects'", "give an AI2-THOR house")
        rooms = {
            r["id"]: maybe_text(r.get("roomType")) or r["id"]
            for r in house.get("rooms") or []
            if isinstance(r, dict) and isinstance(r.get("id"), str)
        }

        def make(place: Place, entry: Any) -> SceneObject:
            return _object(place, entry, rooms)

        structure, broken = structure_of(house)
        entries = [*_entries(house["objects"], ("objects",))]
        if structure is not None:
            entries.append(((), _house(path)))
        objects, problems = collect(entries, make, lambda e: maybe_text(e.get("id")))
        frame = SceneFrame("y", 1.0, left_handed=True)
        return Scene(path.stem, path, self.name, objects, (*problems, *broken), frame)

    def unpack(self, scene: Scene, folder: Path) -> Unpacked:
        """See :class:`~model.scenes.unpacking.GeometryReader`."""
        made = Unpacker(folder)
        structure, _ = structure_of(read_json(scene.path))
        if structure is not None:
            asset = _house(scene.path).asset
            made.add(asset or BUILDING, BUILDING, lambda: [(None, structure)])
        return made.result()


def _house(path: Path) -> SceneObject:
    """Floors and walls; no entry of the file."""
    return SceneObject(
        BUILDING, BUILDING, np.eye(4), np.ones(3), asset=f"{path.name}#{BUILDING}", static=True
    )


def _entries(objects: list[Any], place: Place, depth: int = 0) -> Iterator[tuple[Place, Any]]:
    for i, entry in enumerate(objects):
        here = (*place, i)
        yield here, entry
        children = entry.get("children") if isinstance(entry, dict) else None
        if isinstance(children, list) and depth < _MAX_DEPTH:
            yield from _entries(children, (*here, "children"), depth + 1)


def _object(place: Place, entry: Any, rooms: dict[str, str]) -> SceneObject:
    if isinstance(entry, SceneObject):
        return entry
    entry = table(entry, "assetId")
    id = text(entry.get("id"), "id")
    asset = text(entry.get("assetId"), "assetId")
    turn = entry.get("rotation")
    degrees = np.zeros(3) if turn is None else numbers(turn, 3, "rotation")
    world = from_unity(numbers(entry.get("position"), 3, "position"), degrees)
    name = maybe_text(entry.get("object_name")) or re.sub(r"\(.*?\)|\|.*", "", id)
    room = entry.get("roomId")
    kinematic = entry.get("kinematic")
    return SceneObject(
        id=id,
        description=maybe_text(entry.get("description")) or readable(name),
        world_from_object=world,
        scale=np.ones(3),
        asset=asset,
        category=maybe_text(entry.get("category")) or maybe_text(entry.get("objectType")),
        room=rooms.get(room, room) if isinstance(room, str) else None,
        anchor="center",
        static=kinematic if isinstance(kinematic, bool) else None,
        place=place,
    )


MODELS, MOBILITY_MODELS = "ThreedFront", "GPN"
_UP = turned_up("y")[:3, :3]
_REMEDY = "give a room that PhyScene wrote: ThreedFront and GPN, or objects with rot_degree"


class PhySceneReader(JsonReader):
    """``{"ThreedFront": …, "GPN": …}``, or ``{"objects": […], "floor_center", "door_box"}``."""

    name = "physcene"
    description = "PhyScene rooms (retrieved models, or boxes with a floor plan)"
    marks = (b'"ThreedFront"', b'"GPN"', b'"rot_degree"', b'"door_box"')

    def read(self, path: Path) -> Scene:
        """See :class:`~model.scenes.scene.SceneReader`."""
        room = _room(path)
        if isinstance(room.get("objects"), list):
            boxes = [(("objects", i), entry) for i, entry in enumerate(room["objects"])]
            objects, problems = collect(boxes, _box, _label)
        else:
            objects, problems = collect(_models(path, room), _model, _label)
        solids, broken = _building(path, room)
        if solids:
            asset, still = f"{path.name}#{BUILDING}", (np.eye(4), np.ones(3))
            objects = (*objects, SceneObject(BUILDING, BUILDING, *still, asset=asset, static=True))
        every = (*problems, *broken)
        return Scene(path.stem, path, self.name, objects, every, SceneFrame("y"))

    def unpack(self, scene: Scene, folder: Path) -> Unpacked:
        """See :class:`~model.scenes.unpacking.GeometryReader`."""
        made = Unpacker(folder)
        solids, _ = _building(scene.path, _room(scene.path))
        if solids:
            made.add(f"{scene.path.name}#{BUILDING}", BUILDING, lambda: [(None, join(solids))])
        return made.result()


def _room(path: Path) -> dict[str, Any]:
    room = read_json(path)
    if not isinstance(room, dict) or not (
        isinstance(room.get("objects"), list) or {MODELS, MOBILITY_MODELS} & set(room)
    ):
        raise InputFileError(path, "is no PhyScene room", _REMEDY)
    return room


def _models(path: Path, room: dict[str, Any]) -> Iterator[tuple[Place, Any]]:
    for kind in (MODELS, MOBILITY_MODELS):
        table = room.get(kind) or {}
        if not isinstance(table, dict):
            raise InputFileError(path, f"{kind!r} is {shown(table)}, no table of models", _REMEDY)
        for id, entries in table.items():
            for i, entry in enumerate(entries if isinstance(entries, list) else [entries]):
                yield ((kind, id, i) if isinstance(entries, list) else (kind, id)), entry


def _label(entry: Any) -> str | None:
    return maybe_text(entry.get("query_label")) or maybe_text(entry.get("label"))


def _model(place: Place, entry: Any) -> SceneObject:
    entry = table(entry, "theta and position")
    kind, id = str(place[0]), text(place[1], "the model's id")
    scale = entry.get("scale")
    if isinstance(scale, int | float) and not isinstance(scale, bool):
        scale = [scale] * 3
    factors = numbers(scale, 3, "scale")[[0, 2, 1]]
    turn = about_z(float(numbers([entry.get("theta")], 1, "theta")[0]))
    centroid = numbers(entry.get("centroid"), 3, "centroid")
    where = numbers(entry.get("position"), 3, "position") + centroid
    shift = _UP @ where - turn @ (_UP @ centroid)
    if kind == MOBILITY_MODELS:
        # The URDF's base joint turns the OBJ by (π/2, 0, -π/2), a quarter turn beyond "Y is up".
        turn, factors = turn @ about_z(math.pi / 2), factors[[1, 0, 2]]
    if factors.all():
        turn, factors = upright(turn, factors)
    return SceneObject(
        id="_".join(str(step) for step in place[1:]),
        description=readable(_label(entry) or id),
        world_from_object=pose(shift, turn),
        scale=factors,
        asset=id,
        category=maybe_text(entry.get("label")) or maybe_text(entry.get("query_label")),
        place=place,
    )


def _box(place: Place, entry: Any) -> SceneObject:
    entry = table(entry, "label and position")
    label = text(entry.get("label"), "label")
    half = numbers(entry.get("scale"), 3, "scale (half of the box' sizes)")
    x, y, z = (2 * half[[0, 2, 1]]).tolist()
    degrees = float(numbers([entry.get("rot_degree")], 1, "rot_degree")[0])
    where = _UP @ numbers(entry.get("position"), 3, "position")
    return SceneObject(
        id=f"{label}_{place[-1]}",
        description=readable(label),
        world_from_object=pose(where, about_z(math.radians(degrees))),
        scale=np.ones(3),
        asset=label,
        category=label,
        anchor="center",
        fit=(x, y, z),
        box=(x, y, z),
        place=place,
    )


def _building(path: Path, room: dict[str, Any]) -> tuple[list[Loaded], list[SceneProblem]]:
    """Floor and doors in the scene's frame, and what of them couldn't be used."""
    problems: list[SceneProblem] = []
    floor = None
    file = _floor_plan(path)
    if file is not None:
        try:
            center = room.get("floor_center")
            floor = _floor(file, None if center is None else numbers(center, 3, "floor_center"))
        except (InputFileError, SceneObjectError) as error:
            problems.append(SceneProblem(file.name, f"floor plan: {error}"))
    solids = [] if floor is None else [floor]
    doors = room.get("door_box")
    for i, door in enumerate(doors if isinstance(doors, list) else ()):
        try:
            solids.append(_door(numbers(door, 7, "door_box"), floor))
        except SceneObjectError as error:
            problems.append(SceneProblem(f"door {i}", str(error)))
    return solids, problems


def _floor_plan(path: Path) -> Path | None:
    """``room_<n>.obj`` beside ``House_<m>_room_<n>_<type>_bbox.json``, as PhyScene copies it, in
    its house's folder, or ``room_<scene>.obj``."""
    house, room = re.search(r"House_\d+", path.stem), re.search(r"room_\d+", path.stem)
    names = [f"room_{path.stem}.obj"] + ([f"{room[0]}.obj"] if room else [])
    names += [f"{house[0]}/{room[0]}.obj"] if house and room else []
    return next((path.parent / n for n in names if (path.parent / n).is_file()), None)


def _floor(path: Path, center: FloatArray | None) -> Loaded:
    """The plan about the room's middle, +z up; its flat axis tells which way is up in the file:
    some versions of the public code have y and z exchanged."""
    plan = load_geometry(path, DEFAULT_MAX_BYTES)
    if not len(plan.faces) or not np.isfinite(plan.vertices).all():
        raise InputFileError(path, "is no floor plan", "triangles with finite corners are needed")
    low, high = plan.vertices.min(axis=0), plan.vertices.max(axis=0)
    middle = (low + high) / 2 if center is None else center
    order = [0, 2, 1] if np.argmin(high - low) == 2 else [0, 1, 2]
    return plan.moved(affine(_UP @ np.eye(3)[order]) @ affine(shift=-middle))


def _door(box: FloatArray, floor: Loaded | None) -> Loaded:
    """A panel in the middle of (7,) ``x, z, y, size along x, z, y, 0``."""
    x, z, y, wide, deep, high, _ = box
    sizes = np.array([wide, deep, high])
    if (sizes <= 0).any():
        raise SceneObjectError(f"its sizes {sizes.tolist()} must be above 0")
    middle = np.array([x, -z, y])
    if floor is not None:
        sizes[_across(floor, middle[:2])] = THICKNESS
    return _solid(middle - sizes / 2 + BOX_CORNERS * sizes, BOX_FACES, WALL_COLOR)


def _across(floor: Loaded, spot: FloatArray) -> int:
    """The horizontal axis (0 or 1) across the floor's edge that is nearest to (2,) ``spot``."""
    edges = np.sort(np.concatenate([floor.faces[:, [i, (i + 1) % 3]] for i in range(3)]), axis=1)
    edges, counts = np.unique(edges, axis=0, return_counts=True)
    a, b = np.moveaxis(floor.vertices[edges[counts == 1]][..., :2].astype(np.float64), 1, 0)
    along = b - a
    length = np.maximum((along**2).sum(axis=1), 1e-12)
    share = np.clip(((spot - a) * along).sum(axis=1) / length, 0, 1)
    nearest = np.linalg.norm(a + share[:, None] * along - spot, axis=1).argmin()
    return int(np.abs(along[nearest]).argmin())
