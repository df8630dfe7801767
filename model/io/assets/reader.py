"""Read saved assets; ``asset_folder`` writes them and documents the format."""

from __future__ import annotations

import logging
from collections.abc import Collection
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Literal

from model.core.affordance import Affordance
from model.core.articulated_object import ArticulatedObject, Part, remarks_of
from model.core.errors import GeometryError, InputFileError
from model.core.files import OLD, read_json
from model.core.joint import DeclaredDynamics
from model.core.progress import Progress, no_progress
from model.core.textures import one_reading
from model.io.geometry_files import SUFFIXES, read_geometry_file
from model.io.model_files import articulated_stage, read_model
from model.io.part_folder import remarks_in
from model.io.tree_json import affordances_in
from model.io.urdf.declared_physics import DeclaredPhysics

FORMAT = 1
URDF, TREE, PROVENANCE, MESHES = "object.urdf", "tree.json", "provenance.json", "meshes"
MIN_CLOUD = 4
"""Points below which readers take a file for damaged; such a part comes back as its mesh alone."""
DECLARED = "told"
"""Entry of ``provenance.json`` that names the masses, joints and shapes the source declared."""
COMPLETED = "completed"
"""Entry of ``provenance.json`` that names the completion of the parts' meshes."""

_LOG = logging.getLogger(__name__)


def recover(folder: Path) -> None:
    """Restore an asset whose replacement was interrupted between its two renames."""
    if folder.exists() or not folder.parent.is_dir() or not folder.name:
        return
    start = f".{folder.name}."
    try:
        waiting = [
            p for p in folder.parent.iterdir()
            if p.name.startswith(start) and p.name.endswith(OLD) and (p / PROVENANCE).is_file()
        ]  # fmt: skip
        if waiting:
            max(waiting, key=lambda p: p.stat().st_mtime).rename(folder)
    except OSError:
        return  # the next reader of the folder reports the problem


@one_reading()
def load_object(asset: str | Path, progress: Progress = no_progress) -> ArticulatedObject:
    """The object of a saved asset, with its category, part names and clouds.

    Of a URDF or MJCF alone masses, joint dynamics and collision shapes are those of the file; of a
    saved asset those that its own source declared, while the others are computed again.

    Args:
        asset: the folder; or a URDF or MJCF file, or a folder with an ``object.urdf`` alone, which
            have neither category nor clouds.

    Raises:
        InputFileError: for anything else, or a damaged file in it.
    """
    path = Path(asset)
    recover(path)
    if path.is_file():
        if path.suffix.lower() in SUFFIXES and articulated_stage(path) is None:
            raise InputFileError(
                path,
                "is no URDF or MJCF, and no USD with joints",
                "run artiworld segment and predict on it first, or serve it",
            )
        obj, declared = _read(path, progress)
        return declared.of(obj)
    if not (path / URDF).is_file():
        raise InputFileError(path, f"has no {URDF}", "give the folder of a saved asset, or a URDF")
    obj, declared = _read(path / URDF, progress)
    if not (path / PROVENANCE).is_file():
        return declared.of(obj)
    kept = read_provenance(path)["asset"]
    entries = {entry["link"]: entry for entry in kept.get("parts", [])}
    remarks = remarks_in(kept)
    made = kept.get(COMPLETED)
    made_up = made if isinstance(made, dict) else {}
    parts: list[Part] = []
    for part in obj.parts:
        entry = entries.get(part.link, {})
        cloud = None
        if entry.get("cloud") and entry.get("points", 0) >= MIN_CLOUD:
            cloud = read_geometry_file(path / entry["cloud"], up_axis="z").cloud
        said = (*remarks, *part.remarks)
        words = () if cloud is None else tuple(map(str, made_up.get(part.link, ())))
        parts.append(
            replace(part, cloud=cloud, name=entry.get("name"), remarks=said, completed=words)
        )
    gives_way = kept.get("give_way")
    names = gives_way if isinstance(gives_way, list) else []
    joints = tuple(replace(j, give_way=j.name in names) for j in obj.tree.joints)
    tree = replace(obj.tree, joints=joints)
    obj = replace(obj, parts=tuple(parts), tree=tree, category=kept.get("category"))
    declared = _listed(declared, kept.get(DECLARED))
    return replace(declared, affordances=_affordances(path / TREE)).of(obj)


def _affordances(path: Path) -> tuple[Affordance, ...]:
    """Those of a saved tree; none in one of an earlier version."""
    if not path.is_file():
        return ()
    try:
        return affordances_in(read_json(path, "save the asset again"))
    except GeometryError as error:
        raise InputFileError(path, str(error), "save the asset again") from None


def _read(path: Path, progress: Progress) -> tuple[ArticulatedObject, DeclaredPhysics]:
    """The object of a URDF or MJCF, and the physics that the file declares."""
    model = read_model(path)
    declared = model.declared
    for note in (*model.notes, *declared.notes):
        _LOG.warning("%s: %s", path, note)
    return model.load(progress), declared


def _listed(declared: DeclaredPhysics, entry: Any) -> DeclaredPhysics:
    """Values of ``declared`` that the entry ``told`` of a ``provenance.json`` lists."""
    named = entry if isinstance(entry, dict) else {}
    masses, dynamics, shaped = (named.get(k) for k in ("masses", "dynamics", "collision"))
    links = masses if isinstance(masses, list) else []
    kept = shaped if isinstance(shaped, list) else []
    fields = dynamics if isinstance(dynamics, dict) else {}
    return DeclaredPhysics(
        {link: i for link, i in declared.inertials.items() if link in links},
        {
            name: DeclaredDynamics(**{k: v for k, v in asdict(d).items() if k in fields[name]})
            for name, d in declared.dynamics.items()
            if isinstance(fields.get(name), list)
        },
        collision={link: c for link, c in declared.collision.items() if link in kept},
    )


def declared_links(folder: Path, what: Literal["masses", "collision"]) -> list[str] | None:
    """Links of a saved asset whose masses or collision shapes its own source declared; None where
    ``folder`` is none, and its URDF declares all of them."""
    if not (folder / PROVENANCE).is_file():
        return None
    named = read_provenance(folder)["asset"].get(DECLARED)
    links = named.get(what) if isinstance(named, dict) else None
    return links if isinstance(links, list) else []


def declared_entry(obj: ArticulatedObject, shaped: Collection[str] = ()) -> dict[str, Any]:
    """Entry ``told`` of ``provenance.json``: physics of links and joints that the source declared.

    Args:
        shaped: links whose written collision shapes the source declared.
    """
    return {
        "masses": sorted(obj.inertials),
        "dynamics": {
            j.name: [k for k, v in asdict(j.dynamics).items() if v is not None]
            for j in obj.tree.joints
            if j.dynamics is not None
        },
        "collision": sorted(shaped),
    }


def reading_notes(asset: str | Path, obj: ArticulatedObject) -> tuple[str, ...]:
    """Remarks on reading ``obj`` with :func:`load_object`: changes, and content that was skipped in
    its meshes or in the source they come from."""
    path = Path(asset)
    model = read_model(path if path.is_file() else path / URDF)
    return (*model.notes, *model.declared.notes, *remarks_of(obj.parts))


def read_provenance(folder: str | Path) -> dict[str, Any]:
    """``provenance.json`` of an asset folder.

    Raises:
        InputFileError: where it is missing, damaged, or of a newer format.
    """
    recover(Path(folder))
    path = Path(folder) / PROVENANCE
    data = read_json(path, "give the folder of a saved asset")
    asset = data.get("asset") if isinstance(data, dict) else None
    if not isinstance(asset, dict) or not isinstance(asset.get("format"), int):
        raise InputFileError(path, "has no 'asset' entry", "save the asset again")
    if asset["format"] > FORMAT:
        raise InputFileError(
            path, f"has format {asset['format']}, newer than {FORMAT}", "update ArtiWorld"
        )
    return data
