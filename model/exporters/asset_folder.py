"""The asset as it is saved: a folder that any URDF reader can open.

::

    object.urdf        links, joints, inertia; see model.kinematics.urdf
    meshes/            link_0.obj, link_0.mtl, texture_….png; link_0.ply beside it for a cloud
    tree.json          the kinematic tree without numbers; see model.kinematics.tree_json
    provenance.json    where it comes from

``provenance.json`` holds what the caller gives (source and hash, prompts, predictor, edits, who,
when, versions) and an entry ``asset`` of this module::

    {"format": 1, "name": str, "category": str | null, "written": ISO 8601 in UTC,
     "parts": [{"link", "name", "mesh": file, "cloud": file | null, "faces", "points", "area"}],
     "original": {"faces", "points", "area"} | null,
     "files": {file: sha256}, "versions": {package: version}}

Files are relative to the folder, areas in m² are those of the parts' own meshes.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import platform
import re
import secrets
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from model.errors import GeometryError, InputFileError
from model.exporters.inertia import inertials_of
from model.geometry.asset import Asset
from model.geometry.mesh import Mesh
from model.geometry.point_cloud import PointCloud
from model.kinematics.articulated_object import ArticulatedObject, Part
from model.kinematics.tree_json import tree_to_json
from model.kinematics.urdf import read_urdf, write_urdf
from model.progress import Progress, no_progress

FORMAT = 1
URDF, TREE, PROVENANCE, MESHES = "object.urdf", "tree.json", "provenance.json", "meshes"
MIN_CLOUD = 4
"""Points below which readers take a file for damaged; such a part comes back as its mesh alone."""
AREA_TOLERANCE = 1e-6
"""Relative: the parts' areas must add up to the original's."""


@dataclass(frozen=True)
class AssetFiles:
    """What was written; all paths lie in ``folder``.

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
    progress: Progress = no_progress,
) -> AssetFiles:
    """Save ``obj``. An asset that is there already is replaced only by a complete new one.

    Args:
        obj: its parts hold the original geometry; a part with a cloud alone gets a mesh too.
        folder: created where needed, its parents as well.
        provenance: anything that JSON can hold.
        original: what the parts were cut from; their areas, or points, must add up to its own.
        progress: told of each part.

    Raises:
        GeometryError: for a part without geometry, or parts that don't add up.
        InputFileError: where the folder holds something else, or can't be written.
    """
    folder = Path(folder).absolute()
    _check_sums(obj, original)
    text = json.dumps(dict(provenance), allow_nan=False)  # fails before anything is written
    _check_target(folder)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        fresh = folder.with_name(f".{folder.name}.{secrets.token_hex(6)}")
        fresh.mkdir()
    except OSError as error:
        raise _unwritable(folder, error) from error
    try:
        parts = _write_parts(obj, fresh, progress)
        _write_texts(obj, fresh, parts, json.loads(text), original)
        _take_place(fresh, folder)
    except OSError as error:
        raise _unwritable(folder, error) from error
    finally:
        shutil.rmtree(fresh, ignore_errors=True)
    return AssetFiles(
        folder,
        folder / URDF,
        folder / TREE,
        folder / PROVENANCE,
        {p["link"]: folder / p["mesh"] for p in parts},
        {p["link"]: folder / p["cloud"] for p in parts if p["cloud"]},
    )


def load_object(folder: str | Path, progress: Progress = no_progress) -> ArticulatedObject:
    """The object of an asset folder, with its category, part names and clouds.

    Raises:
        InputFileError: for a folder that isn't one, or a damaged file in it.
    """
    from model.geometry.readers import read_asset

    folder = Path(folder)
    kept = read_provenance(folder)["asset"]
    obj = read_urdf(folder / URDF, progress=progress)
    entries = {entry["link"]: entry for entry in kept.get("parts", [])}
    parts: list[Part] = []
    for part in obj.parts:
        entry = entries.get(part.link, {})
        if entry.get("cloud") and entry.get("points", 0) >= MIN_CLOUD:
            cloud = read_asset(folder / entry["cloud"], up_axis="z").cloud
            part = replace(part, cloud=cloud)  # noqa: PLW2901
        parts.append(replace(part, name=entry.get("name")))
    return replace(obj, parts=tuple(parts), category=kept.get("category"))


def read_provenance(folder: str | Path) -> dict[str, Any]:
    """``provenance.json`` of an asset folder.

    Raises:
        InputFileError: where it is missing, damaged, or of a newer format.
    """
    path = Path(folder) / PROVENANCE
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputFileError(
            path, error.strerror or "can't be read", "give the folder of a saved asset"
        ) from error
    except ValueError as error:
        raise InputFileError(path, f"is not JSON ({error})", "save the asset again") from error
    asset = data.get("asset") if isinstance(data, dict) else None
    if not isinstance(asset, dict) or not isinstance(asset.get("format"), int):
        raise InputFileError(path, "has no 'asset' entry", "save the asset again")
    if asset["format"] > FORMAT:
        raise InputFileError(
            path, f"has format {asset['format']}, newer than {FORMAT}", "update ArtiWorld"
        )
    return data


def file_stems(links: Sequence[str]) -> dict[str, str]:
    """Link → a file name without suffix that every file system takes; ``link_0`` stays."""
    out: dict[str, str] = {}
    taken: set[str] = set()
    for link in links:
        base = stem = re.sub(r"[^A-Za-z0-9_-]+", "_", link).strip("_") or "part"
        i = 2
        while stem.lower() in taken:
            stem, i = f"{base}_{i}", i + 1
        taken.add(stem.lower())
        out[link] = stem
    return out


def _unwritable(folder: Path, error: OSError) -> InputFileError:
    return InputFileError(
        folder, f"can't be written ({error.strerror or error})", "check space and permissions"
    )


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


def _write_parts(obj: ArticulatedObject, folder: Path, progress: Progress) -> list[dict[str, Any]]:
    from model.geometry.writers import write_cloud, write_mesh

    (folder / MESHES).mkdir()
    stems = file_stems([p.link for p in obj.parts])
    out: list[dict[str, Any]] = []
    for i, part in enumerate(obj.parts):
        progress(i / len(obj.parts), f"writing {part.link}")
        stem = f"{MESHES}/{stems[part.link]}"
        mesh, cloud = part.mesh, part.cloud
        if mesh is not None and not len(mesh.faces):
            mesh = None
        if cloud is not None and not len(cloud):
            cloud = None
        if mesh is None and cloud is None:
            raise GeometryError(
                f"part {part.link!r} has no face and no point; give it some or remove it"
            )
        if cloud is not None:
            write_cloud(cloud, folder / f"{stem}.ply")
        shape = mesh if mesh is not None else _surface_of_cloud(cloud)  # type: ignore[arg-type]
        write_mesh(shape, folder / f"{stem}.obj")
        out.append(
            {
                "link": part.link,
                "name": part.name,
                "mesh": f"{stem}.obj",
                "cloud": f"{stem}.ply" if cloud is not None else None,
                "faces": len(shape.faces),
                "points": 0 if cloud is None else len(cloud),
                "area": float(shape.face_areas.sum()),
                "flat": _is_flat(shape),
            }
        )
    progress(1.0, "written")
    return out


def _surface_of_cloud(cloud: PointCloud) -> Mesh:
    """A mesh for the simulator; a box for points that span no surface."""
    from model.geometry.reconstruct import mesh_from_cloud

    with contextlib.suppress(GeometryError):
        mesh = mesh_from_cloud(cloud)
        if len(mesh.faces):
            return mesh
    import trimesh

    low, high = cloud.bounds
    size = np.maximum(high - low, max(0.01 * float((high - low).max()), 1e-3))
    box = trimesh.creation.box(extents=size)
    box.apply_translation((low + high) / 2)
    colors = None
    if cloud.colors is not None:
        mean = np.rint(cloud.colors.mean(axis=0))
        colors = np.tile(np.array([*mean, 255], np.uint8), (len(box.vertices), 1))
    return Mesh(np.asarray(box.vertices), np.asarray(box.faces), vertex_colors=colors)


def _is_flat(mesh: Mesh) -> bool:
    """Whether MuJoCo would refuse the mesh: it wants four corners and some volume."""
    corners = np.unique(mesh.vertices[np.unique(mesh.faces)], axis=0)
    if len(corners) < 4:
        return True
    area = float(mesh.face_areas.sum())
    if area <= 0:
        return True
    middle = (mesh.triangles.mean(axis=1) * mesh.face_areas[:, None]).sum(axis=0) / area
    away = mesh.triangles[:, 0] - middle
    volume = float(np.abs(np.einsum("fi,fi->f", away, mesh.face_cross)).sum()) / 6
    return volume < 1e-7 * area * float(np.ptp(corners, axis=0).max())


def _write_texts(
    obj: ArticulatedObject,
    folder: Path,
    parts: list[dict[str, Any]],
    provenance: dict[str, Any],
    original: Asset | None,
) -> None:
    flat = any([p.pop("flat") for p in parts])  # a list: every entry loses its key
    write_urdf(
        obj,
        folder / URDF,
        {p["link"]: [p["mesh"]] for p in parts},
        inertials=inertials_of(obj),
        mujoco_visuals=not flat,
    )
    _write_json(folder / TREE, tree_to_json(obj.tree))
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    provenance["asset"] = {
        "format": FORMAT,
        "name": obj.name,
        "category": obj.category,
        "written": datetime.now(UTC).isoformat(timespec="seconds"),
        "parts": parts,
        "original": None if original is None else _sums(original),
        "files": {p.relative_to(folder).as_posix(): _sha256(p) for p in files},
        "versions": _versions(),
    }
    _write_json(folder / PROVENANCE, provenance)


def _sums(original: Asset) -> dict[str, Any]:
    mesh, cloud = original.mesh, original.cloud
    return {
        "faces": 0 if mesh is None else len(mesh.faces),
        "points": 0 if cloud is None else len(cloud),
        "area": 0.0 if mesh is None else float(mesh.face_areas.sum()),
    }


def _write_json(path: Path, data: Any) -> None:
    text = json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _versions() -> dict[str, str]:
    out = {"python": platform.python_version()}
    for package in ("artiworld", "numpy", "scipy", "open3d", "trimesh"):
        with contextlib.suppress(metadata.PackageNotFoundError):
            out[package] = metadata.version(package)
    return out


def _take_place(fresh: Path, folder: Path) -> None:
    """Put ``fresh`` where ``folder`` is; whatever fails, one of the two is left whole."""
    if not folder.exists():
        fresh.rename(folder)
        return
    old = fresh.with_name(fresh.name + ".old")
    folder.rename(old)
    try:
        fresh.rename(folder)
    except OSError:
        old.rename(folder)
        raise
    shutil.rmtree(old, ignore_errors=True)
