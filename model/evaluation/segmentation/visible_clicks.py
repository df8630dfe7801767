"""The visible-click protocol: clicks on what a person sees, all moving parts, never the base.

The field's protocol clicks the deepest point of a part wherever that is, inside a closed drawer
too. A person clicks the middle of the largest visible component of a part, then the middle of the
largest visible error: for the part that it belongs to, or with Shift on excess.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import distance_transform_edt, label
from scipy.spatial import KDTree

from model.core.asset import Asset
from model.core.geometry import Mesh
from model.geometry.casting import Caster, camera_rays, look_at
from model.segmentation.arrays import Bool, Float, Float64, Int64, Labels
from model.segmentation.prompts import BASE, Click, Prompts
from model.segmentation.protocol import SegmentationSession

Points = Float64

_ROWS, _COLUMNS = 200, 240
_FOV = 0.6
LEAST_PIXELS = 12
"""Least pixels of a part or an error that is clicked."""
_NOTHING = -1
_SOME, _AROUND = 2000, 6
"""Points of a cloud, and neighbours of each, that give its spacing."""
_LARGEST_DOT = 5.0
"""Largest radius of a point's dot in pixels."""
FRONT = (-1.0, 0.0, 0.0)
"""Direction that PartNet-Mobility's objects face."""


@dataclass(frozen=True, eq=False)
class Picture:
    """The visible elements of an object, seen from its front, the side and above.

    Attributes:
        element: (R, C) int64 the element in each pixel, -1 for none.
        position: (R, C, 3) metres, the visible point.
    """

    element: Int64
    position: Float64

    def of(self, labels: Labels) -> Labels:
        """(R, C) the part in each pixel, -1 for none."""
        return np.where(self.element < 0, np.int16(_NOTHING), labels[self.element])

    def click(self, pixel: tuple[int, int], part: int, positive: bool = True) -> Click:
        """A click on a pixel (row, column)."""
        x, y, z = self.position[pixel].tolist()
        return Click((x, y, z), part, positive, int(self.element[pixel]))


def picture_of(asset: Asset, front: npt.ArrayLike = FRONT) -> Picture:
    """The picture of ``asset`` that a person sees first, 240 by 200 pixels.

    The points of a cloud are dots that are large enough to close its surfaces.

    Args:
        front: (3,) the direction that it faces.
    """
    low, high = asset.bounds
    return picture_from(asset, *_camera(low, high, front))


def picture_from(asset: Asset, eye: Points, target: Points, fov: float = _FOV) -> Picture:
    """The picture of ``asset`` from an eye that looks at a target, both (3,).

    Args:
        fov: vertical angle of view in radians.
    """
    if asset.mesh is not None:
        return _of_mesh(asset.mesh, eye, target, fov)
    assert asset.cloud is not None
    return _of_points(asset.cloud.points.astype(np.float64), eye, target, fov)


def _camera(low: Points, high: Points, front: npt.ArrayLike) -> tuple[Points, Points]:
    """(3,) positions of the eye and of its target."""
    middle = (low + high) / 2
    ahead = np.asarray(front, np.float64)
    toward = ahead + 0.5 * np.cross(ahead, (0.0, 0.0, 1.0)) + (0.0, 0.0, 0.45)
    toward /= np.linalg.norm(toward)
    away = 0.55 * float(np.linalg.norm(high - low)) / np.tan(_FOV / 2)
    return middle + away * toward, middle


def _of_mesh(mesh: Mesh, eye: Points, middle: Points, fov: float) -> Picture:
    directions = camera_rays(eye, middle, _COLUMNS, _ROWS, fov)
    origins = np.broadcast_to(eye, directions.shape)
    hits = Caster([mesh]).cast(origins, directions, colors=False)
    element = np.full(_ROWS * _COLUMNS, _NOTHING, np.int64)
    position = np.zeros((_ROWS * _COLUMNS, 3))
    element[hits.ray], position[hits.ray] = hits.face, hits.points
    return Picture(element.reshape(_ROWS, _COLUMNS), position.reshape(_ROWS, _COLUMNS, 3))


def _of_points(points: Points, eye: Points, middle: Points, fov: float) -> Picture:
    local = (points - eye) @ look_at(eye, middle).T
    pixel = 2 * np.tan(fov / 2) / _ROWS
    column = np.floor(local[:, 0] / local[:, 2] / pixel + _COLUMNS / 2).astype(np.int64)
    row = np.floor(local[:, 1] / local[:, 2] / pixel + _ROWS / 2).astype(np.int64)
    some = points[:: max(len(points) // _SOME, 1)]
    apart, _ = KDTree(points).query(some, k=min(_AROUND + 1, len(points)))
    spacing = float(np.median(np.atleast_2d(apart)[:, -1]))
    radius = float(np.clip(spacing / (pixel * np.median(local[:, 2])), 1.0, _LARGEST_DOT))
    far_first = np.argsort(-local[:, 2], kind="stable")
    row, column, depth = row[far_first], column[far_first], local[far_first, 2]
    element = np.full(_ROWS * _COLUMNS, _NOTHING, np.int64)
    nearest = np.full(_ROWS * _COLUMNS, np.inf)
    reach = range(-int(np.ceil(radius)), int(np.ceil(radius)) + 1)
    for down, right in ((d, r) for d in reach for r in reach if d * d + r * r <= radius**2 + 0.25):
        there = (row + down >= 0) & (row + down < _ROWS)
        there &= (column + right >= 0) & (column + right < _COLUMNS)
        at = (row[there] + down) * _COLUMNS + column[there] + right
        drawn = np.full(_ROWS * _COLUMNS, _NOTHING, np.int64)
        drawn[at] = np.flatnonzero(there)  # of several the last one stays, which is the nearest
        # A dot's middle is in front of its rim, so that dots side by side share their border.
        behind = depth[drawn] + 1e-3 * spacing * (down**2 + right**2)
        nearer = (drawn >= 0) & (behind < nearest)
        nearest[nearer], element[nearer] = behind[nearer], far_first[drawn[nearer]]
    position = np.where((element >= 0)[:, None], points[element], 0.0)
    return Picture(element.reshape(_ROWS, _COLUMNS), position.reshape(_ROWS, _COLUMNS, 3))


def largest_component(region: Bool) -> tuple[Bool, int]:
    """The largest connected component of a region, and its number of pixels."""
    number = np.zeros(region.shape, np.int32)
    label(region, output=number)
    size = np.bincount(number.ravel())[1:]
    if not len(size):
        return region, 0
    return number == 1 + size.argmax(), int(size.max())


def depths(component: Bool) -> Points:
    """(R, C) distance of each pixel to the component's outline in pixels, 0 outside."""
    return np.asarray(distance_transform_edt(np.pad(component, 1)))[1:-1, 1:-1]


def middle_of(component: Bool) -> tuple[int, int]:
    """Row and column of the pixel that is farthest from the component's outline."""
    depth = depths(component)
    row, column = np.unravel_index(int(np.argmax(depth)), depth.shape)
    return int(row), int(column)


@dataclass(frozen=True, eq=False)
class VisibleRounds:
    """A session by the visible-click protocol.

    Attributes:
        parts: visible moving parts.
        labels: (E,) after the last click.
        iou: mean IoU of the parts' visible pixels, after each round.
        clicks, drops: corrective clicks, and those that lowered that mean by more than ``DROP``.
        after_rounds: (E,) labels after each round.
    """

    parts: tuple[int, ...]
    labels: Labels
    iou: tuple[float, ...]
    clicks: int = 0
    drops: int = 0
    after_rounds: tuple[Labels, ...] = ()


DROP = 0.05
"""Mean IoU that a click may lose before it counts as one that lowers it."""


def visible_rounds(
    session: SegmentationSession, picture: Picture, truth: Labels, rounds: int = 3
) -> VisibleRounds:
    """Click every visible moving part once, then in each round the largest visible errors.

    Args:
        truth: (E,) the true part of each element, 0 the base, -1 for none.
        rounds: of as many clicks as there are parts.
    """
    true = picture.of(truth)
    parts = [int(p) for p in np.unique(true[true > BASE]) if (true == p).sum() >= LEAST_PIXELS]
    if not parts:
        return VisibleRounds((), np.zeros(len(truth), np.int16), ())
    one = (true >= BASE).astype(float)

    def mean(labels: Labels) -> float:
        shown = picture.of(labels)
        return float(np.mean([_iou(shown == p, true == p, one) for p in parts]))

    clicks = [picture.click(middle_of(largest_component(true == p)[0]), p) for p in parts]
    labels = session.segment(Prompts(tuple(clicks))).labels
    iou, after, drops = [mean(labels)], [labels], 0
    for _ in range(rounds - 1):
        now = iou[-1]
        for _ in parts:
            more = _next(picture, true, picture.of(labels), parts)
            if more is None:
                break
            clicks.append(more)
            labels = session.segment(Prompts(tuple(clicks))).labels
            before, now = now, mean(labels)
            drops += now < before - DROP
        iou.append(now)
        after.append(labels)
    corrective = len(clicks) - len(parts)
    return VisibleRounds(tuple(parts), labels, tuple(iou), corrective, drops, tuple(after))


def visible_click_ious(
    session: SegmentationSession, picture: Picture, truth: Labels, weight: Float, rounds: int = 3
) -> list[tuple[float, float]]:
    """After each of the :func:`visible_rounds`, the mean IoU of visible pixels, and of all elements
    by their ``weight`` (E,), 0 for those of no part; empty if no moving part is visible.
    """
    found = visible_rounds(session, picture, truth, rounds)
    whole = [
        float(np.mean([_iou(labels == p, truth == p, weight) for p in found.parts]))
        for labels in found.after_rounds
    ]
    return list(zip(found.iou, whole, strict=True))


def _next(picture: Picture, true: Labels, shown: Labels, parts: list[int]) -> Click | None:
    """The click on the largest visible error within one true part; None without any."""
    errors = [(largest_component((true == p) & (shown != p)), p) for p in [BASE, *parts]]
    (error, size), part = max(errors, key=lambda found: found[0][1])
    if size < LEAST_PIXELS:
        return None
    at = middle_of(error)
    wanted = part != BASE
    return picture.click(at, part if wanted else int(shown[at]), wanted)


def _iou(answer: Bool, truth: Bool, weight: Float) -> float:
    return float(weight[answer & truth].sum() / max(weight[answer | truth].sum(), 1e-12))
