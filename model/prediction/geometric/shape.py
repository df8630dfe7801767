"""What one part looks like: a deterministic surface sample, its box, and how round it is.

All lengths are in the working frame of :mod:`model.prediction.geometric.assembly`: the object's
diagonal is 1
and its dominant horizontal directions lie along x and y.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from model.prediction.geometric.outline import Roundness, extent, roundness

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Box:
    """An oriented box.

    Attributes:
        axes: (3, 3), columns are unit axes, right-handed.
        center: (3,). half: (3,) half extents along the axes.
    """

    axes: Array
    center: Array
    half: Array

    @property
    def volume(self) -> float:
        """Of the box, with a floor for flat ones."""
        return float(np.prod(2 * self.half + 1e-3))

    def local(self, points: Array) -> Array:
        """(N, 3) points in box coordinates (not scaled)."""
        return (points - self.center) @ self.axes

    def reach(self, direction: Array) -> float:
        """Half extent along a unit direction."""
        return float(np.abs(self.axes.T @ direction) @ self.half)


@dataclass(frozen=True, eq=False)
class Shape:
    """One part's geometry.

    Attributes:
        link: its link. name: the given part name or None.
        points: (N, 3) surface sample. normals: (N, 3) unit, sign unknown.
        outline: (M, 3) points that give exact extents (mesh vertices, or the cloud).
        area: surface area in squared diagonals (of clouds: an estimate).
        scanned: the geometry is a cloud, so extents are noisy and sides may be missing.
        noise: standard deviation of its points across the surface.
    """

    link: str
    name: str | None
    points: Array
    normals: Array
    outline: Array
    area: float
    scanned: bool
    noise: float = 0.0

    @cached_property
    def box(self) -> Box:
        """Smallest of a few boxes, with a preference for the object's own directions."""
        return fit_box(self.outline, self.scanned, self.noise)

    @cached_property
    def size(self) -> float:
        """Diagonal of the box."""
        return float(2 * np.linalg.norm(self.box.half))

    @cached_property
    def low(self) -> Array:
        """(3,) lowest corner along the working frame's axes."""
        return self._bounds[0]

    @cached_property
    def high(self) -> Array:
        """(3,) highest corner along the working frame's axes."""
        return self._bounds[1]

    @cached_property
    def _bounds(self) -> Array:
        return extent(self.outline, self.scanned)

    @property
    def center(self) -> Array:
        """(3,) of the box."""
        return self.box.center

    @cached_property
    def principal(self) -> Array:
        """(3, 3) principal axes as columns, longest first."""
        centred = self.points - self.points.mean(0)
        _, _, rows = np.linalg.svd(centred[:: max(1, len(centred) // 2000)], full_matrices=False)
        return rows.T if rows.shape == (3, 3) else np.eye(3)

    @cached_property
    def roundnesses(self) -> tuple[Roundness, ...]:
        """For each candidate axis (box axes, then principal axes), roundest first."""
        axes = [*self.box.axes.T]
        if self.scanned:
            axes += [*np.eye(3)]
        if self.size > 30 * self.noise:
            axes += [*self.principal.T]
        kept: list[Array] = []
        for a in axes:
            if all(abs(a @ b) < 0.9998 for b in kept):
                kept.append(a)
        out = [
            r
            for a in kept
            if (r := roundness(self.outline, a, self.scanned, self.noise)) is not None
        ]
        return tuple(sorted(out, key=lambda r: r.spread))

    @cached_property
    def roundest(self) -> Roundness | None:
        """The axis about which the part is round; None where it is not.

        Where several are (a ball, a short cylinder) the one with the shorter extent wins.
        """
        # What is hardly larger than the noise looks round whatever it is.
        found = [r for r in self.roundnesses if r.round and r.radius > 6 * self.noise]
        return min(found, key=lambda r: (round(r.spread / 0.02), r.half)) if found else None

    @property
    def ball(self) -> bool:
        """Whether it is round about three axes."""
        return sum(r.round for r in self.roundnesses) >= 3

    @cached_property
    def order(self) -> tuple[int, int, int]:
        """Indices of the box axes: thin, middle, long."""
        a, b, c = np.argsort(self.box.half, kind="stable")
        return int(a), int(b), int(c)

    @cached_property
    def thinness(self) -> float:
        """Thin over middle extent: small for a panel or a flat blade."""
        thin, middle, _ = self.order
        return float(self.box.half[thin] / max(self.box.half[middle], 1e-6))

    @cached_property
    def slenderness(self) -> float:
        """Middle over long extent: small for a rod or a blade."""
        _, middle, long = self.order
        return float(self.box.half[middle] / max(self.box.half[long], 1e-6))

    @cached_property
    def panel(self) -> Panel:
        """The part seen as a panel with something sticking out."""
        return fit_panel(self)

    @property
    def slab_center(self) -> Array:
        """(3,) of the panel's slab, without what sticks out of it."""
        panel, axis = self.panel, self.box.axes[:, self.panel.normal]
        return self.box.center + axis * (panel.low + panel.high) / 2


@dataclass(frozen=True, eq=False)
class Protrusion:
    """What sticks out of one face of a panel: a handle, or what reaches into the body.

    Attributes:
        center: (3,) mean of its points, box coordinates. spread: (3,) their standard deviation.
        share: of the part's sample.
        height: how far it sticks out.
    """

    center: Array
    spread: Array
    share: float
    height: float

    @property
    def strength(self) -> float:
        """0..1: how much it is like a handle, not like a seam, a step or a frame."""
        return float(np.clip((self.height - 0.004) / 0.008, 0, 1)) * float(
            np.clip((0.3 - self.share) / 0.15, 0, 1)
        )


@dataclass(frozen=True, eq=False)
class Panel:
    """The part seen as a slab with something sticking out of its faces.

    Attributes:
        normal: index of the box axis across the slab.
        low, high: the slab's two faces along that axis, in box coordinates.
        below, above: what sticks out beyond ``low`` and beyond ``high``, or None.
        fill: share of the box's face that the part covers, 1 for a full panel.
    """

    normal: int
    low: float
    high: float
    below: Protrusion | None = None
    above: Protrusion | None = None
    fill: float = 1.0

    def beyond(self, sign: float) -> Protrusion | None:
        """What sticks out towards the positive or the negative side of the normal."""
        return self.above if sign > 0 else self.below


FACE_COVER = 0.3
"""Share of the panel's outline that a layer must cover to be its face and not a handle."""


def fit_panel(shape: Shape, normal: int | None = None) -> Panel:
    """Find the slab's faces: from outside, the first layers that cover enough of the outline."""
    box = shape.box
    k = shape.order[0] if normal is None else normal
    local = box.local(shape.points)
    u, v = (i for i in range(3) if i != k)
    depth = local[:, k]
    half = float(box.half[k])
    if half < 1e-6 or len(local) < 30:
        return Panel(k, -half, half)
    cells = 12 if len(local) > 900 else 8
    cell = np.zeros(len(local), int)
    for i in (u, v):
        at = np.clip(
            ((local[:, i] / (2 * box.half[i] + 1e-9) + 0.5) * cells).astype(int), 0, cells - 1
        )
        cell = cell * cells + at
    total = len(np.unique(cell))

    def face(sign: float) -> float:
        highest = np.full(cells * cells, -np.inf)
        np.maximum.at(highest, cell, sign * depth)
        levels = np.sort(highest[np.isfinite(highest)])[::-1]
        return sign * float(levels[min(len(levels) - 1, int(FACE_COVER * total))])

    high, low = face(1.0), face(-1.0)
    if low > high:
        low, high = high, low
    slack = max(0.06 * half, 0.004 if shape.scanned else 0.0015)

    def beyond(sign: float) -> Protrusion | None:
        edge = high if sign > 0 else -low
        out = sign * depth > edge + slack
        if out.sum() < max(4, 0.002 * len(depth)) or out.mean() > 0.45:
            return None
        return Protrusion(
            local[out].mean(0),
            local[out].std(0),
            float(out.mean()),
            float((sign * depth[out]).max() - edge),
        )

    return Panel(k, low, high, beyond(-1.0), beyond(1.0), total / cells**2)


def _box_in(points: Array, axes: Array, scanned: bool) -> Box:
    low, high = extent(points @ axes, scanned)
    return Box(axes, axes @ ((low + high) / 2), np.maximum((high - low) / 2, 1e-6))


def rotation(axis: Array, angle: float) -> Array:
    """(3, 3) right-handed rotation about a unit axis (rad)."""
    x, y, z = axis
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k)


def fit_box(points: Array, scanned: bool, noise: float = 0.0) -> Box:
    """The object's directions, unless a turned box is clearly smaller.

    By a tenth for meshes; by more for clouds, whose sides may be missing, and never for what is
    hardly larger than its noise.
    """
    points = points[:: max(1, len(points) // 3000)] if scanned else points
    best = _box_in(points, np.eye(3), scanned)
    if scanned and float(np.sort(best.half)[1]) < 8 * noise:
        return best
    limit = (0.55 if scanned else 0.9) * best.volume
    coarse = points[:: max(1, len(points) // 400)]
    for k in range(3):
        turned = _turned_box(points, coarse, k, scanned)
        if turned.volume < limit:
            best, limit = turned, turned.volume * 0.98
    if len(points) >= 3:
        centred = points - points.mean(0)
        _, _, rows = np.linalg.svd(centred, full_matrices=False)
        if rows.shape == (3, 3):
            axes = rows.T * (1 if np.linalg.det(rows) > 0 else -1)
            axes = _near_identity(axes)
            box = _box_in(points, axes, scanned)
            if box.volume < 0.9 * limit:
                best = box
    return best


def _near_identity(axes: Array) -> Array:
    """The same box axes, ordered and signed so that column k is close to axis k."""
    out, free = np.zeros((3, 3)), [0, 1, 2]
    for k in np.argsort(-np.abs(axes).max(0)):
        to = max(free, key=lambda f: abs(axes[f, k]))
        free.remove(to)
        out[:, to] = axes[:, k] * (1.0 if axes[to, k] >= 0 else -1.0)
    if np.linalg.det(out) < 0:
        out[:, 2] *= -1
    return out


def _turned_box(points: Array, coarse: Array, k: int, scanned: bool) -> Box:
    """Smallest box after a turn about working axis ``k``, to half a degree."""

    def areas(p: Array, angles: Array) -> Array:
        i, j = [x for x in range(3) if x != k]
        c, s = np.cos(angles)[:, None], np.sin(angles)[:, None]
        a, b = c * p[:, i] + s * p[:, j], -s * p[:, i] + c * p[:, j]
        if scanned and p.shape[0] >= 200:
            qa, qb = (np.quantile(x, [0.004, 0.996], axis=1) for x in (a, b))
            return (qa[1] - qa[0]) * (qb[1] - qb[0])
        return np.ptp(a, axis=1) * np.ptp(b, axis=1)

    angles = np.deg2rad(np.arange(-45, 45, 3.0))
    rough = angles[np.argmin(areas(coarse, angles))]
    fine = rough + np.deg2rad(np.arange(-3, 3.01, 0.5))
    angle = float(fine[np.argmin(areas(points, fine))])
    e = np.eye(3)[k]
    # (i, j) is (z, x) reversed for k = 1, so the sense of the turn changes there.
    return _box_in(points, rotation(e, angle if k != 1 else -angle), scanned)


def _rim(points: Array, axis: Array) -> float:
    """Smallest over largest reach around an axis: near 1 for plates and rings, small for blades."""
    u = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    u /= np.linalg.norm(u)
    v = np.cross(axis, u)
    a, b = points @ u, points @ v
    reach = np.zeros(36)
    np.maximum.at(
        reach, ((np.arctan2(b, a) / (2 * np.pi) + 0.5) * 36).astype(int) % 36, np.hypot(a, b)
    )
    return float(np.quantile(reach, 0.1) / max(reach.max(), 1e-9))


def blades(shape: Shape) -> tuple[Array, Array, int] | None:
    """Axis, centre and number of the blades of a part like a propeller; None for other parts.

    The part is flat, not filled, and lies on itself after a turn by a full turn over 3, 4, 5 or 6.
    """
    from scipy.spatial import KDTree

    axis = shape.box.axes[:, shape.order[0]]
    if shape.roundest is not None or shape.thinness > 0.6 or shape.slenderness < 0.75:
        return None
    if shape.panel.fill > 0.8:
        return None
    points = shape.points[:: max(1, len(shape.points) // 500)]
    center = points.mean(0)
    tree = KDTree(points)
    radius = float(np.linalg.norm(points - center, axis=1).max())
    if _rim(points - center, axis) > 0.6:
        return None
    spacing = float(np.median(tree.query(points, k=2)[0][:, 1]))
    for count in (3, 5, 4, 6):
        turned = (points - center) @ rotation(axis, 2 * np.pi / count).T + center
        off = float(np.quantile(tree.query(turned)[0], 0.9))
        if off < 2.5 * spacing + 0.03 * radius:
            return axis, center, count
    return None
