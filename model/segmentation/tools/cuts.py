"""Cut a mask along a plane, or into its connected components."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from model.core.asset import Asset
from model.core.errors import PromptError
from model.geometry.splitting import ON_THE_PLANE, Plane, share_crossed
from model.segmentation.arrays import Bool, Float, Float64
from model.segmentation.default import DefaultSession
from model.segmentation.encode.graph import components
from model.segmentation.tools.element_masks import checked, to_elements, to_nodes

Position = Sequence[float] | Float

_AROUND = 24
_ONE_DIRECTION = 0.75
_COARSE = 0.01
"""Share of a mesh's area; if the faces across a cut have less, it follows their edges."""


@dataclass(frozen=True, eq=False)
class Cut:
    """A straight border through some elements of an asset.

    Attributes:
        chosen: (E,) the elements that are cut.
        planes: those on the inner side of all of them come off.
        whole: (E,) elements that come off undivided, or None.
    """

    chosen: Bool
    planes: tuple[Plane, ...]
    whole: Bool | None = None

    def inside(self, asset: Asset) -> Bool:
        """(E,) the elements that come off: their middle lies on the inner side or the border."""
        out = self.chosen & within(asset, self.planes)
        return out if self.whole is None else out | self.whole

    def splits_faces(self, asset: Asset) -> bool:
        """True if it crosses faces so large that they have to be split."""
        mesh = asset.mesh
        return mesh is not None and share_crossed(mesh, self.chosen, self.planes) > _COARSE


def line_cut(
    session: DefaultSession, mask: Bool, positions: Sequence[Position], view: Position | None = None
) -> Cut:
    """Cut a mask by a plane through two or three clicks.

    Two clicks cut along the line between them, perpendicular to the surface, or along ``view``
    where the surface has no single direction (an edge, a corner). This separates a door that is
    flush with the body. Three clicks are three points of the plane.

    Args:
        view: (3,) the direction that the person looks in.

    Raises:
        PromptError: if the clicks don't determine a plane.
    """
    at = np.array([np.asarray(tuple(p), float) for p in positions])
    if len(at) not in (2, 3):
        raise PromptError(f"a straight cut needs two or three clicks, got {len(at)}")
    along = at[1] - at[0]
    if len(at) == 3:
        normal = np.cross(along, at[2] - at[0])
    else:
        normal = np.cross(along, _into_the_surface(session, at, view))
    length = float(np.linalg.norm(normal))
    if length < 1e-9 * max(float(along @ along), 1e-18):
        raise PromptError("the clicks of a straight cut must be distinct and not on one line")
    return Cut(checked(session, mask), (plane_through(at[0], normal),))


def within(asset: Asset, planes: Sequence[Plane]) -> Bool:
    """(E,) elements whose middle lies on the inner side of all planes, or on a plane."""
    out = np.ones(asset.element_count, bool)
    for plane in planes:
        out &= plane.distance(asset.element_centers) >= -ON_THE_PLANE * asset.diagonal
    return out


def plane_through(point: Float64, normal: Float64) -> Plane:
    """The plane through a point (3,), with a normal of any length."""
    x, y, z = point.tolist()
    u, v, w = (normal / np.linalg.norm(normal)).tolist()
    return Plane((x, y, z), (u, v, w))


def _into_the_surface(session: DefaultSession, at: Float64, view: Position | None) -> Float64:
    """(3,) the normal of the surface around some places; ``view`` if they have several."""
    nodes, normals = session.encoding.nodes, session.encoding.graph.normals
    _, near = nodes.tree.query(at, k=min(_AROUND, len(nodes)))
    around = normals[near].reshape(-1, 3).astype(float)
    # Normals of scans may be flipped: their main axis is the same.
    values, axes = np.linalg.eigh(around.T @ around)
    if view is not None and values[2] < _ONE_DIRECTION * values.sum():
        return np.asarray(tuple(view), float)
    return axes[:, 2]


def connected_components(session: DefaultSession, mask: Bool) -> list[Bool]:
    """The connected components of a mask, largest first; for splitting a part."""
    inside = to_nodes(session, mask)
    graph = session.encoding.graph
    keep = inside[graph.a] & inside[graph.b] & ~graph.bridge
    _, component = components(len(inside), graph.a[keep], graph.b[keep])
    ids, counts = np.unique(component[inside], return_counts=True)
    out = []
    for i in ids[np.argsort(-counts, kind="stable")]:
        out.append(to_elements(session, inside & (component == i)) & mask)
    return [m for m in out if m.any()]
