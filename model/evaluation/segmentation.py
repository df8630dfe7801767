"""``artiworld bench segment``: simulated clicks, quality and time, beside the baselines."""

from __future__ import annotations

import itertools
import json
import resource
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from rich.console import Console
from rich.table import Table

from model.core.progress import Progress, no_progress
from model.data.registry import DatasetOptions, open_dataset
from model.evaluation.segmentation_clicks import (
    BenchObject,
    View,
    dataset_objects,
    partnet_objects,
    picture_of,
    procedural_objects,
    room_objects,
    visible_click_ious,
)
from model.segmentation.all_parts import propose_parts
from model.segmentation.arrays import Bool, Int16
from model.segmentation.default import DefaultSession
from model.segmentation.prompts import BASE, Click, Prompts, deepest, next_click, next_part_click
from model.segmentation.registry import DEFAULT, SegmentationSession, load_segmenter

DataSet = Literal["partnet", "partnet-one-sided", "partnet-scan", "partnet-mesh",
                  "procedural", "procedural-noisy", "procedural-one-sided", "room",
                  "urdf", "urdf-one-sided", "urdf-scan", "urdf-mesh",
                  "mjcf", "mjcf-one-sided", "mjcf-scan", "mjcf-mesh",
                  "physxnet", "physxnet-one-sided", "physxnet-scan", "physxnet-mesh"]  # fmt: skip
MARKS = (1, 3, 5, 10)
TARGETS = (0.80, 0.85, 0.90)
TABS = (1, 2, 5)
"""Numbers of alternatives after the first click."""
_SHOWN = 100_000
"""Points among which the next click is searched."""


@dataclass(frozen=True)
class BenchConfig:
    """Data sets, segmenters and clicks to measure.

    Attributes:
        data: folder with ``partnet_mobility`` and ``scans/scannet``, or one of these two; for the
            sets of URDFs, of MJCFs and of PhysXNet the folder of those.
        sets: data sets.
        segmenters: registered names.
        limit: objects of each set, 0 for all (40 procedural ones).
        offset: first object of the subset, except of rooms and procedural ones; other offsets give
            other objects.
        points: of each cloud.
        parts: asked for in each object, at most.
        least: elements of a part that is asked for.
        cap: clicks at most.
        first: place of the first click.
        competing: also let all parts compete, one to three clicks each, by deepest points and by
            the visible-click protocol.
    """

    data: Path = Path("../shared/data")
    sets: tuple[DataSet, ...] = ("partnet",)
    segmenters: tuple[str, ...] = (DEFAULT,)
    limit: int = 20
    offset: int = 0
    points: int = 100_000
    parts: int = 8
    least: int = 20
    cap: int = 20
    first: Literal["deepest", "random"] = "deepest"
    competing: bool = True


@dataclass
class BenchRow:
    """Figures of one segmenter on one data set; written to the report under these names.

    Attributes:
        curves: IoU after each click.
        offered: IoU of the first click's answer and of its alternatives (Tab), in order.
        proposed: best IoU of each part with a part of *All parts*, or its base.
        guesses: for each object, proposed parts, those with an IoU over a half with a moving part,
            moving parts, and those found so.
        seen: for each object and round of visible clicks, the IoU of visible pixels and of all.
        reachable: best IoU of each part that any choice of superpoints gives.
        moves: whether each part moves; bases don't.
        left_out: which objects could not be read, and why.
    """

    segmenter: str
    dataset: str
    objects: int = 0
    curves: list[list[float]] = field(default_factory=list)
    offered: list[list[float]] = field(default_factory=list)
    reachable: list[float] = field(default_factory=list)
    proposed: list[float] = field(default_factory=list)
    guesses: list[tuple[int, int, int, int]] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    moves: list[bool] = field(default_factory=list)
    competing: list[list[float]] = field(default_factory=list)
    seen: list[list[tuple[float, float]]] = field(default_factory=list)
    encode_seconds: list[float] = field(default_factory=list)
    click_seconds: list[float] = field(default_factory=list)
    undo_seconds: list[float] = field(default_factory=list)
    encode_cpu: list[float] = field(default_factory=list)
    click_cpu: list[float] = field(default_factory=list)
    peak_megabytes: float = 0.0
    left_out: list[str] = field(default_factory=list)

    def summary(self) -> dict[str, float]:
        """The figures that people compare."""
        out: dict[str, float] = {"objects": self.objects, "parts": len(self.curves)}
        out |= _of_clicks(self.curves, self.offered)
        for number in range(3):
            done = [c[number] for c in self.competing]
            out[f"all@{number + 1}"] = float(np.mean(done)) if done else float("nan")
            if self.seen:
                there, whole = np.mean([s[number] for s in self.seen], axis=0)
                out[f"seen all@{number + 1}"] = float(there)
                out[f"seen all@{number + 1}, hidden too"] = float(whole)
        if self.reachable:
            out["cells IoU"] = _mean(self.reachable)
            for target in (TARGETS[0], TARGETS[-1]):
                at_once = [[value] for value in self.reachable]
                out[f"cells NoC@{round(100 * target)}"] = _mean(
                    [_clicks_to(c, target) for c in at_once]
                )
        if self.guesses:
            number, right, there, found = np.sum(self.guesses, axis=0)
            out["proposed IoU"] = float(np.mean(self.proposed))
            out["proposed parts"] = float(number / len(self.guesses))
            out["proposed right %"] = 100 * float(right / max(number, 1))
            out["proposed found %"] = 100 * float(found / max(there, 1))
        if not all(self.moves):
            figures = _of_clicks(
                list(itertools.compress(self.curves, self.moves)),
                list(itertools.compress(self.offered, self.moves)),
            )
            out |= {f"moving {name}": value for name, value in figures.items()}
        out["encode s"] = _quantile(self.encode_seconds, 0.5)
        out["click p50 ms"] = 1000 * _quantile(self.click_seconds, 0.5)
        out["click p95 ms"] = 1000 * _quantile(self.click_seconds, 0.95)
        # Processor time doesn't depend on the machine's other work.
        out["encode cpu s"] = _quantile(self.encode_cpu, 0.5)
        out["click cpu p50 ms"] = 1000 * _quantile(self.click_cpu, 0.5)
        out["click cpu p95 ms"] = 1000 * _quantile(self.click_cpu, 0.95)
        out["undo ms"] = 1000 * _quantile(self.undo_seconds, 0.95)
        out["peak MB"] = self.peak_megabytes
        return out


@dataclass
class BenchReport:
    """All rows of a run and its settings."""

    config: BenchConfig
    rows: list[BenchRow]

    def to_json(self) -> str:
        """Settings, summaries and curves."""
        rows = [{**asdict(r), "summary": r.summary()} for r in self.rows]
        config = {k: str(v) if isinstance(v, Path) else v for k, v in asdict(self.config).items()}
        return json.dumps({"config": config, "rows": rows}, indent=1)

    def print_table(self) -> None:
        """Print the summaries."""
        table = Table(title="Segmentation by simulated clicks")
        table.add_column("figure")
        for row in self.rows:
            table.add_column(f"{row.segmenter}\n{row.dataset}", justify="right")
        summaries = [r.summary() for r in self.rows]
        for name in dict.fromkeys(n for s in summaries for n in s):
            digits = 3 if "IoU" in name or "all@" in name else 1
            cells = (f"{s[name]:.{digits}f}" if name in s else "" for s in summaries)
            table.add_row(name, *cells)
        console = Console()
        console.print(table)
        for line in dict.fromkeys(line for row in self.rows for line in row.left_out):
            console.print(f"left out: {line}", markup=False, highlight=False)


def run(config: BenchConfig, progress: Progress = no_progress) -> BenchReport:
    """Measure; the same settings give the same figures, except times."""
    rows = []
    for name in config.segmenters:
        segmenter = load_segmenter(name)
        for data in config.sets:
            row = BenchRow(name, data)
            for number, item in enumerate(bench_objects(config, data, row.left_out)):
                progress(number / max(config.limit or 79, 1) % 1.0, f"{name}: {item.name}")
                begin, busy = time.perf_counter(), time.process_time()
                session = segmenter.encode(item.asset)
                row.encode_seconds.append(time.perf_counter() - begin)
                row.encode_cpu.append(time.process_time() - busy)
                row.objects += 1
                one_against_the_rest(session, item, config, row, number)
                if config.competing and item.whole:
                    all_competing(session, item, row)
                    _visible_clicks(session, item, row)
                if isinstance(session, DefaultSession):
                    _reachable(session, item, row)
                    if item.whole:
                        _proposal(session, item, row)
            row.peak_megabytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            rows.append(row)
    return BenchReport(config, rows)


def bench_objects(
    config: BenchConfig, data: DataSet, left_out: list[str] | None
) -> Iterator[BenchObject]:
    """Objects of a data set; ``left_out`` as of :func:`.dataset_objects`."""
    common = (config.points, config.limit, config.least, config.parts)
    if data == "room":
        rooms = config.data / "scans" / "scannet"
        return room_objects(rooms if rooms.is_dir() else config.data)
    if not data.startswith("procedural"):
        name, _, view = data.partition("-")
        seen: View = view or "all"  # type: ignore[assignment]
        if name != "partnet":
            source = open_dataset(DatasetOptions(name, config.data))
            return dataset_objects(source, seen, *common, config.offset, left_out=left_out)
        root = config.data / "partnet_mobility"
        root = root if root.is_dir() else config.data
        return partnet_objects(root, seen, *common, config.offset)
    if data == "procedural":
        return procedural_objects("all", *common)
    if data == "procedural-noisy":
        return procedural_objects("all", *common, noise=0.001)
    return procedural_objects("one-sided", *common, noise=0.001)


class _Pointer:
    """Turns elements into clicks, and thins large clouds for finding the next one.

    Elements of no part (a scan's outliers) are neither clicked nor counted.
    """

    def __init__(self, item: BenchObject) -> None:
        self.centers = item.asset.element_centers
        self.weight = (
            item.asset.mesh.face_areas
            if item.asset.mesh is not None
            else np.ones(len(self.centers))
        ) * (item.labels >= 0)
        step = max(len(self.centers) // _SHOWN, 1)
        self.shown = np.arange(0, len(self.centers), step)
        self.shown = self.shown[item.labels[self.shown] >= 0]
        self.points = self.centers[self.shown]

    def click(self, shown: int, part: int, positive: bool = True) -> Click:
        element = int(self.shown[shown])
        x, y, z = self.centers[element]
        return Click((float(x), float(y), float(z)), part, positive, element)

    def iou(self, answer: Bool, truth: Bool) -> float:
        """By area on meshes, by points on clouds."""
        union = self.weight[answer | truth].sum()
        return float(self.weight[answer & truth].sum() / max(union, 1e-12))


def one_against_the_rest(
    session: SegmentationSession, item: BenchObject, config: BenchConfig, row: BenchRow, seed: int
) -> None:
    """Click each part alone until it is right or ``config.cap`` clicks are made."""
    pointer = _Pointer(item)
    rng = np.random.default_rng([seed, 11])
    if isinstance(session, DefaultSession):
        # This protocol asks for the base, too, which people don't click.
        session = session.including_base()
    for part in item.parts:
        truth = item.labels == part
        small = truth[pointer.shown]
        if not small.any():
            continue
        if config.first == "deepest":
            start = deepest(pointer.points, small)
        else:
            start = int(rng.choice(np.nonzero(small)[0]))
        clicks = [pointer.click(start, 1)]
        curve: list[float] = []
        while True:
            labels = _timed(session, clicks, row.click_seconds, row.click_cpu)
            answer = labels == 1
            curve.append(pointer.iou(answer, truth))
            done = curve[-1] >= TARGETS[-1] and len(curve) >= max(MARKS)
            if done or len(curve) == config.cap:
                break
            found = next_click(pointer.points, small, answer[pointer.shown])
            if found is None:
                break
            clicks.append(pointer.click(found[0], 1, found[1]))
        if len(clicks) > 1:
            _timed(session, clicks[:-1], row.undo_seconds, [])
        one = Prompts(tuple(clicks[:1]))
        others = session.candidates(one, 1)
        row.offered.append([curve[0], *(pointer.iou(mask, truth) for mask in others)])
        row.curves.append(curve)
        row.names.append(f"{item.name}/{part}")
        row.moves.append(part != BASE)


def all_competing(session: SegmentationSession, item: BenchObject, row: BenchRow) -> None:
    """One click on each part, then on the largest error, up to three clicks a part."""
    pointer = _Pointer(item)
    truth = item.labels[pointer.shown]
    parts = list(item.parts)
    # Parts that aren't asked for count as base.
    truth = np.where(np.isin(truth, parts), truth, 0)
    full = np.where(np.isin(item.labels, parts), item.labels, 0)
    clicks = [pointer.click(deepest(pointer.points, truth == p), p) for p in parts]
    result: list[float] = []
    labels = item.labels
    for number in range(len(parts), 3 * len(parts) + 1):
        if number > len(parts):
            found = next_part_click(pointer.points, truth, labels[pointer.shown])
            if found is not None:
                clicks.append(pointer.click(found[0], found[1]))
        labels = session.segment(Prompts(tuple(clicks))).labels
        if number % len(parts) == 0:
            result.append(float(np.mean([pointer.iou(labels == p, full == p) for p in parts])))
    row.competing.append(result)


def _visible_clicks(session: SegmentationSession, item: BenchObject, row: BenchRow) -> None:
    """All parts by the visible-click protocol."""
    picture, weight = picture_of(item.asset, item.front), _Pointer(item).weight
    rounds = visible_click_ious(session, picture, item.labels, weight)
    if rounds:
        row.seen.append(rounds)


def _reachable(session: DefaultSession, item: BenchObject, row: BenchRow) -> None:
    """Best IoU by superpoints: those most of which a part has, as many as its IoU gains from."""
    encoding, weight = session.encoding, _Pointer(item).weight
    superpoint = encoding.superpoints.of_node[encoding.nodes.elements.node_of_element]
    size = np.bincount(superpoint, weight, len(encoding.superpoints))
    for part in item.parts:
        own = np.bincount(superpoint, weight * (item.labels == part), len(size))
        if own.sum() > 0:
            order = np.argsort(-own / np.maximum(size, 1e-12), kind="stable")
            inside, taken = np.cumsum(own[order]), np.cumsum(size[order])
            row.reachable.append(float((inside / (taken + own.sum() - inside)).max()))


def _proposal(session: DefaultSession, item: BenchObject, row: BenchRow) -> None:
    """*All parts* before any click."""
    pointer, labels = _Pointer(item), propose_parts(session).labels
    proposed = [labels == p for p in np.unique(labels)]
    for part in item.parts:
        row.proposed.append(max(pointer.iou(m, item.labels == part) for m in proposed))
    moving = [item.labels == p for p in np.unique(item.labels[item.labels > BASE])]
    guesses = [labels == p for p in np.unique(labels[labels > BASE])]
    overlap = np.array([pointer.iou(m, link) for m in guesses for link in moving])
    hit = overlap.reshape(len(guesses), len(moving)) > 0.5
    right, found = int(hit.any(1).sum()), int(hit.any(0).sum())
    row.guesses.append((len(guesses), right, len(moving), found))


def _timed(
    session: SegmentationSession, clicks: list[Click], seconds: list[float], cpu: list[float]
) -> Int16:
    begin, busy = time.perf_counter(), time.process_time()
    labels = session.segment(Prompts(tuple(clicks))).labels
    seconds.append(time.perf_counter() - begin)
    cpu.append(time.process_time() - busy)
    return labels


def _of_clicks(curves: list[list[float]], offered: list[list[float]]) -> dict[str, float]:
    """The field's figures for the IoU after each click."""
    out: dict[str, float] = {}
    for mark in MARKS:
        out[f"IoU@{mark}"] = _mean([c[min(mark, len(c)) - 1] for c in curves])
    for tabs in TABS:
        out[f"IoU@1 best of {1 + tabs}"] = _mean([max(o[: 1 + tabs]) for o in offered])
    for target in TARGETS:
        out[f"NoC@{round(100 * target)}"] = _mean([_clicks_to(c, target) for c in curves])
    drops = [b < a - 0.05 for c in curves for a, b in itertools.pairwise(c)]
    out["drops %"] = 100 * float(np.mean(drops)) if drops else 0.0
    return out


def _mean(values: list[float] | list[int]) -> float:
    return float(np.mean(values)) if values else float("nan")


def _clicks_to(curve: list[float], target: float) -> int:
    """Clicks until ``target``; a failure counts 20."""
    reached = [i + 1 for i, value in enumerate(curve) if value >= target]
    return reached[0] if reached else 20


def _quantile(values: list[float], q: float) -> float:
    return float(np.quantile(values, q)) if values else float("nan")
