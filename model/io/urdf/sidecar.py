"""Files beside a URDF that name its parts and its category."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from model.core.files import read_json

DESCRIPTION = "object.json"


def description_beside(path: Path) -> dict[str, Any]:
    """The content of the ``object.json`` beside a URDF; empty without one.

    Raises:
        InputFileError: where it can't be read.
    """
    said = read_json_beside(path.parent / DESCRIPTION)
    return said if isinstance(said, dict) else {}


def partnet_category(folder: Path) -> str | None:
    """The category in ``meta.json``."""
    meta = read_json_beside(folder / "meta.json")
    category = meta.get("model_cat") if isinstance(meta, dict) else None
    return category if isinstance(category, str) else None


def semantic_names(folder: Path) -> dict[str, str]:
    """``link_k`` → part name, from semantics.txt, else from mobility_v2.json."""
    path = folder / "semantics.txt"
    if path.exists():
        rows = [line.split() for line in path.read_text(encoding="utf-8").splitlines()]
        return {r[0]: r[2] for r in rows if len(r) >= 3}
    nodes = read_json_beside(folder / "mobility_v2.json")
    if not isinstance(nodes, list):
        return {}
    return {f"link_{n['id']}": str(n["name"]) for n in nodes if "id" in n and n.get("name")}


def read_json_beside(path: Path) -> object:
    """The JSON value in a file; an empty object where the file is absent.

    Raises:
        InputFileError: where it is not JSON.
    """
    return read_json(path) if path.exists() else {}
