"""Standard views, the flat picture, and one part alone: keys of the number pad and the corner."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
import numpy.typing as npt

from app.server.pointer_messages import call_page
from app.viewer.panels.markup import Presses
from app.viewer.picture.object_picture import ObjectPicture
from app.viewer.picture.stage import toggle_flat
from app.viewer.tab import Tab
from app.viewer.words import view as words

_PADS: Final[dict[str, str]] = {
    "1": "front", "c1": "back", "3": "right", "c3": "left", "7": "top", "c7": "bottom",
    "9": "opposite",
}  # fmt: skip
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
            "front": front, "back": -front, "right": np.cross(up, front),
            "left": np.cross(front, up), "top": up + _TILT * front, "bottom": -up + _TILT * front,
        }[view]  # fmt: skip

    def toggle_flat(self) -> None:
        """Between perspective and a picture without it, as orthographic as the page can."""
        flat = toggle_flat(self._tab.client)
        self._tab.say(words.FLAT if flat else words.PERSPECTIVE)

    def isolate(self) -> None:
        """Show the selected part alone (its joint's part in the other steps); again: as before."""
        selection = self._tab.selection
        obj, part = selection.need_object(), selection.worked_on
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
