"""Split an asset into its parts, and triangles along planes.

Every face or point belongs to exactly one part. Planes are for borders that no edges of the mesh
follow.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import Part
from model.core.asset import Asset
from model.core.errors import GeometryError
from model.core.geometry import Mesh
from model.geometry.topology import weld

Bool = npt.NDArray[np.bool_]
Float = npt.NDArray[np.float64]
Int = npt.NDArray[np.int64]

ON_THE_PLANE = 1e-5
"""Distance in the diagonal up to which vertices are on a plane, so that no slivers are cut off."""


@dataclass(frozen=True)
class Plane:
    """A plane; its normal points to the inner side.

    Attributes:
        point: (3,) metres.
        normal: (3,) unit vector.
    """

    point: tuple[float, float, float]
    normal: tuple[float, float, float]

    def __post_init__(self) -> None:
        values = np.array([self.point, self.normal], float)
        if values.shape != (2, 3) or not np.isfinite(values).all():
            raise GeometryError("a plane needs a point and a normal of three finite numbers each")
        if abs(float(np.linalg.norm(values[1])) - 1.0) > 1e-6:
            raise GeometryError(f"a plane's normal must have length 1, got {self.normal}")

    def distance(self, points: Float) -> Float:
        """(N,) metres to the plane, positive on the inner side."""
        return (points - np.array(self.point)) @ np.array(self.normal)


@dataclass(frozen=True, eq=False)
class Split:
    """A mesh with some of its faces split.

    Attributes:
        mesh: of the same shape; new vertices are on old edges.
        parent: (F',) int64 source face of each face, ascending.
        inside: (F',) whether a face is of a chosen one and on the inner side of all planes.
    """

    mesh: Mesh
    parent: Int
    inside: Bool


@dataclass
class _Soup:
    """A mesh being split."""

    vertices: Float
    uv: npt.NDArray[np.float32] | None
    colors: npt.NDArray[np.uint8] | None
    place: Int
    faces: Int
    parent: Int
    inside: Bool


def split_faces(mesh: Mesh, chosen: Bool, planes: Sequence[Plane]) -> Split:
    """Split the chosen faces along planes, each plane splitting the inside of the former ones.

    Faces beside split edges are split as well, so that a closed mesh stays closed. Texture
    coordinates and vertex colours are interpolated along the edges.

    Args:
        chosen: (F,).

    Raises:
        GeometryError: where ``chosen`` doesn't have one entry per face.
    """
    if chosen.shape != (len(mesh.faces),):
        raise GeometryError(f"chosen needs {len(mesh.faces)} entries, got {chosen.shape}")
    soup = _Soup(
        np.asarray(mesh.vertices, np.float64),
        mesh.uv,
        mesh.vertex_colors,
        weld(mesh).astype(np.int64),
        mesh.faces.astype(np.int64),
        np.arange(len(mesh.faces)),
        chosen.copy(),
    )
    near = ON_THE_PLANE * float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    for plane in planes:
        _split(soup, plane, near)
    return Split(
        Mesh(
            soup.vertices,
            soup.faces.astype(np.int32),
            mesh.face_material[soup.parent],
            mesh.materials,
            soup.uv,
            soup.colors,
        ),
        soup.parent,
        soup.inside,
    )


def share_crossed(mesh: Mesh, chosen: Bool, planes: Sequence[Plane]) -> float:
    """Return the share of the chosen faces' area in faces that a plane crosses."""
    area = np.asarray(mesh.face_areas)[chosen]
    if not area.sum() > 0:
        return 0.0
    corners = mesh.triangles[chosen]
    near = ON_THE_PLANE * float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    crossed = np.zeros(len(area), bool)
    outside = np.zeros(len(area), bool)
    for plane in planes:
        apart = plane.distance(corners.reshape(-1, 3)).reshape(-1, 3)
        crossed |= (apart.min(1) < -near) & (apart.max(1) > near)
        outside |= apart.max(1) <= near
    # A face outside of one plane may be crossed by another, far from the cut.
    return float(area[crossed & ~outside].sum() / area.sum())


def _split(soup: _Soup, plane: Plane, near: float) -> None:
    apart = plane.distance(soup.vertices)
    apart[np.abs(apart) <= near] = 0.0
    sign = np.sign(apart)
    tail, head = soup.faces, np.roll(soup.faces, -1, axis=1)
    low = np.minimum(soup.place[tail], soup.place[head])
    high = np.maximum(soup.place[tail], soup.place[head])
    key = low * (int(soup.place.max()) + 1) + high
    wanted = soup.inside[:, None] & (sign[tail] * sign[head] < 0) & (low != high)
    cut = np.isin(key, np.unique(key[wanted]))
    if cut.any():
        middle = _middles(soup, apart, tail[cut], head[cut], key[cut])
        index = np.full(cut.shape, -1, np.int64)
        index[cut] = middle
        _subdivide(soup, index)
        apart = plane.distance(soup.vertices)
        apart[np.abs(apart) <= near] = 0.0
    soup.inside &= apart[soup.faces].sum(1) >= 0  # a rim on the plane is inside


def _middles(soup: _Soup, apart: Float, tail: Int, head: Int, key: Int) -> Int:
    """(M,) new vertices where half-edges (tail, head) meet the plane; added to the soup."""
    turned = soup.place[tail] > soup.place[head]
    a, b = np.where(turned, head, tail), np.where(turned, tail, head)
    count = len(soup.vertices)
    _, first, inverse = np.unique(a * count + b, return_index=True, return_inverse=True)
    a, b = a[first], b[first]
    # A neighbour's edge that does not cross (a seam a hair away) is split halfway.
    step = apart[a] - apart[b]
    t = np.where(apart[a] * apart[b] < 0, apart[a] / np.where(step == 0, 1.0, step), 0.5)[:, None]
    va, vb = soup.vertices[a], soup.vertices[b]
    soup.vertices = np.concatenate([soup.vertices, va + t * (vb - va)])
    if soup.uv is not None:
        mixed = soup.uv[a] + t * (soup.uv[b] - soup.uv[a])
        soup.uv = np.concatenate([soup.uv, mixed.astype(np.float32)])
    if soup.colors is not None:
        mixed = soup.colors[a] + t * (soup.colors[b].astype(float) - soup.colors[a])
        soup.colors = np.concatenate([soup.colors, np.rint(mixed).astype(np.uint8)])
    _, group = np.unique(key[first], return_inverse=True)
    soup.place = np.concatenate([soup.place, int(soup.place.max()) + 1 + group])
    return count + inverse.reshape(-1)


def _subdivide(soup: _Soup, middle: Int) -> None:
    """Replace each face by the pieces that the new vertices on its edges make of it.

    Args:
        middle: (F, 3) new vertex on the edge from corner k to the next, or -1.
    """
    number = (middle >= 0).sum(1)
    kept = number == 0
    pieces, parents = [soup.faces[kept]], [np.flatnonzero(kept)]
    for count, first in ((1, 0), (2, 2), (3, 0)):
        rows = np.flatnonzero(number == count)
        if not len(rows):
            continue
        # Turn the faces: with one new vertex it comes first, with two the whole edge comes last.
        known = middle[rows] >= 0
        turn = known.argmax(1) if count < 2 else (~known).argmax(1) - first
        order = (np.arange(3) + turn[:, None]) % 3
        v = np.take_along_axis(soup.faces[rows], order, 1).T
        m = np.take_along_axis(middle[rows], order, 1).T
        for corners in _PIECES[count]:
            pieces.append(np.stack([(v if kind == "v" else m)[k] for kind, k in corners], 1))
            parents.append(rows)
    parent = np.concatenate(parents)
    order = np.argsort(parent, kind="stable")
    parent = parent[order]
    soup.faces = np.concatenate(pieces)[order]
    soup.inside, soup.parent = soup.inside[parent], soup.parent[parent]


_V = tuple(("v", k) for k in range(3))
_M = tuple(("m", k) for k in range(3))
_PIECES = {
    1: ((_V[0], _M[0], _V[2]), (_M[0], _V[1], _V[2])),
    2: ((_M[0], _V[1], _M[1]), (_V[0], _M[0], _M[1]), (_V[0], _M[1], _V[2])),
    3: ((_V[0], _M[0], _M[2]), (_M[0], _V[1], _M[1]), (_M[2], _M[1], _V[2]), (_M[0], _M[1], _M[2])),
}
"""Corners (v) and new vertices (m) of the pieces of a face with so many new vertices."""


BASE = 0
"""The part of unassigned elements."""


def split(
    asset: Asset, labels: npt.NDArray[np.integer], names: Mapping[int, str] | None = None
) -> tuple[Part, ...]:
    """Split ``asset`` by labels, with its textures, colours and normals.

    Args:
        asset: its mesh is split if it has one, else its cloud.
        labels: (E,) part of each element; -1 (unassigned) becomes part 0.
        names: label → name of the part.

    Returns:
        A part ``link_i`` for each label i with elements, ascending. Faces keep their order.

    Raises:
        GeometryError: where the labels don't fit the asset.
    """
    labels = np.asarray(labels)
    if labels.shape != (asset.element_count,) or labels.dtype.kind not in "iu":
        raise GeometryError(
            f"{asset.name}: {asset.element_count} whole labels are needed, one a "
            f"{asset.element_kind}; got {labels.dtype} of shape {labels.shape}"
        )
    if len(labels) and labels.min() < -1:
        raise GeometryError(f"{asset.name}: label {labels.min()} is below -1")
    labels = np.where(labels < 0, BASE, labels)
    names = names or {}
    # One stable sort instead of one scan per part.
    order = np.argsort(labels, kind="stable")
    kept, starts = np.unique(labels[order], return_index=True)
    out = []
    for label, index in zip(kept, np.split(order, starts[1:]), strict=True):
        mesh = None if asset.mesh is None else asset.mesh.take_faces(index)
        cloud = None
        if asset.mesh is None and asset.cloud is not None:
            cloud = asset.cloud.take(index)
        name = names.get(int(label)) or None
        out.append(Part(f"link_{label}", mesh, cloud, name, asset.warnings))
    return tuple(out)
