"""Files and folders that can be opened: their display names, models, and folders of part meshes.

Models declare parts and joints: URDF, SDF, MJCF and USD, read into the same model.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from model.core.errors import InputFileError
from model.core.files import free_name
from model.io.formats.loaded import DEFAULT_MAX_BYTES, ReferenceRefused, resolve, size_of
from model.io.formats.usd import USD_SUFFIXES
from model.io.geometry_files import FOLDER_SUFFIXES, SUFFIXES, unknown_type
from model.io.mjcf_reader import read_mjcf_model
from model.io.mjcf_source import MJCF_SUFFIXES, is_mjcf, named_files
from model.io.urdf.files import (
    ANYMESH,
    MOBILITY,
    PACKAGE,
    URDF_SUFFIX,
    allow,
    gazebo_model,
    is_anymesh,
    is_urdf,
    named_meshes,
    package_root,
)
from model.io.urdf.model import UrdfModel
from model.io.urdf.reader import read_urdf_model
from model.io.urdf.sdf import SDF_SUFFIX, is_sdf
from model.io.usd_model import read_usd_model

OBJECT_JSON = "object.json"
_MAX_JSON = 16 << 20
_MAX_PARTS = 1000
_MAX_REMARKS, _LONGEST_REMARK = 100, 300


@dataclass(frozen=True)
class PartEntry:
    """One part: its file, link and name (or None)."""

    path: Path
    link: str
    name: str | None = None


@dataclass(frozen=True)
class Manifest:
    """The parts of a folder.

    Attributes:
        path: its object.json, or None.
        remarks: what was passed over on reading the source that the parts were cut from.
    """

    entries: tuple[PartEntry, ...]
    category: str | None = None
    path: Path | None = None
    remarks: tuple[str, ...] = ()


def natural_key(path: Path) -> list[tuple[int, int, str]]:
    """Sort key in which link_2 comes before link_10."""
    return [
        (0, int(piece), "") if piece.isdecimal() else (1, 0, piece)
        for piece in re.split(r"(\d+)", path.name.lower())
        if piece
    ]


def safe_link(stem: str) -> str:
    """A link name made of letters, digits, ``_``, ``-`` and ``.`` only."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "_", stem).strip("_.") or "part"


def is_part_folder(folder: Path, suffixes: tuple[str, ...]) -> bool:
    """True if the folder is one object in parts."""
    return (folder / OBJECT_JSON).is_file() or bool(_files(folder, suffixes, "link_"))


def find_manifest(folder: Path, suffixes: tuple[str, ...]) -> Manifest:
    """The parts in ``folder``.

    Raises:
        InputFileError: where there are none, or object.json is wrong.
    """
    if not folder.is_dir():
        problem = "is not a folder" if folder.exists() else "no such folder"
        raise InputFileError(folder, problem, "give a folder with one mesh for each part")
    path = folder / OBJECT_JSON
    if path.is_file():
        return _from_json(path)
    files = _files(folder, suffixes, "link_") or _files(folder, suffixes, "")
    if not files:
        raise InputFileError(
            folder,
            "has no meshes or clouds",
            f"put link_0, link_1, … into it, each one of {', '.join(suffixes)}",
        )
    if len(files) > _MAX_PARTS:
        raise InputFileError(folder, f"{len(files)} files are too many parts for one object")
    return Manifest(_named([(f, None) for f in files]))


def _files(folder: Path, suffixes: tuple[str, ...], prefix: str) -> list[Path]:
    try:
        entries = list(folder.iterdir())
    except OSError:
        return []
    found = [
        p
        for p in entries
        if p.suffix.lower() in suffixes
        and p.name.startswith(prefix)
        and p.is_file()
        and not p.name.startswith(".")
    ]
    return sorted(found, key=natural_key)


def _from_json(path: Path) -> Manifest:
    try:
        if path.stat().st_size > _MAX_JSON:
            raise InputFileError(path, "is far too large for a list of parts")
        tree: Any = json.loads(path.read_text("utf-8-sig"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputFileError(path, f"is not JSON: {error}", "see the README for its form") from None
    remedy = 'as in {"category": "cabinet", "parts": [{"file": "link_0.obj", "name": "door"}]}'
    parts = tree.get("parts") if isinstance(tree, dict) else None
    if not isinstance(parts, list) or not parts:
        raise InputFileError(path, "has no list 'parts'", remedy)
    if len(parts) > _MAX_PARTS:
        raise InputFileError(path, f"{len(parts)} parts are too many for one object")
    found: list[tuple[Path, str | None]] = []
    for number, part in enumerate(parts):
        file = part.get("file") if isinstance(part, dict) else part
        name = part.get("name") if isinstance(part, dict) else None
        if not isinstance(file, str) or not (name is None or isinstance(name, str)):
            raise InputFileError(path, f"part {number} has no file name", remedy)
        try:
            target = resolve(file, path.parent, path.parent)
        except ReferenceRefused as error:
            raise InputFileError(path, f"part {number}: {error}", "keep it in the folder") from None
        if not target.is_file():
            raise InputFileError(path, f"part {number} names {file!r}, which is missing")
        found.append((path.parent / file, name or None))
    files = [f for f, _ in found]
    twice = next((f for f in files if files.count(f) > 1), None)
    if twice is not None:
        raise InputFileError(path, f"names {twice.name!r} twice")
    category = tree.get("category")
    known = category if isinstance(category, str) else None
    return Manifest(_named(found), known, path, remarks_in(tree.get("source")))


def remarks_in(entry: Any) -> tuple[str, ...]:
    """The texts of ``remarks`` in a JSON object, each on one short line; () where it has none."""
    said = entry.get("remarks") if isinstance(entry, dict) else None
    texts = [t for t in said if isinstance(t, str)] if isinstance(said, list) else []
    return tuple(" ".join(t.split())[:_LONGEST_REMARK] for t in texts[:_MAX_REMARKS])


def _named(files: list[tuple[Path, str | None]]) -> tuple[PartEntry, ...]:
    """Entries with a different link name each."""
    out: list[PartEntry] = []
    taken: set[str] = set()
    for path, name in files:
        link = free_name(safe_link(path.stem), taken)
        taken.add(link)
        out.append(PartEntry(path, link, name))
    return tuple(out)


MODEL_SUFFIXES = (URDF_SUFFIX, *MJCF_SUFFIXES, SDF_SUFFIX)


def is_model(path: Path) -> bool:
    """True if ``path`` is a URDF, an XML file that begins as an MJCF does, an SDF of one model, or
    AnyMesh's JSON."""
    return is_urdf(path) or is_mjcf(path) or is_sdf(path) or is_anymesh(path)


def _with_unmoved(model: UrdfModel) -> UrdfModel:
    """The model with a remark on joints that can't move: exporters write a range of 0 where none
    was set."""
    said = " ".join(model.notes)
    names = [
        repr(j.name)
        for j in model.tree.joints
        if j.limited and j.lower == j.upper and j.mimic is None and repr(j.name) not in said
    ]
    if not names:
        return model
    which = f"joint{'s'[: len(names) != 1]} {', '.join(names[:5])}{', …' if len(names) > 5 else ''}"
    why = f"{which} can't move, as the range is empty: set a range, or predict the joints"
    return replace(model, notes=(*model.notes, why))


def articulated_stage(path: Path, max_bytes: int = DEFAULT_MAX_BYTES) -> UrdfModel | None:
    """Articulated object of a USD stage; None for any other file.

    Raises:
        InputFileError: where it is a damaged stage.
        ConfigurationError: where usd-core isn't installed.
    """
    if path.suffix.lower() not in USD_SUFFIXES:
        return None
    model = read_usd_model(path, max_bytes)
    return None if model is None else _with_unmoved(model)


def read_model(
    path: Path, max_bytes: int = DEFAULT_MAX_BYTES, given: Path | None = None
) -> UrdfModel:
    """Read a file without loading meshes, which a USD stage holds itself; see
    ``read_urdf_model``, ``read_mjcf_model`` and ``read_usd_model``.

    Args:
        path: the file.
        max_bytes: refuse larger meshes where they are read at once.
        given: folder that a person gave, which the model's files may lie in.

    Raises:
        InputFileError: naming the file and what is wrong in it.
        ConfigurationError: for an MJCF or USD, where MuJoCo or usd-core isn't installed.
    """
    if path.suffix.lower() in MJCF_SUFFIXES:
        root = package_root(path, given)
        return _with_unmoved(read_mjcf_model(path, root=root, max_bytes=max_bytes))
    if path.suffix.lower() in USD_SUFFIXES:
        model = articulated_stage(path, max_bytes)
        if model is None:
            raise InputFileError(
                path, "holds no object with joints, or several", "open it as a scene or a mesh"
            )
        return model
    return _with_unmoved(read_urdf_model(path, root=package_root(path, given)))


def files_named_by(path: Path) -> list[Path]:
    """Absolute paths that the model's files may have; only its own text is read."""
    return named_meshes(path) if is_urdf(path) or is_sdf(path) else named_files(path)


_WHOLE_FOLDER = (MOBILITY, "object.urdf", "object.xml", "model.sdf", ANYMESH)
"""URDFs, MJCFs and others that stand for their folder, which is called after the object."""


def refusal(path: Path) -> InputFileError | None:
    """Why a file can't be opened whatever is in it: a pipe, a device, empty, or of no known type.

    None for folders, and where only reading it can tell.
    """
    if path.is_dir():
        return None
    try:
        size_of(path)
    except InputFileError as error:
        return error
    if path.suffix.lower() in MJCF_SUFFIXES and not is_mjcf(path):
        return InputFileError(
            path, "doesn't begin with <mujoco>", "of XML files URDF, SDF and MJCF can be opened"
        )
    if path.suffix.lower() in (*SUFFIXES, *MODEL_SUFFIXES):
        return None
    return unknown_type(path, (*SUFFIXES, *MODEL_SUFFIXES))


def asset_name(path: Path) -> str:
    """Display name of a file or folder: ``object.urdf``, ``object.xml`` and ``mobility.urdf``,
    names that many files share, have their folder's."""
    if path.name in _WHOLE_FOLDER:
        path = path.absolute().parent
    return path.name if path.is_dir() else path.stem


def model_of(folder: Path) -> Path | None:
    """The URDF or MJCF that tells what is in a folder; None where its part meshes do, or nothing.

    It is one that stands for its folder (``mobility.urdf``, ``object.urdf``, ``object.xml``), else
    the only URDF there, or the only one in ``urdf/`` of a ROS package or beside ``meshes/``, else
    the only MJCF or SDF, or the only MJCF in ``xml/`` beside ``meshes/``.
    """
    named = _whole(folder)
    if named is not None or is_part_folder(folder, FOLDER_SUFFIXES):
        return named
    found = _only_urdf(folder) or _urdf_of_package(folder) or _only_mjcf(folder)
    found = found or ((folder / "meshes").is_dir() and _only_mjcf(folder / "xml")) or None
    return found or _only(folder, is_sdf)


def _whole(folder: Path) -> Path | None:
    named = (p for n in _WHOLE_FOLDER if is_model(p := folder / n))
    return next(named, None) or gazebo_model(folder)


def _urdf_of_package(folder: Path) -> Path | None:
    whole = (folder / PACKAGE).is_file() or (folder / "meshes").is_dir()
    return _only_urdf(folder / "urdf") if whole else None


def _only_urdf(folder: Path) -> Path | None:
    return _only(folder, is_urdf)


def _only(folder: Path, kind: Callable[[Path], bool]) -> Path | None:
    found = [p for p in folder.iterdir() if kind(p)] if folder.is_dir() else []
    return found[0] if len(found) == 1 else None


def _only_mjcf(folder: Path) -> Path | None:
    """The one that no other includes; None where a URDF is there, too."""
    if not folder.is_dir() or any(map(is_urdf, folder.iterdir())):
        return None
    found = [p for p in folder.iterdir() if is_mjcf(p)]
    if len(found) > 1:
        included = {str(each) for p in found for each in files_named_by(p)}
        found = [p for p in found if os.path.abspath(p) not in included]
    return found[0] if len(found) == 1 else None


def find_assets(paths: Iterable[str | Path]) -> list[Path]:
    """Assets that can be opened among ``paths``: files as they are, folders searched in depth.

    A folder with a ``mobility.urdf``, an ``object.urdf``, an ``object.xml``, an ``object.json`` or
    ``link_*`` meshes is one item. Files of a URDF or MJCF in the folder are none, nor is the
    MJCF of a converted scene. A file that is named directly is always in, so that opening it can
    say what is wrong with it.

    Raises:
        InputFileError: where a path doesn't exist or a folder holds nothing that can be opened.
    """
    out: list[Path] = []
    for path in map(Path, paths):
        if not path.exists():
            raise InputFileError(path, "no such file or folder", "check the path")
        if path.is_dir():
            allow(path)
        found = _without_pieces(_search(path, set())) if path.is_dir() else [path]
        if not found:
            looked = ", ".join((*FOLDER_SUFFIXES, *MODEL_SUFFIXES))
            raise InputFileError(path, "nothing in it can be opened", f"looked for {looked}")
        out.extend(found)
    return list(dict.fromkeys(out))


def _search(folder: Path, seen: set[Path]) -> list[Path]:
    """Assets in ``folder``, except in folders of ``seen``, to which all visited ones are added."""
    real = folder.resolve()
    if real in seen:  # a link back up, or another name of a folder
        return []
    seen.add(real)
    if _whole(folder) is not None:
        return [folder]
    out: list[Path] = []
    try:
        entries = sorted(folder.iterdir(), key=natural_key)
    except OSError:
        return []
    if is_part_folder(folder, FOLDER_SUFFIXES):
        return [folder, *(p for p in entries if is_model(p))]
    for entry in entries:
        if entry.name.startswith("."):
            continue
        if entry.is_dir():
            out.extend(_search(entry, seen))
        elif entry.is_file() and (
            entry.suffix.lower() in FOLDER_SUFFIXES
            or (is_model(entry) and not (entry.name == "scene.xml" and _is_scene(folder)))
        ):
            out.append(entry)
    urdf = _urdf_of_package(folder)
    if urdf is not None:  # the ROS package has the object's name, its folder urdf/ has not
        return [folder, *(p for p in out if p not in (urdf, urdf.parent))]
    return out


def _is_scene(folder: Path) -> bool:
    """True if ``scene convert`` wrote it: its MJCF describes all objects together."""
    return (folder / "scene.json").is_file() and (folder / "assets").is_dir()


def _without_pieces(found: list[Path]) -> list[Path]:
    """Without the meshes, the folders of part meshes, and the MJCFs that a URDF or MJCF among
    ``found`` names."""
    models = [model_of(p) if p.is_dir() else p for p in found]
    outside = (  # files in a model's own folder aren't separate assets
        m
        for m, p in zip(models, found, strict=True)
        if m is not None and is_model(m) and (m == p or package_root(m) != m.parent)
    )
    pieces = {str(piece) for model in outside for piece in files_named_by(model)}
    homes = {os.path.dirname(piece) for piece in pieces}

    def is_piece(path: Path, model: Path | None) -> bool:
        if path.is_dir():
            return model is None and os.path.abspath(path) in homes
        return os.path.abspath(path) in pieces

    return [p for p, model in zip(found, models, strict=True) if not is_piece(p, model)]
