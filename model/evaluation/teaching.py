"""``artiworld bench teach``: predictions after a few objects of each kind were accepted.

Of each kind the first objects are accepted as they truly are; the others are predicted alone and
with these examples, with names and without, and the corrections that a person needs are counted.
Their parts are the true ones, or found in their meshes by clicks or *All parts*, and then named as
the true ones that they match. As in a workspace, only kinds are used whose examples help each
other.
"""

from __future__ import annotations

import itertools
import re
import statistics
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, TypeVar

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject, Part, Prediction, SegmentedObject
from model.core.asset import Asset
from model.core.errors import ConfigurationError
from model.core.geometry import Mesh, merged, merged_clouds
from model.core.pool import robust_map, time_limit
from model.core.progress import Progress, no_progress
from model.data.registry import DatasetOptions, open_dataset, select
from model.evaluation.joint_metrics import JointScore, ObjectScore, UsableLimits, score_object
from model.evaluation.part_matching import match_parts, sampled_parts
from model.evaluation.segmentation_clicks import front_of, picture_of, visible_rounds
from model.evaluation.summary import calibrate
from model.geometry.splitting import split
from model.prediction.arti4urdf.predictor import learned_hybrid
from model.prediction.arti4urdf.structure import read_structure
from model.prediction.experience import Experience, ObjectExample, example_of, part_name
from model.prediction.experience import kind_of as example_kind
from model.segmentation.all_parts import mask_examples, propose_parts
from model.segmentation.default import DefaultSegmenter
from model.segmentation.similar import MaskTable

SPLITS = {"choose": "train:0.5", "table": "test:0.5", "all": "all"}
"""Half → split, see :func:`model.data.registry.select`."""
SECONDS = 300.0
"""Time limit of an object."""
WAYS = (True, False), (False, True)
"""With names and without, each alone and with examples."""
ROUNDS = 2
"""Clicks on each part, see :func:`.visible_rounds`."""
Parts = Literal["truth", "clicks", "all"]
Counts = tuple[int, int, int]
Object = TypeVar("Object", ArticulatedObject, SegmentedObject)
_LIMITS = UsableLimits()


@dataclass(frozen=True)
class TeachConfig:
    """Objects to measure.

    Attributes:
        data: the objects. half: key of :data:`SPLITS`. examples: of each kind.
        limit: predicted objects of each kind; 0 for all. jobs: processes.
        parts: of the predicted objects.
    """

    data: DatasetOptions
    half: str = "table"
    examples: int = 3
    limit: int = 0
    jobs: int = 2
    parts: Parts = "truth"


@dataclass(frozen=True)
class Taught:
    """One object, predicted in one way.

    Attributes:
        kind: of the object. names, examples: whether it was predicted with them.
        score: against the truth. corrections: see :func:`corrections`.
        parts: numbers of moving ones that were found, of right ones, and of true ones.
    """

    kind: str
    names: bool
    examples: bool
    score: ObjectScore
    corrections: int
    parts: Counts = (0, 0, 0)


def kind_of(object_id: str, category: str | None) -> str:
    """The category, or the id without its numbers."""
    return (category or re.sub(r"[\W\d_]+$", "", object_id) or "object").lower()


def run(config: TeachConfig, progress: Progress = no_progress) -> list[Taught]:
    """Measure every kind that has more objects than examples.

    Raises:
        ConfigurationError: where no kind has.
    """
    dataset = open_dataset(config.data)
    kinds: dict[str, list[str]] = {}
    for i in select(dataset, SPLITS[config.half]):
        kinds.setdefault(kind_of(i, dataset.category(i)), []).append(i)
    shown = {i: k for k, ids in kinds.items() for i in ids[: config.examples]}
    last = config.examples + config.limit if config.limit else None
    asked = {
        i: kind
        for kind, ids in kinds.items()
        for i in (ids[config.examples : last] if config.examples else ids)
    }
    if not asked:
        raise ConfigurationError(f"no kind has more than {config.examples} objects")
    read = robust_map(partial(_examples, config), list(shown), config.jobs)
    found = sorted((i, both) for i, both in read if both is not None)
    known = {
        names: Experience(tuple(both[k] for _, both in found))
        for k, names in enumerate((True, False))
    }
    given = replace(config, parts="truth")
    in_turn = robust_map(partial(_predicted, given, known, shown), list(shown), config.jobs)
    left_out = [row for _, found_rows in in_turn for row in found_rows or []]
    known = {names: checked(known[names], left_out, names) for names in known}
    rows: dict[str, list[Taught]] = {}
    predicted = partial(_predicted, config, known, asked)
    for i, results in robust_map(predicted, list(asked), config.jobs):
        rows[i] = results or []
        progress(len(rows) / len(asked), i)
    return [row for i in asked for row in rows[i]]


def _bare(obj: Object) -> Object:
    parts = tuple(Part(p.link, p.mesh, p.cloud) for p in obj.parts)
    return replace(obj, parts=parts, category=None)


def _examples(config: TeachConfig, object_id: str) -> tuple[ObjectExample, ...] | None:
    """The example of an object with names, and without."""
    try:
        with time_limit(SECONDS):
            truth = _loaded(config.data, object_id)
            named, bare = (accepted_example(o, object_id) for o in (truth, _bare(truth)))
            if config.parts == "all":
                named = with_masks(named, truth)
            return named, replace(bare, masks=named.masks)
    except Exception:  # the boundary of a job
        return None


def accepted_example(obj: ArticulatedObject, source: str) -> ObjectExample:
    """The example of an accepted object, which knows what is predicted without experience."""
    segmented = SegmentedObject(obj.name, obj.parts, obj.category)
    structure = read_structure(segmented)
    found, _ = learned_hybrid(None).predict_with_evidence(segmented, structure=structure)
    score = score_object(obj, found.tree)
    wrong = {j.child for j in score.joints if not j.usable} | {child for child, _ in score.extra}
    foreseen = {p.link for p in obj.parts} - wrong
    return example_of(obj, source, structure.sampled, foreseen)


def with_masks(example: ObjectExample, obj: ArticulatedObject) -> ObjectExample:
    """An accepted object's example with what *All parts* learns from it."""
    asset, labels = whole(obj)
    names = [part_name(p.name) for p in _base_first(obj)]
    masks = mask_examples(DefaultSegmenter().encode(asset), labels, names)
    return replace(example, masks=masks)


def _base_first(obj: ArticulatedObject) -> list[Part]:
    return sorted(obj.parts, key=lambda p: p.link != obj.tree.root)


def whole(obj: ArticulatedObject) -> tuple[Asset, npt.NDArray[np.int16]]:
    """The scan of all parts, or their mesh, and (E,) the part of each element, the base first."""
    parts = _base_first(obj)
    clouds = [p.cloud for p in parts if p.cloud is not None]
    if len(clouds) == len(parts):
        asset, counts = Asset(obj.name, cloud=merged_clouds(clouds)), [len(c) for c in clouds]
    else:
        empty = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
        meshes = [p.mesh or empty for p in parts]
        asset, counts = Asset(obj.name, mesh=merged(meshes)), [len(m.faces) for m in meshes]
    return asset, np.repeat(np.arange(len(parts)), counts).astype(np.int16)


def checked(known: Experience, left_out: Sequence[Taught], names: bool) -> Experience:
    """Experience without the kinds whose objects don't gain from each other's example, and with
    how often each kind is right.

    Args:
        left_out: each object, predicted alone and with the examples of the others.
    """
    unused, right = [], {}
    for kind in sorted({example_kind(o.category) for o in known.objects}):
        sources = {o.source for o in known.objects if example_kind(o.category) == kind}
        own = [r for r in left_out if r.names == names and r.score.object_id in sources]
        alone, after = ([r.score for r in own if r.examples == e] for e in (False, True))
        if not helps(alone, after):
            unused, after = [*unused, kind], alone
        right[kind] = _right(after)[1], sum(len(s.joints) for s in after)
    return replace(known, unused=tuple(unused), checked=right)


def helps(alone: Sequence[ObjectScore], after: Sequence[ObjectScore]) -> bool:
    """True if a kind's examples cost nothing, and gain something unless no object is right anyway.

    Args:
        alone, after: its accepted objects without experience, and with that of the others.
    """
    usable, joints = _right(alone)
    now, now_joints = _right(after)
    gains = (now, now_joints) != (usable, joints)
    return now >= usable and now_joints >= joints and (gains or not usable)


def _right(scores: Sequence[ObjectScore]) -> tuple[int, int]:
    """Usable objects and joints."""
    return sum(s.usable for s in scores), sum(j.usable for s in scores for j in s.joints)


def _loaded(data: DatasetOptions, object_id: str) -> ArticulatedObject:
    dataset = open_dataset(data)
    truth = dataset.load(object_id).object
    return replace(truth, category=kind_of(object_id, dataset.category(object_id)))


def _predicted(
    config: TeachConfig,
    known: Mapping[bool, Experience],
    kinds: Mapping[str, str],
    object_id: str,
) -> list[Taught]:
    rows: list[Taught] = []
    kind = kinds[object_id]
    try:
        with time_limit(SECONDS):
            truth = _loaded(config.data, object_id)
            others = {names: known[names].without(object_id) for names in known}
            found = _parts(truth, config.parts, others[True].masks_of(kind))
            for names, taught in itertools.product(*WAYS):
                parts, counts = found[taught]
                named = SegmentedObject(object_id, parts, truth.category)
                predictor = learned_hybrid(others[names] if taught else None)
                predicted = predictor.predict(named if names else _bare(named))
                score = score_object(
                    truth,
                    predicted.tree,
                    confidence=predicted.confidence,
                    unmatched_parts=counts[0] - counts[1],
                )
                score, needed = replace(score, object_id=object_id), corrections(truth, predicted)
                rows.append(Taught(kind, names, taught, score, needed, counts))
    except Exception:  # the boundary of a job
        failed = ObjectScore(object_id, kind, (), problem="it failed")
        ways = itertools.product(*WAYS)
        rows += [Taught(kind, *way, failed, 0) for way in list(ways)[len(rows) :]]
    return rows


def _parts(
    truth: ArticulatedObject, how: Parts, masks: Sequence[MaskTable]
) -> list[tuple[tuple[Part, ...], Counts]]:
    """The parts that are predicted alone and with examples, and how many were found, are right,
    and are there, the base aside.

    Found ones get links and names of those that they match; what is left is the base.

    Args:
        masks: of accepted objects of its kind.
    """
    base, *moving = _base_first(truth)
    if how == "truth":
        return [(truth.parts, (len(moving), len(moving), len(moving)))] * 2
    asset, true = whole(truth)
    session = DefaultSegmenter().encode(asset)
    if how == "clicks":
        front = front_of([(k, p.mesh) for k, p in enumerate([base, *moving]) if p.mesh is not None])
        found = [visible_rounds(session, picture_of(asset, front), true, ROUNDS).labels] * 2
    else:
        alone = propose_parts(session).labels
        found = [alone, propose_parts(session, known=masks).labels if masks else alone]
    there = sampled_parts(moving)
    out = []
    for labels in found:
        parts = split(asset, labels)
        own = [p for p in parts if p.link != "link_0"]
        matches = match_parts(there, sampled_parts(own))
        links = {"link_0": base.link} | {m.link: m.part for m in matches}
        names = {p.link: p.name for p in truth.parts}
        named = [replace(p, link=links.get(p.link, f"extra_{p.link}")) for p in parts]
        named = tuple(replace(p, name=names.get(p.link)) for p in named)
        out.append((named, (len(own), len(matches), len(moving))))
    return out


def corrections(truth: ArticulatedObject, found: Prediction) -> int:
    """Presses of M and edits that make a prediction right, the fewest for each part.

    A press takes a joint's next alternative. An edit sets a joint's type, parent, axis, place, or
    range.
    """
    tree = found.tree
    if tree is None:
        return sum(j.moves for j in truth.tree.joints) * 2
    fewest = _edits(truth, score_object(truth, tree))
    for child, others in found.alternatives.items():
        for presses, other in enumerate(others, start=1):
            changed = _edits(truth, score_object(truth, tree.with_joint(other)))
            if child in fewest or child in changed:
                least = presses + changed.get(child, 0)
                fewest[child] = min(fewest.get(child, 0), least)
    return sum(fewest.values())


def _edits(truth: ArticulatedObject, score: ObjectScore) -> dict[str, int]:
    """Edits of each part whose joint isn't right."""
    out: dict[str, int] = {}
    for joint in score.joints:
        out[joint.child] = out.get(joint.child, 0) + (0 if joint.usable else _wrong(joint))
    for child, _ in score.extra:
        out[child] = out.get(child, 0) + 1
    return {child: count for child, count in out.items() if count}


def _wrong(joint: JointScore) -> int:
    """Wrong properties of a joint; without its type, its range isn't known either."""
    axis = joint.apd is None or joint.apd > _LIMITS.axis
    place = not axis and joint.opd_line is not None and joint.opd_line > _LIMITS.origin
    kind = not joint.type_right
    return max(1, kind + axis + place + (not joint.parent_right) + (kind or not joint.range_right))


def table(rows: Sequence[Taught]) -> list[dict[str, Any]]:
    """A row for each kind and one for all: figures alone and with examples."""
    kinds = sorted({r.kind for r in rows})
    groups = [("all", rows), *((k, [r for r in rows if r.kind == k]) for k in kinds)]
    return [dict(_figures(title, group)) for title, group in groups]


def _figures(title: str, rows: Sequence[Taught]) -> Iterator[tuple[str, Any]]:
    yield "kind", title
    yield "objects", len({r.score.object_id for r in rows})
    for said, of in (("found", 2), ("right", 0)):
        sides = [[r.parts for r in rows if r.examples == e] for e in (False, True)]
        shares = (sum(p[1] for p in s) / max(1, sum(p[of] for p in s)) for s in sides)
        yield f"parts {said} %", _beside(f"{100 * share:.0f}" for share in shares)
    for names in (True, False):
        sides = [[r for r in rows if r.names == names and r.examples == e] for e in (False, True)]
        said = "names" if names else "no names"
        yield f"objects %, {said}", _beside(_share([r.score.usable for r in s]) for s in sides)
        joints = [[j.usable for r in s for j in r.score.joints] for s in sides]
        yield f"joints %, {said}", _beside(_share(j) for j in joints)
        needed = [statistics.median([r.corrections for r in s] or [0]) for s in sides]
        yield f"corrections, {said}", _beside(f"{n:g}" for n in needed)
        yield f"ECE, {said}", _beside(f"{calibrate([r.score for r in s]).ece:.2f}" for s in sides)


def _share(right: Sequence[bool]) -> str:
    return f"{100 * sum(right) / max(1, len(right)):.0f}"


def _beside(pair: Iterator[str]) -> str:
    return " → ".join(pair)
