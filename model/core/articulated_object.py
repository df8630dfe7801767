"""Parts and a tree that agree, and a predictor's answer.

With them go the mass properties of links, and affordances: where a robot takes hold of a moving
part.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from model.core.errors import GeometryError, KinematicsError
from model.core.geometry import Mesh, PointCloud
from model.core.joint import Joint
from model.core.shapes import Shape, moved_shape
from model.core.tree import KinematicTree, moved_joint

AffordanceKind = Literal["grasp", "hook", "push", "turn"]
AFFORDANCE_KINDS: tuple[AffordanceKind, ...] = get_args(AffordanceKind)
UNIT_TOLERANCE = 1e-3
"""Largest difference of a direction's length from 1."""

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Affordance:
    """One place on a link from which its joint can be moved, in the link frame.

    The link frame sits at the joint's origin with the object's axes at rest, as in the URDF.

    Attributes:
        joint, link: the joint that is moved, and its child link.
        kind: grasp (pinch and pull), hook (a finger behind an edge), push (with the fingertips),
            turn (pinch across the axis).
        center: (3,) metres: between the pads, or the point that the finger touches.
        normal: (3,) unit, from the link to the hand; the hand comes against it.
        closing: (3,) unit, along which the fingers close, perpendicular to ``normal``. The closed
            fingers of a hook pull along ``closing`` × ``normal``.
        width: metres between the pads when they touch; 0 for a hook or a push.

    Raises:
        GeometryError: for an unknown kind, or values that are no directions or lengths.
    """

    joint: str
    link: str
    kind: AffordanceKind
    center: Vector
    normal: Vector
    closing: Vector
    width: float = 0.0

    def __post_init__(self) -> None:
        problems: list[str] = []
        if self.kind not in AFFORDANCE_KINDS:
            problems.append(f"kind {self.kind!r} is none of {', '.join(AFFORDANCE_KINDS)}")
        for name in ("center", "normal", "closing"):
            value = tuple(float(v) for v in getattr(self, name))
            object.__setattr__(self, name, value)
            if len(value) != 3 or not all(map(math.isfinite, value)):
                problems.append(f"{name} must be three finite numbers, got {value}")
            elif name != "center" and abs(math.hypot(*value) - 1.0) > UNIT_TOLERANCE:
                problems.append(f"{name} must have length 1, got {math.hypot(*value):.4g}")
        if not (math.isfinite(self.width) and self.width >= 0):
            problems.append(f"width must be 0 m or more, got {self.width}")
        if problems:
            raise GeometryError(f"affordance of {self.joint!r}: {'; '.join(problems)}")

    def to_json(self) -> dict[str, Any]:
        """Everything but the joint and the link, whose entry holds it."""
        values = {
            name: [round(v, 6) for v in getattr(self, name)]
            for name in ("center", "normal", "closing")
        }
        return {"kind": self.kind, **values, "width": round(self.width, 6)}

    @classmethod
    def from_json(cls, joint: str, link: str, data: Mapping[str, Any]) -> Affordance:
        """The inverse of :meth:`to_json`.

        Raises:
            GeometryError: where an entry is missing or wrong.
        """
        try:
            vectors = [tuple(float(v) for v in data[k]) for k in ("center", "normal", "closing")]
            width = float(data.get("width", 0.0))
            return cls(joint, link, data["kind"], *vectors, width)  # type: ignore[arg-type]
        except (KeyError, TypeError, ValueError) as error:
            raise GeometryError(
                f"affordance of {joint!r} needs kind, center, normal and closing: {error}"
            ) from None


def belongs(affordance: Affordance, tree: KinematicTree) -> bool:
    """True if its joint is in ``tree``, moves, and has the same child."""
    joint = tree.by_name.get(affordance.joint)
    return joint is not None and joint.moves and joint.child == affordance.link


@dataclass(frozen=True, eq=False)
class Inertial:
    """Mass properties of a link at rest.

    Attributes:
        mass: kg.
        center: (3,) centre of mass in metres, object frame.
        tensor: (3, 3) inertia about ``center`` in kg m², object-frame axes.
    """

    mass: float
    center: npt.NDArray[np.float64]
    tensor: npt.NDArray[np.float64]

    @property
    def exact_tensor(self) -> npt.NDArray[np.float64]:
        """``tensor`` to 12 digits, without products of inertia that are rounding errors."""
        least = 1e-12 * np.abs(self.tensor).max()
        exact = [0.0 if abs(v) < least else float(f"{v:.12g}") for v in self.tensor.ravel()]
        return np.reshape(exact, (3, 3))

    def moved(self, matrix: npt.NDArray[np.float64]) -> Inertial:
        """The same mass under (4, 4) ``matrix``: a rotation, a uniform scale, a translation."""
        linear = matrix[:3, :3]
        center = linear @ self.center + matrix[:3, 3]
        return Inertial(self.mass, center, linear @ self.tensor @ linear.T)


def together(inertials: Sequence[Inertial]) -> Inertial:
    """Inertial of several bodies that are fixed to each other; at least one."""
    if len(inertials) == 1:
        return inertials[0]
    mass = sum(i.mass for i in inertials)
    center = np.sum([i.mass * i.center for i in inertials], axis=0) / mass
    tensor = np.zeros((3, 3))
    for i in inertials:
        arm = i.center - center
        tensor += i.tensor + i.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return Inertial(mass, center, tensor)


def inertial_problems(inertials: Mapping[str, Inertial]) -> list[str]:
    """Links with mass properties that no rigid body can have."""
    out: list[str] = []
    for link, inertial in inertials.items():
        if not (np.isfinite(inertial.center).all() and np.isfinite(inertial.tensor).all()):
            out.append(f"{link}: inertia is not a number")
            continue
        values = np.linalg.eigvalsh(inertial.tensor)
        if not inertial.mass > 0 or not values[0] > 0:
            out.append(f"{link}: mass and inertia must be above 0")
        elif values[0] + values[1] < values[2] * (1 - 1e-9):
            out.append(f"{link}: inertia breaks the triangle inequality")
    return out


@dataclass(frozen=True, eq=False)
class Part:
    """A rigid part in the object's rest frame.

    Attributes:
        link: name of its link (``link_0``).
        mesh, cloud: its geometry; at least one.
        name: what it is in the field's words (door, drawer, lid, …), or None.
        remarks: what was passed over on reading the source it comes from (points that are no
            numbers, a missing texture), human-readable.
        completed: kinds of completion behind the cloud's surface, see
            :func:`model.geometry.completion.complete`.
    """

    link: str
    mesh: Mesh | None = None
    cloud: PointCloud | None = None
    name: str | None = None
    remarks: tuple[str, ...] = ()
    completed: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.mesh is None and self.cloud is None:
            raise GeometryError(f"part {self.link!r} needs a mesh or a cloud")

    @property
    def bounds(self) -> npt.NDArray[np.float64]:
        """(2, 3) lowest and highest corner."""
        return (self.mesh if self.mesh is not None else self.cloud).bounds  # type: ignore[union-attr]

    def moved(self, matrix: npt.NDArray[np.float64]) -> Part:
        """The part under an affine (4, 4)."""
        mesh, cloud = (None if g is None else g.moved(matrix) for g in (self.mesh, self.cloud))
        return replace(self, mesh=mesh, cloud=cloud)


def remarks_of(parts: Iterable[Part]) -> tuple[str, ...]:
    """The remarks of all parts, each once: parts of one source share theirs."""
    return tuple(dict.fromkeys(remark for part in parts for remark in part.remarks))


def bounds_of(parts: Iterable[Part]) -> npt.NDArray[np.float64]:
    """(2, 3) lowest and highest corner of all parts."""
    each = np.stack([p.bounds for p in parts])
    return np.stack([each[:, 0].min(0), each[:, 1].max(0)])


@dataclass(frozen=True, eq=False)
class SegmentedObject:
    """Input of a predictor: the rigid parts of one object, in one frame.

    The order of the parts says nothing about which one is the base.

    Attributes:
        inertials: link → mass properties that the source declares; no predictor reads them.
        shapes: link → collision shapes that the source declares, object frame.
    """

    name: str
    parts: tuple[Part, ...]
    category: str | None = None
    inertials: Mapping[str, Inertial] = field(default_factory=dict)
    shapes: Mapping[str, tuple[Shape, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.parts:
            raise GeometryError(f"{self.name}: an object needs at least one part")
        links = [p.link for p in self.parts]
        twice = sorted({n for n in links if links.count(n) > 1})
        if twice:
            raise GeometryError(f"{self.name}: parts with the same link name: {', '.join(twice)}")

    @property
    def bounds(self) -> npt.NDArray[np.float64]:
        """(2, 3) lowest and highest corner of all parts."""
        return bounds_of(self.parts)


@dataclass(frozen=True, eq=False)
class ArticulatedObject:
    """Parts and tree that agree: every part is a link, every other link is a helper.

    Attributes:
        inertials: link → mass properties where the source tells them; links that aren't there
            have what exporters work out.
        shapes: link → collision shapes, object frame, where the source tells them; for other parts
            they are made.

    Raises:
        KinematicsError: where they don't.
    """

    name: str
    parts: tuple[Part, ...]
    tree: KinematicTree
    category: str | None = None
    inertials: Mapping[str, Inertial] = field(default_factory=dict)
    shapes: Mapping[str, tuple[Shape, ...]] = field(default_factory=dict)
    affordances: tuple[Affordance, ...] = ()

    def __post_init__(self) -> None:
        links, owned = set(self.tree.links), {p.link for p in self.parts}
        problems = [f"part {link!r} has no link in the tree" for link in sorted(owned - links)]
        problems += [
            f"link {link!r} has no part; helper links must not begin with 'link_'"
            for link in sorted(links - owned)
            if link.startswith("link_")
        ]
        if problems:
            raise KinematicsError(problems)

    def pose(self, q: Mapping[str, float]) -> dict[str, npt.NDArray[np.float64]]:
        """Link → (4, 4), as :meth:`KinematicTree.pose`."""
        return self.tree.pose(q)

    @property
    def bounds(self) -> npt.NDArray[np.float64]:
        """(2, 3) lowest and highest corner of all parts."""
        return bounds_of(self.parts)

    def moved(self, matrix: npt.NDArray[np.float64]) -> ArticulatedObject:
        """The object under (4, 4) ``matrix``, a rotation, a uniform scale, a translation, without
        its affordances."""
        return replace(
            self,
            parts=tuple(p.moved(matrix) for p in self.parts),
            tree=self.tree.moved(matrix),
            inertials={link: i.moved(matrix) for link, i in self.inertials.items()},
            shapes={k: tuple(moved_shape(s, matrix) for s in v) for k, v in self.shapes.items()},
            affordances=(),
        )


@dataclass(frozen=True)
class Prediction:
    """A predictor's answer, or the joints that a file tells. Bad model text never raises: it
    becomes ``problems``.

    Attributes:
        tree: None where nothing usable came out.
        problems: human-readable errors and doubts.
        confidence: child link → 0..1 for its joint.
        backend: predictor and version; of a file's joints "file" and its name.
        raw_text: the model's own words, "" for a predictor without any.
        notes: child link → human-readable explanation of the joint.
        file: name of the file that declares the joints; None where a predictor answered.
        alternatives: child link → other joints that it may have, likeliest first.
    """

    tree: KinematicTree | None
    problems: tuple[str, ...] = ()
    confidence: Mapping[str, float] = field(default_factory=dict)
    backend: str = ""
    seed: int = 0
    seconds: float = 0.0
    raw_text: str = ""
    notes: Mapping[str, str] = field(default_factory=dict)
    file: str | None = None
    alternatives: Mapping[str, tuple[Joint, ...]] = field(default_factory=dict)

    @classmethod
    def of_file(cls, name: str, tree: KinematicTree) -> Prediction:
        """The joints that a file declares; declared joints have no confidence."""
        notes = {j.child: f"From {name}." for j in tree.joints}
        return cls(tree, backend=f"file {name}", notes=notes, file=name)

    def likely(self, child: str) -> tuple[Joint, ...]:
        """The joint of ``child`` and its alternatives, likeliest first."""
        joint = self.joint(child)
        return () if joint is None else (joint, *self.alternatives.get(child, ()))

    def joint(self, child: str) -> Joint | None:
        """The joint of ``child``, or None."""
        return None if self.tree is None else self.tree.joint_of.get(child)

    def moved(self, matrix: npt.NDArray[np.float64]) -> Prediction:
        """The answer after (4, 4) ``matrix`` has moved the object."""
        others = {k: tuple(moved_joint(j, matrix) for j in v) for k, v in self.alternatives.items()}
        tree = None if self.tree is None else self.tree.moved(matrix)
        return replace(self, tree=tree, alternatives=others)
