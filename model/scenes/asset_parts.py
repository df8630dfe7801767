"""The rigid parts that an asset declares, or why an annotator must segment it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

from model.core.articulated_object import Inertial, Part, SegmentedObject, remarks_of
from model.core.asset import Asset
from model.core.errors import ArtiworldError
from model.core.geometry import PointCloud, affine
from model.core.names import MOST_NAMED
from model.core.shapes import Shape, moved_shape
from model.core.tree import KinematicTree
from model.data.partnet_mobility import read_partnet_mobility
from model.data.protocol import GroundTruth
from model.data.urdf_folders import UrdfFolders
from model.geometry.cleaning import outlier_points
from model.geometry.splitting import split
from model.geometry.topology import connected_shells
from model.io.assets.reader import declared_links
from model.io.geometry_files import FOLDER_SUFFIXES
from model.io.model_files import is_part_folder
from model.io.open_asset import open_asset, read_part_files
from model.io.urdf.files import MOBILITY
from model.io.urdf.meshes import merged, merged_clouds, moved_mesh
from model.io.urdf.reader import read_urdf_model
from model.scenes.scene import FloatArray, SceneObject

MOST_PIECES = MOST_NAMED
"""Connected pieces up to which they pass for parts; beyond, they are screws and panels."""
SAME = 1e-3
"""Scales that differ less from 1 are rounding."""


class LeftForAnnotator(ArtiworldError):
    """The asset declares no parts; the message gives the reason."""


@dataclass(frozen=True, eq=False)
class AssetParts:
    """Parts in the asset's own frame, metres, +z up.

    Attributes:
        how: human-readable origin of the cut.
        truth: the joints of the asset's own URDF, where it has one.
        notes: human-readable remarks on changes made on reading that URDF.
        inertials: link → mass properties where that URDF declares them.
        shapes: link → collision shapes where it declares them.
    """

    parts: tuple[Part, ...]
    how: str
    truth: KinematicTree | None = None
    notes: tuple[str, ...] = ()
    inertials: Mapping[str, Inertial] = field(default_factory=dict)
    shapes: Mapping[str, tuple[Shape, ...]] = field(default_factory=dict)


def known_parts(path: Path) -> AssetParts:
    """Parts by the asset's links, part files, named meshes, or connected pieces, in this order.

    Raises:
        LeftForAnnotator: where none of these tells at least two parts.
        InputFileError: where the asset can't be read.
    """
    if path.is_dir():
        if (path / MOBILITY).is_file():
            return _of_urdf(read_partnet_mobility(path, shapes=True), path / MOBILITY)
        if (path / "object.urdf").is_file():
            truth = UrdfFolders(path.parent).load(path.name, shapes=True)
            return _of_urdf(truth, path / "object.urdf")
        if is_part_folder(path, FOLDER_SUFFIXES):
            return _at_least_two(read_part_files(path).parts, "its part files")
    asset = read_unshifted(path)
    if asset.element_part is not None and not path.is_dir():
        named = split(asset, asset.element_part, dict(enumerate(asset.part_names)))
        return AssetParts(named, "its named meshes")
    return _pieces(asset)


def read_unshifted(path: Path) -> Asset:
    """The asset in its file's own frame, where scenes count from, even far from its origin."""
    return _unshifted(open_asset(path))


def whole(path: Path) -> Part:
    """The asset as one rigid part ``link_0``.

    Raises:
        InputFileError: where it can't be read.
    """
    if path.is_dir() and not (path / MOBILITY).is_file() and (path / "object.urdf").is_file():
        parts = UrdfFolders(path.parent).load(path.name).object.parts
        meshes = [p.mesh for p in parts if p.mesh is not None]
        clouds = [p.cloud for p in parts if p.cloud is not None]
        return Part(
            "link_0",
            merged(meshes) if meshes else None,
            merged_clouds(clouds) if clouds and not meshes else None,
            remarks=remarks_of(parts),
        )
    asset = read_unshifted(path)
    cloud = None if asset.mesh is not None else asset.cloud
    return Part("link_0", asset.mesh, cloud, remarks=asset.warnings)


def scaled(parts: tuple[Part, ...], factors: FloatArray) -> tuple[Part, ...]:
    """Parts stretched, and mirrored by negative factors (3,), about the asset's origin."""
    target = np.diag([*factors, 1.0])
    return tuple(
        replace(
            p,
            mesh=None if p.mesh is None else moved_mesh(p.mesh, target),
            cloud=None if p.cloud is None else _stretched(p.cloud, factors),
        )
        for p in parts
    )


def scaled_tree(tree: KinematicTree, factors: FloatArray) -> KinematicTree:
    """Joints stretched as :func:`scaled` does the parts.

    A turn about an axis is none any more where the factors differ; its axis goes along. In a mirror
    it turns the other way round.
    """
    handed = float(np.sign(factors).prod())
    joints = []
    for joint in tree.joints:
        along = np.asarray(joint.axis) * factors
        length = float(np.linalg.norm(along))
        slide = length if joint.slides else 1.0
        way = 1.0 if joint.slides else handed
        x, y, z = (way * along / length + 0.0).tolist() if length > 0 else joint.axis
        ox, oy, oz = (np.asarray(joint.origin) * factors).tolist()
        joints.append(replace(
            joint, axis=(x, y, z), origin=(ox, oy, oz),
            lower=None if joint.lower is None else joint.lower * slide,
            upper=None if joint.upper is None else joint.upper * slide,
        ))  # fmt: skip
    return KinematicTree(tree.links, tuple(joints))


def masses_at(known: AssetParts, factors: FloatArray) -> Mapping[str, Inertial]:
    """Mass properties by link that the asset tells; none where the factors (3,) aren't 1, as at
    another size it weighs something else."""
    return known.inertials if bool((abs(factors - 1) < SAME).all()) else {}


def scaled_shapes(
    shapes: Mapping[str, tuple[Shape, ...]], factors: FloatArray
) -> dict[str, tuple[Shape, ...]]:
    """Collision shapes at another size; none where the factors (3,) differ or mirror, as a
    stretched cylinder is none."""
    if not np.allclose(factors, factors[0], rtol=1e-6) or not factors[0] > 0:
        return {}
    matrix = np.diag([*factors, 1.0])
    return {link: tuple(moved_shape(s, matrix) for s in held) for link, held in shapes.items()}


def bounds_of(parts: tuple[Part, ...]) -> FloatArray:
    """(2, 3) lowest and highest corner; of scans without stray points, which would have the object
    stand in the air."""
    clouds = [p.cloud.points for p in parts if p.mesh is None and p.cloud is not None]
    meshes = tuple(p for p in parts if p.mesh is not None)
    each = [SegmentedObject("bounds", meshes).bounds] if meshes else []
    if clouds:
        # All at once: an outlier of one part may lie on the surface of another.
        points = np.concatenate(clouds)
        kept = np.ones(len(points), bool)
        kept[outlier_points(points, KDTree(points))] = False
        each.append(np.stack([points[kept].min(axis=0), points[kept].max(axis=0)]))
    low, high = np.stack(each).astype(np.float64).swapaxes(0, 1)
    return np.stack([low.min(axis=0), high.max(axis=0)])


def size_factors(obj: SceneObject, parts: tuple[Part, ...]) -> FloatArray:
    """(3,) factors that bring an asset's parts to the object's size in the scene."""
    return obj.scale if obj.fit is None else obj.placed(bounds_of(parts)).scale


def _stretched(cloud: PointCloud, factors: FloatArray) -> PointCloud:
    normals = cloud.normals
    if normals is not None:
        normals = normals / factors
        normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        normals = normals.astype(np.float32)
    points = (cloud.points * factors).astype(np.float32)
    return replace(cloud, points=points, normals=normals)


def _at_least_two(parts: tuple[Part, ...], how: str) -> AssetParts:
    if len(parts) < 2:
        raise LeftForAnnotator(f"{how} are a single part; cut it by clicks")
    return AssetParts(parts, how)


def _of_urdf(truth: GroundTruth, path: Path) -> AssetParts:
    found = _at_least_two(truth.object.parts, "links of its URDF")
    # Not those on merged links: that fixed links are one part is no change.
    model, obj = read_urdf_model(path), truth.object
    weighed, shaped = (declared_links(path.parent, what) for what in ("masses", "collision"))

    def its_own(link: str, listed: list[str] | None) -> bool:
        return listed is None or bool({link, link.removeprefix("link_")} & set(listed))

    return replace(
        found,
        truth=obj.tree,
        notes=(*model.notes, *model.declared.notes),
        inertials={link: i for link, i in obj.inertials.items() if its_own(link, weighed)},
        shapes={link: held for link, held in obj.shapes.items() if its_own(link, shaped)},
    )


def _pieces(asset: Asset) -> AssetParts:
    if asset.mesh is None:
        raise LeftForAnnotator("it is a point cloud without parts; cut it by clicks")
    shells = connected_shells(asset.mesh)
    count = int(shells.max()) + 1 if len(shells) else 0
    if not 2 <= count <= MOST_PIECES:
        pieces = "one connected piece" if count == 1 else f"{count} connected pieces"
        raise LeftForAnnotator(
            f"its mesh is {pieces}; two to {MOST_PIECES} pass for parts, so cut it by clicks"
        )
    return AssetParts(split(asset, shells), "its connected pieces")


def _unshifted(asset: Asset) -> Asset:
    """In the file's own frame, where scenes count from, even far from its origin."""
    shift = np.asarray(asset.source.shift if asset.source is not None else (0.0, 0.0, 0.0))
    if not shift.any():
        return asset
    back = affine(shift=shift)
    mesh = None if asset.mesh is None else moved_mesh(asset.mesh, back)
    cloud = asset.cloud
    if cloud is not None:
        cloud = replace(cloud, points=(cloud.points + shift).astype(np.float32))
    return replace(asset, mesh=mesh, cloud=cloud)
