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


class _Recent(Generic[K, V]):
    """The last few values of an expensive function; for one process."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._kept: OrderedDict[K, V] = OrderedDict()

    def get(self, key: K, make: Callable[[], V]) -> V:
        if key not in self._kept:
            self._kept[key] = make()
            while len(self._kept) > self._size:
                self._kept.popitem(last=False)
        self._kept.move_to_end(key)
        return self._kept[key]


@dataclass(frozen=True)
class ReadOptions:
    """How a source is read: None is the format's default."""

    up_axis: UpAxis | None = None
    unit_scale: float = 1.0


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
    """A motion sweep of one joint.

    Attributes:
        q: (S,) radians or metres; depth: (S,) penetration beyond that at rest, metres.
        where: (3,) worst contact in the object frame, or None where nothing touches.
        other: the link that is hit.
    """

    joint: str
    q: npt.NDArray[np.float64]
    depth: npt.NDArray[np.float64]
    where: tuple[float, float, float] | None
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
    path: Path, cache: Path, options: ReadOptions, progress: Progress = no_progress
) -> OpenedAsset:
    """Read ``path``, lay its arrays down for the other workers, and prepare what is shown."""
    from model.geometry.cache import load_asset, save_asset
    from model.geometry.readers import read_asset

    progress(0.02, "Reading")
    identity = (str(path.resolve()), _stamp(path), options.up_axis, options.unit_scale)
    key = hashlib.sha256(repr(identity).encode()).hexdigest()[:24]
    folder = cache / key
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
        progress(0.6, "Keeping a working copy")
        save_asset(asset, folder)
    progress(0.8, "Preparing the picture")
    return _opened(asset, folder, path)


def _stamp(path: Path) -> tuple[tuple[str, int, int], ...]:
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
    flat = np.asarray(points, np.float64)[:: max(1, len(points) // 20_000), :2]
    best, score = (0.0, -1.0, 0.0), 0.0
    turn = _box_yaw(flat)
    for quarter in np.array([-0.5, 0.0, 1.0, 0.5]) * np.pi:
        direction = np.array([np.cos(turn + quarter), np.sin(turn + quarter)])
        along, across = flat @ direction, flat @ np.array([-direction[1], direction[0]])
        low, high = np.percentile(along, (1, 99))  # a scan's outliers don't count
        broad = float(np.ptp(np.percentile(across, (1, 99))))
        share = float(np.mean(high - along < 0.15 * max(high - low, 1e-9))) * broad
        if share > score * 1.4:
            best, score = (float(direction[0]), float(direction[1]), 0.0), share
    return best


def _box_yaw(flat: npt.NDArray[np.float64]) -> float:
    """Angle in (-π/4, π/4] of the smallest upright box around (N, 2) points; 0 on near ties."""
    best, least = 0.0, np.inf
    for yaw in np.radians([0, *range(-44, 46, 2)]):
        turned = flat @ np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        low, high = np.percentile(turned, (1, 99), axis=0)
        area = float(np.prod(high - low + 1e-9))
        if area < least * 0.8:
            best, least = float(yaw), area
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
def _asset(folder: Path) -> Asset:
    from model.geometry.cache import load_asset

    return load_asset(folder)


_pickers: _Recent[Path, Any] = _Recent(4)
_encodings: _Recent[tuple[Path, str], Any] = _Recent(ENCODINGS_KEPT)


def _picker(folder: Path) -> Any:
    from model.geometry.picking import Picker

    return _pickers.get(folder, lambda: Picker(_asset(folder)))


def prepare_picking(folder: Path) -> None:
    """Build the ray structure before the first click needs it."""
    _picker(folder)


def pick(
    folder: Path, origin: tuple[float, float, float], direction: tuple[float, float, float]
) -> Any:
    """The surface under a ray: ``Pick(position, element, normal)``, or None for the background."""
    return _picker(folder).pick(np.asarray(origin), np.asarray(direction))


def select_box(
    folder: Path,
    workspace: Path,
    camera: Any,
    corner_min: tuple[float, float],
    corner_max: tuple[float, float],
) -> tuple[str, int]:
    """Visible elements inside a rectangle of the screen: their stored array and their number."""
    chosen = _picker(folder).select_box(camera, corner_min, corner_max, visible_only=True)
    return _arrays(workspace).put(np.asarray(chosen, np.int64)), len(chosen)


# --- segmentation ---------------------------------------------------------------------------


def _arrays(workspace: Path) -> Any:
    from sessions.arrays import ArrayFiles

    return ArrayFiles(workspace / "arrays")


def encode(folder: Path, segmenter: str, progress: Progress = no_progress) -> float:
    """Encode an asset once; the later clicks find it here. Returns the seconds it took."""
    import time

    from model.segmentation.registry import load_segmenter

    start = time.perf_counter()
    _encodings.get(
        (folder, segmenter), lambda: load_segmenter(segmenter).encode(_asset(folder), progress)
    )
    return time.perf_counter() - start


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
    encode(folder, segmenter, progress)
    session = _encodings.get((folder, segmenter), lambda: None)
    answer = session.segment(_prompts(workspace, items))
    return _answer(workspace, answer, prompts_key, element)


@dataclass(frozen=True)
class RegionOffer:
    """Elements that a tool gives to a part, or takes from it. ``part`` -1 asks for a new part."""

    part: int
    elements: str
    count: int
    positive: bool = True


def use_tool(
    folder: Path,
    workspace: Path,
    segmenter: str,
    items: tuple[Click | StoredRegion, ...],
    part: int,
    tool: str,
    turn: int = 0,
) -> list[RegionOffer]:
    """What a segmentation tool makes of ``part``.

    Args:
        tool: "next mask", "connected", "same shape", "grow", "shrink" or "propose".
        turn: how often "next mask" was asked before.

    Raises:
        CommandError: where the segmenter has no such tool, or nothing comes of it.
    """
    from model.segmentation import tools

    encode(folder, segmenter)
    session = _encodings.get((folder, segmenter), lambda: None)
    if not hasattr(session, "encoding"):
        raise CommandError(f"the segmenter {segmenter!r} has no tools; use the default one")
    if tool == "propose":
        labels = tools.propose(session).labels
        return [_offer(workspace, labels == i, -1) for i in np.unique(labels) if i > 0]
    prompts = _prompts(workspace, items)
    mask = session.segment(prompts).labels == part
    if tool == "next mask":
        return _next_mask(workspace, session, prompts, part, mask, turn)
    if tool == "connected":
        clicks = [c for c in prompts.clicks if c.part == part and c.positive]
        if not clicks:
            raise CommandError("click on the part first; what is connected with it joins it")
        more = tools.connected(session, clicks[-1].position, clicks[-1].element) & ~mask
        return [_offer(workspace, more, part)] if more.any() else []
    if not mask.any():
        raise CommandError("click on the part first")
    if tool == "same shape":
        return [_offer(workspace, m, -1) for m in tools.same_shape(session, mask)]
    changed = tools.grow(session, mask, 1 if tool == "grow" else -1)
    moved = changed & ~mask if tool == "grow" else mask & ~changed
    return [_offer(workspace, moved, part, tool == "grow")] if moved.any() else []


def _next_mask(
    workspace: Path, session: Any, prompts: Prompts, part: int, mask: Any, turn: int
) -> list[RegionOffer]:
    others = session.candidates(prompts, part)
    turn %= len(others) + 1
    if turn == len(others):
        return []  # all were shown: back to the first
    chosen = others[turn]
    out = []
    for positive, moved in ((False, mask & ~chosen), (True, chosen & ~mask)):
        if moved.any():
            out.append(_offer(workspace, moved, part, positive))
    return out


def _offer(workspace: Path, mask: Any, part: int, positive: bool = True) -> RegionOffer:
    elements = np.flatnonzero(mask).astype(np.int64)
    return RegionOffer(part, _arrays(workspace).put(elements), len(elements), positive)


def source_regions(folder: Path, workspace: Path) -> dict[int, tuple[str, int]]:
    """The parts that the source was already cut into: part → stored elements and their number."""
    part = _asset(folder).element_part
    if part is None:
        return {}
    arrays = _arrays(workspace)
    out = {}
    for i in np.unique(part[part >= 0]):
        elements = np.flatnonzero(part == i).astype(np.int64)
        out[int(i)] = (arrays.put(elements), len(elements))
    return out


def _prompts(workspace: Path, items: tuple[Click | StoredRegion, ...]) -> Prompts:
    arrays = _arrays(workspace)
    return Prompts(
        tuple(
            p if isinstance(p, Click) else Region(p.part, arrays.get(p.elements), p.positive)
            for p in items
        )
    )


def _answer(
    workspace: Path, answer: Any, prompts_key: str, element: npt.NDArray[np.int32] | None
) -> SegmentationAnswer:
    labels = np.where(answer.labels < 0, 0, answer.labels).astype(np.int16)
    ids, counts = np.unique(labels, return_counts=True)
    return SegmentationAnswer(
        prompts_key=prompts_key,
        labels=_arrays(workspace).put(labels),
        display_labels=labels if element is None else labels[element],
        counts={int(i): int(n) for i, n in zip(ids, counts, strict=True)},
        segmenter=answer.segmenter,
        seconds=answer.seconds,
    )


def display_labels(
    workspace: Path, labels: str, element: npt.NDArray[np.int32]
) -> npt.NDArray[np.int16]:
    """Stored labels for the displayed elements."""
    return _arrays(workspace).get(labels)[element].astype(np.int16)


# --- parts, prediction, saving ----------------------------------------------------------------


_cut: _Recent[Any, tuple[Part, ...]] = _Recent(2)


def _parts(source: PartSource) -> tuple[Part, ...]:
    """The parts; the last ones are kept, with what others computed for them."""
    from model.geometry.parts import split

    def cut() -> tuple[Part, ...]:
        labels = _arrays(source.workspace).get(source.labels)
        return split(_asset(source.folder), labels, source.names)

    names = tuple(sorted(source.names.items()))
    return _cut.get((source.folder, source.labels, names), cut)


def _named(part: Part) -> Part:
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

    shown = display_asset(_asset(source.folder))
    labels = _arrays(source.workspace).get(source.labels)[element]
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
    return SegmentedObject(source.title, tuple(map(_named, _parts(source))), source.category)


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


def check_joints(
    source: PartSource, tree: KinematicTree, progress: Progress = no_progress
) -> list[JointCheck]:
    """Sweep every joint over its range against the other parts."""
    from model.kinematics.sweep import sweep_joint

    obj = ArticulatedObject(source.title, _parts(source), tree, source.category)
    moving = [j for j in tree.joints if j.moves]
    out = []
    for k, joint in enumerate(moving):
        progress(k / max(len(moving), 1), f"Sweeping {joint.name}")
        sweep = sweep_joint(obj, joint.name)
        worst = int(np.argmax(sweep.depth)) if len(sweep.depth) else 0
        hit = bool(sweep.collides.any())
        where = tuple(float(v) for v in sweep.where[worst]) if hit else None
        other = sweep.others[worst] if hit else None
        out.append(JointCheck(joint.name, sweep.q, sweep.depth, where, other))  # type: ignore[arg-type]
    return out


def save_asset_folder(
    source: PartSource,
    tree: KinematicTree,
    folder: Path,
    provenance: dict[str, Any],
    progress: Progress = no_progress,
) -> str:
    """Write the accepted asset and read it back. Returns the folder.

    Raises:
        ArtiworldError: where what was written doesn't load as it should.
    """
    from model.exporters.asset_folder import write_asset
    from model.exporters.reload import reload_check

    progress(0.1, "Cutting out the parts")
    asset = _asset(source.folder)
    obj = ArticulatedObject(source.title, _parts(source), tree, source.category)
    progress(0.3, "Writing meshes and URDF")
    write_asset(obj, folder, provenance=provenance, original=asset)
    progress(0.85, "Reading it back")
    problems = reload_check(folder)
    if problems:
        raise ArtiworldError(f"{folder}: written, but doesn't load as it should: {problems[0]}")
    return str(folder)


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

    parts = {p.link: p for p in _parts(source)}
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
