"""The parts' geometry as files that every simulator reads: OBJ, MTL, textures."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from model.core.articulated_object import ArticulatedObject
from model.core.files import free_name
from model.core.mesh import Mesh
from model.core.progress import Progress, no_progress
from model.io.assets.reader import MESHES
from model.io.write.meshes import write_cloud, write_mesh
from model.physics.part_mesh import part_mesh


@dataclass(frozen=True)
class PartFile:
    """Files written for a part; paths are relative to the asset's folder.

    Attributes:
        flat: whether MuJoCo would refuse the mesh: it needs four corners and some volume.
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
        base = re.sub(r"[^A-Za-z0-9_-]+", "_", link).strip("_") or "part"
        free = free_name(base.lower(), taken)
        taken.add(free)
        out[link] = base + free[len(base) :]
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
    """Features of the files of :func:`write_parts` that other programs don't read, in words."""
    shaded = any(m.maps.occlusion is not None for p in obj.parts for m in part_mesh(p).materials)
    if not shaded:
        return ()
    return ("occlusion maps: an MTL has no word for them; map_ao is read by ArtiWorld alone",)


def is_flat(mesh: Mesh) -> bool:
    """True if MuJoCo would refuse the mesh: it needs four corners and some volume."""
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
