"""Encode, step 1: sample at most 100k nodes that stand for all faces or points of an asset.

All later steps work on nodes, so their cost doesn't depend on the size of the scan.
:class:`ElementMap` carries labels back to every face or point.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import KDTree

from model.core.asset import Asset
from model.core.geometry import Mesh, PointCloud
from model.geometry.cleaning import NOISY, denoised, noise_level, outlier_points
from model.geometry.crop import ROOM_METRES
from model.geometry.sampling import sample_surface
from model.geometry.topology import coincident_faces, connected_shells
from model.segmentation.arrays import Float32, Int, Int16, Int32, Int64, Uint8

TARGET_NODES = 100_000
"""Nodes per asset: 6 mm apart on a 1 m cabinet."""

MOST_VOTES = 5_000_000
"""Pairs of faces and nodes, 150 MB in all; with more, only one copy of a face has them."""
_MIN_SHELL_NODES = 12
_NODES_PER_FACE = 12
_LEAST_MESH_NODES = 30_000


@dataclass(frozen=True, eq=False)
class ElementMap:
    """Which nodes stand for which elements.

    Attributes:
        node_of_element: (E,) int32 the node that stands for each element.
        vote_element, vote_node: (K,) int32 further (element, node) pairs of faces that hold
            several nodes; such a face takes the majority of its nodes.
        outliers: (S,) int32 ascending, elements on no surface; they follow their nearest node.
        like: (E,) int32 the element whose label each one takes; None where that is its own.
    """

    node_of_element: Int32
    vote_element: Int32
    vote_node: Int32
    node_count: int
    outliers: Int32 = field(default_factory=lambda: np.zeros(0, np.int32))
    like: Int32 | None = None

    @cached_property
    def _by_node(self) -> tuple[Int32, Int]:
        own = np.arange(len(self.node_of_element), dtype=np.int32)
        if len(self.outliers):  # last, so that none represents a node
            own = np.concatenate([np.delete(own, self.outliers), self.outliers])
        element = np.concatenate([own, self.vote_element])
        node = np.concatenate([self.node_of_element[own], self.vote_node])
        order = np.argsort(node, kind="stable")
        start = np.searchsorted(node[order], np.arange(self.node_count + 1))
        return element[order], start

    @property
    def element_of_node(self) -> Int32:
        """(N,) one of the elements that each node stands for."""
        element, start = self._by_node
        return element[start[:-1]]

    def prepare(self) -> None:
        """Build the lazy tables now instead of at the first click."""
        _ = self._by_node, self._multi

    def is_outlier(self, element: int) -> bool:
        """True if an element lies on no surface."""
        at = int(np.searchsorted(self.outliers, element))
        return at < len(self.outliers) and int(self.outliers[at]) == element

    def elements_of(self, nodes: Int) -> Int32:
        """(K,) unique elements that the nodes stand for."""
        element, start = self._by_node
        if not len(nodes):
            return np.zeros(0, np.int32)
        return np.unique(np.concatenate([element[start[n] : start[n + 1]] for n in nodes]))

    @cached_property
    def _multi(self) -> tuple[Int32, Int]:
        return np.unique(self.vote_element, return_inverse=True)

    def to_elements(self, labels: Int16) -> Int16:
        """(E,) labels from (N,) node labels >= 0; a large face takes its nodes' majority."""
        out = labels[self.node_of_element]
        if len(self.vote_element):
            faces, row = self._multi
            width = int(labels.max()) + 1
            votes = np.bincount(row * width + labels[self.vote_node], minlength=len(faces) * width)
            out[faces] = votes.reshape(len(faces), width).argmax(1)
        return out if self.like is None else out[self.like]

    def nodes_of(self, elements: Int) -> Int32:
        """Nodes more than half of whose elements are among ``elements``."""
        inside = np.zeros(len(self.node_of_element), bool)
        inside[elements] = True
        element, start = self._by_node
        total = np.concatenate([[0], np.cumsum(inside[element])])
        share = np.diff(total[start]) / np.maximum(np.diff(start), 1)
        return np.nonzero(share > 0.5)[0].astype(np.int32)


@dataclass(frozen=True, eq=False)
class Nodes:
    """Surface samples of an asset.

    Attributes:
        points: (N, 3) float32, metres, object frame.
        normals: (N, 3) float32 exact normals, or None if they must be estimated.
        colors: (N, 3) uint8, or None.
        shell: (N,) int32 connected shell of the mesh; zeros for a cloud.
        material: (N,) int32 material of the face; zeros for a cloud.
        elements: the map between nodes and elements.
        of_mesh: whether they were sampled from a mesh's faces.
    """

    points: Float32
    normals: Float32 | None
    colors: Uint8 | None
    shell: Int32
    material: Int32
    elements: ElementMap
    of_mesh: bool = False

    def __len__(self) -> int:
        return len(self.points)

    @cached_property
    def tree(self) -> KDTree:
        """KD-tree over the points."""
        return KDTree(self.points)


def distinct(values: Int) -> Int:
    """Sorted distinct values; ``np.unique`` hashes them, which takes ten times as long."""
    ordered = np.sort(values)
    return ordered[np.r_[True, ordered[1:] != ordered[:-1]]] if len(ordered) else ordered


def nodes_of_asset(asset: Asset, target: int = TARGET_NODES) -> Nodes:
    """Sample ``asset`` into about ``target`` nodes; deterministic."""
    if asset.mesh is not None and len(asset.mesh.faces):
        # Labels are per face: more than a dozen nodes a face would only cost time.
        enough = max(_NODES_PER_FACE * len(asset.mesh.faces), _LEAST_MESH_NODES)
        return _mesh_nodes(asset.mesh, min(target, enough))
    assert asset.cloud is not None
    nodes = _cloud_nodes(asset.cloud, target)
    if len(nodes) and np.ptp(nodes.points[:, :2], axis=0).max() >= ROOM_METRES:
        return nodes  # outliers of a room are cropped together with its floor and walls
    nodes = _without_outliers(nodes)
    if noise_level(nodes.points, nodes.tree) > NOISY:
        nodes = replace(nodes, points=denoised(nodes.points, nodes.tree))
    return nodes


def _without_outliers(nodes: Nodes) -> Nodes:
    """``nodes`` of a cloud without those on no surface, whose points go to the nearest node."""
    at = outlier_points(nodes.points, nodes.tree)
    if not len(at):
        return nodes
    outlier = np.zeros(len(nodes), bool)
    outlier[at] = True
    kept = np.flatnonzero(~outlier)
    became = np.zeros(len(nodes), np.int32)
    became[kept] = np.arange(len(kept), dtype=np.int32)
    _, near = KDTree(nodes.points[kept]).query(nodes.points[at])
    became[at] = near
    of_element = nodes.elements.node_of_element
    floating = np.flatnonzero(outlier[of_element]).astype(np.int32)
    none = np.zeros(0, np.int32)
    elements = ElementMap(became[of_element], none, none, len(kept), floating)
    normals = None if nodes.normals is None else nodes.normals[kept]
    colors = None if nodes.colors is None else nodes.colors[kept]
    zero = np.zeros(len(kept), np.int32)
    return Nodes(nodes.points[kept], normals, colors, zero, zero, elements)


def voxel_keys(points: Float32, low: Float32, size: float) -> Int64:
    """(N,) key of each point's voxel of edge ``size``; ``low`` (3,) is the grid's corner."""
    voxel = np.floor((points - low) / np.float32(size)).astype(np.int64)
    return (voxel[:, 0] << 42) | (voxel[:, 1] << 21) | voxel[:, 2]


def _voxel_size(points: Float32, target: int) -> float:
    """Edge length at which about ``target`` voxels are occupied."""
    low = points.min(0)
    extent = float((points.max(0) - low).max())
    size = max(extent, 1e-9) / 200
    for _ in range(6):
        key = voxel_keys(points, low, size)
        # Counting one voxel in eight, by hash, is accurate enough.
        few = key[(key * np.int64(0x9E3779B97F4A7C1) >> 40) & 7 == 0]
        ratio = np.sqrt(max(8 * len(distinct(few)), 1) / target)
        if 0.92 < ratio < 1.0:
            break
        size *= float(np.clip(ratio * 1.02, 0.25, 4.0))
    return size


def _cloud_nodes(cloud: PointCloud, target: int) -> Nodes:
    count = len(cloud)
    none = np.zeros(0, np.int32)
    # A few nodes too many are better than voxels that halve the resolution.
    if count <= 1.2 * target:
        zero = np.zeros(count, np.int32)
        same = ElementMap(np.arange(count, dtype=np.int32), none, none, count)
        return Nodes(cloud.points, cloud.normals, cloud.colors, zero, zero, same)
    points = cloud.points
    low = points.min(0)
    size = _voxel_size(points, target)
    key = voxel_keys(points, low, size)
    order = np.argsort(key, kind="stable")
    first = np.nonzero(np.r_[True, np.diff(key[order]) != 0])[0]
    group = np.zeros(count, np.int32)
    group[first[1:]] = 1
    group = np.cumsum(group, dtype=np.int32)
    # The point nearest the voxel's centre represents it: a mean would cancel the two sides of a
    # thin sheet.
    offset = (points[order] - low) / np.float32(size) % 1.0 - 0.5
    distance = np.einsum("ij,ij->i", offset, offset)
    nearest = np.minimum.reduceat(distance, first)
    hit = np.nonzero(distance == nearest[group])[0]
    keep = order[hit[np.r_[True, np.diff(group[hit]) != 0]]]
    node_of = np.empty(count, np.int32)
    node_of[order] = group
    number = np.diff(np.r_[first, count])[:, None]
    colors = None
    if cloud.colors is not None:
        total = np.add.reduceat(cloud.colors[order].astype(np.float32), first, axis=0)
        colors = (total / number).round().astype(np.uint8)
    normals = None if cloud.normals is None else cloud.normals[keep]
    zero = np.zeros(len(keep), np.int32)
    elements = ElementMap(node_of, none, none, len(keep))
    return Nodes(points[keep], normals, colors, zero, zero, elements)


def _mesh_nodes(mesh: Mesh, target: int) -> Nodes:
    shells = np.asarray(connected_shells(mesh))
    first_of = coincident_faces(mesh)
    if first_of is None:
        return _nodes_of_mesh(mesh, shells, target)
    # Coincident faces would be sampled twice, with normals that contradict each other.
    once = np.flatnonzero(first_of == np.arange(len(first_of)))
    single = replace(mesh, faces=mesh.faces[once], face_material=mesh.face_material[once])
    nodes = _nodes_of_mesh(single, shells[once], target)
    row = np.searchsorted(once, first_of)
    return replace(nodes, elements=_repeated(nodes.elements, row))


def _repeated(elements: ElementMap, row: Int64) -> ElementMap:
    """``elements`` where each element (E,) takes the nodes of the one in ``row``."""
    count = len(elements.node_of_element)
    of, node = elements.vote_element, elements.vote_node
    if np.bincount(row, minlength=count)[of].sum() > MOST_VOTES:
        first = np.unique(row, return_index=True)[1].astype(np.int32)
        of_element = elements.node_of_element[row]
        return ElementMap(of_element, first[of], node, elements.node_count, like=first[row])
    found = csr_matrix((np.ones(len(of), np.int8), (of, np.arange(len(of)))), (count, len(of)))
    found = found[row].tocoo()
    return ElementMap(
        elements.node_of_element[row],
        found.row.astype(np.int32),
        node[found.col],
        elements.node_count,
    )


def _nodes_of_mesh(mesh: Mesh, shells: Int, target: int) -> Nodes:
    rng = np.random.default_rng(0)
    cloud, face = sample_surface(mesh, target, rng)
    face = np.asarray(face)
    parts: list[PointCloud] = [cloud]
    faces: list[Int] = [face]
    # A button of a large object may have got no sample: give each shell a few.
    samples = np.bincount(shells[face], minlength=shells.max() + 1)
    poor = np.nonzero(samples[shells] < _MIN_SHELL_NODES)[0]
    if len(poor):
        number = len(np.unique(shells[poor])) * _MIN_SHELL_NODES
        keep = poor
        if len(keep) > max(number, target // 10):
            keep = rng.choice(poor, max(number, target // 10), replace=False)
            keep.sort()
        centers = PointCloud(
            mesh.triangles[keep].mean(1).astype(np.float32),
            mesh.face_normals[keep].astype(np.float32),
            None if cloud.colors is None else _nearest_colors(cloud, face, keep, mesh),
        )
        parts.append(centers)
        faces.append(keep)
    points = np.concatenate([p.points for p in parts])
    normals = np.concatenate([np.asarray(p.normals) for p in parts])
    colors = None if cloud.colors is None else np.concatenate([np.asarray(p.colors) for p in parts])
    face = np.concatenate(faces).astype(np.int32)
    node_of = _nodes_of_faces(mesh, points, face, shells)
    count = np.bincount(face, minlength=len(mesh.faces))
    several = np.nonzero(count[face] > 1)[0].astype(np.int32)
    elements = ElementMap(node_of, face[several], several, len(points))
    shell, material = shells[face].astype(np.int32), mesh.face_material[face]
    return Nodes(points, normals, colors, shell, material, elements, of_mesh=True)


def _nearest_colors(cloud: PointCloud, face: Int, keep: Int, mesh: Mesh) -> Uint8:
    """Colours for face centres: the material's, or its vertices'."""
    if mesh.vertex_colors is not None:
        return mesh.vertex_colors[mesh.faces[keep]][..., :3].mean(1).astype(np.uint8)
    base = np.array([m.base_color[:3] for m in mesh.materials], np.uint8)
    out = base[mesh.face_material[keep]]
    textured = np.array([m.texture is not None for m in mesh.materials])
    for material in np.unique(mesh.face_material[keep]):
        here = cloud.colors[mesh.face_material[face] == material]  # type: ignore[index]
        if textured[material] and len(here):
            out[mesh.face_material[keep] == material] = np.median(here, axis=0).astype(np.uint8)
    return out


def _nodes_of_faces(mesh: Mesh, points: Float32, face: Int32, shells: Int) -> Int32:
    """(F,) a node for each face: on it, else near it and if possible of the same shell."""
    node_of = np.full(len(mesh.faces), -1, np.int32)
    node_of[face[::-1]] = np.arange(len(face) - 1, -1, -1, dtype=np.int32)
    missing = np.nonzero(node_of < 0)[0]
    if len(missing):
        k = min(8, len(points))
        tree = KDTree(points)
        _, near = tree.query(mesh.triangles[missing].mean(1), k=k, workers=2)
        near = near.reshape(len(missing), k)
        same = shells[face[near]] == shells[missing][:, None]
        facing = np.einsum("fkj,fj->fk", mesh.face_normals[face[near]], mesh.face_normals[missing])
        rank = -np.arange(k) + 100.0 * same + 4.0 * (facing > 0.5)
        node_of[missing] = near[np.arange(len(missing)), rank.argmax(1)]
    return node_of
