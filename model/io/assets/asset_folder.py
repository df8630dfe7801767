"""The asset as it is saved: a folder that any URDF reader can open.

::

    object.urdf        links, joints, inertia; see model.io.urdf.writer
    meshes/            door_1.obj, door_1.mtl, texture_….png; door_1.ply beside it for a cloud
    meshes/collision/  door_1_0.obj, …: convex hulls; other shapes are in the URDF itself
    tree.json          the kinematic tree without numbers; see model.io.tree_json
    provenance.json    where it comes from

``provenance.json`` holds what the caller gives (source and hash, prompts, predictor, edits, who,
when, versions) and an entry ``asset`` of this module::

    {"format": 1, "name": str, "category": str | null, "written": ISO 8601 in UTC,
     "parts": [{"link", "name", "mesh": file, "cloud": file | null, "faces", "points", "area"}],
     "original": {"faces", "points", "area"} | null, "give_way": [joint, ...],
     "told": {"masses": [link, ...], "dynamics": {joint: ["damping", ...]},
              "collision": [link, ...]},
     "completed": {link: ["closed surface", ...]},
     "names": {"links": {link: link in the session}, "joints": {joint: joint in the session}},
     "files": {file: sha256}, "versions": {package: version}}

Files are relative to the folder, areas in m² are those of the parts' own meshes; ``give_way`` are
the joints whose collision shapes were to be shrunk; ``told`` names the links whose mass, the
joints of whose dynamics something, and the links whose collision shapes are declared; all else
was computed. Links and joints have the names of :mod:`model.io.file_names`; what the caller gives
has those of the session, ``link_1``, and ``names`` leads back to them. ``completed``, where it is
there, names the completion of the parts' meshes (see :mod:`model.geometry.completion`); their
clouds are what was scanned.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from model.core.articulated_object import ArticulatedObject, remarks_of
from model.core.asset import Asset
from model.core.errors import GeometryError, InputFileError
from model.core.files import draft_of, file_sha256, written_to
from model.core.packages import installed_versions
from model.core.progress import Progress, no_progress
from model.io.assets.reader import (
    AREA_TOLERANCE,
    COMPLETED,
    DECLARED,
    FORMAT,
    PROVENANCE,
    TREE,
    URDF,
    declared_entry,
    load_object,
    read_provenance,
    recover,
    reload_check,
)
from model.io.export.part_files import PartFile, write_parts
from model.io.export.urdf import write_urdf_of
from model.io.file_names import FileNames
from model.io.tree_json import tree_to_json
from model.physics.affordances import find_affordances
from model.physics.simulation_values import Physics

__all__ = [
    "AssetFiles",
    "load_object",
    "publish",
    "read_provenance",
    "reload_check",
    "write_asset",
    "write_draft",
]


@dataclass(frozen=True)
class AssetFiles:
    """The written files; all paths lie in ``folder``.

    Attributes:
        meshes: link → the mesh that the URDF refers to.
        clouds: link → the cloud of a scanned part.
    """

    folder: Path
    urdf: Path
    tree: Path
    provenance: Path
    meshes: Mapping[str, Path]
    clouds: Mapping[str, Path]


def write_asset(
    obj: ArticulatedObject,
    folder: str | Path,
    *,
    provenance: Mapping[str, Any],
    original: Asset | None = None,
    physics: Physics | None = None,
    progress: Progress = no_progress,
) -> AssetFiles:
    """Save ``obj`` with links named after its parts. An asset that is there already is replaced
    only by a complete new one.

    Args:
        obj: its parts hold the original geometry; a part with a cloud alone gets a mesh too.
        folder: created where needed, its parents as well.
        provenance: anything that JSON can hold.
        original: what the parts were cut from; their areas, or points, must add up to its own.
        physics: mass, collision shapes and joint dynamics; None leaves the shapes out.
        progress: reports each part.

    Raises:
        GeometryError: for a part without geometry, or parts that don't add up.
        InputFileError: where the folder holds something else, or can't be written.
    """
    make = partial(write_draft, obj, original=original, physics=physics, progress=progress)
    return _put(make, Path(folder), provenance)


def write_draft(
    obj: ArticulatedObject,
    draft: Path,
    *,
    original: Asset | None = None,
    physics: Physics | None = None,
    progress: Progress = no_progress,
) -> None:
    """Everything of an asset but where it comes from, into the new folder ``draft``.

    It reads as an asset does; :func:`publish` makes it one.

    Raises:
        GeometryError: for a part without geometry, or parts that don't add up.
        OSError: where the folder is there already, or can't be written.
    """
    _check_sums(obj, original)
    names = FileNames.of(obj)
    obj, physics = names.object(obj), physics and names.physics(physics)
    draft.mkdir()
    parts = write_parts(obj, draft, progress=progress)
    _write_texts(obj, draft, parts, original, physics, names)


def publish(draft: Path, folder: Path, provenance: Mapping[str, Any]) -> AssetFiles:
    """Say where the asset in ``draft`` comes from, and let it take its place; the draft is gone.

    Raises:
        InputFileError: where the folder holds something else, or can't be written.
    """
    return _put(lambda fresh: shutil.move(draft, fresh), folder, provenance)


def _put(make: Callable[[Path], object], folder: Path, provenance: Mapping[str, Any]) -> AssetFiles:
    """Let the asset that ``make`` makes take its place, and say where it comes from."""
    folder = folder.absolute()
    text = json.dumps(dict(provenance), allow_nan=False)  # fails before anything is written
    recover(folder)
    _check_target(folder)
    with written_to(folder, "check space and permissions"), draft_of(folder) as fresh:
        make(fresh)
        entry: dict[str, Any] = read_provenance(fresh)["asset"]
        entry["written"] = _now()
        _write_json(fresh / PROVENANCE, {**json.loads(text), "asset": entry})
    clouds = {p["link"]: folder / p["cloud"] for p in entry["parts"] if p["cloud"]}
    return AssetFiles(
        folder,
        folder / URDF,
        folder / TREE,
        folder / PROVENANCE,
        {p["link"]: folder / p["mesh"] for p in entry["parts"]},
        clouds,
    )


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def _check_target(folder: Path) -> None:
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return
    if not (folder / PROVENANCE).is_file():
        raise InputFileError(
            folder, "holds something that is not a saved asset", "choose another folder"
        )


def _check_sums(obj: ArticulatedObject, original: Asset | None) -> None:
    if original is None:
        return
    if original.mesh is not None:
        whole = float(original.mesh.face_areas.sum())
        cut = sum(float(p.mesh.face_areas.sum()) for p in obj.parts if p.mesh is not None)
        if abs(cut - whole) > AREA_TOLERANCE * max(whole, 1e-300):
            raise GeometryError(
                f"{obj.name}: the parts' area is {cut:.9g} m², the original's {whole:.9g} m²; "
                "every face must be in exactly one part"
            )
    elif original.cloud is not None:
        count = sum(len(p.cloud) for p in obj.parts if p.cloud is not None)
        if count != len(original.cloud):
            raise GeometryError(
                f"{obj.name}: the parts have {count} points, the original {len(original.cloud)}; "
                "every point must be in exactly one part"
            )


def _write_texts(
    obj: ArticulatedObject,
    folder: Path,
    parts: tuple[PartFile, ...],
    original: Asset | None,
    physics: Physics | None,
    names: FileNames,
) -> None:
    write_urdf_of(obj, parts, folder / URDF, physics)
    remarks = list(remarks_of(obj.parts))
    collision = {} if physics is None else physics.collision
    affordances = find_affordances(obj, collision, remarks=remarks)
    _write_json(folder / TREE, tree_to_json(obj.tree, affordances))
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    entry = {
        "format": FORMAT,
        "name": obj.name,
        "category": obj.category,
        "written": _now(),
        "parts": [_entry(p) for p in parts],
        "names": names.to_json(),
        "remarks": remarks,
        "original": None if original is None else _sums(original),
        "give_way": [j.name for j in obj.tree.joints if j.give_way],
        DECLARED: declared_entry(obj, () if physics is None else physics.declared_shapes),
        "files": {p.relative_to(folder).as_posix(): file_sha256(p) for p in files},
        "versions": installed_versions("artiworld", "numpy", "scipy", "open3d", "trimesh"),
    }
    if completed := {p.link: list(p.completed) for p in obj.parts if p.completed}:
        entry[COMPLETED] = completed
    _write_json(folder / PROVENANCE, {"asset": entry})


def _entry(part: PartFile) -> dict[str, Any]:
    out = asdict(part)
    del out["flat"]
    return out


def _sums(original: Asset) -> dict[str, Any]:
    mesh, cloud = original.mesh, original.cloud
    return {
        "faces": 0 if mesh is None else len(mesh.faces),
        "points": 0 if cloud is None else len(cloud),
        "area": 0.0 if mesh is None else float(mesh.face_areas.sum()),
    }


def _write_json(path: Path, data: Any) -> None:
    text = json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False)
    path.write_bytes((text + "\n").encode("utf-8", "backslashreplace"))  # half a surrogate: \ud800
