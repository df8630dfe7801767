"""Ambient occlusion in vertex colors, and crease edges: so that parts show without a texture."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from model.core.geometry import Material, Mesh
from model.geometry.sampling import corner_normals
from model.geometry.topology import weld

Array = npt.NDArray[np.float64]

CREASE = np.radians(30.0)
"""Angle between two faces from which their edge is a line."""
_FACES = 20_000
"""Faces that a mesh is refined to at most: a browser draws them smoothly in software."""
_FINEST = 0.025
"""Share of the diagonal: edges aren't split any shorter."""
_REACH = 0.12
"""Share of the diagonal: what is farther away takes no light."""
_STRENGTH, _DARKEST = 0.9, 0.3
"""Share of the occlusion, and the least share of its color that a surface keeps."""
_RAYS = 32
"""Rays a side and vertex; evenly spread, so that more hardly change a picture."""
_INSET, _LIFTED = 0.03, 5e-4
"""Rays begin that share of the way from a corner to its faces' middles, lifted by that share of
the diagonal."""
_CHUNK = 400_000
"""Rays cast at once, for memory."""
_NOISE = 0.35
"""Share of creases among a mesh's edges from which it is the noise of a scan, not a shape."""
_LINES = 30_000


@dataclass(frozen=True, eq=False)
class CreaseEdges:
    """Edges to draw as lines.

    Attributes:
        points: (N, 2, 3) float32 ends in metres, a little before the surface.
        face: (N,) int32 a face beside each edge.
    """

    points: npt.NDArray[np.float32]
    face: npt.NDArray[np.int32]


def is_plain(mesh: Mesh) -> bool:
    """True if a mesh has neither images nor vertex colors that show its shape."""
    colors = mesh.vertex_colors
    one_color = colors is None or not len(colors) or bool((colors == colors[0]).all())
    return one_color and not any(m.pictured for m in mesh.materials)


def with_ambient_occlusion(mesh: Mesh) -> tuple[Mesh, npt.NDArray[np.int32]]:
    """Refine a plain mesh, and darken its vertices where their surroundings take the light.

    Each side of a surface is looked at, and the freer one counts: faces may point inwards.

    Returns:
        The mesh with vertex colors, and (T,) the face of ``mesh`` that each of its faces is in.
    """
    vertices, faces, face = _refined(mesh)
    fine = replace(
        mesh,
        vertices=vertices,
        faces=faces,
        face_material=mesh.face_material[face],
        uv=None,
        vertex_colors=None,
    )
    group, normals = corner_normals(fine)
    look = fine.face_material.astype(np.int64)[:, None].repeat(3, axis=1)
    key = (faces.astype(np.int64) * len(normals) + group) * len(mesh.materials) + look
    unique, index = np.unique(key.reshape(-1), return_inverse=True)
    material, rest = unique % len(mesh.materials), unique // len(mesh.materials)
    vertex, normal = rest // len(normals), normals[rest % len(normals)].astype(np.float64)
    middle = np.repeat(fine.triangles.mean(axis=1), 3, axis=0)
    count = np.bincount(index, minlength=len(unique))[:, None]
    inward = np.stack([np.bincount(index, middle[:, k], len(unique)) for k in range(3)], axis=1)
    start = vertices[vertex] + _INSET * (inward / count - vertices[vertex])
    light = 1.0 - _STRENGTH * _occlusion(mesh, start, normal)
    own = np.array([m.base_color for m in mesh.materials], np.float64)[material]
    if mesh.vertex_colors is not None and len(mesh.vertex_colors):
        own = own * mesh.vertex_colors[0] / 255.0
    own[:, :3] *= np.clip(light, _DARKEST, 1.0)[:, None]
    white = tuple(replace(m, base_color=(255, 255, 255, m.base_color[3])) for m in mesh.materials)
    own[:, 3] = 255
    shaded = Mesh(
        vertices=vertices[vertex],
        faces=index.reshape(-1, 3).astype(np.int32),
        face_material=fine.face_material,
        materials=white or (Material(),),
        vertex_colors=np.rint(own).astype(np.uint8),
    )
    return shaded, face


def crease_edges(mesh: Mesh) -> CreaseEdges:
    """Edges between faces that meet at more than ``CREASE``, and those of only one face; none of a
    mesh that is rough all over. The longest come first where there are too many."""
    ids = weld(mesh)
    directed = ids[mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)]
    at = mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    owner = np.repeat(np.arange(len(mesh.faces)), 3)
    kept = directed[:, 0] != directed[:, 1]
    directed, at, owner = directed[kept], at[kept], owner[kept]
    order = np.lexsort(np.sort(directed, axis=1).T)
    directed, at, owner = directed[order], at[order], owner[order]
    low_high = np.sort(directed, axis=1)
    first = np.flatnonzero(np.any(np.diff(low_high, axis=0, prepend=-1) != 0, axis=1))
    count = np.diff(np.append(first, len(low_high)))
    pair = first[count == 2]
    a, b = owner[pair], owner[pair + 1]
    cosine = np.einsum("ij,ij->i", mesh.face_normals[a], mesh.face_normals[b])
    cosine[directed[pair, 0] == directed[pair + 1, 0]] *= -1  # wound the other way
    sharp = cosine < np.cos(CREASE)
    if len(pair) > _LINES and sharp.mean() > _NOISE:
        return CreaseEdges(np.zeros((0, 2, 3), np.float32), np.zeros(0, np.int32))
    rows = np.concatenate([pair[sharp], first[count == 1]])
    outward = mesh.face_normals[owner[rows]].copy()
    outward[: sharp.sum()] += mesh.face_normals[b[sharp]]
    size = np.linalg.norm(outward, axis=1, keepdims=True)
    outward = np.divide(outward, size, out=np.zeros_like(outward), where=size > 1e-9)
    ends = mesh.vertices[at[rows]].astype(np.float64)
    longest = np.argsort(-np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1), kind="stable")[:_LINES]
    lifted = ends + _LIFTED * _diagonal(mesh) * outward[:, None]
    return CreaseEdges(lifted[longest].astype(np.float32), owner[rows][longest].astype(np.int32))


def _diagonal(mesh: Mesh) -> float:
    return float(np.linalg.norm(np.ptp(np.asarray(mesh.vertices, np.float64), axis=0)))


def _refined(mesh: Mesh) -> tuple[Array, npt.NDArray[np.int32], npt.NDArray[np.int32]]:
    """Vertices and faces with no long edge, each face's longest one halved as often as needed, and
    the face that each came from."""
    vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces)
    origin = np.arange(len(faces), dtype=np.int32)
    area = float(mesh.face_areas.sum())
    longest = max(_FINEST * _diagonal(mesh), float(np.sqrt(4.0 * area / _FACES)))
    while len(faces) < _FACES:
        corner = vertices[faces]
        length = np.linalg.norm(corner - np.roll(corner, -1, axis=1), axis=2)
        side = length.argmax(axis=1)
        split = np.flatnonzero(length.max(axis=1) > longest)
        if not len(split):
            break
        split = split[np.argsort(-length[split].max(axis=1), kind="stable")][: _FACES - len(faces)]
        rows, side = faces[split], side[split]
        turn = (side[:, None] + np.arange(3)) % 3
        p, q, apex = np.take_along_axis(rows, turn, axis=1).T
        ends = np.sort(np.stack([p, q], axis=1), axis=1)
        pairs, number = np.unique(ends, axis=0, return_inverse=True)
        middle = (len(vertices) + number.reshape(-1)).astype(faces.dtype)
        vertices = np.concatenate([vertices, vertices[pairs].mean(axis=1)])
        faces = faces.copy()
        faces[split] = np.stack([p, middle, apex], axis=1)
        faces = np.concatenate([faces, np.stack([middle, q, apex], axis=1)])
        origin = np.concatenate([origin, origin[split]])
    return vertices, faces.astype(np.int32), origin


def _occlusion(mesh: Mesh, points: Array, normals: Array) -> Array:
    """(K,) share of the light from above each (K, 3) point that near surfaces take, 0 to 1; of the
    freer side."""
    import open3d as o3d

    tensor = o3d.core.Tensor.from_numpy
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)  # others need the cores, too
    scene.add_triangles(
        tensor(np.ascontiguousarray(mesh.vertices, np.float32)),
        tensor(np.ascontiguousarray(mesh.faces, np.uint32)),
    )
    diagonal = _diagonal(mesh)
    sides = []
    for sign in (1.0, -1.0):
        up = sign * normals
        start = points + _LIFTED * diagonal * up
        taken = np.zeros(len(points))
        step = max(1, _CHUNK // _RAYS)
        for begin in range(0, len(points), step):
            rows = slice(begin, begin + step)
            rays = _rays_from(start[rows], up[rows])
            far = scene.cast_rays(tensor(rays), nthreads=1)["t_hit"].numpy()
            near = np.clip(1.0 - far / (_REACH * diagonal), 0.0, 1.0)
            taken[rows] = near.reshape(-1, _RAYS).mean(axis=1)
        sides.append(taken)
    return np.minimum(*sides)


def _rays_from(points: Array, up: Array) -> npt.NDArray[np.float32]:
    """(K * _RAYS, 6) origins and unit directions, spread by the cosine about ``up`` on the spiral
    of a sunflower (Vogel, 1979)."""
    turn = np.arange(_RAYS) * np.pi * (3.0 - np.sqrt(5.0))
    radius = np.sqrt((np.arange(_RAYS) + 0.5) / _RAYS)
    disk = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1 - radius**2)], axis=1)
    helper = np.eye(3)[np.abs(up).argmin(axis=1)]
    x = np.cross(helper, up)
    x /= np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-12)
    frame = np.stack([x, np.cross(up, x), up], axis=1)  # rows
    directions = np.einsum("rk,pkd->prd", disk, frame)
    origins = np.broadcast_to(points[:, None], directions.shape)
    return np.concatenate([origins, directions], axis=2).reshape(-1, 6).astype(np.float32)
