"""Jobs that pick: the surface under a ray, the elements in a box or under a stroke."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from app.server.tasks import arrays_of, asset_of
from model.core.memory import LruCache
from model.geometry.crop import largest_component
from model.geometry.picking import Picker, Stroke


@dataclass(frozen=True)
class Hidden:
    """Parts that a person has hidden: picking goes through them.

    Attributes:
        workspace: folder of the stored labels.
        labels: reference of the stored (E,) labels.
        parts: ids of the hidden parts.
    """

    workspace: Path
    labels: str
    parts: tuple[int, ...]


_pickers: LruCache[Path, Any] = LruCache(8)
_hidden: LruCache[Hidden, npt.NDArray[np.bool_]] = LruCache(4)


def picker_of(folder: Path) -> Any:
    """Return the picker of an asset, cached in this process."""
    return _pickers.get(folder, lambda: Picker(asset_of(folder, textures=False)))


def prepare_picking(folder: Path) -> None:
    """Build the ray structure before the first click needs it."""
    picker_of(folder)


def _elements_of(hidden: Hidden | None) -> npt.NDArray[np.bool_] | None:
    """Return the (E,) mask of hidden elements."""
    if hidden is None:
        return None
    return _hidden.get(
        hidden, lambda: np.isin(arrays_of(hidden.workspace).get(hidden.labels), hidden.parts)
    )


def pick(
    folder: Path,
    origin: tuple[float, float, float],
    direction: tuple[float, float, float],
    hidden: Hidden | None = None,
) -> Any:
    """Return ``Pick(position, element, normal)`` of a ray, or None for the background."""
    picker = picker_of(folder)
    return picker.pick(np.asarray(origin), np.asarray(direction), hidden=_elements_of(hidden))


def select_box(
    folder: Path,
    workspace: Path,
    camera: Any,
    corner_min: tuple[float, float],
    corner_max: tuple[float, float],
    *,
    one_piece: bool = False,
    hidden: Hidden | None = None,
) -> tuple[str, int]:
    """Store the visible elements inside a rectangle of the screen; returns reference and number.

    Args:
        one_piece: of a scan only the largest connected component.
    """
    chosen = picker_of(folder).select_box(
        camera, corner_min, corner_max, visible_only=True, hidden=_elements_of(hidden)
    )
    cloud = asset_of(folder, textures=False).cloud
    if one_piece and cloud is not None and len(chosen):
        chosen = chosen[largest_component(cloud.points[chosen])]
    return arrays_of(workspace).put(np.asarray(chosen, np.int64)), len(chosen)


def select_stroke(
    folder: Path, workspace: Path, camera: Any, stroke: Stroke, hidden: Hidden | None = None
) -> tuple[str, int]:
    """Store the visible elements under a stroke; returns reference and number."""
    chosen = picker_of(folder).select_stroke(camera, stroke, hidden=_elements_of(hidden))
    return arrays_of(workspace).put(np.asarray(chosen, np.int64)), len(chosen)
