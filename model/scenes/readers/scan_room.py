"""A scanned room: PLY with a label a point (or vertex), each labelled instance an object cut out of
it, walls and floor as a static ``building``, and the leftovers as a static ``background``. The
leftovers hold bits of everything, so they stop no joint, and where a floor is labelled they have no
collision shapes.

Labels are a property of the PLY's vertices, or in an NPZ beside it (``room_labels.npz`` or
``room.npz`` for ``room.ply``): ``instance`` (N,), -1 for none, and, for what the objects are,
``category`` (N,) texts or ``segment20`` (N,) numbers of ScanNet's 20 classes. Where nobody has
labelled the room, ``room_boxes.json`` holds boxes drawn round objects::

    {"objects": [{"id", "category", "description", "center": [x, y, z], "size": [x, y, z],
                  "yaw": radians}]}

Metres, +z up, as PLY scans are taken.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.errors import InputFileError
from model.io.formats.loaded import Loaded
from model.io.formats.ply import read_ply_columns
from model.io.formats.points import npz_arrays
from model.io.geometry_files import MIN_POINTS
from model.scenes.scene import Scene, SceneObject, SceneObjectError, SceneProblem
from model.scenes.unpacking import Unpacked, Unpacker
from model.scenes.values import (
    Place,
    about_z,
    collect,
    maybe_text,
    numbers,
    pose,
    read_json,
    table,
    text,
)

Labels = npt.NDArray[np.int64]

BACKGROUND, BUILDING, ROOM = "background", "building", "room"
"""Surface without a label, walls and floor, and a room that nobody has labelled."""
SCANNET20 = (
    "wall", "floor", "cabinet", "bed", "chair", "sofa", "table", "door", "window", "bookshelf",
    "picture", "counter", "desk", "curtain", "refrigerator", "shower curtain", "toilet", "sink",
    "bathtub", "other furniture",
)  # fmt: skip
"""Names of the ScanNet benchmark's classes in its order."""
_BUILDING = frozenset({"wall", "floor", "ceiling"})
PROPERTIES = ("instance", "instance_id", "instanceid", "object_id", "objectid")
"""Properties of PLY vertices that hold instances."""
_LABELS = (*PROPERTIES, "category", "segment20")
FEWEST = 50
"""Points of an instance below which it is a splinter."""
_GRID = 128.0
"""Origins are multiples of 1/128 m: taking one off a float32 coordinate loses nothing."""


@dataclass(frozen=True, eq=False)
class Instance:
    """One object of the room.

    Attributes:
        id, category, description: as the labels tell.
        points: (K,) its vertices, ascending.
        floor: whether a floor is among them.
    """

    id: str
    category: str | None
    description: str
    points: Labels
    floor: bool = False


class ScanRoomReader:
    """PLY with instance labels in it or beside it, or boxes beside it."""

    name = "scan"
    description = "scanned rooms (PLY with instance labels or boxes)"

    def recognises(self, path: Path, head: bytes) -> bool:
        """See :class:`~model.scenes.scene.SceneReader`."""
        if path.suffix.lower() != ".ply" or not head.startswith(b"ply"):
            return False
        header = head.split(b"end_header")[0].decode("latin-1").lower()
        inside = re.search(rf"property \w+ ({'|'.join(PROPERTIES)})\s", header)
        return inside is not None or _beside(path) is not None

    def read(self, path: Path) -> Scene:
        """See :class:`~model.scenes.scene.SceneReader`."""
        loaded, columns = read_ply_columns(path, PROPERTIES)
        found, problems = _instances(path, loaded, columns)
        every = [*found, *_rest(loaded, found)]
        entries: list[tuple[Place, Any]] = [(("instance", i.id), i) for i in every]
        make = partial(_object, path.name, loaded, any(i.floor for i in found))
        objects, broken = collect(entries, make, lambda i: i.id)
        return Scene(path.stem, path, self.name, objects, (*problems, *broken))

    def unpack(self, scene: Scene, folder: Path) -> Unpacked:
        """See :class:`~model.scenes.unpacking.GeometryReader`."""
        loaded, columns = read_ply_columns(scene.path, PROPERTIES)
        found, _ = _instances(scene.path, loaded, columns)
        by_id = {i.id: i for i in [*found, *_rest(loaded, found)]}
        made = Unpacker(folder)
        for n, obj in enumerate(scene.objects):
            origin = obj.world_from_object[:3, 3]
            points = by_id[str(obj.place[1])].points
            made.add(obj.asset or obj.id, f"instance_{n}", partial(_cut, loaded, points, origin))
        return made.result()


def _beside(path: Path) -> Path | None:
    for name in (f"{path.stem}_labels.npz", f"{path.stem}.npz", f"{path.stem}_boxes.json"):
        if path.with_name(name).is_file():
            return path.with_name(name)
    return None


def _instances(
    path: Path, loaded: Loaded, columns: dict[str, npt.NDArray[Any]]
) -> tuple[list[Instance], tuple[SceneProblem, ...]]:
    beside = _beside(path)
    if beside is not None and beside.suffix == ".json":
        return _boxed(beside, loaded)
    arrays = columns if beside is None else npz_arrays(beside, _LABELS)[0]
    labels = next((arrays[k] for k in PROPERTIES if k in arrays), None)
    if labels is None and beside is None:
        message = (
            "nobody has labelled this room: pick objects out of it in the browser, or put boxes "
            f"round them into {path.stem}_boxes.json"
        )
        everything = Instance(ROOM, None, ROOM, np.arange(len(loaded.vertices)))
        return [everything], (SceneProblem(ROOM, message, skipped=False),)
    if labels is None:
        raise InputFileError(
            beside or path,
            "has no array 'instance'",
            f"label the room's points, or put boxes into {path.stem}_boxes.json",
        )
    count = len(loaded.vertices)
    if labels.shape != (count,) or labels.dtype.kind not in "iuf":
        raise InputFileError(
            beside or path,
            f"'instance' is {labels.dtype} of shape {labels.shape}",
            f"one whole number for each of the {count} vertices is needed",
        )
    if labels.dtype.kind == "f":
        labels = np.where(np.isfinite(labels), labels, -1)
    names = _categories(arrays, count)
    whole = labels.astype(np.int64)
    order = np.argsort(whole, kind="stable")
    kept, starts = np.unique(whole[order], return_index=True)
    found, problems, building, floor = [], [], [], False
    for label, points in zip(kept.tolist(), np.split(order, starts[1:]), strict=True):
        if label < 0:
            continue
        category = None if names is None else _commonest(names[points])
        if category in _BUILDING:
            building.append(points)
            floor |= category == "floor"
            continue
        id = f"{category or 'object'} {label}"
        if len(points) < FEWEST:
            message = f"has {len(points)} points and stays in the background"
            problems.append(SceneProblem(id, message))
            continue
        found.append(Instance(id, category, category or "object", points))
    if building:
        every = np.sort(np.concatenate(building))
        found.append(Instance(BUILDING, None, BUILDING, every, floor))
    return found, tuple(problems)


def _categories(arrays: dict[str, npt.NDArray[Any]], count: int) -> npt.NDArray[Any] | None:
    """(N,) texts, "" if unknown."""
    given, classes = arrays.get("category"), arrays.get("segment20")
    if given is not None and given.shape == (count,) and given.dtype.kind == "U":
        return given
    if classes is None or classes.shape != (count,) or classes.dtype.kind not in "iu":
        return None
    known = (classes >= 0) & (classes < len(SCANNET20))
    return np.where(known, np.array(SCANNET20)[np.where(known, classes, 0)], "")


def _commonest(names: npt.NDArray[Any]) -> str | None:
    values, counts = np.unique(names, return_counts=True)
    best = str(values[counts.argmax()]).strip()
    return best or None


def _boxed(path: Path, loaded: Loaded) -> tuple[list[Instance], tuple[SceneProblem, ...]]:
    """Objects in boxes; a point belongs to the first box round it."""
    message = read_json(path)
    listed = message.get("objects") if isinstance(message, dict) else None
    if not isinstance(listed, list):
        raise InputFileError(path, "has no list 'objects'", "boxes with id, center and size")
    free = np.ones(len(loaded.vertices), bool)
    found: list[Instance] = []
    problems: list[SceneProblem] = []
    for n, entry in enumerate(listed):
        try:
            made = _in_box(entry, loaded, free)
        except SceneObjectError as error:
            id = maybe_text(entry.get("id")) if isinstance(entry, dict) else None
            problems.append(SceneProblem(id or f"objects {n}", str(error)))
            continue
        if any(made.id == i.id for i in found) or made.id in (BACKGROUND, BUILDING, ROOM):
            problems.append(SceneProblem(made.id, "the id is there twice; ids must differ"))
            continue
        free[made.points] = False
        found.append(made)
    return found, tuple(problems)


def _in_box(entry: Any, loaded: Loaded, free: npt.NDArray[np.bool_]) -> Instance:
    entry = table(entry, "id, center and size")
    id = text(entry.get("id"), "id")
    center, size = numbers(entry.get("center"), 3, "center"), numbers(entry.get("size"), 3, "size")
    yaw = float(numbers([entry.get("yaw", 0.0)], 1, "yaw")[0])
    if (size <= 0).any():
        raise SceneObjectError(f"size {size.tolist()} must be three positive numbers")
    local = (loaded.vertices - center) @ about_z(yaw)
    points = np.flatnonzero(free & (np.abs(local) <= size / 2).all(1))
    if len(points) < FEWEST:
        raise SceneObjectError(f"its box holds {len(points)} points that are in no other box")
    category = maybe_text(entry.get("category"))
    described = maybe_text(entry.get("description")) or category or id
    return Instance(id, category, described, points)


def _rest(loaded: Loaded, found: list[Instance]) -> list[Instance]:
    rest = np.ones(len(loaded.vertices), bool)
    for instance in found:
        rest[instance.points] = False
    points = np.flatnonzero(rest)
    return [Instance(BACKGROUND, None, BACKGROUND, points)] if len(points) >= MIN_POINTS else []


def _object(
    file: str, loaded: Loaded, floor: bool, place: Place, instance: Instance
) -> SceneObject:
    points = loaded.vertices[instance.points]
    points = points[np.isfinite(points).all(1)]
    if not len(points):
        raise SceneObjectError("all its points are NaN or infinite")
    low, high = points.min(0).astype(np.float64), points.max(0).astype(np.float64)
    middle = np.array([*((low + high) / 2)[:2], low[2]])
    return SceneObject(
        id=instance.id,
        description=instance.description,
        world_from_object=pose(np.rint(middle * _GRID) / _GRID),
        scale=np.ones(3),
        asset=f"{file}#{instance.id}",
        category=instance.category,
        static=True if instance.id in (BACKGROUND, BUILDING, ROOM) else None,
        place=place,
        obstacle=instance.id not in (BACKGROUND, ROOM),
        base="fixed",  # the shapes of scanned neighbours overlap: let go, they fly apart
        # Bits of everything would fill the room; they are only needed where they are the floor.
        solid=not (instance.id == BACKGROUND and floor),
    )


def _cut(loaded: Loaded, points: Labels, origin: npt.NDArray[np.float64]) -> list[Any]:
    """The instance about its own origin, with the faces whose corners it owns."""
    vertices = loaded.vertices[points].astype(np.float64) - origin
    colors = None if loaded.colors is None else loaded.colors[points]
    if not len(loaded.faces):
        normals = None if loaded.normals is None else loaded.normals[points]
        return [(None, Loaded(vertices, normals=normals, colors=colors))]
    number = np.full(len(loaded.vertices), -1)
    number[points] = np.arange(len(points))
    faces = number[loaded.faces]
    faces = faces[(faces >= 0).all(1)]
    return [(None, Loaded(vertices, faces, colors=colors))]
