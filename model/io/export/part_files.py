"""The parts' geometry as files that every simulator reads: OBJ, MTL, textures.

Collision hulls and meshes are small OBJ files, the one mesh format that every target reads.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from model.core.articulated_object import ArticulatedObject, Part
from model.core.files import free_name
from model.core.geometry import Mesh
from model.core.progress import Progress, no_progress
from model.core.shapes import MOST_CORNERS, Hull, Primitive, Solid, hull_of_shape, simplified
from model.io.assets.reader import MESHES
from model.io.write import write_cloud, write_mesh
from model.physics.collision.build import Collision
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


FOLDER = f"{MESHES}/collision"


def write_collision(
    collision: Collision,
    parts: Sequence[Part],
    folder: Path,
    *,
    capsules: bool = False,
    concave: bool = True,
) -> dict[str, list[str | Primitive]]:
    """Write hulls into ``folder/meshes/collision``.

    Args:
        parts: of the object; files of shapes are called after theirs.
        capsules: whether the format has them; else they are written as hulls.
        concave: whether the format may have meshes as they are; else they are written as hulls.
            Hulls have at most :data:`MOST_CORNERS` vertices, as PhysX wants them.

    Returns:
        Link → file relative to ``folder``, in object-frame coordinates, or primitive.
    """
    out: dict[str, list[str | Primitive]] = {}
    stems = file_stems(list(dict.fromkeys([*(p.link for p in parts), *collision])))
    for link, shapes in collision.items():
        held = out.setdefault(link, [])
        for i, shape in enumerate(shapes):
            if isinstance(shape, Primitive) and (capsules or shape.kind != "capsule"):
                held.append(shape)
                continue
            name = f"{FOLDER}/{stems[link]}_{i}.obj"
            (folder / FOLDER).mkdir(parents=True, exist_ok=True)
            body = (
                shape
                if isinstance(shape, Solid) and concave
                else (simplified(hull_of_shape(shape), MOST_CORNERS))
            )
            (folder / name).write_text(obj_text(body))
            held.append(name)
    return out


def obj_text(hull: Hull | Solid) -> str:
    """A hull or mesh as OBJ with vertices and faces only."""
    lines = ["# ArtiWorld collision hull, metres, +z up"]
    lines += ["v {:.9g} {:.9g} {:.9g}".format(*row) for row in (hull.vertices + 0.0).tolist()]
    lines += ["f {} {} {}".format(*row) for row in (hull.faces + 1).tolist()]
    return "\n".join([*lines, ""])
