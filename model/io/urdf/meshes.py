"""Loading the geometry that the links of a URDF or MJCF declare: visuals and collision shapes.

Collision shapes are loaded on demand. They aren't needed to show or move an object, so a mistake in
them is a remark, not an error. Materials of MuJoCo's geoms are here too, and triangles of those
without a mesh file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import Part
from model.core.errors import ArtiworldError, InputFileError
from model.core.geometry import Material, Mesh, PointCloud, merged, merged_clouds
from model.core.shapes import Kind, Primitive, Shape, Solid, hull_of
from model.core.textures import (
    ImageFile,
    SurfaceMaps,
    TextureError,
    open_image_file,
    open_texture,
    to_linear,
)
from model.geometry.topology import connected_shells
from model.io.formats.loaded import unpictured
from model.io.formats.mtl import MaterialFiles, OneMaterial
from model.io.geometry_files import Piece, read_geometry_file

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

    def repeat(self, geom: int) -> tuple[float, float]:
        """Repetitions of a geom's textures along u and v."""
        look = int(self.model.geom_matid[geom])
        u, v = (1.0, 1.0) if look < 0 else self.model.mat_texrepeat[look].tolist()
        return u, v

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
            normal=self._image(look, _NORMAL),
            emission=(r, g, b),
            emissive=emissive,
            occlusion=self._image(look, _OCCLUSION),
        )
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
        material = unpictured(material)
    return replace(
        mesh,
        materials=(material,),
        face_material=np.zeros(len(mesh.faces), np.int32),
        vertex_colors=None,
    )


def compiled_mesh(model: Any, mesh: int) -> Mesh:
    """A mesh asset as MuJoCo compiled it, in the frame of its geoms."""
    v, f, t = (
        int(a[mesh]) for a in (model.mesh_vertadr, model.mesh_faceadr, model.mesh_texcoordadr)
    )
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


@dataclass(frozen=True, eq=False)
class UrdfVisual:
    """One piece of a link's geometry.

    Attributes:
        link: the link that carries it.
        name: the element's ``name``, or None.
        object_from_geometry: (4, 4) from the file's coordinates to the object frame at rest,
            scale included.
        file: the mesh file, resolved; None for a primitive, and for ``mesh``.
        primitive: ``("box", (x, y, z))``, ``("cylinder", (radius, length))``, ``("sphere",
            (radius,))`` or ``("capsule", (radius, length without the caps))`` in metres; None for
            a file.
        color: RGBA in 0..255 from the URDF's material, or None. It is for what has no looks.
        mesh: geometry that no file holds, or None.
        material: takes the place of what a mesh file says of its looks, or None.
        repeat: how often its textures repeat along u and v.
        piece: the only one of the file's named pieces that counts, and whether its box' centre is
            its origin; None for the whole file.
    """

    link: str
    name: str | None
    object_from_geometry: npt.NDArray[np.float64]
    file: Path | None = None
    primitive: tuple[str, tuple[float, ...]] | None = None
    color: tuple[int, int, int, int] | None = None
    mesh: Mesh | None = None
    material: Material | None = None
    repeat: tuple[float, float] = (1.0, 1.0)
    piece: Piece | None = None


SECTIONS = 32
"""Sides of a cylinder."""


def load_part(link: str, visuals: Sequence[UrdfVisual], files: MaterialFiles | None = None) -> Part:
    """All the geometry of a link in one part, object frame.

    Args:
        files: of the URDF's folder; textures of the meshes in it may lie beside their folder.

    Raises:
        InputFileError: for a file that is missing or can't be read.
    """
    meshes: list[Mesh] = []
    clouds: list[PointCloud] = []
    remarks: list[str] = []
    for visual in visuals:
        mesh, cloud = _load(visual, remarks, files)
        if mesh is not None:
            meshes.append(mesh.moved(visual.object_from_geometry))
        if cloud is not None:
            clouds.append(cloud.moved(visual.object_from_geometry))
    names = {v.name for v in visuals}
    name = names.pop() if len(names) == 1 else None
    return Part(
        link,
        merged(meshes) if meshes else None,
        merged_clouds(clouds) if clouds else None,
        name,
        tuple(dict.fromkeys(remarks)),
    )


def _load(
    visual: UrdfVisual, remarks: list[str], files: MaterialFiles | None
) -> tuple[Mesh | None, PointCloud | None]:
    """Load the geometry; its warnings are added to ``remarks``."""
    if visual.mesh is not None:
        return _with_material(visual.mesh, visual), None
    if visual.file is None:
        assert visual.primitive is not None
        return _with_material(_primitive(*visual.primitive, visual.color), visual), None
    if not visual.file.is_file():
        raise InputFileError(
            visual.file, f"the mesh of link {visual.link!r} isn't there", "put it beside the URDF"
        )
    # A URDF takes mesh files as they are: the format's usual up axis doesn't count.
    inside = files is not None and visual.file.resolve().is_relative_to(files.root.resolve())
    within = files if inside else None
    if visual.material is not None:
        within = OneMaterial(visual.file.parent, visual.material)
    asset = read_geometry_file(visual.file, up_axis="z", files=within, piece=visual.piece)
    remarks += (f"{visual.file.name}: {w}" for w in asset.warnings)
    mesh = asset.mesh
    if mesh is not None and visual.material is not None:
        mesh = _with_material(mesh, visual)
    elif mesh is not None and visual.color is not None and _plain(mesh):
        mesh = replace(mesh, materials=(Material("urdf", visual.color),) * len(mesh.materials))
    return mesh, None if mesh is not None else asset.cloud


def _with_material(mesh: Mesh, visual: UrdfVisual) -> Mesh:
    if visual.material is None:
        return mesh
    made = with_material(mesh, visual.material)
    if made.uv is None or visual.repeat == (1.0, 1.0):
        return made
    # MuJoCo repeats an image from its top, which is v = 1 here.
    start = np.array([0.0, (1.0 - visual.repeat[1]) % 1.0])
    return replace(made, uv=(made.uv * visual.repeat + start).astype(np.float32))


def _plain(mesh: Mesh) -> bool:
    """True if its file declares no appearance: an STL, a PLY without colours, an OBJ without
    materials. Only such meshes get a URDF's colour."""
    unsaid = Material()
    return mesh.vertex_colors is None and all(
        m.texture is None
        and m.base_color == unsaid.base_color
        and m.metallic is None
        and m.maps == unsaid.maps
        for m in mesh.materials
    )


def _primitive(
    shape: str, sizes: tuple[float, ...], color: tuple[int, int, int, int] | None
) -> Mesh:
    from trimesh import creation

    if shape == "box":
        made = creation.box(extents=sizes)
    elif shape == "cylinder":
        made = creation.cylinder(radius=sizes[0], height=sizes[1], sections=SECTIONS)
    elif shape == "capsule":
        made = creation.capsule(radius=sizes[0], height=sizes[1])
        made.apply_translation((0, 0, -made.bounds.mean(axis=0)[2]))
    else:
        made = creation.icosphere(subdivisions=3, radius=sizes[0])
    material = Material("urdf", color) if color is not None else Material()
    return Mesh(np.asarray(made.vertices), np.asarray(made.faces), materials=(material,))


CONVEX = 0.98
"""Share of its hull's volume that a closed mesh fills which counts as convex."""
MOST_SHELLS = 256
"""More connected pieces in a mesh are no convex decomposition."""


@dataclass(frozen=True, eq=False)
class DeclaredCollision:
    """The ``<collision>`` elements of a link.

    Attributes:
        pieces: those that could be read, poses in the object frame.
        wrong: human-readable problem of one of the others; "" for none.
        repeated: whether they are the meshes of its visuals once more. That is what converters
            write who know no better: nobody has made shapes for collisions.
    """

    pieces: tuple[UrdfVisual, ...]
    wrong: str = ""
    repeated: bool = False


def repeats(pieces: Sequence[UrdfVisual], visuals: Sequence[UrdfVisual]) -> bool:
    """True if each of ``pieces`` is a mesh of ``visuals`` at the same place."""
    return all(
        (piece.file or piece.mesh) is not None
        and any(
            piece.file == v.file
            and piece.piece == v.piece
            and piece.mesh is v.mesh
            and np.allclose(piece.object_from_geometry, v.object_from_geometry)
            for v in visuals
        )
        for piece in pieces
    )


def declared_shapes(
    links: Sequence[str], declared: Mapping[str, DeclaredCollision], remarks: list[str]
) -> tuple[Shape, ...] | None:
    """Shapes of links that are fixed to each other, object frame; None where none are declared, or
    some can't be loaded, which is added to ``remarks``."""
    mine = [(link, declared[link]) for link in links if link in declared]
    if all(each.repeated for _, each in mine):
        return None
    out: list[Shape] = []
    read: dict[tuple[Path, Piece | None], Mesh] = {}
    for link, each in mine:
        wrong = each.wrong
        for piece in each.pieces if not wrong else ():
            try:
                out += _shapes(piece, read)
            except (ArtiworldError, OSError) as error:
                wrong = f"link {link!r}: {error}"
                break
        if wrong:
            remarks.append(f"{wrong}; the file's collision shapes of that part are not taken")
            return None
    return tuple(out)


def _shapes(piece: UrdfVisual, read: dict[tuple[Path, Piece | None], Mesh]) -> list[Shape]:
    """One piece; a mesh of several convex bodies is each of them.

    Raises:
        ArtiworldError: where its file is missing, can't be read, or has no volume.
    """
    if piece.primitive is not None:
        kind, sizes = piece.primitive
        return [Primitive(cast(Kind, kind), piece.object_from_geometry, sizes)]
    if piece.mesh is not None:
        mesh = piece.mesh
    else:
        assert piece.file is not None
        key = (piece.file, piece.piece)
        if key not in read:
            read[key] = _mesh(*key)
        mesh = read[key]
    mesh = mesh.moved(piece.object_from_geometry)
    bodies = _convex_bodies(mesh)
    if bodies:
        return list(bodies)
    found = _solid(mesh)
    if hull_of(found.vertices) is None:
        name = "of it" if piece.file is None else repr(piece.file.name)
        raise ArtiworldError(f"the collision mesh {name} has no volume")
    return [found]


def _mesh(file: Path, piece: Piece | None) -> Mesh:
    if not file.is_file():
        raise ArtiworldError(f"the collision mesh {file.name!r} isn't there")
    asset = read_geometry_file(file, up_axis="z", piece=piece)
    if asset.mesh is None:
        raise ArtiworldError(f"the collision mesh {file.name!r} has no faces")
    shift = np.zeros(3) if asset.source is None else np.asarray(asset.source.shift)
    return Mesh(asset.mesh.vertices + shift, asset.mesh.faces)


def _solid(mesh: Mesh) -> Solid:
    used, faces = np.unique(mesh.faces, return_inverse=True)
    vertices = np.asarray(mesh.vertices[used], np.float64)
    return Solid(vertices, faces.reshape(-1, 3).astype(np.int32))


def _convex_bodies(mesh: Mesh) -> list[Solid]:
    """The connected pieces of a mesh where there are several and all are convex: simulators that
    take the hull of a mesh would fill what lies between them."""
    shells = connected_shells(mesh)
    count = int(shells.max()) + 1 if len(shells) else 0
    if not 1 < count <= MOST_SHELLS:
        return []
    out: list[Solid] = []
    for i in range(count):
        body = _solid(Mesh(mesh.vertices, mesh.faces[shells == i]))
        hull = hull_of(body.vertices)
        a, b, c = (body.vertices[body.faces[:, k]] - body.vertices.mean(axis=0) for k in range(3))
        volume = abs(float((np.cross(a, b) * c).sum())) / 6
        if hull is None or volume < CONVEX * hull.volume:
            return []
        out.append(body)
    return out
