"""PhysXNet folders (Cao et al., *PhysX-3D*, 2025): ``finaljson/<id>.json`` and part meshes.

Meshes lie in ``partseg/<id>/objs/<label>.obj``, Y up as in PartNet, with a longest side of about 1;
``dimension`` ("80*10*25", centimetres) gives the scale. ``group_info`` holds the mechanism: group
"0" is the base, every other one is ``[labels, parent group, params, type]``:

======  ==========================  ===============================================================
type    motion                      params, in the meshes' frame and units
======  ==========================  ===============================================================
A       free: not articulated       none
B       slide                       0-2 axis, 3-5 a point, the last two the range
C       turn                        0-2 axis, 3-5 pivot, the last two the range in units of pi
D       ball                        3-5 pivot; three turns of ±pi about x, y and z
CB      turn, then slide            0-2, 3-5, 6-7 the turn; 8-10 the slide, last two its range
======  ==========================  ===============================================================

A turn of ±pi is continuous. Groups of type A belong to their parent's part. The format is known
from public readers of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from model.core.articulated_object import Part
from model.core.errors import InputFileError, KinematicsError
from model.core.files import read_json
from model.core.geometry import Mesh, affine, merged
from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.data.registry import GroundTruth
from model.io.geometry_files import turned_up
from model.io.merging import merge_rigid
from model.io.open_asset import open_asset

Vector = tuple[float, float, float]
_AXES: tuple[Vector, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
_TO_Z_UP = turned_up("y")[:3, :3]
_LEAST = {"B": 8, "C": 8, "D": 6, "CB": 13}
"""Numbers that each type needs."""


@dataclass(frozen=True)
class PhysXNet:
    """A folder with ``finaljson`` and ``partseg``."""

    root: Path
    name: str = "physxnet"

    def ids(self) -> tuple[str, ...]:
        """Stems of ``finaljson/*.json``, sorted.

        Raises:
            InputFileError: where there is none.
        """
        found = tuple(sorted(p.stem for p in (Path(self.root) / "finaljson").glob("*.json")))
        if not found:
            raise InputFileError(
                self.root,
                "no PhysXNet object in it",
                "give the folder that holds finaljson/<id>.json and partseg/",
            )
        return found

    def category(self, object_id: str) -> str | None:
        """See :class:`~model.data.registry.Dataset`."""
        said = self._read(object_id).get("category")
        return said if isinstance(said, str) else None

    def load(self, object_id: str) -> GroundTruth:
        """Read one object: +z up, metres by its ``dimension``.

        Raises:
            InputFileError: naming the file and what is wrong.
        """
        path, data = self._path(object_id), self._read(object_id)
        groups = _groups(path, data)
        labels = {label: key for key, g in groups.items() for label in g.labels}
        meshes = {label: self._mesh(object_id, label) for label in labels}
        scale, notes = _scale(data, list(meshes.values()))
        transform = affine(scale * _TO_Z_UP)
        parts: dict[str, Part] = {}
        for key, group in groups.items():
            own = [meshes[label] for label in group.labels]
            if own:
                parts[f"link_{key}"] = Part(f"link_{key}", merged(own).moved(transform))
        if not parts:
            raise InputFileError(path, "group_info names no part", "it needs at least one label")
        said = {p.get("label"): p.get("name") for p in data.get("parts", []) if isinstance(p, dict)}
        names = {
            f"link_{key}": str(said[g.labels[0]])
            for key, g in groups.items()
            if g.labels and said.get(g.labels[0])
        }
        try:
            tree = _tree(path, groups, scale, set(parts))
            obj, merges = merge_rigid(
                object_id, tree, parts, names=names, category=self.category(object_id)
            )
        except KinematicsError as error:
            raise InputFileError(path, f"group_info is no tree: {error}") from error
        free = [f"link_{k}: free, so it belongs to its parent" for k, g in groups.items() if g.free]
        return GroundTruth(object_id, obj, (*notes, *free, *merges))

    def _path(self, object_id: str) -> Path:
        return Path(self.root) / "finaljson" / f"{object_id}.json"

    def _read(self, object_id: str) -> dict[str, Any]:
        path = self._path(object_id)
        data = read_json(path)
        if not isinstance(data, dict) or not isinstance(data.get("group_info"), dict):
            raise InputFileError(path, "has no 'group_info'", "see PhysXNet's finaljson")
        return data

    def _mesh(self, object_id: str, label: int) -> Mesh:
        path = Path(self.root) / "partseg" / object_id / "objs" / f"{label}.obj"
        if not path.is_file():
            raise InputFileError(path, f"the mesh of part {label} isn't there")
        mesh = open_asset(path, up_axis="z").mesh
        if mesh is None:
            raise InputFileError(path, "has no faces")
        return mesh


@dataclass(frozen=True)
class _Group:
    labels: tuple[int, ...]
    parent: str | None = None
    params: tuple[float, ...] = ()
    kind: str = ""

    @property
    def free(self) -> bool:
        return self.kind == "A"


def _groups(path: Path, data: dict[str, Any]) -> dict[str, _Group]:
    out: dict[str, _Group] = {}
    for key, value in data["group_info"].items():
        where = f"group_info[{key!r}]"
        try:
            if str(key) == "0":
                out["0"] = _Group(_labels(value))
                continue
            labels, parent, params, kind = value
            numbers = tuple(float(v) for v in (params or ()))
            out[str(key)] = _Group(_labels(labels), str(parent), numbers, str(kind).strip())
        except (TypeError, ValueError) as error:
            remedy = "it must be [labels, parent group, params, type]"
            raise InputFileError(path, f"{where}: {error}", remedy) from None
        group = out[str(key)]
        if group.kind not in ("A", *_LEAST):
            raise InputFileError(path, f"{where}: type {group.kind!r} is none of A, B, C, D, CB")
        if len(group.params) < _LEAST.get(group.kind, 0) or not np.isfinite(group.params).all():
            need = _LEAST.get(group.kind, 0)
            raise InputFileError(path, f"{where}: needs {need} finite numbers, got {group.params}")
    if "0" not in out:
        raise InputFileError(path, "group_info has no group '0', the base")
    return out


def _labels(value: Any) -> tuple[int, ...]:
    flat = value if isinstance(value, list) else [value]
    nested = [v for item in flat for v in (item if isinstance(item, list) else [item])]
    return tuple(int(v) for v in nested)


def _scale(data: dict[str, Any], meshes: list[Mesh]) -> tuple[float, tuple[str, ...]]:
    """Metres per mesh unit, from the longest side."""
    text = str(data.get("dimension", "")).split(" ")[0]
    try:
        longest = max(float(v) for v in text.split("*")) / 100.0
    except ValueError:
        longest = 0.0
    bounds = np.stack([m.bounds for m in meshes]) if meshes else np.zeros((1, 2, 3))
    side = float((bounds[:, 1].max(0) - bounds[:, 0].min(0)).max())
    if not (math.isfinite(longest) and longest > 0 and side > 0):
        return 1.0, (f"no usable dimension ({text[:40]!r}): mesh units are taken for metres",)
    return longest / side, ()


def _tree(path: Path, groups: dict[str, _Group], scale: float, owning: set[str]) -> KinematicTree:
    links: list[str] = []
    joints: list[Joint] = []

    def link(key: str) -> str:
        return f"link_{key}" if f"link_{key}" in owning else f"group_{key}"

    for key, group in groups.items():
        links.append(link(key))
        if group.parent is None:
            continue
        if group.parent not in groups:
            raise InputFileError(path, f"group_info[{key!r}]: no group {group.parent!r}")
        chain = _motions(key, group, scale)
        above = link(group.parent)
        for i, (kind, axis, origin, limits) in enumerate(chain):
            last = i == len(chain) - 1
            below = link(key) if last else f"helper_{key}_{i}"
            if not last:
                links.append(below)
            lower, upper = limits or (None, None)
            joints.append(Joint(f"joint_{key}_{i}", kind, above, below, axis, origin, lower, upper))  # type: ignore[arg-type]
            above = below
    return KinematicTree(tuple(links), tuple(joints))


def _motions(
    key: str, group: _Group, scale: float
) -> list[tuple[str, Vector, Vector, tuple[float, float] | None]]:
    """The joints of a group from its parent on: type, axis, origin, limits."""
    p = group.params
    if group.free:
        return [("fixed", (0.0, 0.0, 1.0), (0.0, 0.0, 0.0), None)]
    origin = _turned(p[3:6], scale)
    if group.kind == "D":
        limits = (-math.pi, math.pi)
        return [("revolute", axis, origin, limits) for axis in _AXES]
    if np.linalg.norm(p[:3]) < 1e-9:
        raise KinematicsError([f"group {key}: the axis is zero"])
    if group.kind == "B":
        return [("prismatic", _turned(p[:3]), origin, _ordered(p[-2:], scale))]
    turn = p[6:8] if group.kind == "CB" else p[-2:]
    if max(turn) - min(turn) >= 2.0 - 1e-9:
        first = ("continuous", _turned(p[:3]), origin, None)
    else:
        first = ("revolute", _turned(p[:3]), origin, _ordered(turn, math.pi))
    if group.kind == "C":
        return [first]
    if np.linalg.norm(p[8:11]) < 1e-9:
        raise KinematicsError([f"group {key}: the slide's axis is zero"])
    return [first, ("prismatic", _turned(p[8:11]), origin, _ordered(p[-2:], scale))]


def _turned(v: tuple[float, ...], scale: float = 1.0) -> Vector:
    x, y, z = scale * (_TO_Z_UP @ np.asarray(v, np.float64))
    return float(x), float(y), float(z)


def _ordered(limits: tuple[float, ...], scale: float) -> tuple[float, float]:
    a, b = (float(v) * scale for v in limits)
    return min(a, b), max(a, b)
