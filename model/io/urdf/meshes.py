"""Loading the geometry that a URDF's links refer to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import Part
from model.core.errors import InputFileError
from model.core.mesh import Material, Mesh
from model.core.point_cloud import PointCloud
from model.io.formats.mtl import MaterialFiles, OneMaterial
from model.io.geometry_files import read_geometry_file
from model.io.mjcf.appearance import with_material
from model.io.urdf.visual import UrdfVisual

SECTIONS = 32
"""Sides of a cylinder."""


def load_part(
    link: str, visuals: Sequence[UrdfVisual], files: MaterialFiles | None = None
) -> Part:  # fmt: skip
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
            meshes.append(moved_mesh(mesh, visual.object_from_geometry))
        if cloud is not None:
            clouds.append(_moved_cloud(cloud, visual.object_from_geometry))
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
    asset = read_geometry_file(visual.file, up_axis="z", files=within)
    remarks += (f"{visual.file.name}: {w}" for w in asset.warnings)
    mesh = asset.mesh
    if mesh is not None and visual.material is not None:
        mesh = _with_material(mesh, visual)
    elif mesh is not None and visual.color is not None and _plain(mesh):
        mesh = replace(mesh, materials=(Material("urdf", visual.color),) * len(mesh.materials))
    return mesh, None if mesh is not None else asset.cloud


def _with_material(mesh: Mesh, visual: UrdfVisual) -> Mesh:
    return mesh if visual.material is None else with_material(mesh, visual.material)


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


def moved_mesh(mesh: Mesh, target_from_mesh: npt.NDArray[np.float64]) -> Mesh:
    """``mesh`` under an affine (4, 4); a mirroring turns the faces over, so that they keep facing
    outwards."""
    linear = target_from_mesh[:3, :3]
    vertices = mesh.vertices @ linear.T + target_from_mesh[:3, 3]
    faces = mesh.faces[:, ::-1] if np.linalg.det(linear) < 0 else mesh.faces
    return replace(mesh, vertices=vertices, faces=faces)


def _moved_cloud(cloud: PointCloud, target_from_cloud: npt.NDArray[np.float64]) -> PointCloud:
    linear = target_from_cloud[:3, :3]
    points = cloud.points @ linear.T + target_from_cloud[:3, 3]
    normals = cloud.normals
    if normals is not None:
        normals = normals @ np.linalg.inv(linear)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = (normals / np.where(length > 0, length, 1.0)).astype(np.float32)
    return PointCloud(points.astype(np.float32), normals, cloud.colors)


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
