"""Superpoints on a grid along the object's main directions, for boxes as proposals."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from model.segmentation.arrays import Bool, Float, Float32, Float64, Int16, Int64
from model.segmentation.encode.superpoints import Superpoints
from model.segmentation.propose.plane_boxes import STEPS, PlaneBoxes, plane_boxes

_AXES_TRIED = 400
_ALONG = np.cos(np.radians(6))
_SQUARE = 0.12
"""Largest cosine between a first and a second main direction, before it is made square."""
_LEAST_SUPPORT = 0.03
"""Least share of the surface that faces along a main direction."""
_FACING = 0.9
"""Least cosine between a superpoint's normal and the direction it faces along."""
_FLAT = 0.3
"""Largest ratio of the shortest to the second side of a front that a box may lie behind."""
_COVER = 0.2
"""Share of a front's own surface that has to face it for a box to end there."""
_NEAREST, _ENDS = 4, 2
"""Least steps between a front and the end of a box, and ends tried on each side."""
_TRIM = 0.01
"""Share of the content that may lie beyond each bound, such as a handle."""


def main_directions(normal: Float, weight: Float) -> Float64:
    """(3, 3) orthonormal rows along which most of the surface faces, the last nearest to z.

    Args:
        normal: (C, 3) unit normals, or zeros.
        weight: (C,) share of the surface.
    """
    step = max(len(normal) // _AXES_TRIED, 1)
    tried = np.concatenate([np.eye(3), normal[::step]])
    tried = tried[np.linalg.norm(tried, axis=1) > 0.5]
    total = max(float(weight.sum()), 1e-12)
    found: list[Float64] = []
    for _ in range(2):
        for axis in found:
            tried = tried[np.abs(tried @ axis) < _SQUARE]
            tried = tried - np.outer(tried @ axis, axis)
        tried = tried / np.linalg.norm(tried, axis=1, keepdims=True)
        if not len(tried):
            break
        support = (np.abs(tried @ normal.T) > _ALONG) @ weight / total
        best = tried[int(support.argmax())]
        if support.max() < _LEAST_SUPPORT:
            break
        near = np.abs(normal @ best) > _ALONG
        mean = (normal[near] * np.sign(normal[near] @ best)[:, None] * weight[near, None]).sum(0)
        for axis in found:
            mean -= mean @ axis * axis
        found.append(mean / np.linalg.norm(mean))
    if len(found) < 2:
        return np.eye(3)
    axes = np.stack([*found, np.cross(found[0], found[1])])
    upright = int(np.abs(axes[:, 2]).argmax())
    return np.roll(axes, 2 - upright, axis=0)


class BoxGrid:
    """The superpoints on a grid of 256 steps along the object's main directions.

    Attributes:
        place: (3, C) uint8 step of each superpoint along each direction.
        facing: (3, C) whether the superpoint faces along it.
        size: (C,) float32 nodes of each superpoint.
        square: (C,) the same, 0 for those that face along no direction.
        step: (3,) metres.
        axes: (3, 3) the directions, in rows.
    """

    def __init__(self, superpoints: Superpoints, axes: Float | None = None) -> None:
        length = np.linalg.norm(superpoints.normal, axis=1, keepdims=True)
        unit = superpoints.normal / np.maximum(length, 1e-9)
        self.axes = main_directions(unit, superpoints.size) if axes is None else axes
        at = superpoints.center @ self.axes.T
        low, side = at.min(0), np.maximum(np.ptp(at, axis=0), 1e-9)
        self.step = side / STEPS
        place = np.minimum((at - low) / self.step, STEPS - 1)
        self.place = np.ascontiguousarray(place.T.astype(np.uint8))
        self.facing = np.ascontiguousarray(np.abs(unit @ self.axes.T).T > _FACING)
        self.size = superpoints.size.astype(np.float32)
        self.square = self.facing.any(0) * self.size
        number = len(superpoints)
        rows = (self.place.astype(np.int64) + STEPS * np.arange(3)[:, None]).ravel()
        self._bins = csr_matrix(
            (np.tile(self.size, 3), (rows, np.tile(np.arange(number), 3))),
            shape=(3 * STEPS, number),
        )

    def between_planes(self, superpoints: Superpoints) -> PlaneBoxes:
        """The boxes between the object's planes."""
        links = superpoints.links
        apart = np.linalg.norm(superpoints.center[links.a] - superpoints.center[links.b], axis=1)
        # The distance of superpoints, patches of some nodes, tells the distance of nodes.
        spacing = float(np.median(apart)) if len(apart) else 1.0
        spacing /= max(float(np.sqrt(np.median(superpoints.size))), 1.0)
        return plane_boxes(superpoints, self.place, self.facing, self.step, max(spacing, 1e-9))

    def bounds(self, masks: Bool) -> tuple[Int16, Int16]:
        """(H, 3) first and last step of each mask, without a hundredth of it at each end."""
        held = (self._bins @ masks.T.astype(np.float32)).T.reshape(len(masks), 3, STEPS)
        low, high = trimmed_range(held)
        return low.astype(np.int16), high.astype(np.int16)

    def contents(self, low: Int16, high: Int16, margin: int = 1) -> Bool:
        """(H, C) superpoints in boxes (H, 3) that are ``margin`` steps larger on each side."""
        first = np.clip(low - margin, 0, STEPS - 1).astype(np.uint8)
        last = np.clip(high + margin, 0, STEPS - 1).astype(np.uint8)
        out = np.ones((len(low), self.place.shape[1]), bool)
        for axis in range(3):
            out &= self.place[axis] >= first[:, axis, None]
            out &= self.place[axis] <= last[:, axis, None]
        return out

    def behind(self, low: Int16, high: Int16, most: int) -> tuple[Int16, Int16]:
        """Boxes from the ``most`` largest flat ones to the surfaces that face them, both ways."""
        lows: list[Int16] = []
        highs: list[Int16] = []
        side = (high - low + 1) * self.step
        order = np.sort(side, axis=1)
        flat = np.nonzero(order[:, 0] <= _FLAT * order[:, 1])[0]
        flat = flat[np.argsort(-order[flat, 1] * order[flat, 2], kind="stable")][:most]
        for one, other, long in zip(low[flat], high[flat], side[flat], strict=True):
            axis = int(long.argmin())
            ends = self._facing_surfaces(one, other, axis)
            for end in ends[ends >= other[axis] + _NEAREST][:_ENDS]:
                lows.append(one)
                highs.append(_moved(other, axis, end))
            for end in ends[ends <= one[axis] - _NEAREST][::-1][:_ENDS]:
                lows.append(_moved(one, axis, end))
                highs.append(other)
        if not lows:
            return np.zeros((0, 3), np.int16), np.zeros((0, 3), np.int16)
        return np.stack(lows), np.stack(highs)

    def _facing_surfaces(self, low: Int16, high: Int16, axis: int) -> Int64:
        """Steps along ``axis`` at which much surface faces a flat box, within its outline."""
        inside = self.contents(_moved(low, axis, 0)[None], _moved(high, axis, STEPS - 1)[None])[0]
        inside &= self.facing[axis]
        held = np.bincount(self.place[axis][inside], self.size[inside], STEPS)
        held = held + np.r_[held[1:], 0] + np.r_[0, held[:-1]]
        own = held[low[axis] : high[axis] + 1].max()
        peak = (held >= np.r_[0, held[:-1]]) & (held > np.r_[held[1:], 0])
        return np.nonzero(peak & (held > _COVER * own))[0]


def _moved(corner: Int16, axis: int, step: int) -> Int16:
    out = corner.copy()
    out[axis] = step
    return out


def trimmed_range(held: Float32) -> tuple[Int64, Int64]:
    """First and last bin along the last axis, without a hundredth of the content at each end."""
    passed = np.cumsum(held, axis=-1)
    total = passed[..., -1:]
    first = (passed > _TRIM * total).argmax(-1)
    return first, (passed >= (1 - _TRIM) * total * (1 - 1e-6)).argmax(-1)
