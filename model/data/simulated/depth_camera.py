"""Simulated scans: by a depth camera before an object, and reconstructions as phones deliver them.

Each view casts a camera's rays, so that what is hidden stays hidden and the far side is missing.
Depth noise grows with the square of the distance, edges smear, surfaces seen at a slant and a few
patches return nothing, and outliers float around.

Photogrammetry and LiDAR reconstructions differ from one depth picture: poses of the views drift,
depth errors are smooth over a picture, smooth surfaces have holes, backs and undersides are
incomplete, density is uneven, and the object stands on something, among other things, in a frame
of any rotation and scale.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import trimesh
from scipy.ndimage import zoom
from scipy.spatial.transform import Rotation

from model.core.articulated_object import ArticulatedObject, SegmentedObject
from model.core.errors import ConfigurationError
from model.core.geometry import Material, Mesh, PointCloud
from model.geometry.casting import Caster, Hits, camera_rays, daylight
from model.geometry.cleaning import CLUTTER, OBJECT, OUTLIER, SUPPORT

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class View:
    """Position of a camera: it looks at the object's middle.

    Attributes:
        azimuth: radians; 0 is before the front, positive to the viewer's right.
        elevation: radians above the middle.
        distance: metres from the middle, or None for 1.6 diagonals.
    """

    azimuth: float
    elevation: float
    distance: float | None = None


@dataclass(frozen=True)
class ScanSettings:
    """Views of a scan, and faults of its camera.

    Attributes:
        views: at least one.
        points: how many points remain in all (fewer where fewer are seen).
        depth_noise: standard deviation of the depth in metres at 1 m; grows with distance squared.
        color_noise: standard deviation in 0..255; each view has its own exposure as well.
        smear: share of the points at depth edges that are drawn into the gap behind them.
        holes: patches a view where nothing returns; hole_size: their radius in diagonals.
        outliers: share of points on no surface.
        misalignment: metres and radians (standard deviation) between the views.
        see_through: glass is not seen at all.
    """

    views: tuple[View, ...] = (View(-0.45, 0.35), View(0.5, 0.3))
    points: int = 100_000
    depth_noise: float = 0.0012
    color_noise: float = 6.0
    smear: float = 0.25
    holes: int = 3
    hole_size: float = 0.02
    outliers: float = 0.002
    misalignment: float = 0.0006
    see_through: bool = True

    def __post_init__(self) -> None:
        if not self.views:
            raise ConfigurationError("a scan needs at least one view")
        if self.points < 1:
            raise ConfigurationError(f"points must be 1 or more, got {self.points}")


@dataclass(frozen=True, eq=False)
class LabelledScan:
    """A scan whose points know what they are.

    Attributes:
        cloud: points and colours, object frame.
        part: (N,) int32 index of the part in the object's order; -1 for outliers.
        smeared: (N,) whether a point was drawn into the gap behind an edge: it lies on no surface.
    """

    cloud: PointCloud
    part: npt.NDArray[np.int32]
    smeared: npt.NDArray[np.bool_]


def simulate_scan(
    obj: ArticulatedObject | SegmentedObject, settings: ScanSettings, rng: np.random.Generator
) -> LabelledScan:
    """Scan an object in its rest pose.

    Points come view by view in the camera's row order.
    """
    low, high = obj.bounds
    diagonal = float(np.linalg.norm(high - low))
    caster = Caster.of(obj, see_through=settings.see_through)
    each = [
        _view(caster, view, settings, (low + high) / 2, diagonal, rng) for view in settings.views
    ]
    points, colors, part, smeared = (np.concatenate([e[k] for e in each]) for k in range(4))
    if len(points) > settings.points:
        kept = np.sort(rng.choice(len(points), settings.points, replace=False))
        points, colors, part, smeared = points[kept], colors[kept], part[kept], smeared[kept]
    outliers = int(settings.outliers * len(points))
    if outliers:
        spots = rng.uniform(low - 0.05 * diagonal, high + 0.05 * diagonal, (outliers, 3))
        points = np.concatenate([points, spots])
        colors = np.concatenate([colors, rng.integers(40, 220, (outliers, 3))])
        part = np.concatenate([part, np.full(outliers, -1)])
        smeared = np.concatenate([smeared, np.zeros(outliers, bool)])
    cloud = PointCloud(points.astype(np.float32), None, np.clip(colors, 0, 255).astype(np.uint8))
    return LabelledScan(cloud, part.astype(np.int32), smeared.astype(bool))


def _view(
    caster: Caster,
    view: View,
    settings: ScanSettings,
    middle: Array,
    diagonal: float,
    rng: np.random.Generator,
) -> tuple[Array, Array, npt.NDArray[np.int32], npt.NDArray[np.bool_]]:
    # About a quarter of the picture is the object; more rays than points are cast.
    side = int(np.sqrt(5.5 * settings.points / len(settings.views))) + 8
    eye, directions = look_from(view, middle, diagonal, side)
    hits = caster.cast(np.tile(eye, (len(directions), 1)), directions)
    light = daylight(caster, hits, samples=8, reach=0.12 * diagonal)
    sigma = settings.depth_noise * hits.distance**2
    slant = np.abs(np.einsum("ij,ij->i", hits.normals, directions[hits.ray]))
    depth = hits.distance + sigma * rng.standard_normal(len(sigma)) / np.clip(slant, 0.25, 1)
    depth, smeared = flying_pixels(hits, depth, side, settings.smear, diagonal, rng)
    kept = rng.random(len(depth)) < np.clip(slant / 0.3, 0.02, 1)
    kept &= ~dropouts(hits, settings, diagonal, rng)
    points = eye + depth[:, None] * directions[hits.ray]
    points = _misaligned(points, middle, settings.misalignment, rng)
    exposure = rng.uniform(0.92, 1.08) * (1 + rng.normal(0, 0.015, 3))
    colors = hits.colors * light[:, None] * exposure + rng.normal(
        0, settings.color_noise, points.shape
    )
    return points[kept], colors[kept], hits.part[kept], smeared[kept]


def look_from(view: View, middle: Array, diagonal: float, side: int) -> tuple[Array, Array]:
    """(3,) eye and (side², 3) rays of a square picture that holds the object."""
    distance = 1.6 * diagonal if view.distance is None else view.distance
    ce = np.cos(view.elevation)
    away = np.array([np.sin(view.azimuth) * ce, -np.cos(view.azimuth) * ce, np.sin(view.elevation)])
    eye = middle + distance * away
    return eye, camera_rays(
        eye, middle, side, side, 2 * float(np.arctan(0.56 * diagonal / distance))
    )


def flying_pixels(
    hits: Hits, depth: Array, side: int, share: float, diagonal: float, rng: np.random.Generator
) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Depths with smeared edges, and the mask of smeared points."""
    image = np.full(side * side, np.nan)
    image[hits.ray] = hits.distance
    image = image.reshape(side, side)
    right = np.full_like(image, np.nan)
    right[:, :-1] = image[:, 1:]
    jump = (right - image).reshape(-1)[hits.ray]
    edge = np.isfinite(jump) & (np.abs(jump) > 0.01 * diagonal) & (np.abs(jump) < 0.2 * diagonal)
    edge &= rng.random(len(edge)) < share
    out = depth.copy()
    out[edge] += jump[edge] * rng.random(int(edge.sum())) * 0.6
    return out, edge


def dropouts(
    hits: Hits, settings: ScanSettings, diagonal: float, rng: np.random.Generator
) -> npt.NDArray[np.bool_]:
    """Patches that return nothing, and dark surfaces that return little."""
    out = np.zeros(len(hits.points), bool)
    if not len(out):
        return out
    for center in hits.points[rng.integers(len(out), size=settings.holes)]:
        radius = settings.hole_size * diagonal * rng.uniform(0.5, 1.5)
        ragged = radius * (1 + 0.25 * rng.standard_normal(len(out)))
        out |= np.linalg.norm(hits.points - center, axis=1) < ragged
    dark = hits.colors.max(1) < 45
    return out | (dark & (rng.random(len(out)) < 0.35))


def _misaligned(points: Array, middle: Array, amount: float, rng: np.random.Generator) -> Array:
    """The view's points, turned and shifted a little, as registration leaves them."""
    axis = rng.standard_normal(3) * amount
    shifted = points - middle
    return middle + shifted + np.cross(axis, shifted) + rng.standard_normal(3) * amount


def visible_elements(obj: ArticulatedObject, views: Sequence[View], *, side: int = 320) -> Hits:
    """The elements of an object that cameras at ``views`` see, without noise."""
    low, high = obj.bounds
    middle, diagonal = (low + high) / 2, float(np.linalg.norm(high - low))
    caster = Caster.of(obj)
    found = []
    for view in views:
        eye, rays = look_from(view, middle, diagonal, side)
        found.append(caster.cast(np.tile(eye, (len(rays), 1)), rays, colors=False))
    names = ("ray", "part", "face", "points", "normals", "distance", "colors")
    return Hits(*(np.concatenate([getattr(h, n) for h in found]) for n in names))


@dataclass(frozen=True)
class ReconstructionSettings:
    """Settings of a reconstruction. Lengths are in diagonals of the object.

    Attributes:
        views: pictures, spread over ``arc`` radians of azimuth around ``ahead``.
        points: how many remain in all, fewer where fewer are seen.
        drift: degrees between neighbouring views that registration leaves (standard deviation).
        depth_noise: standard deviation of single depths.
        low_frequency: standard deviation of depth errors that are smooth over a picture.
        flying: share of the points at depth edges that are drawn into the gap behind them.
        holes: patches a view where nothing returns.
        outliers: share of points in the air.
        support: whether the object stands on a table or floor.
        clutter: other things that stand on it.
        upright: whether the frame is the object's; else it has any rotation and scale.
        ahead: azimuth in radians from which a person looks at it; 0 is -y.
    """

    views: int = 14
    arc: float = 4.4
    points: int = 220_000
    drift: float = 0.25
    depth_noise: float = 0.0015
    low_frequency: float = 0.002
    flying: float = 0.25
    holes: int = 3
    outliers: float = 0.004
    support: bool = True
    clutter: int = 0
    upright: bool = False
    ahead: float = 0.0

    def __post_init__(self) -> None:
        if self.views < 1 or self.points < 1:
            raise ConfigurationError(
                f"a reconstruction needs a view and a point, got {self.views} and {self.points}"
            )


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """A simulated scan with its truth.

    Attributes:
        cloud: points and colours in the source's frame.
        part: (N,) int32 index of the part in the object's order; -1 beside the object.
        kind: (N,) int8, as :func:`model.geometry.cleaning.classify` gives.
        source_from_object: (4, 4) rotation, uniform scale and shift.
    """

    cloud: PointCloud
    part: npt.NDArray[np.int32]
    kind: npt.NDArray[np.int8]
    source_from_object: Array


def reconstruct_scan(
    obj: ArticulatedObject | SegmentedObject,
    settings: ReconstructionSettings,
    rng: np.random.Generator,
) -> Reconstruction:
    """Scan an object in its rest pose; every part needs a mesh."""
    meshes = [p.mesh for p in obj.parts if p.mesh is not None]
    low, high = obj.bounds
    diagonal = float(np.linalg.norm(high - low))
    kinds = [OBJECT] * len(meshes)
    if settings.support:
        meshes.append(_table(low, high, diagonal, rng))
        kinds.append(SUPPORT)
    for _ in range(settings.clutter):
        meshes.append(_neighbor(low, high, diagonal, rng))
        kinds.append(CLUTTER)
    caster = Caster(meshes)
    order = np.linspace(-0.5, 0.5, settings.views) * settings.arc
    order = order + rng.normal(0, 0.1, settings.views) + settings.ahead + rng.uniform(-0.6, 0.6)
    drift = np.cumsum(rng.normal(0, np.radians(settings.drift), (settings.views, 3)), axis=0)
    drift -= drift.mean(0)
    views = [
        View(float(a), float(rng.uniform(0.1, 0.75)), float(rng.uniform(1.3, 1.9)) * diagonal)
        for a in order
    ]
    each = [
        _seen(caster, view, turn, settings, (low + high) / 2, diagonal, rng)
        for view, turn in zip(views, drift, strict=True)
    ]
    points, colors = (np.concatenate([e[k] for e in each]) for k in range(2))
    mesh_index = np.concatenate([e[2] for e in each])
    if len(points) > settings.points:
        kept = np.sort(rng.choice(len(points), settings.points, replace=False))
        points, colors, mesh_index = points[kept], colors[kept], mesh_index[kept]
    kind = np.array(kinds, np.int8)[mesh_index]
    part = np.where(kind == OBJECT, mesh_index, -1).astype(np.int32)
    count = int(settings.outliers * len(points))
    spots = rng.uniform(low - 0.3 * diagonal, high + 0.3 * diagonal, (count, 3))
    points = np.concatenate([points, spots])
    colors = np.concatenate([colors, rng.integers(40, 220, (count, 3))])
    part = np.concatenate([part, np.full(count, -1, np.int32)])
    kind = np.concatenate([kind, np.full(count, OUTLIER, np.int8)])
    frame = np.eye(4) if settings.upright else _any_frame(rng)
    points = points @ frame[:3, :3].T + frame[:3, 3]
    cloud = PointCloud(points.astype(np.float32), None, np.clip(colors, 0, 255).astype(np.uint8))
    return Reconstruction(cloud, part, kind, frame)


def _seen(
    caster: Caster,
    view: View,
    drift: Array,
    settings: ReconstructionSettings,
    middle: Array,
    diagonal: float,
    rng: np.random.Generator,
) -> tuple[Array, Array, npt.NDArray[np.int64]]:
    """Points, colours and mesh seen by one view, in its drifting pose."""
    side = int(np.sqrt(3.0 * settings.points / settings.views)) + 8
    eye, rays = look_from(view, middle, diagonal, side)
    hits = caster.cast(np.tile(eye, (len(rays), 1)), rays)
    near = np.linalg.norm(hits.points - middle, axis=1) < 1.5 * diagonal
    light = daylight(caster, hits, samples=4, reach=0.12 * diagonal)
    slant = np.abs(np.einsum("ij,ij->i", hits.normals, rays[hits.ray]))
    depth, _ = flying_pixels(hits, hits.distance, side, settings.flying, diagonal, rng)
    smooth = np.asarray(zoom(rng.standard_normal((6, 6)), side / 6, order=3))[:side, :side]
    depth = depth + diagonal * settings.low_frequency * smooth.ravel()[hits.ray]
    depth += diagonal * settings.depth_noise * rng.standard_normal(len(depth)) / slant.clip(0.3, 1)
    kept = near & (rng.random(len(depth)) < (slant / 0.35).clip(0.02, 1))
    for center in hits.points[rng.integers(len(hits.points), size=settings.holes)]:
        ragged = (
            0.03 * diagonal * rng.uniform(0.5, 1.5) * (1 + 0.25 * rng.standard_normal(len(kept)))
        )
        kept &= np.linalg.norm(hits.points - center, axis=1) > diagonal * ragged
    kept &= (hits.colors.max(1) > 45) | (rng.random(len(kept)) < 0.6)  # dark returns little
    points = eye + depth[:, None] * rays[hits.ray] - middle
    points = points @ Rotation.from_rotvec(drift).as_matrix().T + middle
    exposure = rng.uniform(0.9, 1.1) * (1 + rng.normal(0, 0.02, 3))
    colors = hits.colors * light[:, None] * exposure + rng.normal(0, 6.0, points.shape)
    return points[kept], colors[kept], hits.part[kept].astype(np.int64)


def _table(low: Array, high: Array, diagonal: float, rng: np.random.Generator) -> Mesh:
    """A table top or floor below the object that reaches beyond it, at times far."""
    reach = diagonal * rng.uniform(0.15, 0.9, 4)
    thickness = 0.03 * diagonal
    corners = np.array(
        [
            [low[0] - reach[0], low[1] - reach[1], low[2] - thickness],
            [high[0] + reach[2], high[1] + reach[3], low[2]],
        ]
    )
    return _box(corners, rng)


def _neighbor(low: Array, high: Array, diagonal: float, rng: np.random.Generator) -> Mesh:
    """Something else that stands on the table, beside the object."""
    size = diagonal * rng.uniform(0.08, 0.3, 3)
    angle = rng.uniform(0, 2 * np.pi)
    away = (0.5 * np.linalg.norm((high - low)[:2]) + 0.6 * size[:2].max()) * rng.uniform(1.05, 1.3)
    middle = (low + high)[:2] / 2 + away * np.array([np.cos(angle), np.sin(angle)])
    corner = np.array([*(middle - size[:2] / 2), low[2]])
    return _box(np.array([corner, corner + size]), rng)


def _box(corners: Array, rng: np.random.Generator) -> Mesh:
    box = trimesh.creation.box(bounds=corners)
    r, g, b = rng.integers(60, 230, 3).tolist()
    material = Material("", (r, g, b, 255))
    return Mesh(np.asarray(box.vertices), np.asarray(box.faces), materials=(material,))


def _any_frame(rng: np.random.Generator) -> Array:
    frame = np.eye(4)
    scale = float(np.exp(rng.uniform(np.log(0.05), np.log(20))))
    frame[:3, :3] = scale * Rotation.from_quat(rng.standard_normal(4)).as_matrix()
    frame[:3, 3] = scale * rng.uniform(-3, 3, 3)
    return frame
