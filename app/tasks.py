"""What the worker processes do. Top-level functions: called by name in another process.

Each worker keeps what it computed in small caches of its own process; the server only ever holds
what a browser shows. Geometry passes between processes as a folder of memory-mapped arrays.
"""

from __future__ import annotations

import hashlib
import math
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
import numpy.typing as npt

from model.errors import ArtiworldError, CommandError
from model.gate.report import GateReport
from model.geometry.asset import Asset, ElementKind, UpAxis
from model.geometry.point_cloud import PointCloud
from model.kinematics.articulated_object import (
    ArticulatedObject,
    Part,
    Prediction,
    SegmentedObject,
)
from model.kinematics.joint import Joint
from model.kinematics.tree import KinematicTree
from model.progress import Progress, no_progress
from model.segmentation.prompts import Click, Prompts, Region

K = TypeVar("K")
V = TypeVar("V")

SWEEP_POINTS = 3000
ENCODINGS_KEPT = 3


class Recent(Generic[K, V]):
    """The last few values of an expensive function; for one process."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._kept: OrderedDict[K, V] = OrderedDict()

    def get(self, key: K, make: Callable[[], V]) -> V:
        """The value of ``key``; made where it isn't kept."""
        if key not in self._kept:
            self._kept[key] = make()
            while len(self._kept) > self._size:
                self._kept.popitem(last=False)
        self._kept.move_to_end(key)
        return self._kept[key]


@dataclass(frozen=True)
class ReadOptions:
    """How a source is read.

    Attributes:
        up_axis: None is the format's default.
        unit_scale: metres per unit.
        left_out: reference of the stored elements that are not looked at, or None.
    """

    up_axis: UpAxis | None = None
    unit_scale: float = 1.0
    left_out: str | None = None


@dataclass(frozen=True, eq=False)
class OpenedAsset:
    """What the server keeps of an open object.

    Attributes:
        folder: memory-mapped arrays of the asset, shared by the workers.
        display_vertices, display_faces: what the browser draws of a mesh, else None.
        display_points, display_colors: what the browser draws of a cloud, else None.
        element: (D,) source element of each displayed face or point.
        glb: the displayed mesh with its materials, z up, else None.
        part_names: names by part id where the source was already cut into parts.
    """

    name: str
    folder: Path
    path: Path
    sha256: str
    up_axis: UpAxis
    unit_scale: float
    element_kind: ElementKind
    element_count: int
    bounds: npt.NDArray[np.float64]
    element: npt.NDArray[np.int32]
    display_vertices: npt.NDArray[np.float32] | None = None
    display_faces: npt.NDArray[np.int32] | None = None
    display_points: npt.NDArray[np.float32] | None = None
    display_colors: npt.NDArray[np.uint8] | None = None
    glb: bytes | None = None
    part_names: tuple[str, ...] = ()
    has_parts: bool = False
    category: str | None = None
    warnings: tuple[str, ...] = ()
    front: tuple[float, float, float] = (0.0, -1.0, 0.0)

    @property
    def diagonal(self) -> float:
        """Length of the bounding box's diagonal in metres."""
        return float(np.linalg.norm(self.bounds[1] - self.bounds[0]))


@dataclass(frozen=True, eq=False)
class SegmentationAnswer:
    """Labels as the server needs them: the stored array's name, and what is shown."""

    prompts_key: str
    labels: str
    display_labels: npt.NDArray[np.int16]
    counts: dict[int, int]
    segmenter: str
    seconds: float


@dataclass(frozen=True, eq=False)
class PartPayload:
    """One part as the browser draws it when joints move."""

    part: int
    glb: bytes | None
    points: npt.NDArray[np.float32] | None
    colors: npt.NDArray[np.uint8] | None
    vertices: npt.NDArray[np.float32] | None = None
    faces: npt.NDArray[np.int32] | None = None


@dataclass(frozen=True, eq=False)
class JointCheck:
    """A joint that runs into something.

    Attributes:
        q: radians or metres where it is deepest. depth: metres beyond the penetration at rest.
        where: (3,) the contact in the object frame.
        other: the link that is hit.
    """

    joint: str
    q: float
    depth: float
    where: tuple[float, float, float]
    other: str | None


@dataclass(frozen=True)
class StoredRegion:
    """A :class:`Region` whose elements lie in the workspace."""

    part: int
    elements: str
    positive: bool = True


@dataclass(frozen=True)
class PartSource:
    """Everything a worker needs to cut an asset into parts."""

    folder: Path
    workspace: Path
    labels: str
    names: Mapping[int, str] = field(default_factory=dict)
    category: str | None = None
    title: str = "object"


# --- assets ---------------------------------------------------------------------------------


def open_asset(
    path: Path, workspace: Path, options: ReadOptions, progress: Progress = no_progress
) -> OpenedAsset:
    """Read ``path``, lay its arrays down for the other workers, and prepare what is shown."""
    progress(0.02, "Reading")
    asset, folder = working_copy(path, workspace, options, progress)
    progress(0.8, "Preparing the picture")
    return _opened(asset, folder, path)


def working_copy(
    path: Path, workspace: Path, options: ReadOptions, progress: Progress = no_progress
) -> tuple[Asset, Path]:
    """The asset of ``path`` and the folder of its arrays, which is made where it isn't there."""
    from model.geometry.cache import load_asset, save_asset
    from model.geometry.readers import read_asset

    identity = (str(path.resolve()), stamp(path), options.up_axis, options.unit_scale)
    if options.left_out is not None:
        identity = (*identity, options.left_out)
    key = hashlib.sha256(repr(identity).encode()).hexdigest()[:24]
    folder = workspace / "cache" / key
    asset: Asset | None = None
    if folder.exists():
        try:
            asset = load_asset(folder)
        except ArtiworldError:
            asset = None
    if asset is None:
        asset = read_asset(
            path, up_axis=options.up_axis, unit_scale=options.unit_scale, progress=progress
        )
        if options.left_out is not None:
            asset = _without(asset, arrays_of(workspace).get(options.left_out))
        progress(0.6, "Keeping a working copy")
        save_asset(asset, folder)
    return asset, folder


def _without(asset: Asset, elements: npt.NDArray[np.int64]) -> Asset:
    from model.segmentation.crop import crop

    keep = np.ones(asset.element_count, bool)
    if len(elements) and elements[-1] >= len(keep):
        raise CommandError("the source has fewer elements than when some were left out; undo that")
    keep[elements] = False
    return crop(asset, keep)


def stamp(path: Path) -> tuple[tuple[str, int, int], ...]:
    """Names, sizes and times of what a path holds: tells whether a working copy is still true."""
    files = [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.is_file())[:5000]
    return tuple((f.name, f.stat().st_size, f.stat().st_mtime_ns) for f in files)


def _opened(asset: Asset, folder: Path, path: Path) -> OpenedAsset:
    from model.geometry.display import display_asset
    from model.geometry.glb import mesh_to_glb

    shown = display_asset(asset)
    source = asset.source
    mesh, cloud = shown.mesh, shown.cloud
    return OpenedAsset(
        name=asset.name,
        folder=folder,
        path=path,
        sha256=source.sha256 if source else "",
        up_axis=source.up_axis if source else "z",
        unit_scale=source.unit_scale if source else 1.0,
        element_kind=asset.element_kind,
        element_count=asset.element_count,
        bounds=np.asarray(asset.bounds),
        element=np.asarray(shown.element, np.int32),
        display_vertices=None if mesh is None else mesh.vertices.astype(np.float32),
        display_faces=None if mesh is None else np.asarray(mesh.faces),
        display_points=None if cloud is None else np.asarray(cloud.points),
        display_colors=None if cloud is None else _colors(cloud),
        glb=None if mesh is None else mesh_to_glb(mesh),
        part_names=asset.part_names,
        has_parts=asset.element_part is not None,
        category=asset.category,
        warnings=asset.warnings,
        front=front_direction(mesh.triangles.mean(1) if mesh is not None else cloud.points),  # type: ignore[union-attr]
    )


def front_direction(points: npt.NDArray[np.floating[Any]]) -> tuple[float, float, float]:
    """The horizontal side to look from first: broad, and with the most detail.

    Handles and knobs are small faces, and a one-sided scan has points where the camera stood, so
    the side whose outer layer holds the most elements is the front. Near ties go to -y, glTF's
    front. The sides are those of the tightest upright box.
    """
    from model.geometry.upright_box import box_yaw

    flat = np.asarray(points, np.float64)[:: max(1, len(points) // 20_000), :2]
    best, score = (0.0, -1.0, 0.0), 0.0
    turn = box_yaw(flat)
    for quarter in np.array([-0.5, 0.0, 1.0, 0.5]) * np.pi:
        direction = np.array([np.cos(turn + quarter), np.sin(turn + quarter)])
        along, across = flat @ direction, flat @ np.array([-direction[1], direction[0]])
        low, high = np.percentile(along, (1, 99))  # a scan's outliers don't count
        broad = float(np.ptp(np.percentile(across, (1, 99))))
        share = float(np.mean(high - along < 0.15 * max(high - low, 1e-9))) * broad
        if share > score * 1.4:
            best, score = (float(direction[0]), float(direction[1]), 0.0), share
    return best


def _colors(cloud: PointCloud) -> npt.NDArray[np.uint8]:
    """The scan's colours; without any, a height ramp so that the shape still reads."""
    if cloud.colors is not None:
        return np.asarray(cloud.colors)
    z = cloud.points[:, 2]
    t = (z - z.min()) / max(float(np.ptp(z)), 1e-9)
    low, high = np.array([96, 110, 130.0]), np.array([214, 218, 222.0])
    return (low + t[:, None] * (high - low)).astype(np.uint8)


@lru_cache(maxsize=8)
def asset_of(folder: Path) -> Asset:
    """The asset laid down in a folder."""
    from model.geometry.cache import load_asset

    return load_asset(folder)


_pickers: Recent[Path, Any] = Recent(4)
_encodings: Recent[tuple[Path, str], Any] = Recent(ENCODINGS_KEPT)
_regions: Recent[tuple[Path, str], npt.NDArray[np.int64]] = Recent(100)


def picker_of(folder: Path) -> Any:
    """Its picker, kept in this process."""
    from model.geometry.picking import Picker

    return _pickers.get(folder, lambda: Picker(asset_of(folder)))


def prepare_picking(folder: Path) -> None:
    """Build the ray structure before the first click needs it."""
    picker_of(folder)


def pick(
    folder: Path, origin: tuple[float, float, float], direction: tuple[float, float, float]
) -> Any:
    """The surface under a ray: ``Pick(position, element, normal)``, or None for the background."""
    return picker_of(folder).pick(np.asarray(origin), np.asarray(direction))


def select_box(
    folder: Path,
    workspace: Path,
    camera: Any,
    corner_min: tuple[float, float],
    corner_max: tuple[float, float],
    *,
    one_piece: bool = False,
) -> tuple[str, int]:
    """Visible elements inside a rectangle of the screen: their stored array and their number.

    Args:
        one_piece: of a scan only what hangs together, not what stands before and behind it.
    """
    chosen = picker_of(folder).select_box(camera, corner_min, corner_max, visible_only=True)
    cloud = asset_of(folder).cloud
    if one_piece and cloud is not None and len(chosen):
        from model.segmentation.crop import largest_piece

        chosen = chosen[largest_piece(cloud.points[chosen])]
    return arrays_of(workspace).put(np.asarray(chosen, np.int64)), len(chosen)


# --- segmentation ---------------------------------------------------------------------------


def arrays_of(workspace: Path) -> Any:
    """The workspace's arrays."""
    from sessions.arrays import ArrayFiles

    return ArrayFiles(workspace / "arrays")


def encode(folder: Path, segmenter: str, progress: Progress = no_progress) -> float:
    """Encode an asset once; the later clicks find it here. Returns the seconds it took."""
    import time

    start = time.perf_counter()
    session_of(folder, segmenter, progress)
    return time.perf_counter() - start


def session_of(folder: Path, segmenter: str, progress: Progress = no_progress) -> Any:
    """The asset as the segmenter has encoded it, kept in this process."""
    from model.segmentation.registry import load_segmenter

    return _encodings.get(
        (folder, segmenter), lambda: load_segmenter(segmenter).encode(asset_of(folder), progress)
    )


def segment(
    folder: Path,
    workspace: Path,
    segmenter: str,
    items: tuple[Click | StoredRegion, ...],
    prompts_key: str,
    element: npt.NDArray[np.int32] | None,
    progress: Progress = no_progress,
) -> SegmentationAnswer:
    """Answer the prompts; labels for all elements go to the workspace, for the shown ones back."""
    session = session_of(folder, segmenter, progress)
    answer = session.segment(prompts_of(workspace, items))
    return _answer(workspace, answer, prompts_key, element)


def source_regions(folder: Path, workspace: Path) -> dict[int, tuple[str, int]]:
    """The parts that the source was already cut into: part → stored elements and their number."""
    return source_regions_of(asset_of(folder), workspace)


def source_regions_of(asset: Asset, workspace: Path) -> dict[int, tuple[str, int]]:
    """As :func:`source_regions`, of an asset at hand."""
    part = asset.element_part
    if part is None:
        return {}
    arrays = arrays_of(workspace)
    out = {}
    for i in np.unique(part[part >= 0]):
        elements = np.flatnonzero(part == i).astype(np.int64)
        out[int(i)] = (arrays.put(elements), len(elements))
    return out


def prompts_of(workspace: Path, items: tuple[Click | StoredRegion, ...]) -> Prompts:
    """Prompts with the elements of their regions."""
    return Prompts(
        tuple(
            p
            if isinstance(p, Click)
            else Region(p.part, _elements(workspace, p.elements), p.positive)
            for p in items
        )
    )


def _elements(workspace: Path, ref: str) -> npt.NDArray[np.int64]:
    return _regions.get((workspace, ref), lambda: arrays_of(workspace).get(ref))


def _answer(
    workspace: Path, answer: Any, prompts_key: str, element: npt.NDArray[np.int32] | None
) -> SegmentationAnswer:
    labels = np.where(answer.labels < 0, 0, answer.labels).astype(np.int16)
    ids, counts = np.unique(labels, return_counts=True)
    return SegmentationAnswer(
        prompts_key=prompts_key,
        labels=arrays_of(workspace).put(labels),
        display_labels=labels if element is None else labels[element],
        counts={int(i): int(n) for i, n in zip(ids, counts, strict=True)},
        segmenter=answer.segmenter,
        seconds=answer.seconds,
    )


def display_labels(
    workspace: Path, labels: str, element: npt.NDArray[np.int32]
) -> npt.NDArray[np.int16]:
    """Stored labels for the displayed elements."""
    return arrays_of(workspace).get(labels)[element].astype(np.int16)


# --- parts, prediction, saving ----------------------------------------------------------------


_cut: Recent[Any, tuple[Part, ...]] = Recent(2)


def parts_of(source: PartSource) -> tuple[Part, ...]:
    """The parts; the last ones are kept, with what others computed for them."""
    from model.geometry.parts import split

    def cut() -> tuple[Part, ...]:
        labels = arrays_of(source.workspace).get(source.labels)
        return split(asset_of(source.folder), labels, source.names)

    names = tuple(sorted(source.names.items()))
    return _cut.get((source.folder, source.labels, names), cut)


def named(part: Part) -> Part:
    """In the app part 0 is the base by definition: the predictor need not guess it."""
    if part.link == "link_0" and part.name is None:
        return replace(part, name="base")
    return part


def part_payloads(
    source: PartSource, element: npt.NDArray[np.int32], progress: Progress = no_progress
) -> list[PartPayload]:
    """Each part as the browser draws it, from the displayed elements."""
    from model.geometry.display import display_asset
    from model.geometry.glb import mesh_to_glb

    shown = display_asset(asset_of(source.folder))
    labels = arrays_of(source.workspace).get(source.labels)[element]
    out = []
    parts = [int(p) for p in np.unique(labels)]
    for k, part in enumerate(parts):
        progress(k / len(parts), "Cutting the picture into parts")
        mine = labels == part
        if shown.mesh is not None:
            mesh = shown.mesh.take_faces(mine)
            out.append(
                PartPayload(
                    part,
                    mesh_to_glb(mesh),
                    None,
                    None,
                    mesh.vertices.astype(np.float32),
                    np.asarray(mesh.faces),
                )
            )
        else:
            assert shown.cloud is not None
            cloud = shown.cloud.take(mine)
            out.append(PartPayload(part, None, np.asarray(cloud.points), _colors(cloud)))
    return out


def segmented_object(source: PartSource) -> SegmentedObject:
    """The parts of an asset as a predictor reads them."""
    return SegmentedObject(source.title, tuple(map(named, parts_of(source))), source.category)


def articulated_object(source: PartSource, tree: KinematicTree) -> ArticulatedObject:
    """The parts of an asset with the joints that were decided."""
    return ArticulatedObject(source.title, parts_of(source), tree, source.category)


def predict(
    source: PartSource,
    predictor: str,
    locked: tuple[Joint, ...],
    seed: int,
    progress: Progress = no_progress,
) -> Prediction:
    """Predict the kinematic tree of the parts."""
    from model.predictors import load_predictor

    progress(0.02, "Cutting out the parts")
    segmented = segmented_object(source)
    return load_predictor(predictor).predict(segmented, locked=locked, seed=seed, progress=progress)


def checks_of(report: GateReport) -> list[JointCheck]:
    """The collisions of a gate's answer as the views mark them."""
    return [
        JointCheck(j.joint, f.q.get(j.joint, 0.0), f.depth, f.where, f.other)
        for j in report.joints
        for f in j.findings
        if f.kind in ("collision", "jammed") and f.verdict != "fine" and f.where is not None
    ]


def snap_joint(source: PartSource, tree: KinematicTree, child: str, to: str) -> Joint:
    """The joint of ``child`` snapped to a feature of its part.

    Args:
        to: "axis Long", "axis Middle", "axis Short", "Box edge", "Contact", "Centre" or
            "free range" (limits up to the first collision).
    """
    from model.kinematics.snapping import (
        axis_along_box,
        box_of,
        origin_on_box_edge,
        origin_on_contact,
    )

    parts = {p.link: p for p in parts_of(source)}
    joint = tree.joint_of[child]
    if child not in parts:
        raise CommandError(f"{child} has no part to snap to; it is a helper link")
    if to == "free range":
        return _with_free_range(source, tree, joint, tuple(parts.values()))
    points = _surface_points(parts[child])
    if to.startswith("axis "):
        return axis_along_box(joint, box_of(points), to.removeprefix("axis "))  # type: ignore[arg-type]
    if to == "Box edge":
        return origin_on_box_edge(joint, box_of(points))
    if to == "Centre":
        return replace(joint, origin=tuple(float(v) for v in box_of(points).center))
    if joint.parent not in parts:
        raise CommandError(f"{joint.parent} has no part to touch; it is a helper link")
    reach = 0.01 * float(np.linalg.norm(np.ptp(points, axis=0)))
    return origin_on_contact(joint, points, _surface_points(parts[joint.parent]), reach)


def _surface_points(part: Part) -> npt.NDArray[np.float64]:
    from model.geometry.sampling import sample_surface

    if part.mesh is not None and len(part.mesh.faces):
        samples, _ = sample_surface(part.mesh, SWEEP_POINTS, np.random.default_rng(0))
        corners = part.mesh.vertices[np.unique(part.mesh.faces)]
        return np.concatenate([samples.points.astype(np.float64), corners])
    assert part.cloud is not None
    points = part.cloud.points.astype(np.float64)
    if len(points) > 4 * SWEEP_POINTS:
        keep = np.random.default_rng(0).choice(len(points), 4 * SWEEP_POINTS, replace=False)
        points = points[keep]
    return points


def _with_free_range(
    source: PartSource, tree: KinematicTree, joint: Joint, parts: tuple[Part, ...]
) -> Joint:
    from model.kinematics.sweep import free_range

    part = next(p for p in parts if p.link == joint.child)
    along = _surface_points(part) @ np.asarray(joint.axis)
    most = math.pi if joint.rotates else 0.95 * float(np.ptp(along))
    lower, upper = free_range(ArticulatedObject(source.title, parts, tree), joint.name, most)
    closed_below, closed_above = joint.lower == 0.0, joint.upper == 0.0
    return replace(
        joint,
        lower=0.0 if closed_below else float(lower),
        upper=0.0 if closed_above else float(upper),
    )
