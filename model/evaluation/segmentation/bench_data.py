"""Objects with known parts for ``artiworld bench segment``."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from model.core.articulated_object import ArticulatedObject
from model.core.asset import Asset
from model.core.errors import ArtiworldError, InputFileError
from model.core.geometry import Mesh, PointCloud
from model.data.partnet_mobility import PartNetMobility
from model.data.protocol import Dataset
from model.data.simulated.depth_camera import ScanSettings, simulate_scan
from model.data.simulated.depth_camera import View as Camera
from model.data.simulated.scans import build, scan, visible_from
from model.evaluation.segmentation.visible_clicks import FRONT, picture_of
from model.geometry.sampling import sample_surface
from model.io.open_asset import open_asset
from model.segmentation.arrays import Float32, Int, Int16, Int64

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
"""Those of ScanNet's 20 classes, counted from 0, that a person would pick out of a room."""

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
