"""Standard views, the flat picture, one part alone; and distances between two places of the
picture, snapped to corners of what is drawn.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from app.server.open_object import OpenObject
from app.server.page import call_page
from app.viewer.panels.widgets import Presses
from app.viewer.picture.object_picture import ObjectPicture
from app.viewer.picture.scene_nodes import hit_distance
from app.viewer.picture.stage import toggle_flat
from app.viewer.tab import Tab, worked_on
from app.viewer.words import keys as words

_PADS: Final[dict[str, str]] = {
    "1": "front",
    "c1": "back",
    "3": "right",
    "c3": "left",
    "7": "top",
    "c7": "bottom",
    "9": "opposite",
}
"""Key of the number pad, with "c" for Ctrl → view; as in Blender."""
VIEWS: Final = ("front", "back", "right", "left", "top", "bottom", "opposite")
_AXES: Final = "xyz"
_TILT = 0.01
"""Forward tilt of top and bottom views, a share of the direction's length; it keeps the front at
the lower edge."""


class Views:
    """Camera views of one tab.

    Args:
        number: takes a digit of the number pad while a prompt waits for one.
        asking: True while a prompt waits for a digit.
    """

    def __init__(
        self,
        tab: Tab,
        picture: ObjectPicture,
        presses: Presses,
        number: Callable[[int], None],
        asking: Callable[[], bool],
    ) -> None:
        self._tab, self._picture = tab, picture
        self._number, self._asking = number, asking
        self._before: frozenset[int] = frozenset()
        presses.on("look", self.look)
        presses.on("pad", self._pad)

    def _pad(self, key: str) -> None:
        if key.isdigit() and self._asking():
            self._number(int(key))
        elif key == "/":
            self.isolate()
        elif key.endswith("5"):
            self.toggle_flat()
        elif key in _PADS:
            self.look(_PADS[key])

    def look(self, view: str) -> None:
        """Look from a side: a name of ``VIEWS``, or an axis with its sign such as "-y"."""
        if view[0] in "+-":
            direction = np.eye(3)[_AXES.index(view[1])] * (-1.0 if view[0] == "-" else 1.0)
            if abs(direction[2]):
                direction = direction + _TILT * self._front()
        elif view == "opposite":
            camera = self._tab.client.camera
            direction = np.asarray(camera.look_at) - np.asarray(camera.position)
            up = np.asarray(camera.up_direction)
            direction = direction - 2 * (direction @ up) * up  # on the other side, as high
        else:
            turn = self._picture.shown_upright[:3, :3].T
            direction = turn @ self._side(view)
        call_page(self._tab.client, "View.look", [float(v) for v in direction])

    def _front(self) -> npt.NDArray[np.float64]:
        """Unit vector (3,) pointing out of the front."""
        obj = self._tab.selection.object
        asset = None if obj is None else obj.asset
        return np.array((0.0, -1.0, 0.0) if asset is None else asset.front)

    def _side(self, view: str) -> npt.NDArray[np.float64]:
        """(3,) from the object to the camera, in the upright frame."""
        front, up = self._front(), np.array((0.0, 0.0, 1.0))
        return {
            "front": front,
            "back": -front,
            "right": np.cross(up, front),
            "left": np.cross(front, up),
            "top": up + _TILT * front,
            "bottom": -up + _TILT * front,
        }[view]

    def toggle_flat(self) -> None:
        """Between perspective and a picture without it, as orthographic as the page can."""
        flat = toggle_flat(self._tab.client)
        self._tab.say(words.FLAT if flat else words.PERSPECTIVE)

    def isolate(self) -> None:
        """Show the selected part alone (its joint's part in the other steps); again: as before."""
        selection = self._tab.selection
        obj, part = selection.need_object(), worked_on(selection)
        others = frozenset(p.id for p in obj.document.parts if p.id != part)
        if not others or len(others) == len(obj.document.parts):
            self._tab.notify(words.ISOLATE, words.NOTHING_ISOLATED, "gray")
            return
        if selection.hidden == others:
            selection.hidden = self._before & others if self._before != others else frozenset()
        else:
            self._before = selection.hidden
            selection.hidden = others
        self._tab.invalidate()


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
            list(self._shapes(obj)),
            np.asarray(origin, np.float64),
            np.asarray(direction, np.float64),
            tolerance,
            _BEHIND * diagonal,
        )
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
    surface = min(
        (hit_distance(origin, unit, v.astype(np.float32), _indices(f)) for v, f in shapes),
        default=np.inf,
    )
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
