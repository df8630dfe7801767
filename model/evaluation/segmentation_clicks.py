"""Objects with known parts for ``artiworld bench segment``, and the visible-click protocol.

The field's protocol clicks the deepest point of a part wherever that is, inside a closed drawer
too. A person clicks the middle of the largest visible component of a part, then the middle of the
largest visible error: for the part that it belongs to, or with Shift where it is too much. All
moving parts are clicked, never the base.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.ndimage import distance_transform_edt, label
from scipy.spatial import KDTree

from model.core.articulated_object import ArticulatedObject
from model.core.asset import Asset
from model.core.errors import ArtiworldError, InputFileError
from model.core.geometry import Mesh, PointCloud
from model.data.folders import PartNetMobility
from model.data.registry import Dataset
from model.data.simulated.depth_camera import ScanSettings, simulate_scan
from model.data.simulated.depth_camera import View as Camera
from model.data.simulated.scans import build, scan, visible_from
from model.geometry.casting import Caster, camera_rays, look_at
from model.geometry.sampling import sample_surface
from model.io.open_asset import open_asset
from model.segmentation.arrays import Bool, Float, Float32, Float64, Int, Int16, Int64, Labels
from model.segmentation.prompts import BASE, Click, Prompts
from model.segmentation.registry import SegmentationSession

Points = Float64

_ROWS, _COLUMNS = 200, 240
_FOV = 0.6
LEAST_PIXELS = 12
"""Least pixels of a part or an error that is clicked."""
_NOTHING = -1
_SOME, _AROUND = 2000, 6
"""Points of a cloud, and neighbours of each, that give its spacing."""
_LARGEST_DOT = 5.0
"""Largest radius of a point's dot in pixels."""
FRONT = (-1.0, 0.0, 0.0)
"""Direction that PartNet-Mobility's objects face."""


@dataclass(frozen=True, eq=False)
class Picture:
    """The visible elements of an object, seen from its front, the side and above.

    Attributes:
        element: (R, C) int64 the element in each pixel, -1 for none.
        position: (R, C, 3) metres, the visible point.
    """

    element: Int64
    position: Float64

    def of(self, labels: Labels) -> Labels:
        """(R, C) the part in each pixel, -1 for none."""
        return np.where(self.element < 0, np.int16(_NOTHING), labels[self.element])

    def click(self, pixel: tuple[int, int], part: int, positive: bool = True) -> Click:
        """A click on a pixel (row, column)."""
        x, y, z = self.position[pixel].tolist()
        return Click((x, y, z), part, positive, int(self.element[pixel]))


def picture_of(asset: Asset, front: npt.ArrayLike = FRONT) -> Picture:
    """The picture of ``asset`` that a person sees first, 240 by 200 pixels.

    The points of a cloud are dots that are large enough to close its surfaces.

    Args:
        front: (3,) the direction that it faces.
    """
    low, high = asset.bounds
    return picture_from(asset, *_camera(low, high, front))


def picture_from(asset: Asset, eye: Points, target: Points, fov: float = _FOV) -> Picture:
    """The picture of ``asset`` from an eye that looks at a target, both (3,).

    Args:
        fov: vertical angle of view in radians.
    """
    if asset.mesh is not None:
        return _of_mesh(asset.mesh, eye, target, fov)
    assert asset.cloud is not None
    return _of_points(asset.cloud.points.astype(np.float64), eye, target, fov)


def _camera(low: Points, high: Points, front: npt.ArrayLike) -> tuple[Points, Points]:
    """(3,) positions of the eye and of its target."""
    middle = (low + high) / 2
    ahead = np.asarray(front, np.float64)
    toward = ahead + 0.5 * np.cross(ahead, (0.0, 0.0, 1.0)) + (0.0, 0.0, 0.45)
    toward /= np.linalg.norm(toward)
    away = 0.55 * float(np.linalg.norm(high - low)) / np.tan(_FOV / 2)
    return middle + away * toward, middle


def _of_mesh(mesh: Mesh, eye: Points, middle: Points, fov: float) -> Picture:
    directions = camera_rays(eye, middle, _COLUMNS, _ROWS, fov)
    origins = np.broadcast_to(eye, directions.shape)
    hits = Caster([mesh]).cast(origins, directions, colors=False)
    element = np.full(_ROWS * _COLUMNS, _NOTHING, np.int64)
    position = np.zeros((_ROWS * _COLUMNS, 3))
    element[hits.ray], position[hits.ray] = hits.face, hits.points
    return Picture(element.reshape(_ROWS, _COLUMNS), position.reshape(_ROWS, _COLUMNS, 3))


def _of_points(points: Points, eye: Points, middle: Points, fov: float) -> Picture:
    local = (points - eye) @ look_at(eye, middle).T
    pixel = 2 * np.tan(fov / 2) / _ROWS
    column = np.floor(local[:, 0] / local[:, 2] / pixel + _COLUMNS / 2).astype(np.int64)
    row = np.floor(local[:, 1] / local[:, 2] / pixel + _ROWS / 2).astype(np.int64)
    some = points[:: max(len(points) // _SOME, 1)]
    apart, _ = KDTree(points).query(some, k=min(_AROUND + 1, len(points)))
    spacing = float(np.median(np.atleast_2d(apart)[:, -1]))
    radius = float(np.clip(spacing / (pixel * np.median(local[:, 2])), 1.0, _LARGEST_DOT))
    far_first = np.argsort(-local[:, 2], kind="stable")
    row, column, depth = row[far_first], column[far_first], local[far_first, 2]
    element = np.full(_ROWS * _COLUMNS, _NOTHING, np.int64)
    nearest = np.full(_ROWS * _COLUMNS, np.inf)
    reach = range(-int(np.ceil(radius)), int(np.ceil(radius)) + 1)
    for down, right in ((d, r) for d in reach for r in reach if d * d + r * r <= radius**2 + 0.25):
        there = (row + down >= 0) & (row + down < _ROWS)
        there &= (column + right >= 0) & (column + right < _COLUMNS)
        at = (row[there] + down) * _COLUMNS + column[there] + right
        drawn = np.full(_ROWS * _COLUMNS, _NOTHING, np.int64)
        drawn[at] = np.flatnonzero(there)  # of several the last one stays, which is the nearest
        # A dot's middle is in front of its rim, so that dots side by side share their border.
        behind = depth[drawn] + 1e-3 * spacing * (down**2 + right**2)
        nearer = (drawn >= 0) & (behind < nearest)
        nearest[nearer], element[nearer] = behind[nearer], far_first[drawn[nearer]]
    position = np.where((element >= 0)[:, None], points[element], 0.0)
    return Picture(element.reshape(_ROWS, _COLUMNS), position.reshape(_ROWS, _COLUMNS, 3))


def largest_component(region: Bool) -> tuple[Bool, int]:
    """The largest connected component of a region, and its number of pixels."""
    number = np.zeros(region.shape, np.int32)
    label(region, output=number)
    size = np.bincount(number.ravel())[1:]
    if not len(size):
        return region, 0
    return number == 1 + size.argmax(), int(size.max())


def depths(component: Bool) -> Points:
    """(R, C) distance of each pixel to the component's outline in pixels, 0 outside."""
    return np.asarray(distance_transform_edt(np.pad(component, 1)))[1:-1, 1:-1]


def middle_of(component: Bool) -> tuple[int, int]:
    """Row and column of the pixel that is farthest from the component's outline."""
    depth = depths(component)
    row, column = np.unravel_index(int(np.argmax(depth)), depth.shape)
    return int(row), int(column)


@dataclass(frozen=True, eq=False)
class VisibleRounds:
    """A session by the visible-click protocol.

    Attributes:
        parts: visible moving parts.
        labels: (E,) after the last click.
        iou: mean IoU of the parts' visible pixels, after each round.
        clicks, drops: corrective clicks, and those that lowered that mean by more than ``DROP``.
        after_rounds: (E,) labels after each round.
    """

    parts: tuple[int, ...]
    labels: Labels
    iou: tuple[float, ...]
    clicks: int = 0
    drops: int = 0
    after_rounds: tuple[Labels, ...] = ()


DROP = 0.05
"""Mean IoU that a click may lose before it counts as one that lowers it."""


def visible_rounds(
    session: SegmentationSession, picture: Picture, truth: Labels, rounds: int = 3
) -> VisibleRounds:
    """Click every visible moving part once, then in each round the largest visible errors.

    Args:
        truth: (E,) the true part of each element, 0 the base, -1 for none.
        rounds: of as many clicks as there are parts.
    """
    true = picture.of(truth)
    parts = [int(p) for p in np.unique(true[true > BASE]) if (true == p).sum() >= LEAST_PIXELS]
    if not parts:
        return VisibleRounds((), np.zeros(len(truth), np.int16), ())
    one = (true >= BASE).astype(float)

    def mean(labels: Labels) -> float:
        shown = picture.of(labels)
        return float(np.mean([_iou(shown == p, true == p, one) for p in parts]))

    clicks = [picture.click(middle_of(largest_component(true == p)[0]), p) for p in parts]
    labels = session.segment(Prompts(tuple(clicks))).labels
    iou, after, drops = [mean(labels)], [labels], 0
    for _ in range(rounds - 1):
        now = iou[-1]
        for _ in parts:
            more = _next(picture, true, picture.of(labels), parts)
            if more is None:
                break
            clicks.append(more)
            labels = session.segment(Prompts(tuple(clicks))).labels
            before, now = now, mean(labels)
            drops += now < before - DROP
        iou.append(now)
        after.append(labels)
    corrective = len(clicks) - len(parts)
    return VisibleRounds(tuple(parts), labels, tuple(iou), corrective, drops, tuple(after))


def visible_click_ious(
    session: SegmentationSession, picture: Picture, truth: Labels, weight: Float, rounds: int = 3
) -> list[tuple[float, float]]:
    """After each of the :func:`visible_rounds`, the mean IoU of visible pixels, and of all elements
    by their ``weight`` (E,), 0 for those of no part; empty if no moving part is visible.
    """
    found = visible_rounds(session, picture, truth, rounds)
    whole = [
        float(np.mean([_iou(labels == p, truth == p, weight) for p in found.parts]))
        for labels in found.after_rounds
    ]
    return list(zip(found.iou, whole, strict=True))


def _next(picture: Picture, true: Labels, shown: Labels, parts: list[int]) -> Click | None:
    """The click on the largest visible error within one true part; None without any."""
    errors = [(largest_component((true == p) & (shown != p)), p) for p in [BASE, *parts]]
    (error, size), part = max(errors, key=lambda found: found[0][1])
    if size < LEAST_PIXELS:
        return None
    at = middle_of(error)
    wanted = part != BASE
    return picture.click(at, part if wanted else int(shown[at]), wanted)


def _iou(answer: Bool, truth: Bool, weight: Float) -> float:
    return float(weight[answer & truth].sum() / max(weight[answer | truth].sum(), 1e-12))


View = Literal["all", "one-sided", "mesh", "scan"]
"""A cloud of all surfaces; of those visible from the front, with noise; the mesh; a simulated scan
by depth cameras in front of it."""
Direction = tuple[float, float, float]

_CAMERAS = ((-0.6, 0.25), (-0.2, 0.5), (0.2, 0.25), (0.6, 0.5))
"""Radians beside and above the front: a person walks past with a scanner."""
_DEPTH_NOISE, _MISALIGNED = 0.001, 0.0003
"""Noise and misalignment of a scan, in diagonals."""
_SIDES: tuple[Direction, ...] = (FRONT, (0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))

ROOM_CLASSES = {2: "cabinet", 7: "door", 14: "refrigerator"}
"""Classes among ScanNet's 20, counted from 0, that a person would pick out of a room."""

_BENCH_SEED = 900_000


@dataclass(frozen=True, eq=False)
class BenchObject:
    """An asset with the true part of every element.

    Attributes:
        labels: (E,) int16; 0 is the base, -1 no part.
        parts: the parts to ask for, one against the rest.
        whole: whether the parts cover the object, so that they can all compete.
        front: the direction that it faces.
    """

    name: str
    dataset: str
    asset: Asset
    labels: Int16
    parts: tuple[int, ...]
    whole: bool = True
    front: Direction = FRONT


def asked_parts(labels: Int, least: int, most: int, seed: int) -> tuple[int, ...]:
    """At most ``most`` of the parts that have ``least`` elements, chosen by ``seed``."""
    ids, counts = np.unique(labels, return_counts=True)
    ids = ids[(counts >= least) & (ids >= 0)]
    if len(ids) > most:
        ids = np.sort(np.random.default_rng(seed).permutation(ids)[:most])
    return tuple(int(i) for i in ids)


def dataset_objects(
    source: Dataset,
    view: View,
    points: int,
    limit: int,
    least: int,
    most: int,
    offset: int = 0,
    *,
    front: Direction | None = None,
    left_out: list[str] | None = None,
) -> Iterator[BenchObject]:
    """Objects of a data set, each link a part, the tree's root the base.

    ``limit`` takes every n-th object, beginning with ``offset``, so that all kinds are there.
    Clouds have colours and no normals.

    Args:
        front: direction that all objects face; None for the side that shows most moving parts.
        left_out: gets a line for each object that can't be read; None makes that an error.

    Raises:
        ArtiworldError: if an object can't be read and ``left_out`` is None.
    """
    ids = source.ids()
    step = max(len(ids) // limit, 1) if limit else 1
    chosen = ids[offset::step][: limit or None]
    for number, object_id in enumerate(chosen):
        try:
            truth = source.load(object_id).object
        except ArtiworldError as error:
            if left_out is None:
                raise
            left_out.append(f"{object_id}: {error}")
            continue
        links = [truth.tree.root, *(p.link for p in truth.parts if p.link != truth.tree.root)]
        by_link = {p.link: p.mesh for p in truth.parts if p.mesh is not None}
        pieces = [(i, by_link[n]) for i, n in enumerate(links) if n in by_link]
        if len(pieces) < 2:
            continue
        ahead = front_of(pieces) if front is None else front
        if view == "scan":
            asset, labels = _scanned(truth, {n: i for i, n in enumerate(links)}, points, ahead)
        else:
            asset, labels = _assembled(object_id, pieces, view, points, number, ahead)
        parts = asked_parts(labels, least, most, number)
        yield BenchObject(object_id, f"{source.name} {view}", asset, labels, parts, front=ahead)


def partnet_objects(
    root: Path, view: View, points: int, limit: int, least: int, most: int, offset: int = 0
) -> Iterator[BenchObject]:
    """PartNet-Mobility objects, see :func:`dataset_objects`."""
    source = PartNetMobility(root)
    return dataset_objects(source, view, points, limit, least, most, offset, front=FRONT)


def front_of(pieces: list[tuple[int, Mesh]]) -> Direction:
    """The side from which most of the moving parts is visible."""
    mesh, labels = _joined(pieces)
    asset = Asset("sides", mesh=mesh)
    visible = [int((picture_of(asset, side).of(labels) > 0).sum()) for side in _SIDES]
    return _SIDES[int(np.argmax(visible))]


def _assembled(
    name: str, pieces: list[tuple[int, Mesh]], view: View, points: int, seed: int, front: Direction
) -> tuple[Asset, Int16]:
    if view == "mesh":
        mesh, labels = _joined(pieces)
        return Asset(name, mesh=mesh), labels
    rng = np.random.default_rng(seed)
    area = np.array([float(m.face_areas.sum()) for _, m in pieces])
    wanted = points if view == "all" else 4 * points
    share = np.maximum((wanted * area / area.sum()).round().astype(int), 1)
    clouds = [
        sample_surface(m, int(n), rng)[0] if a > 0 else None
        for (_, m), n, a in zip(pieces, share, area, strict=True)
    ]
    there = [(p, c) for (p, _), c in zip(pieces, clouds, strict=True) if c is not None]
    xyz = np.concatenate([c.points for _, c in there])
    rgb = np.concatenate([np.asarray(c.colors) for _, c in there])
    normal = np.concatenate([np.asarray(c.normals) for _, c in there])
    labels = np.repeat([p for p, _ in there], [len(c) for _, c in there]).astype(np.int16)
    if view == "one-sided":
        keep = _seen_from_the_front(xyz, normal, rng, points, front)
        diagonal = float(np.linalg.norm(np.ptp(xyz, axis=0)))
        xyz = xyz[keep] + rng.normal(0, 0.001 * diagonal, (len(keep), 3)).astype(np.float32)
        noisy = rgb[keep].astype(float) + rng.normal(0, 8, (len(keep), 3))
        rgb, labels = np.clip(noisy, 0, 255).astype(np.uint8), labels[keep]
    order = rng.permutation(len(xyz))
    cloud = PointCloud(xyz[order].astype(np.float32), colors=rgb[order])
    return Asset(name, cloud=cloud), labels[order]


def _scanned(
    truth: ArticulatedObject, number: dict[str, int], points: int, front: Direction
) -> tuple[Asset, Int16]:
    """A scan by simulated depth cameras; points on no surface are labelled -1.

    Args:
        number: the label of each link.
    """
    there = replace(truth, parts=tuple(p for p in truth.parts if p.mesh is not None))
    bounds = np.concatenate([p.bounds for p in there.parts])
    diagonal = float(np.linalg.norm(bounds.max(0) - bounds.min(0)))
    ahead = float(np.arctan2(front[0], -front[1]))
    views = tuple(Camera(ahead + aside, above, 1.6 * diagonal) for aside, above in _CAMERAS)
    settings = ScanSettings(
        views,
        points,
        depth_noise=_DEPTH_NOISE * diagonal / (1.6 * diagonal) ** 2,
        misalignment=_MISALIGNED * diagonal,
    )
    found = simulate_scan(there, settings, np.random.default_rng(len(there.parts)))
    links = np.array([number[p.link] for p in there.parts], np.int16)
    labels = np.where((found.part < 0) | found.smeared, np.int16(-1), links[found.part])
    return Asset(truth.name, cloud=found.cloud), labels


def _seen_from_the_front(
    xyz: Float32, normal: Float32, rng: np.random.Generator, points: int, front: Direction
) -> Int64:
    """(K,) points visible from two views in front and above, as a person holds the scanner."""
    azimuth = np.arctan2(front[1], front[0]) + rng.uniform(-0.4, 0.4) + np.array([-0.4, 0.4])
    directions = np.stack([np.cos(azimuth), np.sin(azimuth), np.full(2, 0.5)], axis=1)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    diagonal = float(np.linalg.norm(np.ptp(xyz, axis=0)))
    visible = visible_from(xyz, directions, 1.2 * diagonal / np.sqrt(len(xyz))) > 0
    visible &= rng.random(len(xyz)) < np.abs(normal @ directions.T).max(1)
    keep = np.nonzero(visible)[0]
    return keep if len(keep) <= points else np.sort(rng.choice(keep, points, replace=False))


def _joined(pieces: list[tuple[int, Mesh]]) -> tuple[Mesh, Int16]:
    """One mesh of all pieces, without textures, and the part of each face."""
    vertices, faces, material, materials, labels = [], [], [], [], []
    offset = 0
    for part, mesh in pieces:
        vertices.append(mesh.vertices)
        faces.append(mesh.faces + offset)
        material.append(mesh.face_material + len(materials))
        materials += mesh.materials
        labels.append(np.full(len(mesh.faces), part, np.int16))
        offset += len(mesh.vertices)
    whole = Mesh(
        np.concatenate(vertices),
        np.concatenate(faces).astype(np.int32),
        np.concatenate(material).astype(np.int32),
        tuple(materials),
    )
    return whole, np.concatenate(labels)


def procedural_objects(
    view: View, points: int, limit: int, least: int, most: int, noise: float = 0.0
) -> Iterator[BenchObject]:
    """Procedural objects that no network was trained on."""
    mode = "one-sided" if view == "one-sided" else "outside"
    name = f"procedural {mode}{' noisy' if noise else ''}"
    made = 0
    seed = _BENCH_SEED
    while made < (limit or 40):
        seed += 1
        data = scan(build(seed), points, mode, noise, seed)
        parts = asked_parts(data.labels, least, most, seed)
        if len(parts) < 2:
            continue
        made += 1
        asset = Asset(f"{data.family} {seed}", cloud=data.cloud)
        yield BenchObject(asset.name, name, asset, data.labels, parts, front=(0.0, -1.0, 0.0))


def room_objects(folder: Path) -> Iterator[BenchObject]:
    """Labelled rooms: ``<name>.ply`` with ``<name>_labels.npz`` beside it.

    The labels are ``instance`` (E,), -1 for none, and ``segment20`` (E,), ScanNet's 20 classes:
    cabinets, doors and refrigerators are picked one by one.

    Raises:
        InputFileError: if there is no such pair, or the labels don't fit the scan.
    """
    pairs = [
        (path, truth)
        for truth in sorted(folder.glob("*_labels.npz"))
        if (path := truth.with_name(truth.name.replace("_labels.npz", ".ply"))).is_file()
    ]
    if not pairs:
        raise InputFileError(
            folder, "holds no labelled scan", "put <name>.ply and <name>_labels.npz there"
        )
    for path, truth in pairs:
        asset = open_asset(path)
        with np.load(truth) as data:
            instance, kind = data["instance"].astype(np.int16), data["segment20"]
        if len(instance) != asset.element_count:
            raise InputFileError(
                truth, f"{len(instance)} labels for {asset.element_count} {asset.element_kind}s"
            )
        parts = []
        for i in np.unique(instance[instance >= 0]):
            members = kind[instance == i]
            if np.bincount(members[members >= 0], minlength=20).argmax() in ROOM_CLASSES:
                parts.append(int(i) + 1)
        labels = (instance + 1).astype(np.int16)
        yield BenchObject(path.stem, "room", asset, labels, tuple(parts), whole=False)
