"""Evidence about joints from a workspace's accepted objects of the same category.

Each accepted joint is kept with the name of its part, where its axis lies in the part's box, its
limits, and the name of the part that carries it. A part of the same name in an object of the same
category gets the motion that most of them have, among its own candidates, where that outweighs
what the predictor finds; and their type, limits and parent where they agree. Nothing is trained:
an object that is taken out leaves no trace.
"""

from __future__ import annotations

import json
import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from model.core import codec
from model.core.articulated_object import ArticulatedObject, SegmentedObject
from model.core.errors import InputFileError
from model.core.joint import JOINT_KINDS, JointType
from model.prediction.geometric.sampled_object import SampledObject, sample_object

Array = npt.NDArray[np.float64]
Vector = tuple[float, float, float]

FORMAT = 1
_WORDS = re.compile(r"[a-z0-9]+")
FILE = "experience.json"
FOLDER, CURRENT, RECORD = "learned", "current.json", "record.json"
"""Folder of a workspace's versions, file of the one in use, and file of each one's results."""
SAME_AXIS, SAME_LINE = 0.95, 0.35
"""Least cosine between axes, and most between their lines in half extents of the part's box."""
THIN = 0.25
"""Least half extent of a part's box, as a share of its largest: doors have hardly any depth."""
UNSEEN = 1.0
"""Accepted joints that a motion counts as having without any; fewer trust experience more."""
ENOUGH, MOST = 2, 0.7
"""Accepted objects, and the share of them that must agree, before type, limits or parent follow."""
SPREAD = 0.25
"""Largest deviation of agreed limits, as a share of their range."""


@dataclass(frozen=True)
class JointExample:
    """An accepted joint, in the working frame of its object.

    Attributes:
        name: of its part, in lower-case words.
        parent: of the part that carries it; "" for the base and parts without a name.
        type: of the joint. axis: (3,) unit.
        arm: (3,) from the middle of the part's box to the axis, in half extents; 0 where it slides.
        lower, upper: radians, or extents of the part along the axis.
    """

    name: str
    parent: str
    type: JointType
    axis: Vector = (0.0, 0.0, 1.0)
    arm: Vector = (0.0, 0.0, 0.0)
    lower: float = 0.0
    upper: float = 0.0

    @property
    def rotates(self) -> bool:
        """True if it turns."""
        return JOINT_KINDS[self.type].rotates


@dataclass(frozen=True)
class ObjectExample:
    """The joints of an accepted object; ``source`` names its asset."""

    source: str
    category: str | None
    joints: tuple[JointExample, ...]


@dataclass(frozen=True)
class Motions:
    """The candidates of one part.

    Attributes:
        name: of the part, as people write it.
        axes, arms: (K, 3) as in :class:`JointExample`. turns: (K,) bool.
    """

    name: str | None
    axes: Array
    arms: Array
    turns: npt.NDArray[np.bool_]

    def agree(self, example: JointExample, turn: Array) -> npt.NDArray[np.bool_]:
        """(K,) which have the motion of an example whose object is turned by ``turn`` (3, 3)."""
        if example.type == "fixed":
            return np.zeros(len(self.axes), bool)
        along = np.abs(self.axes @ (turn @ np.asarray(example.axis))) > SAME_AXIS
        if not example.rotates:
            return along & ~self.turns
        off = np.abs(self.arms - turn @ np.asarray(example.arm)).max(axis=1)
        return along & self.turns & (off < SAME_LINE)


@dataclass(frozen=True)
class Recalled:
    """Evidence about one part.

    Attributes:
        objects: accepted objects that have a part of this name.
        agreeing: (K,) of them, those whose joint has each candidate's motion.
        types: shares of the joint types. parents: shares of the parents' names.
        limits: (N, 5) axis (3), lower and upper of joints, this object's working frame.
    """

    objects: int
    agreeing: Array
    types: Mapping[str, float]
    parents: Mapping[str, float]
    limits: Array

    def agreed(self, shares: Mapping[str, float]) -> str | None:
        """Name that most of enough objects have, or None."""
        if self.objects < ENOUGH or not shares:
            return None
        best = max(shares, key=lambda k: shares[k])
        return best if shares[best] >= MOST else None

    def range_about(self, axis: Array) -> tuple[float, float] | None:
        """Lower and upper limit about a (3,) axis, where the accepted joints agree on them."""
        along = self.limits[:, :3] @ axis
        fitting = np.abs(along) > SAME_AXIS
        if fitting.sum() < ENOUGH:
            return None
        ends = self.limits[fitting, 3:]
        ends = np.where(along[fitting, None] < 0, -ends[:, ::-1], ends)
        middle = np.median(ends, axis=0)
        size = float(middle[1] - middle[0])
        near = (np.abs(ends - middle) <= SPREAD * size).all(axis=1)
        if size <= 0 or near.mean() < MOST:
            return None
        return float(middle[0]), float(middle[1])


@dataclass(frozen=True)
class Experience:
    """Accepted objects.

    Attributes:
        objects: the accepted objects.
        trust: share of the joints taken from experience that were right when each object was left
            out in turn, 0..1.
    """

    objects: tuple[ObjectExample, ...]
    trust: float = 0.0

    @cached_property
    def _by_category(self) -> dict[str | None, list[ObjectExample]]:
        out: dict[str | None, list[ObjectExample]] = {}
        for known in self.objects:
            out.setdefault(known.category, []).append(known)
        return out

    def without(self, source: str) -> Experience:
        """Everything but one object."""
        return Experience(tuple(o for o in self.objects if o.source != source), self.trust)

    def recall(self, category: str | None, parts: Mapping[int, Motions]) -> dict[int, Recalled]:
        """Evidence about the parts of an object, by their keys; only for named ones, and none
        without a category."""
        if category is None:
            return {}
        names = {key: part_name(m.name) for key, m in parts.items()}
        votes: dict[int, list[tuple[Array, list[JointExample], Array]]] = {k: [] for k in parts}
        for known in self._by_category.get(category, ()):
            fitting = {
                key: found
                for key, name in names.items()
                if name and (found := [j for j in known.joints if j.name == name])
            }
            if not fitting:
                continue
            # Of several that fit alike the first: most objects face the same way.
            turn = max(_TURNS, key=lambda t: _fit(parts, fitting, t))
            for key, found in fitting.items():
                share = np.mean([parts[key].agree(j, turn) for j in found], axis=0)
                votes[key].append((share, found, turn))
        return {key: _recalled(found) for key, found in votes.items() if found}


def _quarter_turns() -> tuple[Array, ...]:
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    return tuple(np.linalg.matrix_power(quarter, k) for k in range(4))


_TURNS = _quarter_turns()
"""Objects face any of the four horizontal directions of the working frame."""


def _fit(
    parts: Mapping[int, Motions], examples: Mapping[int, Sequence[JointExample]], turn: Array
) -> int:
    """Parts that have a candidate like an accepted joint whose object is turned by ``turn``."""
    return sum(
        any(parts[key].agree(j, turn).any() for j in found) for key, found in examples.items()
    )


def _recalled(votes: Sequence[tuple[Array, list[JointExample], Array]]) -> Recalled:
    agreeing = np.sum([share for share, _, _ in votes], axis=0)
    types: dict[str, float] = defaultdict(float)
    parents: dict[str, float] = defaultdict(float)
    limits = []
    for _, found, turn in votes:
        for joint in found:
            types[joint.type] += 1 / len(found) / len(votes)
            parents[joint.parent] += 1 / len(found) / len(votes)
            if joint.type in ("revolute", "prismatic"):
                limits.append([*(turn @ np.asarray(joint.axis)), joint.lower, joint.upper])
    return Recalled(len(votes), agreeing, types, parents, np.array(limits).reshape(-1, 5))


def part_name(name: str | None) -> str:
    """A part's name in lower case without numbers of its own; "" without one."""
    return " ".join(w for w in _WORDS.findall((name or "").lower()) if not w.isdigit())


def in_part(sampled: SampledObject, part: int, axis: Array, origin: Array) -> tuple[Array, Array]:
    """An axis line of the working frame as in :class:`JointExample`: its direction and its arm."""
    shape = sampled.shapes[part]
    middle, half = (shape.low + shape.high) / 2, (shape.high - shape.low) / 2
    half = np.maximum(half, max(THIN * float(half.max()), 1e-6))
    offset = origin - middle
    return axis, (offset - axis * float(axis @ offset)) / half


def extent_along(sampled: SampledObject, part: int, axis: Array) -> float:
    """Length of a part along an axis of the working frame, diagonals."""
    return max(float(np.ptp(sampled.shapes[part].points @ axis)), 1e-3)


def example_of(obj: ArticulatedObject, source: str, seed: int = 0) -> ObjectExample:
    """The joints of an accepted object; parts with several joints are left out."""
    segmented = SegmentedObject(obj.name, obj.parts, obj.category)
    sampled = sample_object(segmented, seed)
    frame, links = sampled.frame, {p.link: k for k, p in enumerate(obj.parts)}
    found = []
    for part, k in links.items():
        joint = obj.tree.joint_of.get(part)
        name = part_name(obj.parts[k].name)
        if joint is None or not name or joint.parent not in links:
            continue
        carries = links[joint.parent]
        above = "" if joint.parent == obj.tree.root else part_name(obj.parts[carries].name)
        if not joint.moves:
            found.append(JointExample(name, above, "fixed"))
            continue
        direction = frame.object_from_working.T @ np.asarray(joint.axis)
        axis, arm = in_part(sampled, k, direction, frame.to_working(np.array([joint.origin]))[0])
        unit = 1.0 if joint.rotates else extent_along(sampled, k, axis) * frame.diagonal
        ends = ((v or 0.0) / unit for v in (joint.lower, joint.upper))
        found.append(
            JointExample(
                name,
                above,
                joint.type,
                _vector(axis),
                _vector(arm if joint.rotates else np.zeros(3)),
                *(round(v, 4) for v in ends),
            )
        )
    return ObjectExample(source, obj.category, tuple(found))


def _vector(v: Array) -> Vector:
    x, y, z = (round(float(c), 4) for c in v)
    return x, y, z


def save_experience(experience: Experience, path: Path) -> None:
    """Write it as JSON."""
    data = {"format": FORMAT, **codec.write(experience)}
    path.write_text(json.dumps(data, indent=1), encoding="utf-8")


def record_of(folder: Path) -> dict[str, Any]:
    """The record of a version in its folder; empty where it can't be read."""
    try:
        found = json.loads((folder / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def in_use(workspace: Path) -> Path | None:
    """The folder of the version that predictions in a workspace use; None without one."""
    try:
        current = json.loads((workspace / FOLDER / CURRENT).read_text(encoding="utf-8"))
        folder = workspace / FOLDER / str(int(current["version"]))
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return folder if (folder / FILE).is_file() else None


@lru_cache(maxsize=4)
def load_experience(path: Path) -> Experience:
    """Read what :func:`save_experience` wrote.

    Raises:
        InputFileError: if the file is absent or damaged.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        if data.pop("format") != FORMAT:
            raise ValueError("another format")
        return codec.read(Experience, data)
    except (OSError, ValueError, KeyError, AttributeError, TypeError) as error:
        raise InputFileError(
            path, f"holds no experience: {error}", "run artiworld train --workspace again"
        ) from None
