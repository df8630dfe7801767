"""Points on a mesh's surface, and their colours: textures, vertex colours, base colours."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from model.core.errors import GeometryError
from model.core.geometry import Mesh, PointCloud

Array = npt.NDArray[Any]


def colors_at(mesh: Mesh, face: Array, barycentric: Array) -> npt.NDArray[np.uint8]:
    """Return RGBA at points on faces.

    Args:
        face: (N,) face of each point.
        barycentric: (N, 3) weights of the face's corners.

    Returns:
        (N, 4) uint8 sRGB: the bilinear texture times the base colour, or the vertex colours, or
        the base colour.
    """
    corners = mesh.faces[face]
    if mesh.vertex_colors is not None:
        blended = np.einsum("nk,nkc->nc", barycentric, mesh.vertex_colors[corners].astype(float))
        out = blended
    else:
        base = np.array([m.base_color for m in mesh.materials], np.float64)
        out = base[mesh.face_material[face]]
    if mesh.uv is not None and any(m.texture is not None for m in mesh.materials):
        material = mesh.face_material[face]
        for i, m in enumerate(mesh.materials):
            rows = np.flatnonzero(material == i) if m.texture is not None else ()
            if m.texture is None or not len(rows):
                continue
            uv = np.einsum("nk,nkc->nc", barycentric[rows], mesh.uv[corners[rows]].astype(float))
            out[rows] *= _bilinear(m.texture, uv) / 255.0
    return np.rint(np.clip(out, 0, 255)).astype(np.uint8)


def face_colors(mesh: Mesh) -> npt.NDArray[np.uint8]:
    """Return (F, 4) RGBA at the centre of each face."""
    middle = np.full((len(mesh.faces), 3), 1.0 / 3.0)
    return colors_at(mesh, np.arange(len(mesh.faces)), middle)


def vertex_colors(mesh: Mesh) -> npt.NDArray[np.uint8]:
    """Return (V, 4) RGBA of the vertices, each by one of its faces; grey without one."""
    out = np.full((len(mesh.vertices), 4), 200, np.uint8)
    out[:, 3] = 255
    if not len(mesh.faces):
        return out
    corner = np.full(len(mesh.vertices), -1, np.int64)
    corner[mesh.faces.reshape(-1)] = np.arange(mesh.faces.size)
    used = np.flatnonzero(corner >= 0)
    weights = np.zeros((len(used), 3))
    weights[np.arange(len(used)), corner[used] % 3] = 1.0
    out[used] = colors_at(mesh, corner[used] // 3, weights)
    return out


def _bilinear(image: Image.Image, uv: Array) -> npt.NDArray[np.float64]:
    """(N, 4) values in 0..255 at texture coordinates (v up), which repeat outside 0..1."""
    pixels = np.asarray(image)
    height, width = pixels.shape[:2]
    x = np.mod(uv[:, 0], 1.0) * width - 0.5
    y = (1.0 - np.mod(uv[:, 1], 1.0)) * height - 0.5
    x0, y0 = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    fx, fy = (x - x0)[:, None], (y - y0)[:, None]
    x1, y1 = (x0 + 1) % width, (y0 + 1) % height
    x0, y0 = x0 % width, y0 % height
    top = pixels[y0, x0] * (1 - fx) + pixels[y0, x1] * fx
    bottom = pixels[y1, x0] * (1 - fx) + pixels[y1, x1] * fx
    out = top * (1 - fy) + bottom * fy
    if out.shape[1] == 3:
        out = np.column_stack([out, np.full(len(out), 255.0)])
    return out


def sample_surface(
    mesh: Mesh, count: int, rng: np.random.Generator
) -> tuple[PointCloud, npt.NDArray[np.int32]]:
    """Sample ``count`` points evenly over the area.

    Systematic sampling: each of ``count`` equal shares of the area, in the faces' order, gets one
    point, so that a face has its share of the points to within one.

    Args:
        mesh: with a face of positive area.
        count: at least 1.
        rng: the only source of randomness.

    Returns:
        The points in random order with face normals and colours, and (count,) the face of each.

    Raises:
        GeometryError: without area, and for ``count`` below 1.
    """
    if count < 1:
        raise GeometryError(f"{count} samples: at least one is needed")
    cumulative = np.cumsum(mesh.face_areas)
    if not len(cumulative) or not cumulative[-1] > 0:
        raise GeometryError("a mesh without area can't be sampled")
    share = (np.arange(count) + rng.random(count)) / count
    face = np.searchsorted(cumulative, share * cumulative[-1], side="right")
    # Rounding must not select faces without area at the end.
    face = np.minimum(face, np.flatnonzero(mesh.face_areas)[-1])
    face = face[rng.permutation(count)]
    u, v = rng.random((2, count))
    turn = u + v > 1.0
    u, v = np.where(turn, 1.0 - u, u), np.where(turn, 1.0 - v, v)
    weights = np.stack([1.0 - u - v, u, v], axis=1)
    points = np.einsum("nk,nkc->nc", weights, mesh.vertices[mesh.faces[face]])
    cloud = PointCloud(
        points.astype(np.float32),
        mesh.face_normals[face].astype(np.float32),
        colors_at(mesh, face, weights)[:, :3],
    )
    return cloud, face.astype(np.int32)
