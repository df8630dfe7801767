"""A simulated annotator: how much work the software saves a person. It turns a session's joints
into the ground truth by the app's commands.
"""

from __future__ import annotations

import tempfile
import zlib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject, Part, Prediction, SegmentedObject
from model.core.asset import Asset
from model.core.errors import ConfigurationError
from model.core.geometry import PointCloud
from model.core.joint import Joint
from model.core.pool import time_limit
from model.core.tree import KinematicTree
from model.data.registry import DatasetOptions, open_dataset
from model.evaluation.joint_metrics import (
    UsableLimits,
    axis_angle,
    chain,
    compare_ranges,
    path,
    point_to_line,
    score_object,
)
from model.geometry.sampling import sample_surface
from model.geometry.splitting import split
from model.prediction.geometric.roles import change_joint_type
from model.prediction.registry import DEFAULT, load_predictor
from model.segmentation.prompts import BASE, Click, Prompts, deepest, next_part_click
from model.segmentation.registry import load_segmenter
from sessions.commands import (
    AddClick,
    NamePart,
    RecordPrediction,
    RecordSegmentation,
    SetCategory,
    SetJoint,
    SetRoot,
)
from sessions.live import LiveSession
from sessions.store import Store

WHO = "scripted annotator"


class JointCorrector:
    """Corrects one property of a joint at a time: parent, type, axis, origin, direction, one limit.

    Attributes:
        commands: number of corrections so far.
        unreachable: differences that no command can correct, in words.
    """

    def __init__(self, live: LiveSession, truth: ArticulatedObject, limits: UsableLimits) -> None:
        self.live, self.truth, self.limits = live, truth, limits
        self.parts = frozenset(p.link for p in truth.parts)
        corners = np.concatenate([p.bounds for p in truth.parts])
        self.diagonal = float(np.linalg.norm(np.ptp(corners, axis=0))) or 1.0
        self.commands = 0
        self.unreachable: list[str] = []

    def correct(self) -> tuple[int, int]:
        """Correct every joint; return how many were wrong, and the number of commands."""
        wrong = 0
        root = self.truth.tree.root
        if root in self.parts and root in self.tree.links and self.tree.root != root:
            self._do(SetRoot(root))
        for part in (p for p in self.truth.tree.order if p in self.parts):
            before = self.commands
            if part not in self.tree.links:
                self.unreachable.append(f"{part} got no points from the clicks")
                continue
            self._correct_part(part)
            wrong += self.commands > before
        return wrong, self.commands

    @property
    def tree(self) -> KinematicTree:
        """The session's current tree."""
        tree = self.live.document.tree
        assert tree is not None
        return tree

    def _do(self, command: SetJoint | SetRoot) -> None:
        before = self.live.state
        if self.live.do(command, WHO) is not before:
            self.commands += 1

    def _change(self, child: str, **values: Any) -> None:
        self._do(SetJoint(replace(self.tree.joint_of[child], **values)))

    def _correct_part(self, part: str) -> None:
        above, true_chain = chain(self.truth.tree, part, self.parts)
        parent, found = path(self.tree, part, self.parts)
        if above and found and parent != above and above in self.tree.links:
            self._change(found[0].child, parent=above)
            found = path(self.tree, part, self.parts)[1]
        if not true_chain:
            for joint in found:
                if joint.moves:
                    self._change(joint.child, type="fixed", lower=None, upper=None)
            return
        if len(found) != len(true_chain):
            self.unreachable.append(
                f"{part} needs {len(true_chain)} joints in a row, and there are {len(found)}"
            )
            return
        for true, joint in zip(true_chain, found, strict=True):
            self._correct_joint(true, joint.child)

    def _correct_joint(self, true: Joint, child: str) -> None:
        if self.tree.joint_of[child].type != true.type:
            # As on the screen, geometry proposes the joint of that type.
            parts = SegmentedObject(self.truth.name, self.truth.parts, self.truth.category)
            self._do(SetJoint(change_joint_type(parts, self.tree, child, true.type)))
        if axis_angle(true.axis, self.tree.joint_of[child].axis) > self.limits.axis:
            self._change(child, axis=true.axis)
        origin = self.tree.joint_of[child].origin
        off = point_to_line(origin, true.origin, true.axis) / self.diagonal
        if true.rotates and off > self.limits.origin:
            self._change(child, origin=true.origin)
        if true.limited:
            self._correct_range(true, child)

    def _correct_range(self, true: Joint, child: str) -> None:
        def right(joint: Joint) -> bool:
            return compare_ranges(true, joint, self.limits, self.diagonal)[2]

        joint = self.tree.joint_of[child]
        if right(joint):
            return
        turned = replace(joint, axis=tuple(-v if v else 0.0 for v in joint.axis))
        wanted = true if np.dot(true.axis, joint.axis) > 0 else true.flipped()
        other = true if np.dot(true.axis, turned.axis) > 0 else true.flipped()
        if right(turned) or _nearer(other, turned, wanted, joint):
            self._do(SetJoint(turned))
            joint, wanted = turned, other
        assert wanted.lower is not None and wanted.upper is not None
        # One limit at a time, as on the screen; the lower one never exceeds the upper one.
        order = ("upper", "lower") if wanted.upper >= (joint.lower or 0.0) else ("lower", "upper")
        for side in order:
            if not right(self.tree.joint_of[child]):
                self._change(child, **{side: getattr(wanted, side)})


def _nearer(a: Joint, turned: Joint, b: Joint, joint: Joint) -> bool:
    """True if turning the joint corrects more limits than it costs commands."""

    def differing(true: Joint, found: Joint) -> int:
        ends = ((true.lower, found.lower), (true.upper, found.upper))
        return sum(abs((x or 0.0) - (y or 0.0)) > 1e-3 for x, y in ends)

    return differing(a, turned) + 1 < differing(b, joint)


BY_HAND = "by hand"
LEAST_POINTS = 60
"""Fewest points of a part: a person zooms in on small ones."""
MAX_PARTS = 64
"""More than a person would click."""

Labels = npt.NDArray[np.int16]


@dataclass(frozen=True)
class AnnotatorConfig:
    """Settings of the annotator.

    Attributes:
        data: the objects.
        predictors: names; each starts from the same parts.
        segmenter: turns the clicks into parts.
        names: whether the annotator also names the parts and the object's category.
        points: size of the cloud that is annotated.
        target: IoU at which a part is good enough.
        clicks: most clicks per part, on average over the object.
        seed: random seed of sampling and predictors.
        timeout: seconds per object.
        limits: tolerances of a correct joint.
    """

    data: DatasetOptions
    predictors: tuple[str, ...] = (DEFAULT,)
    segmenter: str = "default"
    names: bool = True
    points: int = 30_000
    target: float = 0.9
    clicks: int = 6
    seed: int = 0
    timeout: float = 300.0
    limits: UsableLimits = field(default_factory=UsableLimits)


@dataclass(frozen=True)
class AnnotatorScore:
    """One object with one predictor.

    Attributes:
        predictor: its name, or :data:`BY_HAND`.
        parts, joints: of the ground truth; joints are those that move.
        clicks: until every part was good enough, or no more were allowed.
        part_iou: mean over the parts after the last click.
        wrong: moving joints that needed a correction, or that shouldn't move.
        corrections: commands on joints until the object was correct.
        commands: all commands: clicks, names, the request to predict, corrections.
        right: whether the object is correct at the end.
        why: the reason where it isn't.
    """

    object_id: str
    category: str | None
    predictor: str
    parts: int = 0
    joints: int = 0
    clicks: int = 0
    part_iou: float = 0.0
    wrong: int = 0
    corrections: int = 0
    commands: int = 0
    right: bool = False
    why: str = ""


def annotate(config: AnnotatorConfig, object_id: str) -> list[AnnotatorScore]:
    """Annotate one object with each predictor and by hand; failures become a score's ``why``."""
    try:
        with time_limit(config.timeout), tempfile.TemporaryDirectory() as folder:
            return _Annotator(config, object_id, Path(folder)).run()
    except Exception as error:  # the boundary of a job: the run goes on
        why = f"{type(error).__name__}: {error}"[:300]
        return [AnnotatorScore(object_id, None, p, why=why) for p in (*config.predictors, BY_HAND)]


class _Annotator:
    def __init__(self, config: AnnotatorConfig, object_id: str, folder: Path) -> None:
        self.config = config
        self.id = object_id
        truth = open_dataset(config.data).load(object_id).object
        self.truth, self.part_of = _numbered(truth)
        self.asset, self.labels = _scan(self.truth, config, self.part_of)
        self.store = Store(folder)
        record = self.store.open_object(folder / f"{object_id}.ply", None, object_id)
        self.live = LiveSession(self.store, record.id)

    def run(self) -> list[AnnotatorScore]:
        try:
            clicks, labels, iou = self._click()
            named = self._name() if self.config.names else 0
            parts = split(self.asset, labels, self._names())
            before = AnnotatorScore(
                self.id,
                self.truth.category,
                "",
                parts=len(self.truth.parts),
                joints=sum(j.moves for j in self.truth.tree.joints),
                clicks=clicks,
                part_iou=iou,
            )
            return [
                self._score(before, name, parts, clicks + named)
                for name in (*self.config.predictors, BY_HAND)
            ]
        finally:
            self.store.close()

    def _do(self, command: Any) -> None:
        self.live.do(command, WHO)

    # --- parts

    def _click(self) -> tuple[int, Labels, float]:
        """Click until the parts are good enough; return number of clicks, labels and mean IoU."""
        session = load_segmenter(self.config.segmenter).encode(self.asset)
        points = self.asset.element_centers
        clicks: list[Click] = []
        cap = self.config.clicks * len(self.part_of)
        labels = np.zeros(len(points), np.int16)
        for part in sorted(self.part_of.values()):
            clicks.append(_click(points, deepest(points, self.labels == part), part))
            self._do(AddClick(clicks[-1]))
        while True:
            prompts = Prompts(tuple(clicks))
            answer = session.segment(prompts)
            labels = np.where(answer.labels < 0, BASE, answer.labels).astype(np.int16)
            self._record(labels, answer.segmenter, answer.seconds)
            ious = self._ious(labels)
            found = next_part_click(points, self.labels, labels)
            if ious.min() >= self.config.target or found is None or len(clicks) >= cap:
                return len(clicks), labels, float(ious.mean())
            clicks.append(_click(points, *found))
            self._do(AddClick(clicks[-1]))

    def _record(self, labels: Labels, segmenter: str, seconds: float) -> None:
        ids, counts = np.unique(labels, return_counts=True)
        elements = {int(i): int(n) for i, n in zip(ids, counts, strict=True)}
        ref = self.store.put_array(labels)
        key = self.live.document.key
        self._do(RecordSegmentation(key, ref, segmenter or "segmenter", seconds, elements))

    def _ious(self, labels: Labels) -> npt.NDArray[np.float64]:
        parts = np.array(sorted(self.part_of.values()))[:, None]
        own, given = self.labels == parts, labels == parts
        return (own & given).sum(1) / np.maximum((own | given).sum(1), 1)

    def _name(self) -> int:
        """Name the parts and the category; return the number of commands."""
        before = self.live.state.seq
        for number, name in self._names().items():
            self._do(NamePart(number, name))
        if self.truth.category:
            self._do(SetCategory(self.truth.category))
        return self.live.state.seq - before

    def _names(self) -> dict[int, str]:
        if not self.config.names:
            return {}
        return {self.part_of[p.link]: p.name for p in self.truth.parts if p.name}

    # --- joints

    def _score(
        self, before: AnnotatorScore, name: str, parts: tuple[Part, ...], commands: int
    ) -> AnnotatorScore:
        # In the app part 0 is the base by definition: the predictor needn't guess it.
        named = tuple(
            replace(p, name="base") if p.link == f"link_{BASE}" and p.name is None else p
            for p in parts
        )
        category = self.truth.category if self.config.names else None
        segmented = SegmentedObject(self.id, named, category)
        if name == BY_HAND:
            prediction = Prediction(_all_fixed(segmented), backend=BY_HAND)
        else:
            prediction = load_predictor(name).predict(segmented, seed=self.config.seed)
            commands += 1
        out = replace(before, predictor=name)
        if prediction.tree is None:
            why = "; ".join(prediction.problems) or "the predictor gave no tree"
            return replace(out, commands=commands, why=why)
        segmentation = self.live.document.segmentation
        assert segmentation is not None
        self._do(RecordPrediction(prediction, segmentation.labels))
        corrector = JointCorrector(self.live, self.truth, self.config.limits)
        wrong, corrections = corrector.correct()
        tree = self.live.document.tree
        score = score_object(self.truth, tree, limits=self.config.limits)
        why = "; ".join(corrector.unreachable)
        return replace(
            out,
            wrong=wrong,
            corrections=corrections,
            commands=commands + corrections,
            right=score.usable,
            why=why if not score.usable else "",
        )


def _numbered(truth: ArticulatedObject) -> tuple[ArticulatedObject, dict[str, int]]:
    """The ground truth with its parts numbered as in the app, the root's part first.

    Raises:
        ConfigurationError: where it has more than :data:`MAX_PARTS` parts.
    """
    links = [p.link for p in truth.parts]
    if len(links) > MAX_PARTS:
        raise ConfigurationError(f"{truth.name} has {len(links)} parts; {MAX_PARTS} are the limit")
    first = truth.tree.root if truth.tree.root in links else links[0]
    order = [first, *(x for x in links if x != first)]
    names = {link: f"link_{i}" for i, link in enumerate(order)}
    parts = {p.link: replace(p, link=names[p.link]) for p in truth.parts}
    tree = truth.tree.renamed(names)
    obj = ArticulatedObject(truth.name, tuple(parts[x] for x in order), tree, truth.category)
    return obj, {p.link: i for i, p in enumerate(obj.parts)}


def _scan(
    truth: ArticulatedObject, config: AnnotatorConfig, part_of: dict[str, int]
) -> tuple[Asset, Labels]:
    """The object as one coloured cloud, and the part of each point."""
    rng = np.random.default_rng([config.seed, zlib.crc32(truth.name.encode())])
    areas = [0.0 if p.mesh is None else float(p.mesh.face_areas.sum()) for p in truth.parts]
    whole = sum(areas) or 1.0
    clouds, labels = [], []
    for part, area in zip(truth.parts, areas, strict=True):
        count = max(LEAST_POINTS, round(config.points * area / whole))
        cloud = part.cloud if part.mesh is None else sample_surface(part.mesh, count, rng)[0]
        assert cloud is not None
        clouds.append(cloud)
        labels.append(np.full(len(cloud), part_of[part.link], np.int16))
    order = rng.permutation(sum(map(len, clouds)))
    points = np.concatenate([c.points for c in clouds])[order]
    colors = None
    if all(c.colors is not None for c in clouds):
        colors = np.concatenate([c.colors[:, :3] for c in clouds if c.colors is not None])[order]
    cloud = PointCloud(points.astype(np.float32), colors=colors)
    return Asset(truth.name, cloud=cloud), np.concatenate(labels)[order]


def _click(points: npt.NDArray[np.floating], element: int, part: int) -> Click:
    x, y, z = (float(v) for v in points[element])
    return Click((x, y, z), part, True, int(element))


def _all_fixed(segmented: SegmentedObject) -> KinematicTree:
    """The start by hand: nothing moves, every part is fixed to the base."""
    links = tuple(p.link for p in segmented.parts)
    joints = tuple(
        Joint(f"joint_{link.removeprefix('link_')}", "fixed", links[0], link) for link in links[1:]
    )
    return KinematicTree(links, joints)
