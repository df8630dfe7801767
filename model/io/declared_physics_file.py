"""Declared masses and collision shapes of a source, saved beside the part meshes, so that a working
copy of a scene's asset keeps them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from model.core.inertial import Inertial, inertial_problems
from model.core.shapes import Shape, moved_shape
from model.physics.collision.store import load_arrays, packed, unpacked

FILE = "told.npz"
_SHAPE = "shape "


def save_declared(
    folder: Path,
    inertials: Mapping[str, Inertial],
    shapes: Mapping[str, tuple[Shape, ...]],
) -> None:
    """Write ``told.npz`` if anything is declared.

    Args:
        inertials, shapes: by link, in the frame of the folder's meshes; ``link_2`` is the third
            part of its ``object.json``.

    Raises:
        OSError: where it can't be written.
    """
    if not inertials and not shapes:
        return
    arrays = {f"{_SHAPE}{name}": array for name, array in packed(shapes).items()}
    each = list(inertials.values())
    arrays["inertial links"] = np.array(list(inertials), dtype=np.str_)
    arrays["mass"] = np.array([i.mass for i in each])
    arrays["center"] = np.array([i.center for i in each]).reshape(-1, 3)
    arrays["tensor"] = np.array([i.tensor for i in each]).reshape(-1, 3, 3)
    np.savez(folder / FILE, **arrays)  # type: ignore[arg-type]


def load_declared(
    folder: Path, target_from_folder: npt.NDArray[np.float64]
) -> tuple[dict[str, Inertial], dict[str, tuple[Shape, ...]]]:
    """Read what :func:`save_declared` wrote, under (4, 4) a rotation and a uniform scale; nothing
    where the file is absent or damaged."""
    data = load_arrays(folder / FILE)
    if data is None:
        return {}, {}
    try:
        rows = zip(
            data["inertial links"].tolist(), data["mass"].tolist(), data["center"], data["tensor"],
            strict=True,
        )  # fmt: skip
        inertials = {
            link: Inertial(mass, center, tensor).moved(target_from_folder)
            for link, mass, center, tensor in rows
        }
        shapes = unpacked(
            {k.removeprefix(_SHAPE): v for k, v in data.items() if k.startswith(_SHAPE)}
        )
        moved = {k: tuple(moved_shape(s, target_from_folder) for s in v) for k, v in shapes.items()}
    except (ValueError, KeyError, TypeError, AssertionError):
        return {}, {}
    return ({}, {}) if inertial_problems(inertials) else (inertials, moved)
