"""``artiworld.json`` beside an exported object: where it comes from, and what was left out."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path, PurePath
from typing import Any

from model.errors import InputFileError
from model.exporters.saved import PROVENANCE, read_provenance

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
        notes: what was changed or passed over on reading and on writing, for people.

    Raises:
        InputFileError: where it can't be written, or the asset's ``provenance.json`` is damaged.
    """
    kept = read_provenance(asset) if (asset / PROVENANCE).is_file() else {}
    source, predictor = kept.get("source"), kept.get("predictor")
    if isinstance(source, dict):
        sha256, source = source.get("sha256"), source.get("path")
    else:
        sha256 = None
    if isinstance(predictor, dict):
        predictor = predictor.get("backend")
    review = _entry(kept, "review")
    version = None
    with contextlib.suppress(metadata.PackageNotFoundError):
        version = metadata.version("artiworld")
    said = {
        "format": name,
        "asset": asset.resolve().name,
        "exported": datetime.now(UTC).isoformat(timespec="seconds"),
        "artiworld": version,
        "category": _entry(kept, "asset").get("category"),
        "source": None if source is None else PurePath(str(source)).name,
        "sha256": sha256,
        "predictor": predictor,
        "review": review and {k: review[k] for k in REVIEW if review.get(k)},
        "gate": _entry(kept, "gate").get("verdict"),
        "notes": list(dict.fromkeys(notes)),
    }
    path = folder / ABOUT
    text = json.dumps({k: v for k, v in said.items() if v not in (None, {})}, indent=2)
    try:
        path.write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        raise InputFileError(
            path, error.strerror or "can't be written", "choose another folder"
        ) from error
    return path


def category_told(folder: Path) -> tuple[str | None, bool]:
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
