"""Distances between two places of the picture, snapped to corners of what is drawn."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from app.server.open_object import OpenObject
from app.viewer.picture.object_picture import ObjectPicture
from app.viewer.picture.scene_rays import hit_distance
from app.viewer.tab import Tab
from app.viewer.words import view as words

Array = npt.NDArray[np.float64]
Shape = tuple[npt.NDArray[np.floating], npt.NDArray[Any] | None]
"""(V, 3) vertices or points where they are drawn, and (F, 3) faces or None."""
SNAP_PIXELS: Final = 10.0
"""So near to the ray a vertex takes it."""
_BEHIND = 0.02
"""Share of the object's diagonal: what lies farther than this behind the surface isn't seen."""


class Measuring:
    """Two clicks and the line between them, in one tab."""

    def __init__(self, tab: Tab, picture: ObjectPicture) -> None:
        self._tab, self._picture = tab, picture
        self._places: list[Array] = []

    @property
    def hint(self) -> str:
        """Instruction for the next click."""
        return (words.HINT_FIRST, words.HINT_SECOND, words.HINT_MEASURED)[len(self._places)]

    def clear(self) -> None:
        """Remove points and line."""
        if self._places:
            self._places = []
            self._picture.overlays.show_measure((), "")

    def click(self, origin: Any, direction: Any) -> bool:
        """Take the place where a ray, (3,) and (3,), meets the object; False where it doesn't."""
        obj = self._tab.selection.need_object()
        camera = self._tab.client.camera
        tolerance = SNAP_PIXELS * float(camera.fov) / max(int(camera.image_height), 1)
        diagonal = 1.0 if obj.asset is None else obj.asset.diagonal
        place = snapped_hit(
            list(self._shapes(obj)), np.asarray(origin, np.float64),
            np.asarray(direction, np.float64), tolerance, _BEHIND * diagonal,
        )  # fmt: skip
        if place is None:
            return False
        if len(self._places) == 2:
            self._places = []
        self._places.append(place)
        self._show()
        self._tab.invalidate()
        return True

    def _show(self) -> None:
        text = ""
        if len(self._places) == 2:
            apart = self._places[1] - self._places[0]
            text = words.length(float(np.linalg.norm(apart)))
            x, y, z = (words.length(float(v)) for v in np.abs(apart))
            self._tab.say(words.steps(text, x, y, z))
        self._picture.overlays.show_measure(tuple(self._places), text)

    def _shapes(self, obj: OpenObject) -> Iterator[Shape]:
        """Shapes as drawn now, with their poses."""
        hidden, asset = self._tab.selection.hidden, obj.asset
        posed = self._picture.posed_parts(hidden)
        if posed is not None:
            yield from posed
        elif asset is not None:
            labels = obj.labels
            shown = None if labels is None or not hidden else ~np.isin(labels, list(hidden))
            if asset.display_points is not None:
                points = asset.display_points
                yield (points if shown is None else points[shown]), None
            elif asset.display_vertices is not None and asset.display_faces is not None:
                faces = asset.display_faces if shown is None else asset.display_faces[shown]
                yield asset.display_vertices, faces


def snapped_hit(
    shapes: list[Shape], origin: Array, direction: Array, tolerance: float, behind: float
) -> Array | None:
    """(3,) where a ray meets shapes first, or the vertex beside it; None where it meets nothing.

    Args:
        tolerance: radians between the ray and a vertex that takes it.
        behind: metres; vertices farther than this behind the surface are hidden.
    """
    unit = direction / np.linalg.norm(direction)
    shapes = [(v, f) for v, f in shapes if len(v) and (f is None or len(f))]
    surface = min((hit_distance(origin, unit, v.astype(np.float32), _indices(f))
                   for v, f in shapes), default=np.inf)  # fmt: skip
    best, nearest = None, tolerance
    for vertices, faces in shapes:
        used = vertices if faces is None else vertices[np.unique(faces)]
        away = used.astype(np.float64) - origin
        along = away @ unit
        off = np.linalg.norm(away - along[:, None] * unit, axis=1)
        angle = np.where(along > 1e-9, off / np.maximum(along, 1e-9), np.inf)
        angle[along > surface + behind] = np.inf
        at = int(np.argmin(angle))
        if angle[at] <= nearest:
            best, nearest = used[at].astype(np.float64), float(angle[at])
    if best is None and np.isfinite(surface):
        return origin + surface * unit
    return best


def _indices(faces: npt.NDArray[Any] | None) -> npt.NDArray[np.uint32] | None:
    return None if faces is None else faces.astype(np.uint32)
