"""Closed solids from a few primitives: almost everything is a loft of loops.

All lengths are metres. Solids are built around the origin unless stated otherwise, with +z up, the
front towards -y and +x to the viewer's right, and then moved.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Points = npt.NDArray[np.float64]
Vector = Sequence[float] | npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Solid:
    """A closed triangle mesh without appearance.

    Attributes:
        vertices: (V, 3) metres.
        faces: (F, 3) int32, outward.
    """

    vertices: Points
    faces: npt.NDArray[np.int32]

    def moved(self, offset: Vector) -> Solid:
        """Shifted by ``offset`` (3,)."""
        return Solid(self.vertices + np.asarray(offset, np.float64), self.faces)

    def turned(self, axis: Vector, angle: float, about: Vector = (0.0, 0.0, 0.0)) -> Solid:
        """Turned right-handed by ``angle`` radians round the line through ``about``."""
        m = rotation(axis, angle)
        center = np.asarray(about, np.float64)
        return Solid((self.vertices - center) @ m.T + center, self.faces)

    def scaled(self, factors: Vector) -> Solid:
        """Scaled per axis about the origin; mirrored factors turn the faces round."""
        return _outward(self.vertices * np.asarray(factors, np.float64), self.faces)

    def shaped(self, deform: Callable[[Points], Points]) -> Solid:
        """With every vertex passed through ``deform``: (V, 3) -> (V, 3)."""
        return _outward(deform(self.vertices.copy()), self.faces)

    @property
    def bounds(self) -> Points:
        """(2, 3) lowest and highest corner."""
        return np.stack([self.vertices.min(0), self.vertices.max(0)])


def rotation(axis: Vector, angle: float) -> Points:
    """(3, 3) right-handed rotation by ``angle`` radians about ``axis`` through the origin."""
    a = np.asarray(axis, np.float64)
    x, y, z = a / np.linalg.norm(a)
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * skew + (1.0 - np.cos(angle)) * (skew @ skew)


def signed_volume(vertices: Points, faces: npt.NDArray[np.int32]) -> float:
    """Volume in m³; negative where the faces look inward."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def _outward(vertices: Points, faces: npt.NDArray[np.int32]) -> Solid:
    if signed_volume(vertices - vertices.mean(0), faces) < 0:
        faces = np.ascontiguousarray(faces[:, ::-1])
    return Solid(vertices, faces)


def rectangle(width: float, height: float, radius: float = 0.0, corner: int = 1) -> Points:
    """(n, 2) counter-clockwise outline about the origin, its corners cut or rounded.

    Args:
        radius: of the corners; 0 gives four points.
        corner: segments a corner, 1 is a chamfer.
    """
    if radius <= 0:
        return np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * [width / 2, height / 2]
    radius = min(radius, 0.499 * width, 0.499 * height)
    angles = np.linspace(0, np.pi / 2, corner + 1)
    arc = radius * np.stack([np.cos(angles), np.sin(angles)], 1)
    out = []
    signs = ((1, 1, 0), (-1, 1, 1), (-1, -1, 2), (1, -1, 3))
    for sx, sy, quarter in signs:
        c, s = np.cos(quarter * np.pi / 2), np.sin(quarter * np.pi / 2)
        center = np.array([sx * (width / 2 - radius), sy * (height / 2 - radius)])
        out.append(center + arc @ np.array([[c, s], [-s, c]]))
    return np.concatenate(out)


def circle(radius: float, segments: int = 24) -> Points:
    """(n, 2) counter-clockwise regular polygon."""
    a = np.arange(segments) * 2 * np.pi / segments
    return radius * np.stack([np.cos(a), np.sin(a)], 1)


def loft(loops: Sequence[Points] | Points, *, ring: bool = False) -> Solid:
    """Skin over loops of equally many points.

    Args:
        loops: K loops of (n, 3); star-shaped about their mean where they are capped.
        ring: join the last loop to the first (frames, hollow tubes) instead of capping both.
    """
    stack = np.asarray(loops, np.float64)
    k, n, _ = stack.shape
    vertices = stack.reshape(-1, 3)
    index = np.arange(k * n).reshape(k, n)
    a = index if ring else index[:-1]
    b = np.roll(index, -1, axis=0) if ring else index[1:]
    a1, b1 = np.roll(a, -1, axis=1), np.roll(b, -1, axis=1)
    quads = np.stack([a, a1, b1, b], -1).reshape(-1, 4)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    if not ring:
        for loop, flip in ((index[0], True), (index[-1], False)):
            cap = _cap(vertices[loop], loop, len(vertices))
            if cap[1] is not None:
                vertices = np.vstack([vertices, cap[1]])
            faces = np.concatenate([faces, cap[0][:, ::-1] if flip else cap[0]])
    return _outward(vertices, faces.astype(np.int32))


def _cap(
    points: Points, loop: npt.NDArray[np.intp], free: int
) -> tuple[npt.NDArray[np.intp], Points | None]:
    """Triangles over one loop: two for a quadrilateral, else a fan about the mean."""
    if len(loop) == 4:
        return loop[[[0, 1, 2], [0, 2, 3]]], None
    fan = np.stack([loop, np.roll(loop, -1), np.full(len(loop), free)], 1)
    return fan, points.mean(0, keepdims=True)


def at(outline: Points, z: float) -> Points:
    """(n, 3): a (n, 2) outline lifted to height ``z``."""
    return np.column_stack([outline, np.full(len(outline), z)])


def box(size: Vector, center: Vector = (0.0, 0.0, 0.0), bevel: float = 0.0) -> Solid:
    """A box of ``size`` (x, y, z); ``bevel`` cuts all its edges."""
    w, d, h = (float(v) for v in size)
    b = min(bevel, 0.3 * min(w, d, h))
    if b <= 0:
        solid = loft([at(rectangle(w, d), -h / 2), at(rectangle(w, d), h / 2)])
    else:
        full, inner = rectangle(w, d, b), rectangle(w - 2 * b, d - 2 * b, 0.4 * b)
        heights = (-h / 2, b - h / 2, h / 2 - b, h / 2)
        outlines = (inner, full, full, inner)
        solid = loft([at(o, z) for o, z in zip(outlines, heights, strict=True)])
    return solid.moved(center)


def slab(
    outline: Points,
    thickness: float,
    *,
    axis: int = 2,
    bevel: float = 0.0,
    inset: Points | None = None,
) -> Solid:
    """A star-shaped (n, 2) outline given a thickness along ``axis``, centred on the origin.

    With axis 2 the outline lies in xy; with 1 in xz, its front to -y; with 0 in yz.
    ``bevel`` rounds both rims (``inset`` is the outline there, else a scaled one).
    """
    b = min(bevel, 0.45 * thickness)
    half = thickness / 2
    if b > 0:
        rim = inset
        if rim is None:
            center = outline.mean(0)
            extent = np.abs(outline - center).max(0)
            rim = center + (outline - center) * np.maximum(1 - b / np.maximum(extent, 1e-9), 0.1)
        loops = [at(rim, -half), at(outline, b - half), at(outline, half - b), at(rim, half)]
    else:
        loops = [at(outline, -half), at(outline, half)]
    return along(loft(loops), axis)


def along(solid: Solid, axis: int) -> Solid:
    """Turn a solid built along +z to lie along x (0) or y (1)."""
    if axis == 2:
        return solid
    v = solid.vertices
    turned = np.stack([v[:, 0], -v[:, 2], v[:, 1]], 1) if axis == 1 else v[:, [2, 0, 1]]
    return _outward(turned, solid.faces)


def rounded_box(
    size: Vector, radius: float, *, corner: int = 4, rim: float | None = None, rings: int = 0
) -> Solid:
    """A box with upright edges rounded by ``radius`` and its rims by ``rim`` (half of it).

    ``rings`` loops are added inside both caps, for shapes that are bent afterwards.
    """
    w, d, h = (float(v) for v in size)
    rim = min(radius * 0.5 if rim is None else rim, 0.45 * h, 0.3 * min(w, d))
    angles = np.linspace(0, np.pi / 2, 4)
    loops = [
        at(rectangle(w - 2 * rim, d - 2 * rim, radius, corner) * k / (rings + 1), -h / 2)
        for k in range(1, rings + 1)
    ]
    for a in angles:
        cut = rim * (1 - np.sin(a))
        outline = rectangle(w - 2 * cut, d - 2 * cut, max(radius - cut, 0.2 * radius), corner)
        loops.append(at(outline, -h / 2 + rim * (1 - np.cos(a))))
    top = [loop * [1, 1, -1] for loop in reversed(loops)]
    return loft([*loops, *top])


def frame(
    outer: tuple[float, float],
    inner: tuple[float, float],
    depth: float,
    *,
    bevel: float = 0.0,
    shift: tuple[float, float] = (0.0, 0.0),
) -> Solid:
    """A rectangular frame in the xz plane, ``depth`` along y, its opening moved by ``shift``."""
    o, i = rectangle(*outer), rectangle(*inner) + np.asarray(shift)
    half, b = depth / 2, min(bevel, 0.3 * depth)
    small = rectangle(outer[0] - 2 * b, outer[1] - 2 * b)
    if b > 0:
        loops = [at(small, half), at(o, half - b), at(o, -half), at(i, -half), at(i, half)]
    else:
        loops = [at(o, half), at(o, -half), at(i, -half), at(i, half)]
    return along(loft(loops, ring=True), 1)


def tray(
    size: Vector,
    wall: float,
    *,
    floor: float | None = None,
    radius: float = 0.0,
    taper: float = 0.0,
    corner: int = 3,
) -> Solid:
    """An open container in one piece, standing on z = 0, open at the top.

    Args:
        size: outer (x, y, z) at the rim.
        taper: how much narrower the bottom is on each side, metres.
    """
    w, d, h = (float(v) for v in size)
    floor = wall if floor is None else floor
    at_floor = 2 * taper * (1 - floor / h)

    def outline(cut: float) -> Points:
        return rectangle(w - cut, d - cut, max(radius - cut / 2, 0.3 * radius), corner)

    loops = [
        at(outline(2 * taper), 0),
        at(outline(0), h),
        at(outline(2 * wall), h),
        at(outline(2 * wall + at_floor), floor),
    ]
    return loft(loops)


def lathe(profile: Sequence[tuple[float, float]], segments: int = 28) -> Solid:
    """A (radius, z) profile turned round z, from one end on the axis to the other.

    The ends are capped, so the profile may go up outside and come down inside (a pot).
    """
    rows = np.asarray(profile, np.float64)
    unit = circle(1.0, segments)
    return loft([at(unit * max(r, 1e-5), z) for r, z in rows])


def ring(profile: Sequence[tuple[float, float]], segments: int = 28) -> Solid:
    """A closed (radius, z) profile turned round z: washers, tyres, rims."""
    unit = circle(1.0, segments)
    return loft([at(unit * r, z) for r, z in np.asarray(profile, np.float64)], ring=True)


def cylinder(radius: float, height: float, *, segments: int = 24, bevel: float = 0.0) -> Solid:
    """An upright cylinder about the origin."""
    b = min(bevel, 0.4 * height, 0.4 * radius)
    half = height / 2
    if b <= 0:
        return lathe([(radius, -half), (radius, half)], segments)
    profile = [(radius - b, -half), (radius, b - half), (radius, half - b), (radius - b, half)]
    return lathe(profile, segments)


def arc_profile(
    center: tuple[float, float], radius: float, start: float, stop: float, steps: int = 8
) -> list[tuple[float, float]]:
    """(radius, z) points on an arc; angles in degrees, 0 is outward and 90 up."""
    a = np.radians(np.linspace(start, stop, steps))
    return [(center[0] + radius * np.cos(t), center[1] + radius * np.sin(t)) for t in a]


def sphere(radius: float, segments: int = 24) -> Solid:
    """A ball about the origin."""
    return lathe(arc_profile((0.0, 0.0), radius, -90, 90, segments // 2 + 1), segments)


def sweep(path: Points, outline: Points, *, scale: npt.ArrayLike | None = None) -> Solid:
    """A (n, 2) outline carried along a (K, 3) path without twisting.

    The outline's x axis stays as level as it can be; ``scale`` (K,) widens it on the way.
    """
    path = np.asarray(path, np.float64)
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    widths = np.ones(len(path)) if scale is None else np.asarray(scale, np.float64)
    up = np.eye(3)[int(np.argmin(np.abs(tangent[0])))]
    if abs(tangent[0][2]) < 0.9:
        up = np.array([0.0, 0.0, 1.0])
    loops, side = [], np.cross(up, tangent[0])
    for point, t, s in zip(path, tangent, widths, strict=True):
        side = side - t * (side @ t)
        side /= np.linalg.norm(side)
        loops.append(point + s * (outline[:, :1] * side + outline[:, 1:] * np.cross(t, side)))
    return loft(loops)


def bent_path(corners: Sequence[Vector], radius: float, steps: int = 5) -> Points:
    """(K, 3) polyline through ``corners`` with each inner one rounded by about ``radius``."""
    pts = np.asarray(corners, np.float64)
    out = [pts[0]]
    for before, here, after in zip(pts[:-2], pts[1:-1], pts[2:], strict=True):
        into, away = before - here, after - here
        reach = min(radius, 0.45 * np.linalg.norm(into), 0.45 * np.linalg.norm(away))
        a = here + into / np.linalg.norm(into) * reach
        b = here + away / np.linalg.norm(away) * reach
        for t in np.linspace(0, 1, steps):
            out.append((1 - t) ** 2 * a + 2 * t * (1 - t) * here + t**2 * b)
    out.append(pts[-1])
    return np.asarray(out)


def tube(path: Points, radius: float, segments: int = 12) -> Solid:
    """A round bar along a (K, 3) path."""
    return sweep(path, circle(radius, segments))
