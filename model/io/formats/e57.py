"""E57: clouds of terrestrial scanners (ASTM E2807), read through pye57."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from model.core.errors import InputFileError
from model.core.installing import require
from model.io.formats.loaded import DEFAULT_MAX_BYTES, Loaded, colors_from, size_of

_POINT_BYTES = 24


def read_e57(path: Path, max_bytes: int = DEFAULT_MAX_BYTES) -> Loaded:
    """Read all scans of one E57 file in their common frame; metres, +z up.

    Raises:
        InputFileError: where it is no such file, damaged, or has no points.
        ConfigurationError: where pye57 isn't installed.
    """
    pye57 = require("pye57", "artiworld[scans]")
    if size_of(path) > max_bytes:
        raise InputFileError(path, "is over the limit of bytes", "thin the scan first")
    points: list[np.ndarray] = []
    colors: list[np.ndarray | None] = []
    try:
        file = pye57.E57(str(path))
        try:
            total = sum(file.get_header(k).point_count for k in range(file.scan_count))
            if total * _POINT_BYTES > max_bytes:
                raise InputFileError(path, f"has {total} points, over the limit", "thin the scan")
            for k in range(file.scan_count):
                data = file.read_scan(k, colors=True, ignore_missing_fields=True)
                points.append(np.column_stack([data[f"cartesian{a}"] for a in "XYZ"]))
                shown = [data.get(f"color{c}") for c in ("Red", "Green", "Blue")]
                colors.append(None if any(c is None for c in shown) else np.column_stack(shown))  # type: ignore[arg-type]
        finally:
            file.close()
    except InputFileError:
        raise
    except Exception as error:  # libE57 raises its own kinds, and KeyError for missing fields
        raise InputFileError(path, f"can't be read as E57 ({error})", "export it again") from None
    if not sum(map(len, points)):
        raise InputFileError(path, "has no points", "export the scan again")
    rgb = None
    if all(c is not None for c in colors):
        rgb = colors_from(np.concatenate(colors).astype(np.uint16))  # type: ignore[arg-type]
    return Loaded(np.concatenate(points).astype(np.float64), colors=rgb)
