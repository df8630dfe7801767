"""Short-lived marks over an object: the preview of a click, points of a cut."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import viser

from app.viewer.picture import palette

_TOWARD_CAMERA = 0.006
_DOT = 0.0032
_MARK = 0.006
_LINE_PIXELS = 3.0


class Overlays:
    """Short-lived marks in one client's scene.

    Args:
        diagonal: of the object, metres; None where none is drawn, and no mark is either.
    """

    def __init__(self, client: viser.ClientHandle, diagonal: float | None = None) -> None:
        self._client = client
        self._diagonal = diagonal
        self._dots: dict[str, Any] = {}
        self._places: list[Any] = []
        self._measure: list[Any] = []

    def show_hover(
        self,
        gained: npt.NDArray[np.float32] | None,
        lost: npt.NDArray[np.float32] | None,
        color: palette.Rgb,
    ) -> None:
        """Draw dots on elements that a click would add, dark ones on those it would remove."""
        if self._diagonal is None:
            return
        with self._client.atomic():
            self._put("gained", gained, _light(color), self._diagonal)
            self._put("lost", lost, palette.NEGATIVE, self._diagonal)

    def _put(
        self,
        name: str,
        points: npt.NDArray[np.float32] | None,
        color: palette.Rgb,
        diagonal: float,
    ) -> None:
        if points is None or not len(points):
            if name in self._dots:
                self._dots.pop(name).remove()
            return
        # A little nearer to the camera, so that the dots win over the surface they lie on.
        camera = np.asarray(self._client.camera.position, np.float32)
        near = points + _TOWARD_CAMERA * (camera - points)
        self._dots[name] = self._client.scene.add_point_cloud(
            f"/hover/{name}",
            near.astype(np.float32),
            color,
            point_size=_DOT * diagonal,
            point_shape="circle",
            precision="float32",
        )

    def show_places(self, places: tuple[tuple[float, float, float], ...]) -> None:
        """Mark the points of a cut."""
        if self._diagonal is None:
            return
        for handle in self._places:
            handle.remove()
        self._places = self._balls("/place", places, palette.CONTACT, self._diagonal)

    def _balls(
        self, name: str, places: Sequence[Any], color: palette.Rgb, diagonal: float
    ) -> list[Any]:
        """Draw a small ball at each place, (3,); returns the handles."""
        return [
            self._client.scene.add_icosphere(
                f"{name}/{k}", radius=_MARK * diagonal, color=color, subdivisions=2,
                position=place, cast_shadow=False, receive_shadow=False,
            )
            for k, place in enumerate(places)
        ]  # fmt: skip

    def show_measure(self, places: Sequence[npt.NDArray[np.float64]], text: str) -> None:
        """Mark one or two points, (3,) each, and the line between them with ``text``."""
        if self._diagonal is None:
            return
        for handle in self._measure:
            handle.remove()
        scene = self._client.scene
        self._measure = self._balls("/measure", places, palette.SELECTED, self._diagonal)
        if len(places) == 2:
            ends = np.stack(places).astype(np.float32)
            self._measure += [
                scene.add_line_segments(
                    "/measure/line",
                    ends[None],
                    palette.SELECTED,
                    thickness=_LINE_PIXELS,
                    thickness_units="screen",
                ),
                scene.add_label(
                    "/measure/label", text, position=ends.mean(axis=0), anchor="bottom-center"
                ),
            ]


def _light(color: palette.Rgb) -> palette.Rgb:
    """A lighter color."""
    r, g, b = (int(c + 0.45 * (255 - c)) for c in color)
    return (r, g, b)
