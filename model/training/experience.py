"""Keeps accepted objects as examples, once they are shown to help on each other.

Every object is predicted without experience, and with that of all others; what was accepted is the
truth. A version takes over where more of the accepted joints come out as they were accepted; kinds
whose objects don't gain from each other aren't used.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import NoReturn

from model.core import codec
from model.core.articulated_object import SegmentedObject
from model.core.codec import CodecError
from model.core.errors import ConfigurationError, InputFileError
from model.core.files import draft_of, write_json, written_to
from model.core.pool import robust_map
from model.core.progress import Progress, attempt, no_progress
from model.evaluation.joint_metrics import ObjectScore, score_object
from model.evaluation.summary import calibrate
from model.evaluation.teaching import accepted_example, helps, with_masks
from model.io.assets.reader import PROVENANCE, load_object
from model.prediction.arti4urdf.predictor import learned_hybrid
from model.prediction.arti4urdf.structure import read_structure
from model.prediction.experience import (
    CURRENT,
    FILE,
    FOLDER,
    LEAST,
    RECORD,
    Experience,
    ObjectExample,
    in_use,
    kind_of,
    load_experience,
    record_of,
    save_experience,
    versions,
)

MOST_CHECKED = 6
"""Accepted objects of a kind that are predicted to see whether it is used."""
AUTOMATIC_KEPT = 5
"""Versions that stay of those that nobody asked for."""


@dataclass(frozen=True)
class Side:
    """Accepted objects, predicted in one way.

    Attributes:
        joints, usable: moving joints, and those that came out as accepted within the tolerances.
        objects: with all joints usable.
        calibration_error: of the confidences.
    """

    joints: int
    usable: int
    objects: int
    calibration_error: float


@dataclass(frozen=True)
class Kind:
    """Accepted objects of one category, without experience, and with that of the others.

    Attributes:
        used: see :func:`model.evaluation.teaching.helps`.
    """

    before: Side
    after: Side
    used: bool


@dataclass(frozen=True)
class Learned:
    """One version.

    Attributes:
        version: number from 1.
        assets: folders of the accepted assets that it knows.
        left_out: names of objects that were left out on demand, and of those whose asset is gone.
        before, after: without experience, and with that of the other objects where it is used.
        taken: whether more joints came out right.
        kinds: category → its objects. automatic: whether nobody asked for it.
    """

    version: int
    assets: tuple[str, ...]
    left_out: tuple[str, ...]
    before: Side
    after: Side
    taken: bool
    kinds: Mapping[str, Kind] = field(default_factory=dict)
    automatic: bool = False


Both = tuple[ObjectScore, ObjectScore]
"""Scores of an object without experience, and with it."""


def learn(
    workspace: Path,
    assets: Sequence[Path],
    left_out: Sequence[str] = (),
    *,
    automatic: bool = False,
    jobs: int = 2,
    progress: Progress = no_progress,
) -> Learned:
    """Learn from accepted assets, and use the version if it is better than none.

    Each object is kept as an example; those of a kind that changed since the last version are
    predicted without experience, and with that of the others. Kinds that don't gain aren't used.

    Args:
        workspace: gets ``learned/<version>``.
        assets: folders of accepted assets. left_out: recorded. automatic: nobody asked for it.

    Raises:
        ConfigurationError: for too few objects with joints.
    """
    earlier, results = _latest(workspace)
    found = _examples(assets, earlier, jobs)
    everything = Experience(tuple(found))
    kinds: dict[str, list[ObjectExample]] = {}
    for example in found:
        kinds.setdefault(kind_of(example.category), []).append(example)
    few = max(map(len, kinds.values()), default=0) < LEAST
    if few and not (automatic and earlier):  # an example that was taken back must go
        raise ConfigurationError(
            f"{len(found)} accepted objects have moving parts; it takes {LEAST} of one kind"
        )
    before: dict[str, list[ObjectExample]] = {}
    for example in earlier.values():
        before.setdefault(kind_of(example.category), []).append(example)
    changed = [k for k in kinds if k not in results or kinds[k] != before.get(k)]
    checked = {o.source: kind for kind in changed for o in kinds[kind][-MOST_CHECKED:]}
    rows: dict[str, list[Both]] = {kind: [] for kind in changed}
    todo = [a for a in assets if a.name in checked]
    compared = robust_map(partial(_compare, everything), todo, jobs)
    for count, (asset, row) in enumerate(compared, start=1):
        progress(count / len(todo), asset.name)
        rows[checked[asset.name]] += [row] if row is not None else []
    for kind, pairs in rows.items():
        sides = [before for before, _ in pairs], [after for _, after in pairs]
        results[kind] = Kind(*map(_side, sides), used=helps(*sides))
    results = {kind: results[kind] for kind in sorted(kinds)}
    unused = tuple(kind for kind, result in results.items() if not result.used)
    alone = _sum(r.before for r in results.values())
    sides = {kind: r.after if r.used else r.before for kind, r in results.items()}
    after = _sum(sides.values())
    learned = Learned(
        1 + max(versions(workspace), default=0),
        tuple(o.source for o in found),
        tuple(left_out),
        alone,
        after,
        after.usable > alone.usable and after.objects >= alone.objects,
        results,
        automatic,
    )
    checked_joints = {kind: (side.usable, side.joints) for kind, side in sides.items()}
    everything = replace(everything, unused=unused, checked=checked_joints)
    learned = keep_version(workspace, learned, everything)
    if learned.taken or automatic:
        use(workspace, learned.version)
    _prune(workspace)
    return learned


def _examples(
    assets: Sequence[Path], earlier: Mapping[str, ObjectExample], jobs: int
) -> list[ObjectExample]:
    """The examples of assets with moving parts, by name; those with masks that didn't change
    aren't read."""
    kept = {a: earlier.get(a.name) for a in assets}
    new = [a for a, o in kept.items() if o is None or o.stamp != _stamp(a) or o.masks is None]
    kept |= dict(robust_map(_example, new, jobs))
    found = (o for o in kept.values() if o is not None and any(p.steps for p in o.parts))
    return sorted(found, key=lambda o: o.source)


def _latest(workspace: Path) -> tuple[dict[str, ObjectExample], dict[str, Kind]]:
    """The examples and results of the newest version that can be read."""
    for version in reversed(versions(workspace)):
        folder = workspace / FOLDER / str(version)
        with suppress(InputFileError, CodecError):
            objects = load_experience(folder / FILE).objects
            kinds = record_of(folder).get("kinds", {})
            return {o.source: o for o in objects}, codec.read(dict[str, Kind], kinds)
    return {}, {}


def _prune(workspace: Path) -> None:
    """Remove all but the newest versions that nobody asked for, and the one in use."""
    folders = [workspace / FOLDER / str(v) for v in versions(workspace)]
    automatic = [f for f in folders if record_of(f).get("automatic")]
    for folder in automatic[:-AUTOMATIC_KEPT]:
        if folder != in_use(workspace):
            shutil.rmtree(folder, ignore_errors=True)


def keep_version(workspace: Path, learned: Learned, experience: Experience) -> Learned:
    """Write a version, under a later number where another run took its own meanwhile.

    Raises:
        InputFileError: where the workspace can't be written.
    """
    with written_to(workspace / FOLDER, "make the workspace writable"):
        while True:
            folder = workspace / FOLDER / str(learned.version)
            try:
                with draft_of(folder, _refuse) as draft:
                    write_json(draft / RECORD, asdict(learned), indent=1, allow_nan=True)
                    save_experience(experience, draft / FILE)
                return learned
            except ConfigurationError:
                learned = replace(learned, version=learned.version + 1)


def _refuse(folder: Path) -> NoReturn:
    raise ConfigurationError(f"{folder} is there already")


def _stamp(asset: Path) -> float:
    """Time at which an asset was written; 0 where it is gone."""
    with suppress(OSError):
        return (asset / PROVENANCE).stat().st_mtime
    return 0.0


def _example(asset: Path) -> ObjectExample | None:
    def read() -> ObjectExample:
        obj = load_object(asset)
        example = with_masks(accepted_example(obj, asset.name), obj)
        return replace(example, stamp=_stamp(asset))

    return attempt([], asset.name, read, None)


def _compare(everything: Experience, asset: Path) -> Both | None:
    """Predict an accepted object without experience, and with that of the others."""

    def compared() -> Both:
        obj = load_object(asset)
        segmented = SegmentedObject(obj.name, obj.parts, obj.category)
        structure = read_structure(segmented)
        before, after = (
            learned_hybrid(known).predict_with_evidence(segmented, structure=structure)[0]
            for known in (None, everything.without(asset.name))
        )
        return (
            score_object(obj, before.tree, confidence=before.confidence),
            score_object(obj, after.tree, confidence=after.confidence),
        )

    return attempt([], asset.name, compared, None)


def _side(scores: Sequence[ObjectScore]) -> Side:
    joints = [j for s in scores for j in s.joints]
    return Side(
        len(joints),
        sum(j.usable for j in joints),
        sum(s.usable for s in scores),
        round(calibrate(scores).ece, 4),
    )


def _sum(sides: Iterable[Side]) -> Side:
    found = list(sides)
    joints = sum(s.joints for s in found)
    errors = sum(s.joints * s.calibration_error for s in found)
    return Side(
        joints,
        sum(s.usable for s in found),
        sum(s.objects for s in found),
        round(errors / max(joints, 1), 4),
    )


def use(workspace: Path, version: int) -> None:
    """Let predictions in a workspace use a version; 0 for none.

    Raises:
        ConfigurationError: where there is no such version.
    """
    there = versions(workspace)
    if version and version not in there:
        listed = ", ".join(map(str, there)) or "none"
        raise ConfigurationError(f"{workspace} has no version {version}; versions: {listed}")
    chosen = version < max(there, default=0)  # a later one that isn't taken changes nothing
    write_json(workspace / FOLDER / CURRENT, {"version": version, "chosen": chosen})
