"""Render articulated objects without a GPU or a window, as depth-sorted points in numpy.

An orthographic camera looks down on the front. Surfaces are sampled densely enough that no hole
shows at the picture's size; joints are drawn over them as arrows.
"""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw
from scipy.ndimage import maximum_filter

from model.core.articulated_object import ArticulatedObject, Part
from model.core.joint import Joint
from model.geometry.sampling import sample_surface

PALETTE: tuple[tuple[int, int, int], ...] = (
    (176, 182, 190), (230, 126, 34), (41, 128, 185), (39, 174, 96), (155, 89, 182),
    (241, 196, 15), (231, 76, 120), (26, 188, 156), (140, 100, 60), (120, 150, 40),
)  # fmt: skip
"""The base's colour, then the moving parts'."""
TURN, SLIDE = (200, 30, 30), (20, 60, 200)
"""Arrows of turning and sliding joints."""
BACKGROUND = (250, 250, 250)
SPLAT = 1
"""Pixels that a point covers to each side."""
DENSITY = 2.5
"""Points a pixel, were the object's area spread over the picture."""

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class View:
    """Direction of the camera, and size of the picture.

    Attributes:
        azimuth: rad from +x, where the camera stands; objects of the data sets face -x.
        elevation: rad above the ground.
        width, height: pixels.
    """

    azimuth: float = math.pi + 0.6
    elevation: float = 0.42
    width: int = 300
    height: int = 260

    @property
    def axes(self) -> FloatArray:
        """(3, 3) rows: right, up, toward the camera."""
        ca, sa = math.cos(self.azimuth), math.sin(self.azimuth)
        ce, se = math.cos(self.elevation), math.sin(self.elevation)
        toward = np.array([ca * ce, sa * ce, se])
        right = np.array([-sa, ca, 0.0])
        return np.stack([right, np.cross(toward, right), toward])


def draw(
    obj: ArticulatedObject,
    *,
    colors: Mapping[str, tuple[int, int, int]] | None = None,
    q: Mapping[str, float] | None = None,
    joints: bool = False,
    bounds: FloatArray | None = None,
    view: View | None = None,
    seed: int = 0,
) -> Image.Image:
    """A picture of ``obj``.

    Args:
        colors: link → RGB; the part's own colours where it isn't named or this is None.
        q: joint values (rad or m); at rest where None.
        joints: whether axes are drawn.
        bounds: (2, 3) corners of what has to fit in; the object's at rest by default.
        view: the camera.
        seed: random seed of the sampling.
    """
    view = view or View()
    if bounds is None:
        bounds = obj.bounds
    camera = _Camera(view, bounds)
    posed = obj.pose(q or {})
    rng = np.random.default_rng(seed)
    pieces = [
        _surface(part, posed[part.link], (colors or {}).get(part.link), count, camera, rng)
        for part, count in zip(obj.parts, _counts(obj.parts, view), strict=True)
    ]
    image = camera.splat(pieces)
    if joints:
        pen = ImageDraw.Draw(image)
        for joint in obj.tree.joints:
            if joint.moves:
                _arrow(pen, camera, obj, joint, posed[joint.parent])
    return image


def part_colors(links: Sequence[str], base: str) -> dict[str, tuple[int, int, int]]:
    """A colour for each link; the base's is grey."""
    moving = [link for link in links if link != base]
    out = {link: PALETTE[1 + i % (len(PALETTE) - 1)] for i, link in enumerate(moving)}
    return {**out, base: PALETTE[0]}


def half_open(obj: ArticulatedObject) -> dict[str, float]:
    """Joint values that show the motion: half of the longer way, 0.6 rad for what has no limits."""
    out: dict[str, float] = {}
    for joint in obj.tree.joints:
        if joint.moves and joint.mimic is None:
            ends = (joint.lower or 0.0, joint.upper or 0.0) if joint.limited else (0.0, 1.2)
            value = max(ends, key=abs) / 2
            out[joint.name] = float(np.clip(value, -1.2, 1.2)) if joint.rotates else value
    return out


def png(image: Image.Image) -> bytes:
    """The picture as a PNG file."""
    out = io.BytesIO()
    image.quantize(128).save(out, "PNG", optimize=True)
    return out.getvalue()


@dataclass(frozen=True, eq=False)
class _Piece:
    points: FloatArray
    colors: FloatArray


class _Camera:
    def __init__(self, view: View, bounds: FloatArray) -> None:
        self.view, self.axes = view, view.axes
        corners = np.array(np.meshgrid(*bounds.T)).reshape(3, -1).T @ self.axes.T
        low, high = corners.min(0), corners.max(0)
        self.middle = (low + high) / 2
        size = np.maximum(high - low, 1e-12)[:2]
        room = np.array([view.width, view.height]) * 0.78
        self.scale = float((room / size).min())

    def project(self, points: FloatArray) -> FloatArray:
        """(N, 3) pixel x, pixel y (down), and nearness to the camera."""
        seen = (points @ self.axes.T - self.middle) * self.scale
        x = self.view.width / 2 + seen[:, 0]
        return np.stack([x, self.view.height / 2 - seen[:, 1], seen[:, 2]], axis=1)

    def splat(self, pieces: Sequence[_Piece]) -> Image.Image:
        width, height = self.view.width, self.view.height
        points = self.project(np.concatenate([p.points for p in pieces]))
        colors = np.concatenate([p.colors for p in pieces])
        order = np.argsort(points[:, 2], kind="stable")  # far to near
        x, y = np.floor(points[order, :2]).astype(np.int64).T + SPLAT
        inside = (x >= 0) & (x < width + 2 * SPLAT) & (y >= 0) & (y < height + 2 * SPLAT)
        nearest = np.full((height + 2 * SPLAT, width + 2 * SPLAT), -1)
        nearest[y[inside], x[inside]] = np.flatnonzero(inside)  # the last one stays
        nearest = np.asarray(maximum_filter(nearest, 2 * SPLAT + 1), np.int64)
        nearest = nearest[SPLAT:-SPLAT, SPLAT:-SPLAT]
        canvas = np.full((height, width, 3), BACKGROUND, np.uint8)
        shown = nearest >= 0
        canvas[shown] = np.clip(colors[order[nearest[shown]]], 0, 255).astype(np.uint8)
        return Image.fromarray(canvas)


def _counts(parts: Sequence[Part], view: View) -> list[int]:
    areas = [
        float(p.mesh.face_areas.sum()) if p.mesh is not None and len(p.mesh.faces) else 0.0
        for p in parts
    ]
    whole = sum(areas) or 1.0
    return [max(400, int(DENSITY * view.width * view.height * a / whole)) for a in areas]


def _surface(
    part: Part,
    posed_from_rest: FloatArray,
    color: tuple[int, int, int] | None,
    count: int,
    camera: _Camera,
    rng: np.random.Generator,
) -> _Piece:
    if part.mesh is not None and float(part.mesh.face_areas.sum()) > 0:
        cloud = sample_surface(part.mesh, count, rng)[0]
    else:
        cloud = part.cloud
    if cloud is None:
        return _Piece(np.zeros((0, 3)), np.zeros((0, 3)))
    points = cloud.points.astype(np.float64) @ posed_from_rest[:3, :3].T + posed_from_rest[:3, 3]
    if color is not None or cloud.colors is None:
        colors = np.tile(np.array(color or PALETTE[0], np.float64), (len(points), 1))
    else:
        colors = cloud.colors[:, :3].astype(np.float64)
    if cloud.normals is not None:
        normals = cloud.normals.astype(np.float64) @ posed_from_rest[:3, :3].T
        facing = np.abs(normals @ camera.axes[2])
        above = np.abs(normals[:, 2])
        colors = colors * (0.45 + 0.4 * facing + 0.15 * above)[:, None]
    return _Piece(points, colors)


def _arrow(
    pen: ImageDraw.ImageDraw,
    camera: _Camera,
    obj: ArticulatedObject,
    joint: Joint,
    posed_from_rest: FloatArray,
) -> None:
    """An axis as a line through its origin, a slide as an arrow out of its part."""
    axis = posed_from_rest[:3, :3] @ np.asarray(joint.axis)
    inside = obj.tree.descendants(joint.child)
    bounds = [p.bounds for p in obj.parts if p.link in inside]
    if not bounds:
        return
    box = np.stack([np.min([b[0] for b in bounds], 0), np.max([b[1] for b in bounds], 0)])
    reach = max(0.6 * float(np.linalg.norm(box[1] - box[0])), 24 / camera.scale)
    if joint.rotates:
        middle = np.asarray(joint.origin)
        # The point of the axis next to the part: an origin may lie anywhere along it.
        middle = middle + np.asarray(joint.axis) * ((box.mean(0) - middle) @ np.asarray(joint.axis))
        start, end, color = -reach, reach, TURN
    else:
        middle = box.mean(0)
        way = max((joint.lower or 0.0, joint.upper or 0.0), key=abs)
        start, end, color = 0.0, math.copysign(reach, way or 1.0), SLIDE
    middle = posed_from_rest[:3, :3] @ middle + posed_from_rest[:3, 3]
    tips = camera.project(np.stack([middle + start * axis, middle + end * axis]))[:, :2]
    _line(pen, tips[0], tips[1], color)


def _line(
    pen: ImageDraw.ImageDraw, start: FloatArray, end: FloatArray, color: tuple[int, int, int]
) -> None:
    pen.line([*start, *end], fill=(255, 255, 255), width=5)
    pen.line([*start, *end], fill=color, width=3)
    way = end - start
    length = float(np.linalg.norm(way))
    if length < 4:  # seen from its end
        x, y = end
        pen.ellipse([x - 5, y - 5, x + 5, y + 5], fill=color, outline=(255, 255, 255))
        return
    way = way / length
    side = np.array([-way[1], way[0]])
    head = [end + 3 * way, end - 8 * way + 5 * side, end - 8 * way - 5 * side]
    pen.polygon([tuple(p) for p in head], fill=color)
