"""Training samples: procedural objects, corrupted, with their structure prompts and labels.

Labels are the true joints in terms of the structure prompt's candidates.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject
from model.core.errors import ArtiworldError, ConfigurationError
from model.core.files import draft_of
from model.core.joint import JOINT_KINDS, Joint
from model.core.pool import in_processes
from model.core.progress import Progress, no_progress
from model.data.procedural.corruption import MIXED, corrupted, sometimes
from model.data.procedural.generate import COMPOSITE, family_names, make
from model.data.registry import GroundTruth, recognised, training_ids
from model.evaluation.joint_metrics import UsableLimits, chain, interval_iou
from model.prediction.arti4urdf.structure import (
    SLOTS,
    Structure,
    StructureArrays,
    read_structure,
    structure_arrays,
)
from model.prediction.arti4urdf.vocabulary import SCREW, TYPES
from model.prediction.geometric.context import JointProposal

Array = npt.NDArray[np.float64]

GOOD_AXIS = 0.06
GOOD_LINE = 0.025
"""Largest errors of a correct candidate's axis (rad) and line (diagonals): half those of a usable
joint."""


@dataclass(frozen=True, eq=False)
class Labels:
    """The truth of one object, by part index.

    Attributes:
        parents: (P,), -1 for the root.
        types: (P,) index into ``TYPES``; "fixed" for the root.
        right: (P, SLOTS) candidates with a correct axis and line.
        offered: (P, SLOTS) those with correct limits of their own.
        limits: (P, 2) true limits (rad or diagonals) about the true axis.
        axis: (P, 3) true axis, working frame. line: (P, 3) point of its line nearest to the part's
            centre, relative to the centre; 0 for prismatic joints.
        same_sign: (P, SLOTS) the candidate's axis has the direction of the true one.
    """

    parents: npt.NDArray[np.int64]
    types: npt.NDArray[np.int64]
    right: npt.NDArray[np.bool_]
    offered: npt.NDArray[np.bool_]
    limits: npt.NDArray[np.float32]
    axis: npt.NDArray[np.float32]
    line: npt.NDArray[np.float32]
    same_sign: npt.NDArray[np.bool_]


def label(structure: Structure, truth: ArticulatedObject) -> Labels | None:
    """Labels of ``truth``; None if the vocabulary can't express its tree."""
    sampled = structure.sampled
    links = [s.link for s in sampled.shapes]
    index = {link: i for i, link in enumerate(links)}
    parts = frozenset(links)
    n = len(links)
    parents = np.full(n, -1, np.int64)
    types = np.full(n, TYPES.index("fixed"), np.int64)
    right, offered = np.zeros((n, SLOTS), bool), np.zeros((n, SLOTS), bool)
    same = np.ones((n, SLOTS), bool)
    limits, axes, lines = (np.zeros((n, k), np.float32) for k in (2, 3, 3))
    for i, link in enumerate(links):
        parent, joints = chain(truth.tree, link, parts)
        parents[i] = index.get(parent, -1)
        if parents[i] < 0 or not joints:
            continue
        kind = _kind(joints)
        if kind is None:
            return None
        types[i] = TYPES.index(kind)
        joint = next((j for j in joints if j.rotates), joints[0])
        axis = sampled.frame.object_from_working.T @ np.asarray(joint.axis)
        origin = sampled.frame.to_working(np.asarray(joint.origin)[None])[0]
        arm = origin - sampled.shapes[i].center
        arm = arm - axis * float(arm @ axis)
        limited = next((j for j in joints if j.limited), None)
        scale = sampled.frame.diagonal
        true_limits = _limits(limited, scale)
        axes[i], limits[i] = axis, true_limits
        lines[i] = arm if joint.rotates else 0.0
        for slot, h in enumerate(structure.slots[i]):
            if h is None or JOINT_KINDS[h.type].slides == joint.rotates:
                continue
            right[i, slot], same[i, slot] = _agrees(h, axis, origin, joint.rotates)
            if not right[i, slot]:
                continue
            if kind == "continuous":
                offered[i, slot] = True
                continue
            final = structure.candidate(i, slot)
            assert final is not None
            own = final.travel if kind == TYPES[SCREW] else (final.lower, final.upper)
            if own is None or (kind == "revolute" and h.type == "continuous"):
                continue
            aligned = float(final.axis @ axis) > 0
            offered[i, slot] = _limits_right(own, true_limits, aligned, kind == "revolute")
    if (parents < 0).sum() != 1:
        return None
    return Labels(parents, types, right, offered, limits, axes, lines, same)


def _kind(joints: tuple[Joint, ...]) -> str | None:
    if len(joints) == 1:
        return joints[0].type
    turning = [j for j in joints if j.rotates]
    if len(joints) == 2 and len(turning) == 1:
        a, b = (np.asarray(j.axis) for j in joints)
        if abs(float(a @ b)) > 0.99:
            return TYPES[SCREW]
    return None


def _limits(joint: Joint | None, diagonal: float) -> tuple[float, float]:
    if joint is None or joint.lower is None or joint.upper is None:
        return -math.pi, math.pi
    scale = 1.0 if joint.rotates else diagonal
    return joint.lower / scale, joint.upper / scale


def _agrees(h: JointProposal, axis: Array, origin: Array, rotates: bool) -> tuple[bool, bool]:
    along = float(h.axis @ axis)
    if abs(along) < math.cos(GOOD_AXIS):
        return False, along > 0
    if rotates:
        off = np.linalg.norm(np.cross(axis, h.origin - origin))
        if off > GOOD_LINE:
            return False, along > 0
    return True, along > 0


def _limits_right(
    own: tuple[float, float], true: tuple[float, float], aligned: bool, rotates: bool
) -> bool:
    low, high = own if aligned else (-own[1], -own[0])
    good = UsableLimits()
    near = good.angle if rotates else good.travel
    ends = max(abs(low - true[0]), abs(high - true[1]))
    return interval_iou((low, high), true) >= 0.6 or ends <= 0.7 * near


HELD_OUT = ("Display", "Suitcase", "Pliers", "Kettle", "Oven")
"""The paper's five categories that are never trained on."""
VERSION = 1
BUDGET = 12000
MOST_PARTS = 40


@dataclass(frozen=True, eq=False)
class Sample:
    """The network's input for one object, with its labels.

    Attributes:
        id: family, seed and index. category, names: "" if unknown.
    """

    id: str
    category: str
    names: tuple[str, ...]
    arrays: StructureArrays
    labels: Labels


def training_families() -> tuple[str, ...]:
    """All families but those held out."""
    return tuple(f for f in family_names() if f not in HELD_OUT)


def family_of(families: Sequence[str], index: int) -> str:
    """Family of the object with this index: every fourth is a composite."""
    return COMPOSITE if index % 4 == 3 else families[index % len(families)]


def draw_truth(family: str, seed: int, index: int) -> tuple[GroundTruth, bool]:
    """A procedural object, 35 % clean, else corrupted, and whether it has names."""
    rng = np.random.default_rng([seed, index, 7])
    made = make(family, seed, index)
    named = bool(rng.random() < 0.5)
    if rng.random() < 0.35:
        return GroundTruth(f"{family}_{seed}_{index}", made.object), named
    settings = sometimes(MIXED, rng)
    return corrupted(made, settings, rng, name=f"{family}_{seed}_{index}"), named


def make_sample(truth: GroundTruth, *, named: bool, seed: int) -> Sample | None:
    """The structure prompt and labels of one object; None if it is unusable."""
    segmented = truth.segmented(names=named)
    if not 2 <= len(segmented.parts) <= MOST_PARTS:
        return None
    rng = np.random.default_rng(seed)
    structure = read_structure(segmented, seed, budget=BUDGET)
    labels = label(structure, truth.object)
    if labels is None:
        return None
    arrays = structure_arrays(structure, rng)
    names = tuple(s.name or "" for s in structure.sampled.shapes)
    return Sample(truth.id, segmented.category or "", names, arrays, labels)


def generate_samples(
    families: Sequence[str], seed: int, indices: Sequence[int]
) -> Iterator[Sample | None]:
    """Samples one by one; None for unusable objects."""
    for index in indices:
        truth, named = draw_truth(family_of(families, index), seed, index)
        yield make_sample(truth, named=named, seed=index)


_ARRAYS = tuple(f.name for f in fields(StructureArrays))
_LABELS = tuple(f.name for f in fields(Labels))


def write_shard(samples: Sequence[Sample], path: Path) -> None:
    """Write samples as one file; it appears whole or not at all."""
    out: dict[str, npt.NDArray[np.generic]] = {
        "version": np.array(VERSION),
        "sizes": np.array([len(s.arrays) for s in samples]),
        "ids": np.array([s.id for s in samples]),
        "categories": np.array([s.category for s in samples]),
        "names": np.array(["|".join(s.names) for s in samples]),
    }
    for name in _ARRAYS:
        values = [getattr(s.arrays, name) for s in samples]
        if name == "relations":
            values = [v.reshape(-1, v.shape[-1]) for v in values]
        array = np.concatenate(values)
        out[f"arrays.{name}"] = array.astype(np.float16) if array.dtype == np.float32 else array
    for name in _LABELS:
        out[f"labels.{name}"] = np.concatenate([getattr(s.labels, name) for s in samples])
    with draft_of(path) as draft:
        np.savez(draft, **out)  # type: ignore[arg-type]


def read_shard(path: Path) -> list[Sample]:
    """Read what :func:`write_shard` wrote.

    Raises:
        ConfigurationError: if the file is of another version.
    """
    with np.load(path, allow_pickle=False) as data:
        if int(data["version"]) != VERSION:
            raise ConfigurationError(
                f"{path} has version {int(data['version'])}, this is {VERSION}: make it again"
            )
        columns = {k: data[k] for k in data.files}
    ends = np.cumsum(columns["sizes"])
    squares = np.cumsum(columns["sizes"] ** 2)
    out: list[Sample] = []
    for k, size in enumerate(columns["sizes"]):
        rows = slice(ends[k] - size, ends[k])
        values = {}
        for name in _ARRAYS:
            whole = columns[f"arrays.{name}"]
            if name == "relations":
                cut = whole[squares[k] - size**2 : squares[k]].reshape(size, size, -1)
            else:
                cut = whole[rows]
            if cut.dtype == np.float16:
                cut = np.nan_to_num(cut.astype(np.float32), posinf=8, neginf=-8).clip(-8, 8)
            values[name] = cut
        labels = Labels(**{name: columns[f"labels.{name}"][rows] for name in _LABELS})
        out.append(
            Sample(
                str(columns["ids"][k]),
                str(columns["categories"][k]),
                tuple(str(columns["names"][k]).split("|")),
                StructureArrays(**values),
                labels,
            )
        )
    return out


def make_shards(
    folder: Path,
    count: int,
    *,
    seed: int,
    shard: int = 100,
    jobs: int = 1,
    families: Sequence[str] | None = None,
    progress: Progress = no_progress,
) -> None:
    """Fill ``folder`` with shards of ``shard`` objects in ``jobs`` processes (0: one per core).

    Existing shards are kept.
    """
    folder.mkdir(parents=True, exist_ok=True)
    numbers = [k for k in range(math.ceil(count / shard)) if not _path(folder, seed, k).exists()]
    write = partial(_write_one, folder, count, seed, shard, families)
    jobs = min(jobs or os.cpu_count() or 1, len(numbers))
    if jobs <= 1:
        for done, number in enumerate(numbers):
            write(number)
            progress((done + 1) / len(numbers), f"{(done + 1) * shard} objects")
        return
    with in_processes(write, numbers, jobs, "spawn") as waiting:
        for done, job in enumerate(as_completed(waiting)):
            job.result()
            progress((done + 1) / len(waiting), f"{(done + 1) * shard} objects")


def _path(folder: Path, seed: int, number: int) -> Path:
    return folder / f"{seed:04d}_{number:05d}.npz"


def _write_one(
    folder: Path, count: int, seed: int, shard: int, families: Sequence[str] | None, number: int
) -> None:
    indices = range(number * shard, min(count, (number + 1) * shard))
    found = generate_samples(families or training_families(), seed, indices)
    kept = [s for s in found if s is not None]
    if kept:
        write_shard(kept, _path(folder, seed, number))


def write_dataset(
    root: Path,
    folder: Path,
    *,
    held_out: bool = False,
    test_share: float = 0.0,
    progress: Progress = no_progress,
) -> tuple[int, list[str]]:
    """Add a shard of the objects under ``root``, each with and without names.

    Args:
        root: of PartNet-Mobility or PhysXNet. folder: of the shards.
        held_out, test_share: see :func:`model.data.registry.training_ids`.
        progress: reports each object.

    Returns:
        Number of samples, and the errors of unreadable objects.

    Raises:
        InputFileError: if ``root`` is no such folder.
    """
    dataset = recognised(root)
    ids = training_ids(dataset, held_out=held_out, test_share=test_share)
    kept: list[Sample] = []
    bad: list[str] = []
    for k, object_id in enumerate(ids):
        progress(k / len(ids), object_id)
        try:
            truth = dataset.load(object_id)
            made = [make_sample(truth, named=named, seed=k) for named in (True, False)]
        except ArtiworldError as error:
            bad.append(str(error))
            continue
        kept += [s for s in made if s is not None]
    if kept:
        folder.mkdir(parents=True, exist_ok=True)
        write_shard(kept, folder / f"data_{root.resolve().name}.npz")
    return len(kept), bad
