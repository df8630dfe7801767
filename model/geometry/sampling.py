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
    """``count`` points spread evenly over the area.

    The area is cut into ``count`` equal shares in the faces' order and each share gets one point,
    so that a face holds its share of the points to within one (systematic sampling).

    Args:
        mesh: needs a face with an area.
        count: at least 1.
        rng: decides everything that is random.

    Returns:
        The points in random order with face normals and colours, and (count,) the face of each.

    Raises:
        GeometryError: where there is no area or ``count`` is below 1.
    """
    if count < 1:
        raise GeometryError(f"{count} samples: at least one is needed")
    cumulative = np.cumsum(mesh.face_areas)
    if not len(cumulative) or not cumulative[-1] > 0:
        raise GeometryError("a mesh without area can't be sampled")
    share = (np.arange(count) + rng.random(count)) / count
    face = np.searchsorted(cumulative, share * cumulative[-1], side="right")
    # Faces without area at the end must not catch what rounding pushes over.
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
