"""Markers of comments in the picture, with their numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import viser

from app.viewer.picture import palette

_RADIUS = 0.014
"""Radius of a marker, and :data:`_REACH`, tolerance of a click on it; in the object's diagonal."""
_REACH = 0.02
Point = tuple[float, float, float]


@dataclass(frozen=True)
class CommentMark:
    """A comment: its number, its place (3,) at rest, and the text that is shown beside it."""

    number: int
    place: Point
    text: str
    chosen: bool


class CommentMarks:
    """The markers of one object in one client's scene.

    Args:
        diagonal: of the object, metres; None where none is drawn, and no marker is either.
    """

    def __init__(self, client: viser.ClientHandle, diagonal: float | None = None) -> None:
        self._client, self._diagonal = client, diagonal
        self._shown: dict[CommentMark, list[Any]] = {}

    def show(self, marks: Sequence[CommentMark]) -> None:
        """Draw markers; only those that changed are sent."""
        if self._diagonal is None:
            return
        for mark in [m for m in self._shown if m not in marks]:
            for handle in self._shown.pop(mark):
                handle.remove()
        for mark in marks:
            if mark not in self._shown:
                self._shown[mark] = self._draw(mark, self._diagonal)

    def _draw(self, mark: CommentMark, diagonal: float) -> list[Any]:
        scene, radius = self._client.scene, _RADIUS * diagonal
        name = f"/comment/{mark.number}"
        ball = scene.add_icosphere(
            name, radius=radius, color=palette.SELECTED if mark.chosen else palette.COMMENT,
            subdivisions=2, position=mark.place, cast_shadow=False, receive_shadow=False,
        )  # fmt: skip
        label = scene.add_label(
            f"{name}/label", mark.text, position=(0.0, 0.0, 1.6 * radius), anchor="bottom-center"
        )
        return [label, ball]

    def hit(self, origin: Point, direction: Point) -> int | None:
        """Return the number of the nearest marker that a ray passes, or None."""
        if self._diagonal is None:
            return None
        unit = np.asarray(direction) / np.linalg.norm(direction)
        found = []
        for mark in self._shown:
            away = np.subtract(mark.place, origin)
            along = float(away @ unit)
            if along > 0 and np.linalg.norm(away - along * unit) < _REACH * self._diagonal:
                found.append((along, mark.number))
        return min(found)[1] if found else None
