"""Files and folders that can be opened, and their display names."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from model.core.errors import InputFileError
from model.io.formats.loaded import size_of
from model.io.geometry_files import FOLDER_SUFFIXES, SUFFIXES, unknown_type
from model.io.mjcf.source import MJCF_SUFFIXES, is_mjcf
from model.io.model_files import MODEL_SUFFIXES, files_named_by, is_model
from model.io.part_folder import is_part_folder, natural_key
from model.io.urdf.anymesh import ANYMESH
from model.io.urdf.files import MOBILITY, PACKAGE, is_urdf, package_root

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
    the only URDF there, or the only one in ``urdf/`` of a ROS package, else the only MJCF.
    """
    named = _whole(folder)
    if named is not None or is_part_folder(folder, FOLDER_SUFFIXES):
        return named
    return _only_urdf(folder) or _urdf_of_package(folder) or _only_mjcf(folder)


def _whole(folder: Path) -> Path | None:
    return next((p for n in _WHOLE_FOLDER if is_model(p := folder / n)), None)


def _urdf_of_package(folder: Path) -> Path | None:
    return _only_urdf(folder / "urdf") if (folder / PACKAGE).is_file() else None


def _only_urdf(folder: Path) -> Path | None:
    found = [p for p in folder.iterdir() if is_urdf(p)] if folder.is_dir() else []
    return found[0] if len(found) == 1 else None


def _only_mjcf(folder: Path) -> Path | None:
    """The one that no other includes; None where a URDF is there, too."""
    if not folder.is_dir() or any(map(is_urdf, folder.iterdir())):
        return None
    found = [p for p in folder.iterdir() if is_mjcf(p)]
    if len(found) > 1:
        included = {each for p in found for each in files_named_by(p)}
        found = [p for p in found if p.absolute() not in included]
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
        m for m, p in zip(models, found, strict=True)
        if m is not None and is_model(m) and (m == p or package_root(m) != m.parent)
    )  # fmt: skip
    pieces = {piece for model in outside for piece in files_named_by(model)}
    homes = {piece.parent for piece in pieces}

    def is_piece(path: Path, model: Path | None) -> bool:
        if path.is_dir():
            return model is None and path.absolute() in homes
        return path.absolute() in pieces

    return [p for p, model in zip(found, models, strict=True) if not is_piece(p, model)]
