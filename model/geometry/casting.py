"""Ray casting against an object's meshes, and simple pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from PIL import Image

from model.core.articulated_object import ArticulatedObject, SegmentedObject
from model.core.geometry import Mesh
from model.geometry.sampling import colors_at

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Hits:
    """Hits of rays, in the order of the rays that hit.

    Attributes:
        ray: (H,) index of the ray.
        part: (H,) index of the part in the object's order; face: (H,) its face.
        points: (H, 3) metres; normals: (H, 3) towards the ray's origin; distance: (H,) metres.
        colors: (H, 3) uint8 of the surface, unlit.
    """

    ray: npt.NDArray[np.int64]
    part: npt.NDArray[np.int32]
    face: npt.NDArray[np.int64]
    points: Array
    normals: Array
    distance: Array
    colors: npt.NDArray[np.uint8]


class Caster:
    """A ray-casting scene of meshes.

    Args:
        meshes: one per part.
        see_through: whether rays pass glass (alpha below 128).
    """

    def __init__(self, meshes: Sequence[Mesh], *, see_through: bool = False) -> None:
        import open3d as o3d

        self._tensor = o3d.core.Tensor.from_numpy
        self._meshes: list[Mesh] = []
        self._faces: list[npt.NDArray[np.int64]] = []
        self._scene = o3d.t.geometry.RaycastingScene()
        for mesh in meshes:
            opaque = np.array([m.base_color[3] >= 128 for m in mesh.materials])
            kept = np.flatnonzero(opaque[mesh.face_material] | (not see_through))
            self._meshes.append(mesh)
            self._faces.append(kept)
            self._scene.add_triangles(
                self._tensor(np.ascontiguousarray(mesh.vertices, np.float32)),
                self._tensor(np.ascontiguousarray(mesh.faces[kept], np.uint32)),
            )

    @classmethod
    def of(cls, obj: ArticulatedObject | SegmentedObject, *, see_through: bool = False) -> Caster:
        """Make a scene of an object's parts, which need meshes."""
        meshes = [p.mesh for p in obj.parts if p.mesh is not None]
        assert len(meshes) == len(obj.parts), f"{obj.name} has parts without a mesh"
        return cls(meshes, see_through=see_through)

    def cast(self, origins: Array, directions: Array, *, colors: bool = True) -> Hits:
        """Cast (R, 3) rays with unit ``directions`` to their first hits."""
        rays = self._tensor(np.concatenate([origins, directions], 1).astype(np.float32))
        found = self._scene.cast_rays(rays)
        distance = found["t_hit"].numpy().astype(np.float64)
        ray = np.flatnonzero(np.isfinite(distance))
        part = found["geometry_ids"].numpy()[ray].astype(np.int32)
        local = found["primitive_ids"].numpy()[ray].astype(np.int64)
        uv = found["primitive_uvs"].numpy()[ray].astype(np.float64)
        normals = found["primitive_normals"].numpy()[ray].astype(np.float64)
        toward = np.einsum("ij,ij->i", normals, directions[ray])
        normals[toward > 0] *= -1
        face, rgb = np.zeros(len(ray), np.int64), np.full((len(ray), 3), 200, np.uint8)
        weights = np.column_stack([1 - uv.sum(1), uv])
        for k, mesh in enumerate(self._meshes):
            rows = np.flatnonzero(part == k)
            face[rows] = self._faces[k][local[rows]]
            if colors and len(rows):
                rgb[rows] = colors_at(mesh, face[rows], weights[rows])[:, :3]
        points = origins[ray] + distance[ray, None] * directions[ray]
        return Hits(ray, part, face, points, normals, distance[ray], rgb)

    def occluded(self, origins: Array, directions: Array) -> npt.NDArray[np.bool_]:
        """(R,) whether rays hit anything."""
        rays = self._tensor(np.concatenate([origins, directions], 1).astype(np.float32))
        return self._scene.test_occlusions(rays).numpy()


def look_at(eye: Array, target: Array) -> Array:
    """Return (3, 3): right, down and forward of a camera at ``eye`` that looks at ``target``."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def camera_rays(eye: Array, target: Array, width: int, height: int, fov: float) -> Array:
    """Return (height * width, 3) unit rays of a pinhole camera; ``fov`` is vertical, radians."""
    right, down, forward = look_at(eye, target)
    step = 2 * np.tan(fov / 2) / height
    x = (np.arange(width) + 0.5 - width / 2) * step
    y = (np.arange(height) + 0.5 - height / 2) * step
    d = forward + x[None, :, None] * right + y[:, None, None] * down
    return (d / np.linalg.norm(d, axis=2, keepdims=True)).reshape(-1, 3)


def daylight(caster: Caster, hits: Hits, *, samples: int = 12, reach: float = 0.35) -> Array:
    """Return (H,) brightness under a soft sky and a lamp above the viewer's left shoulder."""
    lamp = np.array([-0.45, -0.75, 0.85])
    lamp /= np.linalg.norm(lamp)
    start = hits.points + 1e-4 * hits.normals + 1e-4 * lamp
    lit = np.clip(hits.normals @ lamp, 0, 1)
    facing = np.flatnonzero(lit > 0)
    lit[facing[caster.occluded(start[facing], np.tile(lamp, (len(facing), 1)))]] *= 0.15
    directions = np.random.default_rng(7).standard_normal((samples, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    open_ = np.zeros(len(hits.points))
    for d in directions:
        side = hits.normals @ d
        outward = np.where((side < 0)[:, None], -d, d)
        found = caster.cast(hits.points + 2e-4 * hits.normals, outward, colors=False)
        near = np.ones(len(open_))
        near[found.ray] = np.clip(found.distance / reach, 0, 1)
        open_ += near
    sky = 0.75 + 0.25 * hits.normals[:, 2]
    return 0.62 * sky * open_ / samples + 0.5 * lit


def render(
    obj: ArticulatedObject,
    size: tuple[int, int] = (480, 480),
    *,
    azimuth: float = -0.6,
    elevation: float = 0.35,
    labels: bool = False,
) -> Image.Image:
    """Render an object that fills the frame.

    Args:
        azimuth, elevation: of the camera, radians; azimuth 0 looks at the front.
        labels: whether parts have flat colours instead of their own.
    """
    low, high = obj.bounds
    target, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    fov = 0.45
    away = np.array(
        [
            np.sin(azimuth) * np.cos(elevation),
            -np.cos(azimuth) * np.cos(elevation),
            np.sin(elevation),
        ]
    )
    eye = target + away * radius * 1.04 / np.sin(fov / 2)
    scale = 2
    width, height = size[0] * scale, size[1] * scale
    caster = Caster.of(obj)
    directions = camera_rays(eye, target, width, height, fov)
    hits = caster.cast(np.tile(eye, (len(directions), 1)), directions)
    colors = part_colors(len(obj.parts))[hits.part] if labels else hits.colors
    light = daylight(caster, hits, reach=0.25 * radius)
    pixels = np.full((len(directions), 3), 246.0)
    pixels[hits.ray] = np.clip(colors * light[:, None] * 1.05, 0, 255)
    image = Image.fromarray(pixels.reshape(height, width, 3).astype(np.uint8))
    return image.resize(size, Image.Resampling.LANCZOS)


def part_colors(count: int) -> npt.NDArray[np.uint8]:
    """Return (count, 3) easily distinguished colours; the first is grey."""
    hue = (np.arange(count) * 0.618034) % 1.0
    wheel = np.abs((hue[:, None] * 6 + np.array([0.0, 4.0, 2.0])) % 6 - 3) - 1
    out = (70 + 170 * np.clip(wheel, 0, 1)).astype(np.uint8)
    out[:1] = 185
    return out
