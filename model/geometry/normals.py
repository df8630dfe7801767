"""Normals of point clouds, and shading normals of meshes.

Those of clouds are estimated from neighbours and oriented outwards; those of meshes are smooth
across gentle bends, sharp at creases.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.errors import GeometryError
from model.core.geometry import Mesh, PointCloud
from model.geometry.topology import face_adjacency, weld

Array = npt.NDArray[Any]

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
