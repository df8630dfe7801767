"""Collision shapes on disk, named by the content that they were made from."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import Part
from model.core.errors import NoSpaceError
from model.core.files import draft_of
from model.core.shapes import Primitive, Shape, Solid, hull_of

VERSION = 7
"""Counted up when the same input gives other shapes."""


def default_store() -> Path:
    """The user's cache folder, by the XDG base directory specification."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "artiworld/collision")


def fingerprint(*values: Any) -> str:
    """Hash arrays, parts, and values with an exact ``repr``."""
    digest = hashlib.sha256(f"collision {VERSION}".encode())
    for value in values:
        for item in _content(value) if isinstance(value, Part) else (value,):
            if isinstance(item, np.ndarray):
                digest.update(f"{item.dtype}{item.shape}".encode())
                digest.update(np.ascontiguousarray(item).data)
            else:
                digest.update(repr(item).encode())
            digest.update(b"\0")
    return digest.hexdigest()[:40]


def _content(part: Part) -> list[Any]:
    if part.mesh is not None and len(part.mesh.faces):
        return ["mesh", part.mesh.vertices, part.mesh.faces]
    return ["cloud", None if part.cloud is None else part.cloud.points]


def load_shapes(folder: Path | None, key: str) -> dict[str, tuple[Shape, ...]] | None:
    """Return link → shapes; None where the file is missing or damaged."""
    data = None if folder is None else load_arrays(folder / f"{key}.npz")
    try:
        return None if data is None else unpacked(data)
    except (ValueError, KeyError, AssertionError):
        return None


def save_shapes(folder: Path | None, key: str, shapes: dict[str, tuple[Shape, ...]]) -> None:
    """Save shapes; an unwritable folder is ignored."""
    if folder is not None:
        save_arrays(folder / f"{key}.npz", packed(shapes))


def load_arrays(path: Path) -> dict[str, npt.NDArray[Any]] | None:
    """Return arrays by name; None where the file is missing or damaged."""
    try:
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except (OSError, ValueError, KeyError, EOFError, BadZipFile):
        return None


def save_arrays(path: Path, arrays: dict[str, npt.NDArray[Any]]) -> None:
    """Save arrays atomically; an unwritable folder is ignored."""
    with suppress(OSError, NoSpaceError), draft_of(path) as draft:
        np.savez(draft, **arrays)  # type: ignore[arg-type]


def packed(shapes: Mapping[str, tuple[Shape, ...]]) -> dict[str, npt.NDArray[Any]]:
    """Return link → shapes as arrays by name."""
    out: dict[str, npt.NDArray[Any]] = {"links": np.array(list(shapes), dtype=np.str_)}
    for n, held in enumerate(shapes.values()):
        out[f"count {n}"] = np.array(len(held))
        for i, shape in enumerate(held):
            if isinstance(shape, Primitive):
                out[f"kind {n} {i}"] = np.array(shape.kind)
                out[f"pose {n} {i}"] = shape.object_from_shape
                out[f"sizes {n} {i}"] = np.array(shape.sizes)
            elif isinstance(shape, Solid):
                out[f"solid {n} {i}"], out[f"faces {n} {i}"] = shape.vertices, shape.faces
            else:
                out[f"hull {n} {i}"] = shape.vertices
    return out


def unpacked(data: Mapping[str, npt.NDArray[Any]]) -> dict[str, tuple[Shape, ...]]:
    """Invert :func:`packed`.

    Raises:
        ValueError, KeyError, AssertionError: for anything else.
    """
    out: dict[str, tuple[Shape, ...]] = {}
    for n, link in enumerate(data["links"].tolist()):
        held: list[Shape] = []
        for i in range(int(data[f"count {n}"])):
            if f"hull {n} {i}" in data:
                hull = hull_of(data[f"hull {n} {i}"])
                assert hull is not None
                held.append(hull)
            elif f"solid {n} {i}" in data:
                held.append(Solid(data[f"solid {n} {i}"], data[f"faces {n} {i}"]))
            else:
                kind, sizes = str(data[f"kind {n} {i}"]), data[f"sizes {n} {i}"].tolist()
                held.append(Primitive(kind, data[f"pose {n} {i}"], tuple(sizes)))  # type: ignore[arg-type]
        out[link] = tuple(held)
    return out
