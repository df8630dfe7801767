"""Accepted objects of a workspace, kept as examples of whole motions.

Each part is kept with its name, size and place in its object, the part that carries it, and all
joints of its motion: types, axes, lines relative to its own box and to that of its carrier, ranges.
Nothing is trained: an object that is taken out leaves no trace. How parts of another object follow
them is in :mod:`model.prediction.lessons`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from model.core import codec
from model.core.articulated_object import ArticulatedObject
from model.core.errors import InputFileError
from model.core.joint import JOINT_KINDS, Joint, JointType
from model.core.names import category_key
from model.core.tree import moving_chain
from model.prediction.geometric.sampled_object import SampledObject
from model.prediction.geometric.shape import PartShape
from model.segmentation.similar import MaskExample, MaskTable

Array = npt.NDArray[np.float64]
Vector = tuple[float, float, float]
ZERO: Vector = (0.0, 0.0, 0.0)

FORMAT = 2
"""Format 1 kept single joints of named parts, without sizes and places; it is still read."""
_WORDS = re.compile(r"[a-z0-9]+")
FILE = "experience.json"
FOLDER, CURRENT, RECORD = "learned", "current.json", "record.json"
"""Folder of a workspace's versions, file of the one in use, and file of each one's results."""
LEAST = 3
"""Accepted objects of one kind below which nothing is learned."""
THIN = 0.25
"""Least half extent of a part's box, as a share of its largest: doors have hardly any depth."""


@dataclass(frozen=True)
class Step:
    """One joint of a part's motion, in the working frame of its object.

    Attributes:
        type: of the joint. axis: (3,) unit.
        arm: (3,) from the middle of the part's box to the axis, in half extents; 0 where it slides.
        held: (3,) the same from the middle of the carrier's box.
        lower, upper: radians, or extents of the part along the axis.
    """

    type: JointType
    axis: Vector
    arm: Vector = ZERO
    held: Vector = ZERO
    lower: float = 0.0
    upper: float = 0.0

    @property
    def rotates(self) -> bool:
        """True if it turns."""
        return JOINT_KINDS[self.type].rotates


@dataclass(frozen=True)
class PartExample:
    """A part of an accepted object.

    Attributes:
        name: in lower-case words; "" without one.
        carrier: index of the part that carries it, -1 for the base.
        place: (3,) of its middle in the object's box, -0.5..0.5.
        half: (3,) half extents along the working axes, diagonals; 0 where unknown.
        round: whether it is round about an axis.
        skew: (3,) where in its box, -1..1, lies what stands out of it, such as a door's handle.
        steps: joints of its motion from the carrier on; none if it is fixed.
        foreseen: whether its joint came out as accepted without any experience.
    """

    name: str
    carrier: int = -1
    place: Vector = ZERO
    half: Vector = ZERO
    round: bool = False
    skew: Vector = ZERO
    steps: tuple[Step, ...] = ()
    foreseen: bool = False


@dataclass(frozen=True)
class ObjectExample:
    """The parts of an accepted object.

    Attributes:
        source: name of its asset. category: of the object.
        stamp: time at which the asset was written, seconds since 1970.
        masks: that clicks may mean; None where an early version kept it.
    """

    source: str
    category: str | None
    parts: tuple[PartExample, ...]
    stamp: float = 0.0
    masks: tuple[MaskExample, ...] | None = None


@dataclass(frozen=True)
class Experience:
    """Accepted objects.

    Attributes:
        objects: the accepted objects.
        unused: kinds whose objects don't gain from the others' example; they are left out.
        checked: kind → numbers of right joints and of all, when each object was left out.
    """

    objects: tuple[ObjectExample, ...] = ()
    unused: tuple[str, ...] = ()
    checked: Mapping[str, tuple[int, int]] = field(default_factory=dict)

    def without(self, source: str) -> Experience:
        """Everything but one object."""
        return replace(self, objects=tuple(o for o in self.objects if o.source != source))

    def of(self, category: str | None) -> tuple[ObjectExample, ...]:
        """The objects of a kind; all where the kind isn't known."""
        kind = kind_of(category)
        used = (o for o in self.objects if kind_of(o.category) not in self.unused)
        return tuple(o for o in used if not kind or kind_of(o.category) in (kind, ""))

    def masks_of(self, category: str | None) -> tuple[MaskTable, ...]:
        """The masks of each object of a kind; none where the kind isn't known."""
        kind = kind_of(category)
        own = (o for o in self.objects if kind and kind_of(o.category) == kind and o.masks)
        return tuple(MaskTable.of(o.masks or (), (p.name for p in o.parts)) for o in own)


def kind_of(category: str | None) -> str:
    """A category as it is compared; "" without one."""
    return category_key(category) or " ".join(_WORDS.findall((category or "").lower()))


def part_name(name: str | None) -> str:
    """A part's name in lower case without numbers of its own; "" without one."""
    return " ".join(w for w in _WORDS.findall((name or "").lower()) if not w.isdigit())


def box_of(sampled: SampledObject, part: int) -> tuple[Array, Array]:
    """Middle (3,) of a part's box, working frame, and the half extents (3,) that arms count in."""
    shape = sampled.shapes[part]
    half = (shape.high - shape.low) / 2
    return (shape.low + shape.high) / 2, np.maximum(half, max(THIN * float(half.max()), 1e-6))


def extent_along(sampled: SampledObject, part: int, axis: Array) -> float:
    """Length of a part along an axis of the working frame, diagonals."""
    return max(float(np.ptp(sampled.shapes[part].points @ axis)), 1e-3)


def described(sampled: SampledObject) -> list[PartExample]:
    """The parts of an object without their motions."""
    size = np.maximum(
        np.max([s.high for s in sampled.shapes], axis=0)
        - np.min([s.low for s in sampled.shapes], axis=0),
        1e-6,
    )
    return [
        PartExample(
            part_name(s.name),
            place=_vector((s.low + s.high) / 2 / size),
            half=_vector((s.high - s.low) / 2),
            round=s.roundest is not None,
            skew=_vector(_skew(s)),
        )
        for s in sampled.shapes
    ]


def _skew(shape: PartShape) -> Array:
    half = np.maximum((shape.high - shape.low) / 2, 1e-6)
    there = (shape.points - (shape.high + shape.low) / 2) / half
    off = there[:, int(np.argmin(half))] ** 2
    return (off @ there) / max(float(off.sum()), 1e-9)


def example_of(
    obj: ArticulatedObject, source: str, sampled: SampledObject, foreseen: Collection[str] = ()
) -> ObjectExample:
    """The parts of an accepted object with their motions.

    Args:
        source: name of its asset. sampled: its parts.
        foreseen: links whose joints came out as accepted without experience.
    """
    links = {p.link: k for k, p in enumerate(obj.parts)}
    found = []
    for (link, k), part in zip(links.items(), described(sampled), strict=True):
        joints, carrier = [], -1
        if link != obj.tree.root:
            chain = moving_chain(obj.tree, link, links.__contains__)
            joints = [obj.tree.joint_of[below] for below in chain]
            carrier = links.get(joints[0].parent, -1)
        steps = tuple(_step(sampled, k, carrier, j) for j in joints if j.moves)
        found.append(replace(part, carrier=carrier, steps=steps, foreseen=link in foreseen))
    return ObjectExample(source, obj.category, tuple(found))


def _step(sampled: SampledObject, part: int, carrier: int, joint: Joint) -> Step:
    frame = sampled.frame
    axis = frame.object_from_working.T @ np.asarray(joint.axis)
    origin = frame.to_working(np.array([joint.origin]))[0]
    unit = 1.0 if joint.rotates else extent_along(sampled, part, axis) * frame.diagonal
    lower, upper = ((v or 0.0) / unit for v in (joint.lower, joint.upper))
    arms = [ZERO, ZERO]
    if joint.rotates:
        for k, box in enumerate((part, carrier if carrier >= 0 else part)):
            middle, half = box_of(sampled, box)
            offset = origin - middle
            arms[k] = _vector((offset - axis * float(axis @ offset)) / half)
    return Step(joint.type, _vector(axis), arms[0], arms[1], round(lower, 4), round(upper, 4))


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


def versions(workspace: Path) -> list[int]:
    """The versions that were learned, sorted."""
    found = (p.parent.name for p in (workspace / FOLDER).glob(f"*/{FILE}"))
    return sorted(int(name) for name in found if name.isdecimal())


def chosen_by_person(workspace: Path) -> bool:
    """True where a person switched learning off, or went back to an earlier version."""
    try:
        current = json.loads((workspace / FOLDER / CURRENT).read_text(encoding="utf-8"))
        earlier = int(current["version"]) < max(versions(workspace), default=0)
        return bool(current.get("chosen", earlier))
    except (OSError, ValueError, KeyError, TypeError):
        return False


def masks_in_use(workspace: Path, category: str | None) -> tuple[MaskTable, ...]:
    """The masks of each accepted object of a kind in the version that a workspace uses.

    Raises:
        InputFileError: if its file is damaged.
    """
    folder = in_use(workspace)
    return () if folder is None else load_experience(folder / FILE).masks_of(category)


@lru_cache(maxsize=4)
def load_experience(path: Path) -> Experience:
    """Read what :func:`save_experience` wrote.

    Raises:
        InputFileError: if the file is absent or damaged.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        found = data.pop("format")
        if found == 1:
            return Experience(tuple(_of_format_1(o) for o in data["objects"]))
        if found != FORMAT:
            raise ValueError("another format")
        data.pop("trust", None)  # earlier versions kept shares alone
        return codec.read(Experience, data)
    except (OSError, ValueError, KeyError, AttributeError, TypeError) as error:
        raise InputFileError(
            path, f"holds no experience: {error}", "run artiworld train --workspace again"
        ) from None


def _of_format_1(data: Mapping[str, Any]) -> ObjectExample:
    """An object of named joints, whose sizes and places aren't known."""
    joints: Sequence[Mapping[str, Any]] = data["joints"]
    place = {joint["name"]: k for k, joint in enumerate(joints, start=1)}
    parts = [PartExample("")]  # the base, whose name wasn't kept
    for joint in joints:
        step = codec.read(Step, {k: joint[k] for k in ("type", "axis", "arm", "lower", "upper")})
        moving = (step,) if JOINT_KINDS[step.type].unit else ()
        parts.append(PartExample(joint["name"], place.get(joint["parent"], 0), steps=moving))
    return ObjectExample(data["source"], data["category"], tuple(parts))
