"""Jobs that light plain meshes for the browser; see :mod:`model.geometry.ambient_light`."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt

from app.server.tasks import asset_of
from model.core.files import draft_of
from model.core.geometry import Mesh
from model.geometry.ambient_light import CreaseEdges, crease_edges, is_plain, with_ambient_occlusion
from model.geometry.display import display_asset
from model.io.write import face_order, mesh_to_glb

_FILE = "light-1.npz"
"""In the folder of the asset's arrays; another number where the light is computed otherwise."""


@dataclass(frozen=True, eq=False)
class LitMesh:
    """A displayed mesh without a texture, lit.

    Attributes:
        glb: with the light in its vertex colors.
        glb_order: (T,) displayed face that each of its triangles lies in.
        edges: lines; their faces are displayed ones.
    """

    glb: bytes
    glb_order: npt.NDArray[np.int32]
    edges: CreaseEdges


def lit_mesh(folder: Path) -> LitMesh | None:
    """The displayed mesh of an asset with its light, from the cache where it was computed before;
    None where a cloud, a texture or vertex colors are displayed."""
    mesh = display_asset(asset_of(folder)).mesh
    if mesh is None or not len(mesh.faces) or not is_plain(mesh):
        return None
    found = _stored(folder, mesh)
    if found is None:
        _store(folder, mesh)
        found = _stored(folder, mesh)
    if found is None:
        return None
    shaded, face = found
    order = face[face_order(shaded, matt=True)]
    return LitMesh(mesh_to_glb(shaded, matt=True), order, crease_edges(mesh))


def lit_parts(folder: Path, mesh: Mesh, labels: npt.NDArray[np.integer]) -> dict[int, Mesh] | None:
    """The lit mesh of each part by the (D,) labels of the displayed faces; None without light."""
    found = _stored(folder, mesh)
    if found is None:
        return None
    shaded, face = found
    of_triangle = labels[face]
    return {int(p): shaded.take_faces(of_triangle == p) for p in np.unique(of_triangle)}


def _store(folder: Path, mesh: Mesh) -> None:
    shaded, face = with_ambient_occlusion(mesh)
    assert shaded.vertex_colors is not None
    with draft_of(folder / _FILE) as draft:
        np.savez(
            draft, vertices=shaded.vertices, faces=shaded.faces, material=shaded.face_material,
            colors=shaded.vertex_colors, face=face, count=len(mesh.faces),
        )  # fmt: skip


def _stored(folder: Path, mesh: Mesh) -> tuple[Mesh, npt.NDArray[np.int32]] | None:
    """The refined mesh and the displayed face of each of its faces; None where there is none."""
    with suppress(FileNotFoundError, KeyError, ValueError, BadZipFile):
        with np.load(folder / _FILE) as kept:
            arrays = {name: kept[name] for name in kept.files}
        if int(arrays["count"]) != len(mesh.faces):
            return None
        white = tuple(
            replace(m, base_color=(255, 255, 255, m.base_color[3])) for m in mesh.materials
        )
        shaded = Mesh(
            vertices=arrays["vertices"],
            faces=arrays["faces"],
            face_material=arrays["material"],
            materials=white,
            vertex_colors=arrays["colors"],
        )
        return shaded, arrays["face"]
    return None
