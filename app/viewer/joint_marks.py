"""What is drawn about joints: their axes, where they run into something, the worst moment."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import viser

from app.display_tasks import PartPayload
from app.judging import JointCheck
from app.viewer import palette
from model.kinematics.joint import Joint


@dataclass(frozen=True)
class AxisMark:
    """One axis to draw: an arrow through ``origin`` along ``axis`` in its parent's pose."""

    key: str
    origin: tuple[float, float, float]
    axis: tuple[float, float, float]
    length: float
    color: palette.Rgb
    thick: bool


class JointMarks:
    """The marks of one object in one client's scene.

    Args:
        diagonal: of the object, metres; None where none is drawn, and no mark is either.
    """

    def __init__(self, client: viser.ClientHandle, diagonal: float | None = None) -> None:
        self._client = client
        self._diagonal = diagonal
        self._axes: dict[str, tuple[AxisMark, Any]] = {}
        self._contacts: list[Any] = []
        self._contact_key: Any = None
        self._moment: list[Any] = []

    def show_axes(self, marks: Iterable[AxisMark]) -> None:
        """Draw joint axes as arrows; only those that changed are sent."""
        if self._diagonal is None:
            return
        wanted = {m.key: m for m in marks}
        for key in [k for k, (m, _) in self._axes.items() if wanted.get(k) != m]:
            self._axes.pop(key)[1].remove()
        for key, mark in wanted.items():
            if key in self._axes:
                continue
            origin, axis = np.asarray(mark.origin), np.asarray(mark.axis)
            width = self._diagonal * (0.0042 if mark.thick else 0.0026)
            ends = np.stack([origin - 0.5 * mark.length * axis, origin + 0.62 * mark.length * axis])
            self._axes[key] = (
                mark,
                self._client.scene.add_arrows(
                    f"/axis/{key}",
                    ends[None].astype(np.float32),
                    mark.color,
                    shaft_radius=width,
                    head_radius=2.6 * width,
                    head_length=6.5 * width,
                ),
            )

    def _ball(
        self, name: str, at: tuple[float, float, float], radius: float, opacity: float
    ) -> Any:
        return self._client.scene.add_icosphere(
            name,
            radius=radius,
            color=palette.CONTACT,
            subdivisions=2,
            opacity=opacity,
            position=at,
            cast_shadow=False,
            receive_shadow=False,
        )

    def show_contacts(self, checks: Sequence[JointCheck], visible: bool) -> None:
        """Mark where a sweep hits something."""
        hits = tuple(c.where for c in checks) if visible else ()
        if hits == self._contact_key or self._diagonal is None:
            return
        self._contact_key = hits
        for handle in self._contacts:
            handle.remove()
        radius = 0.009 * self._diagonal
        self._contacts = [
            self._ball(f"/contact/{k}", where, radius, 0.85) for k, where in enumerate(hits)
        ]

    def show_moment(self, where: tuple[float, float, float] | None, text: str) -> None:
        """Mark one contact so that it is seen through the parts; None takes the mark away."""
        for handle in self._moment:
            handle.remove()
        self._moment = []
        if where is None or self._diagonal is None:
            return
        radius = 0.016 * self._diagonal
        ball = self._ball("/moment", where, radius, 0.9)
        # Labels are drawn over everything, the ball is inside of what meets there.
        cross = self._client.scene.add_label("/moment/cross", "✖", anchor="center-center")
        label = self._client.scene.add_label(
            "/moment/label", text, position=(0.0, 0.0, 2.5 * radius), anchor="bottom-center"
        )
        self._moment = [cross, label, ball]


def axis_length(payloads: Sequence[PartPayload] | None, joint: Joint, diagonal: float) -> float:
    """A length that lets the arrow stand out of its part at both ends."""
    part = joint.child.removeprefix("link_")
    for payload in payloads or ():
        if str(payload.part) == part:
            points = payload.vertices if payload.vertices is not None else payload.points
            if points is not None and len(points):
                along = points @ np.asarray(joint.axis, np.float32)
                return float(np.clip(1.25 * np.ptp(along), 0.12 * diagonal, 1.1 * diagonal))
    return 0.3 * diagonal
