"""``artiworld.json`` beside an export: its source, and what was left out."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path, PurePath
from typing import Any

from model.core.files import file_sha256, write_json
from model.core.packages import installed_versions
from model.io.assets.reader import PROVENANCE, read_provenance

ABOUT = "artiworld.json"
REVIEW = ("state", "by", "at", "comment", "override")


def write_about(folder: Path, asset: Path, name: str, notes: Sequence[str]) -> Path:
    """Write it into ``folder``; returns its path.

    The source is named by its file alone, as exports go to other people. It is no
    ``provenance.json``, which says that a folder is an asset.

    Args:
        folder: of the export.
        asset: what was exported: an asset folder or a URDF file.
        name: of the export format.
        notes: human-readable remarks on content changed or skipped on reading and writing.

    Raises:
        InputFileError: where it can't be written, or the asset's ``provenance.json`` is damaged.
    """
    said = {
        "format": name,
        "asset": asset.resolve().name,
        **_written(),
        **about_asset(asset),
        "notes": list(dict.fromkeys(notes)),
    }
    return _write(folder, said)


def write_scene_about(
    folder: Path,
    source: Path,
    reader: str,
    files: Sequence[str],
    assets: Mapping[str, Sequence[str]],
    notes: Sequence[str],
) -> Path:
    """The same for a written scene, with an entry for each of its assets; returns its path.

    Args:
        folder: of the scene.
        source: the scene that was read.
        reader: the name of its format.
        files: what the scene was written as.
        assets: folder of an asset below ``folder`` → ids of the objects that it is.
        notes: as in :func:`write_about`.

    Raises:
        InputFileError: as :func:`write_about`.
    """
    sha256 = file_sha256(source) if source.is_file() else None
    entries = {k: about_asset(folder / k) | {"objects": list(ids)} for k, ids in assets.items()}
    said = {
        "format": "scene",
        "files": list(files),
        **_written(),
        "source": source.name,
        "reader": reader,
        "sha256": sha256,
        "assets": {key: _without_nothing(entry) for key, entry in entries.items()},
        "notes": list(dict.fromkeys(notes)),
    }
    return _write(folder, said)


def about_asset(asset: Path) -> dict[str, Any]:
    """The public entries of an asset's ``provenance.json``; None or {} without any.

    Raises:
        InputFileError: where it is damaged.
    """
    kept = read_provenance(asset) if (asset / PROVENANCE).is_file() else {}
    source, predictor = kept.get("source"), kept.get("predictor")
    sha256 = scene = None
    if isinstance(source, dict):
        sha256, scene, source = source.get("sha256"), source.get("scene"), source.get("path")
    if isinstance(predictor, dict):
        predictor = predictor.get("backend")
    review = _entry(kept, "review")
    return {
        "category": _entry(kept, "asset").get("category"),
        "source": None if source is None else PurePath(str(source)).name,
        "sha256": sha256,
        "scene": None if scene is None else PurePath(str(scene)).name,
        "predictor": predictor,
        "review": review and {k: review[k] for k in REVIEW if review.get(k)},
        "gate": _entry(kept, "gate").get("verdict"),
    }


def _written() -> dict[str, Any]:
    version = installed_versions("artiworld").get("artiworld")
    return {"exported": datetime.now(UTC).isoformat(timespec="seconds"), "artiworld": version}


def _without_nothing(said: Mapping[str, Any]) -> dict[str, Any]:
    return {k: v for k, v in said.items() if v not in (None, {})}


def _write(folder: Path, said: Mapping[str, Any]) -> Path:
    write_json(folder / ABOUT, _without_nothing(said))
    return folder / ABOUT


def declared_category(folder: Path) -> tuple[str | None, bool]:
    """The category in an export's ``artiworld.json``, and whether the folder is such an export."""
    try:
        said = json.loads((folder / ABOUT).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None, False
    category = said.get("category") if isinstance(said, dict) else None
    return category if isinstance(category, str) else None, isinstance(said, dict)


def _entry(kept: Mapping[str, Any], key: str) -> dict[str, Any]:
    value = kept.get(key)
    return value if isinstance(value, dict) else {}
