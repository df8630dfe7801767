"""The shape of one part: surface sample, oriented box, panel with protrusions, roundness.

Lengths are in the working frame of :mod:`model.prediction.geometric.sampled_object`: the object's
diagonal is 1 and its main horizontal directions lie along x and y.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull, KDTree, QhullError

Array = npt.NDArray[np.float64]
TINY, NOTHING = 1e-6, 1e-9
"""Divisors instead of 0: of extents (diagonals) and ratios, and of what is never so small."""

ROUND = 0.055
"""Largest spread of a circle, see :class:`Roundness` (a hexagon has 0.047, a square 0.11)."""


@dataclass(frozen=True, eq=False)
class Roundness:
    """A circle fitted to the outline seen along ``axis``.

    Attributes:
        axis: (3,) unit. center: (3,) on the axis, halfway along the part. radius: of the circle.
        spread: standard deviation of the outline's radius over its mean; 0 is a perfect circle.
        half: half the part's extent along the axis.
    """

    axis: Array
    center: Array
    radius: float
    spread: float
    half: float

    @property
    def round(self) -> bool:
        """True if the outline counts as a circle."""
        return self.spread < ROUND


def extent(points: Array, scanned: bool) -> Array:
    """(2, D) lowest and highest values; clouds lose the outermost 0.4 % on each side."""
    if scanned and len(points) >= 200:
        return np.quantile(points, [0.004, 0.996], axis=0)
    return np.stack([points.min(0), points.max(0)])


def roundness(points: Array, axis: Array, scanned: bool, noise: float = 0.0) -> Roundness | None:
    """Fit a circle to the convex outline of ``points`` seen along ``axis``.

    The spread is reduced by that of a circle with this much noise.
    """
    u = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    u /= np.linalg.norm(u)
    v = np.cross(axis, u)
    flat = points @ np.stack([u, v], 1)
    if len(flat) < 4:
        return None
    if scanned and len(flat) >= 50:
        middle = np.median(flat, axis=0)
        r = np.linalg.norm(flat - middle, axis=1)
        flat = flat[r <= np.quantile(r, 0.985)]
    try:
        hull = np.asarray(flat[ConvexHull(flat).vertices], np.float64)
    except (QhullError, ValueError):
        return None
    ring = _resampled(hull, 96)
    scale = float(np.ptp(ring, axis=0).max())
    if scale < NOTHING:
        return None
    a = np.column_stack([2 * ring, np.ones(len(ring))])
    solution, *_ = np.linalg.lstsq(a, (ring**2).sum(1), rcond=None)
    middle = solution[:2]
    radii = np.linalg.norm(ring - middle, axis=1)
    along = points @ axis
    low, high = extent(along[:, None], scanned)[:, 0]
    center = middle[0] * u + middle[1] * v + axis * (low + high) / 2
    mean = float(radii.mean())
    spread = np.sqrt(max(0.0, float(radii.std()) ** 2 - (1.2 * noise) ** 2))
    if mean > 0.65 * scale:
        spread = mean  # a sliver fits a huge circle, but isn't round
    return Roundness(axis, center, mean, float(spread / mean), float(high - low) / 2)


def _resampled(polygon: Array, count: int) -> Array:
    """Evenly spaced points along a closed polygon."""
    closed = np.vstack([polygon, polygon[:1]])
    step = np.linalg.norm(np.diff(closed, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(step)])
    at = np.linspace(0.0, along[-1], count, endpoint=False)
    return np.stack([np.interp(at, along, closed[:, i]) for i in range(2)], 1)


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
        """Volume, not quite 0 for flat boxes."""
        return float(np.prod(2 * self.half + 1e-3))

    def local(self, points: Array) -> Array:
        """(N, 3) points in box coordinates (not scaled)."""
        return (points - self.center) @ self.axes

    def reach(self, direction: Array) -> float:
        """Half extent along a unit direction."""
        return float(np.abs(self.axes.T @ direction) @ self.half)


@dataclass(frozen=True, eq=False)
class PartShape:
    """One part's geometry in the working frame.

    Attributes:
        link: its link. name: the given part name or None.
        points: (N, 3) surface sample. normals: (N, 3) unit, sign unknown.
        outline: (M, 3) points that give exact extents (mesh vertices, or the cloud).
        area: surface area in squared diagonals; an estimate for clouds.
        scanned: a cloud, so extents are noisy and sides may be missing.
        noise: standard deviation of the points across the surface.
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
        """See :func:`fit_box`."""
        return fit_box(self.outline, self.scanned, self.noise)

    @cached_property
    def size(self) -> float:
        """Diagonal of the oriented box."""
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
        """(3,) centre of the oriented box."""
        return self.box.center

    @cached_property
    def principal(self) -> Array:
        """(3, 3) principal axes as columns, longest first."""
        centred = self.points - self.points.mean(0)
        _, _, rows = np.linalg.svd(centred[:: max(1, len(centred) // 2000)], full_matrices=False)
        return rows.T if rows.shape == (3, 3) else np.eye(3)

    @cached_property
    def roundnesses(self) -> tuple[Roundness, ...]:
        """Circle fits along the box axes and principal axes, roundest first."""
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
        """Circle fit along the part's symmetry axis; None if the part isn't round.

        Of several (a ball, a short cylinder) the one with the shortest extent wins.
        """
        # Anything hardly larger than the noise would pass for round.
        found = [r for r in self.roundnesses if r.round and r.radius > 6 * self.noise]
        return min(found, key=lambda r: (round(r.spread / 0.02), r.half)) if found else None

    @property
    def ball(self) -> bool:
        """True if the part is round about three axes."""
        return sum(r.round for r in self.roundnesses) >= 3

    @cached_property
    def order(self) -> tuple[int, int, int]:
        """Indices of the box axes by extent: thin, middle, long."""
        a, b, c = np.argsort(self.box.half, kind="stable")
        return int(a), int(b), int(c)

    @cached_property
    def thinness(self) -> float:
        """Thin over middle extent: small for panels and blades."""
        thin, middle, _ = self.order
        return float(self.box.half[thin] / max(self.box.half[middle], TINY))

    @cached_property
    def slenderness(self) -> float:
        """Middle over long extent: small for rods and blades."""
        _, middle, long = self.order
        return float(self.box.half[middle] / max(self.box.half[long], TINY))

    @cached_property
    def panel(self) -> Panel:
        """See :func:`fit_panel`."""
        return fit_panel(self)

    @property
    def slab_center(self) -> Array:
        """(3,) centre of the panel without its protrusions."""
        panel, axis = self.panel, self.box.axes[:, self.panel.normal]
        return self.box.center + axis * (panel.low + panel.high) / 2


@dataclass(frozen=True, eq=False)
class Protrusion:
    """The part of a panel beyond one of its faces: a handle, or a drawer behind its front.

    Attributes:
        center: (3,) mean of its points, box coordinates. spread: (3,) their standard deviation.
        share: of the part's sample. height: above the face.
    """

    center: Array
    spread: Array
    share: float
    height: float

    @property
    def strength(self) -> float:
        """0..1: resemblance to a handle rather than a seam, a step or a frame."""
        return float(np.clip((self.height - 0.004) / 0.008, 0, 1)) * float(
            np.clip((0.3 - self.share) / 0.15, 0, 1)
        )


@dataclass(frozen=True, eq=False)
class Panel:
    """A part as a slab with protrusions.

    Attributes:
        normal: index of the box axis across the slab.
        low, high: the slab's two faces along that axis, in box coordinates.
        below, above: protrusion beyond ``low`` and beyond ``high``, or None.
        fill: share of the box's face that the part covers, 1 for a full panel.
    """

    normal: int
    low: float
    high: float
    below: Protrusion | None = None
    above: Protrusion | None = None
    fill: float = 1.0

    def beyond(self, sign: float) -> Protrusion | None:
        """Protrusion on the positive or the negative side of the normal."""
        return self.above if sign > 0 else self.below


FACE_COVER = 0.3
"""Share of the panel's area that a layer must cover to be its face rather than a handle."""


def fit_panel(shape: PartShape, normal: int | None = None) -> Panel:
    """Find the slab's faces: from outside, the first layers that cover enough of its area.

    Args:
        normal: index of the box axis across the slab; the thinnest by default.
    """
    box = shape.box
    k = shape.order[0] if normal is None else normal
    local = box.local(shape.points)
    u, v = (i for i in range(3) if i != k)
    depth = local[:, k]
    half = float(box.half[k])
    if half < TINY or len(local) < 30:
        return Panel(k, -half, half)
    cells = 12 if len(local) > 900 else 8
    cell = np.zeros(len(local), int)
    for i in (u, v):
        at = np.clip(
            ((local[:, i] / (2 * box.half[i] + NOTHING) + 0.5) * cells).astype(int), 0, cells - 1
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
    return Box(axes, axes @ ((low + high) / 2), np.maximum((high - low) / 2, TINY))


def same_extents(a: PartShape, b: PartShape, tolerance: float = 0.25, slack: float = 0.01) -> bool:
    """True if two boxes have nearly the same extents.

    Args:
        tolerance: share of the extents of ``b``. slack: diagonals added to it.
    """
    x, y = np.sort(a.box.half), np.sort(b.box.half)
    return bool(np.all(np.abs(x - y) < tolerance * y + slack))


def rotation(axis: Array, angle: float) -> Array:
    """(3, 3) right-handed rotation about a unit axis (rad)."""
    x, y, z = axis
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k)


def fit_box(points: Array, scanned: bool, noise: float = 0.0) -> Box:
    """The axis-aligned box, unless a rotated one is clearly smaller.

    It must be a tenth smaller for meshes and more for clouds, whose sides may be missing. Parts
    hardly larger than their noise keep the axis-aligned box.
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
    """Smallest box rotated about working axis ``k``, to half a degree."""

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
    # For k = 1 the pair (i, j) is left-handed, so the angle changes its sign.
    return _box_in(points, rotation(e, angle if k != 1 else -angle), scanned)


def _rim(points: Array, axis: Array) -> float:
    """Smallest over largest radius around an axis: near 1 for discs and rings, small for blades."""
    u = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    u /= np.linalg.norm(u)
    v = np.cross(axis, u)
    a, b = points @ u, points @ v
    reach = np.zeros(36)
    np.maximum.at(
        reach, ((np.arctan2(b, a) / (2 * np.pi) + 0.5) * 36).astype(int) % 36, np.hypot(a, b)
    )
    return float(np.quantile(reach, 0.1) / max(reach.max(), NOTHING))


def blades(shape: PartShape) -> tuple[Array, Array, int] | None:
    """Axis, centre and number of blades of a part like a propeller; None for other parts.

    Such a part is flat, not filled, and has a rotational symmetry of order 3, 4, 5 or 6.
    """
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
