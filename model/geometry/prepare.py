"""A scan brought into the object's frame: levelled, sized, cleaned.

The object's frame has +z up, metres, the lowest point at z = 0, and the middle of the outline at
x = y = 0. The nearest quarter turn about z puts the object's main upright surfaces along x and y.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from model.core.asset import Asset
from model.core.errors import ConfigurationError, GeometryError
from model.core.geometry import affine, uniform_scale
from model.core.joint import Joint
from model.core.progress import Progress, no_progress, scaled_progress
from model.core.tree import KinematicTree
from model.geometry.cleaning import KIND_NAMES, OBJECT, OUTLIER, Kinds, classify, outlier_points
from model.geometry.crop import crop
from model.geometry.levelling import (
    LYING_DECLARED,
    SURE,
    UPRIGHT,
    Levelling,
    find_up,
    supporting_height,
)
from model.geometry.sampling import sample_surface
from model.geometry.units import category_of, unusual_height

Array = npt.NDArray[np.float64]
Vector = tuple[float, float, float]

_SAMPLES = 200_000
"""Points of a mesh's surface that are looked at."""
_MOST = 1_000_000
"""Points of a scan that its bounds are measured on, against the time."""
_YAW_SAMPLES, _YAW_CELLS = 20_000, 200
"""Points, and cells along the outline's diagonal, by which upright surfaces are found."""
_ROUND = 1.05
"""The best axes must share cells so much more often than usual ones: things of revolution reach
1.03, others 1.06 to 9 (36 scans of PartNet-Mobility and Infinigen)."""
_MOST_OUTLIERS = 0.03
"""Share of the scan up to which outliers go without a person who sees them."""


@dataclass(frozen=True)
class PrepareSettings:
    """Settings for preparing a scan.

    Attributes:
        up: the source's up direction; None finds it.
        height: metres of the prepared object along z, or None.
        length: two places in the source's frame and the metres between them, or None.
        unit_scale: metres per source unit where neither is given.
        keep_support: keep what the object stands on and what stands beside it.
    """

    up: Vector | None = None
    height: float | None = None
    length: tuple[Vector, Vector, float] | None = None
    unit_scale: float = 1.0
    keep_support: bool = False

    def __post_init__(self) -> None:
        for name, value in (("height", self.height), ("unit scale", self.unit_scale)):
            if value is not None and not (np.isfinite(value) and value > 0):
                raise ConfigurationError(f"the {name} {value} must be a positive number of metres")
        if self.height is not None and self.length is not None:
            raise ConfigurationError("give a height or a length, not both")
        if self.length is not None:
            a, b, metres = self.length
            if not (np.isfinite([*a, *b, metres]).all() and metres > 0 and a != b):
                raise ConfigurationError(
                    "a length needs two places that differ and positive metres"
                )
        if self.up is not None and not 1e-9 < float(np.linalg.norm(self.up)) < np.inf:
            raise ConfigurationError(f"up {self.up} must be a direction other than zero")


@dataclass(frozen=True, eq=False)
class PrepareProposal:
    """Proposed preparation of a scan.

    Attributes:
        object_from_source: (4, 4) rotation, uniform scale and shift.
        levelling: the up direction in the source's frame with its confidence; 1.0 where it was
            given.
        kinds: (E,) int8 kind of each element; see :mod:`model.geometry.cleaning`.
    """

    object_from_source: Array
    levelling: Levelling
    kinds: Kinds


@dataclass(frozen=True, eq=False)
class Prepared:
    """A prepared scan.

    Attributes:
        asset: the object in its own frame.
        object_from_source, levelling: as in :class:`PrepareProposal`.
        kept: (K,) int64, ascending, the source's elements that the asset has.
        removed: kind of point → elements taken away.
    """

    asset: Asset
    object_from_source: Array
    levelling: Levelling
    kept: npt.NDArray[np.int64]
    removed: dict[str, int]


def propose(
    asset: Asset, settings: PrepareSettings | None = None, progress: Progress = no_progress
) -> PrepareProposal:
    """Find up, the object's frame and the kinds of elements.

    Args:
        asset: in the source's own frame and unit.
        settings: how; by default all of it is found.
        progress: called between the steps; it may cancel.
    """
    settings = settings or PrepareSettings()
    progress(0.0, "comparing directions")
    points, normals, face = _surface(asset)
    given = settings.up
    if given is None:
        found = _found_up(asset, points, normals, scaled_progress(progress, 0.0, 0.45))
    else:
        x, y, z = (np.asarray(given, float) / np.linalg.norm(given)).tolist()
        support = supporting_height(points, normals, np.array([x, y, z]))
        found = Levelling((x, y, z), 1.0, support)
    progress(0.45, "finding the object")
    rotation = _rotation_to_z(np.array(found.up))
    levelled = points @ rotation.T
    progress(0.55, "finding the object")
    of_points = classify(levelled, found.support)
    progress(0.8, "finding the object")
    kinds = of_points if face is None else _face_kinds(asset, points, face, of_points)
    progress(0.9, "finding the frame")
    turn = _squaring(levelled[of_points == OBJECT])  # what it stands on may lie askew
    rotation, levelled = turn @ rotation, levelled @ turn.T
    return PrepareProposal(
        _frame(rotation, levelled, of_points, found.support, settings), found, kinds
    )


def tilt_remark(asset: Asset, declared: bool = False) -> str | None:
    """Human-readable remark where a scan seems not to be upright, else None.

    Args:
        declared: whether the file's format says which axis is up.
    """
    points, normals, _ = _surface(asset)
    found = _found_up(asset, points, normals)
    if found.askew and found.confidence >= SURE:
        return f"tilted by {np.degrees(found.tilt):.0f}°: level it first with artiworld prepare"
    if not found.lies(declared):
        return None
    sure = f"confidence {100 * found.confidence:.0f} %"
    return f"seems to lie on its back or front ({sure}): stand it up with artiworld prepare"


def _found_up(
    asset: Asset, points: Array, normals: Array | None, progress: Progress = no_progress
) -> Levelling:
    """The up direction by the surface, and by the height of what the file is named after."""
    # Where the axis that was taken for the file's up is wrong, it is mostly the other of z and y.
    other = -1.0 if asset.source is not None and asset.source.up_axis == "y" else 1.0
    kept = _without_outliers(points)
    normals = None if normals is None else normals[kept]
    found = find_up(points[kept], normals, progress, mistaken=other)
    category = category_of(asset.name)
    if found.lying is None or category is None:
        return found
    _, lies, stands = (unusual_height(category, v) is None for v in np.ptp(asset.bounds, axis=0))
    if lies == stands:
        return found
    up = UPRIGHT if stands else found.up if found.up != UPRIGHT else (0.0, other, 0.0)
    others = tuple(v for v in (found.up, *found.alternatives) if v != up)
    lying = 1 - LYING_DECLARED if stands else max(found.lying, LYING_DECLARED)
    return Levelling(up, max(lying, 1 - lying), None, others, lying=lying)


def _without_outliers(points: Array) -> npt.NDArray[Any]:
    """The points that up is found by, or all where few are none: those far off would be taken for
    the object's extent."""
    chosen = np.arange(0, len(points), max(len(points) // _SAMPLES, 1))
    some = points[chosen]
    finite = np.isfinite(some).all(1)
    outliers = outlier_points(some[finite], KDTree(some[finite])) if finite.any() else []
    if not len(outliers):
        return np.arange(len(points))
    return np.delete(chosen[finite], outliers)


def prepare(
    asset: Asset, settings: PrepareSettings | None = None, progress: Progress = no_progress
) -> Prepared:
    """Level, size and clean a scan; arguments as of :func:`propose`.

    Raises:
        GeometryError: where nothing of the object is left.
    """
    settings = settings or PrepareSettings()
    found = propose(asset, settings, scaled_progress(progress, 0.1, 0.8))
    outlier = found.kinds == OUTLIER
    keep = ~outlier if settings.keep_support else found.kinds == OBJECT
    if outlier.mean() > _MOST_OUTLIERS:
        keep |= outlier
        note = f"kept {outlier.sum():,} outliers, too many to remove unseen: use the step Prepare"
        asset = replace(asset, warnings=(*asset.warnings, note))
    if not keep.any():
        raise GeometryError(f"{asset.name}: nothing of the object is left; keep the support")
    progress(0.8, "moving")
    whole = crop(asset, keep) if not keep.all() else asset
    removed = {
        KIND_NAMES[k]: int(n)
        for k, n in enumerate(np.bincount(found.kinds[~keep], minlength=len(KIND_NAMES)))
        if n
    }
    frame = found.object_from_source
    progress(1.0, "prepared")
    return Prepared(moved(whole, frame), frame, found.levelling, np.flatnonzero(keep), removed)


def standing(points: npt.NDArray[np.floating], rotation: Array) -> Array:
    """(4, 4) frame of a (3, 3) rotation in which (N, 3) points stand on z = 0 about x = y = 0."""
    turned = points @ rotation.T
    kinds = np.full(len(points), OBJECT, np.int8)
    return _frame(rotation, turned, kinds, None, PrepareSettings())


def moved(asset: Asset, target_from_asset: Array) -> Asset:
    """An asset under a (4, 4) rotation, uniform scale and shift.

    Masses and collision shapes that its file declares are dropped, with a warning.
    """
    linear, shift = target_from_asset[:3, :3], target_from_asset[:3, 3]
    scale = uniform_scale(linear)
    rotation = linear / scale
    mesh, cloud = asset.mesh, asset.cloud
    if mesh is not None:
        mesh = replace(mesh, vertices=mesh.vertices @ linear.T + shift)
    if cloud is not None:
        normals = None if cloud.normals is None else cloud.normals @ rotation.T.astype(np.float32)
        points = (cloud.points @ linear.T + shift).astype(np.float32)
        cloud = replace(cloud, points=points, normals=normals)
    warnings = asset.warnings
    if asset.inertials or asset.shapes:
        warnings = (*warnings, "was turned: its declared masses and collision shapes aren't used")
    return replace(
        asset,
        mesh=mesh,
        cloud=cloud,
        inertials={},
        shapes={},
        warnings=warnings,
        tree=None if asset.tree is None else _moved_tree(asset.tree, rotation, scale, shift),
    )


def _moved_tree(tree: KinematicTree, rotation: Array, scale: float, shift: Array) -> KinematicTree:
    def moved_joint(joint: Joint) -> Joint:
        ax, ay, az = (rotation @ joint.axis).tolist()
        ox, oy, oz = (scale * (rotation @ joint.origin) + shift).tolist()
        far = scale if joint.slides else 1.0
        low, high = (None if v is None else far * v for v in (joint.lower, joint.upper))
        return replace(joint, axis=(ax, ay, az), origin=(ox, oy, oz), lower=low, upper=high)

    return replace(tree, joints=tuple(moved_joint(j) for j in tree.joints))


def _surface(asset: Asset) -> tuple[Array, Array | None, npt.NDArray[np.int32] | None]:
    """The points of a cloud; of a mesh samples of its surface, their normals and faces."""
    if asset.mesh is None:
        return asset.element_centers, None, None
    cloud, face = sample_surface(asset.mesh, _SAMPLES, np.random.default_rng(0))
    assert cloud.normals is not None
    return cloud.points.astype(np.float64), cloud.normals.astype(np.float64), face


def _face_kinds(
    asset: Asset, points: Array, face: npt.NDArray[np.int32], of_points: Kinds
) -> Kinds:
    """Most frequent kind among each face's samples; without any, that of the nearest sample."""
    count = len(KIND_NAMES)
    votes = np.bincount(face * count + of_points, minlength=count * asset.element_count)
    votes = votes.reshape(-1, count)
    kinds = votes.argmax(1).astype(np.int8)
    bare = np.flatnonzero(votes.sum(1) == 0)
    if len(bare):
        _, near = KDTree(points).query(asset.element_centers[bare], workers=2)
        kinds[bare] = of_points[near]
    return kinds


def _frame(
    rotation: Array, levelled: Array, kinds: Kinds, support: float | None, settings: PrepareSettings
) -> Array:
    """(4, 4) object_from_source, from what is known to be the object."""
    of_object = levelled[kinds == OBJECT]
    of_object = of_object[:: max(len(of_object) // _MOST, 1)]
    low, high = np.percentile(of_object, [0.05, 99.95], axis=0)
    bottom = float(low[2]) if support is None else support
    scale = settings.unit_scale
    if settings.height is not None:
        scale = settings.height / max(float(high[2]) - bottom, 1e-12)
    elif settings.length is not None:
        a, b, metres = settings.length
        scale = metres / float(np.linalg.norm(np.subtract(a, b)))
    middle = np.array([*((low + high)[:2] / 2), bottom])
    return affine(scale * rotation, -scale * middle)


def _rotation_to_z(up: Array) -> Array:
    """(3, 3) the least rotation that turns ``up`` to +z."""
    axis = np.cross(up, [0.0, 0.0, 1.0])
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:
        return np.eye(3) if up[2] > 0 else np.diag([1.0, -1.0, -1.0])
    angle = float(np.arctan2(sine, up[2]))
    return np.asarray(Rotation.from_rotvec(axis / sine * angle).as_matrix())


def _squaring(points: Array) -> Array:
    """(3, 3) the turn about z, of at most 45 degrees, that puts upright surfaces along x and y.

    Seen from above such surfaces are lines, so along the right axes points share few positions.
    """
    if not len(points):
        return np.eye(3)
    flat = points[:: max(len(points) // _YAW_SAMPLES, 1), :2]
    low, high = np.percentile(flat, [1, 99], axis=0)
    width = max(float(np.linalg.norm(high - low)) / _YAW_CELLS, 1e-12)

    def shared(angles: Array) -> Array:
        """(A,) chance that two points share a cell along an axis turned by each of (A,) angles."""
        out = np.zeros(len(angles))
        for k, angle in enumerate([*angles, *(angles + np.pi / 2)]):
            along = flat @ [np.cos(angle), np.sin(angle)] / width
            cells = np.clip(along - np.median(along), -_YAW_CELLS, _YAW_CELLS) + _YAW_CELLS
            for shift in (0.0, 0.5):
                counts = np.bincount((cells + shift).astype(np.int64))
                out[k % len(angles)] += float(counts @ counts)
        return out

    coarse = np.radians(np.arange(-45, 45, 0.5))
    scores = shared(coarse)
    if scores.max() < _ROUND * np.median(scores):
        return np.eye(3)
    fine = coarse[scores.argmax()] + np.radians(np.linspace(-0.5, 0.5, 11))
    return np.asarray(Rotation.from_rotvec([0, 0, -fine[shared(fine).argmax()]]).as_matrix())
