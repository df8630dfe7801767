"""The parts' geometry as files that every simulator reads: OBJ, MTL, textures."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from weakref import WeakKeyDictionary

import numpy as np

from model.core.articulated_object import ArticulatedObject, Part
from model.core.errors import GeometryError
from model.core.mesh import Mesh
from model.core.point_cloud import PointCloud
from model.core.progress import Progress, no_progress
from model.io.assets.reader import MESHES


@dataclass(frozen=True)
class PartFile:
    """What was written of a part; paths are relative to the asset's folder.

    Attributes:
        flat: whether MuJoCo would refuse the mesh: it wants four corners and some volume.
    """

    link: str
    name: str | None
    mesh: str
    cloud: str | None
    faces: int
    points: int
    area: float
    flat: bool


def file_stems(links: Sequence[str]) -> dict[str, str]:
    """Link → a file name without suffix that every file system takes; ``link_0`` stays."""
    out: dict[str, str] = {}
    taken: set[str] = set()
    for link in links:
        base = stem = re.sub(r"[^A-Za-z0-9_-]+", "_", link).strip("_") or "part"
        i = 2
        while stem.lower() in taken:
            stem, i = f"{base}_{i}", i + 1
        taken.add(stem.lower())
        out[link] = stem
    return out


def write_parts(
    obj: ArticulatedObject, folder: Path, *, clouds: bool = True, progress: Progress = no_progress
) -> tuple[PartFile, ...]:
    """Write every part into ``folder/meshes``, which is created.

    Args:
        clouds: write the clouds of scanned parts beside their meshes.

    Raises:
        GeometryError: for a part without geometry.
    """
    from model.io.write.meshes import write_cloud, write_mesh

    (folder / MESHES).mkdir(exist_ok=True)
    stems = file_stems([p.link for p in obj.parts])
    out: list[PartFile] = []
    for i, part in enumerate(obj.parts):
        progress(i / len(obj.parts), f"writing {part.link}")
        stem = f"{MESHES}/{stems[part.link]}"
        shape = part_mesh(part)
        write_mesh(shape, folder / f"{stem}.obj")
        cloud = part.cloud if clouds and part.cloud is not None and len(part.cloud) else None
        if cloud is not None:
            write_cloud(cloud, folder / f"{stem}.ply")
        out.append(
            PartFile(
                part.link,
                part.name,
                f"{stem}.obj",
                None if cloud is None else f"{stem}.ply",
                len(shape.faces),
                0 if cloud is None else len(cloud),
                float(shape.face_areas.sum()),
                is_flat(shape),
            )
        )
    progress(1.0, "written")
    return tuple(out)


def losses_of(obj: ArticulatedObject) -> tuple[str, ...]:
    """What other programs won't read of the files of :func:`write_parts`, in words."""
    shaded = any(m.maps.occlusion is not None for p in obj.parts for m in part_mesh(p).materials)
    if not shaded:
        return ()
    return ("occlusion maps: an MTL has no word for them; map_ao is read by ArtiWorld alone",)


_OF_CLOUDS: WeakKeyDictionary[PointCloud, Mesh] = WeakKeyDictionary()


def part_mesh(part: Part, store: Path | None = None) -> Mesh:
    """The part's mesh, or a surface through its cloud, which is made once.

    Args:
        store: folder where such surfaces are kept between runs and for other processes.

    Raises:
        GeometryError: where it has neither a face nor a point.
    """
    if part.mesh is not None and len(part.mesh.faces):
        return part.mesh
    if part.cloud is not None and len(part.cloud):
        if part.cloud not in _OF_CLOUDS:
            _OF_CLOUDS[part.cloud] = _surface_of_cloud(part.cloud, store)
        return _OF_CLOUDS[part.cloud]
    raise GeometryError(f"part {part.link!r} has no face and no point; give it some or remove it")


def _surface_of_cloud(cloud: PointCloud, store: Path | None) -> Mesh:
    """A mesh for the simulator; a box for points that span no surface."""
    with contextlib.suppress(GeometryError):
        mesh = _reconstructed(cloud, store)
        if len(mesh.faces):
            return mesh
    import trimesh

    low, high = cloud.bounds
    size = np.maximum(high - low, max(0.01 * float((high - low).max()), 1e-3))
    box = trimesh.creation.box(extents=size)
    box.apply_translation((low + high) / 2)
    colors = None
    if cloud.colors is not None:
        mean = np.rint(cloud.colors.mean(axis=0))
        colors = np.tile(np.array([*mean, 255], np.uint8), (len(box.vertices), 1))
    return Mesh(np.asarray(box.vertices), np.asarray(box.faces), vertex_colors=colors)


def _reconstructed(cloud: PointCloud, store: Path | None) -> Mesh:
    from model.geometry.reconstruct import mesh_from_cloud
    from model.physics.surface_cache import load_surface, save_surface

    if store is None:
        return mesh_from_cloud(cloud)
    mesh = load_surface(store, cloud)
    if mesh is None:
        mesh = mesh_from_cloud(cloud)
        save_surface(store, cloud, mesh)
    return mesh


def is_flat(mesh: Mesh) -> bool:
    """Whether MuJoCo would refuse the mesh: it wants four corners and some volume."""
    corners = np.unique(mesh.vertices[np.unique(mesh.faces)], axis=0)
    if len(corners) < 4:
        return True
    area = float(mesh.face_areas.sum())
    if area <= 0:
        return True
    middle = (mesh.triangles.mean(axis=1) * mesh.face_areas[:, None]).sum(axis=0) / area
    away = mesh.triangles[:, 0] - middle
    volume = float(np.abs(np.einsum("fi,fi->f", away, mesh.face_cross)).sum()) / 6
    return volume < 1e-7 * area * float(np.ptp(corners, axis=0).max())
