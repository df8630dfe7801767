"""Limits of a joint in 3D: on an arc round its axis, or on a bar along it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from model.core.joint import Joint

Array = npt.NDArray[np.float64]
Side = Literal["lower", "upper"]

STEP: Final[dict[bool, float]] = {True: math.radians(5.0), False: 0.005}
"""Steps of Shift, by whether the joint rotates: 5° or 5 mm."""
FINE: Final[dict[bool, float]] = {True: math.radians(0.1), False: 1e-4}
"""Without Shift: as the fields show it, 0.1° or 0.1 mm."""
_OUTSIDE = 1.06
"""The arc's radius over that of the part, so that the part doesn't hide it."""
_LEAST, _MOST = 0.09, 0.9
"""Bounds of the arc's radius, shares of the object's diagonal."""
_SLANTED = 0.15
"""Sine of the angle between ray and the arc's plane, below which the plane is seen edge-on."""
_ARC_STEP = math.radians(4.0)


@dataclass(frozen=True, eq=False)
class LimitGauge:
    """An arc or a bar in the frame of the joint's parent at rest.

    Attributes:
        rotates: whether it is an arc.
        center: (3,) metres, middle of the arc, or where the bar has its zero.
        axis: (3,) unit.
        zero: (3,) unit, from the arc's middle to its zero; across the bar.
        radius: of the arc, metres.
    """

    rotates: bool
    center: Array
    axis: Array
    zero: Array
    radius: float

    @classmethod
    def of(cls, joint: Joint, points: Array, diagonal: float) -> LimitGauge:
        """The gauge of a joint beside its part.

        Args:
            points: (N, 3) of the part that it moves, at rest; metres.
            diagonal: of the object, metres.
        """
        axis, origin = np.asarray(joint.axis, np.float64), np.asarray(joint.origin, np.float64)
        points = np.asarray(points, np.float64)
        if not len(points):
            points = origin[None]
        along = (points - origin) @ axis
        away = points - origin - along[:, None] * axis
        if not joint.rotates:
            lead = float(along.max()) + 0.01 * diagonal
            middle = (points.min(axis=0) + points.max(axis=0)) / 2
            return cls(False, middle + (lead - (middle - origin) @ axis) * axis, axis,
                       _across(axis), 0.0)  # fmt: skip
        reach = np.linalg.norm(away, axis=1)
        zero = away.mean(axis=0)
        if np.linalg.norm(zero) < 0.05 * max(float(reach.max()), 1e-9):  # as of a knob
            zero = away[int(np.argmax(reach))]
        if np.linalg.norm(zero) < 1e-9:
            zero = _across(axis)
        radius = np.clip(_OUTSIDE * reach.max(), _LEAST * diagonal, _MOST * diagonal)
        # Of an upright axis the upper end, where one looks onto the arc.
        upright = abs(axis[2]) > 0.5
        at = (along.max() if axis[2] > 0 else along.min()) if upright else along.mean()
        return cls(True, origin + float(at) * axis, axis, zero / np.linalg.norm(zero),
                   float(radius))  # fmt: skip

    def place(self, q: float) -> Array:
        """(3,) where a value, radians or metres, is."""
        if not self.rotates:
            return self.center + q * self.axis
        side = np.cross(self.axis, self.zero)
        return self.center + self.radius * (math.cos(q) * self.zero + math.sin(q) * side)

    def value(self, eye: Array, target: Array, near: float) -> float:
        """The value at which a ray points.

        Args:
            eye, target: (3,) two points of the ray.
            near: the value before: turns are counted from there, and seen edge-on it stays.
        """
        along = target - eye
        length = float(np.linalg.norm(along))
        if length < 1e-12:
            return near
        along = along / length
        if not self.rotates:
            return self._nearest_on_axis(eye, along, near)
        slope = float(along @ self.axis)
        if abs(slope) < _SLANTED:
            point = target  # on the plane of the screen through the grip
        else:
            point = eye + ((self.center - eye) @ self.axis / slope) * along
        away = point - self.center
        angle = math.atan2(away @ np.cross(self.axis, self.zero), away @ self.zero)
        return near + math.remainder(angle - near, math.tau)

    def _nearest_on_axis(self, eye: Array, along: Array, near: float) -> float:
        """Coordinate along the bar's line, metres from its centre, that is nearest to a ray."""
        cosine = float(along @ self.axis)
        if 1.0 - cosine * cosine < 1e-4:  # seen end-on
            return near
        away = self.center - eye
        return float((cosine * (away @ along) - away @ self.axis) / (1.0 - cosine * cosine))

    def line(self, low: float, high: float) -> npt.NDArray[np.float32]:
        """(N, 2, 3) segments of the arc or bar from one value to another."""
        count = max(2, math.ceil(abs(high - low) / _ARC_STEP) + 1) if self.rotates else 2
        path = np.array([self.place(q) for q in np.linspace(low, high, count)])
        return np.stack([path[:-1], path[1:]], axis=1).astype(np.float32)

    def fan(
        self, low: float, high: float
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.uint32]]:
        """(V, 3) vertices and (F, 3) faces of the sector between two values, at most one turn."""
        high = min(high, low + math.tau)
        path = self.line(low, high)
        rim = np.concatenate([path[:, 0], path[-1:, 1]])
        vertices = np.concatenate([self.center[None].astype(np.float32), rim])
        first = np.arange(1, len(rim), dtype=np.uint32)
        return vertices, np.stack([np.zeros_like(first), first, first + 1], axis=1)


def snapped(q: float, rotates: bool, *, coarse: bool) -> float:
    """``q`` in steps of 5° or 5 mm where ``coarse``, else as the fields show it."""
    step = (STEP if coarse else FINE)[rotates]
    return round(q / step) * step


def limits_with(joint: Joint, side: Side, q: float) -> tuple[float, float]:
    """The limits of a joint once one of them is ``q``: they don't pass each other."""
    assert joint.lower is not None and joint.upper is not None
    if side == "lower":
        return min(q, joint.upper), joint.upper
    return joint.lower, max(q, joint.lower)


def _across(axis: Array) -> Array:
    """(3,) a unit vector at right angles to ``axis``."""
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    across = np.cross(helper, axis)
    return across / np.linalg.norm(across)
