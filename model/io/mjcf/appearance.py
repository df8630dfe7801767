"""Materials of MuJoCo's geoms, and triangles of those without a mesh file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.mesh import Material, Mesh
from model.core.surface_maps import ImageFile, SurfaceMaps, open_image_file
from model.core.textures import TextureError, open_texture
from model.io.formats.srgb import to_linear

UNSAID = (0.5, 0.5, 0.5, 1.0)
"""RGBA that MuJoCo gives to geoms of which nothing is said."""
_RGB, _OCCLUSION, _NORMAL, _EMISSIVE, _RGBA = 1, 2, 5, 7, 8  # mjtTextureRole


class Looks:
    """Materials of a compiled model, made once each.

    Args:
        model: MuJoCo's.
        textures: texture name → its image.
        notes: gets a remark on each image that can't be loaded.
    """

    def __init__(self, model: Any, textures: dict[str, Path], notes: list[str]) -> None:
        self.model, self.textures, self.notes = model, textures, notes
        self.made: dict[int, Material] = {}
        self.used: list[Path] = []

    def of(self, geom: int) -> Material | None:
        """The material of a geom; None if it has none."""
        model, look = self.model, int(self.model.geom_matid[geom])
        if look < 0:
            rgba = model.geom_rgba[geom]
            return None if np.allclose(rgba, UNSAID) else Material("mjcf", _bytes(rgba))
        if look not in self.made:
            self.made[look] = self._material(look)
        return self.made[look]

    def _material(self, look: int) -> Material:
        model = self.model
        rgba = np.asarray(model.mat_rgba[look], np.float64)
        metallic, roughness = (  # -1 is MuJoCo's "unspecified"
            None if value < 0 else min(float(value), 1.0)
            for value in (model.mat_metallic[look], model.mat_roughness[look])
        )
        texture = None
        file = self._file(look, _RGB) or self._file(look, _RGBA)
        if file is not None:
            try:
                texture = open_texture(file)
                self.used.append(file)
            except TextureError as error:
                self.notes.append(str(error))
        emissive = self._image(look, _EMISSIVE)
        light = to_linear(np.clip(rgba[:3], 0, 1)) * max(float(model.mat_emission[look]), 0.0)
        r, g, b = (1.0, 1.0, 1.0) if emissive is not None else light.tolist()
        maps = SurfaceMaps(
            normal=self._image(look, _NORMAL), emission=(r, g, b), emissive=emissive,
            occlusion=self._image(look, _OCCLUSION),
        )  # fmt: skip
        name = model.mat(look).name or "mjcf"
        return Material(name, _bytes(rgba), texture, metallic, roughness, maps)

    def _file(self, look: int, role: int) -> Path | None:
        number = int(self.model.mat_texid[look][role])
        return self.textures.get(self.model.tex(number).name) if number >= 0 else None

    def _image(self, look: int, role: int) -> ImageFile | None:
        file = self._file(look, role)
        if file is None:
            return None
        try:
            image = open_image_file(file)
        except TextureError as error:
            self.notes.append(str(error))
            return None
        self.used.append(file)
        return image


def _bytes(rgba: npt.ArrayLike) -> tuple[int, int, int, int]:
    r, g, b, a = np.clip(np.round(255 * np.asarray(rgba, np.float64)), 0, 255).astype(int).tolist()
    return r, g, b, a


def with_material(mesh: Mesh, material: Material) -> Mesh:
    """``mesh`` with ``material`` all over; without texture coordinates in the mean colour of the
    material's texture."""
    if mesh.uv is None and material.pictured:
        color = np.asarray(material.base_color, np.float64)
        if material.texture is not None:
            small = material.texture.convert("RGB").resize((1, 1), resample=4)  # a box: the mean
            color[:3] *= np.asarray(small, np.float64).reshape(3) / 255
        material = replace(material, base_color=_bytes(color / 255), texture=None,
                           maps=SurfaceMaps(emission=material.maps.emission))  # fmt: skip
    return replace(
        mesh, materials=(material,), face_material=np.zeros(len(mesh.faces), np.int32),
        vertex_colors=None,
    )  # fmt: skip


def compiled_mesh(model: Any, mesh: int) -> Mesh:
    """A mesh asset as MuJoCo compiled it, in the frame of its geoms."""
    v, f, t = (int(a[mesh]) for a in (model.mesh_vertadr, model.mesh_faceadr,
                                      model.mesh_texcoordadr))  # fmt: skip
    count = int(model.mesh_facenum[mesh])
    vertices = model.mesh_vert[v : v + model.mesh_vertnum[mesh]].astype(np.float64)
    faces = model.mesh_face[f : f + count].astype(np.int32)
    if t < 0:
        return Mesh(vertices, faces)
    corners = model.mesh_facetexcoord[f : f + count].ravel()
    uv = model.mesh_texcoord[t : t + model.mesh_texcoordnum[mesh]][corners]
    apart = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    return Mesh(vertices[faces.ravel()], apart, uv=uv * (1, -1) + (0, 1))


def ellipsoid(radii: npt.ArrayLike) -> Mesh:
    """About its own centre; (3,) radii in metres."""
    from trimesh import creation

    made = creation.icosphere(subdivisions=3)
    return Mesh(np.asarray(made.vertices) * np.asarray(radii), np.asarray(made.faces))
