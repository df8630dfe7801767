"""Location of the files that ship with ArtiWorld."""

from __future__ import annotations

from pathlib import Path


def static_assets() -> Path:
    """The folder ``static_assets`` beside the packages."""
    return Path(__file__).resolve().parents[2] / "static_assets"
