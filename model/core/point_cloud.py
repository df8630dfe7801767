"""The :class:`PointCloud` value."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.core.arrays import frozen
from model.core.errors import GeometryError


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Points of an object, metres, object frame, +z up. Arrays are read-only.

    Attributes:
        points: (N, 3) float32.
        normals: (N, 3) float32 unit vectors, or None.
        colors: (N, 3) uint8 RGB, or None.
        confidence: (N,) float32 as the source gives it, such as a splat's opacity, or None.
    """

    points: npt.NDArray[np.float32]
    normals: npt.NDArray[np.float32] | None = None
    colors: npt.NDArray[np.uint8] | None = None
    confidence: npt.NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        set_(self, "points", frozen(self.points, np.float32, 3, "points"))
        if self.normals is not None:
            set_(self, "normals", frozen(self.normals, np.float32, 3, "normals"))
        if self.colors is not None:
            set_(self, "colors", frozen(self.colors, np.uint8, 3, "colors"))
        if self.confidence is not None:
            set_(self, "confidence", frozen(self.confidence, np.float32, None, "confidence"))
        for name in ("normals", "colors", "confidence"):
            value = getattr(self, name)
            if value is not None and len(value) != len(self.points):
                raise GeometryError(
                    f"{name} has {len(value)} rows for {len(self.points)} points; they must agree"
                )

    def __len__(self) -> int:
        return len(self.points)

    def take(self, index: npt.NDArray[np.integer] | npt.NDArray[np.bool_]) -> PointCloud:
        """The points at ``index`` (integers or a mask), in that order."""
        return PointCloud(
            self.points[index],
            None if self.normals is None else self.normals[index],
            None if self.colors is None else self.colors[index],
            None if self.confidence is None else self.confidence[index],
        )

    @property
    def bounds(self) -> npt.NDArray[np.float64]:
        """(2, 3) lowest and highest corner."""
        if not len(self.points):
            raise GeometryError("a cloud without points has no bounds")
        return np.stack([self.points.min(0), self.points.max(0)]).astype(np.float64)
