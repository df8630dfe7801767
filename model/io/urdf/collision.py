"""The collision shapes that a URDF declares, loaded on demand.

They aren't needed to show or move an object, so a mistake in them is a remark, not an error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np

from model.core.errors import ArtiworldError
from model.core.mesh import Mesh
from model.core.shapes import Kind, Primitive, Shape, Solid, hull_of
from model.geometry.topology import connected_shells
from model.io.geometry_files import read_geometry_file
from model.io.urdf.meshes import moved_mesh
from model.io.urdf.visual import UrdfVisual

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
    read: dict[Path, Mesh] = {}
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


def _shapes(piece: UrdfVisual, read: dict[Path, Mesh]) -> list[Shape]:
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
        if piece.file not in read:
            read[piece.file] = _mesh(piece.file)
        mesh = read[piece.file]
    mesh = moved_mesh(mesh, piece.object_from_geometry)
    bodies = _convex_bodies(mesh)
    if bodies:
        return list(bodies)
    found = _solid(mesh)
    if hull_of(found.vertices) is None:
        name = "of it" if piece.file is None else repr(piece.file.name)
        raise ArtiworldError(f"the collision mesh {name} has no volume")
    return [found]


def _mesh(file: Path) -> Mesh:
    if not file.is_file():
        raise ArtiworldError(f"the collision mesh {file.name!r} isn't there")
    asset = read_geometry_file(file, up_axis="z")
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
