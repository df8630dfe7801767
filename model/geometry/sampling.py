"""Points on a mesh's surface."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from model.core.errors import GeometryError
from model.core.mesh import Mesh
from model.core.point_cloud import PointCloud
from model.geometry.appearance import colors_at


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
