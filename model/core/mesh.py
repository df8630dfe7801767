"""The :class:`Mesh` value: triangles with materials, textures and vertex colours."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt
from PIL import Image

from model.core.arrays import frozen
from model.core.errors import GeometryError
from model.core.surface_maps import SurfaceMaps


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
