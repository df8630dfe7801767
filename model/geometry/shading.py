"""Shading normals: smooth across gentle bends, sharp at creases."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.mesh import Mesh
from model.geometry.topology import face_adjacency, weld

Array = npt.NDArray[Any]

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
