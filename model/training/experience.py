"""Keeps what accepted objects say about joints, once that is shown to help on each of them.

Every object is predicted without experience, and with that of all others; what was accepted is the
truth. A version takes over where more of the accepted joints come out as they were accepted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import NoReturn

from model.core.articulated_object import ArticulatedObject, Prediction, SegmentedObject
from model.core.errors import ArtiworldError, ConfigurationError
from model.core.files import draft_of, write_json, written_to
from model.core.pool import robust_map
from model.core.progress import Progress, no_progress
from model.evaluation.joint_metrics import ObjectScore, score_object
from model.evaluation.summary import calibrate
from model.io.assets.reader import load_object
from model.prediction.arti4urdf.predictor import learned_hybrid
from model.prediction.arti4urdf.structure import read_structure
from model.prediction.builder import EXPERIENCE
from model.prediction.experience import (
    CURRENT,
    FILE,
    FOLDER,
    RECORD,
    Experience,
    ObjectExample,
    example_of,
    save_experience,
)

LEAST = 3
"""Accepted objects below which nothing is learned."""


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
class Learned:
    """One version.

    Attributes:
        version: number from 1.
        assets: folders of the accepted assets that it knows.
        left_out: names of objects that were left out on demand, and of those without a usable name.
        before, after: without experience, and with that of the other objects.
        taken: whether it took over.
    """

    version: int
    assets: tuple[str, ...]
    left_out: tuple[str, ...]
    before: Side
    after: Side
    taken: bool


@dataclass(frozen=True)
class _Compared:
    before: ObjectScore
    after: ObjectScore
    followed: frozenset[str]
    """Child links whose joints are as most accepted ones."""

    def right(self) -> list[bool]:
        """One bool for each of those joints: True if predicted as accepted."""
        return [j.usable for j in self.after.joints if j.child in self.followed]

    def trusting(self, trust: float) -> ObjectScore:
        """The score with experience, whose confidences know how far it can be trusted."""
        joints = tuple(
            replace(j, confidence=max(j.confidence or 0.0, trust))
            if j.child in self.followed
            else j
            for j in self.after.joints
        )
        return replace(self.after, joints=joints)


def learn(
    workspace: Path,
    assets: Sequence[Path],
    left_out: Sequence[str] = (),
    *,
    jobs: int = 2,
    progress: Progress = no_progress,
) -> Learned:
    """Learn from accepted assets, and keep the version if it is better than none.

    Args:
        workspace: gets ``learned/<version>``.
        assets: folders of accepted assets. left_out: recorded.

    Raises:
        ConfigurationError: for too few objects whose parts have names.
    """
    examples = [
        found
        for _, found in robust_map(_example, list(assets), jobs)
        if found is not None and found.joints and found.category
    ]
    if len(examples) < LEAST:
        raise ConfigurationError(
            f"{len(examples)} accepted objects have a category and named parts with joints; it "
            f"takes {LEAST}"
        )
    examples.sort(key=lambda e: e.source)
    everything = Experience(tuple(examples))
    known = {e.source for e in examples}
    chosen = [a for a in assets if a.name in known]
    rows: list[_Compared] = []
    for count, (asset, found) in enumerate(
        robust_map(partial(_compare, everything), chosen, jobs), start=1
    ):
        progress(count / len(chosen), asset.name)
        rows += [found] if found is not None else []
    followed = [right for r in rows for right in r.right()]
    trust = (sum(followed) + 1) / (len(followed) + 2)
    before, after = _side([r.before for r in rows]), _side([r.trusting(trust) for r in rows])
    version = 1 + max(versions(workspace), default=0)
    taken = after.usable > before.usable and after.objects >= before.objects
    learned = Learned(version, tuple(sorted(known)), tuple(left_out), before, after, taken)
    learned = keep_version(workspace, learned, Experience(everything.objects, round(trust, 4)))
    if taken:
        use(workspace, learned.version)
    return learned


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


def _example(asset: Path) -> ObjectExample | None:
    try:
        return example_of(load_object(asset), asset.name)
    except ArtiworldError:
        return None


def _compare(everything: Experience, asset: Path) -> _Compared | None:
    """Predict an accepted object without experience, and with that of the others."""
    try:
        accepted = load_object(asset)
        segmented = SegmentedObject(accepted.name, accepted.parts, accepted.category)
        structure = read_structure(segmented)
        (plain, _), (found, evidence) = (
            learned_hybrid(known).predict_with_evidence(segmented, structure=structure)
            for known in (None, everything.without(asset.name))
        )
        followed = frozenset(link for link, e in evidence.items() if EXPERIENCE in e)
        return _Compared(_score(accepted, plain), _score(accepted, found), followed)
    except ArtiworldError:
        return None


def _score(accepted: ArticulatedObject, found: Prediction) -> ObjectScore:
    return score_object(accepted, found.tree, confidence=found.confidence)


def _side(scores: Sequence[ObjectScore]) -> Side:
    joints = [j for s in scores for j in s.joints]
    return Side(
        len(joints),
        sum(j.usable for j in joints),
        sum(s.usable for s in scores),
        round(calibrate(scores).ece, 4),
    )


def versions(workspace: Path) -> list[int]:
    """The versions that were learned, sorted."""
    found = (p.parent.name for p in (workspace / FOLDER).glob(f"*/{FILE}"))
    return sorted(int(name) for name in found if name.isdecimal())


def use(workspace: Path, version: int) -> None:
    """Let predictions in a workspace use a version; 0 for none.

    Raises:
        ConfigurationError: where there is no such version.
    """
    there = versions(workspace)
    if version and version not in there:
        listed = ", ".join(map(str, there)) or "none"
        raise ConfigurationError(f"{workspace} has no version {version}; versions: {listed}")
    write_json(workspace / FOLDER / CURRENT, {"version": version})
