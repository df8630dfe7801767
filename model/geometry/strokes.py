"""Strokes on the screen: the inside of a lasso, or the trace of a brush."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw

from model.core.errors import GeometryError

_HEIGHT = 1024
"""Rows of the raster: more than most windows have."""
_LONGEST = 5000

StrokeKind = Literal["lasso", "brush"]


@dataclass(frozen=True)
class Stroke:
    """A path on the screen.

    Attributes:
        kind: a lasso covers the inside of its closed path, a brush the trace of its disc.
        path: (x, y) from (0, 0), the screen's top left, to (1, 1), its bottom right.
        radius: of the brush, as a share of the screen's height.
    """

    kind: StrokeKind
    path: tuple[tuple[float, float], ...]
    radius: float = 0.02

    def __post_init__(self) -> None:
        if self.kind not in ("lasso", "brush"):
            raise GeometryError(f"a stroke is a lasso or a brush, got {self.kind!r}")
        at = np.asarray(self.path, np.float64)
        if at.ndim != 2 or at.shape[1] != 2 or not 1 <= len(at) <= _LONGEST:
            raise GeometryError(f"a stroke needs 1 to {_LONGEST} points (x, y)")
        if not (np.isfinite(at).all() and np.abs(at).max() < 10):
            raise GeometryError("a stroke's points must be on the screen, from 0 to 1")
        if not 0 < self.radius <= 0.5:
            raise GeometryError(f"a brush's radius must be in (0, 0.5], got {self.radius}")

    def raster(self, aspect: float) -> npt.NDArray[np.bool_]:
        """(rows, columns) covered pixels of a screen ``aspect`` times as wide as high."""
        size = (max(1, round(_HEIGHT * min(aspect, 8.0))), _HEIGHT)
        image = Image.new("1", size)
        draw = ImageDraw.Draw(image)
        path = [(x * size[0], y * size[1]) for x, y in self.path]
        if self.kind == "lasso":
            if len(path) >= 3:
                draw.polygon(path, fill=1)
        else:
            radius = self.radius * _HEIGHT
            if len(path) > 1:
                draw.line(path, fill=1, width=max(1, round(2 * radius)))
            for x, y in path:
                draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=1)
        return np.array(image, bool)


def covered(
    raster: npt.NDArray[np.bool_], screen: npt.NDArray[np.floating]
) -> npt.NDArray[np.bool_]:
    """Return (N,) whether the raster covers (N, 2) points on the screen."""
    rows, columns = raster.shape
    on = ((screen >= 0) & (screen < 1)).all(axis=1)
    x = np.clip(np.nan_to_num(screen[:, 0]) * columns, 0, columns - 1).astype(np.int64)
    y = np.clip(np.nan_to_num(screen[:, 1]) * rows, 0, rows - 1).astype(np.int64)
    return on & raster[y, x]
