"""Folders of part meshes: the parts' files and names."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from model.core.errors import InputFileError
from model.core.files import free_name
from model.io.formats.references import ReferenceRefused, resolve

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


def has_part_files(folder: Path, suffixes: tuple[str, ...]) -> bool:
    """True if the folder has ``link_*`` meshes."""
    return bool(_files(folder, suffixes, "link_"))


def is_part_folder(folder: Path, suffixes: tuple[str, ...]) -> bool:
    """True if the folder is one object in parts."""
    return (folder / OBJECT_JSON).is_file() or has_part_files(folder, suffixes)


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
        if p.suffix.lower() in suffixes and p.name.startswith(prefix) and p.is_file()
        and not p.name.startswith(".")
    ]  # fmt: skip
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
