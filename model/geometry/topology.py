"""Topology of meshes: welding, face adjacency, connected shells."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.geometry import Mesh

Array = npt.NDArray[Any]


def same_points(points: Array) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Group equal rows of (N, K): bit for bit, but for the sign of zero.

    Returns:
        ``(first, inverse)`` as ``np.unique(axis=0)``, many times faster: one row for each distinct
        row, and (N,) the distinct row of each row.
    """
    rows = np.ascontiguousarray(points, np.float64) + 0.0
    key = _mixed(rows.view(np.uint64).reshape(rows.shape))
    _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    inverse = inverse.reshape(-1)
    if not np.array_equal(rows[first[inverse]], rows, equal_nan=True):  # two rows, one hash
        _, first, inverse = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    return first, inverse.reshape(-1)


def _mixed(words: Array) -> Array:
    """Hash (N, K) uint64 to (N,), by the finaliser of splitmix64."""
    out = np.zeros(len(words), np.uint64)
    for i in range(words.shape[1]):
        out = out * np.uint64(0x9E3779B97F4A7C15) + words[:, i]
        out = (out ^ (out >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        out = (out ^ (out >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        out ^= out >> np.uint64(31)
    return out


def coincident_faces(mesh: Mesh) -> npt.NDArray[np.int64] | None:
    """Return (F,) the first face with the same three corners, of either winding, or None.

    None where no two faces coincide. Many modelled meshes have each face twice, once per side.
    """
    if not len(mesh.faces):
        return None
    _, place = same_points(mesh.vertices)
    corners = np.sort(place[mesh.faces], axis=1)
    first, group = same_points(corners.astype(np.float64))
    if len(first) == len(corners):
        return None
    lowest = np.full(len(first), len(corners), np.int64)
    np.minimum.at(lowest, group, np.arange(len(corners)))
    return lowest[group]


def weld(mesh: Mesh, tolerance: float | None = None) -> npt.NDArray[np.int32]:
    """Return (V,) the welded vertex of each vertex.

    Args:
        tolerance: metres within which vertices are merged; by default 1e-6 of the diagonal.
    """
    if not len(mesh.vertices):
        return np.zeros(0, np.int32)
    if tolerance is None:
        tolerance = 1e-6 * float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    if tolerance <= 0:
        return same_points(mesh.vertices)[1].astype(np.int32)
    first, place = same_points(np.floor(mesh.vertices / tolerance))
    # Neighbours on two sides of a cell's border are joined.
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import KDTree

    pairs = KDTree(mesh.vertices[first]).query_pairs(tolerance, output_type="ndarray")
    if not len(pairs):
        return place.astype(np.int32)
    graph = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(first), len(first)))
    return connected_components(graph, directed=False)[1][place].astype(np.int32)


@dataclass(frozen=True, eq=False)
class FaceAdjacency:
    """Pairs of faces that share a welded edge.

    Attributes:
        pairs: (A, 2) int32 faces, first < second.
        angle: (A,) radians between the two normals, 0 for coplanar faces.
        convex: (A,) whether the surface bends outwards or not at all; unreliable for inconsistent
            winding.
        edge: (A, 2) int32 vertices of the shared edge, as indexed by the first face.
        length: (A,) metres.
    """

    pairs: npt.NDArray[np.int32]
    angle: npt.NDArray[np.float32]
    convex: npt.NDArray[np.bool_]
    edge: npt.NDArray[np.int32]
    length: npt.NDArray[np.float32]


def _edge_runs(mesh: Mesh, ids: Array) -> tuple[Array, Array, Array]:
    """Half-edges sorted by welded edge: order, keys, and whether they run forward."""
    tails, heads = ids[mesh.faces].reshape(-1), ids[np.roll(mesh.faces, -1, 1)].reshape(-1)
    low, high = np.minimum(tails, heads).astype(np.int64), np.maximum(tails, heads)
    key = low * (int(ids.max()) + 1) + high
    order = np.argsort(key, kind="stable")
    order = order[(low != high)[order]]
    return order, key[order], (tails < heads)


def face_adjacency(mesh: Mesh, ids: Array | None = None) -> FaceAdjacency:
    """Find faces that share an edge, with their angle.

    Where more than two faces share an edge, each is paired with the next.

    Args:
        ids: of :func:`weld`, if known.
    """
    if not len(mesh.faces):
        empty = np.zeros((0, 2), np.int32)
        none = np.zeros(0, np.float32)
        return FaceAdjacency(empty, none, np.zeros(0, bool), empty, none)
    ids = weld(mesh) if ids is None else ids
    order, key, forward = _edge_runs(mesh, ids)
    same = np.flatnonzero(key[1:] == key[:-1])
    a, b = order[same], order[same + 1]
    keep = a // 3 != b // 3
    a, b = a[keep], b[keep]
    fa, fb = a // 3, b // 3
    swap = fa > fb
    a, b, fa, fb = (
        np.where(swap, b, a),
        np.where(swap, a, b),
        np.where(swap, fb, fa),
        np.where(swap, fa, fb),
    )
    normals = mesh.face_normals
    na, nb = normals[fa], normals[fb]
    # Two triangles that run along the edge in the same direction have opposite winding.
    nb = np.where((forward[a] == forward[b])[:, None], -nb, nb)
    angle = np.arctan2(np.linalg.norm(np.cross(na, nb), axis=1), np.einsum("ij,ij->i", na, nb))
    start = mesh.faces.reshape(-1)[a]
    end = np.roll(mesh.faces, -1, 1).reshape(-1)[a]
    opposite = mesh.vertices[np.roll(mesh.faces, -2, 1).reshape(-1)[b]]
    height = np.einsum("ij,ij->i", na, opposite - mesh.vertices[start])
    length = np.linalg.norm(mesh.vertices[end] - mesh.vertices[start], axis=1)
    return FaceAdjacency(
        np.stack([fa, fb], 1).astype(np.int32),
        angle.astype(np.float32),
        height <= 1e-9 * np.maximum(length, 1e-12),
        np.stack([start, end], 1).astype(np.int32),
        length.astype(np.float32),
    )


def connected_shells(mesh: Mesh, ids: Array | None = None) -> npt.NDArray[np.int32]:
    """Return (F,) the connected shell of each face: faces that share a welded vertex.

    Shells are numbered by their first face.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    if not len(mesh.faces):
        return np.zeros(0, np.int32)
    corners = (weld(mesh) if ids is None else ids)[mesh.faces]
    count = int(corners.max()) + 1
    rows = np.concatenate([corners[:, 0], corners[:, 1]])
    columns = np.concatenate([corners[:, 1], corners[:, 2]])
    graph = coo_matrix((np.ones(len(rows), np.int8), (rows, columns)), shape=(count, count))
    shell = connected_components(graph, directed=False)[1][corners[:, 0]]
    _, first, inverse = np.unique(shell, return_index=True, return_inverse=True)
    rank = np.empty(len(first), np.int32)
    rank[np.argsort(first)] = np.arange(len(first), dtype=np.int32)
    return rank[inverse.reshape(-1)]
