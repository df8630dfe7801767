"""Picking: the face or point under the cursor, in a box, in a lasso, or under a brush."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw

from model.core.asset import Asset
from model.core.errors import GeometryError
from model.geometry.cleaning import OutlierTest

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


Array = npt.NDArray[Any]
Bool = npt.NDArray[np.bool_]

_PASSED = 100
"""Most outliers that a ray passes."""

DEFAULT_PIXEL_ANGLE = 1.5e-3
"""Radians per pixel: 60 degrees over 700 pixels."""
TOLERANCE = 3
"""Largest distance in pixels from the ray that counts as a hit."""


@dataclass(frozen=True, eq=False)
class Pick:
    """The hit of a ray.

    Attributes:
        position: (3,) on the surface, metres, object frame.
        element: face or point.
        normal: (3,) unit, towards the ray's origin.
    """

    position: npt.NDArray[np.float64]
    element: int
    normal: npt.NDArray[np.float64]


class Camera:
    """A pinhole camera.

    Args:
        position: (3,) metres.
        world_from_camera: (3, 3) rotation or (4,) quaternion wxyz; camera axes are OpenCV's: x
            right, y down, z forward.
        fov: vertical field of view in radians.
        aspect: width over height.

    Raises:
        GeometryError: for an invalid rotation or field of view.
    """

    def __init__(
        self, position: npt.ArrayLike, world_from_camera: npt.ArrayLike, fov: float, aspect: float
    ) -> None:
        from scipy.spatial.transform import Rotation

        self.position = np.asarray(position, np.float64).reshape(3)
        rotation = np.asarray(world_from_camera, np.float64)
        if rotation.shape == (4,) and np.linalg.norm(rotation) > 0 and np.isfinite(rotation).all():
            rotation = Rotation.from_quat(rotation[[1, 2, 3, 0]]).as_matrix()
        if rotation.shape != (3, 3) or not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-4):
            raise GeometryError("the camera's orientation is no rotation")
        if not (0 < fov < np.pi and aspect > 0 and np.isfinite(self.position).all()):
            raise GeometryError(f"no camera has a field of view of {fov} and an aspect of {aspect}")
        self.world_from_camera = rotation
        self.fov, self.aspect = float(fov), float(aspect)

    def project(self, points: Array) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Return screen coordinates (N, 2), (0, 0) top left and (1, 1) bottom right, and depth."""
        local = (points - self.position) @ self.world_from_camera
        depth = local[:, 2]
        half = np.tan(self.fov / 2)
        safe = np.where(np.abs(depth) < 1e-12, 1e-12, depth)
        x = 0.5 + local[:, 0] / (safe * 2 * half * self.aspect)
        y = 0.5 + local[:, 1] / (safe * 2 * half)
        return np.stack([x, y], axis=1), depth

    def ray(self, screen: npt.ArrayLike) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Return origin and unit direction of the ray through a point on the screen."""
        return self.position, self.directions(np.asarray(screen, np.float64)[None])[0]

    def directions(self, screen: Array) -> npt.NDArray[np.float64]:
        """Return (N, 3) unit directions of the rays through (N, 2) points on the screen."""
        half = np.tan(self.fov / 2) * np.array([self.aspect, 1.0])
        local = np.concatenate([(2 * screen - 1) * half, np.ones((len(screen), 1))], axis=1)
        directions = local @ self.world_from_camera.T
        return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def rings_around(
    direction: npt.ArrayLike, pixel_angle: float = DEFAULT_PIXEL_ANGLE
) -> Iterator[npt.NDArray[np.float64]]:
    """Yield directions within the tolerance of a ray: a ring per pixel, the nearest first.

    Args:
        direction: (3,) of the ray, not zero.
        pixel_angle: radians of one pixel.

    Yields:
        (8 k, 3) directions for the k-th ring, as long as ``direction``.
    """
    d = np.asarray(direction, np.float64)
    length = float(np.linalg.norm(d))
    side = np.cross(d, np.eye(3)[np.abs(d).argmin()])
    side *= length / np.linalg.norm(side)
    up = np.cross(d, side) / length
    for pixels in range(1, TOLERANCE + 1):
        turn = np.arange(8 * pixels)[:, None] * (2 * np.pi / (8 * pixels))
        ring = d + np.tan(pixels * pixel_angle) * (np.cos(turn) * side + np.sin(turn) * up)
        yield ring * (length / np.linalg.norm(ring, axis=1, keepdims=True))


class Picker:
    """Picks elements of one asset, which it indexes once.

    Meshes use Embree, clouds a march along the ray through a KD-tree.
    """

    def __init__(self, asset: Asset) -> None:
        self._asset = asset
        self._centers: npt.NDArray[np.float32] | None = None
        low, high = asset.bounds
        self._low, self._high = low, high
        self._diagonal = max(float(np.linalg.norm(high - low)), 1e-9)
        if asset.mesh is not None:
            import open3d as o3d

            self._o3d = o3d
            self._scene = o3d.t.geometry.RaycastingScene()
            # Embree computes in float32: move the object to the origin.
            self._shift = (low + high) / 2
            vertices = (asset.mesh.vertices - self._shift).astype(np.float32)
            self._scene.add_triangles(
                o3d.core.Tensor.from_numpy(vertices),
                o3d.core.Tensor.from_numpy(np.ascontiguousarray(asset.mesh.faces, np.uint32)),
            )
            self._cast(np.zeros((1, 3)), np.ones((1, 3)))  # the first ray builds the index
        else:
            from scipy.spatial import KDTree

            assert asset.cloud is not None
            self._points = np.asarray(asset.cloud.points)
            self._tree = KDTree(self._points, balanced_tree=False, compact_nodes=True)
            self._spacing = self._measure_spacing()
            self._outliers = OutlierTest(self._points, self._tree)

    def _measure_spacing(self) -> float:
        """Median distance between neighbours, metres."""
        step = max(1, len(self._points) // 1000)
        k = min(2, len(self._points))
        distance = np.atleast_2d(self._tree.query(self._points[::step], k=k)[0])
        if k < 2:
            return 0.0
        apart = distance[:, 1][distance[:, 1] > 0]
        return float(np.median(apart)) if len(apart) else 0.0

    @property
    def centers(self) -> npt.NDArray[np.float32]:
        """(E, 3) centre of each element."""
        if self._centers is None:
            self._centers = self._asset.element_centers.astype(np.float32)
        return self._centers

    def pick(
        self,
        origin: npt.ArrayLike,
        direction: npt.ArrayLike,
        *,
        pixel_angle: float = DEFAULT_PIXEL_ANGLE,
        hidden: Bool | None = None,
    ) -> Pick | None:
        """Return the first element that a ray hits, or None.

        Args:
            origin: (3,) of the ray.
            direction: (3,) of any length.
            pixel_angle: radians of one pixel; elements count within a cone of three pixels.
            hidden: (E,) elements that are ignored.

        Raises:
            GeometryError: for an invalid ray.
        """
        o = np.asarray(origin, np.float64).reshape(-1)
        d = np.asarray(direction, np.float64).reshape(-1)
        length = np.linalg.norm(d) if d.shape == (3,) else 0.0
        if o.shape != (3,) or not np.isfinite(o).all() or not 0 < length < np.inf:
            raise GeometryError(f"ray from {o.tolist()} along {d.tolist()} is invalid")
        d = d / length
        if self._asset.mesh is not None:
            return self._pick_mesh(o, d, pixel_angle, hidden)
        return self._pick_cloud(o, d, TOLERANCE * pixel_angle, hidden)

    # Meshes

    def _cast(
        self, origins: Array, directions: Array, hidden: Bool | None = None
    ) -> tuple[Array, Array]:
        """Distance (infinite without a hit) and face."""
        rays = np.concatenate([origins - self._shift, directions], axis=1).astype(np.float32)
        found = self._scene.cast_rays(self._o3d.core.Tensor.from_numpy(rays))
        distance, face = found["t_hit"].numpy(), found["primitive_ids"].numpy().astype(np.int64)
        if hidden is not None:
            again = np.flatnonzero(np.isfinite(distance))
            again = again[hidden[face[again]]]
            distance[again], face[again] = self._cast_behind(rays[again], hidden)
        return distance, face

    def _cast_behind(self, rays: Array, hidden: Bool) -> tuple[Array, Array]:
        """As :meth:`_cast`, for (R, 6) rays whose first face is hidden."""
        distance, face = np.full(len(rays), np.inf, np.float32), np.full(len(rays), -1, np.int64)
        if not len(rays):
            return distance, face
        hits = self._scene.list_intersections(self._o3d.core.Tensor.from_numpy(rays))
        at, ray, element = (hits[name].numpy() for name in ("t_hit", "ray_ids", "primitive_ids"))
        shown = ~hidden[element.astype(np.int64)]
        at, ray, element = at[shown], ray[shown].astype(np.int64), element[shown]
        order = np.lexsort((at, ray))
        first, where = np.unique(ray[order], return_index=True)
        distance[first], face[first] = at[order][where], element[order][where]
        return distance, face

    def _pick_mesh(self, o: Array, d: Array, angle: float, hidden: Bool | None) -> Pick | None:
        mesh = self._asset.mesh
        assert mesh is not None
        # Start near the object: a far camera costs precision.
        ahead = max(0.0, float((self._shift - o) @ d) - self._diagonal)
        for ring in chain((d[None],), rings_around(d, angle)):
            starts = o + ring * ahead
            distance, face = self._cast(starts, ring, hidden)
            best = int(distance.argmin())
            if np.isfinite(distance[best]):
                start, d, element, far = starts[best], ring[best], int(face[best]), distance[best]
                break
        else:
            return None
        a, b, c = mesh.vertices[mesh.faces[element]]
        normal = np.cross(b - a, c - a)
        size = np.linalg.norm(normal)
        normal = normal / size if size > 0 else -d
        position = start + d * float(far)
        across = float(normal @ d)
        if abs(across) > 1e-3:  # exactly onto the face's plane
            position = position + d * float(normal @ (a - position)) / across
        return Pick(position, element, -normal if across > 0 else normal)

    # Clouds

    def _pick_cloud(self, o: Array, d: Array, angle: float, hidden: Bool | None) -> Pick | None:
        margin = self._radius(np.array([np.linalg.norm((self._low + self._high) / 2 - o)]), angle)
        span = _clip(o, d, self._low - margin, self._high + margin)
        if span is None:
            return None
        near, far = span
        widest = float(self._radius(np.array([far]), angle)[0])
        step = max(self._diagonal / 128, 6 * self._spacing, widest, (far - near) / 512)
        middle = near + step * (np.arange(int(np.ceil((far - near) / step)) + 1) + 0.5)
        ball = np.hypot(step / 2, self._radius(middle + step / 2, angle))
        centers = o + middle[:, None] * d
        nearest = self._tree.query(centers, distance_upper_bound=float(ball.max()))[0]
        passed: list[int] = []
        for i in np.flatnonzero(nearest <= ball):
            found = np.asarray(self._tree.query_ball_point(centers[i], ball[i]), np.int64)
            if hidden is not None:
                found = found[~hidden[found]]
            while (element := self._front(o, d, found, angle)) is not None:
                # An outlier is picked only where nothing is behind it.
                if len(passed) == _PASSED or not self._outliers.is_outlier(element):
                    return self._point_pick(element, d)
                passed.append(element)
                found = found[found != element]
        return self._point_pick(passed[0], d) if passed else None

    def _radius(self, depth: Array, angle: float) -> Array:
        """The cone's radius: a few pixels, but at least four median distances between neighbours.

        Such a disc has 11 random points of a surface on average: it misses the surface about once
        in 60,000 times.
        """
        return np.maximum(depth * angle, 4.0 * self._spacing)

    def _front(self, o: Array, d: Array, found: Array, angle: float) -> int | None:
        """The point nearest to the ray among the front ones in the cone."""
        away = self._points[found] - o
        depth = away @ d
        across = np.linalg.norm(away - depth[:, None] * d, axis=1)
        radius = self._radius(depth, angle)
        inside = (depth > 0) & (across <= radius)
        if not inside.any():
            return None
        found, depth, across, radius = (v[inside] for v in (found, depth, across, radius))
        front = depth <= depth.min() + 2 * radius
        cost = across + 0.5 * (depth - depth.min())
        return int(found[np.flatnonzero(front)[np.argmin(cost[front])]])

    def _point_pick(self, element: int, d: Array) -> Pick:
        cloud = self._asset.cloud
        assert cloud is not None
        position = self._points[element].astype(np.float64)
        if cloud.normals is not None:
            normal = cloud.normals[element].astype(np.float64)
        else:
            k = min(16, len(self._points))
            around = self._points[np.atleast_1d(self._tree.query(position, k=k)[1])]
            normal = np.linalg.svd(around - around.mean(0), full_matrices=False)[2][-1]
            normal = normal.astype(np.float64)
        size = np.linalg.norm(normal)
        normal = normal / size if size > 0 else -d
        return Pick(position, element, -normal if normal @ d > 0 else normal)

    # Many at once

    def select_box(
        self,
        camera: Camera,
        lower_left: npt.ArrayLike,
        upper_right: npt.ArrayLike,
        *,
        visible_only: bool = True,
        hidden: Bool | None = None,
    ) -> npt.NDArray[np.int64]:
        """Select elements whose centre is inside a rectangle on the screen.

        Args:
            lower_left, upper_right: two opposite corners in any order, (0, 0) the screen's top
                left and (1, 1) its bottom right.
            visible_only: whether to leave out occluded elements.
            hidden: (E,) elements that are ignored.

        Returns:
            (K,) elements, ascending.
        """
        corners = np.stack([np.asarray(lower_left, float), np.asarray(upper_right, float)])
        low, high = corners.min(axis=0), corners.max(axis=0)
        screen, depth = camera.project(self.centers)
        inside = ((screen >= low) & (screen <= high)).all(axis=1)
        return self._selected(camera, screen, depth, inside, visible_only, hidden)

    def select_stroke(
        self,
        camera: Camera,
        stroke: Stroke,
        *,
        visible_only: bool = True,
        hidden: Bool | None = None,
    ) -> npt.NDArray[np.int64]:
        """Select (K,) elements whose centre a stroke covers, ascending; as :meth:`select_box`.

        A brush also selects the faces that it passes over, however far their centre is.
        """
        raster = stroke.raster(camera.aspect)
        screen, depth = camera.project(self.centers)
        inside = covered(raster, screen)
        found = self._selected(camera, screen, depth, inside, visible_only, hidden)
        if stroke.kind == "brush" and self._asset.mesh is not None:
            found = np.union1d(found, self._faces_under(camera, raster, hidden))
        return found

    def _selected(
        self,
        camera: Camera,
        screen: Array,
        depth: Array,
        inside: Array,
        visible_only: bool,
        hidden: Bool | None,
    ) -> npt.NDArray[np.int64]:
        inside = inside & (depth > 1e-6)
        found = np.flatnonzero(inside if hidden is None else inside & ~hidden)
        if not visible_only or not len(found):
            return found
        if self._asset.mesh is not None:
            return found[self._visible_faces(camera, found, hidden)]
        return found[self._visible_points(camera, screen[found], depth[found])]

    def _faces_under(
        self, camera: Camera, raster: Bool, hidden: Bool | None
    ) -> npt.NDArray[np.int64]:
        """Faces behind a grid of covered pixels."""
        step = max(1, round(np.sqrt(raster.sum() / 2000)))
        y, x = np.nonzero(raster[::step, ::step])
        if not len(x):
            return np.zeros(0, np.int64)
        at = (np.stack([x, y], axis=1) + 0.5) * step / np.array(raster.shape[::-1])
        directions = camera.directions(at)
        origins = np.broadcast_to(camera.position, directions.shape)
        hit, face = self._cast(origins, directions, hidden)
        return np.unique(face[np.isfinite(hit)])

    def _visible_faces(self, camera: Camera, found: Array, hidden: Bool | None) -> Array:
        toward = self.centers[found] - camera.position
        distance = np.linalg.norm(toward, axis=1)
        origins = np.broadcast_to(camera.position, toward.shape)
        hit, face = self._cast(origins, toward / distance[:, None], hidden)
        slack = 1e-4 * self._diagonal
        return (face == found) | (hit >= distance - slack)

    def _visible_points(self, camera: Camera, screen: Array, depth: Array) -> Array:
        """The front points of each small square of the screen, by a z-buffer."""
        from scipy.ndimage import minimum_filter

        view = np.tan(camera.fov / 2) * np.array([camera.aspect, 1.0]) * 2
        pixel = max(2.5 * self._spacing / float(np.median(depth)), 1e-3)
        index = np.floor(screen * view / pixel).astype(np.int64)
        index -= index.min(axis=0)
        shape = index.max(axis=0) + 1
        if float(shape[0]) * float(shape[1]) > 5e7:
            return np.ones(len(depth), bool)
        front = np.full(int(shape[0] * shape[1]), np.inf)
        key = index[:, 0] * shape[1] + index[:, 1]
        np.minimum.at(front, key, depth)
        # A square may miss the front surface by chance, nine squares don't.
        front = minimum_filter(front.reshape(shape), size=3, mode="nearest").reshape(-1)
        # A slanted surface spans some depth within one square.
        return depth <= front[key] + 3 * np.maximum(pixel * depth, self._spacing)


def _clip(o: Array, d: Array, low: Array, high: Array) -> tuple[float, float] | None:
    """(near, far) metres along a ray inside a box, or None."""
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (low - o) / d, (high - o) / d
    a, b = np.minimum(a, b), np.maximum(a, b)
    flat = np.abs(d) < 1e-300
    if (flat & ((o < low) | (o > high))).any():
        return None
    near = max(0.0, float(np.where(flat, -np.inf, a).max()))
    far = float(np.where(flat, np.inf, b).min())
    return (near, far) if near <= far else None
