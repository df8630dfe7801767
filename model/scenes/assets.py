"""Folders of 3D assets, indexed by the ids that scenes use."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from model.core.errors import InputFileError
from model.core.files import file_sha256
from model.io.geometry_files import FOLDER_SUFFIXES
from model.io.model_files import is_part_folder
from model.io.urdf.files import MOBILITY, URDF_SUFFIX

_URDF_NAMES = (MOBILITY, "object.urdf")
_FOLDERS_MODEL = "raw_model"
"""Name of the mesh in the folder of each model of 3D-FUTURE."""


@dataclass(frozen=True)
class AssetIndex:
    """Index of assets by id.

    Attributes:
        folders: that were searched.
        by_id: id in lower case → file or folder. An asset's ids are its name, its name without
            suffix and its path below the searched folder, with and without suffix; a 3D-FUTURE
            model's is its folder.
        ambiguous: ids that several assets have; the first in the order of ``folders`` counts.
    """

    folders: tuple[Path, ...]
    by_id: dict[str, Path] = field(default_factory=dict)
    ambiguous: frozenset[str] = frozenset()

    def find(self, id: str) -> Path | None:
        """The asset called ``id``, which may be a path: its last folders count most.

        ``../models/Microwave/7128/mobility.urdf`` is found as ``models/microwave/7128``, else as
        ``microwave/7128``, else as ``7128``.
        """
        words = [w for w in id.replace("\\", "/").lower().split("/") if w not in ("", ".", "..")]
        if not words:
            return None
        ends = [words]
        if len(words) > 1 and "." in words[-1]:
            ends.append(words[:-1])  # the folder that the file is in
        for end in ends:
            for start in range(len(end)):
                found = self.by_id.get("/".join(end[start:]))
                if found is not None:
                    return found
        return None


def index_assets(folders: Iterable[str | Path]) -> AssetIndex:
    """Search folders in depth for assets.

    An asset is a folder with a ``mobility.urdf`` or ``object.urdf``, a folder of part meshes,
    another URDF, or a mesh file.

    Raises:
        InputFileError: where a folder isn't there.
    """
    roots = tuple(Path(f) for f in folders)
    by_id: dict[str, Path] = {}
    ambiguous: set[str] = set()
    for root in roots:
        if not root.is_dir():
            raise InputFileError(root, "no such folder", "give a folder of assets")
        for path in _assets_in(root):
            for id in _ids(root, path):
                if by_id.setdefault(id, path) != path:
                    ambiguous.add(id)
    return AssetIndex(roots, by_id, frozenset(ambiguous))


def _is_asset_folder(folder: Path, files: list[str]) -> bool:
    if any(name in files for name in _URDF_NAMES):
        return True
    return is_part_folder(folder, FOLDER_SUFFIXES)


def _assets_in(root: Path) -> Iterable[Path]:
    for where, below, files in os.walk(root):
        below.sort()
        folder = Path(where)
        if _is_asset_folder(folder, files):
            below.clear()
            yield folder
            continue
        for name in sorted(files):
            if Path(name).suffix.lower() in (*FOLDER_SUFFIXES, URDF_SUFFIX):
                yield folder / name


def _ids(root: Path, path: Path) -> set[str]:
    inside = path.relative_to(root) if path != root else Path(path.name)
    out = {path.name, inside.as_posix()}
    if path.is_file():
        out |= {path.stem, inside.with_suffix("").as_posix()}
    if path.stem == _FOLDERS_MODEL and path.parent != root:
        out |= {path.parent.name, inside.parent.as_posix()}
        out -= {path.name, path.stem}  # what all are called, so that none stands for another
    return {id.lower() for id in out}


def asset_digest(path: Path) -> str:
    """SHA-256 over an asset's files, the same for copies wherever they lie.

    Raises:
        InputFileError: where a file can't be read.
    """
    files = [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.is_file())
    whole = hashlib.sha256()
    try:
        for file in files:
            name = file.name if file == path else file.relative_to(path).as_posix()
            whole.update(f"{name}\0{file_sha256(file)}\n".encode())
    except OSError as error:
        raise InputFileError(path, f"can't be read: {error.strerror}") from error
    return whole.hexdigest()
