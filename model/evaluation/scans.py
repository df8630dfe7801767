"""``artiworld bench scans``: reconstructed scans from file to joints, as people deliver them.

Ground-truth objects are scanned as phones do (:mod:`model.data.simulated.depth_camera`), in three
ways: *cleaned by the truth* (upright, in metres, the object alone), *upright* (in metres, on its
table), and *any* (any rotation and scale; the height is given, as a person types it). Each is
prepared, clicked as seen (three rounds), cut, and predicted with names. *Clean* scans have points
on the surfaces alone and should keep them all; they are prepared only.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject, SegmentedObject
from model.core.asset import Asset
from model.core.errors import ArtiworldError
from model.core.geometry import merged, uniform_scale
from model.core.joint import Joint, same_motion
from model.core.pool import robust_map
from model.core.progress import Progress, no_progress
from model.core.tree import KinematicTree
from model.data.registry import DatasetOptions, open_dataset
from model.data.simulated.depth_camera import (
    Reconstruction,
    ReconstructionSettings,
    reconstruct_scan,
)
from model.evaluation.bench import Half, half_of
from model.evaluation.joint_metrics import chain
from model.evaluation.segmentation_clicks import front_of, picture_of, visible_rounds
from model.geometry.cleaning import OBJECT
from model.geometry.crop import crop
from model.geometry.prepare import PrepareSettings, moved, prepare
from model.geometry.sampling import sample_surface
from model.geometry.splitting import split
from model.prediction.registry import DEFAULT, load_predictor
from model.segmentation.prompts import BASE
from model.segmentation.registry import load_segmenter

Frame = Literal["cleaned by the truth", "upright", "any", "clean, even", "clean, uneven"]
CLEAN: dict[Frame, float] = {"clean, even": 1.0, "clean, uneven": 0.1}
"""Density of what faces away from one side, in that of what faces it."""
FRAMES: tuple[Frame, ...] = ("cleaned by the truth", "upright", "any", *CLEAN)

AXIS, LINE = 0.15, 0.06
"""Radians between the axes, and diagonals from the true axis line, up to which a joint is right."""
LEVEL = np.radians(2)
"""Radians up to which up counts as found."""
SQUARE, SIZED = np.radians(0.5), 0.01
"""Radians to a quarter turn, and share of the object's size, up to which its frame is right."""
CLEAN_POINTS, KEPT = 20_000, 0.995
"""Points of a clean scan, and the share of them from which it counts as kept."""

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class ScansConfig:
    """Objects and scans to measure.

    Attributes:
        data: the objects.
        half: see :func:`~model.evaluation.bench.half_of`.
        limit: objects of that half; 0 for all.
        seed: random seed of the shuffle and the scans.
        frames: of :data:`FRAMES`.
        points: of a scan.
        predictor: name.
        jobs: processes.
    """

    data: DatasetOptions
    half: Half = "table"
    limit: int = 15
    seed: int = 0
    frames: tuple[Frame, ...] = FRAMES
    points: int = 220_000
    predictor: str = DEFAULT
    jobs: int = 2


@dataclass(frozen=True)
class ScanScore:
    """Result for one scan.

    Attributes:
        id, frame: of the object, and how it was delivered.
        up_error: radians; 0 where up was given.
        yaw_error: radians to the nearest quarter turn of the object's own axes.
        size_error: greatest difference of an extent from the true one, as a share of it.
        kept: share of the object's points that preparing keeps.
        iou: after each round, of the moving parts that are seen.
        clicks, drops: how many, and how many of them lowered the mean IoU by more than
            :data:`~model.evaluation.segmentation_clicks.DROP`.
        joints, right: true moving joints, and those that were predicted right.
        extra: moving joints that the object hasn't.
        seconds: of preparing, encoding, the clicks together, and predicting.
        problem: why it ended early, or "".
    """

    id: str
    frame: Frame
    up_error: float = 0.0
    yaw_error: float = 0.0
    size_error: float = 0.0
    kept: float = 0.0
    iou: tuple[float, ...] = ()
    clicks: int = 0
    drops: int = 0
    joints: int = 0
    right: int = 0
    extra: int = 0
    seconds: tuple[float, ...] = ()
    problem: str = ""

    @property
    def whole(self) -> bool:
        """True if every joint of the object is right and none is extra."""
        return not self.problem and self.joints == self.right > 0 and not self.extra


def run(config: ScansConfig, progress: Progress = no_progress) -> list[ScanScore]:
    """Measure; objects whose process dies are counted as problems."""
    ids = half_of(open_dataset(config.data).ids(), config.half, config.seed, config.limit)
    out: list[ScanScore] = []
    for k, (name, found) in enumerate(robust_map(partial(score_object, config), ids, config.jobs)):
        out += found or [ScanScore(name, frame, problem="crashed") for frame in config.frames]
        progress((k + 1) / len(ids), name)
    return sorted(out, key=lambda s: (FRAMES.index(s.frame), ids.index(s.id)))


def score_object(config: ScansConfig, name: str) -> list[ScanScore]:
    """One object in each frame, from one scan."""
    try:
        truth = open_dataset(config.data).load(name).object
        rng = np.random.default_rng([config.seed, *name.encode()])
        front = _front(truth)
        settings = ReconstructionSettings(
            points=config.points,
            clutter=int(rng.integers(3)),
            ahead=float(np.arctan2(front[0], -front[1])),
        )
        scan = reconstruct_scan(truth, settings, rng)
    except ArtiworldError as error:
        return [ScanScore(name, f, problem=str(error)) for f in config.frames]
    out: list[ScanScore] = []
    for frame in config.frames:
        try:
            if frame in CLEAN:
                out.append(_clean(config, name, frame, truth))
                continue
            out.append(_scored(config, name, frame, truth, scan, front))
        except ArtiworldError as error:
            out.append(ScanScore(name, frame, problem=f"{type(error).__name__}: {error}"))
    return out


def _clean(config: ScansConfig, name: str, frame: Frame, truth: ArticulatedObject) -> ScanScore:
    rng = np.random.default_rng([config.seed, *name.encode()])
    meshes = [p.mesh for p in truth.parts if p.mesh is not None and p.mesh.face_areas.sum() > 0]
    cloud, _ = sample_surface(merged(meshes), 5 * CLEAN_POINTS, rng)
    side = rng.normal(size=3)
    weight = np.clip(np.asarray(cloud.normals) @ side / np.linalg.norm(side), CLEAN[frame], 1.0)
    chosen = rng.choice(len(cloud), CLEAN_POINTS, replace=False, p=weight / weight.sum())
    found = prepare(Asset("clean", cloud=cloud.take(np.sort(chosen))))
    return ScanScore(name, frame, found.levelling.tilt, kept=len(found.kept) / CLEAN_POINTS)


def _scored(
    config: ScansConfig,
    name: str,
    frame: Frame,
    truth: ArticulatedObject,
    scan: Reconstruction,
    front: Array,
) -> ScanScore:
    seconds: list[float] = []
    start = time.perf_counter()

    def lap() -> None:
        nonlocal start
        now = time.perf_counter()
        seconds.append(now - start)
        start = now

    asset, object_from_truth, kept, up_error = _delivered(frame, truth, scan)
    lap()
    x, y, _ = object_from_truth[:3, 0]
    yaw_error = abs((np.arctan2(y, x) + np.pi / 4) % (np.pi / 2) - np.pi / 4)
    extents = [np.ptp(bounds, axis=0) for bounds in (asset.bounds, truth.bounds)]
    found_size, true_size = ([*sorted(e[:2]), e[2]] for e in extents)
    size_error = float(np.max(np.abs(np.divide(found_size, true_size) - 1)))
    frame_errors = up_error, float(yaw_error), size_error
    of_object = float((scan.kind[kept] == OBJECT).sum() / max((scan.kind == OBJECT).sum(), 1))
    part_of = part_numbers(truth)
    index = scan.part[kept]
    labels = np.where(index < 0, -1, part_of[np.maximum(index, 0)]).astype(np.int16)
    session = load_segmenter().encode(asset)
    lap()
    toward = object_from_truth[:3, :3] @ front
    picture = picture_of(asset, toward / np.linalg.norm(toward))
    rounds = visible_rounds(session, picture, labels, 3)
    lap()
    if not rounds.iou:
        return ScanScore(name, frame, *frame_errors, of_object, problem="no moving part is seen")
    names = {int(part_of[k]): p.name for k, p in enumerate(truth.parts) if p.name}
    parts = split(asset, rounds.labels, names)
    guess = load_predictor(config.predictor).predict(
        SegmentedObject(name, parts, truth.category), seed=0
    )
    lap()
    seen = [p for p in rounds.parts if p != BASE]
    right, joints, extra = joints_right(truth, part_of, seen, guess.tree, object_from_truth)
    found = (rounds.iou, rounds.clicks, rounds.drops, joints, right, extra)
    times = tuple(round(s, 3) for s in seconds)
    return ScanScore(name, frame, *frame_errors, of_object, *found, times)


def _delivered(
    frame: Frame, truth: ArticulatedObject, scan: Reconstruction
) -> tuple[Asset, Array, npt.NDArray[np.int64], float]:
    """The prepared asset, (4, 4) asset_from_truth, kept elements, and the error of up (rad)."""
    source = Asset(truth.name, cloud=scan.cloud)
    if frame != "any":
        upright = moved(source, np.linalg.inv(scan.source_from_object).astype(np.float64))
        if frame == "upright":
            found = prepare(upright, PrepareSettings(up=(0, 0, 1)))
            return found.asset, found.object_from_source, found.kept, 0.0
        kept = np.flatnonzero(scan.kind == OBJECT)
        return crop(upright, scan.kind == OBJECT), np.eye(4), kept, 0.0
    height = float(np.ptp(truth.bounds[:, 2]))
    found = prepare(source, PrepareSettings(height=height))
    up = scan.source_from_object[:3, 2]
    cosine = float(np.dot(found.levelling.up, up) / np.linalg.norm(up))
    error = float(np.arccos(np.clip(cosine, -1, 1)))
    return found.asset, found.object_from_source @ scan.source_from_object, found.kept, error


def part_numbers(truth: ArticulatedObject) -> npt.NDArray[np.int64]:
    """(P,) number of each part: 0 for the one that nothing moves, the others from 1 on."""
    links = [p.link for p in truth.parts]
    still = [k for k, link in enumerate(links) if not chain(truth.tree, link, set(links))[1]]
    base = links.index(truth.tree.root) if truth.tree.root in links else (still or [0])[0]
    order = [base, *(k for k in range(len(links)) if k != base)]
    out = np.zeros(len(links), np.int64)
    out[order] = np.arange(len(links))
    return out


def _front(truth: ArticulatedObject) -> Array:
    """(3,) where a person looks at it from: the side that shows most of the moving parts."""
    numbers = part_numbers(truth).tolist()
    pieces = [(n, p.mesh) for n, p in zip(numbers, truth.parts, strict=True) if p.mesh is not None]
    return np.array(front_of(pieces))


def joints_right(
    truth: ArticulatedObject,
    part_of: npt.NDArray[np.int64],
    seen: Sequence[int],
    tree: KinematicTree | None,
    asset_from_truth: Array,
) -> tuple[int, int, int]:
    """Right joints and true joints of the parts that are seen, and extra ones."""
    links = {p.link for p in truth.parts}
    scale = uniform_scale(asset_from_truth[:3, :3])
    diagonal = scale * float(np.linalg.norm(np.ptp(truth.bounds, axis=0)))
    mine = set() if tree is None else {f"link_{n}" for n in [BASE, *seen]} & set(tree.links)
    right = total = extra = 0
    for k, part in enumerate(truth.parts):
        if int(part_of[k]) not in seen:
            continue
        true = list(chain(truth.tree, part.link, links)[1])
        link = f"link_{part_of[k]}"
        found = [] if tree is None or link not in mine else list(chain(tree, link, mine)[1])
        total += len(true)
        extra += max(len(found) - len(true), 0)
        for joint in true:
            hit = next((j for j in found if _agrees(joint, j, asset_from_truth, diagonal)), None)
            if hit is not None:
                found.remove(hit)
                right += 1
    return right, total, extra


def _agrees(true: Joint, found: Joint, asset_from_truth: Array, diagonal: float) -> bool:
    """True if type, axis and, for joints that turn, the axis line are right."""
    linear = asset_from_truth[:3, :3]
    axis = linear @ np.asarray(true.axis)
    origin = linear @ np.asarray(true.origin) + asset_from_truth[:3, 3]
    there = replace(
        true, axis=tuple((axis / np.linalg.norm(axis)).tolist()), origin=tuple(origin.tolist())
    )
    return found.type == true.type and same_motion(found, there, AXIS, LINE * diagonal)


def table(scores: Sequence[ScanScore]) -> Iterator[dict[str, float | str]]:
    """One row a frame; shares in 0..1, seconds are medians of preparing, encoding, clicking and
    predicting together."""
    for frame in FRAMES:
        rows = [s for s in scores if s.frame == frame]
        if not rows:
            continue
        clicked = [s for s in rows if s.iou]
        row: dict[str, float | str] = {"frame": frame, "objects": len(rows)}
        row["up within 2°"] = float(np.mean([s.up_error <= LEVEL for s in rows]))
        if frame not in CLEAN:
            row["yaw within 0.5°"] = float(np.mean([s.yaw_error <= SQUARE for s in rows]))
            row["size within 1 %"] = float(np.mean([s.size_error <= SIZED for s in rows]))
        row["kept"] = float(np.mean([s.kept for s in rows]))
        row[f"kept {KEPT:.1%}"] = float(np.mean([s.kept >= KEPT for s in rows]))
        if frame in CLEAN:
            yield row
            continue
        for k in range(3):
            row[f"IoU@{k + 1}"] = float(np.mean([s.iou[k] for s in clicked] or [0.0]))
        row["drops"] = sum(s.drops for s in rows) / max(sum(s.clicks for s in rows), 1)
        row["joints right"] = sum(s.right for s in rows) / max(sum(s.joints for s in rows), 1)
        row["objects right"] = float(np.mean([s.whole for s in rows]))
        row["seconds"] = float(np.median([sum(s.seconds) for s in clicked] or [0.0]))
        yield row
