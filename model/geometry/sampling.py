"""Points on a mesh's surface with their colours, and normals of clouds and meshes.

Normals of clouds are estimated from neighbours and oriented outwards; those of meshes are smooth
across gentle bends, sharp at creases.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from model.core.errors import GeometryError
from model.core.geometry import Mesh, PointCloud
from model.geometry.topology import face_adjacency, weld

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


NEIGHBOURS = 16
_CHUNK = 200_000
_AGREE = 0.7  # |cos| below which neighbours belong to different pieces of the surface


def estimate_normals(cloud: PointCloud, *, neighbours: int = NEIGHBOURS) -> PointCloud:
    """Estimate a unit normal at each point, oriented outwards.

    Directions come from a principal component analysis of the neighbours. Signs agree along a
    minimum spanning tree of the neighbourhood (Hoppe et al., 1992) within each smooth piece, which
    is then oriented to the side from which more of it is visible. A single sheet, equally visible
    from both sides, is oriented away from the cloud's centre.

    Raises:
        GeometryError: for fewer than three points.
    """
    from scipy.spatial import KDTree

    if len(cloud) < 3:
        raise GeometryError(f"{len(cloud)} points have no surface; at least 3 are needed")
    points = cloud.points.astype(np.float64)
    k = min(neighbours, len(points))
    tree = KDTree(points)
    index = np.concatenate(
        [tree.query(points[i : i + _CHUNK], k=k)[1] for i in range(0, len(points), _CHUNK)]
    ).astype(np.int32)
    normals = np.concatenate(
        [_smallest_components(points, index[i : i + _CHUNK]) for i in range(0, len(points), _CHUNK)]
    )
    normals = _oriented(points, normals, index[:, 1 : min(k, 9)])
    return replace(cloud, normals=normals.astype(np.float32))


def _smallest_components(points: Array, index: Array) -> npt.NDArray[np.float64]:
    around = points[index]
    around = around - around.mean(axis=1, keepdims=True)
    covariance = np.einsum("nki,nkj->nij", around, around)
    return np.linalg.eigh(covariance)[1][:, :, 0]


def _oriented(points: Array, normals: Array, near: Array) -> npt.NDArray[np.float64]:
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import (
        breadth_first_order,
        connected_components,
        minimum_spanning_tree,
    )

    count = len(points)
    rows, columns = np.repeat(np.arange(count), near.shape[1]), near.reshape(-1)
    cosine = np.einsum("ij,ij->i", normals[rows], normals[columns])
    smooth = (np.abs(cosine) > _AGREE) & (rows != columns)
    rows, columns, cosine = rows[smooth], columns[smooth], cosine[smooth]
    weight = 1.0 + 1e-6 - np.abs(cosine)
    tree = minimum_spanning_tree(
        coo_matrix((weight, (rows, columns)), shape=(count, count)).tocsr()
    )
    tree = (tree + tree.T).tocsr()
    pieces, piece = connected_components(tree, directed=False)
    # One more node connects all pieces, so that one search visits every point.
    seeds = np.unique(piece, return_index=True)[1]
    ones = np.ones(pieces)
    spokes = coo_matrix((ones, (np.full(pieces, count), seeds)), shape=(count + 1, count + 1))
    tree.resize((count + 1, count + 1))
    order, parent = breadth_first_order(tree + spokes + spokes.T, count, directed=False)
    sign = np.ones(count + 1)
    inner = order[1:]
    towards = parent[inner]
    rooted = towards == count
    flip = np.ones(len(inner))
    flip[~rooted] = np.sign(
        np.einsum("ij,ij->i", normals[inner[~rooted]], normals[towards[~rooted]])
    )
    signs = sign.tolist()
    for node, above, turn in zip(inner.tolist(), towards.tolist(), flip.tolist(), strict=True):
        signs[node] = signs[above] * (turn or 1.0)
    normals = normals * np.asarray(signs[:count])[:, None]
    vote = np.bincount(piece, _visible_side(points, normals), pieces)
    size = np.bincount(piece, minlength=pieces)
    away = np.einsum("ij,ij->i", normals, points - points.mean(axis=0))
    vote = np.where(np.abs(vote) > 0.05 * size, vote, np.bincount(piece, away, pieces))
    return normals * np.where(vote < 0, -1.0, 1.0)[piece][:, None]


def _visible_side(points: Array, normals: Array) -> npt.NDArray[np.float64]:
    """(N,) positive where a point is visible mainly from the side of its normal.

    From 26 directions, each with a coarse z-buffer.
    """
    steps = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)])
    views = steps[np.abs(steps).sum(axis=1) > 0].astype(np.float64)
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    extent = float(np.linalg.norm(np.ptp(points, axis=0)))
    cell = max(3.0 * extent / np.sqrt(len(points)), 1e-12)
    out = np.zeros(len(points))
    for view in views:
        side = np.cross(view, (0.0, 0.0, 1.0) if abs(view[2]) < 0.9 else (1.0, 0.0, 0.0))
        side /= np.linalg.norm(side)
        flat = points @ np.stack([side, np.cross(view, side)], axis=1)
        index = np.floor((flat - flat.min(axis=0)) / cell).astype(np.int64)
        key = index[:, 0] * (int(index[:, 1].max()) + 1) + index[:, 1]
        toward = points @ view
        front = np.full(int(key.max()) + 1, -np.inf)
        np.maximum.at(front, key, toward)
        out += (toward > front[key] - 1.5 * cell) * (normals @ view)
    return out / len(views)


CREASE = np.radians(35.0)


def corner_normals(
    mesh: Mesh, crease: float = CREASE
) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.float32]]:
    """Share normals between corners of adjacent faces whose angle is below ``crease``, radians.

    Returns:
        (F, 3) index of each corner's normal, and (G, 3) the unit normals.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    count = mesh.faces.size
    ids = weld(mesh)
    corners = ids[mesh.faces]
    adjacency = face_adjacency(mesh, ids)
    a, b = adjacency.pairs.T
    normals = mesh.face_normals
    # Faces of opposite winding are not joined: their normals would cancel.
    gentle = np.einsum("ij,ij->i", normals[a], normals[b]) > np.cos(crease)
    a, b, edge = a[gentle], b[gentle], ids[adjacency.edge[gentle]]
    rows, columns = (
        np.concatenate([3 * face + _corner_at(corners[face], edge[:, k]) for k in range(2)])
        for face in (a, b)
    )
    graph = coo_matrix((np.ones(len(rows), np.int8), (rows, columns)), shape=(count, count))
    groups, group = connected_components(graph, directed=False)
    weights = np.repeat(mesh.face_cross, 3, axis=0)
    total = np.stack([np.bincount(group, weights[:, k], groups) for k in range(3)], axis=1)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    up = np.broadcast_to(np.array([0.0, 0.0, 1.0]), total.shape)
    unit = np.where(length > 0, total / np.where(length > 0, length, 1.0), up)
    return group.reshape(-1, 3).astype(np.int32), unit.astype(np.float32)


def _corner_at(corners: Array, place: Array) -> Array:
    """Index of the corner at ``place``."""
    return np.argmax(corners == place[:, None], axis=1)
