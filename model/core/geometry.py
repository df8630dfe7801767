"""Meshes and point clouds as values, and the affine matrices that move them.

A :class:`Mesh` is triangles with materials, textures and vertex colours. Rotations are also read
and written as URDF and SDF have them: roll, pitch, yaw, radians.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image
from scipy.spatial.transform import Rotation

from model.core.errors import GeometryError
from model.core.textures import SurfaceMaps

FloatArray = npt.NDArray[np.floating[Any]]
IntArray = npt.NDArray[np.integer[Any]]


def frozen(array: npt.ArrayLike, dtype: npt.DTypeLike, columns: int | None, what: str) -> Any:
    """A read-only array of ``dtype``; (N,) where ``columns`` is None, else (N, columns).

    Copies only where the input is not already read-only of that type.

    Raises:
        GeometryError: on a wrong shape, NaN or infinity.
    """
    out = np.asarray(array, dtype=dtype)
    if columns is None:
        if out.ndim != 1:
            raise GeometryError(f"{what} must have shape (N,), got {out.shape}")
    elif out.ndim != 2 or out.shape[1] != columns:
        raise GeometryError(f"{what} must have shape (N, {columns}), got {out.shape}")
    if np.issubdtype(out.dtype, np.floating) and not np.isfinite(out).all():
        bad = int((~np.isfinite(out)).reshape(len(out), -1).any(axis=1).sum())
        raise GeometryError(f"{what}: {bad} of {len(out)} rows are NaN or infinite")
    if out.flags.writeable:
        out = np.ascontiguousarray(out) if out.base is not None or not out.flags.owndata else out
        if out is array:
            out = out.copy()
        out.flags.writeable = False
    return out


def affine(
    linear: npt.ArrayLike | None = None, shift: npt.ArrayLike | None = None
) -> npt.NDArray[np.float64]:
    """(4, 4) of a (3, 3) linear map and a (3,) shift; the identity's where one is None."""
    out = np.eye(4)
    if linear is not None:
        out[:3, :3] = linear
    if shift is not None:
        out[:3, 3] = shift
    return out


def axis_scales(linear: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
    """(3,) scales above 0 along the axes in a (3, 3) map that then turns; to 12 digits, so that
    they come back as somebody asked for them, on every processor."""
    return np.array([float(f"{v:.12g}") for v in np.linalg.norm(linear, axis=0)])


def uniform_scale(linear: npt.NDArray[np.floating]) -> float:
    """The scale above 0 of a (3, 3) rotation and uniform scale, as :func:`axis_scales`."""
    return float(np.median(axis_scales(linear)))


def quaternion_wxyz(pose: npt.NDArray[np.float64]) -> tuple[float, float, float, float]:
    """Unit quaternion of a (3, 3) rotation or (4, 4) rigid pose; its first number but 0 is > 0."""
    x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
    exact = np.round([w, x, y, z], 12)
    w, x, y, z = (exact * np.sign(exact[exact != 0][0]) + 0.0).tolist()
    return w, x, y, z


def about(axis: int, angle: float) -> npt.NDArray[np.float64]:
    """(3, 3) turn about an axis, 0 to 2 for x to z, by radians."""
    c, s = math.cos(angle), math.sin(angle)
    out = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    out[i, i], out[i, j], out[j, i], out[j, j] = c, -s, s, c
    return out


def x_onto(axis: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """(3, 3) rotation that turns x onto a unit axis."""
    helper = np.eye(3)[np.abs(axis).argmin()]
    side = np.asarray(np.cross(axis, helper), np.float64)
    side /= np.linalg.norm(side)
    return np.stack([axis, side, np.cross(axis, side)], axis=1)


def rotation_from_rpy(rpy: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """(3, 3) from URDF's roll, pitch, yaw: fixed axes x, then y, then z, radians."""
    roll, pitch, yaw = (float(v) for v in np.asarray(rpy))
    return about(2, yaw) @ about(1, pitch) @ about(0, roll)


def rpy_from_rotation(rotation: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """(3,) roll, pitch, yaw of (3, 3); the inverse of :func:`rotation_from_rpy`."""
    r = np.where(np.abs(rotation) < 1e-15, 0.0, rotation)  # a residue's sign would turn pi round
    flat = float(np.hypot(r[0, 0], r[1, 0]))
    pitch = np.arctan2(-r[2, 0], flat)
    if flat < 1e-9:  # roll and yaw turn about the same line
        return np.array([np.arctan2(-r[1, 2], r[1, 1]), pitch, 0.0])
    return np.array([np.arctan2(r[2, 1], r[2, 2]), pitch, np.arctan2(r[1, 0], r[0, 0])])


@dataclass(frozen=True, eq=False)
class Material:
    """Surface appearance of some faces.

    Attributes:
        name: as in the source file.
        base_color: RGBA in 0..255, multiplied with the texture where there is one.
        texture: RGB(A) image, or None.
        metallic: 0 (none) to 1 (bare metal), or None where the source doesn't say.
        roughness: 0 (mirror) to 1 (matt), or None where the source doesn't say.
        maps: normal, emissive and occlusion maps.
    """

    name: str = "material"
    base_color: tuple[int, int, int, int] = (200, 200, 200, 255)
    texture: Image.Image | None = None
    metallic: float | None = None
    roughness: float | None = None
    maps: SurfaceMaps = field(default_factory=SurfaceMaps)

    @property
    def pictured(self) -> bool:
        """True if it has an image, which needs texture coordinates."""
        return self.texture is not None or bool(self.maps.images)


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh, metres, object frame, +z up. Arrays are read-only.

    Vertices may be duplicated along texture seams and between the pieces of the source file;
    ``model.geometry.topology`` welds them where neighbourhood matters.

    Attributes:
        vertices: (V, 3) float64.
        faces: (F, 3) int32 indices into ``vertices``.
        face_material: (F,) int32 indices into ``materials``.
        materials: at least one.
        uv: (V, 2) float32 texture coordinates (OpenGL, v up), or None.
        vertex_colors: (V, 4) uint8 RGBA, or None. Where present they replace the base colour.
    """

    vertices: npt.NDArray[np.float64]
    faces: npt.NDArray[np.int32]
    face_material: npt.NDArray[np.int32] = field(default_factory=lambda: np.zeros(0, np.int32))
    materials: tuple[Material, ...] = (Material(),)
    uv: npt.NDArray[np.float32] | None = None
    vertex_colors: npt.NDArray[np.uint8] | None = None

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        set_(self, "vertices", frozen(self.vertices, np.float64, 3, "vertices"))
        set_(self, "faces", frozen(self.faces, np.int32, 3, "faces"))
        material = self.face_material
        if len(material) == 0 and len(self.faces):
            material = np.zeros(len(self.faces), np.int32)
        set_(self, "face_material", frozen(material, np.int32, None, "face_material"))
        if self.uv is not None:
            set_(self, "uv", frozen(self.uv, np.float32, 2, "uv"))
        if self.vertex_colors is not None:
            set_(self, "vertex_colors", frozen(self.vertex_colors, np.uint8, 4, "vertex_colors"))
        self._check()

    def _check(self) -> None:
        if len(self.faces):
            low, high = int(self.faces.min()), int(self.faces.max())
            if low < 0 or high >= len(self.vertices):
                raise GeometryError(
                    f"faces index vertices {low}..{high}, but there are "
                    f"{len(self.vertices)} vertices"
                )
        if len(self.face_material) != len(self.faces):
            raise GeometryError("face_material must have one entry a face")
        if len(self.faces) and (
            self.face_material.min() < 0 or self.face_material.max() >= len(self.materials)
        ):
            raise GeometryError("face_material indexes a material that isn't there")
        for name in ("uv", "vertex_colors"):
            value = getattr(self, name)
            if value is not None and len(value) != len(self.vertices):
                raise GeometryError(f"{name} must have one row a vertex")

    @property
    def triangles(self) -> npt.NDArray[np.float64]:
        """(F, 3, 3) corner positions."""
        return self.vertices[self.faces]

    @cached_property
    def face_cross(self) -> npt.NDArray[np.float64]:
        """(F, 3) cross product of two edges: twice the area times the unit normal."""
        t = self.triangles
        return np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])

    @cached_property
    def face_areas(self) -> npt.NDArray[np.float64]:
        """(F,) areas in m²."""
        return 0.5 * np.linalg.norm(self.face_cross, axis=1)

    @cached_property
    def face_normals(self) -> npt.NDArray[np.float64]:
        """(F, 3) unit normals; zero where the face has no area."""
        length = np.linalg.norm(self.face_cross, axis=1, keepdims=True)
        return np.divide(
            self.face_cross, length, out=np.zeros_like(self.face_cross), where=length > 0
        )

    @property
    def bounds(self) -> npt.NDArray[np.float64]:
        """(2, 3) lowest and highest corner of the vertices that faces use."""
        if not len(self.faces):
            raise GeometryError("a mesh without faces has no bounds")
        used = self.vertices[np.unique(self.faces)]
        return np.stack([used.min(0), used.max(0)])

    def moved(self, matrix: npt.NDArray[np.float64]) -> Mesh:
        """The mesh under an affine (4, 4); a mirroring turns the faces over, so that they keep
        facing outwards."""
        linear = matrix[:3, :3]
        faces = self.faces[:, ::-1] if np.linalg.det(linear) < 0 else self.faces
        return replace(self, vertices=self.vertices @ linear.T + matrix[:3, 3], faces=faces)

    def take_faces(self, index: npt.NDArray[np.integer] | npt.NDArray[np.bool_]) -> Mesh:
        """The faces at ``index`` with the vertices and materials that they use."""
        faces = self.faces[index]
        used, inverse = np.unique(faces, return_inverse=True)
        kept, material = np.unique(self.face_material[index], return_inverse=True)
        return Mesh(
            self.vertices[used],
            inverse.reshape(-1, 3).astype(np.int32),
            material.astype(np.int32).reshape(-1),
            tuple(self.materials[i] for i in kept) or self.materials[:1],
            None if self.uv is None else self.uv[used],
            None if self.vertex_colors is None else self.vertex_colors[used],
        )


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Points of an object, metres, object frame, +z up. Arrays are read-only.

    Attributes:
        points: (N, 3) float32.
        normals: (N, 3) float32 unit vectors, or None.
        colors: (N, 3) uint8 RGB, or None.
        confidence: (N,) float32 as the source gives it, such as a splat's opacity, or None.
    """

    points: npt.NDArray[np.float32]
    normals: npt.NDArray[np.float32] | None = None
    colors: npt.NDArray[np.uint8] | None = None
    confidence: npt.NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        set_(self, "points", frozen(self.points, np.float32, 3, "points"))
        if self.normals is not None:
            set_(self, "normals", frozen(self.normals, np.float32, 3, "normals"))
        if self.colors is not None:
            set_(self, "colors", frozen(self.colors, np.uint8, 3, "colors"))
        if self.confidence is not None:
            set_(self, "confidence", frozen(self.confidence, np.float32, None, "confidence"))
        for name in ("normals", "colors", "confidence"):
            value = getattr(self, name)
            if value is not None and len(value) != len(self.points):
                raise GeometryError(
                    f"{name} has {len(value)} rows for {len(self.points)} points; they must agree"
                )

    def __len__(self) -> int:
        return len(self.points)

    def take(self, index: npt.NDArray[np.integer] | npt.NDArray[np.bool_]) -> PointCloud:
        """The points at ``index`` (integers or a mask), in that order."""
        return PointCloud(
            self.points[index],
            None if self.normals is None else self.normals[index],
            None if self.colors is None else self.colors[index],
            None if self.confidence is None else self.confidence[index],
        )

    @property
    def bounds(self) -> npt.NDArray[np.float64]:
        """(2, 3) lowest and highest corner."""
        if not len(self.points):
            raise GeometryError("a cloud without points has no bounds")
        return np.stack([self.points.min(0), self.points.max(0)]).astype(np.float64)

    def moved(self, matrix: npt.NDArray[np.float64]) -> PointCloud:
        """The cloud under an affine (4, 4) that has an inverse."""
        points, normals = self.points @ matrix[:3, :3].T + matrix[:3, 3], self.normals
        if normals is not None:
            normals = normals @ np.linalg.inv(matrix[:3, :3])
            length = np.linalg.norm(normals, axis=1, keepdims=True)
            normals = (normals / np.where(length > 0, length, 1.0)).astype(np.float32)
        return replace(self, points=points.astype(np.float32), normals=normals)


def merged(meshes: Sequence[Mesh]) -> Mesh:
    """One mesh of several, in order, with all their materials."""
    if len(meshes) == 1:
        return meshes[0]
    counts = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    materials = np.cumsum([0, *(len(m.materials) for m in meshes)])
    uv = colors = None
    if any(m.uv is not None for m in meshes):
        uv = np.concatenate(
            [m.uv if m.uv is not None else np.zeros((len(m.vertices), 2)) for m in meshes]
        ).astype(np.float32)
    if any(m.vertex_colors is not None for m in meshes):
        colors = np.concatenate([_colors(m) for m in meshes])
    return Mesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.faces + c for m, c in zip(meshes, counts, strict=False)]),
        np.concatenate([m.face_material + c for m, c in zip(meshes, materials, strict=False)]),
        tuple(material for m in meshes for material in m.materials),
        uv,
        colors,
    )


def _colors(mesh: Mesh) -> npt.NDArray[np.uint8]:
    """Vertex colours that leave the mesh looking as it does without them."""
    if mesh.vertex_colors is not None:
        return mesh.vertex_colors
    out = np.full((len(mesh.vertices), 4), 255, np.uint8)
    base = np.array([m.base_color for m in mesh.materials], np.uint8)
    out[mesh.faces] = base[mesh.face_material][:, None]
    return out


def merged_clouds(clouds: Sequence[PointCloud]) -> PointCloud:
    """One cloud of several, in order; normals and colours where all of them have some."""

    def joined(values: list[npt.NDArray | None]) -> npt.NDArray | None:
        there = [v for v in values if v is not None]
        return np.concatenate(there) if len(there) == len(values) else None

    return PointCloud(
        np.concatenate([c.points for c in clouds]),
        joined([c.normals for c in clouds]),
        joined([c.colors for c in clouds]),
    )
